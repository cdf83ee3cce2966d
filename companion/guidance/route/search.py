"""The A* search for the shortest way in the graph of tangents, and the ways along a given sequence of circles."""

from __future__ import annotations

import cmath
import heapq
import itertools
import math

import numpy as np

from companion.guidance.route.scene import FULL_TURN_RAD, HALF_PI, NO_PARENT, NOTHING, Scene, State, sweep_rad_of


class Search:
    """A* over states on circles, from the start to the goal; discs join the graph once they are found in the way."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.states: list[State] = []
        self._open: list[tuple[float, float, int, int, int, float, float]] = []
        self._discs: list[int] = []
        self._known = [False] * scene.circles.goal_node
        self._on: dict[tuple[int, int], list[State]] = {}
        self._free: dict[tuple[int, int, int, int], bool] = {}
        for state in scene.starts():
            if scene.departure.limited:
                free_rad, blocker = scene.free_rad(state.circle, state.side, state.angle_rad)
                state = state._replace(free_rad=free_rad, blocker=blocker)
            self._enter(state)

    def run(self, max_states: int) -> int | None:
        """Return the index of the state at the goal, or None if none was found with `max_states` states.

        If it is None and `exhausted` is true, there is no way; otherwise `run` may be called again with a higher limit.
        """
        scene, goal_node = self.scene, self.scene.circles.goal_node
        while self._open and len(self.states) < max_states:
            _, length_m, parent, to, side, heading_rad, segment_m = heapq.heappop(self._open)
            begin = self.states[parent]
            if sweep_rad_of(begin, heading_rad) > begin.free_rad:
                self._take_in(begin.blocker)
                continue
            angle_rad = heading_rad - side * HALF_PI
            if to != goal_node and self._dominated(to, side, angle_rad, length_m):
                continue
            if not self._segment_free(begin, to, side, heading_rad, segment_m):
                continue
            if to == goal_node:
                self.states.append(State(length_m, to, side, angle_rad, 0.0, NOTHING, parent, heading_rad, segment_m))
                return len(self.states) - 1
            free = scene.free_rad(to, side, angle_rad)
            self._enter(State(length_m, to, side, angle_rad, *free, parent, heading_rad, segment_m))
        return None

    @property
    def exhausted(self) -> bool:
        """Whether no candidate is left to try."""
        return not self._open

    def chain(self, state: int) -> list[State]:
        """Return the states from the start to the one with the given index, in order."""
        chain = []
        while state != NO_PARENT:
            chain.append(self.states[state])
            state = self.states[state].parent
        return chain[::-1]

    def _enter(self, state: State) -> None:
        index = len(self.states)
        self.states.append(state)
        self._on.setdefault((state.circle, state.side), []).append(state)
        self._push(index, state, self.scene.circles.goal_node, 1)
        for disc in self._discs:
            if disc != state.circle:
                self._push(index, state, disc, 1)
                self._push(index, state, disc, -1)

    def _push(self, index: int, state: State, to: int, to_side: int) -> None:
        circles, goal = self.scene.circles, self.scene.goal
        tangent = circles.tangent(state.circle, state.side, to, to_side)
        if tangent is None:
            return
        heading_rad, segment_m = tangent
        sweep_rad = sweep_rad_of(state, heading_rad)
        if sweep_rad > state.free_rad and self._known[state.blocker]:
            return
        length_m = state.length_m + circles.radius_m[state.circle] * sweep_rad + segment_m
        reach_m = to_side * circles.radius_m[to]
        rest_m = math.hypot(
            circles.north_m[to] + reach_m * math.sin(heading_rad) - goal.real,
            circles.east_m[to] - reach_m * math.cos(heading_rad) - goal.imag,
        )
        heapq.heappush(self._open, (length_m + rest_m, length_m, index, to, to_side, heading_rad, segment_m))

    def _dominated(self, circle: int, side: int, angle_rad: float, length_m: float) -> bool:
        """Return whether an earlier way on the same circle can reach this angle along it without being longer."""
        for other in self._on.get((circle, side), ()):
            sweep_rad = (side * (angle_rad - other.angle_rad)) % math.tau
            if sweep_rad > math.tau - FULL_TURN_RAD:
                sweep_rad = 0.0
            along_m = other.length_m + self.scene.circles.radius_m[circle] * sweep_rad
            if sweep_rad <= other.free_rad and along_m <= length_m + self.scene.tolerance_m:
                return True
        return False

    def _segment_free(self, state: State, to: int, side: int, heading_rad: float, segment_m: float) -> bool:
        key = (state.circle, state.side, to, side)
        free = self._free.get(key)
        if free is None:
            circles = self.scene.circles
            reach_m = state.side * circles.radius_m[state.circle]
            north_m = circles.north_m[state.circle] + reach_m * math.sin(heading_rad)
            east_m = circles.east_m[state.circle] - reach_m * math.cos(heading_rad)
            blockers = self.scene.blockers(north_m, east_m, heading_rad, segment_m)
            free = self._free[key] = not len(blockers)
            for disc in blockers.tolist():
                self._take_in(disc)
        return free

    def _take_in(self, disc: int) -> None:
        if self._known[disc]:
            return
        self._known[disc] = True
        self._discs.append(disc)
        for index, state in enumerate(self.states):
            if state.circle != disc:
                self._push(index, state, disc, 1)
                self._push(index, state, disc, -1)


def chains(scene: Scene, via: tuple[tuple[int, int], ...]) -> list[list[State]]:
    """Return the ways along given circles, (index, side) in order, from each start to the goal, shortest first.

    Where the first circle may have been passed already, the way without it is among them.
    """
    nodes = [*via, (scene.circles.goal_node, 1)]
    between = [scene.circles.tangent(*first, *second) for first, second in itertools.pairwise(nodes)]
    ways = []
    for start in scene.starts():
        whole = _chain(scene, start, nodes, between)
        if whole is not None:
            ways.append(whole)
        # A first disc that would be gone around by more than half has most likely been passed.
        if via and (whole is None or _arc_rad(whole, via[0]) > math.pi):
            less = _chain(scene, start, nodes[1:], between[1:])
            if less is not None:
                ways.append(less)
    return sorted(ways, key=_length_m)


def _length_m(chain: list[State]) -> float:
    return chain[-1].length_m


def _arc_rad(chain: list[State], node: tuple[int, int]) -> float:
    """Return the sweep (rad) of a way along a circle, given as (index, side), that is its first or second."""
    index = 0 if (chain[0].circle, chain[0].side) == node else 1
    return sweep_rad_of(chain[index], chain[index + 1].heading_rad)


def _chain(
    scene: Scene, start: State, nodes: list[tuple[int, int]], between: list[tuple[float, float] | None]
) -> list[State] | None:
    """Return the states of the way from a start along circles with given tangents; None where a tangent is missing."""
    if nodes[0] == (start.circle, start.side):
        nodes, legs = nodes[1:], between
    else:
        legs = [scene.circles.tangent(start.circle, start.side, *nodes[0]), *between]
    chain = [start]
    before = start
    for (circle, side), leg in zip(nodes, legs, strict=True):
        if leg is None:
            return None
        heading_rad, segment_m = leg
        length_m = (
            before.length_m + scene.circles.radius_m[before.circle] * sweep_rad_of(before, heading_rad) + segment_m
        )
        angle_rad = heading_rad - side * HALF_PI
        before = State(length_m, circle, side, angle_rad, 0.0, NOTHING, NO_PARENT, heading_rad, segment_m)
        chain.append(before)
    return chain


def chain_free(scene: Scene, chain: list[State]) -> bool:
    """Return whether a way enters no disc; checks every segment and every arc against every disc at once."""
    circles = scene.circles
    if not circles.goal_node:
        return True
    base: list[complex] = []  # beginnings of segments, then centres of arcs
    ahead: list[complex] = []  # conjugate directions: of the segments, then to the middles of the arcs
    length_m: list[float] = []
    centre, middle, reach_m, cosine = [], [], [], []
    for state, after in itertools.pairwise(chain):
        place = complex(circles.north_m[state.circle], circles.east_m[state.circle])
        radius_m, heading_rad = circles.radius_m[state.circle], after.heading_rad
        base.append(place + cmath.rect(radius_m, heading_rad - state.side * HALF_PI))
        ahead.append(cmath.rect(1.0, -heading_rad))
        length_m.append(after.segment_m)
        half_rad = 0.5 * sweep_rad_of(state, heading_rad)
        if radius_m > 0.0 and half_rad > 0.0:
            centre.append(place)
            middle.append(cmath.rect(1.0, -state.angle_rad - state.side * half_rad))
            reach_m.append(radius_m)
            cosine.append(math.cos(half_rad))
    segments = len(base)
    rows = np.array([base + centre, ahead + middle])[:, :, np.newaxis]
    offset = (scene.centre - rows[0]) * rows[1]  # (segments + arcs, M)
    along_m, aside_m = offset.real[:segments], offset.imag[:segments]
    beyond_m = along_m - np.minimum(np.maximum(along_m, 0.0), np.array(length_m)[:, np.newaxis])
    if np.count_nonzero(beyond_m * beyond_m + aside_m * aside_m < scene.entered_m2):
        return False
    if not centre:
        return True
    # The point of an arc nearest to a disc is on the disc's bearing, or an end of the arc, which a segment covered.
    gap_m = np.abs(offset[segments:])
    off_m = gap_m - np.array(reach_m)[:, np.newaxis]
    near = off_m * off_m < scene.entered_m2
    if not np.count_nonzero(near):
        return True
    return not np.count_nonzero(near & (offset.real[segments:] >= gap_m * np.array(cosine)[:, np.newaxis]))
