"""What the radio's losses cost a flight: `python tests/benchmarks/loss_sweep.py [--runs 4] [--mission paper-dynamic]`.

It flies `sim fly` at 0 to 95 % loss, independent and in bursts (Gilbert-Elliott; kinematic simulator). For each level
it prints how long an agent waits for its first whole picture, how old a picture became, in which stages the companions
were, whether every target was reached, and how often an agent entered a detection disc. It takes several minutes on two
cores.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from companion.mission.model import Burst, LinkSpec, load_mission
from companion.mission.resolve import resolve
from companion.onboard.companion import Companion
from companion.onboard.decision import Decision
from companion.onboard.failsafe import Stage
from sim.lockstep import FlightOptions, fly
from sim.loop import START_S
from sim.score import score

MEAN_BURST_FRAMES = 20.0
"""Mean length of the bursts, in which every frame is lost; they begin as often as the share of losses asked for
needs."""
LEVELS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.95)


@dataclass(frozen=True)
class Outcome:
    """Figures of one flight at one level of loss."""

    current_s: tuple[float, ...]
    """Time of each agent's first picture, infinite where it never had one."""
    oldest_s: float
    stages: Counter[Stage]
    reached: int
    targets: int
    entries_detection: int


def link(loss: float, bursty: bool) -> LinkSpec:
    """Return a link that loses a share `loss` of the frames on average."""
    if not bursty or loss == 0.0:
        return LinkSpec(loss=loss)
    leave = 1.0 / MEAN_BURST_FRAMES
    return LinkSpec(burst=Burst(enter=min(1.0, leave * loss / (1.0 - loss)), leave=leave))


def flown(name: str, seed: int, limit_s: float, loss: float, bursty: bool) -> Outcome:
    """Fly one seed at one level of loss."""
    mission = resolve(load_mission(name), seed)
    changes = {"link": link(loss, bursty), "max_time_s": min(limit_s, mission.max_time_s)}
    mission = mission.model_copy(update=changes)
    first_s = {agent.id: np.inf for agent in mission.agents}
    stages: Counter[Stage] = Counter()
    oldest_s = 0.0
    tick = Companion.tick

    def watched(self: Companion, now_s: float) -> tuple[Decision, list[bytes]]:
        nonlocal oldest_s
        decision, frames = tick(self, now_s)
        stages[decision.stage] += 1
        if decision.picture_age_s is not None:
            first_s[self.config.agent_id] = min(first_s[self.config.agent_id], now_s - START_S)
            oldest_s = max(oldest_s, decision.picture_age_s)
        return decision, frames

    Companion.tick = watched  # type: ignore[method-assign]
    try:
        scored = score(fly(mission, seed, FlightOptions(law="routed")).trajectory, mission)
    finally:
        Companion.tick = tick  # type: ignore[method-assign]
    return Outcome(
        tuple(first_s.values()),
        oldest_s,
        stages,
        scored.targets_reached,
        len(mission.targets),
        scored.threat_entries_detection,
    )


def main() -> None:
    """Fly every level and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=4)
    parser.add_argument("--mission", default="paper-dynamic")
    parser.add_argument("--levels", type=float, nargs="+", default=LEVELS, help="shares of the frames lost")
    parser.add_argument("--time-limit", type=float, default=math.inf, help="s of virtual time, of each flight")
    given = parser.parse_args()
    levels = [(loss, bursty) for bursty in (False, True) for loss in given.levels if loss > 0.0 or not bursty]
    print(
        "loss            first picture s: mean   worst   oldest s     fresh  coasting loitering returning   reached"
        "  R_d entries"
    )
    with ProcessPoolExecutor() as pool:
        jobs = {
            level: [
                pool.submit(flown, given.mission, seed, given.time_limit, *level) for seed in range(1, given.runs + 1)
            ]
            for level in levels
        }
        for (loss, bursty), flights in jobs.items():
            outcomes = [flight.result() for flight in flights]
            current_s = np.array([s for outcome in outcomes for s in outcome.current_s])
            stages = sum((outcome.stages for outcome in outcomes), Counter[Stage]())
            shares = [stages[stage] / stages.total() for stage in Stage]
            kind = "in bursts" if bursty else "each"
            print(
                f"{loss:5.0%} {kind:10s}{current_s.mean():21.1f} {current_s.max():7.1f} "
                f"{max(outcome.oldest_s for outcome in outcomes):10.1f} "
                + " ".join(f"{share:9.1%}" for share in shares)
                + f" {sum(o.reached for o in outcomes):5d}/{sum(o.targets for o in outcomes)}"
                f" {sum(o.entries_detection for o in outcomes):10d}",
                flush=True,
            )


if __name__ == "__main__":
    main()
