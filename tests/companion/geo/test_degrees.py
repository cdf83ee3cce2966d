"""Places in degrees: on the Earth or not, and how far apart two near each other are."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.geo.degrees import is_on_earth, metres_between
from companion.geo.local_frame import LocalFrame


@given(st.floats(-80.0, 80.0), st.floats(-180.0, 180.0), st.floats(-500.0, 500.0), st.floats(-500.0, 500.0))
def test_places_near_each_other_are_apart_as_the_local_frame_says_but_for_the_flattening(
    lat_deg: float, lon_deg: float, north_m: float, east_m: float
) -> None:
    there_deg = LocalFrame(lat_deg, lon_deg).to_global(north_m, east_m)
    apart_m = metres_between((lat_deg, lon_deg), there_deg)
    assert math.dist(apart_m, (north_m, east_m)) <= 0.01 * math.hypot(north_m, east_m) + 0.01


def test_the_date_line_is_no_distance() -> None:
    assert metres_between((0.0, 179.9999), (0.0, -179.9999)) == pytest.approx((0.0, 22.2), abs=0.1)


@pytest.mark.parametrize("place_e7", [(900_000_001, 0), (-900_000_001, 0), (0, 1_800_000_001), (math.nan, 0)])
def test_what_is_beyond_the_poles_or_the_date_line_is_not_on_the_earth(place_e7: tuple[float, float]) -> None:
    assert not is_on_earth(*place_e7)
    assert is_on_earth(-900_000_000, 1_800_000_000)
