"""The scenarios that real programs are flown through, as data: `SCENARIOS` is the table."""

from __future__ import annotations

import signal
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from companion.guidance.steering import loiter_radius_m
from companion.mission.model import Mission
from tests.real.config import deployed
from tests.real.kinds import KINDS, Kind
from tests.real.wire import PORT as WIRE_PORT
from tests.real.wire import Trouble

ORIGIN = {"lat_deg": -35.363261, "lon_deg": 149.165230, "alt_m": 584.0}
"""Where ArduPilot's own simulator starts, too."""
DRAWN_FOR_M_S = 8.0
"""Speed for which the places below are drawn; lengths are multiplied by a kind's speed over it."""
Figure = Literal[
    "entries",
    "breaches",
    "open_targets",
    "farthest_after_arrival_m",
    "farthest_at_the_end_m",
    "stands_after_s",
    "held_within_m",
    "last_after_told_s",
    "delivered_after_told_s",
    "gap_s",
    "height_off_m",
    "delivered_gap_s",
]
"""Figures of a flight that a scenario may bound (tests/real/score.py)."""
_STANDING: tuple[Figure, ...] = ("stands_after_s", "held_within_m", "farthest_after_arrival_m")


@dataclass(frozen=True)
class Disc:
    """A keep-out disc: its place, R_d and R_a in metres, and how it moves."""

    north_m: float
    east_m: float
    detection_m: float
    attack_m: float
    heading_deg: float = 0.0
    speed_m_s: float = 0.0


@dataclass(frozen=True)
class Scene:
    """A mission's geometry, drawn for DRAWN_FOR_M_S: agents (north, east, heading), targets (north, east), discs."""

    agents: tuple[tuple[float, float, float], ...]
    targets: tuple[tuple[float, float], ...]
    discs: tuple[Disc, ...] = ()
    arrival_radius_m: float = 20.0
    separation_m: float = 20.0


DISCS = Scene(
    agents=((0.0, 0.0, 0.0),),
    targets=((600.0, 0.0),),
    discs=(Disc(250.0, 20.0, 70.0, 35.0), Disc(450.0, -160.0, 50.0, 25.0, heading_deg=90.0, speed_m_s=2.0)),
)
STRAIGHT = Scene(agents=((0.0, 0.0, 0.0),), targets=((700.0, 0.0),))
CROSSING = Scene(
    agents=((0.0, 0.0, 0.0), (200.0, -200.0, 90.0)),
    targets=((400.0, 0.0), (200.0, 200.0)),
)
THREE = Scene(
    agents=((0.0, 0.0, 0.0), (200.0, -200.0, 90.0), (400.0, 60.0, 180.0)),
    targets=((400.0, 0.0), (200.0, 200.0), (0.0, 60.0)),
)
_LANES_M = (-100.0, -50.0, 0.0, 50.0, 100.0)
TEN = Scene(
    agents=(*((-200.0, lane, 0.0) for lane in _LANES_M), *((lane, -200.0, 90.0) for lane in _LANES_M)),
    targets=(*((200.0, lane) for lane in _LANES_M), *((lane, 200.0) for lane in _LANES_M)),
)


@dataclass(frozen=True)
class ChooseMode:
    """The person chooses a mode of `Modes`."""

    mode: Literal["wait", "guided", "return_home"]


@dataclass(frozen=True)
class Signal:
    """A signal to a program: SIGKILL, SIGSTOP or SIGCONT."""

    program: Literal["companion", "groundstation"]
    number: signal.Signals


@dataclass(frozen=True)
class StartAgain:
    """The companion is started again after it was killed."""


@dataclass(frozen=True)
class SetParameters:
    """Parameters of the autopilot's simulator change, by firmware."""

    of: Mapping[str, Mapping[str, float]]
    what: str


@dataclass(frozen=True)
class Drain:
    """The battery is nearly empty from now on."""


@dataclass(frozen=True)
class MoveHome:
    """A ground-control program sets home so far from where it was at the start."""

    north_m: float = 0.0
    east_m: float = 0.0
    up_m: float = 0.0


@dataclass(frozen=True)
class MoveOrigin(MoveHome):
    """A ground-control program sets the origin of the estimator's local frame so far from the start."""


@dataclass(frozen=True)
class LowerRates:
    """Another program on the companion's own link of the autopilot asks for no messages, or on PX4 for slow ones."""


@dataclass(frozen=True)
class Have:
    """The wire between autopilot and companion has a trouble from now on."""

    trouble: Trouble


@dataclass(frozen=True)
class Flood:
    """Junk frames come to the companion's broadcast link from now on."""

    rate_hz: float = 20_000.0


@dataclass(frozen=True)
class Ask:
    """An operator asks something of the ground station (docs/ground-station.md); places and radii are drawn."""

    command: Mapping[str, Any]

    def scaled(self, scale: float) -> dict[str, Any]:
        """Return the command with its lengths multiplied."""
        return {key: value * scale if key.endswith("_m") else value for key, value in self.command.items()}


Action = ChooseMode | Signal | StartAgain | SetParameters | Drain | MoveHome | LowerRates | Have | Flood | Ask


@dataclass(frozen=True)
class Event:
    """What happens to agent 1 some time after the hand-over."""

    after_s: float
    action: Action


@dataclass(frozen=True)
class Scenario:
    """One flight: what is flown, what happens, and which figures it must keep."""

    name: str
    shows: str
    scene: Scene
    kinds: tuple[str, ...] = tuple(KINDS)
    wind_m_s: float = 0.0
    wind_from_deg: float = 30.0
    speed_m_s: float | None = None
    """Cruise speed; None: the kind's."""
    adsb: bool = False
    """Whether each vehicle is told of the others by ADSB_VEHICLE."""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Parameters of an ArduPilot at its start, beside those of its kind."""
    stand_in: Mapping[str, float] = field(default_factory=dict)
    """The same parameters as the stand-in has them."""
    config: Mapping[str, Any] = field(default_factory=dict)
    """Keys of the companion's configuration, beside those of its kind."""
    events: tuple[Event, ...] = ()
    at_most: Mapping[Figure, float] = field(default_factory=dict)
    """Bounds of the figures of a vehicle that can stop; `bounds` has those of the others."""
    wired: bool = False
    """Whether a wire of the lane's own is between companion and autopilot (tests/real/wire.py)."""
    troubles: tuple[Trouble, ...] = ()
    """What the wire has from before the companion starts."""
    direct: bool = False
    """Whether a PX4 copter's setpoints go without MAVSDK, which does not bear a busy computer; so they do by a wire."""
    refused: bool = False
    """Whether the companion must refuse to engage: then nothing moves."""
    stays_s: float = 45.0
    """How long it is watched after the last arrival."""
    most_s: float = 150.0
    """Longest flight after the hand-over."""

    def config_of(self, kind: Kind, agent_id: int) -> dict[str, Any]:
        """Return the keys of the companion's configuration with a kind, section by section."""
        sections: list[Mapping[str, Any]] = [kind.config, self.config]
        if self.wired:
            sections.append({"autopilot": {"link": f"udpin:127.0.0.1:{WIRE_PORT + agent_id}"}})
        if kind.name == "px4-copter" and (self.wired or self.direct):
            sections.append({"autopilot": {"offboard": "direct"}})
        merged: dict[str, Any] = {}
        for section in sections:
            for key, value in section.items():
                merged[key] = merged[key] | value if key in merged and isinstance(value, Mapping) else value
        return merged

    def speed_of(self, kind: Kind) -> float:
        """Return the cruise speed with a kind."""
        return kind.speed_m_s if self.speed_m_s is None else self.speed_m_s

    def bounds(self, kind: Kind) -> dict[Figure, float]:
        """Return the bounds with a kind: a vehicle that cannot stop circles where another stands.

        Its circle is about a place within the arrival radius.
        """
        if kind.can_stop or "stands_after_s" not in self.at_most:
            return dict(self.at_most)
        mission = self.mission(kind)
        agent = mission.agents[0]
        radius_m = loiter_radius_m(agent.speed_m_s, agent.n_max, mission.guidance_step_s, self.wind_m_s)
        others = {figure: bound for figure, bound in self.at_most.items() if figure not in _STANDING}
        return {**others, "farthest_at_the_end_m": mission.arrival_radius_m + radius_m}

    def stand_in_parameters(self, kind: Kind) -> dict[str, float]:
        """Return the parameters that make a stand-in fly as the kind does in this scenario."""
        return {**kind.stand_in, **self.stand_in}

    def stays_after_s(self, kind: Kind) -> float:
        """Return how long it is watched after the last arrival: a plane finds to its circle more slowly."""
        return self.stays_s if kind.can_stop else self.stays_s + 30.0

    def mission(self, kind: Kind) -> Mission:
        """Return the mission as a kind flies it."""
        speed_m_s = self.speed_of(kind)
        scale = kind.speed_m_s / DRAWN_FOR_M_S
        limits = deployed(kind)["limits"]
        agent = {
            "speed_m_s": speed_m_s,
            "n_max": limits["n_max"],
            "range_m": limits["range_m"],
            "height_m": kind.height_m,
        }
        return Mission.model_validate(
            {
                "name": f"{self.name}-{kind.name}",
                "origin": ORIGIN,
                "agents": [
                    {"id": number, "north_m": north * scale, "east_m": east * scale, "heading_deg": heading, **agent}
                    | {"only_target": number}
                    for number, (north, east, heading) in enumerate(self.scene.agents, start=1)
                ],
                "targets": [
                    {"id": number, "north_m": north * scale, "east_m": east * scale, "speed_bound_m_s": 0}
                    for number, (north, east) in enumerate(self.scene.targets, start=1)
                ],
                "threats": [_threat(number, disc, scale) for number, disc in enumerate(self.scene.discs, start=1)],
                "arrival_radius_m": self.scene.arrival_radius_m * scale,
                "separation_m": self.scene.separation_m * scale,
                "detector": "adsb" if self.adsb else "broadcast",
                "detector_range_m": 500.0 * scale,
                "wind": {"from_deg": self.wind_from_deg, "speed_m_s": self.wind_m_s},
                "guidance_step_s": 0.5,
                "integration_step_s": 0.1,
                "broadcast_period_s": 1.0,
                "assignment_period_s": 5.0,
                "max_time_s": 600.0,
            }
        )


def _threat(number: int, disc: Disc, scale: float) -> dict[str, Any]:
    moving = {"motion": {"heading_deg": disc.heading_deg, "speed_m_s": disc.speed_m_s * scale}}
    return {
        "id": number,
        "north_m": disc.north_m * scale,
        "east_m": disc.east_m * scale,
        "detection_radius_m": disc.detection_m * scale,
        "attack_radius_m": disc.attack_m * scale,
        "speed_bound_m_s": disc.speed_m_s * scale,
        **(moving if disc.speed_m_s else {}),
    }


COPTERS = ("arducopter", "px4-copter", "px4-copter-low-drag")
FOUR = ("arducopter", "arduplane", "px4-copter-low-drag", "px4-plane")
SAFE: dict[Figure, float] = {"entries": 0, "breaches": 0}
ARRIVES: dict[Figure, float] = {**SAFE, "open_targets": 0, "gap_s": 0.5}
HOLDS: dict[Figure, float] = {
    **ARRIVES,
    "farthest_after_arrival_m": 25.0,
    "stands_after_s": 15.0,
    "held_within_m": 3.0,
}
UNDISTURBED: dict[Figure, float] = {**ARRIVES, "delivered_gap_s": 0.5}
TAKEN_OVER: dict[Figure, float] = {**SAFE, "delivered_gap_s": 0.5, "delivered_after_told_s": 0.25}
LEVEL: dict[Figure, float] = {**SAFE, "height_off_m": 5.0}
"""Whatever a height is counted from moves, the vehicle does not."""
_GPS_LOST = SetParameters({"ArduPilot": {"SIM_GPS1_ENABLE": 0}, "PX4": {"SIM_GPS_USED": 0}}, "GPS lost")
_GPS_BACK = SetParameters({"ArduPilot": {"SIM_GPS1_ENABLE": 1}, "PX4": {"SIM_GPS_USED": 10}}, "GPS back")
_LEAN_45 = {"ANGLE_MAX": 4500, "ATC_ANGLE_MAX": 45}
"""Under both names (docs/autopilots.md): the one that the firmware does not have is passed over."""
_SOON_STALE = {"staleness": {"coasting_after_s": 3, "loitering_after_s": 8, "blind_after_s": 120}}
SCENARIOS: tuple[Scenario, ...] = (
    Scenario("discs", "around a standing and a moving disc, arrival and hold, still air", DISCS, at_most=HOLDS),
    Scenario("wind-3", "the same in wind of 3 m/s", DISCS, ("arducopter", "px4-copter-low-drag"), 3.0,
             speed_m_s=7.0, at_most=HOLDS),
    Scenario("wind-5", "wind of 5 m/s, at a speed that 30 degrees of lean reach", DISCS, COPTERS[:1], 5.0,
             speed_m_s=5.3, at_most=HOLDS, most_s=240.0),
    Scenario("wind-5-lean-45", "wind of 5 m/s at 8 m/s, 45 degrees of lean", DISCS, COPTERS[:1], 5.0,
             parameters=_LEAN_45, stand_in={"ANGLE_MAX": 4500}, at_most=HOLDS, most_s=240.0),
    Scenario("wind-5-px4", "wind of 5 m/s", DISCS, ("px4-copter-low-drag",), 5.0, speed_m_s=7.0, at_most=HOLDS,
             most_s=240.0),
    Scenario("wind-5-beyond", "wind of 5 m/s at 8 m/s, which 30 degrees of lean do not reach: refused", DISCS,
             COPTERS[:1], 5.0, at_most=SAFE, refused=True, most_s=40.0),
    Scenario("wind-7", "wind of 7 m/s, 45 degrees of lean on the copter", DISCS, ("arducopter",), 7.0, speed_m_s=7.5,
             parameters=_LEAN_45, stand_in={"ANGLE_MAX": 4500}, at_most=HOLDS, most_s=240.0),
    Scenario("wind-7-others", "wind of 7 m/s", DISCS, ("px4-copter-low-drag", "arduplane", "px4-plane"), 7.0,
             at_most=HOLDS, most_s=240.0),
    Scenario("crossing", "two cross at right angles; all that they know of each other is what is broadcast", CROSSING,
             at_most=HOLDS, most_s=240.0),
    Scenario("crossing-adsb", "the same, each told of the other by ADSB_VEHICLE", CROSSING, adsb=True,
             parameters={"ADSB_TYPE": 1}, at_most=HOLDS),
    Scenario("three-crossing", "three cross, by what is broadcast", THREE, at_most=HOLDS, most_s=240.0),
    Scenario("ten-crossing", "two streams of five cross, 50 m apart, by what is broadcast", TEN, COPTERS[:1],
             at_most=HOLDS, most_s=240.0),
    Scenario("person", "a person takes it over, gives it back, and sends it home",
             STRAIGHT, events=(Event(15.0, ChooseMode("wait")), Event(25.0, ChooseMode("guided")),
                               Event(40.0, ChooseMode("return_home"))),
             at_most={**SAFE, "last_after_told_s": 0.2}, most_s=55.0),
    Scenario("killed", "kill -9 of the companion", STRAIGHT,
             events=(Event(20.0, Signal("companion", signal.SIGKILL)),), at_most=SAFE, most_s=45.0),
    Scenario("restarted", "kill -9 of the companion, started again after 3 s", STRAIGHT,
             events=(Event(20.0, Signal("companion", signal.SIGKILL)), Event(23.0, StartAgain())), at_most=SAFE,
             most_s=60.0),
    Scenario("hung", "the companion hangs (SIGSTOP)", STRAIGHT,
             events=(Event(20.0, Signal("companion", signal.SIGSTOP)),), at_most=SAFE, most_s=45.0),
    Scenario("silence", "no broadcast for 25 s", STRAIGHT, config=_SOON_STALE,
             events=(Event(15.0, Signal("groundstation", signal.SIGSTOP)),
                     Event(40.0, Signal("groundstation", signal.SIGCONT))), at_most=ARRIVES, most_s=150.0),
    Scenario("gps", "GPS lost for 15 s", STRAIGHT, events=(Event(20.0, _GPS_LOST), Event(35.0, _GPS_BACK)),
             at_most=SAFE, most_s=70.0),
    Scenario("battery", "the battery is nearly empty", STRAIGHT, events=(Event(20.0, Drain()),), at_most=SAFE,
             most_s=70.0),
    Scenario("home-lower", "home is set 560 m lower in flight, and the vehicle is handed over once more", STRAIGHT,
             FOUR, events=(Event(15.0, MoveHome(up_m=-560.0)), Event(35.0, ChooseMode("wait")),
                     Event(39.0, ChooseMode("guided"))), at_most=LEVEL, most_s=60.0, direct=True),
    Scenario("home-higher", "home is set 560 m higher in flight, and the vehicle is handed over once more", STRAIGHT,
             FOUR, events=(Event(15.0, MoveHome(up_m=560.0)), Event(35.0, ChooseMode("wait")),
                     Event(39.0, ChooseMode("guided"))), at_most=LEVEL, most_s=60.0, direct=True),
    Scenario("home-elsewhere", "home is set 700 m to the north-east in flight", STRAIGHT, FOUR,
             events=(Event(15.0, MoveHome(500.0, 500.0)),), at_most=LEVEL, most_s=60.0, direct=True),
    Scenario("origin", "the estimator's origin is set 300 m north and 560 m higher in flight", STRAIGHT,
             FOUR[2:], events=(Event(15.0, MoveOrigin(north_m=300.0, up_m=560.0)),), at_most=LEVEL, most_s=60.0,
             direct=True),
    Scenario("two-gps", "the first of two GPS receivers dies, and the autopilot flies on", STRAIGHT,
             FOUR[:2], parameters={"SIM_GPS2_ENABLE": 1, "GPS2_TYPE": 1}, wired=True,
             events=(Event(15.0, _GPS_LOST),), at_most=UNDISTURBED),
    Scenario("rates", "another program on its link stops or slows all messages, and once more 30 s later", STRAIGHT,
             FOUR, wired=True, events=(Event(10.0, LowerRates()), Event(40.0, LowerRates())), at_most=ARRIVES),
    Scenario("stranger", "a stranger sends one byte 50 times a second to the companion's port", STRAIGHT, FOUR,
             wired=True, events=(Event(5.0, Have("stranger")),), at_most=UNDISTURBED),
    Scenario("copies", "every frame of the autopilot comes again, 0.1 to 5 s late; then a person takes it over",
             STRAIGHT, FOUR, wired=True, events=(Event(5.0, Have("copies")), Event(30.0, ChooseMode("wait"))),
             at_most=TAKEN_OVER, most_s=50.0),
    Scenario("impostors", "HEARTBEATs of a router, another vehicle and a script that calls itself 1/1 from the start; "
             "then a person takes it over", STRAIGHT, FOUR, wired=True,
             troubles=("impostors",), events=(Event(30.0, ChooseMode("wait")),), at_most=TAKEN_OVER, most_s=45.0),
    Scenario("flood", "20 000 junk frames a second on the broadcast link, and a person takes it over", STRAIGHT,
             FOUR, wired=True, events=(Event(10.0, Flood()), Event(30.0, ChooseMode("wait"))), at_most=TAKEN_OVER,
             most_s=45.0),
    Scenario("asked", "an operator drops a disc on the route, then holds the agent alone for 12 s",
             STRAIGHT, events=(
                 Event(8.0, Ask({"do": "add-threat", "id": 9, "north_m": 380.0, "east_m": 15.0,
                                 "detection_radius_m": 70.0, "attack_radius_m": 35.0})),
                 Event(20.0, Ask({"do": "direct", "directive": "hold", "agent": 1})),
                 Event(32.0, Ask({"do": "direct", "directive": "normal", "agent": 1}))),
             at_most=HOLDS, most_s=180.0),
)  # fmt: skip
"""What is flown. Places, speeds and radii are for copters, and larger for planes by their speed."""
