"""What each autopilot does when its companion falls silent in flight: killed, hung, or its machine dead.

On the wire the three are one: no setpoint comes any more. Figures are docs/safety.md's.
"""

from __future__ import annotations

import math

import pytest

from companion.geo.kinematics import GRAVITY_M_S2
from tests.sim.vehicles.tracking import Flight

pytestmark = pytest.mark.slow

WATCHED_S = 60.0
STANDING_M_S = 0.3


def left_alone(flight: Flight, seconds: float = WATCHED_S) -> tuple[float, float | None, float]:
    """Return how far it got at most (m), after how long it stood still (s), and its change of height (m)."""
    last, farthest_m, stood_s = flight.vehicle.truth, 0.0, None
    for step in range(1, round(10 * seconds) + 1):
        flight.vehicle.step_to(flight.now_s + 0.1 * step)
        truth = flight.vehicle.truth
        farthest_m = max(farthest_m, math.hypot(truth.north_m - last.north_m, truth.east_m - last.east_m))
        if stood_s is None and truth.speed_m_s < STANDING_M_S:
            stood_s = 0.1 * step
    return farthest_m, stood_s, flight.vehicle.truth.altitude_m - last.altitude_m


def steered(kind: str, speed_m_s: float, parameters: dict[str, float], turning: bool, until_s: float = 16.0) -> Flight:
    flight = Flight(kind, speed_m_s)
    flight.vehicle.parameters.update(parameters)
    rate_rad_s = flight.adapter.abilities.n_max * GRAVITY_M_S2 / speed_m_s if turning else 0.0
    heading_rad = 0.0
    while flight.now_s < until_s:
        heading_rad += 0.5 * rate_rad_s
        flight.decide(heading_rad)
    return flight


HOLD = {"COM_OBL_RC_ACT": 5.0}


@pytest.mark.parametrize("turning", [False, True], ids=["straight on", "in a turn"])
@pytest.mark.parametrize(
    ("kind", "speed_m_s", "parameters", "within_m", "stands_after_s"),
    [
        ("arducopter", 8.0, {}, 40.0, 6.7),
        ("arducopter", 8.0, {"GUID_TIMEOUT": 1.0}, 24.0, 4.7),
        ("px4-copter", 10.0, HOLD, 35.0, 7.6),
    ],
)
def test_a_copter_whose_companion_fell_silent_stops_nearby(
    kind: str, speed_m_s: float, parameters: dict[str, float], within_m: float, stands_after_s: float, turning: bool
) -> None:
    farthest_m, stood_s, climbed_m = left_alone(steered(kind, speed_m_s, parameters, turning))
    assert farthest_m <= within_m
    assert stood_s is not None
    assert stood_s <= stands_after_s
    assert abs(climbed_m) < 1.0


@pytest.mark.parametrize("turning", [False, True], ids=["straight on", "in a turn"])
@pytest.mark.parametrize("until_s", [16.0, 17.0, 18.0, 19.0])
def test_an_arduplane_whose_companion_fell_silent_circles_nearby_whenever_it_was(turning: bool, until_s: float) -> None:
    farthest_m, _, climbed_m = left_alone(steered("arduplane", 22.0, {}, turning, until_s))
    assert farthest_m <= 150.0
    assert abs(climbed_m) < 5.0


@pytest.mark.parametrize("turning", [False, True], ids=["straight on", "in a turn"])
def test_a_px4_plane_whose_companion_fell_silent_circles_nearby(turning: bool) -> None:
    farthest_m, _, climbed_m = left_alone(steered("px4-plane", 15.0, HOLD, turning))
    assert farthest_m <= 100.0
    assert abs(climbed_m) < 5.0


def test_with_px4s_default_the_copter_sinks_and_the_plane_flies_on_which_is_why_5_is_demanded() -> None:
    copter_m, _, climbed_m = left_alone(steered("px4-copter", 10.0, {"COM_OBL_RC_ACT": 0.0}, False))
    assert copter_m > 50.0
    assert climbed_m < -20.0
    plane_m, _, _ = left_alone(steered("px4-plane", 15.0, {"COM_OBL_RC_ACT": 0.0}, False))
    assert plane_m > 800.0
