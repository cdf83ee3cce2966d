"""What one decision costs with 4, 25 and 100 threats, every law in the same run: `python tests/benchmarks/decision.py`.

One agent flies through static and through moving threats and receives a broadcast every five seconds. Timed are the
companion's whole tick (picture, law, right of way, turn limit, guard) and, within it, law and guard alone; the steps
after a new broadcast are included. With the paper's law and the published methods the guard keeps only R_a, so it costs
them little. Machines differ and are noisy: compare with the paper's law on the same row, timed in turn on the same
missions.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from companion.guard.guard import Guard
from companion.guidance.laws import SteeringLaw, law_of
from companion.guidance.settings import LawName, LawSettings
from companion.mission.model import AgentSpec, Area, Defaults, Draw, Mission, TargetSpec, ThreatDefaults
from companion.mission.resolve import resolve
from sim.arena.flight import fly_arena
from sim.arena.peers import PEERS, SLOW
from sim.arena.run import OWN_LAWS

THREATS = (4, 25, 100)
SCENES = 4
TIME_LIMIT_S = 1_000.0
SIDE_M = 20_000.0
COVER = 0.25
"""Share of the ground that the discs would cover if none overlapped."""


def scene(threats: int, speed_m_s: float, seed: int) -> Mission:
    """Return the mission of one agent whose target lies across a square of threats."""
    radius_m = (COVER * SIDE_M**2 / (threats * np.pi)) ** 0.5
    mission = Mission(
        name=f"{threats} threats",
        area_m=Area(north=SIDE_M, east=SIDE_M),
        agents=(
            AgentSpec(id=1, north_m=-0.1 * SIDE_M, east_m=0.5 * SIDE_M, heading_deg=0.0, speed_m_s=25.0, n_max=1.0),
        ),
        targets=(TargetSpec(id=1, north_m=1.1 * SIDE_M, east_m=0.5 * SIDE_M, speed_bound_m_s=0.0),),
        draw=Draw(threats=threats),
        defaults=Defaults(
            threat=ThreatDefaults(
                detection_radius_m=radius_m,
                attack_radius_m=0.5 * radius_m,
                speed_bound_m_s=speed_m_s,
                motion="random" if speed_m_s else "static",
            )
        ),
        arrival_radius_m=100.0,
        separation_m=40.0,
        max_time_s=TIME_LIMIT_S,
    )
    return resolve(mission, seed)


class Stopwatch:
    """Adds up the time spent in functions that it wraps."""

    def __init__(self) -> None:
        self.spent_ns = 0

    def timed(self, call: Callable[..., Any]) -> Callable[..., Any]:
        """Return a function that does the same and adds its time to the sum."""

        def wrapped(*given: Any, **named: Any) -> Any:  # noqa: ANN401
            began_ns = time.perf_counter_ns()
            try:
                return call(*given, **named)
            finally:
                self.spent_ns += time.perf_counter_ns() - began_ns

        return wrapped


def fly_timed(mission: Mission, seed: int, law: str) -> tuple[np.ndarray, np.ndarray]:  # (D,) us, (D,) us
    """Return the times of every whole tick, and those of law and guard within it."""
    watch = Stopwatch()
    parts_us: list[float] = []
    check, timed_check = Guard.check, watch.timed(Guard.check)

    def decided(*given: Any, **named: Any) -> Any:  # noqa: ANN401
        verdict = timed_check(*given, **named)
        parts_us.append(watch.spent_ns / 1000.0)
        watch.spent_ns = 0
        return verdict

    def steering(settings: LawSettings) -> SteeringLaw:
        made: Any = PEERS[law](settings) if law in PEERS else law_of(settings)
        made.steer = watch.timed(made.steer)
        steered: SteeringLaw = made
        return steered

    own: LawName = "routed" if law == "routed" else "seed"
    Guard.check = decided  # type: ignore[method-assign]
    try:
        ticks_us = fly_arena(mission, seed, own, steering).decision_us
    finally:
        Guard.check = check  # type: ignore[method-assign]
    return ticks_us, np.array(parts_us)


def main() -> None:
    """Time every law in every scene and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("laws", nargs="*", metavar="LAW", help="only these; all but the slow ones if none is named")
    parser.add_argument("--threats", type=int, nargs="+", default=THREATS)
    parser.add_argument("--scenes", type=int, default=SCENES, help="of each kind")
    parser.add_argument("--time-limit", type=float, default=TIME_LIMIT_S, help="s of virtual time in each")
    options = parser.parse_args()
    laws = options.laws or [law for law in (*OWN_LAWS, *PEERS) if law not in SLOW]
    columns = ("tick med us", "p99", "max", "law+guard med", "p99", "max", "x seed")
    print(f"{'threats':>7s} {'motion':7s} {'law':12s}" + "".join(f"{column:>15s}" for column in columns))
    for threats in options.threats:
        for speed_m_s in (0.0, 2.5):
            times_us: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {law: [] for law in laws}
            for seed in range(1, options.scenes + 1):
                mission = scene(threats, speed_m_s, seed).model_copy(update={"max_time_s": options.time_limit})
                for law in laws:
                    times_us[law].append(fly_timed(mission, seed, law))
            base_us = np.median(np.concatenate([part for _, part in times_us["seed"]])) if "seed" in laws else np.nan
            for law in laws:
                tick_us, part_us = (np.concatenate(times) for times in zip(*times_us[law], strict=True))
                figures = [
                    f"{figure:15.0f}"
                    for us in (tick_us, part_us)
                    for figure in (np.median(us), np.percentile(us, 99), us.max())
                ]
                motion = "random" if speed_m_s else "static"
                print(
                    f"{threats:7d} {motion:7s} {law:12s}{''.join(figures)}{np.median(part_us) / base_us:15.2f}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
