"""Passing obstacles that are smaller than a turn: arcs as wide as a turn that touch them on the side of the way.

A circle of the turn's radius about a small disc keeps far from it, and two of them close a gap that a vehicle could fly
through. A circle that has the disc inside it, and touches it where the way passes, bulges no farther into the gap than
the disc does. Where it touches follows from the way: on the line that halves the turn of the way there.
"""

from __future__ import annotations

import cmath
import itertools
import math
from typing import NamedTuple

from companion.guidance.route.scene import Scene, State, sweep_rad_of
from companion.guidance.route.search import chain_free, chains

ROUNDS = 5
"""Number of times the touching points are computed anew, each time along the way over the last ones."""
FEWEST_ROUNDS = 2
"""Number of times after which a free way is good enough if it is hardly longer than the rough one."""
HARDLY_LONGER = 1.005
"""Ratio to the length of the rough way up to which a way is hardly longer."""


class Tightened(NamedTuple):
    """What has become of a rough way, whose arcs have the discs' own radii."""

    scene: Scene
    chain: list[State]
    """The way, flyable and free; empty if none was found."""
    blamed: set[int]
    """The discs whose arcs could not be replaced, if none was found."""


def tightened(rough: Scene, chain: list[State], wide: Scene, tight: set[int]) -> Tightened:
    """Return the way that passes the same discs as a rough one, with arcs that touch those of `tight`.

    `wide` is the scene whose arcs are all wide enough to fly.
    """
    goal_node = rough.circles.goal_node
    passed = [(state.circle, state.side) for state in chain[:-1] if state.circle < goal_node]
    touch = {disc: towards for disc, towards in _middles(chain).items() if disc in tight}
    facing: dict[int, complex] = {}
    best: list[State] = []
    scene, blamed = wide, set(touch)
    for number in range(ROUNDS):
        scene_now = wide.touching({**touch, **facing})
        via = tuple(passed)
        shut = _apart(scene_now, via, facing)
        if shut:
            facing.update(shut)
            continue
        ways = chains(scene_now, via, chain[-1].side)
        if not ways:
            break
        way = ways[0]
        free = chain_free(scene_now, way)
        if free and (not best or way[-1].length_m < best[-1].length_m):
            best, scene = way, scene_now
        if best and number + 1 >= FEWEST_ROUNDS and best[-1].length_m <= HARDLY_LONGER * chain[-1].length_m:
            break
        if not free:
            blamed = _blamed(scene_now, way, tight) or blamed
        around = {
            (state.circle, state.side)
            for state, after in itertools.pairwise(way)
            if state.circle in tight and sweep_rad_of(state, after.heading_rad) > math.pi
        }
        passed = [node for node in passed if node not in around]
        middles = _middles(way)
        touch = {disc: middles.get(disc, towards) for disc, towards in touch.items()}
    return Tightened(scene, best, blamed)


def _middles(chain: list[State]) -> dict[int, complex]:
    """Return the direction from each circle's centre to the middle of the way's arc on it."""
    return {
        state.circle: cmath.rect(1.0, state.angle_rad + 0.5 * state.side * sweep_rad_of(state, after.heading_rad))
        for state, after in itertools.pairwise(chain)
    }


def _apart(scene: Scene, via: tuple[tuple[int, int], ...], facing: dict[int, complex]) -> dict[int, complex]:
    """Return directions that part neighbours without a tangent: to each other, in which they always have one."""
    found: dict[int, complex] = {}
    for first, second in itertools.pairwise(via):
        if first[1] == second[1] or scene.circles.tangent(*first, *second) is not None:
            continue
        towards = complex(scene.centre[second[0]] - scene.centre[first[0]])
        for disc, sign in ((first[0], 1.0), (second[0], -1.0)):
            if disc in scene.circles.touch and disc not in facing and towards:
                found[disc] = sign * towards / abs(towards)
    return found


def _blamed(scene: Scene, chain: list[State], tight: set[int]) -> set[int]:
    """Return the discs of `tight` at the ends of those parts of a way that are not free."""
    blamed: set[int] = set()
    for index in range(len(chain) - 1):
        ends = {chain[index].circle, chain[index + 1].circle} & tight
        if ends - blamed and not chain_free(scene, chain[index : index + 2]):
            blamed |= ends
    return blamed
