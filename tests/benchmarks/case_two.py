"""Case II on `paper-dynamic`: how far off dead reckoning is, and how the flights end.

`python tests/benchmarks/case_two.py [--seeds 20] [--error-seeds 5]` (kinematic simulator; a quarter of an hour on two
cores). It prints first the distance between where the ground station reckons its agents and where they are, over the
agents on their way, with and without wind, with reports never, every 300 s and every 60 s; then the flights without
wind and reports, seed by seed.
"""

from __future__ import annotations

import argparse
import math
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from companion.mission.model import Mission, Wind, load_mission
from companion.mission.resolve import resolve
from companion.protocol.codec import Kind
from groundstation.ground_station import GroundStation
from sim.lockstep import FlightOptions, fly
from sim.score import score

REPORT_PERIODS_S = (0.0, 300.0, 60.0)
WINDS = (Wind(), Wind(from_deg=270.0, speed_m_s=10.0, gust_m_s=5.0))
TIMES_S = (100.0, 200.0, 400.0, 600.0, 800.0, 1000.0)
WINDOW_S = 25.0
"""Greatest time between a sample and a time of TIMES_S at which the sample's error is counted."""


@dataclass(frozen=True)
class Outcome:
    """One flight: its figures, and the errors of dead reckoning."""

    seed: int
    targets_reached: int
    targets: int
    entries: int
    breaches: int
    min_separation_m: float
    flight_time_s: float
    t_s: np.ndarray  # (S,)
    mean_m: np.ndarray  # (S,) over the agents on their way
    worst_m: np.ndarray  # (S,)
    beyond_uncertainty: float
    """Share of the errors that are greater than the uncertainty that the ground station states."""


def case_two(seed: int, report_period_s: float, wind: Wind, limit_s: float) -> Mission:
    """Return `paper-dynamic` as Case II."""
    paper = load_mission("paper-dynamic")
    changes = {"case": "II", "report_period_s": report_period_s, "wind": wind}
    return resolve(paper.model_copy(update=changes | {"max_time_s": min(limit_s, paper.max_time_s)}), seed)


def flown(seed: int, report_period_s: float, wind: Wind, limit_s: float) -> Outcome:
    """Fly one seed and compare the reckoned positions with the true ones at every step."""
    mission = case_two(seed, report_period_s, wind, limit_s)
    rows: list[tuple[float, float, float]] = []
    beyond: list[bool] = []

    def watch(t_s: float, ground: GroundStation, agents: np.ndarray) -> None:
        picture, errors_m = ground.tracks, []
        for index, agent in enumerate(mission.agents):
            if agent.id in picture.active_agents:
                track = picture.tracks[Kind.AGENT, agent.id]
                errors_m.append(float(np.hypot(track.north_m - agents[index, 0], track.east_m - agents[index, 1])))
                beyond.append(errors_m[-1] > picture.uncertainty_m[agent.id])
        if errors_m:
            rows.append((t_s, float(np.mean(errors_m)), max(errors_m)))

    scored = score(fly(mission, seed, FlightOptions(watch=watch)).trajectory, mission)
    t_s, mean_m, worst_m = np.array(rows).T
    return Outcome(
        seed,
        scored.targets_reached,
        scored.targets,
        scored.threat_entries_detection,
        scored.separation_breaches,
        scored.min_separation_m or np.inf,
        scored.flight_time_s,
        t_s,
        mean_m,
        worst_m,
        float(np.mean(beyond)),
    )


def print_errors(outcomes: list[Outcome]) -> None:
    """Print the mean and worst error about each time, over the flights that lasted until then."""
    cells = []
    for time_s in TIMES_S:
        near = [np.abs(outcome.t_s - time_s) <= WINDOW_S for outcome in outcomes]
        means = np.concatenate([outcome.mean_m[mask] for outcome, mask in zip(outcomes, near, strict=True)])
        worst = np.concatenate([outcome.worst_m[mask] for outcome, mask in zip(outcomes, near, strict=True)])
        cells.append(f"{np.mean(means):7.0f} /{np.max(worst):7.0f}" if means.size else f"{'-':>16}")
    print("  " + " ".join(cells), flush=True)


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--error-seeds", type=int, default=5)
    parser.add_argument("--time-limit", type=float, default=math.inf, help="s of virtual time, of each flight")
    options = parser.parse_args()
    limit_s = options.time_limit
    with ProcessPoolExecutor() as pool:
        print("error of the reckoning, mean / worst m, over", options.error_seeds, "flights; time s:")
        print("  " + " ".join(f"{time_s:16.0f}" for time_s in TIMES_S))
        for wind in WINDS:
            for period_s in REPORT_PERIODS_S:
                said = f"every {period_s:.0f} s" if period_s else "never"
                runs = [pool.submit(flown, seed, period_s, wind, limit_s) for seed in range(1, options.error_seeds + 1)]
                outcomes = [run.result() for run in runs]
                beyond = np.mean([outcome.beyond_uncertainty for outcome in outcomes])
                reached = sum(outcome.targets_reached for outcome in outcomes)
                print(
                    f"wind {wind.speed_m_s:g} m/s, gusts {wind.gust_m_s:g} m/s; reports {said}; targets reached "
                    f"{reached} of {sum(outcome.targets for outcome in outcomes)}; "
                    f"{100 * beyond:.2f} % of errors above the uncertainty"
                )
                print_errors(outcomes)
        print("\nflights without wind or reports: seed, targets reached, R_d entries, breaches, least separation, time")
        for run in [pool.submit(flown, seed, 0.0, WINDS[0], limit_s) for seed in range(1, options.seeds + 1)]:
            outcome = run.result()
            print(
                f"{outcome.seed:4d} {outcome.targets_reached:3d} of {outcome.targets} {outcome.entries:3d} "
                f"{outcome.breaches:3d} {outcome.min_separation_m:9.1f} m {outcome.flight_time_s:7.0f} s",
                flush=True,
            )


if __name__ == "__main__":
    main()
