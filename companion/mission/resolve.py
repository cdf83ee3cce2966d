"""Drawing from a seed what a mission leaves to chance, and checking that its start is legal.

A mission may give counts under `draw` and leave out positions and headings. `resolve` draws them from a seed and lists
everything; the same mission and seed give the same result, whatever else uses the seed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from companion.errors import InputError
from companion.geo.polygon import inside_polygon
from companion.mission.model import AgentSpec, Defaults, Draw, Mission, PathMotion, TargetSpec, ThreatSpec, is_obstacle
from companion.mission.random_streams import random_stream

DRAW_CLEARANCE = 0.5
"""Clearance that drawn agents and targets keep from every detection disc, as a fraction of R_d. Within about 0.1 R_d
(pairwise; 0.2 analytic) the repulsion of F* outweighs the attraction, so that a nearer target could not be approached;
the rest leaves room for target and threat to move towards each other, a kilometre or two in a flight of the paper's
length."""
DRAW_TRIES = 10_000
"""Greatest number of places drawn for one item before `resolve` gives up."""
DRAW_DECIMALS = 1
"""Decimals of drawn positions (metres) and headings (degrees), few enough that the resolved file reads well."""
DRAW_STREAM = 1
"""Number of the seed's random stream that `resolve` draws from. Motion, link and the rest use others, so that a
resolved mission that is flown again with the same seed repeats the flight."""

SpecT = TypeVar("SpecT", AgentSpec, TargetSpec, ThreatSpec)


def resolve(mission: Mission, seed: int, source: str | None = None) -> Mission:
    """Draw from the seed what a mission leaves to chance; return it with everything listed. Errors name `source`.

    Targets and agents are drawn inside the area and the fence, outside the exclusions, more than DRAW_CLEARANCE·R_d
    outside every detection disc, and agents also at least two separations apart. Threats are drawn inside the area,
    with the same clearance from the listed agents and targets. The result depends on nothing but mission and seed.

    Raises:
        InputError: no legal place was found, or a listed start is illegal.

    """
    name = source or mission.name
    # One stream for all: what is drawn first decides what is drawn after it.
    drawing = _Drawing(mission, random_stream(seed, DRAW_STREAM), name)
    threats = _placed_threats(drawing)
    discs = np.array([(*t.position_ned_m, t.detection_radius_m * (1 + DRAW_CLEARANCE)) for t in threats])
    discs = discs.reshape(-1, 3)
    targets = _placed_targets(drawing, discs)
    agents = _placed_agents(drawing, discs)
    resolved = mission.model_copy(
        update={"agents": agents, "targets": targets, "threats": threats, "draw": Draw(), "defaults": Defaults()}
    )
    check_start(resolved, name)
    return resolved


def check_start(mission: Mission, source: str) -> None:
    """Raise InputError if a resolved mission starts illegally.

    Illegal are: an agent or target inside an attack radius, outside the fence or inside an exclusion, two agents closer
    than the separation, and a loss of an agent that does not exist.
    """
    starts: list[tuple[str, AgentSpec | TargetSpec]] = []
    starts += [(f"agents[{index}]", agent) for index, agent in enumerate(mission.agents)]
    starts += [(f"targets[{index}]", target) for index, target in enumerate(mission.targets)]
    for key, item in starts:
        _check_place(mission, f"{source}: {key}", item)
    _check_separation(mission, source)
    known = [agent.id for agent in mission.agents]
    for index, loss in enumerate(mission.losses):
        if loss.agent not in known:
            raise InputError(
                f"{source}: losses[{index}].agent: {loss.agent}; allowed: one of {', '.join(map(str, known))}"
            )


def _check_place(mission: Mission, where: str, item: AgentSpec | TargetSpec) -> None:
    """Raise InputError if an item starts outside the fence, inside an exclusion or inside an attack radius.

    For an agent only threats that reach its height count.
    """
    for threat in mission.threats:
        distance_m = math.dist(item.position_ned_m, threat.position_ned_m)
        if isinstance(item, AgentSpec) and not is_obstacle(mission, item.id, threat):
            continue
        if distance_m <= threat.attack_radius_m:
            raise InputError(
                f"{where}: id {item.id} starts {distance_m:.1f} m from threat {threat.id}; "
                f"allowed: outside its attack_radius_m {threat.attack_radius_m:g} m"
            )
    if mission.fence is not None and not inside_polygon(item.position_ned_m, mission.fence):
        raise InputError(f"{where}: id {item.id} starts at {_shown(item)}; allowed: inside the fence")
    for index, exclusion in enumerate(mission.exclusions):
        if inside_polygon(item.position_ned_m, exclusion):
            raise InputError(f"{where}: id {item.id} starts at {_shown(item)}; allowed: outside exclusions[{index}]")


def _shown(item: AgentSpec | TargetSpec) -> str:
    north_m, east_m = item.position_ned_m
    # No "-0 m", as a rounded number may be.
    return f"{north_m + 0.0:.7g} m north, {east_m + 0.0:.7g} m east of the origin"


def _check_separation(mission: Mission, source: str) -> None:
    """Raise InputError if two agents start closer than the separation."""
    positions_ned_m = [agent.position_ned_m for agent in mission.agents]
    for index, position in enumerate(positions_ned_m):
        for other in range(index):
            distance_m = math.dist(position, positions_ned_m[other])
            if distance_m < mission.separation_m:
                raise InputError(
                    f"{source}: agents[{index}]: id {mission.agents[index].id} starts {distance_m:.1f} m from agent "
                    f"{mission.agents[other].id}; allowed: at least separation_m {mission.separation_m:g} m"
                )


@dataclass(frozen=True)
class _Drawing:
    """The mission and the random generator that all draws of one `resolve` share."""

    mission: Mission
    generator: np.random.Generator
    name: str
    """Name of the mission in errors."""

    def point(self) -> tuple[float, float]:
        """Draw a point (north, east) of the area, in metres."""
        area_m = self.mission.area_m
        north_m, east_m = self.generator.uniform((0.0, 0.0), (area_m.north, area_m.east))
        return round(float(north_m), DRAW_DECIMALS), round(float(east_m), DRAW_DECIMALS)

    def heading_deg(self) -> float:
        """Draw a heading from 0 to 360 degrees."""
        return round(float(self.generator.uniform(0.0, 360.0)), DRAW_DECIMALS)


def _placed_threats(drawing: _Drawing) -> tuple[ThreatSpec, ...]:
    """Return all threats; one without a place starts where its path does, or is drawn clear of the listed items."""
    mission = drawing.mission
    given = mission.defaults.threat.model_dump(exclude_none=True)
    threats = [*mission.threats]
    threats += [ThreatSpec(id=identity, **given) for identity in _free_ids(mission.threats, mission.draw.threats)]
    listed: list[AgentSpec | TargetSpec] = [*mission.agents, *mission.targets]
    listed_ned_m = np.array([item.position_ned_m for item in listed if _is_placed(item)]).reshape(-1, 2)
    return tuple(
        threat
        if _is_placed(threat)
        else _placed_at(threat, _path_start(threat) or _threat_point(drawing, threat, listed_ned_m))
        for threat in threats
    )


def _placed_targets(drawing: _Drawing, discs: np.ndarray) -> tuple[TargetSpec, ...]:
    """Return all targets; one without a place starts where its path does, or is drawn clear of the discs.

    `discs` (M, 3): north, east and radius to keep clear of, in metres.
    """
    mission = drawing.mission
    given = mission.defaults.target.model_dump(exclude_none=True)
    targets = [*mission.targets]
    targets += [TargetSpec(id=identity, **given) for identity in _free_ids(mission.targets, mission.draw.targets)]
    nobody_ned_m = np.empty((0, 2))
    return tuple(
        target
        if _is_placed(target)
        else _placed_at(
            target, _path_start(target) or _legal_point(drawing, discs, nobody_ned_m, f"target {target.id}")
        )
        for target in targets
    )


def _placed_agents(drawing: _Drawing, discs: np.ndarray) -> tuple[AgentSpec, ...]:
    """Return all agents; places and headings that are not given are drawn.

    `discs` (M, 3): north, east and radius to keep clear of, in metres.
    """
    mission = drawing.mission
    given = mission.defaults.agent.model_dump(exclude_none=True)
    agents = [*mission.agents]
    agents += [AgentSpec(id=identity, **given) for identity in _free_ids(mission.agents, mission.draw.agents)]
    taken = [agent.position_ned_m for agent in agents if _is_placed(agent)]
    placed_agents = []
    for agent in agents:
        placed = agent
        if not _is_placed(agent):
            point = _legal_point(drawing, discs, np.array(taken).reshape(-1, 2), f"agent {agent.id}")
            placed = _placed_at(agent, point)
            taken.append(point)
        if placed.heading_deg is None:
            placed = placed.model_copy(update={"heading_deg": drawing.heading_deg()})
        placed_agents.append(placed)
    return tuple(placed_agents)


def _free_ids(listed: Sequence[AgentSpec | TargetSpec | ThreatSpec], count: int) -> list[int]:
    used = {item.id for item in listed}
    return [identity for identity in range(1, len(used) + count + 1) if identity not in used][:count]


def _is_placed(item: AgentSpec | TargetSpec | ThreatSpec) -> bool:
    return item.north_m is not None and item.east_m is not None


def _placed_at(item: SpecT, point: tuple[float, float]) -> SpecT:
    return item.model_copy(update={"north_m": point[0], "east_m": point[1]})


def _path_start(item: TargetSpec | ThreatSpec) -> tuple[float, float] | None:
    return item.motion.path[0][1:] if isinstance(item.motion, PathMotion) else None


def _threat_point(
    drawing: _Drawing,
    threat: ThreatSpec,
    listed_ned_m: np.ndarray,  # (L, 2) m, agents and targets whose places are given
) -> tuple[float, float]:
    for _ in range(DRAW_TRIES):
        point = drawing.point()
        apart_m = np.hypot(listed_ned_m[:, 0] - point[0], listed_ned_m[:, 1] - point[1])
        if np.all(apart_m > threat.detection_radius_m * (1 + DRAW_CLEARANCE)):
            return point
    raise InputError(
        f"{drawing.name}: threat {threat.id}: no legal start in {DRAW_TRIES} draws; allowed: an area_m with room clear "
        "of the listed agents and targets"
    )


def _legal_point(
    drawing: _Drawing,
    discs: np.ndarray,  # (M, 3) north, east, radius to keep clear of
    others_ned_m: np.ndarray,  # (P, 2) agents already placed
    subject: str,
) -> tuple[float, float]:
    mission = drawing.mission
    for _ in range(DRAW_TRIES):
        point = drawing.point()
        if mission.fence is not None and not inside_polygon(point, mission.fence):
            continue
        if any(inside_polygon(point, exclusion) for exclusion in mission.exclusions):
            continue
        if np.any(np.hypot(discs[:, 0] - point[0], discs[:, 1] - point[1]) <= discs[:, 2]):
            continue
        apart_m = np.hypot(others_ned_m[:, 0] - point[0], others_ned_m[:, 1] - point[1])
        if np.all(apart_m >= 2 * mission.separation_m):
            return point
    raise InputError(
        f"{drawing.name}: {subject}: no legal start in {DRAW_TRIES} draws; allowed: an area_m with room inside the "
        "fence, outside the exclusions, clear of the detection discs and apart from the other agents"
    )
