"""Where the vehicle is on the plane of the picture, and how far it has flown."""

from __future__ import annotations

from dataclasses import replace

import pytest

from companion.autopilot.telemetry import Telemetry
from companion.geo.local_frame import LocalFrame
from companion.onboard.config import Config, LimitsSection
from companion.onboard.navigation import Located, Navigation, navigate, outside_fence, plane_of

ORIGIN_DEG = (47.0, 8.0)
PLANE = LocalFrame(*ORIGIN_DEG)
NOW_S = 1_000.0
FENCE = ((-100.0, -100.0), (-100.0, 100.0), (100.0, 100.0), (100.0, -100.0))
CONFIG = Config(agent_id=1, limits=LimitsSection(speed_m_s=10.0, range_m=5_000.0, fence=FENCE))


def telemetry_at(north_m: float, east_m: float = 0.0) -> Telemetry:
    lat_deg, lon_deg = PLANE.to_global(north_m, east_m)
    return Telemetry(
        position_at_s=NOW_S, lat_deg=lat_deg, lon_deg=lon_deg, velocity_north_m_s=5.0, velocity_east_m_s=0.0
    )


def two_steps(step_m: float) -> tuple[Navigation, Located]:
    """Return what is known after a step of this length in a second."""
    first, located = navigate(Navigation(), PLANE, None, telemetry_at(0.0), CONFIG, NOW_S)
    later = replace(telemetry_at(step_m), position_at_s=NOW_S + 1.0)
    return navigate(first, PLANE, located.fix, later, CONFIG, NOW_S + 1.0)


def test_without_a_picture_the_plane_is_about_the_vehicle_and_stays() -> None:
    here = telemetry_at(500.0)
    plane = plane_of(None, None, here)
    assert (plane.lat_deg, plane.lon_deg) == (here.lat_deg, here.lon_deg)
    assert plane_of(None, plane, telemetry_at(900.0)) is plane


def test_the_plane_changes_with_the_origin_of_the_picture_only() -> None:
    plane = plane_of(ORIGIN_DEG, None, telemetry_at(0.0))
    assert plane_of(ORIGIN_DEG, plane, telemetry_at(900.0)) is plane
    assert plane_of((48.0, 9.0), plane, telemetry_at(900.0)) is not plane


def test_the_distance_flown_adds_up_where_the_vehicle_was_found() -> None:
    assert two_steps(5.0)[0].flown_m == pytest.approx(5.0, abs=0.01)


def test_one_wrong_position_does_not_use_up_the_range() -> None:
    assert two_steps(3_000.0)[0].flown_m == pytest.approx(1.5 * 10.0)


def test_old_telemetry_is_carried_on_to_now() -> None:
    _, located = navigate(Navigation(), PLANE, None, telemetry_at(0.0), CONFIG, NOW_S + 0.4)
    assert located.fix.position_ned_m == pytest.approx((0.0, 0.0), abs=0.01)
    assert located.motion.position_ned_m == pytest.approx((2.0, 0.0), abs=0.01)


def test_a_home_out_of_range_gives_way_to_where_the_vehicle_began() -> None:
    far = replace(telemetry_at(0.0), home_deg=PLANE.to_global(6_000.0, 0.0))
    _, located = navigate(Navigation(), PLANE, None, far, CONFIG, NOW_S)
    assert located.home.too_far
    assert located.home.position_ned_m == pytest.approx((0.0, 0.0), abs=0.01)


@pytest.mark.parametrize(("north_m", "outside"), [(50.0, False), (150.0, True)])
def test_a_vehicle_is_outside_the_fence_or_not(north_m: float, outside: bool) -> None:
    assert outside_fence(telemetry_at(north_m), ORIGIN_DEG, CONFIG) is outside


@pytest.mark.parametrize(("north_m", "outside"), [(10.0, False), (50.0, True), (90.0, False)])
def test_who_is_inside_an_exclusion_is_outside_the_fence(north_m: float, outside: bool) -> None:
    exclusion = ((40.0, -20.0), (60.0, -20.0), (60.0, 20.0), (40.0, 20.0))
    for fence in (FENCE, None):
        limits = CONFIG.limits.model_copy(update={"fence": fence, "exclusions": (exclusion,)})
        config = CONFIG.model_copy(update={"limits": limits})
        assert outside_fence(telemetry_at(north_m), ORIGIN_DEG, config) is outside


def test_nobody_is_outside_a_fence_whose_origin_is_not_known() -> None:
    assert not outside_fence(telemetry_at(150.0), None, CONFIG)


def test_home_is_found_anew_when_the_autopilot_tells_another() -> None:
    first, _ = navigate(Navigation(), PLANE, None, telemetry_at(0.0), CONFIG, NOW_S)
    moved = replace(telemetry_at(0.0), home_deg=PLANE.to_global(700.0, 0.0))
    _, located = navigate(first, PLANE, None, moved, CONFIG, NOW_S)
    assert located.home.position_ned_m == pytest.approx((700.0, 0.0), abs=0.01)


def test_home_is_found_anew_on_another_plane() -> None:
    first, _ = navigate(Navigation(), PLANE, None, telemetry_at(0.0), CONFIG, NOW_S)
    other = LocalFrame(*PLANE.to_global(-300.0, 0.0))
    _, located = navigate(first, other, None, telemetry_at(0.0), CONFIG, NOW_S)
    assert located.home.position_ned_m == pytest.approx((300.0, 0.0), abs=0.01)
