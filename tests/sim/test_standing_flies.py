"""The copters' stand-ins stand at their target soon after they arrive, also in wind, and stay there."""

from __future__ import annotations

import pytest

from tests.benchmarks.standing import arrived, stood

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("kind", "radius_m", "speed_m_s", "wind_m_s"),
    [("arducopter", 20.0, 8.0, 0.0), ("arducopter", 5.0, 5.5, 4.0), ("px4-copter", 20.0, 8.0, 4.0)],
)
def test_a_copter_stands_at_its_target_soon_and_flies_no_wider_than_it_arrived(
    kind: str, radius_m: float, speed_m_s: float, wind_m_s: float
) -> None:
    found = stood(arrived(kind, radius_m, speed_m_s, wind_m_s))
    assert found.after_s <= 15.0
    assert found.held_m <= 3.0
    assert found.widest_m <= radius_m
