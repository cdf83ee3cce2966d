"""Polygons: what is inside one, and which corners make none."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.geo.polygon import inside_polygon, polygon_fault

SQUARE = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))


@pytest.mark.parametrize("corners", [SQUARE, SQUARE[::-1], SQUARE[:3], (*SQUARE[:3], (4.0, 6.0))])
def test_a_simple_polygon_has_no_fault(corners: tuple[tuple[float, float], ...]) -> None:
    assert polygon_fault(corners) is None


@pytest.mark.parametrize(
    ("corners", "fault"),
    [
        ((*SQUARE, SQUARE[0]), "corner 4 is corner 0 again"),
        (((0.0, 0.0), (10.0, 10.0), (10.0, 0.0), (0.0, 10.0)), "the edges after corners 0 and 2 cross or touch"),
        (((0.0, 0.0), (5.0, 5.0), (10.0, 10.0)), "its three corners are on one line"),
        ((*SQUARE[:3], (5.0, 0.0)), "the edges after corners 0 and 2 cross or touch"),
        ((*SQUARE, (0.0, 5.0), (-5.0, 5.0), (0.0, 7.0)), "the edges after corners 3 and 5 cross or touch"),
        ((*SQUARE, (0.0, 20.0)), "the edges after corners 2 and 4 cross or touch"),
    ],
    ids=["closed twice", "crossing", "no area", "a corner on an edge", "an edge through a corner", "a spike"],
)
def test_corners_that_make_no_polygon_are_told_where(corners: tuple[tuple[float, float], ...], fault: str) -> None:
    assert polygon_fault(corners) == fault


@st.composite
def stars(draw: st.DrawFn) -> list[tuple[float, float]]:
    """Return the corners of a polygon that sees its own middle, in the order of their bearings."""
    count = draw(st.integers(3, 12))
    radii_m = draw(st.lists(st.floats(10.0, 1_000.0), min_size=count, max_size=count))
    return [
        (radius_m * math.cos(math.tau * index / count), radius_m * math.sin(math.tau * index / count))
        for index, radius_m in enumerate(radii_m)
    ]


@given(stars(), st.integers(0, 11))
def test_a_star_is_simple_from_whatever_corner_on_and_its_middle_is_inside(
    corners: list[tuple[float, float]], first: int
) -> None:
    turned = corners[first % len(corners) :] + corners[: first % len(corners)]
    assert polygon_fault(turned) is None
    assert inside_polygon((0.0, 0.0), turned)


@given(stars(), st.data())
def test_a_star_of_which_two_corners_change_places_is_judged_as_by_hand(
    corners: list[tuple[float, float]], data: st.DataObject
) -> None:
    if len(corners) < 4:
        return
    index = data.draw(st.integers(0, len(corners) - 1))
    after = (index + 1) % len(corners)
    corners[index], corners[after] = corners[after], corners[index]
    assert polygon_fault(corners) == _fault_by_hand(corners)


def _fault_by_hand(corners: list[tuple[float, float]]) -> str | None:
    edges = list(zip(corners, corners[1:] + corners[:1], strict=True))
    for first, one in enumerate(edges):
        for second in range(first + 2, len(edges)):
            if (first, second) != (0, len(edges) - 1) and _cross_each_other(*one, *edges[second]):
                return f"the edges after corners {first} and {second} cross or touch"
    return None


def _cross_each_other(
    a: tuple[float, float], b: tuple[float, float], c: tuple[float, float], d: tuple[float, float]
) -> bool:
    """Solve for the common point of the lines through a, b and c, d."""
    along, other = (b[0] - a[0], b[1] - a[1]), (d[0] - c[0], d[1] - c[1])
    slope = along[0] * other[1] - along[1] * other[0]
    if slope == 0.0:
        return False
    share = ((c[0] - a[0]) * other[1] - (c[1] - a[1]) * other[0]) / slope
    other_share = ((c[0] - a[0]) * along[1] - (c[1] - a[1]) * along[0]) / slope
    return 0.0 <= share <= 1.0 and 0.0 <= other_share <= 1.0
