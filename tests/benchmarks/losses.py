"""Losing 1 to 6 agents at random times in `paper-dynamic`: targets stay covered while there are enough agents.

`python tests/benchmarks/losses.py [--runs 100]` (kinematic simulator; about ten minutes on two cores). At every step of
every flight, once the ground station knows of a loss, the rule is checked on the broadcast that it would send: with at
least as many agents on their way as open targets each target has an agent; with fewer, each agent has a target, and the
targets without one are named.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial

import numpy as np

from companion.mission.model import Loss, Mission, load_mission
from companion.mission.random_streams import random_stream
from companion.mission.resolve import resolve
from groundstation.ground_station import GroundStation
from sim.lockstep import FlightOptions, fly
from sim.score import score

LOSS_STREAM = 5
"""Number of the random stream, among those of the seed, that decides which agents are lost when."""
LATEST_LOSS_S = 1000.0
"""Latest time at which an agent is lost; most flights are over after 1000 to 1500 s."""
MOST_LOST = 6


@dataclass(frozen=True)
class Outcome:
    """Figures of one flight with losses."""

    lost: int
    known: int
    steps_checked: int
    steps_short: int
    """Number of steps with fewer agents on their way than open targets."""
    broken: tuple[str, ...]
    targets_reached: int


def with_losses(mission: Mission, seed: int) -> Mission:
    """Return the mission with 1 to 6 random agents lost at random times."""
    generator = random_stream(seed, LOSS_STREAM)
    count = int(generator.integers(1, MOST_LOST + 1))
    agents = generator.choice([agent.id for agent in mission.agents], count, replace=False).tolist()
    losses = tuple(Loss(agent=agent, t_s=float(generator.uniform(0.0, LATEST_LOSS_S))) for agent in agents)
    return mission.model_copy(update={"losses": losses})


def flown(seed: int, limit_s: float) -> Outcome:
    """Fly one seed with losses and check the rule at every step."""
    drawn = resolve(load_mission("paper-dynamic"), seed)
    mission = with_losses(drawn.model_copy(update={"max_time_s": min(limit_s, drawn.max_time_s)}), seed)
    broken: list[str] = []
    known = checked = short = 0

    def watch(t_s: float, ground: GroundStation, agents: np.ndarray) -> None:
        nonlocal known, checked, short
        picture = ground.tracks
        active, open_targets = picture.active_agents, picture.open_targets
        known = max(known, len(picture.progress.lost))
        uncovered = set(open_targets) - set(ground.assignment.values())
        checked += 1
        short += len(active) < len(open_targets)
        idle = set(active) - ground.assignment.keys()
        if set(ground.assignment) & picture.progress.lost:
            broken.append(f"{t_s:g} s: a lost agent is assigned")
        if len(active) >= len(open_targets) and uncovered:
            broken.append(f"{t_s:g} s: {len(active)} agents, uncovered {sorted(uncovered)}")
        if len(active) < len(open_targets) and idle:
            broken.append(f"{t_s:g} s: targets uncovered, agents {sorted(idle)} idle")
        if set(ground.uncovered) != uncovered:
            broken.append(f"{t_s:g} s: uncovered {sorted(uncovered)}, named {sorted(ground.uncovered)}")

    scored = score(fly(mission, seed, FlightOptions(watch=watch)).trajectory, mission)
    return Outcome(len(mission.losses), known, checked, short, tuple(broken), scored.targets_reached)


def main() -> None:
    """Fly all runs and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--time-limit", type=float, default=math.inf, help="s of virtual time, of each flight")
    options = parser.parse_args()
    runs = options.runs
    with ProcessPoolExecutor() as pool:
        outcomes = list(pool.map(partial(flown, limit_s=options.time_limit), range(1, runs + 1)))
    print("lost  runs  known in flight  steps checked  fewer agents than targets  rule broken  targets reached (mean)")
    for lost, count in sorted(Counter(outcome.lost for outcome in outcomes).items()):
        those = [outcome for outcome in outcomes if outcome.lost == lost]
        print(
            f"{lost:4d} {count:5d} {sum(o.known for o in those):16d} {sum(o.steps_checked for o in those):14d} "
            f"{sum(o.steps_short for o in those):26d} {sum(bool(o.broken) for o in those):12d} "
            f"{np.mean([o.targets_reached for o in those]):23.2f}"
        )
    for seed, outcome in enumerate(outcomes, start=1):
        for line in outcome.broken[:1]:
            print(f"seed {seed}: {line}")
    print(f"the rule held in {sum(not outcome.broken for outcome in outcomes)} of {runs} runs")


if __name__ == "__main__":
    main()
