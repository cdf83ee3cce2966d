"""The shared map: round trips, distances from the origin, and the convergence that turns a heading."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyproj import Geod

from companion.geo.local_frame import LocalFrame, to_grid

WGS84 = Geod(ellps="WGS84")
REACH_M = 300e3

LATITUDES = st.floats(-89.9, 89.9)
LONGITUDES = st.floats(-180.0, 180.0)
BEARINGS = st.floats(0.0, math.tau)
NEAR_THE_DATE_LINE = [(52.0, 179.99), (-17.0, -179.99), (0.0, 180.0)]
HIGH = [(84.0, 10.0), (-88.5, -120.0), (89.99, 45.0)]


def at(bearing_rad: float, distance_m: float) -> tuple[float, float]:
    return distance_m * math.cos(bearing_rad), distance_m * math.sin(bearing_rad)


@given(lat_deg=LATITUDES, lon_deg=LONGITUDES, bearing_rad=BEARINGS, distance_m=st.floats(0.0, REACH_M))
def test_a_round_trip_over_300_km_returns_within_a_micrometre(
    lat_deg: float, lon_deg: float, bearing_rad: float, distance_m: float
) -> None:
    frame, place = LocalFrame(lat_deg, lon_deg), at(bearing_rad, distance_m)
    assert math.dist(frame.to_local(*frame.to_global(*place)), place) < 1e-6


@pytest.mark.parametrize("origin", [*NEAR_THE_DATE_LINE, *HIGH], ids=str)
@pytest.mark.parametrize("bearing_deg", range(0, 360, 30))
def test_a_round_trip_survives_the_date_line_and_the_poles(origin: tuple[float, float], bearing_deg: int) -> None:
    frame, place = LocalFrame(*origin), at(math.radians(bearing_deg), REACH_M)
    assert math.dist(frame.to_local(*frame.to_global(*place)), place) < 1e-6


@pytest.mark.parametrize("origin", NEAR_THE_DATE_LINE, ids=str)
def test_the_other_side_of_the_date_line_is_near(origin: tuple[float, float]) -> None:
    frame = LocalFrame(*origin)
    assert math.hypot(*frame.to_local(origin[0], -math.copysign(179.99, origin[1]))) < 2.3e3


@given(lat_deg=LATITUDES, lon_deg=LONGITUDES, bearing_rad=BEARINGS, distance_m=st.floats(0.0, REACH_M))
def test_distance_from_the_origin_is_the_geodesic_distance(
    lat_deg: float, lon_deg: float, bearing_rad: float, distance_m: float
) -> None:
    there_lat_deg, there_lon_deg = LocalFrame(lat_deg, lon_deg).to_global(*at(bearing_rad, distance_m))
    assert WGS84.inv(lon_deg, lat_deg, there_lon_deg, there_lat_deg)[2] == pytest.approx(distance_m, abs=1e-6)


def test_north_is_north_and_east_is_east() -> None:
    frame = LocalFrame(47.0, 8.0)
    north_m, east_m = frame.to_local(47.1, 8.0)
    assert north_m == pytest.approx(11_118.0, abs=5.0)
    assert east_m == pytest.approx(0.0, abs=1e-6)
    north_m, east_m = frame.to_local(47.0, 8.1)
    assert north_m == pytest.approx(0.0, abs=10.0)
    assert east_m == pytest.approx(7_605.0, abs=5.0)


def test_the_origin_maps_to_zero_without_convergence() -> None:
    frame = LocalFrame(47.0, 8.0)
    assert frame.to_local(47.0, 8.0) == pytest.approx((0.0, 0.0))
    assert frame.to_global(0.0, 0.0) == pytest.approx((47.0, 8.0))
    assert frame.convergence_rad(0.0, 0.0) == pytest.approx(0.0, abs=1e-12)


@given(lat_deg=st.floats(-75.0, 75.0), lon_deg=LONGITUDES, bearing_rad=BEARINGS, distance_m=st.floats(1e3, REACH_M))
def test_convergence_is_the_turn_of_the_radial_direction_found_by_differences(
    lat_deg: float, lon_deg: float, bearing_rad: float, distance_m: float
) -> None:
    frame = LocalFrame(lat_deg, lon_deg)
    here, there = (frame.to_global(*at(bearing_rad, distance_m + step_m)) for step_m in (-50.0, 50.0))
    onward_deg, back_deg, _ = WGS84.inv(here[1], here[0], there[1], there[0])
    # The azimuth half-way is the mean of the azimuths at both ends, but for terms of third order.
    middle_rad = math.radians(onward_deg) + 0.5 * math.remainder(math.radians(back_deg + 180.0 - onward_deg), math.tau)
    error_rad = math.remainder(middle_rad - bearing_rad - frame.convergence_rad(*at(bearing_rad, distance_m)), math.tau)
    assert abs(error_rad) < 1e-8


@given(
    lat_deg=st.floats(-60.0, 60.0),
    bearing_rad=BEARINGS,
    distance_m=st.floats(1e3, REACH_M),
    course_rad=BEARINGS,
)
def test_a_grid_heading_plus_convergence_is_the_true_heading_in_every_direction(
    lat_deg: float, bearing_rad: float, distance_m: float, course_rad: float
) -> None:
    """Off the radial direction the plane is stretched by (d/R)^2/6: under a milliradian at 300 km."""
    frame, (north_m, east_m) = LocalFrame(lat_deg, 8.0), at(bearing_rad, distance_m)
    here = frame.to_global(north_m, east_m)
    there = frame.to_global(north_m + 10.0 * math.cos(course_rad), east_m + 10.0 * math.sin(course_rad))
    true_rad = math.radians(WGS84.inv(here[1], here[0], there[1], there[0])[0])
    error_rad = math.remainder(true_rad - course_rad - frame.convergence_rad(north_m, east_m), math.tau)
    assert abs(error_rad) < 2e-4 * (distance_m / REACH_M) ** 2 + 1e-6


def test_the_convergence_east_of_a_northern_origin_is_clockwise_and_matters() -> None:
    convergence_deg = math.degrees(LocalFrame(47.0, 8.0).convergence_rad(0.0, REACH_M))
    assert 2.5 < convergence_deg < 3.5


@given(lat_deg=LATITUDES, lon_deg=LONGITUDES, bearing_rad=BEARINGS, distance_m=st.floats(1.0, REACH_M))
def test_every_way_to_ask_gives_the_same_place_and_convergence(
    lat_deg: float, lon_deg: float, bearing_rad: float, distance_m: float
) -> None:
    frame, place = LocalFrame(lat_deg, lon_deg), at(bearing_rad, distance_m)
    there_lat_deg, there_lon_deg, convergence_rad = frame.to_global_with_convergence(*place)
    assert (there_lat_deg, there_lon_deg) == frame.to_global(*place)
    assert convergence_rad == frame.convergence_rad(*place)
    assert -math.pi <= convergence_rad <= math.pi
    *local, back_rad = frame.to_local_with_convergence(there_lat_deg, there_lon_deg)
    assert tuple(local) == frame.to_local(there_lat_deg, there_lon_deg)
    assert abs(math.remainder(back_rad - convergence_rad, math.tau)) < 1e-5


def test_an_equirectangular_map_would_err_by_more_than_a_kilometre() -> None:
    lat_deg, lon_deg = 47.0, 8.0
    there = LocalFrame(lat_deg, lon_deg).to_global(*at(math.radians(45.0), REACH_M))
    radius_m = 6_371_008.8
    flat = (
        radius_m * math.radians(there[0] - lat_deg),
        radius_m * math.cos(math.radians(lat_deg)) * math.radians(there[1] - lon_deg),
    )
    assert math.dist(flat, at(math.radians(45.0), REACH_M)) > 1e3


def test_a_vector_from_true_north_keeps_its_length_and_its_heading_loses_the_convergence() -> None:
    north, east = to_grid(3.0 * math.cos(1.0), 3.0 * math.sin(1.0), 0.25)
    assert (north, east) == pytest.approx((3.0 * math.cos(0.75), 3.0 * math.sin(0.75)))
