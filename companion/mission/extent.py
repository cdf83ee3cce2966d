"""The extent of a mission: the box and the greatest radius that the grid of its broadcast has room for.

The grid is fixed by it for all frames of a revision (docs/wire.md), not by what is in one frame.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from companion.geo.kinematics import GRAVITY_M_S2
from companion.mission.model import AgentSpec, Mission

FARTHEST_M = 2.0e7
"""Greatest distance from the origin along each axis that an extent reaches, along the ground: half the way round the
Earth, which any frame can carry."""
WHOLE_PLANE_M = 4.1e7
"""Radius up to which discs grow: such a disc contains the whole Earth wherever its centre is, and fits a frame."""
REACH_S = 600.0
"""Time for which there is room for what moves and for radii that grow, unless the mission ends before."""
AGENT_REACH_S = 30.0
"""Time for which there is room for an agent that flies outwards, beside two of its turning circles."""
WIDER = 2.0
"""Least factor by which a side or radius grows that has become too small, so that it grows a few times at most."""

Point = tuple[float, float]
"""North and east in m."""


@dataclass(frozen=True)
class Extent:
    """The box of positions (north, east) and the greatest radius, in m, that a grid has room for."""

    low_ned_m: Point
    high_ned_m: Point
    radius_m: float

    def holds(self, point: Point) -> bool:
        """Return whether a position is in the box."""
        return all(
            low <= along <= high for low, along, high in zip(self.low_ned_m, point, self.high_ned_m, strict=True)
        )

    def widened(self, points: Iterable[Point], radius_m: float) -> Extent:
        """Return an extent that holds positions and a radius as well; each side that is too near moves far out."""
        lows, highs, greatest_m = list(self.low_ned_m), list(self.high_ned_m), self.radius_m
        for point in points:
            for axis, along in enumerate(point):
                span_m = highs[axis] - lows[axis]
                if along < lows[axis]:
                    lows[axis] = max(-FARTHEST_M, min(along, highs[axis] - WIDER * span_m))
                elif along > highs[axis]:
                    highs[axis] = min(FARTHEST_M, max(along, lows[axis] + WIDER * span_m))
        if radius_m > greatest_m:
            greatest_m = min(WHOLE_PLANE_M, max(radius_m, WIDER * greatest_m))
        return Extent((lows[0], lows[1]), (highs[0], highs[1]), greatest_m)


def mission_extent(mission: Mission) -> Extent:
    """Return the extent of a resolved mission: where everything stands, and can get to for a while.

    In Case II no position of an agent is told, so that none needs room, unless a source of the mission sees agents.
    """
    reach_s = min(REACH_S, mission.max_time_s)
    things = (*mission.targets, *mission.threats)
    boxes: list[tuple[Point, float]] = [(thing.position_ned_m, thing.speed_bound_m_s * reach_s) for thing in things]
    if mission.case == "I" or any(source.things == "agents" for source in mission.sources):
        agents_m = max(map(_agent_reach_m, mission.agents), default=0.0)
        boxes += [(agent.position_ned_m, agents_m) for agent in mission.agents]
        boxes += [(target.position_ned_m, agents_m) for target in mission.targets]
        # Agents fly round the discs, and inside the fence.
        boxes += [(threat.position_ned_m, threat.detection_radius_m) for threat in mission.threats]
        boxes += [(vertex, 0.0) for vertex in mission.fence or ()]
    boxes = boxes or [((0.0, 0.0), 0.0)]
    north_m, east_m = (
        (min(point[axis] - reach_m for point, reach_m in boxes), max(point[axis] + reach_m for point, reach_m in boxes))
        for axis in (0, 1)
    )
    grown_m = (threat.detection_radius_m + threat.speed_bound_m_s * reach_s for threat in mission.threats)
    return Extent(
        (max(-FARTHEST_M, north_m[0]), max(-FARTHEST_M, east_m[0])),
        (min(FARTHEST_M, north_m[1]), min(FARTHEST_M, east_m[1])),
        min(WHOLE_PLANE_M, max(grown_m, default=0.0)),
    )


def _agent_reach_m(agent: AgentSpec) -> float:
    turn_radius_m = agent.speed_m_s**2 / (agent.n_max * GRAVITY_M_S2)
    return 4.0 * turn_radius_m + AGENT_REACH_S * agent.speed_m_s
