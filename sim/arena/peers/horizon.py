"""Receding-horizon planning: BIT* (Gammell, Srinivasa & Barfoot 2015, ICRA) of OMPL, repeated every two seconds.

The planner knows the whole path to the target, as our route does, but searches for it by sampling the plane; its plan
ignores the turn limit. Between plans the vehicle heads for the farthest point of the last plan in its line of sight.
"""

from __future__ import annotations

import importlib
import itertools
import math
from collections.abc import Callable, Sequence
from types import ModuleType

import numpy as np

from companion.errors import InputError
from companion.guard.types import Motion
from companion.guidance.laws import SteeringDemand, Task
from companion.guidance.settings import LawSettings
from companion.guidance.view import View
from sim.arena.peers.surroundings import (
    Discs,
    discs_foreseen,
    distances_m,
    goal_of,
    heading_for,
    ray_margins_m,
    scale_of,
)

REPLAN_S = 2.0
"""Time between two plans."""
ITERATIONS = 3000
"""Iterations of BIT* for one plan: 23 to 76 ms with 14 to 60 discs. A budget in iterations gives the same plan on every
machine."""
CLEARANCE_TURN_RADII = 0.1
"""Distance in turn radii that the plan keeps from the discs beyond the common margin, because the vehicle cannot turn
at its corners."""
NEAR_SHARE = 0.999
"""Greatest radius of a disc in a plan, as a share of the distance from the vehicle to the disc's centre, so that the
vehicle is never inside."""
BOX_SHARE = 1.5
"""Distance by which the sampled box reaches beyond vehicle, target and centres of discs, in radii of the largest
disc."""
SEED = 1


class RecedingHorizon:
    """Plans a path every REPLAN_S and follows it; the sampler is seeded, so that equal inputs give equal plans."""

    def __init__(
        self, settings: LawSettings, clearance_turn_radii: float = CLEARANCE_TURN_RADII, iterations: int = ITERATIONS
    ) -> None:
        self._planner = BatchPlanner(iterations)
        self._scale = scale_of(settings)
        self._clearance_m = clearance_turn_radii * self._scale.turn_radius_m
        self._way_ned_m = np.zeros((0, 2))
        self._planned_at_s = -math.inf
        self._planned_for: tuple[float, float] | None = None
        self._plans = 0

    def steer(self, task: Task, motion: Motion, view: View, now_s: float) -> SteeringDemand:
        """Return the steering demand of this method, as SteeringLaw defines it."""
        if task.loitering:
            # It may be loitering for want of a plan: that is no reason to plan more often.
            return SteeringDemand(task.pull)
        discs = discs_foreseen(view, motion, self._scale)
        if task.place_ned_m != self._planned_for:
            self._way_ned_m, self._planned_at_s, self._planned_for = np.zeros((0, 2)), -math.inf, task.place_ned_m
        if now_s - self._planned_at_s >= REPLAN_S - 1e-6:
            self._plan(task, motion, discs)
            self._planned_at_s = now_s
        if not len(self._way_ned_m):
            return SteeringDemand(task.pull, stay="no plan")
        return SteeringDemand(heading_for(self._follow(motion, discs), goal_of(task, motion)[0]))

    def _plan(self, task: Task, motion: Motion, discs: Discs) -> None:
        """Plan from the vehicle's position; keep the last plan where no new one is found."""
        swept = self._swept(discs)
        apart_m = distances_m(swept, motion.position_ned_m)[1]
        radius_m = np.minimum(swept.radius_m + self._clearance_m, NEAR_SHARE * apart_m)
        self._plans += 1
        to_place_m = distances_m(swept, task.place_ned_m)[1]
        if np.any(to_place_m < radius_m):
            return  # no way can end there, and the planner would spend its whole budget to find none
        way_ned_m = self._planner.plan(
            motion.position_ned_m, task.place_ned_m, swept.centres_ned_m, radius_m, SEED + self._plans
        )
        if len(way_ned_m):
            self._way_ned_m = way_ned_m

    def _swept(self, discs: Discs) -> Discs:
        """Return the discs, and a second time those that move, where they will be when the vehicle has passed them.

        Each disc is enlarged by the distance that it may move before the next plan.
        """
        moving = discs.velocity_m_s.any(axis=1)
        radius_m = discs.radius_m + REPLAN_S * np.hypot(discs.velocity_m_s[:, 0], discs.velocity_m_s[:, 1])
        passing_s = 2.0 * discs.radius_m[moving] / self._scale.speed_m_s
        later_ned_m = discs.centres_ned_m[moving] + discs.velocity_m_s[moving] * passing_s[:, np.newaxis]
        return Discs(
            centres_ned_m=np.concatenate((discs.centres_ned_m, later_ned_m)),
            radius_m=np.concatenate((radius_m, radius_m[moving])),
            velocity_m_s=np.concatenate((discs.velocity_m_s, discs.velocity_m_s[moving])),
            threats=discs.threats,
        )

    def _follow(self, motion: Motion, discs: Discs) -> float:
        """Return the heading of the farthest visible point of the path, and drop the points before it."""
        here_m = np.broadcast_to(np.array(motion.position_ned_m), self._way_ned_m.shape)
        visible = np.flatnonzero(ray_margins_m(discs, here_m, self._way_ned_m) >= 0.0)
        if visible.size:
            self._way_ned_m = self._way_ned_m[visible[-1] :]
        elif len(self._way_ned_m) > 1 and math.dist(motion.position_ned_m, self._way_ned_m[0]) <= self._scale.step_m:
            self._way_ned_m = self._way_ned_m[1:]
        north_m, east_m = self._way_ned_m[0] - motion.position_ned_m
        return math.atan2(east_m, north_m)


def check_installed() -> None:
    """Raise InputError if OMPL, the library that plans, is not installed."""
    _ompl("base")


def _ompl(part: str) -> ModuleType:
    try:
        return importlib.import_module(f"ompl.{part}")
    except ImportError as error:
        raise InputError("horizon: needs the library OMPL; install '.[arena]'") from error


class BatchPlanner:
    """BIT* in the plane, with an exact test of straight motions against discs."""

    def __init__(self, iterations: int) -> None:
        """Load OMPL.

        Raises:
            InputError: the library is not installed.

        """
        self._base, self._geometric, self._util = _ompl("base"), _ompl("geometric"), _ompl("util")
        self._iterations = iterations

    def plan(
        self,
        start_ned_m: tuple[float, float],
        goal_ned_m: tuple[float, float],
        centres_ned_m: np.ndarray,  # (D, 2) m
        radius_m: np.ndarray,  # (D,) m
        seed: int,
    ) -> np.ndarray:  # (W, 2) m
        """Return the corners of the path after the start, the goal last; no corners if no path was found."""
        discs = [(*centre, radius**2) for centre, radius in zip(centres_ned_m.tolist(), radius_m.tolist(), strict=True)]
        if not _clear(discs, *goal_ned_m, *goal_ned_m):
            return np.zeros((0, 2))
        if _clear(discs, *start_ned_m, *goal_ned_m):
            return np.array([goal_ned_m])
        # OMPL warns that a seed comes late when it is not the first; it takes it all the same.
        level = self._util.getLogLevel()
        self._util.setLogLevel(self._util.LOG_NONE)
        try:
            self._util.RNG.setSeed(seed)
            return self._search(start_ned_m, goal_ned_m, centres_ned_m, radius_m, discs)
        finally:
            self._util.setLogLevel(level)

    def _search(
        self,
        start_ned_m: tuple[float, float],
        goal_ned_m: tuple[float, float],
        centres_ned_m: np.ndarray,
        radius_m: np.ndarray,
        discs: list[tuple[float, float, float]],
    ) -> np.ndarray:
        space = self._base.RealVectorStateSpace(2)
        space.setBounds(self._box(np.vstack((start_ned_m, goal_ned_m, centres_ned_m)), float(radius_m.max())))
        information = self._base.SpaceInformation(space)
        information.setStateValidityChecker(lambda state: _clear(discs, state[0], state[1], state[0], state[1]))
        validator = _motion_validator(self._base)(information, discs)
        information.setMotionValidator(validator)
        information.setup()
        problem = self._base.ProblemDefinition(information)
        ends = []
        for place in (start_ned_m, goal_ned_m):
            state = information.allocState()
            state[0], state[1] = place
            ends.append(state)
        problem.setStartAndGoalStates(*ends)
        problem.setOptimizationObjective(self._base.PathLengthOptimizationObjective(information))
        planner = self._geometric.BITstar(information)
        planner.setProblemDefinition(problem)
        planner.setup()
        asked = itertools.count(1)
        planner.solve(self._base.PlannerTerminationCondition(lambda: next(asked) > self._iterations))
        if not problem.hasExactSolution():
            return np.zeros((0, 2))
        path = problem.getSolutionPath()
        corners = [path.getState(index) for index in range(1, path.getStateCount())]
        return np.array([(corner[0], corner[1]) for corner in corners])

    def _box(self, places_ned_m: np.ndarray, radius_m: float) -> object:
        low_m, high_m = places_ned_m.min(axis=0) - BOX_SHARE * radius_m, places_ned_m.max(axis=0) + BOX_SHARE * radius_m
        bounds = self._base.RealVectorBounds(2)
        for axis in (0, 1):
            bounds.setLow(axis, float(low_m[axis]))
            bounds.setHigh(axis, float(high_m[axis]))
        return bounds


def _motion_validator(base: ModuleType) -> Callable[[object, list[tuple[float, float, float]]], object]:
    """Return the class of the motion test, whose parent class is known only once OMPL is loaded."""

    class Straight(base.MotionValidator):  # type: ignore[misc, name-defined]
        """Accepts a straight motion if it keeps out of every disc."""

        def __init__(self, information: object, discs: list[tuple[float, float, float]]) -> None:
            super().__init__(information)
            self._discs = discs

        def checkMotion(self, begin: Sequence[float], end: Sequence[float]) -> bool:
            return _clear(self._discs, begin[0], begin[1], end[0], end[1])

    return Straight


def _clear(
    discs: list[tuple[float, float, float]], north_m: float, east_m: float, to_north_m: float, to_east_m: float
) -> bool:
    """Return whether a straight motion keeps out of discs (north m, east m, radius squared m^2).

    It computes with plain floats: it is called some hundreds of times a plan, each time with a few tens of discs, where
    arrays cost more.
    """
    along_north_m, along_east_m = to_north_m - north_m, to_east_m - east_m
    length2_m2 = along_north_m**2 + along_east_m**2
    for disc_north_m, disc_east_m, radius2_m2 in discs:
        off_north_m, off_east_m = disc_north_m - north_m, disc_east_m - east_m
        share = 0.0
        if length2_m2 > 0.0:
            share = (off_north_m * along_north_m + off_east_m * along_east_m) / length2_m2
            share = 0.0 if share < 0.0 else min(share, 1.0)
        off_north_m -= share * along_north_m
        off_east_m -= share * along_east_m
        if off_north_m**2 + off_east_m**2 < radius2_m2:
            return False
    return True
