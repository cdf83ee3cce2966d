"""A copter in a wind that takes more lean than it has stays at its place, where its setpoints once led it away.

The scene has nothing of the companion's own words in it, so that it can be flown with any companion: before the limit
was walked by the command, the same copter flew on for 840 to 1130 m in 160 s after it had arrived.
"""

from __future__ import annotations

import math

import pytest

from companion.mission.model import Mission
from companion.mission.resolve import resolve
from sim.faults.flight import Flight
from sim.faults.scene import Setting

pytestmark = pytest.mark.slow

KIND, CRUISE_M_S, ARRIVAL_M = "arducopter", 8.0, 20.0
COURSE_DEG, WAY_M = 64.0, 400.0
WIND_M_S = 5.0
"""Against it 8 m/s over ground take 13 m/s through the air; a lean of 30 degrees reaches 10.3."""
WATCHED_S = 80.0
TARGET_M = WAY_M * math.cos(math.radians(COURSE_DEG)), WAY_M * math.sin(math.radians(COURSE_DEG))


def scene() -> Mission:
    target = {"id": 1, "north_m": TARGET_M[0], "east_m": TARGET_M[1], "speed_bound_m_s": 0.0}
    agent = {"id": 1, "north_m": 0.0, "east_m": 0.0, "heading_deg": COURSE_DEG, "height_m": 30.0}
    return resolve(
        Mission.model_validate(
            {
                "name": "wind",
                "fence": [[-3000, -3000], [-3000, 3000], [3000, 3000], [3000, -3000]],
                "agents": [agent | {"speed_m_s": CRUISE_M_S, "n_max": 0.178}],
                "targets": [target],
                "threats": [],
                "broadcast_period_s": 1.0,
                "assignment_period_s": 5.0,
                "integration_step_s": 0.1,
                "arrival_radius_m": ARRIVAL_M,
                "scale": {"autopilot": KIND, "factor": 1.0},
            }
        ),
        1,
    )


def farthest_after_arrival_m(from_deg: float) -> float:
    """Return the greatest distance to the target within WATCHED_S after arriving; nobody told of the wind."""
    flight = Flight(Setting(KIND, scene(), heading_deg=COURSE_DEG))
    from_rad = math.radians(from_deg)
    flight.faulty.set_wind((-WIND_M_S * math.cos(from_rad), -WIND_M_S * math.sin(from_rad)))
    log = flight.run(1.6 * WAY_M / CRUISE_M_S + WATCHED_S)
    away_m = [math.dist((moment.north_m, moment.east_m), TARGET_M) for moment in log.moments]
    arrived = next(index for index, metres in enumerate(away_m) if metres < ARRIVAL_M)
    return max(away_m[arrived:])


@pytest.mark.parametrize("from_deg", [0.0, 270.0])
def test_a_copter_in_a_wind_beyond_its_lean_stays_where_it_arrived(from_deg: float) -> None:
    assert farthest_after_arrival_m(from_deg) < 2.0 * ARRIVAL_M
