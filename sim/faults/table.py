"""The table of faults, each flown with each kind, and the results, as in the tests, benchmark and docs/faults.md."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from companion.autopilot.kinds import CRUISE_M_S
from sim.faults.flight import Flight
from sim.faults.log import Log, Moment
from sim.faults.scene import DEMANDED, KINDS, LOOP_PERIOD_S, Setting, fault_mission
from sim.loop import START_S
from sim.scaling import PAPER_SPEED_M_S

ON_S = 10.0
"""Time of the flight at which a fault begins: after 6 s under guidance, 5 s before the static disc."""
WATCHDOG_S = 2.0
"""WatchdogSec of companion/onboard/deploy: systemd kills a process that does not notify it within this time."""
RESTART_S = 3.0
"""Longest time that a restart may take, from the end of a process to the first decision of the next."""
STOPPED_M_S = 0.5
"""Speed over the ground below which a vehicle counts as stopped."""
AFTERMATH_S = 40.0
"""Time for which a vehicle is observed after its companion died."""
TURNED_RAD = math.radians(45.0)
"""Turn from the first course under guidance after which the companion dies in a turn."""
OFF_ITS_WAY_RAD = math.radians(90.0)
"""Change of course after which a vehicle without a companion counts as turned off its way."""

Action = Callable[[Flight], None]
"""Something that is done to a flight, such as a fault or its end."""
Plan = tuple[tuple[float, Action], ...]
"""Actions, each with its time of the flight in seconds."""


@dataclass(frozen=True)
class Fault:
    """One fault: a plan of actions by time of the flight, which ends at `until_s`."""

    title: str
    plan: Plan
    until_s: float
    setting: Callable[[str], Setting] | None = None
    """Function from a kind to the flight's settings; None: those of `fault_mission` alone."""
    kinds: tuple[str, ...] = KINDS
    """Kinds with which the fault is flown."""
    on_s: float = ON_S
    """Time of the flight at which the fault begins."""


@dataclass(frozen=True)
class Row:
    """One fault flown with one kind, and the log of that flight."""

    fault: Fault
    kind: str
    log: Log

    @property
    def events(self) -> tuple[tuple[float, str], ...]:
        """What the companion did in words from the fault on, each with its time in seconds since the fault began."""
        return tuple((t_s - self.fault.on_s, words) for t_s, words in self.log.course_of_events(self.fault.on_s))

    @property
    def disc_m(self) -> float:
        """Least distance to a detection disc's edge from the fault on; negative if the vehicle was inside."""
        return self.log.nearest_disc_m(self.fault.on_s)

    @property
    def fence_m(self) -> float:
        """Least distance to the fence from the fault on; negative if the vehicle was outside."""
        return self.log.nearest_fence_m(self.fault.on_s)

    @property
    def normal_after_s(self) -> float | None:
        """Time from the fault's beginning until flight is normal to the end; None: it is not normal at the end."""
        normal_s = self.log.normal_from_s(self.fault.on_s)
        return None if normal_s is None else normal_s - self.fault.on_s


def fly(fault: Fault, kind: str) -> Row:
    """Fly one fault with one autopilot kind and return its row of the table."""
    setting = Setting(kind, fault_mission(kind)) if fault.setting is None else fault.setting(kind)
    flight = Flight(setting)
    for t_s, action in fault.plan:
        flight.at(t_s, action)
    return Row(fault, kind, flight.run(fault.until_s))


def _lasting(on: Action, off: Action, seconds: float) -> Plan:
    return ((ON_S, on), (ON_S + seconds, off))


def _handed_back(after_s: float) -> Plan:
    """Plan how the safety pilot hands the vehicle back, `after_s` after the fault, if it has left the guided mode.

    The pilot chooses the holding mode, which ends a PX4's failsafe, clears the companion's lock, and chooses the guided
    mode again. A vehicle that is still in the guided mode is left alone.
    """
    at_s = ON_S + after_s
    return (
        (at_s - 3.0, _if_left(lambda flight: flight.faulty.pilot.take_over())),
        (at_s - 1.0, _if_left(lambda flight: flight.faulty.process.clear())),
        (at_s, _if_left(lambda flight: flight.faulty.pilot.give_back())),
    )


def _if_left(action: Action) -> Action:
    def act(flight: Flight) -> None:
        if not flight.guided:
            action(flight)

    return act


def _kill(flight: Flight) -> None:
    flight.faulty.process.kill()


def _start(flight: Flight) -> None:
    flight.faulty.process.start()


def _start_anew(flight: Flight) -> None:
    flight.faulty.process.start(with_state=False)


def _hang(flight: Flight) -> None:
    flight.faulty.process.hang(True)


def _go_on(flight: Flight) -> None:
    flight.faulty.process.hang(False)


def _impostor(how: str) -> Fault:
    return Fault(
        f"ground station replaced by an impostor for 16 s, frames {how}",
        _lasting(
            lambda flight: flight.broadcast.replace(how, flight.t_s),
            lambda flight: flight.broadcast.replace(None, flight.t_s),
            16.0,
        ),
        32.0,
    )


def _hour_ahead_and_restarted(flight: Flight) -> None:
    flight.faulty.process.kill()
    flight.faulty.process.step_clock(3600.0)
    flight.faulty.process.start()


def _ahead(flight: Flight, seconds: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return a place ahead, by seconds of flight on the present course, and the velocity of a vehicle coming from it.

    Both are north and east, in m and m/s.
    """
    truth, (north_m_s, east_m_s) = flight.vehicle.truth, flight.vehicle.ground_velocity_m_s
    return (truth.north_m + seconds * north_m_s, truth.east_m + seconds * east_m_s), (-north_m_s, -east_m_s)


def _meet_namesake(flight: Flight) -> None:
    """Let a vehicle that uses our agent id come towards us, from ten seconds of flight ahead."""
    began_s = flight.t_s
    (north_m, east_m), (north_m_s, east_m_s) = _ahead(flight, 10.0)
    flight.faulty.encounter.meet(
        lambda t_s: (
            (north_m + (t_s - began_s) * north_m_s, east_m + (t_s - began_s) * east_m_s),
            (north_m_s, east_m_s),
        )
    )


def _meet_echo(flight: Flight) -> None:
    """Let our own detector receive our own transponder, half a second late."""
    vehicle = flight.vehicle

    def echo(_t_s: float) -> tuple[tuple[float, float], tuple[float, float]]:
        (north_m_s, east_m_s), truth = vehicle.ground_velocity_m_s, vehicle.truth
        return (truth.north_m - 0.5 * north_m_s, truth.east_m - 0.5 * east_m_s), (north_m_s, east_m_s)

    flight.faulty.encounter.meet(echo)


def _target_outside(kind: str) -> Setting:
    """Return settings with the fence 20 s of flight ahead, the target behind it."""
    return Setting(kind, fault_mission(kind, discs=False), fence_ahead_s=20.0)


def _outside_fence(kind: str) -> Setting:
    """Return settings that begin 15 s of flight outside the fence, flying along it."""
    outside_m = 1800.0 * CRUISE_M_S[kind] / PAPER_SPEED_M_S
    return Setting(kind, fault_mission(kind), start_ned_m=(-outside_m, 0.0), heading_deg=90.0)


def _minds_ground_control(kind: str) -> Setting:
    """Return settings that `companion check` refuses: without a ground station's heartbeat the autopilot returns."""
    return Setting(
        kind, fault_mission(kind), parameters={"FS_GCS_ENABLE": 1.0, "FS_GCS_ENABL": 1.0, "FS_LONG_ACTN": 1.0}
    )


def _short_range(kind: str) -> Setting:
    return Setting(kind, fault_mission(kind), range_m=20.0 * CRUISE_M_S[kind])


def _through_child(kind: str) -> Setting:
    return Setting(kind, fault_mission(kind), child=True)


def _blow(north: float, east: float) -> Action:
    """Return the action that sets the wind to (north, east), in shares of the cruise speed."""

    def blow(flight: Flight) -> None:
        flight.vehicle.wind_m_s = (north * flight.cruise_m_s, east * flight.cruise_m_s)

    return blow


def _charge(percent: float) -> Action:
    def charge(flight: Flight) -> None:
        flight.vehicle.battery.percent = percent

    return charge


def _noise(metres: float) -> Action:
    def noise(flight: Flight) -> None:
        flight.vehicle.sensors.noise_m = metres

    return noise


FAULTS = (
    Fault("none", (), 40.0),
    Fault("companion killed, restarted after 0.8 s", _lasting(_kill, _start, 0.8) + _handed_back(8.0), 24.0),
    Fault("companion killed, restarted after 3 s", _lasting(_kill, _start, RESTART_S) + _handed_back(8.0), 24.0),
    Fault(
        "companion killed, restarted after 3 s without its state files",
        _lasting(_kill, _start_anew, RESTART_S) + _handed_back(8.0),
        24.0,
    ),
    Fault("companion hung for 0.5 s", _lasting(_hang, _go_on, 0.5), 16.0),
    Fault("companion hung for 1.9 s", _lasting(_hang, _go_on, 1.9) + _handed_back(8.0), 24.0),
    Fault(
        "companion hung for 1.9 s, a person takes over meanwhile",
        _lasting(_hang, _go_on, 1.9)
        + ((ON_S + 1.0, lambda flight: flight.faulty.pilot.take_over()),)
        + _handed_back(8.0),
        24.0,
    ),
    Fault(
        "companion hung for 1.9 s, setpoints through MAVSDK's child",
        _lasting(_hang, _go_on, 1.9) + _handed_back(8.0),
        24.0,
        setting=_through_child,
        kinds=("px4-copter",),
    ),
    Fault(
        "companion hung, killed by its watchdog after 2 s, restarted after 5 s",
        (
            (ON_S, _hang),
            (ON_S + WATCHDOG_S, _kill),
            (ON_S + WATCHDOG_S + RESTART_S, _start),
            *_handed_back(10.0),
        ),
        26.0,
    ),
    Fault(
        "autopilot rebooted in flight",
        ((ON_S, lambda flight: flight.vehicle.reboot(START_S + flight.t_s)), *_handed_back(9.0)),
        26.0,
    ),
    Fault(
        "telemetry frozen for 6 s",
        _lasting(
            lambda flight: flight.vehicle.freeze_telemetry(True),
            lambda flight: flight.vehicle.freeze_telemetry(False),
            6.0,
        )
        + _handed_back(10.0),
        26.0,
    ),
    Fault(
        "GPS lost for 6 s",
        _lasting(lambda flight: flight.vehicle.lose_gps(True), lambda flight: flight.vehicle.lose_gps(False), 6.0)
        + _handed_back(10.0),
        26.0,
    ),
    Fault("position wrong by 8 m (1 sigma, north and east) for 8 s", _lasting(_noise(8.0), _noise(0.0), 8.0), 24.0),
    Fault(
        "clock stepped by an hour for 8 s",
        _lasting(
            lambda flight: flight.faulty.process.step_clock(3600.0),
            lambda flight: flight.faulty.process.step_clock(-3600.0),
            8.0,
        ),
        24.0,
    ),
    Fault("clock stepped by an hour and the companion restarted", ((ON_S, _hour_ahead_and_restarted),), 40.0),
    Fault(
        "broadcast silent for 16 s",
        _lasting(lambda flight: flight.broadcast.silence(True), lambda flight: flight.broadcast.silence(False), 16.0),
        32.0,
    ),
    Fault("no broadcast from the beginning", ((0.0, lambda flight: flight.broadcast.silence(True)),), 40.0, on_s=0.0),
    _impostor("unsigned"),
    _impostor("of another key"),
    _impostor("replayed"),
    Fault(
        "pilot takes over, gives back at +6 s; clears and gives back at +12 s",
        (
            (ON_S, lambda flight: flight.faulty.pilot.take_over()),
            (ON_S + 6.0, lambda flight: flight.faulty.pilot.give_back()),
            *_handed_back(12.0),
        ),
        28.0,
    ),
    Fault("target outside the fence", (), 45.0, setting=_target_outside, on_s=0.0),
    Fault(
        "target outside the fence, wind of 0.4 of cruise towards it that nobody configured",
        ((ON_S, _blow(0.4, 0.0)),),
        45.0,
        setting=_target_outside,
    ),
    Fault("handed over outside the fence", (), 40.0, setting=_outside_fence, on_s=0.0),
    Fault(
        "wind of 0.4 of cruise that nobody configured for 15 s",
        _lasting(_blow(0.0, 0.4), _blow(0.0, 0.0), 15.0),
        40.0,
    ),
    Fault("battery at 20 % for 8 s", _lasting(_charge(20.0), _charge(100.0), 8.0), 26.0),
    Fault("range of 20 s of flight", (), 40.0, setting=_short_range, on_s=0.0),
    Fault(
        "NaN in telemetry for 6 s",
        _lasting(
            lambda flight: flight.vehicle.corrupt_telemetry(True),
            lambda flight: flight.vehicle.corrupt_telemetry(False),
            6.0,
        )
        + _handed_back(10.0),
        26.0,
    ),
    Fault(
        "two autopilots with one system id for 4 s",
        _lasting(
            lambda flight: flight.faulty.autopilots.join_twin(True, flight.t_s),
            lambda flight: flight.faulty.autopilots.join_twin(False, flight.t_s),
            4.0,
        )
        + _handed_back(38.0),
        54.0,
    ),
    Fault(
        "another vehicle with our agent id comes towards us",
        ((ON_S, _meet_namesake), (ON_S + 14.0, lambda flight: flight.faulty.encounter.meet(None))),
        30.0,
    ),
    Fault("our own transponder is heard back", ((ON_S, _meet_echo),), 20.0),
    Fault(
        "ground control's heartbeat lost for 8 s where the autopilot minds it",
        (
            (ON_S, lambda flight: flight.faulty.pilot.silence(True)),
            (ON_S + 8.0, lambda flight: flight.faulty.pilot.silence(False)),
            *_handed_back(12.0),
        ),
        30.0,
        setting=_minds_ground_control,
        kinds=("arducopter", "arduplane"),
    ),
)
"""The faults, in the order of the table in docs/faults.md."""


@dataclass(frozen=True)
class Dead:
    """What a vehicle does after its companion's death; times count from it, lengths over the ground from its place."""

    last_setpoint_s: float
    off_mode_s: float | None
    """When the autopilot left the guided mode; None: it did not."""
    turned_off_s: float | None
    """When its course was off by OFF_ITS_WAY_RAD, or it had stopped; None: not within AFTERMATH_S."""
    farthest_m: float
    lost_height_m: float
    speed_m_s: float
    """Speed over the ground at the end."""
    resumed_s: float | None
    """When a restarted companion began to steer, at which the other figures end; None: none did."""


def dies(
    kind: str,
    parameters: Mapping[str, float] | None = None,
    *,
    hangs: bool = False,
    child: bool = False,
    turning: bool = False,
    restarts: bool = False,
) -> Dead:
    """Fly until a companion dies at cruise speed, and return what the vehicle then does.

    It is killed or, with `hangs`, hung: in straight flight or, with `turning`, in a turn. With `child` setpoints leave
    through MAVSDK's child process; with `restarts` the process is restarted RESTART_S later. `parameters` are the
    autopilot's; None: those of DEMANDED.
    """
    target_deg = 179.0 if turning else 0.0
    mission = fault_mission(kind, target_deg=target_deg, discs=False)
    flight = Flight(Setting(kind, mission, child=child, parameters=parameters))
    if turning:
        _fly_into_a_turn(flight)
    else:
        flight.run(ON_S)
    died_s = flight.t_s
    flight.at(died_s, lambda flight: flight.faulty.process.hang(True) if hangs else flight.faulty.process.kill())
    if restarts:
        flight.at(died_s + RESTART_S, _kill).at(died_s + RESTART_S, _start)
    log = flight.run(died_s + AFTERMATH_S)
    return _dead(log, died_s)


def _fly_into_a_turn(flight: Flight) -> None:
    """Fly until the vehicle has turned by TURNED_RAD under guidance and is at 0.8 of its cruise speed or more."""
    engaged_s: float | None = None
    course_rad = 0.0
    while flight.t_s < AFTERMATH_S:
        moment = flight.run(flight.t_s + LOOP_PERIOD_S).moments[-1]
        if engaged_s is None and moment.stage is not None:
            engaged_s, course_rad = moment.t_s, moment.course_rad
        if engaged_s is not None and _apart_rad(moment.course_rad, course_rad) > TURNED_RAD:
            if moment.speed_m_s > 0.8 * flight.cruise_m_s:
                return
    raise RuntimeError(f"{flight.setting.kind} never turned")


def _dead(log: Log, died_s: float) -> Dead:
    here = log.between(died_s - LOOP_PERIOD_S, died_s)[0]
    resumed_s = log.first(lambda m: m.stage is not None, died_s)
    after = log.between(died_s, math.inf if resumed_s is None else resumed_s)
    last_s = max((m.t_s for m in after if m.setpoints), default=here.t_s)

    def first_s(holds: Callable[[Moment], bool]) -> float | None:
        return next((m.t_s - died_s for m in after if holds(m)), None)

    return Dead(
        last_setpoint_s=last_s - died_s,
        off_mode_s=first_s(lambda m: not m.guided),
        turned_off_s=first_s(
            lambda m: m.speed_m_s < STOPPED_M_S or _apart_rad(m.course_rad, here.course_rad) > OFF_ITS_WAY_RAD
        ),
        farthest_m=max(math.dist((m.north_m, m.east_m), (here.north_m, here.east_m)) for m in after),
        lost_height_m=max(0.0, here.height_m - min(m.height_m for m in after)),
        speed_m_s=after[-1].speed_m_s,
        resumed_s=None if resumed_s is None else resumed_s - died_s,
    )


def _apart_rad(first_rad: float, second_rad: float) -> float:
    return abs(math.remainder(first_rad - second_rad, math.tau))


DEAD_PARAMETERS: Mapping[str, tuple[Mapping[str, float], ...]] = {
    "arducopter": ({"GUID_TIMEOUT": 0.5}, DEMANDED["arducopter"], {"GUID_TIMEOUT": 3.0}),
    "arduplane": ({"WP_LOITER_RAD": 60.0}, {"WP_LOITER_RAD": 120.0}),
    "px4-copter": (
        {"COM_OF_LOSS_T": 0.5, "COM_OBL_RC_ACT": 5.0},
        DEMANDED["px4-copter"],
        {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 0.0},
    ),
    "px4-plane": (
        {"COM_OF_LOSS_T": 0.5, "COM_OBL_RC_ACT": 5.0},
        DEMANDED["px4-plane"],
        {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 0.0},
    ),
}
"""By kind, the sets of autopilot parameters with which a companion's death is flown. The last set of each PX4 kind is
PX4's defaults, which `companion check` refuses."""
