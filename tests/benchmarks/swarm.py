"""Swarms that keep the right of way, in a kinematic loop of their own: `python tests/benchmarks/swarm.py [SCENE]`.

Every vehicle decides alone and at the same time as all others, from what its own detector sees at that moment, and
flies the exact arc to the heading that it chose. Nothing else keeps the vehicles apart: no guard, no surrogate, no
broadcast.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from companion.geo.kinematics import limit_turn, turn_rate_rad_s, turn_towards
from companion.geo.right_of_way import Rules, growth_m, reserved_radius_m
from companion.guard.types import Motion
from companion.guidance.resolution import AtEffect, Peers, Resolution
from companion.guidance.separation import give_way
from companion.guidance.steering import Occupied, loiter_attraction, loiter_place, loiter_radius_m, loiter_spacing_m

DT_S = 0.5
NOWHERE_NED_M = np.zeros((0, 2))
PIECES = 5
"""Number of parts that a step is sampled in; the separation is interpolated between the samples."""
ARRIVAL_RADIUS_M = 300.0
DETECTOR_RANGE_M = 2000.0
ATTEMPTS = 100
"""Number of attempts to draw a scene before giving up."""
DRAWS = 4000
"""Number of random places drawn in each attempt."""


@dataclass
class Craft:
    """One vehicle of a swarm: its state, its target and its decisions."""

    north_m: float
    east_m: float
    heading_rad: float
    speed_m_s: float
    target_ned_m: tuple[float, float] | None  # None: it loiters from the start
    target_id: int = -1
    cruise_m_s: float = 0.0
    place_ned_m: tuple[float, float] | None = None
    flown_m: float = 0.0
    pending: list[tuple[float, float]] = field(default_factory=list)  # decisions on their way: heading rad, speed m/s
    done_s: float | None = None  # when its target was completed, by itself or by another
    reached: bool = False
    shortest_m: float = 0.0


@dataclass
class Outcome:
    """Figures of one flight of a swarm."""

    vehicles: int
    bound: int  # vehicles that had a target
    arrived: int
    breaches: int  # pairs that came closer than D_safe, each entry counted
    least_m: float
    time_s: float
    path_ratios: list[float] = field(default_factory=list)


def fly(
    crafts: Sequence[Craft],
    rules: Rules,
    time_limit_s: float,
    after_s: float = 0.0,
    detector_range_m: float = DETECTOR_RANGE_M,
    arrival_radius_m: float = ARRIVAL_RADIUS_M,
    give: bool = True,
    noise: Callable[[tuple[int, ...]], np.ndarray] | None = None,
    standing: bool = False,
    word_period_s: float = 0.0,
) -> Outcome:
    """Fly until all vehicles have arrived and for `after_s` more, or to the time limit.

    Without `give` no vehicle gives way. With `standing` all stand still at first. `noise` returns position errors in m
    for an array of the given shape. With `word_period_s` nobody sees anybody: all hear at that period where all were
    and how they flew. The crafts are changed in place.
    """
    for craft in crafts:
        craft.cruise_m_s = craft.speed_m_s
        craft.speed_m_s = 0.0 if standing else craft.speed_m_s
        if craft.target_ned_m is None:
            craft.place_ned_m = (craft.north_m, craft.east_m)
        else:
            craft.shortest_m = math.dist((craft.north_m, craft.east_m), craft.target_ned_m) - arrival_radius_m
    close = np.zeros((len(crafts), len(crafts)), dtype=bool)
    outcome = Outcome(len(crafts), sum(c.target_ned_m is not None for c in crafts), 0, 0, math.inf, 0.0)
    now_s, end_s, told_s = 0.0, time_limit_s, -math.inf
    while now_s < end_s:
        positions = np.array([(c.north_m, c.east_m) for c in crafts])
        velocities = np.array([(math.cos(c.heading_rad), math.sin(c.heading_rad)) for c in crafts])
        velocities *= np.array([[c.speed_m_s] for c in crafts])
        settled = np.array([c.place_ned_m is not None for c in crafts])
        if now_s - told_s >= word_period_s - 1e-9:
            told_s, told_m, told_m_s = now_s, positions, velocities
        decisions = []
        for k, craft in enumerate(crafts):
            seen = np.hypot(*(positions - positions[k]).T) <= detector_range_m
            seen[k] = False
            wanted_rad = _wanted_rad(craft, positions[seen & settled], rules, arrival_radius_m)
            motion = Motion(craft.north_m, craft.east_m, craft.heading_rad, craft.speed_m_s)
            heard = told_m[seen]
            if noise is not None:
                heard = heard + noise(heard.shape)
            if give:
                at_effect = _at_effect(craft, rules)
                peers = _peers(heard, told_m_s[seen], now_s - told_s, rules)
                chosen = give_way(wanted_rad, motion, peers, rules, DT_S, at_effect)
                speed_m_s = min(chosen.speed_m_s, _wanted_m_s(craft, rules))
                decisions.append((_reachable_rad(craft, at_effect, chosen, rules), speed_m_s))
            else:
                decisions.append((wanted_rad, craft.speed_m_s))
        for craft, decision in zip(crafts, decisions, strict=True):
            craft.pending.append(decision)
        delay = round(rules.reaction_s / DT_S)
        ripe = [c.pending.pop(0) if len(c.pending) > delay else (c.heading_rad, c.speed_m_s) for c in crafts]
        samples = np.array([_step(c, h, v, rules) for c, (h, v) in zip(crafts, ripe, strict=True)])
        _score(samples, rules, close, outcome)
        now_s += DT_S
        _arrive(crafts, now_s, arrival_radius_m)
        if end_s == time_limit_s and all(c.done_s is not None or c.target_ned_m is None for c in crafts):
            end_s = min(end_s, now_s + after_s)
    outcome.arrived = sum(c.done_s is not None for c in crafts)
    outcome.time_s = max((c.done_s for c in crafts if c.done_s is not None), default=math.inf)
    outcome.path_ratios = [c.flown_m / c.shortest_m for c in crafts if c.reached and c.shortest_m > 0.0]
    return outcome


def _peers(places_ned_m: np.ndarray, velocities_m_s: np.ndarray, age_s: float, rules: Rules) -> Peers:
    """Return the others as they were told to be an age ago."""
    if age_s == 0.0:
        return Peers(places_ned_m, velocities_m_s)
    speeds_m_s = np.hypot(*velocities_m_s.T).tolist()
    growths_m = np.array([growth_m(speed_m_s, age_s, True, rules, DT_S) for speed_m_s in speeds_m_s])
    return Peers(places_ned_m, velocities_m_s, None, np.full(len(places_ned_m), age_s), growths_m)


def _at_effect(craft: Craft, rules: Rules) -> AtEffect:
    """Return the heading and speed of a craft once its decisions that are still on their way have taken effect."""
    heading_rad, speed_m_s = craft.heading_rad, craft.speed_m_s
    for wanted_rad, speed_m_s in craft.pending:
        rate_rad_s = turn_rate_rad_s(speed_m_s, rules.n_max)
        heading_rad = turn_towards(0.0, 0.0, heading_rad, speed_m_s, wanted_rad, rate_rad_s, DT_S)[2]
    return AtEffect(heading_rad, speed_m_s)


def _reachable_rad(craft: Craft, at_effect: AtEffect, chosen: Resolution, rules: Rules) -> float:
    """Return the chosen heading; for a craft that can stop, as far as it can be turned to in a step."""
    if not rules.can_stop:
        return chosen.heading_rad
    faster_m_s = max(craft.speed_m_s, at_effect.speed_m_s, chosen.speed_m_s)
    return limit_turn(at_effect.heading_rad, chosen.heading_rad, faster_m_s, rules.n_max, DT_S)[0]


def _wanted_m_s(craft: Craft, rules: Rules) -> float:
    """Return the cruise speed, or for a loitering craft that can stop, what its distance to the place allows."""
    if not rules.can_stop or craft.place_ned_m is None:
        return craft.cruise_m_s
    return min(craft.cruise_m_s, 0.3 * math.dist((craft.north_m, craft.east_m), craft.place_ned_m))


def _wanted_rad(craft: Craft, loitering_ned_m: np.ndarray, rules: Rules, arrival_radius_m: float) -> float:
    """Return the heading of plain attraction or of loitering.

    A craft whose target lies inside one of its turning circles flies straight on.
    """
    here = (craft.north_m, craft.east_m)
    if craft.done_s is not None or craft.target_ned_m is None:
        if rules.can_stop:
            occupied = Occupied(loitering_ned_m, 2.0 * rules.separation_m, NOWHERE_NED_M, 0.0)
            craft.place_ned_m = craft.place_ned_m or loiter_place(here, occupied)
            return math.atan2(craft.place_ned_m[1] - here[1], craft.place_ned_m[0] - here[0])
        radius_m = loiter_radius_m(craft.cruise_m_s, rules.n_max, DT_S)
        if craft.place_ned_m is None:
            spacing_m = loiter_spacing_m(rules.separation_m, radius_m) + radius_m
            craft.place_ned_m = loiter_place(here, Occupied(loitering_ned_m, spacing_m, NOWHERE_NED_M, 0.0))
        return loiter_attraction(here, craft.place_ned_m, radius_m).heading_rad
    rho_m = craft.speed_m_s / turn_rate_rad_s(craft.speed_m_s, rules.n_max)
    north_m, east_m = craft.target_ned_m[0] - here[0], craft.target_ned_m[1] - here[1]
    across_m = -north_m * math.sin(craft.heading_rad) + east_m * math.cos(craft.heading_rad)
    along_m = north_m * math.cos(craft.heading_rad) + east_m * math.sin(craft.heading_rad)
    if math.hypot(along_m, abs(across_m) - rho_m) < rho_m - 0.9 * arrival_radius_m:
        return craft.heading_rad
    return math.atan2(east_m, north_m)


def _step(craft: Craft, heading_rad: float, speed_m_s: float, rules: Rules) -> list[tuple[float, float]]:
    """Move a craft by a step; return its positions at the samples, the first at the step's start."""
    places = [(craft.north_m, craft.east_m)]
    start = (craft.north_m, craft.east_m, craft.heading_rad)
    for piece in range(1, PIECES + 1):
        before_m_s = craft.speed_m_s
        if rules.braking_m_s2 is None:
            # Each sample from the beginning of the step: half a circle must not be decided again on the way.
            elapsed_s = DT_S * piece / PIECES
        else:
            start, elapsed_s = (craft.north_m, craft.east_m, craft.heading_rad), DT_S / PIECES
            most_m_s = rules.braking_m_s2 * elapsed_s
            craft.speed_m_s += max(-most_m_s, min(most_m_s, speed_m_s - craft.speed_m_s))
        # At a constant acceleration the way is that at the mean speed: at the last one it would be too long.
        mean_m_s = 0.5 * (before_m_s + craft.speed_m_s)
        rate_rad_s = turn_rate_rad_s(craft.speed_m_s, rules.n_max)
        craft.north_m, craft.east_m, craft.heading_rad = turn_towards(
            *start, mean_m_s, heading_rad, rate_rad_s, elapsed_s
        )
        places.append((craft.north_m, craft.east_m))
        if craft.done_s is None:
            craft.flown_m += mean_m_s * DT_S / PIECES
    return places


def _score(samples: np.ndarray, rules: Rules, close: np.ndarray, outcome: Outcome) -> None:
    """Count the pairs that came closer than D_safe in a step, between samples too; samples (N, pieces + 1, 2) m."""
    offset = samples[:, None] - samples[None, :]  # (N, N, pieces + 1, 2)
    begin, way = offset[:, :, :-1], np.diff(offset, axis=2)
    square = np.maximum((way**2).sum(axis=3), 1e-12)
    part = np.clip(-(begin * way).sum(axis=3) / square, 0.0, 1.0)
    apart_m = np.sqrt(((begin + part[..., None] * way) ** 2).sum(axis=3)).min(axis=2)
    np.fill_diagonal(apart_m, math.inf)
    outcome.least_m = min(outcome.least_m, float(apart_m.min()))
    now_close = apart_m < rules.separation_m
    outcome.breaches += int((now_close & ~close).sum()) // 2
    close[:] = now_close


def _arrive(crafts: Sequence[Craft], now_s: float, arrival_radius_m: float) -> None:
    """Complete the targets that a craft has reached; every craft with such a target is done."""
    reached = set()
    for craft in crafts:
        if craft.done_s is None and craft.target_ned_m is not None:
            if math.dist((craft.north_m, craft.east_m), craft.target_ned_m) <= arrival_radius_m:
                craft.reached = True
                reached.add(craft.target_id)
    for craft in crafts:
        if craft.done_s is None and craft.target_ned_m is not None and craft.target_id in reached:
            craft.done_s = now_s


def facing_rad(here: tuple[float, float], there: tuple[float, float]) -> float:
    """Return the heading from one place to another."""
    return math.atan2(there[1] - here[1], there[0] - here[0])


def bound(here: tuple[float, float], there: tuple[float, float], speed_m_s: float, target_id: int) -> Craft:
    """Return a craft at one place that heads for another."""
    return Craft(*here, facing_rad(here, there), speed_m_s, there, target_id)


def circle(count: int, free: float, rules: Rules, rng: np.random.Generator, jitter: float = 0.0) -> list[Craft]:
    """Return crafts on a circle, each bound for the opposite point; its area is `free` reserved areas per craft."""
    radius_m = math.sqrt(count * free) * reserved_radius_m(rules.speed_m_s, rules, DT_S)
    crafts = []
    for k in range(count):
        angle_rad = math.tau * (k + jitter * rng.uniform(-0.5, 0.5)) / count
        here = (radius_m * math.cos(angle_rad), radius_m * math.sin(angle_rad))
        crafts.append(bound(here, (-here[0], -here[1]), rules.speed_m_s, k))
    return crafts


def scattered(count: int, side_m: float, apart_m: float, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Return `count` places in a square, at least `apart_m` from each other; raise ValueError if they do not fit."""
    for _ in range(ATTEMPTS):
        places: list[tuple[float, float]] = []
        for north_m, east_m in rng.uniform(0.0, side_m, (DRAWS, 2)).tolist():
            if all(math.dist((north_m, east_m), other) >= apart_m for other in places):
                places.append((north_m, east_m))
            if len(places) == count:
                return places
    raise ValueError(f"{count} places {apart_m:.0f} m apart do not fit into {side_m:.0f} m: take a greater --free")


def target_spacing_m(rules: Rules) -> float:
    """Return the distance between targets at which all can be reached while other crafts loiter at theirs."""
    if rules.can_stop:
        return 3.0 * rules.separation_m
    return 1.2 * loiter_spacing_m(rules.separation_m, loiter_radius_m(rules.speed_m_s, rules.n_max, DT_S))


def random_pairs(count: int, free: float, rules: Rules, rng: np.random.Generator) -> list[Craft]:
    """Return crafts at random places of a square, bound for random places of it.

    The square's area is `free` reserved areas for each craft. Their reserved discs do not overlap at the start.
    """
    radius_m = reserved_radius_m(rules.speed_m_s, rules, DT_S)
    side_m = math.sqrt(count * free * math.pi) * radius_m
    ends = scattered(count, side_m, target_spacing_m(rules), rng)
    for _ in range(ATTEMPTS):
        crafts: list[Craft] = []
        for north_m, east_m in rng.uniform(0.0, side_m, (DRAWS, 2)).tolist():
            craft = bound((north_m, east_m), ends[len(crafts)], rules.speed_m_s, len(crafts))
            centre = centre_ned_m(craft, rules)
            if all(math.dist(centre, centre_ned_m(other, rules)) > 2.0 * radius_m for other in crafts):
                crafts.append(craft)
            if len(crafts) == count:
                return crafts
    raise ValueError(f"{count} reserved discs do not fit into {side_m:.0f} m: take a greater --free")


def spread_pairs(count: int, free: float, rules: Rules, rng: np.random.Generator) -> list[Craft]:
    """Return random pairs whose starts leave room to circle there at any heading."""
    radius_m = reserved_radius_m(rules.speed_m_s, rules, DT_S)
    side_m = math.sqrt(count * free * math.pi) * radius_m
    starts = scattered(count, side_m, (2.0 if rules.can_stop else 4.0) * radius_m, rng)
    ends = scattered(count, side_m, target_spacing_m(rules), rng)
    return [bound(here, there, rules.speed_m_s, k) for k, (here, there) in enumerate(zip(starts, ends, strict=True))]


def centre_ned_m(craft: Craft, rules: Rules) -> tuple[float, float]:
    """Return the centre of the disc that a craft reserves."""
    if rules.can_stop:
        return craft.north_m, craft.east_m
    radius_m = craft.speed_m_s / turn_rate_rad_s(craft.speed_m_s, rules.n_max)
    return (
        craft.north_m - radius_m * math.sin(craft.heading_rad),
        craft.east_m + radius_m * math.cos(craft.heading_rad),
    )


def streams(count: int, free: float, rules: Rules, rng: np.random.Generator) -> list[Craft]:
    """Return two opposing streams through one square, half of the crafts each, bound for the other side."""
    radius_m = reserved_radius_m(rules.speed_m_s, rules, DT_S)
    side_m = math.sqrt(count * free * math.pi) * radius_m
    crafts: list[Craft] = []
    for way, number in ((1.0, count - count // 2), (-1.0, count // 2)):
        for north_m, east_m in scattered(number, side_m, max(2.0 * radius_m, target_spacing_m(rules)), rng):
            # Each stream starts in a square of its own, a square apart, and ends in the other's.
            here, there = (north_m - way * side_m, east_m), (north_m + way * side_m, east_m)
            crafts.append(bound(here, there, rules.speed_m_s, len(crafts)))
    return crafts


def among_loiterers(count: int, free: float, rules: Rules, rng: np.random.Generator) -> list[Craft]:
    """Return random pairs of which every other craft loiters at its start from the beginning."""
    crafts = spread_pairs(count, free, rules, rng)
    spacing_m = target_spacing_m(rules)
    for k, craft in enumerate(crafts):
        if k % 2:
            craft.target_ned_m = None
    places = [(c.north_m, c.east_m) for c in crafts if c.target_ned_m is None]
    # Nobody can reach a target inside a loiter circle: such a craft stays out of it.
    return [c for c in crafts if not c.target_ned_m or all(math.dist(c.target_ned_m, p) > spacing_m for p in places)]


def converging(count: int, free: float, rules: Rules, rng: np.random.Generator) -> list[Craft]:
    """Return crafts in groups of five that have one target in common."""
    crafts = spread_pairs(count, free, rules, rng)
    for k, craft in enumerate(crafts):
        leader = crafts[k - k % 5]
        craft.target_ned_m, craft.target_id = leader.target_ned_m, k - k % 5
        assert craft.target_ned_m is not None
        craft.heading_rad = facing_rad((craft.north_m, craft.east_m), craft.target_ned_m)
    return crafts


SCENES: dict[str, Callable[[int, float, Rules, np.random.Generator], list[Craft]]] = {
    "circle": circle,
    "random": random_pairs,
    "streams": streams,
    "loiterers": among_loiterers,
    "converge": converging,
}


def measure(
    name: str,
    count: int,
    free: float,
    rules: Rules,
    seeds: Sequence[int],
    time_limit_s: float,
    detector_range_m: float,
    arrival_radius_m: float,
) -> str:
    """Fly a scene once per seed and return its line of the table."""
    started_s = time.perf_counter()
    outcomes = [
        fly(
            SCENES[name](count, free, rules, np.random.default_rng(seed)),
            rules,
            time_limit_s,
            100.0,
            detector_range_m,
            arrival_radius_m,
        )
        for seed in seeds
    ]
    ratios = [ratio for each in outcomes for ratio in each.path_ratios] or [math.nan]
    arrived, meant = sum(each.arrived for each in outcomes), sum(each.bound for each in outcomes)
    return (
        f"{name:10s} N {count:3d} n {rules.n_max:4.1f} free {free:5.1f} runs {len(seeds):2d} arrived {arrived}/{meant}"
        f" breaches {sum(e.breaches for e in outcomes)} least {min(e.least_m for e in outcomes):6.1f} m"
        f" ratio {statistics.mean(ratios):5.2f} (worst {max(ratios):6.2f})"
        f" last {max(e.time_s for e in outcomes):6.1f} s wall {time.perf_counter() - started_s:5.1f} s"
    )


def main() -> None:
    """Print a line for each scene, size and density."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", default=list(SCENES))
    parser.add_argument("--count", type=int, nargs="+", default=[10, 20, 30, 50])
    parser.add_argument("--free", type=float, nargs="+", default=[8.0, 12.0, 20.0])
    parser.add_argument("--n-max", type=float, nargs="+", default=[1.0])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--range-m", type=float, default=DETECTOR_RANGE_M)
    parser.add_argument("--time-limit", type=float, default=3000.0, help="s of virtual time")
    parser.add_argument("--reaction-s", type=float, default=0.0)
    parser.add_argument("--copters", action="store_true")
    asked = parser.parse_args()
    for name in asked.scenes:
        for n_max in asked.n_max:
            rules = Rules(100.0, n_max, 60.0, asked.reaction_s)
            arrival_radius_m = ARRIVAL_RADIUS_M
            if asked.copters:
                rules = Rules(20.0, n_max, 15.0, asked.reaction_s, can_stop=True, braking_m_s2=3.0)
                arrival_radius_m = 10.0
            for count in asked.count:
                for free in asked.free:
                    seeds, limits = range(asked.seeds), (asked.time_limit, asked.range_m, arrival_radius_m)
                    print(measure(name, count, free, rules, seeds, *limits), flush=True)


if __name__ == "__main__":
    main()
