"""The A* search for the shortest way in the graph of tangents, and the ways along a given sequence of circles."""

from __future__ import annotations

import cmath
import heapq
import itertools
import math
from collections.abc import Generator

import numpy as np

from companion.guidance.route.scene import FULL_TURN_RAD, HALF_PI, NO_PARENT, NOTHING, Scene, State, sweep_rad_of

FEW = 32
"""Number of candidates up to which a loop over them is faster than arrays."""
SHADES = 24
"""Number of known discs nearest to a circle that are asked at once whether they block its candidates."""
SUSPECTS = 4
"""Number of obstacles that a circle remembers to have been in the way of segments from or to it."""

MOST_PASSED = 3
"""Greatest number of circles that a vehicle can pass in one step of guidance."""


class Effort:
    """What is left of the work that a search may do until it must pause, in nominal microseconds.

    It counts what is done instead of the time it takes, so that every run repeats.
    """

    def __init__(self, left_us: float = math.inf) -> None:
        self.left_us = left_us


_Candidate = tuple[float, float, int, int, int, float, float]
"""Bound and length in m, state, circle and side that it leads to, heading in rad and length in m of the segment."""


class Search:
    """A* over states on circles, from the start to the goal; discs join the graph once they are found in the way."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.states: list[State] = []
        self._open: list[tuple[float, float, int, int, int, float, float, list[_Candidate]]] = []
        self._discs: list[int] = []
        self._known = [False] * (scene.circles.first_band + len(scene.bands.half_m))
        self._on: dict[tuple[int, int], list[State]] = {}
        self._free: dict[tuple[int, int, int, int], bool] = {}
        self._suspects: dict[int, list[int]] = {}
        self._columns = _Columns(scene)
        for state in scene.starts():
            if scene.pose.limited:
                free_rad, blocker = scene.free_rad(state.circle, state.side, state.angle_rad)
                state = state._replace(free_rad=free_rad, blocker=blocker)
            self._enter(state)

    def run(self, max_states: int, effort: Effort, below_m: float = math.inf) -> Generator[None, None, int | None]:
        """Return the index of the state at the goal, or None if none was found with `max_states` states.

        It must be shorter than `below_m`. It pauses whenever no effort is left.
        """
        scene, goal_node = self.scene, self.scene.circles.goal_node
        while self._open and len(self.states) < max_states:
            if effort.left_us <= 0.0:
                yield
            effort.left_us -= 4.0
            bound_m, length_m, parent, to, side, heading_rad, segment_m, others = heapq.heappop(self._open)
            if bound_m >= below_m:
                return None
            if others:
                heapq.heappush(self._open, (*others.pop(), others))
            begin = self.states[parent]
            if sweep_rad_of(begin, heading_rad) > begin.free_rad:
                effort.left_us -= self._take_in(begin.blocker)
                continue
            angle_rad = heading_rad - side * HALF_PI
            if to != goal_node and self._dominated(to, side, angle_rad, length_m):
                continue
            if not self._segment_free(begin, (to, side), heading_rad, segment_m, effort):
                continue
            if to == goal_node:
                self.states.append(State(length_m, to, side, angle_rad, 0.0, NOTHING, parent, heading_rad, segment_m))
                return len(self.states) - 1
            free = scene.free_rad(to, side, angle_rad)
            effort.left_us -= self._enter(State(length_m, to, side, angle_rad, *free, parent, heading_rad, segment_m))
        return None

    @property
    def discs(self) -> list[int]:
        """The discs that were taken in."""
        return self._discs

    def chain(self, state: int) -> list[State]:
        """Return the states from the start to the one with the given index, in order."""
        chain = []
        while state != NO_PARENT:
            chain.append(self.states[state])
            state = self.states[state].parent
        return chain[::-1]

    def _enter(self, state: State) -> float:
        """Add a state and its candidates; return the work that this took, in us."""
        index = len(self.states)
        self.states.append(state)
        self._columns.add(index, state)
        self._on.setdefault((state.circle, state.side), []).append(state)
        goal_node = self.scene.circles.goal_node
        for side in self.scene.circles.goal_sides:
            self._push(index, state, goal_node, side)
        if 2 * len(self._discs) > FEW:
            discs = np.array(self._discs)
            return self._push_all(np.array([index]), discs[discs != state.circle])
        for disc in self._discs:
            if disc != state.circle:
                self._push(index, state, disc, 1)
                self._push(index, state, disc, -1)
        return 10.0 + 6.0 * len(self._discs)

    def _take_in(self, blocker: int) -> float:
        """Add a disc, or the discs about both ends of a band, to the graph; return the work that this took, in us."""
        if self._known[blocker]:
            return 0.0
        self._known[blocker] = self._columns.known[blocker] = True
        first_band = self.scene.circles.first_band
        if blocker >= first_band:
            bands = self.scene.bands
            return sum(self._take_in(int(ends[blocker - first_band])) for ends in (bands.first, bands.second))
        self._discs.append(blocker)
        if 2 * len(self.states) > FEW:
            others = np.array([index for index, state in enumerate(self.states) if state.circle != blocker])
            return self._push_all(others, np.array([blocker]))
        for index, state in enumerate(self.states):
            if state.circle != blocker:
                self._push(index, state, blocker, 1)
                self._push(index, state, blocker, -1)
        return 6.0 * len(self.states)

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
        bound_m = length_m + abs(rest_m - circles.radius_m[circles.goal_node])
        heapq.heappush(self._open, (bound_m, length_m, index, to, to_side, heading_rad, segment_m, []))

    def _push_all(self, states: np.ndarray, discs: np.ndarray) -> float:  # (S,) int, (D,) int; S or D is 1
        """Add the candidates that lead from states to both sides of discs; return the work that this took, in us.

        Only the best of them enters the queue; each is replaced by the next when it leaves it.
        """
        found = self._columns.candidates(states, discs, np.array(self._discs))
        if found:
            heapq.heappush(self._open, (*found.pop(), found))
        return 150.0 + 1.5 * (len(states) + len(discs))

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

    def _segment_free(
        self, state: State, to: tuple[int, int], heading_rad: float, segment_m: float, effort: Effort
    ) -> bool:
        """Return whether a segment from a state to a circle, (index, side), is free; take in what is in its way.

        Most segments that are not are blocked by what blocked others from or to the same circles.
        """
        circle, side = state.circle, state.side
        key = (circle, side, *to)
        free = self._free.get(key)
        if free is not None:
            return free
        circles = self.scene.circles
        reach_m = side * circles.radius_m[circle]
        north_m = circles.north_m[circle] + reach_m * math.sin(heading_rad)
        east_m = circles.east_m[circle] - reach_m * math.cos(heading_rad)
        suspects = self._suspects.setdefault(circle, []), self._suspects.setdefault(to[0], [])
        effort.left_us -= 8.0
        free = not self.scene.enters_any((north_m, east_m, heading_rad, segment_m), itertools.chain(*suspects))
        if free:
            blockers = self.scene.blockers(north_m, east_m, heading_rad, segment_m)
            effort.left_us -= 15.0 + 0.02 * len(self._known)
            free = not len(blockers)
            for blocker in blockers.tolist():
                effort.left_us -= self._take_in(blocker)
                for known in suspects:
                    if blocker not in known:
                        known.insert(0, blocker)
                        del known[SUSPECTS:]
        # Flown the other way it enters the same.
        self._free[key] = self._free[to[0], -to[1], circle, -side] = free
        return free


class _Columns:
    """The states of a search as columns, to compute the tangents of many at once."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._circles: np.ndarray | None = None  # (3, C): north, east and radius of each circle, m
        self.known = np.zeros(scene.circles.first_band + len(scene.bands.half_m), dtype=bool)  # what was taken in
        self._states = np.zeros((6, 64))  # length, circle, side, angle, free sweep and blocker of each state

    def add(self, index: int, state: State) -> None:
        """Add the state with the next index."""
        if index >= self._states.shape[1]:
            self._states = np.concatenate((self._states, np.zeros_like(self._states)), axis=1)
        self._states[:, index] = state[:6]

    def candidates(self, states: np.ndarray, discs: np.ndarray, all_discs: np.ndarray) -> list[_Candidate]:
        """Return the candidates from states (S,) to both sides of discs (D,), S or D being 1, the best one last.

        Ways that known obstacles block are left out: along an arc that one covers, or by a segment that enters one of
        those of all discs of the graph, `all_discs`, that are nearest to the one circle that the candidates share.
        """
        scene, circles = self._scene, self._scene.circles
        if self._circles is None:
            self._circles = np.array((circles.north_m, circles.east_m, circles.radius_m))
        from_m, circle, side, angle_rad, free_rad, blocker = self._states[:, states]
        north_m, east_m, radius_m = self._circles[:, circle.astype(int)]
        to_north_m, to_east_m, to_radius_m = self._circles[:, discs]
        reach_m = np.array([[1.0], [-1.0]]) * to_radius_m  # (2, D)
        offset_north_m, offset_east_m = to_north_m - north_m, to_east_m - east_m
        across_m = reach_m - side * radius_m  # (2, S or D)
        gap_m2 = offset_north_m * offset_north_m + offset_east_m * offset_east_m
        along_m2 = gap_m2 - across_m * across_m
        gap_m = np.sqrt(gap_m2)
        exists = (along_m2 > 0.0) | ((gap_m > 0.0) & (np.abs(across_m) <= gap_m + scene.tolerance_m))
        along_m = np.sqrt(np.maximum(along_m2, 0.0))
        heading_rad = np.arctan2(offset_east_m, offset_north_m) - np.arctan2(across_m, along_m)
        sweep_rad = (side * (heading_rad - angle_rad) - HALF_PI) % math.tau
        sweep_rad[sweep_rad > math.tau - FULL_TURN_RAD] = 0.0
        exists &= (sweep_rad <= free_rad) | ~self.known[blocker.astype(int)]
        length_m = from_m + radius_m * sweep_rad + along_m
        sine, cosine = np.sin(heading_rad), np.cos(heading_rad)
        ends_m = np.array((to_north_m + reach_m * sine, to_east_m - reach_m * cosine))
        pivot = int(discs[0]) if len(states) > 1 else int(circle[0])
        exists &= ~self._shaded(pivot, all_discs, ends_m, (sine, cosine), along_m)
        rest_m = np.hypot(ends_m[0] - scene.goal.real, ends_m[1] - scene.goal.imag)
        bound_m = length_m + np.abs(rest_m - circles.radius_m[circles.goal_node])
        kept = np.flatnonzero(exists)
        kept = kept[np.argsort(-bound_m.ravel()[kept], kind="stable")]
        column = kept % bound_m.shape[1]
        from_states = states[column].tolist() if len(states) > 1 else states.tolist() * len(kept)
        to_discs = discs[column].tolist() if len(discs) > 1 else discs.tolist() * len(kept)
        sides = np.where(kept < bound_m.shape[1], 1, -1).tolist()
        columns = [array.ravel()[kept].tolist() for array in (bound_m, length_m, heading_rad, along_m)]
        return list(zip(columns[0], columns[1], from_states, to_discs, sides, columns[2], columns[3], strict=True))

    def _shaded(
        self,
        pivot: int,
        discs: np.ndarray,  # (D,) int
        ends_m: np.ndarray,  # (2, 2, C) m, north and east
        sine_cosine: tuple[np.ndarray, np.ndarray],  # of the headings, (2, C) each
        along_m: np.ndarray,  # (2, C) m, lengths
    ) -> np.ndarray:  # (2, C) bool
        """Return which segments enter one of the discs nearest to a circle."""
        assert self._circles is not None
        north_m, east_m, _ = self._circles[:, discs]
        if len(discs) > SHADES:
            apart_m2 = (north_m - self._circles[0, pivot]) ** 2 + (east_m - self._circles[1, pivot]) ** 2
            nearest = np.argpartition(apart_m2, SHADES)[:SHADES]
            discs, north_m, east_m = discs[nearest], north_m[nearest], east_m[nearest]
        sine, cosine = (column[..., np.newaxis] for column in sine_cosine)
        back_north_m, back_east_m = ends_m[0, ..., np.newaxis] - north_m, ends_m[1, ..., np.newaxis] - east_m
        aside_m = back_north_m * sine - back_east_m * cosine
        before_m = back_north_m * cosine + back_east_m * sine  # how far before the end the disc is passed
        enters = aside_m * aside_m < self._scene.entered_m2[discs]
        enters &= (before_m > 0.0) & (before_m < along_m[..., np.newaxis])
        found: np.ndarray = enters.any(axis=-1)
        return found


def chains(scene: Scene, via: tuple[tuple[int, int], ...], end_side: int) -> list[list[State]]:
    """Return the ways along given circles, (index, side) in order, from each start to the goal, shortest first.

    `end_side` is the side of the goal's circle that they end on, 1 where the goal is a place. Where the first circles
    may have been passed already, the ways without them are among them.
    """
    nodes = [*via, (scene.circles.goal_node, end_side)]
    between = [scene.circles.tangent(*first, *second) for first, second in itertools.pairwise(nodes)]
    ways = []
    for start in scene.starts():
        for passed in range(min(len(via), MOST_PASSED) + 1):
            chain = _chain(scene, start, nodes[passed:], between[passed:])
            if chain is not None:
                ways.append(chain)
            # A first disc that would be gone around by more than half has most likely been passed.
            if passed < len(via) and chain is not None and _arc_rad(chain, via[passed]) <= math.pi:
                break
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
    """Return whether a way enters nothing; checks every segment and every arc against every disc at once."""
    circles = scene.circles
    if not circles.goal_node:
        return True
    if len(scene.bands.half_m) and not _clear_of_bands(scene, chain):
        return False
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


def _clear_of_bands(scene: Scene, chain: list[State]) -> bool:
    """Return whether a way enters no band of a wall."""
    circles = scene.circles
    begin, end = [], []
    for state, after in itertools.pairwise(chain):
        place = complex(circles.north_m[state.circle], circles.east_m[state.circle])
        begin.append(place + cmath.rect(circles.radius_m[state.circle], after.heading_rad - state.side * HALF_PI))
        end.append(begin[-1] + cmath.rect(after.segment_m, after.heading_rad))
    columns = np.array((begin, end))[:, :, np.newaxis]
    if np.count_nonzero(scene.bands.entered(columns[0], columns[1], scene.tolerance_m)):
        return False
    for state, after in itertools.pairwise(chain):
        free_rad, _ = scene.free_rad(state.circle, state.side, state.angle_rad, circles.first_band)
        if sweep_rad_of(state, after.heading_rad) > max(free_rad, 0.0):
            return False
    return True
