"""The scenes in which guidance laws are compared: families of missions, each drawn from a seed.

A mission depends on its family, seed and index alone; it is resolved, and `sim fly` can fly it. Places are chosen by
geometry only; no route is planned and no law is flown for it. Whether a mission is feasible is decided by the planner
(`sim.arena.planner`).

Most missions of the CLASSIC families are feasible. Their lengths are modest so that one flight takes a few hundred
guidance steps: vehicles of 25 m/s, discs of 200 to 1000 m. Those of the field (`sim.arena.families.field`) have every
size, speed, step and link that a mission may have.
"""

from __future__ import annotations

import zlib

from companion.errors import InputError
from companion.mission.model import Mission
from companion.mission.random_streams import random_stream
from companion.mission.resolve import check_start
from sim.arena.families import fleets, movers, packaged, standing
from sim.arena.families.drawing import TRIES, Family, NoRoomError
from sim.arena.families.field import FIELD

ARENA_STREAM = 11
"""Number of the random stream, among those of the seed, that arena scenes are drawn from."""


def draw(family: str, seed: int, index: int, interaction_radius_m: float | None = None) -> Mission:
    """Return mission `index` of a family: resolved, its start legal, the same for the same arguments.

    Where a family has several agents they start at least the interaction radius apart: that of the right-of-way rule at
    their own load factor, or the given one. Where the scene would grow too wide for a short flight, there are fewer
    agents.

    Raises KeyError for an unknown family, RuntimeError if no scene was found within TRIES draws.
    """
    generator = random_stream(seed, ARENA_STREAM, zlib.crc32(family.encode()), index)
    for _ in range(TRIES):
        try:
            mission = FAMILIES[family].draw(generator, f"{family}-{seed}-{index}", interaction_radius_m)
            check_start(mission, mission.name)
        except (NoRoomError, InputError):
            continue
        return mission
    raise RuntimeError(f"{family}: no scene in {TRIES} draws")


CLASSIC: dict[str, Family] = {
    "paper": Family(
        "The paper's scenes",
        "200 km square, 10 agents, 5 targets, 4 threats of 10 km, as packaged, static or walking; targets clear of "
        "every disc grown to the end.",
        "the published setting: assignment, few obstacles, no turn limit that matters",
        8,
        False,
        False,
        packaged.paper,
        True,
    ),
    "dense": Family(
        "Dense",
        "One agent among 10 to 60 static discs that may overlap and cover 15 to 60 % of a 5 km box.",
        "the whole map at once: where gaps close, local repulsion traps",
        100,
        True,
        True,
        standing.dense,
        False,
    ),
    "traps": Family(
        "Traps",
        "A U, a spiral or a corridor with a dead end of overlapping static discs between one agent and its target.",
        "that the way out leads away from the target",
        75,
        True,
        True,
        standing.traps,
        False,
    ),
    "moving": Family(
        "Moving threats",
        "One agent and 3 to 8 threats of 0.1 to 0.7 of its speed: straight, circling, random or chasing.",
        "the threats' speed bounds and ages, not only where they were",
        100,
        False,
        True,
        movers.moving,
        False,
    ),
    "tight": Family(
        "Tight turns",
        "One agent whose turn radius is 0.05 to 1 of R_d, among 8 to 25 equal static discs.",
        "the turn limit before the obstacle is near",
        75,
        True,
        True,
        standing.tight,
        False,
    ),
    "stale": Family(
        "Stale picture",
        "Broadcasts every 5 to 30 s over a link that loses in bursts; one agent, 4 to 10 threats of up to 0.2 of its "
        "speed.",
        "how old each position is",
        65,
        False,
        True,
        movers.stale,
        False,
    ),
    "wind": Family(
        "Wind",
        "One agent in wind and gusts of 0.1 to a third of its speed, among 8 to 20 static discs.",
        "the wind's bound in the turn radius over the ground",
        41,
        True,
        True,
        standing.wind,
        False,
    ),
    "swarm": Family(
        "Swarm",
        "10 to 50 agents crossing: around a circle, as two streams, at random; with no or a few discs.",
        "the other agents: who gives way to whom",
        12,
        True,
        False,
        fleets.swarm,
        True,
    ),
    "losses": Family(
        "Losses",
        "6 to 12 agents for 3 or 4 targets among 2 to 6 static discs; 2 and more of them are lost at random times.",
        "that nobody else will cover the target of a lost agent",
        12,
        True,
        False,
        fleets.losses,
        True,
    ),
    "caseII": Family(
        "Case II",
        "4 to 8 agents for 3 or 4 targets among static discs; the centre does not detect them, they may report.",
        "peers from the own detector alone",
        12,
        True,
        False,
        fleets.case_two,
        True,
    ),
}
"""The families that are drawn to be feasible, by name: modest lengths, one speed, open ground."""

FAMILIES: dict[str, Family] = {**CLASSIC, **FIELD}
"""All families by name, in the order in which tables list them."""
