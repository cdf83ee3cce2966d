"""What there is to say of a mission before it is flown: every place in metres and in degrees, and the warnings."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from companion.autopilot.kinds import ARDUCOPTER, KINEMATIC
from companion.geo.local_frame import LocalFrame
from companion.guidance.settings import DEFAULT_LAW
from companion.mission.lint import first_of
from companion.mission.model import AgentSpec, Mission, PathMotion, SteadyMotion, TargetSpec, ThreatSpec, agent_height_m
from companion.mission.places import DEGREE_DECIMALS
from companion.onboard.lint.fleet import abilities_of, speeds_instead
from companion.onboard.lint.warnings import lint_flight

TURN_TOLERANCE = 0.01
"""Share by which an agent's n_max may exceed the kind's: that of a number rounded to two digits."""


@dataclass(frozen=True)
class Place:
    """One agent, target or threat, where it starts, and its numbers in words."""

    what: str
    id: int
    north_m: float
    east_m: float
    lat_deg: float
    lon_deg: float
    details: str


@dataclass(frozen=True)
class Corner:
    """One corner of the fence or of an exclusion."""

    what: str
    index: int
    north_m: float
    east_m: float
    lat_deg: float
    lon_deg: float


@dataclass(frozen=True)
class Overview:
    """A resolved mission in view."""

    mission: Mission
    seed: int
    kinds: tuple[str, ...]
    """Kinds of autopilot that it was looked at for: what is said holds for all of them."""
    places: tuple[Place, ...]
    corners: tuple[Corner, ...]
    warnings: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the content of the printed JSON."""
        return {
            "mission": self.mission.name,
            "seed": self.seed,
            "autopilots": list(self.kinds),
            "warnings": list(self.warnings),
            "origin": self.mission.origin.model_dump(),
            "places": [asdict(place) for place in self.places],
            "corners": [asdict(corner) for corner in self.corners],
        }


def overview(mission: Mission, seed: int, kind: str | None, source: str) -> Overview:
    """Return a resolved mission in view; `kind` is the autopilot that flies it, None if that is open.

    Raises:
        InputError: a guard or law cannot hold the limits of an agent.

    """
    kinds = (KINEMATIC.name, ARDUCOPTER.name) if kind is None else (kind,)
    frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
    places = [Place("agent", one.id, *_at(frame, one.position_ned_m), _agent(mission, one)) for one in mission.agents]
    places += [Place("target", one.id, *_at(frame, one.position_ned_m), _moves(one)) for one in mission.targets]
    places += [Place("threat", one.id, *_at(frame, one.position_ned_m), _threat(one)) for one in mission.threats]
    polygons = [("fence", mission.fence)] if mission.fence is not None else []
    polygons += [(f"exclusion {index + 1}", corners) for index, corners in enumerate(mission.exclusions)]
    corners = [
        Corner(what, index, *_at(frame, corner)) for what, polygon in polygons for index, corner in enumerate(polygon)
    ]
    warnings = [*_beyond(mission, kind), *lint_flight(mission, DEFAULT_LAW, kinds, source)]
    return Overview(mission, seed, kinds, tuple(places), tuple(corners), tuple(warnings))


def _at(frame: LocalFrame, place_m: tuple[float, float]) -> tuple[float, float, float, float]:
    lat_deg, lon_deg = frame.to_global(*place_m)
    return *place_m, round(lat_deg, DEGREE_DECIMALS), round(lon_deg, DEGREE_DECIMALS)


def _agent(mission: Mission, agent: AgentSpec) -> str:
    only = "" if agent.only_target is None else f", only to target {agent.only_target}"
    return (
        f"heading {agent.heading_deg:g} deg, {agent.speed_m_s:g} m/s, n_max {agent.n_max:g} g, "
        f"range {agent.range_m:g} m, height {agent_height_m(mission, agent.id):g} m{only}"
    )


def _moves(thing: TargetSpec | ThreatSpec) -> str:
    bound = f"at most {thing.speed_bound_m_s:g} m/s"
    if isinstance(thing.motion, PathMotion):
        return f"on a path of {len(thing.motion.path)} points, {bound}"
    if isinstance(thing.motion, SteadyMotion):
        return f"{thing.motion.speed_m_s:g} m/s towards {thing.motion.heading_deg:g} deg, {bound}"
    if thing.motion == "static":
        return "stands" if thing.speed_bound_m_s == 0.0 else f"stands now, {bound}"
    return f"{thing.motion}, {bound}"


def _threat(threat: ThreatSpec) -> str:
    levels = [
        f"{word} {level:g} m above sea level"
        for word, level in (("from", threat.floor_m), ("up to", threat.ceiling_m))
        if level is not None
    ]
    radii = f"R_d {threat.detection_radius_m:g} m, R_a {threat.attack_radius_m:g} m"
    return ", ".join((radii, _moves(threat), *levels))


def _beyond(mission: Mission, kind: str | None) -> list[str]:
    """Return the warnings about agents whose speed or turn the kind does not fly."""
    if kind is None:
        return []
    abilities = abilities_of(kind, ())
    speeds = [
        f"id {agent.id} has speed_m_s {agent.speed_m_s:g} m/s, but {kind} flies {allowed}: `sim fly` refuses it "
        "without --scale"
        for agent in mission.agents
        if (allowed := speeds_instead(agent.speed_m_s, abilities)) is not None
    ]
    turns = [
        f"id {agent.id} has n_max {agent.n_max:g} g, but {kind} turns with {abilities.n_max:.3g} g: the ground station "
        "reckons with tighter turns than it flies"
        for agent in mission.agents
        if agent.n_max > abilities.n_max * (1.0 + TURN_TOLERANCE)
    ]
    return [warning for warning in (first_of("agents", speeds), first_of("agents", turns)) if warning is not None]


def bounds_m(mission: Mission) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the south-west and the north-east corner, (north, east) in metres, of all that a mission holds."""
    boxes = [(agent.position_ned_m, 0.0) for agent in mission.agents]
    boxes += [(target.position_ned_m, mission.arrival_radius_m) for target in mission.targets]
    boxes += [(threat.position_ned_m, threat.detection_radius_m) for threat in mission.threats]
    boxes += [(corner, 0.0) for polygon in (mission.fence or (), *mission.exclusions) for corner in polygon]
    boxes += [
        (point[1:], 0.0)
        for thing in (*mission.targets, *mission.threats)
        if isinstance(thing.motion, PathMotion)
        for point in thing.motion.path
    ]
    low = tuple(min((at[axis] - radius for at, radius in boxes), default=0.0) for axis in (0, 1))
    high = tuple(max((at[axis] + radius for at, radius in boxes), default=0.0) for axis in (0, 1))
    return (low[0], low[1]), (high[0], high[1])


def ahead_m(place_m: tuple[float, float], heading_deg: float, length_m: float) -> tuple[float, float]:
    """Return the place that lies a length ahead of another on a heading."""
    heading_rad = math.radians(heading_deg)
    return place_m[0] + length_m * math.cos(heading_rad), place_m[1] + length_m * math.sin(heading_rad)
