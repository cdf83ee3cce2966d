"""How soon the copters' stand-ins stand after they arrive, and where: `python -m tests.benchmarks.standing`.

Each flies to a target 400 m away and is watched for 40 s after its arrival. docs/autopilots.md has the table.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

from companion.guidance.approach import STANDING_M_S
from companion.mission.model import Mission
from companion.mission.resolve import resolve
from companion.onboard.decision import Purpose
from sim.faults.flight import Flight
from sim.faults.log import Moment
from sim.faults.scene import HEIGHT_M, LOOP_PERIOD_S, Setting

TARGET_M = 400.0
WATCHED_S = 40.0
"""Time for which a vehicle is watched after it has arrived."""
LONGEST_S = 200.0
SETTLED_S = 15.0
"""Time after the arrival from which a vehicle must stand."""
N_MAX = 0.178
"""Load factor that both copters' parameters leave."""
FLIGHTS = (
    ("arducopter", 5.0, 8.0, 0.0),
    ("arducopter", 20.0, 8.0, 0.0),
    ("arducopter", 60.0, 8.0, 0.0),
    ("arducopter", 20.0, 5.5, 4.0),
    ("px4-copter", 5.0, 10.0, 0.0),
    ("px4-copter", 20.0, 10.0, 0.0),
    ("px4-copter", 60.0, 10.0, 0.0),
    ("px4-copter", 20.0, 8.0, 4.0),
)
"""Kind of autopilot, arrival radius (m), speed and wind (m/s) of each flight; wind blows from ahead."""


class Stood(NamedTuple):
    """What a vehicle did after its arrival."""

    after_s: float
    """Time until it stands for good."""
    held_m: float
    """Greatest distance from the target from SETTLED_S on."""
    widest_m: float
    """Greatest distance from the target."""


def mission(arrival_radius_m: float, speed_m_s: float, wind_m_s: float) -> Mission:
    """Return the mission of one copter and a target north of it, in a wind from ahead."""
    side_m = 3_000.0
    data = {
        "name": "standing",
        "fence": [[-side_m, -side_m], [-side_m, side_m], [side_m, side_m], [side_m, -side_m]],
        "agents": [
            {"id": 1, "north_m": 0.0, "east_m": 0.0, "heading_deg": 0.0, "height_m": HEIGHT_M}
            | {"speed_m_s": speed_m_s, "n_max": N_MAX}
        ],
        "targets": [{"id": 1, "north_m": TARGET_M, "east_m": 0.0, "speed_bound_m_s": 0.0}],
        "broadcast_period_s": 1.0,
        "assignment_period_s": 5.0,
        "integration_step_s": LOOP_PERIOD_S,
        "arrival_radius_m": arrival_radius_m,
        "separation_m": 20.0,
        "wind": {"from_deg": 0.0, "speed_m_s": wind_m_s},
    }
    return resolve(Mission.model_validate(data), 1)


def arrived(kind: str, arrival_radius_m: float, speed_m_s: float, wind_m_s: float) -> Sequence[Moment]:
    """Fly to the target and return the moments from the first decision to loiter on.

    Raises:
        RuntimeError: the vehicle does not arrive.

    """
    flight = Flight(Setting(kind, mission(arrival_radius_m, speed_m_s, wind_m_s)))
    flight.vehicle.wind_m_s = (-wind_m_s, 0.0)
    for second in itertools.takewhile(lambda second: second < LONGEST_S, itertools.count(1)):
        moments = flight.run(float(second)).moments
        begins_s = next((moment.t_s for moment in moments if moment.purpose is Purpose.LOITER), math.inf)
        if begins_s + WATCHED_S <= second:
            return [moment for moment in moments if moment.t_s >= begins_s]
    raise RuntimeError(f"{kind} does not arrive within {LONGEST_S:g} s")


def stood(moments: Sequence[Moment]) -> Stood:
    """Return what a vehicle did after its arrival, the first of the moments."""
    begins_s = moments[0].t_s
    moving_s = max((moment.t_s for moment in moments if moment.speed_m_s >= STANDING_M_S), default=begins_s)
    away_m = [math.dist((moment.north_m, moment.east_m), (TARGET_M, 0.0)) for moment in moments]
    held_m = [away for moment, away in zip(moments, away_m, strict=True) if moment.t_s >= begins_s + SETTLED_S]
    return Stood(moving_s + LOOP_PERIOD_S - begins_s, max(held_m), max(away_m))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help="only these")
    kinds = parser.parse_args().kinds
    print("kind        radius  speed   wind    stands after  held within  widest")
    for kind, radius_m, speed_m_s, wind_m_s in (one for one in FLIGHTS if not kinds or one[0] in kinds):
        found = stood(arrived(kind, radius_m, speed_m_s, wind_m_s))
        print(
            f"{kind:11s} {radius_m:4.0f} m {speed_m_s:4.1f} m/s {wind_m_s:3.0f} m/s "
            f"{found.after_s:8.1f} s {found.held_m:9.1f} m {found.widest_m:9.1f} m"
        )


if __name__ == "__main__":
    main()
