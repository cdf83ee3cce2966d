"""Every fault in flight, by kind: what the companion does, when, how near disc and fence it comes, what brings it back.

Times are seconds from the fault on, lengths metres; the scene is sim/faults/scene.py's.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from companion.autopilot.kinds import CRUISE_M_S
from sim.faults.log import Moment
from sim.faults.scene import DEMANDED, KINDS, LOOP_PERIOD_S
from sim.faults.table import DEAD_PARAMETERS, FAULTS, WATCHDOG_S, Dead, Row, dies, fly

ARDUPILOT, PX4 = KINDS[:2], KINDS[2:]
COPTERS, PLANES = KINDS[::2], KINDS[1::2]
ONE_OF_EACH = ("arducopter", "px4-plane")
"""A copter and a plane, an ArduPilot and a PX4: the benchmark flies all kinds."""
DECISION_S = 0.55
"""A decision every half second."""
BY_TITLE = {fault.title: fault for fault in FAULTS}

Check = Callable[[Row], None]


def says(words: str, at_s: float, late_s: float = DECISION_S) -> Check:
    """Expect an event with these words to begin at a time, or a little later."""

    def check(row: Row) -> None:
        times_s = [t_s for t_s, said in row.events if words in said]
        assert any(at_s - 1e-6 <= t_s <= at_s + late_s + 1e-6 for t_s in times_s), (words, row.events)

    return check


def never_says(*words: str) -> Check:
    """Expect none of these words."""

    def check(row: Row) -> None:
        assert not [event for event in row.events if any(word in event[1] for word in words)]

    return check


def keeps_clear(row: Row) -> None:
    """Expect every disc and the fence to be kept."""
    assert row.disc_m > 0.0
    assert row.fence_m > 0.0


def inside(row: Row) -> None:
    """Expect the fence to be kept."""
    assert row.fence_m > 0.0


def enters_a_disc(row: Row) -> None:
    """Expect what nobody could prevent: nobody steers, and the disc lies where the vehicle goes."""
    assert row.disc_m < 0.0


def back_by(at_s: float) -> Check:
    """Expect the companion to be at its task again by a time, and to stay so."""

    def check(row: Row) -> None:
        assert row.normal_after_s is not None, row.events
        assert row.normal_after_s <= at_s + 1e-6, row.events

    return check


def not_back(row: Row) -> None:
    """Expect the companion not to return to its task within the flight."""
    assert row.normal_after_s is None


def sends_nothing(from_s: float, until_s: float) -> Check:
    """Expect no setpoint at all for a while."""

    def check(row: Row) -> None:
        silent = row.log.between(row.fault.on_s + from_s, row.fault.on_s + until_s)
        assert silent
        assert not [moment.t_s for moment in silent if moment.setpoints]

    return check


def steers(from_s: float, until_s: float) -> Check:
    """Expect a setpoint in every loop for a while."""

    def check(row: Row) -> None:
        steered = row.log.between(row.fault.on_s + from_s, row.fault.on_s + until_s)
        assert steered
        assert all(moment.setpoints for moment in steered)

    return check


def stays_within(circles_s: float, from_s: float) -> Check:
    """Expect the vehicle to remain near where it was at a time: within so many seconds of cruise."""

    def check(row: Row) -> None:
        after = row.log.between(row.fault.on_s + from_s)
        assert max(_apart_m(moment, after[0]) for moment in after) <= circles_s * CRUISE_M_S[row.kind]

    return check


def is_not_lured(row: Row) -> None:
    """Expect the vehicle to be where it is without a broadcast, to the millimetre: the impostor says another target."""
    alone = fly(BY_TITLE["broadcast silent for 16 s"], row.kind)
    assert math.dist(_place(row.log.moments[-1]), _place(alone.log.moments[-1])) < 1e-3


def keeps_off_the_other(row: Row) -> None:
    """Expect the vehicle to make way for who flies straight at it."""
    assert min(moment.other_m for moment in row.log.moments) > 5.0


def _apart_m(one: Moment, other: Moment) -> float:
    return math.dist(_place(one), _place(other))


def _place(moment: Moment) -> tuple[float, float]:
    return moment.north_m, moment.east_m


LADDER = (
    says("coasting: picture late", 2.0, 1.0),
    says("loitering: picture too old", 5.0, 1.0),
    says("returning: blind", 11.0, 1.0),
    steers(0.0, 16.0),
    keeps_clear,
    back_by(17.1),
)
"""STALENESS of the scene, from the last broadcast on, which was up to a second before the fault."""
LOCKED = "nothing is sent until it is disarmed or cleared"

CASES: tuple[tuple[str, tuple[str, ...], tuple[Check, ...]], ...] = (
    ("none", KINDS, (says("fresh: target", 0.0), steers(0.0, 30.0), keeps_clear, never_says("silent", "loitering"))),
    (
        "companion killed, restarted after 0.8 s",
        ("arducopter",),
        (sends_nothing(0.0, 0.8), back_by(2.4), keeps_clear),
    ),
    (
        "companion killed, restarted after 0.8 s",
        ("px4-plane",),
        (says(LOCKED, 0.8, 1.1), sends_nothing(0.0, 7.0), back_by(10.1), keeps_clear),
    ),
    ("companion killed, restarted after 3 s", ARDUPILOT, (sends_nothing(0.0, 3.0), back_by(4.1), keeps_clear)),
    (
        "companion killed, restarted after 3 s without its state files",
        PX4,
        (says(LOCKED, 3.0), sends_nothing(0.0, 7.0), back_by(10.1), keeps_clear),
    ),
    ("companion hung for 0.5 s", ("arduplane", "px4-copter"), (sends_nothing(0.0, 0.5), back_by(1.1), keeps_clear)),
    ("companion hung for 1.9 s", ("arducopter",), (sends_nothing(0.0, 1.9), back_by(2.5), keeps_clear)),
    (
        "companion hung for 1.9 s",
        ("px4-plane",),
        (says(LOCKED, 1.9), sends_nothing(0.0, 7.0), back_by(10.1), keeps_clear),
    ),
    (
        "companion hung for 1.9 s, a person takes over meanwhile",
        ("arduplane", "px4-copter"),
        (sends_nothing(2.4, 7.0), says("silent", 1.9, 0.6), back_by(10.1), keeps_clear),
    ),
    (
        "companion hung for 1.9 s, setpoints through MAVSDK's child",
        ("px4-copter",),
        (steers(0.0, 0.5), sends_nothing(0.5, 7.0), says(LOCKED, 1.9), back_by(10.1), keeps_clear),
    ),
    (
        "companion hung, killed by its watchdog after 2 s, restarted after 5 s",
        ("arducopter",),
        (says("dead", WATCHDOG_S), sends_nothing(0.0, 5.0), back_by(6.1), keeps_clear),
    ),
    (
        "companion hung, killed by its watchdog after 2 s, restarted after 5 s",
        ("arduplane",),
        (sends_nothing(0.0, 5.0), back_by(6.6), inside, enters_a_disc),
    ),
    (
        "autopilot rebooted in flight",
        ("arducopter", *PX4),
        (says("silent", 2.0), sends_nothing(2.5, 8.0), back_by(10.6), keeps_clear),
    ),
    (
        "autopilot rebooted in flight",
        ("arduplane",),
        (says("silent", 2.0), sends_nothing(2.5, 8.9), back_by(15.1), inside, enters_a_disc),
    ),
    (
        "telemetry frozen for 6 s",
        ("arducopter",),
        (says("silent: position too old", 2.0), sends_nothing(2.5, 5.9), back_by(6.6), keeps_clear),
    ),
    (
        "telemetry frozen for 6 s",
        PX4,
        (says("silent: position too old", 2.0), sends_nothing(2.5, 8.9), says(LOCKED, 3.0), back_by(11.1), keeps_clear),
    ),
    (
        "GPS lost for 6 s",
        ("arduplane",),
        (says("loitering: no GPS fix", 0.0, 1.6), steers(0.0, 14.0), back_by(8.6), keeps_clear),
    ),
    (
        "GPS lost for 6 s",
        ("px4-copter",),
        (says("loitering: no GPS fix", 0.0, 1.6), says(LOCKED, 5.0, 1.1), sends_nothing(6.1, 8.9), back_by(11.1)),
    ),
    (
        "position wrong by 8 m (1 sigma, north and east) for 8 s",
        COPTERS,
        (says("loitering: position not known well enough", 0.0, 1.6), back_by(10.6), keeps_clear),
    ),
    (
        "clock stepped by an hour for 8 s",
        ("arducopter", "px4-plane"),
        (says("coasting: clock stepped by +3600.0 s", 0.0), steers(0.0, 14.0), back_by(9.6), keeps_clear),
    ),
    (
        "clock stepped by an hour and the companion restarted",
        ("arducopter",),
        (says("silent: no picture", 0.0, 1.6), not_back, stays_within(5.0, 0.0), sends_nothing(0.0, 29.0), inside),
    ),
    (
        "clock stepped by an hour and the companion restarted",
        PX4,
        (says("silent: no picture", 0.0, 1.6), not_back, stays_within(14.0, 1.0), inside),
    ),
    ("broadcast silent for 16 s", ONE_OF_EACH, LADDER),
    (
        "no broadcast from the beginning",
        ONE_OF_EACH,
        (says("silent: no picture", 2.0, 1.6), stays_within(14.0, 3.0), inside),
    ),
    ("ground station replaced by an impostor for 16 s, frames unsigned", ("arducopter",), (*LADDER, is_not_lured)),
    ("ground station replaced by an impostor for 16 s, frames of another key", ("px4-plane",), (*LADDER, is_not_lured)),
    ("ground station replaced by an impostor for 16 s, frames replayed", ("arduplane",), (*LADDER, is_not_lured)),
    (
        "pilot takes over, gives back at +6 s; clears and gives back at +12 s",
        ARDUPILOT,
        (says("silent", 0.0), sends_nothing(0.1, 5.9), back_by(6.6), keeps_clear),
    ),
    (
        "pilot takes over, gives back at +6 s; clears and gives back at +12 s",
        PX4,
        (says(f"taken over: the mode was changed; {LOCKED}", 0.0, 1.6), sends_nothing(1.1, 10.9), back_by(14.1)),
    ),
    ("target outside the fence", ONE_OF_EACH, (steers(4.0, 40.0), inside)),
    (
        "target outside the fence, wind of 0.4 of cruise towards it that nobody configured",
        COPTERS,
        (steers(0.0, 30.0), inside),
    ),
    (
        "target outside the fence, wind of 0.4 of cruise towards it that nobody configured",
        ("arduplane",),
        (says("returning: outside the fence", 0.0, 15.0), says("fresh: target", 15.0, 19.0)),
    ),
    (
        # It hears of the wind from its autopilot before it is at the fence, and turns earlier.
        "target outside the fence, wind of 0.4 of cruise towards it that nobody configured",
        ("px4-plane",),
        (steers(0.0, 30.0), inside),
    ),
    (
        "handed over outside the fence",
        ONE_OF_EACH,
        (says("silent: outside the fence", 2.0, 1.6), not_back, stays_within(14.0, 3.0)),
    ),
    (
        "wind of 0.4 of cruise that nobody configured for 15 s",
        ("arduplane",),
        (never_says("silent", "loitering", "returning"), keeps_clear, back_by(0.0)),
    ),
    (
        "battery at 20 % for 8 s",
        ("arducopter", "px4-plane"),
        (says("returning: battery low", 0.0, 1.6), back_by(10.6), keeps_clear),
    ),
    (
        "range of 20 s of flight",
        ("arduplane", "px4-copter"),
        (says("returning: range", 9.0, 5.0), not_back, steers(4.0, 40.0), keeps_clear),
    ),
    (
        "NaN in telemetry for 6 s",
        ("arduplane", "px4-copter"),
        (never_says("silent", "loitering"), steers(0.0, 14.0), keeps_clear),
    ),
    (
        "NaN in telemetry for 6 s",
        ("px4-plane",),
        (says("silent", 2.0, 1.6), sends_nothing(3.0, 8.9), back_by(11.1), keeps_clear),
    ),
    (
        "two autopilots with one system id for 4 s",
        ("arducopter",),
        (says("silent: two autopilots say they are system 1", 0.0, 1.0), sends_nothing(1.0, 33.0), back_by(35.1)),
    ),
    (
        "two autopilots with one system id for 4 s",
        ("px4-plane",),
        (says("silent: two autopilots say they are system 1", 0.0, 1.0), sends_nothing(1.0, 36.9), back_by(39.1)),
    ),
    (
        "another vehicle with our agent id comes towards us",
        KINDS,
        (says("another vehicle uses agent id 1", 0.0, 1.1), says("gives way", 0.0, 2.1), keeps_off_the_other, inside),
    ),
    ("our own transponder is heard back", ("arduplane", "px4-copter"), (never_says("agent id", "gives way"),)),
    (
        "ground control's heartbeat lost for 8 s where the autopilot minds it",
        ARDUPILOT,
        (says("silent", 4.0, 1.6), sends_nothing(6.0, 11.9), back_by(12.6), keeps_clear),
    ),
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("title", "kind", "checks"),
    [pytest.param(title, kind, checks, id=f"{title}, {kind}") for title, kinds, checks in CASES for kind in kinds],
)
def test_a_fault_ends_as_the_table_says(title: str, kind: str, checks: tuple[Check, ...]) -> None:
    row = fly(BY_TITLE[title], kind)
    for check in checks:
        check(row)


def test_every_fault_is_flown() -> None:
    assert {title for title, _, _ in CASES} | {"companion killed, restarted after 3 s"} == set(BY_TITLE)


@pytest.mark.parametrize("kind", COPTERS)
def test_a_copter_whose_companion_died_stops(kind: str) -> None:
    dead = dies(kind)
    assert _silent_at_once(dead)
    assert dead.speed_m_s < 0.1
    assert dead.lost_height_m < 1.0
    assert dead.turned_off_s is not None
    # A PX4 brakes in HOLD at MPC_ACC_HOR, and creeps to its place.
    assert dead.turned_off_s < {"arducopter": 5.0, "px4-copter": 7.5}[kind]


@pytest.mark.parametrize("kind", PLANES)
@pytest.mark.parametrize("turning", [False, True])
def test_a_plane_whose_companion_died_circles_near_by(kind: str, turning: bool) -> None:
    dead = dies(kind, turning=turning)
    assert _silent_at_once(dead)
    assert dead.lost_height_m < 5.0
    # What it flies until it turns, and two of its circles' radii.
    assert dead.turned_off_s is not None
    assert dead.farthest_m < 10.0 * CRUISE_M_S[kind]


@pytest.mark.parametrize("kind", PX4)
def test_a_px4_as_it_comes_is_left_in_danger_by_a_dead_companion(kind: str) -> None:
    dead = dies(kind, DEAD_PARAMETERS[kind][-1])
    # The copter flies level, and drag alone slows it.
    assert dead.turned_off_s is None or dead.turned_off_s > 10.0
    assert dead.lost_height_m > 20.0 or dead.farthest_m > 500.0


def test_a_child_of_a_hung_companion_steers_for_half_a_second_more() -> None:
    direct, child = dies("px4-copter", hangs=True), dies("px4-copter", hangs=True, child=True)
    assert 0.0 <= child.last_setpoint_s <= 0.5
    assert child.farthest_m == pytest.approx(direct.farthest_m + 0.5 * CRUISE_M_S["px4-copter"], abs=0.5)


def test_a_longer_timeout_costs_its_flight() -> None:
    short, long = (dies("arducopter", {"GUID_TIMEOUT": timeout_s}) for timeout_s in (1.0, 3.0))
    assert DEMANDED["arducopter"]["GUID_TIMEOUT"] == 1.0
    assert long.farthest_m - short.farthest_m == pytest.approx(2.0 * CRUISE_M_S["arducopter"], rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ARDUPILOT)
def test_an_ardupilot_goes_on_when_its_companion_is_started_again(kind: str) -> None:
    dead = dies(kind, restarts=True)
    assert dead.resumed_s is not None
    assert dead.resumed_s < 4.5


@pytest.mark.slow
@pytest.mark.parametrize("kind", PX4)
def test_a_px4_waits_for_a_person_when_its_companion_is_started_again(kind: str) -> None:
    assert dies(kind, restarts=True).resumed_s is None


def _silent_at_once(dead: Dead) -> bool:
    return dead.last_setpoint_s == pytest.approx(-LOOP_PERIOD_S)
