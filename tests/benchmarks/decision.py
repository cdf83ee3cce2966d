"""What one decision costs with 4, 25 and 100 threats, every law in the same run: `python tests/benchmarks/decision.py`.

One agent flies through static and through moving threats, hearing a broadcast every five seconds; what is timed is the
companion's whole tick (picture, law, right of way, turn limit, guard), the steps of a new broadcast among them. Machines
differ and are noisy: compare with the paper's law on the same row, timed in turn on the same missions.
"""

from __future__ import annotations

import sys

import numpy as np

from companion.drawing import resolve
from companion.mission import AgentSpec, Defaults, Draw, Mission, TargetSpec, ThreatDefaults
from sim.arena.peers import PEERS, SLOW
from sim.arena.run import OWN_LAWS, fly_law

THREATS = (4, 25, 100)
SCENES = 4
SIDE_M = 20_000.0
COVER = 0.25
"""Share of the ground that the discs would cover if none overlapped."""


def scene(threats: int, speed_m_s: float, seed: int) -> Mission:
    """Return one agent with its target across a square of threats."""
    radius_m = (COVER * SIDE_M**2 / (threats * np.pi)) ** 0.5
    mission = Mission(
        name=f"{threats} threats",
        area_m={"north": SIDE_M, "east": SIDE_M},
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
        max_time_s=1_000.0,
    )
    return resolve(mission, seed)


def main() -> None:
    """Print the table; arguments restrict it to the laws named."""
    laws = sys.argv[1:] or [law for law in (*OWN_LAWS, *PEERS) if law not in SLOW]
    print(
        f"{'threats':>7s} {'motion':7s} {'law':12s} {'median us':>10s} {'p99 us':>10s} {'max us':>10s} {'x seed':>7s}"
    )
    for threats in THREATS:
        for speed_m_s in (0.0, 2.5):
            times_us: dict[str, list[np.ndarray]] = {law: [] for law in laws}
            for seed in range(1, SCENES + 1):
                mission = scene(threats, speed_m_s, seed)
                for law in laws:
                    times_us[law].append(fly_law(mission, seed, law).decision_us)
            base_us = np.median(np.concatenate(times_us["seed"])) if "seed" in laws else np.nan
            for law in laws:
                us = np.concatenate(times_us[law])
                print(
                    f"{threats:7d} {'random' if speed_m_s else 'static':7s} {law:12s} {np.median(us):10.0f} "
                    f"{np.percentile(us, 99):10.0f} {us.max():10.0f} {np.median(us) / base_us:7.2f}"
                )


if __name__ == "__main__":
    main()
