"""Situations in which a frame of reference moves in flight: home, sea level, the origin of the local frame."""

from __future__ import annotations

from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from companion.onboard.decision import Purpose
from sim.vehicles.modes import BRAKE, GUIDED
from tests.field.rig import TICK_S
from tests.field.situation import Situation
from tests.field.tampered import M_PER_DEG, STEERS_S, TamperedRig

WATCHED_S = 16.0
"""Time for which a flight is watched after something moved: longer than height is commanded anew."""
HELD_M = 3.0
"""How far a vehicle may be from its height."""


def watched(rig: TamperedRig, lasts_s: float = WATCHED_S, each: Callable[[], None] = lambda: None) -> tuple[float, str]:
    """Fly on; return the greatest distance from the wanted height, and where it was: "12 m too low"."""
    off_m: list[float] = []

    def look() -> None:
        each()
        off_m.append(rig.off_height_m)

    rig.run(rig.t_s + lasts_s, look)
    worst_m = max(off_m, key=abs)
    return abs(worst_m), f"{abs(worst_m):.1f} m too {'high' if worst_m > 0 else 'low'}"


def assert_loiters(rig: TamperedRig, words: str) -> str:
    said = rig.words()
    assert rig.last.purpose is Purpose.LOITER, said
    assert words in said, said
    assert "hand over again" in said, said
    return next(one for one in rig.last.triggers if words in one)


def home_moves(kind: str, up_m: float) -> Callable[[], str]:
    def play() -> str:
        rig = TamperedRig(kind).steered()
        rig.move_home(up_m)
        off_m, words = watched(rig)
        assert off_m < HELD_M, words
        return f"at most {words}; {assert_loiters(rig, f'home moved {abs(up_m):.0f} m')}"

    return play


def home_walks() -> str:
    rig = TamperedRig().steered()

    def walk() -> None:
        walked_m = 0.5 * (rig.t_s - STEERS_S + TICK_S)
        rig.move_home(-walked_m)

    off_m, words = watched(rig, 30.0, walk)
    assert off_m < HELD_M, words
    return f"at most {words}; {assert_loiters(rig, 'home moved')}"


def home_moves_unheard() -> str:
    # Silence is no hand-over, and so there is no new reference.
    rig = TamperedRig().steered()
    rig.lost = lambda frame: True
    rig.run(rig.t_s + 5.0)
    assert rig.last.purpose is Purpose.IDLE
    rig.move_home(-500.0)
    rig.lost = lambda frame: False
    off_m, words = watched(rig)
    assert off_m < HELD_M, words
    return f"at most {words}; {assert_loiters(rig, 'home moved 500 m down')}"


def home_moves_and_its_word_is_lost() -> str:
    rig = TamperedRig("px4-copter").steered()
    rig.edits["HOME_POSITION"] = lambda message: None
    rig.move_home(-500.0)
    off_m, words = watched(rig)
    assert off_m < HELD_M, words
    return f"at most {words}; {assert_loiters(rig, 'home moved 500 m down')}"


def home_moves_and_back() -> str:
    rig = TamperedRig().steered()
    rig.move_home(-500.0)
    first_m, _ = watched(rig, 5.0)
    assert_loiters(rig, "home moved 500 m down")
    rig.move_home(0.0)
    second_m, _ = watched(rig, 5.0)
    assert max(first_m, second_m) < HELD_M
    rig.assert_does(Purpose.TARGET)
    return f"at most {max(first_m, second_m):.1f} m off its height; loiters meanwhile, then goes on"


def home_place_moves() -> str:
    rig = TamperedRig().steered()
    rig.run(20.0)
    rig.vehicle.battery.percent = 10.0
    rig.run(26.0)
    rig.assert_does(Purpose.RETURN)
    rig.move_home(north_m=5_000.0)
    before_m = rig.vehicle.truth.north_m
    rig.run(48.0)
    back_m = before_m - rig.vehicle.truth.north_m
    assert back_m > 60.0, f"{back_m:.0f} m nearer to the home of the hand-over"
    moved = next(one for one in rig.last.triggers if "aside" in one)
    return f"{back_m:.0f} m nearer to the home of the hand-over; {moved}"


def origin_moves() -> str:
    # Every setpoint of a plane is in that frame.
    rig = TamperedRig("px4-plane").steered()

    def moved(message: mavlink.MAVLink_local_position_ned_message) -> mavlink.MAVLink_local_position_ned_message:
        if not hasattr(rig.vehicle, "move_origin"):
            message.x, message.z = message.x - 300.0, message.z + 560.0
        return message

    rig.say(
        mavlink.MAVLink_set_gps_global_origin_message(1, round(1e7 * (47.0 + 300.0 / M_PER_DEG)), 80_000_000, 1_060_000)
    )
    rig.edits["LOCAL_POSITION_NED"] = moved
    off_m, words = watched(rig)
    assert_loiters(rig, "the local frame's origin moved 300 m aside and 560 m up")
    assert off_m < 2.0 * HELD_M, words
    return f"at most {words}; {assert_loiters(rig, 'the local frame')}"


def sea_level_moves() -> str:
    # The height above home goes on: a barometer's reference, or a geoid, has changed.
    rig = TamperedRig("arduplane").steered()

    def raised(message: mavlink.MAVLink_global_position_int_message) -> mavlink.MAVLink_global_position_int_message:
        message.alt += 200_000
        return message

    rig.edits["GLOBAL_POSITION_INT"] = raised
    off_m, words = watched(rig)
    assert off_m < HELD_M, words
    return f"at most {words}; {assert_loiters(rig, 'altitude above sea level jumped 200 m up')}"


def hand_over_again() -> str:
    rig = TamperedRig().steered()
    rig.move_home(-40.0)
    rig.run(rig.t_s + 3.0)
    rig.assert_does(Purpose.LOITER)
    rig.set_mode(BRAKE)
    rig.run(rig.t_s + 2.0)
    rig.set_mode(GUIDED)
    rig.run(rig.t_s + 8.0)
    rig.assert_does(Purpose.TARGET)
    assert abs(rig.off_height_m) < HELD_M, rig.off_height_m
    return f"loiters until it is handed over again, then goes to its target {rig.off_height_m:+.1f} m off its height"


HELD = "height held by what does not move; loiters, says so, asks for a hand-over"
SITUATIONS: tuple[Situation, ...] = (
    Situation(
        "home set to sea level on a field at 500 m, ArduCopter",
        HELD,
        "23 m lower after 16 s, and sinks on",
        home_moves("arducopter", -500.0),
    ),
    Situation(
        "home set to sea level on a field at 500 m, ArduPlane",
        HELD,
        "58 m lower after 16 s: into the ground",
        home_moves("arduplane", -500.0),
    ),
    Situation(
        "home set to sea level on a field at 500 m, PX4 copter",
        HELD,
        "23 m lower after 16 s, and sinks on",
        home_moves("px4-copter", -500.0),
    ),
    Situation(
        "home set to sea level on a field at 500 m, PX4 plane",
        HELD,
        "30 m lower after 16 s, and sinks on",
        home_moves("px4-plane", -500.0),
    ),
    Situation(
        "home set 560 m higher, ArduCopter",
        HELD,
        "30 m higher after 16 s, and climbs on",
        home_moves("arducopter", 560.0),
    ),
    Situation("home walks down by 0.5 m/s", HELD, "14 m lower after 30 s: follows it", home_walks),
    Situation(
        "home moves while the autopilot is not heard for 5 s", HELD, "23 m lower, and sinks on", home_moves_unheard
    ),
    Situation(
        "home moves, and HOME_POSITION is lost", HELD, "23 m lower, and sinks on", home_moves_and_its_word_is_lost
    ),
    Situation(
        "home moves and is moved back 5 s later",
        "height held, loiters, then goes on",
        '"above limits.height_max_m at 553.7 m: descends"',
        home_moves_and_back,
    ),
    Situation(
        "home's place moves 5 km while it returns",
        "returns to the home of the hand-over",
        "turns round: 48 m farther from it",
        home_place_moves,
    ),
    Situation("the origin of PX4's local frame moves under a plane", HELD, "not said", origin_moves),
    Situation("the altitude above sea level jumps", HELD, "not said", sea_level_moves),
    Situation(
        "home moved, then handed over again",
        "goes on, at its height: nothing is lowered to where home moved",
        "not said: sinks at once",
        hand_over_again,
    ),
)
