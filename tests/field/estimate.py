"""Situations of the autopilot's estimate: dead receivers, glitches, jumps, and heights of others without a datum."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.onboard.decision import Purpose
from tests.field.rig import EPOCH_S, config_of
from tests.field.situation import Situation
from tests.field.tampered import TamperedRig

Message = Any
FULL = 120
"""More aircraft than a table of neighbours holds."""


def receiver_dies(kind: str) -> Callable[[], str]:
    def play() -> str:
        rig = TamperedRig(kind).steered()

        def without_fix(message: Message) -> Message:
            message.fix_type, message.satellites_visible = 1, 3
            return message

        def second() -> list[Message]:
            fix = (round(1e6 * rig.t_s), 6, 0, 0, 0, 80, 80, 0, 0, 14, 0, 0)
            return [mavlink.MAVLink_gps2_raw_message(*fix, h_acc=500), estimate_of(kind)]

        rig.edits["GPS_RAW_INT"], rig.also = without_fix, second
        rig.run(rig.t_s + 20.0)
        rig.assert_does(Purpose.TARGET)
        assert rig.last.triggers == (), rig.words()
        return f"{rig.words()} all the time"

    return play


def estimate_of(kind: str, flags: int = 0x33F, ratio: float = 0.01) -> Message:
    """Return what an autopilot says of its estimate."""
    if kind.startswith("px4"):
        return mavlink.MAVLink_estimator_status_message(0, flags, 0.01, ratio, 0.01, 0.01, 0.0, 0.0, 0.8, 0.8)
    return mavlink.MAVLink_ekf_status_report_message(flags, 0.01, ratio, 0.01, 0.01, 0.0)


def estimate_says(flags: int, ratio: float = 0.01) -> TamperedRig:
    """Return a copter whose autopilot has said so of its estimate for some seconds, with a fix all the time."""
    rig = TamperedRig().steered()
    rig.edits["EKF_STATUS_REPORT"] = lambda message: None
    rig.also = lambda: [estimate_of("arducopter", flags, ratio)]
    rig.run(rig.t_s + 3.0)
    return rig


def estimate_ends() -> str:
    rig = estimate_says(0x25)
    rig.assert_does(Purpose.IDLE)
    return rig.last.reason


def estimate_glitches() -> str:
    rig = estimate_says(0x833F, 27.0)
    rig.assert_does(Purpose.LOITER)
    return rig.last.reason


def estimate_rejects() -> str:
    rig = estimate_says(0x33F, 1.6)
    rig.assert_does(Purpose.LOITER)
    return rig.last.reason


def jumps_and_back() -> str:
    """Let GPS jump across the fence for a second and come back."""
    fence = ", fence: [[-200, -100], [-200, 100], [20000, 100], [20000, -100]]"
    rig = TamperedRig("arducopter", config_of("arducopter", limits=fence)).steered()
    rig.move_position(0.0, 300.0)
    before = len(rig.decisions)
    rig.run(rig.t_s + 1.0)
    del rig.edits["GLOBAL_POSITION_INT"]
    rig.run(rig.t_s + 4.0)
    headings = [one.setpoint.heading_rad for one in rig.decisions[before:] if one.setpoint is not None]
    swing_deg = math.degrees(max(abs(math.remainder(one, math.tau)) for one in headings))
    assert len(headings) == len(rig.decisions) - before
    assert swing_deg < 5.0, f"setpoint swings by {swing_deg:.0f} degrees: {rig.words()}"
    rig.assert_does(Purpose.TARGET)
    return f"setpoint swings by {swing_deg:.1f} degrees; goes on"


def jumps_onto_target() -> str:
    """Let GPS jump onto the target for half a second: the vehicle is as far from it as before."""
    config = config_of("arducopter").model_copy(update={"arrival_radius_m": 400.0})
    rig = TamperedRig("arducopter", config).steered()
    rig.move_position(20_000.0 - rig.vehicle.truth.north_m)
    rig.run(rig.t_s + 0.5)
    del rig.edits["GLOBAL_POSITION_INT"]
    rig.run(rig.t_s + 3.0)
    assert not any(one.reason == "arrived" for one in rig.decisions), rig.words()
    rig.assert_does(Purpose.TARGET)
    return rig.words()


def jumps_for_good() -> str:
    """Let the estimate give in to a glitch: 111 m in one message, as ArduPilot does after ten seconds."""
    rig = TamperedRig().steered()
    rig.move_position(0.0, 111.0)
    jumped_s = rig.t_s
    rig.run(rig.t_s + 6.0)
    rig.assert_does(Purpose.LOITER)
    assert any("position jumped 110 m at" in one for one in rig.last.triggers), rig.words()
    loiters_s = next(one.t_s for one in rig.decisions if one.purpose is Purpose.LOITER) - EPOCH_S - jumped_s
    drifted_m = abs(rig.vehicle.truth.east_m)
    assert drifted_m < 15.0
    del rig.edits["GLOBAL_POSITION_INT"]
    rig.run(rig.t_s + 6.0)
    rig.assert_does(Purpose.TARGET)
    return f"not believed for 2 s, loiters after {loiters_s:.1f} s, goes on when it has jumped back"


def stands_still(at_share: float, says: str) -> Callable[[], str]:
    """Return a play in which the told place goes a share of the way flown for 12 s, velocity and clock as ever."""

    def play() -> str:
        rig = TamperedRig().steered()
        began_s, first = rig.t_s, list[tuple[int, int]]()

        def edit(message: Message) -> Message:
            first.append((message.lat, message.lon))
            message.lat = round(first[0][0] + at_share * (message.lat - first[0][0]))
            message.lon = round(first[0][1] + at_share * (message.lon - first[0][1]))
            return message

        rig.edits["GLOBAL_POSITION_INT"] = edit
        rig.run(rig.t_s + 12.0)
        rig.assert_does(Purpose.LOITER)
        assert any(says in one for one in rig.last.triggers), rig.words()
        noticed_s = next(one.t_s for one in rig.decisions if one.t_s > EPOCH_S + began_s and one.triggers) - EPOCH_S
        words = rig.words()
        del rig.edits["GLOBAL_POSITION_INT"]
        rig.run(rig.t_s + 4.0)
        rig.assert_does(Purpose.TARGET)
        return f"noticed after {noticed_s - began_s:.1f} s, {words}; goes on when it is back"

    return play


def jumps_about() -> str:
    rig = TamperedRig().steered()
    places = iter(range(10_000))
    rig.edits["GLOBAL_POSITION_INT"] = lambda message: _east(message, 200 * (1 + next(places) % 5))
    rig.run(rig.t_s + 8.0)
    rig.assert_does(Purpose.IDLE)
    return rig.last.reason


def _east(message: Message, east_m: float) -> Message:
    message.lon += round(1e7 * east_m / 76_000.0)
    return message


def gives_way(*, each: Callable[[TamperedRig], list[Message]]) -> str:
    """Return what a copter that keeps 50 m of height apart says of an aircraft that comes head-on."""
    more = "vertical_separation_m: 50\n"
    rig = TamperedRig("arducopter", config_of("arducopter", more)).steered()
    start_m = rig.vehicle.truth.north_m + 300.0
    began_s = rig.t_s

    def come() -> None:
        if round(10 * rig.t_s) % 5 == 0:
            rig.come_m = start_m - 20.0 * (rig.t_s - began_s) - rig.vehicle.truth.north_m
            rig.hear(*each(rig))

    rig.run(rig.t_s + 9.0, come)
    ways = [one.gave_way for one in rig.decisions if one.gave_way is not None]
    assert ways, f"flies on: {rig.words()}"
    return f"gives way: {ways[0]}"


def other_datum() -> str:
    """Let the aircraft tell a pressure altitude, 230 m off on this day."""
    return gives_way(
        each=lambda rig: [
            rig.meet(
                rig.come_m, altitude_type=mavlink.ADSB_ALTITUDE_TYPE_PRESSURE_QNH, altitude_mm=round(1e3 * (560 + 230))
            )
        ]
    )


def far_aircraft_first() -> str:
    """Fill the table of neighbours with aircraft 30 km away before the near one comes."""
    return gives_way(
        each=lambda rig: [
            *(rig.meet(30_000.0 + 50.0 * number, address=number + 1, east_m=20_000) for number in range(FULL)),
            rig.meet(rig.come_m),
        ]
    )


def old_word_after_the_new() -> str:
    """Let each word of the near aircraft be followed by one that is a minute old, as some receivers repeat it."""
    return gives_way(each=lambda rig: [rig.meet(rig.come_m), rig.meet(5_000.0, tslc=60)])


GOES_ON = "the autopilot flies on, and so does the companion"
SITUATIONS: tuple[Situation, ...] = (
    Situation(
        "the first of two GPS receivers dies, ArduCopter", GOES_ON, 'silent: "no GPS fix"', receiver_dies("arducopter")
    ),
    Situation(
        "the first of two GPS receivers dies, PX4 copter", GOES_ON, 'locked: "no GPS fix"', receiver_dies("px4-copter")
    ),
    Situation("the estimate has no position, with a fix", "silent, and says why", "steers on", estimate_ends),
    Situation("the estimate says GPS glitch", "loiters, and says why", "steers on", estimate_glitches),
    Situation("the estimate rejects the position it measures", "loiters, and says why", "steers on", estimate_rejects),
    Situation(
        "GPS jumps over the fence for a second", "no setpoint swings", "setpoint swings by 102 degrees", jumps_and_back
    ),
    Situation("GPS jumps onto the target for half a second", "it has not arrived", '"arrived"', jumps_onto_target),
    Situation(
        "the position jumps 111 m and stays",
        "not believed for 2 s, then loiters",
        "steers on to its target at once",
        jumps_for_good,
    ),
    Situation(
        "the position stands still while clock and velocity go on",
        "loiters, and says so; goes on when it is back",
        "steers on to its target",
        stands_still(0.0, "position stands still while the velocity says"),
    ),
    Situation(
        "the position goes at a third of the velocity",
        "loiters, and says so; goes on when it is back",
        "steers on to its target",
        stands_still(0.33, "otherwise than the velocity"),
    ),
    Situation("the position jumps about for 8 s", "silent, and says why", "steers on, by each of them", jumps_about),
    Situation("an aircraft head-on tells a pressure altitude, 230 m off", "gives way", "flies on", other_datum),
    Situation(
        f"{FULL} aircraft 30 km away before one head-on", "gives way to the near one", "flies on", far_aircraft_first
    ),
    Situation("an aircraft's words are each followed by an old one", "gives way", "flies on", old_word_after_the_new),
)
