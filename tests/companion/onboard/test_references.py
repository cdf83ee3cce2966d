"""Frames of reference that move: whatever moves, no height that is asked for changes the vehicle's own."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.autopilot.telemetry import Telemetry
from companion.onboard.references import (
    ACCELERATION_M_S2,
    MOVED_M,
    References,
    as_handed_over,
    counted_from,
    fallen_m,
    height_to_ask_m,
    moved,
    references_after,
    references_of,
)

PERIOD_MS = 100
HEIGHT_M = 30.0
BASE_M = 500.0
HOME_DEG = (47.0, 8.0)
SURELY_M = 1e-6
BEGAN = Telemetry(
    boot_ms=1_000,
    position_at_s=1.0,
    lat_deg=47.0,
    lon_deg=8.0,
    height_m=HEIGHT_M,
    altitude_m=BASE_M + HEIGHT_M,
    velocity_north_m_s=0.0,
    velocity_east_m_s=0.0,
    home_deg=HOME_DEG,
    home_altitude_m=BASE_M,
)


class Vehicle:
    """A vehicle whose height never changes, told by an autopilot whose references the test moves."""

    def __init__(self) -> None:
        self.told = BEGAN
        self.kept = references_of(BEGAN)

    def tell(
        self, *, up_m: float = 0.0, home_up_m: float = 0.0, sea_up_m: float = 0.0, after_ms: int = PERIOD_MS
    ) -> None:
        """Tell a position after a climb, a move of home, and one of the altitude's zero, without HOME_POSITION."""
        told = self.told
        assert told.boot_ms is not None
        climb_m_s = 1e3 * up_m / after_ms
        self.told = replace(
            told,
            boot_ms=told.boot_ms + after_ms,
            climb_m_s=climb_m_s,
            height_m=told.height_m + up_m - home_up_m,
            altitude_m=told.altitude_m + up_m - sea_up_m,
        )
        self.kept = references_after(self.kept, self.told)

    def tell_home(self, altitude_m: float, place_deg: tuple[float, float] = HOME_DEG) -> None:
        self.told = replace(self.told, home_deg=place_deg, home_altitude_m=altitude_m, home_boot_ms=self.told.boot_ms)
        self.kept = references_after(self.kept, self.told)

    def hand_over_again(self) -> None:
        self.kept = references_of(self.told, fallen_m(self.kept, self.told))

    @property
    def asks_up_m(self) -> float:
        """By how much a vehicle at the wanted height is asked to climb."""
        return height_to_ask_m(self.kept, self.told, HEIGHT_M) - self.told.height_m

    @property
    def words(self) -> str | None:
        return moved(self.kept, self.told, True)


def test_where_nothing_moves_the_telemetry_and_the_height_are_those_that_are_told() -> None:
    vehicle = Vehicle()
    vehicle.tell(up_m=0.4)
    assert as_handed_over(vehicle.kept, vehicle.told) is vehicle.told
    assert height_to_ask_m(vehicle.kept, vehicle.told, 31.7) == 31.7
    assert vehicle.words is None


@pytest.mark.parametrize("home_up_m", [560.0, -560.0])
def test_a_height_is_held_by_the_altitude_when_home_is_moved(home_up_m: float) -> None:
    vehicle = Vehicle()
    vehicle.tell(home_up_m=home_up_m)
    assert vehicle.asks_up_m == pytest.approx(0.0, abs=SURELY_M)
    assert as_handed_over(vehicle.kept, vehicle.told).height_m == pytest.approx(HEIGHT_M)
    assert as_handed_over(vehicle.kept, vehicle.told).altitude_m == vehicle.told.altitude_m
    direction = "up" if home_up_m > 0 else "down"
    assert vehicle.words == (
        f"home moved 560 m {direction} in flight: height held by altitude above sea level; hand over again"
    )


def test_a_height_is_held_above_home_when_the_altitude_jumps_and_the_altitude_is_not_known() -> None:
    vehicle = Vehicle()
    vehicle.tell(sea_up_m=-120.0)
    assert vehicle.asks_up_m == pytest.approx(0.0, abs=SURELY_M)
    assert math.isnan(as_handed_over(vehicle.kept, vehicle.told).altitude_m)
    assert vehicle.words == (
        "altitude above sea level jumped 120 m up in flight: height held by height above home; hand over again"
    )


def test_a_height_is_held_as_before_when_both_jump() -> None:
    vehicle = Vehicle()
    vehicle.tell(home_up_m=-300.0, sea_up_m=-120.0)
    assert vehicle.asks_up_m == pytest.approx(0.0, abs=SURELY_M)
    assert vehicle.words == ("altitude jumped 120 m up and height 300 m up in flight: held as before; hand over again")


@pytest.mark.parametrize("home_up_m", [560.0, -560.0])
def test_handed_over_again_it_keeps_the_height_above_where_home_was(home_up_m: float) -> None:
    vehicle = Vehicle()
    vehicle.tell(home_up_m=home_up_m)
    vehicle.hand_over_again()
    assert vehicle.asks_up_m == pytest.approx(0.0, abs=SURELY_M)
    assert as_handed_over(vehicle.kept, vehicle.told).height_m == pytest.approx(HEIGHT_M)
    assert vehicle.words is None
    direction = "up" if home_up_m > 0 else "down"
    assert counted_from(vehicle.kept) == (
        f"home had moved 560 m {direction} in flight: heights count from where it was"
    )
    vehicle.tell(home_up_m=-home_up_m)
    assert vehicle.words is not None
    vehicle.hand_over_again()
    assert (fallen_m(vehicle.kept, vehicle.told), counted_from(vehicle.kept)) == (0.0, None)


def test_handed_over_again_what_corrected_the_estimate_is_believed() -> None:
    vehicle = Vehicle()
    vehicle.tell(sea_up_m=-120.0)
    assert fallen_m(vehicle.kept, vehicle.told) == 0.0
    vehicle.tell(home_up_m=40.0, sea_up_m=40.0)
    assert fallen_m(vehicle.kept, vehicle.told) == pytest.approx(0.0, abs=SURELY_M)


def test_a_home_that_is_moved_back_is_where_it_was() -> None:
    vehicle = Vehicle()
    vehicle.tell(home_up_m=560.0)
    vehicle.tell(home_up_m=-560.0)
    assert vehicle.words is None
    assert vehicle.asks_up_m == pytest.approx(0.0, abs=SURELY_M)


def test_a_moved_home_is_said_by_the_word_of_home_alone() -> None:
    vehicle = Vehicle()
    vehicle.tell_home(BASE_M + 560.0)
    assert vehicle.words is not None
    assert vehicle.words.startswith("home moved 560 m up in flight")
    assert vehicle.asks_up_m == 0.0


def test_a_home_that_walks_is_known_by_its_own_word_and_the_altitude_counts() -> None:
    vehicle = Vehicle()
    for _ in range(100):
        vehicle.tell(home_up_m=0.3, up_m=0.02)
    vehicle.tell_home(BASE_M + 30.0)
    # It has risen by 2 m, and comes down by as much.
    assert vehicle.asks_up_m == pytest.approx(-2.0)
    assert vehicle.words is not None
    assert vehicle.words.startswith("home moved 30 m up")


def test_where_nobody_says_what_walks_it_climbs_only_as_far_as_both_ask_for() -> None:
    vehicle = Vehicle()
    for _ in range(100):
        vehicle.tell(home_up_m=0.3)
    assert vehicle.asks_up_m == 0.0
    for _ in range(40):
        vehicle.tell(up_m=-0.25)
    # By the altitude it is 10 m too low, by the height above home 40 m.
    assert vehicle.asks_up_m == pytest.approx(10.0)
    assert vehicle.words is not None
    assert vehicle.words.startswith("home and sea level moved 30 m apart in flight")


@pytest.mark.parametrize(("north", "words"), [(0.0001, None), (0.003, "home moved 330 m aside in flight")])
def test_the_home_of_the_hand_over_counts(north: float, words: str | None) -> None:
    vehicle = Vehicle()
    vehicle.tell_home(BASE_M, (HOME_DEG[0] + north, HOME_DEG[1]))
    assert as_handed_over(vehicle.kept, vehicle.told).home_deg == HOME_DEG
    assert (vehicle.words is None) == (words is None)
    assert (vehicle.words or "").startswith(words or "")


def test_a_home_that_is_told_for_the_first_time_in_flight_is_the_one_that_is_kept() -> None:
    began = replace(BEGAN, home_deg=None, home_altitude_m=math.nan)
    kept = references_after(references_of(began), replace(began, home_deg=HOME_DEG, home_altitude_m=BASE_M))
    assert (kept.home_deg, kept.home_altitude_m) == (HOME_DEG, BASE_M)


def test_an_origin_that_the_autopilot_says_has_moved_is_told() -> None:
    began = replace(BEGAN, origin=(47.0, 8.0, 500.0))
    kept, told = references_of(began), replace(began, origin=(47.01, 8.0, 1060.0))
    assert moved(kept, told, False) == (
        "the local frame's origin moved 1110 m aside and 560 m up in flight; hand over again"
    )


def local(
    kept: References | None, north_m: float, local_ned_m: tuple[float, float, float]
) -> tuple[References, Telemetry]:
    """Return the references after a place north of the first, and the telemetry that told it."""
    told = replace(
        BEGAN, lat_deg=47.0 + math.degrees(north_m / 6_371_000.0), local_ned_m=local_ned_m, local_boot_ms=1_000
    )
    return (references_of(told) if kept is None else references_after(kept, told)), told


@pytest.mark.parametrize(
    ("local_ned_m", "said"),
    [
        ((1_100.0, 0.0, -30.0), None),
        ((800.0, 0.0, -30.0), "the local frame's origin moved 300 m aside in flight; hand over again"),
        ((1_100.0, 0.0, 530.0), "the local frame's origin moved 560 m up in flight; hand over again"),
        # Half a degree of convergence on a kilometre.
        ((1_100.0, 9.0, -30.0), None),
    ],
)
def test_a_local_frame_that_moves_is_known_by_its_own_places(
    local_ned_m: tuple[float, float, float], said: str | None
) -> None:
    kept, _ = local(None, 0.0, (100.0, 0.0, -30.0))
    kept, told = local(kept, 1_000.0, local_ned_m)
    assert moved(kept, told, True) == said


@settings(max_examples=40)
@given(st.lists(st.tuples(st.floats(-2_000.0, 2_000.0), st.booleans(), st.booleans()), max_size=12))
def test_however_often_home_is_moved_and_the_vehicle_handed_over_it_is_never_lowered(
    moves: list[tuple[float, bool, bool]],
) -> None:
    """Home jumps, or walks there in small steps that HOME_POSITION does not tell, and the vehicle is handed over."""
    vehicle = Vehicle()
    for home_up_m, walks, again in moves:
        steps = 1 + int(abs(home_up_m) / 3.0) if walks and abs(home_up_m) < 60.0 else 1
        for _ in range(steps):
            vehicle.tell(home_up_m=home_up_m / steps)
        if again:
            vehicle.hand_over_again()
        assert vehicle.asks_up_m >= -MOVED_M - 0.06


WAYS = st.lists(st.tuples(st.sampled_from(["walk", "home", "sea", "both"]), st.integers(-600, 600)), max_size=8)


@settings(max_examples=60)
@given(ways=WAYS, walks_home=st.booleans(), ends_by_jump=st.booleans())
def test_whatever_the_way_there_and_back_where_it_was_nothing_has_moved(
    ways: list[tuple[str, int]], walks_home: bool, ends_by_jump: bool
) -> None:
    """Home, or sea level, walks and jumps, the other jumps, and both at once, until all are where they were."""
    vehicle, away = Vehicle(), {"home": 0.0, "sea": 0.0}

    def tell(home_up_m: float = 0.0, sea_up_m: float = 0.0) -> None:
        vehicle.tell(home_up_m=home_up_m, sea_up_m=sea_up_m)
        away["home"] += home_up_m
        away["sea"] += sea_up_m
        vehicle.tell_home(BASE_M + away["home"])
        # Whether home or sea level walks is told by HOME_POSITION, as exactly as two references may differ.
        assert vehicle.asks_up_m == pytest.approx(0.0, abs=0.06 if walks_home else MOVED_M + 0.06)

    def walk(metres: float) -> None:
        for _ in range(1 + int(abs(metres) / 4.0)):
            step_m = metres / (1 + int(abs(metres) / 4.0))
            tell(step_m if walks_home else 0.0, 0.0 if walks_home else step_m)

    def back(which: str, *, walks: bool) -> None:
        metres = -away[which]
        if walks or abs(metres) < 6.0:
            walk(metres)
        else:
            tell(metres if which == "home" else 0.0, metres if which == "sea" else 0.0)

    def is_left(way: str, metres: float) -> bool:
        """Return whether a jump would leave home or sea level less far off than is ever noticed, but not back."""
        moved = {"home": ("home",), "sea": ("sea",), "both": ("home", "sea")}[way]
        return any(0.0 < abs(away[one] + metres) <= MOVED_M + 1.0 for one in moved)

    walker, jumper = ("home", "sea") if walks_home else ("sea", "home")
    both_m = jumped_m = 0.0
    for way, metres in ways:
        if way == "walk":
            walk(metres / 10.0)
        elif abs(metres) > 10 and not is_left(way, metres):
            tell(metres if way != "sea" else 0.0, metres if way != "home" else 0.0)
            both_m += metres if way == "both" else 0.0
            jumped_m += metres if way == jumper else 0.0
    if abs(both_m) > 6.0:
        tell(-both_m, -both_m)
    elif both_m:
        return
    if 0.0 < abs(jumped_m) <= 6.0:
        return
    back(jumper, walks=False)
    back(walker, walks=not ends_by_jump)
    assert vehicle.words is None
    assert as_handed_over(vehicle.kept, vehicle.told).height_m == pytest.approx(HEIGHT_M, abs=0.06)


def test_a_home_that_walked_away_and_jumped_back_has_not_moved() -> None:
    vehicle = Vehicle()
    for _ in range(24):
        vehicle.tell(home_up_m=-0.25)
    for home_up_m in (66.0, -60.0):
        vehicle.tell(home_up_m=home_up_m)
    assert vehicle.words is not None
    # Whoever sets home has it told.
    vehicle.tell_home(BASE_M)
    assert vehicle.words is None
    assert as_handed_over(vehicle.kept, vehicle.told).height_m == HEIGHT_M
    assert fallen_m(vehicle.kept, vehicle.told) == 0.0


def test_an_estimate_that_jumped_in_two_steps_has_not_come_back() -> None:
    vehicle = Vehicle()
    vehicle.tell(home_up_m=560.0)
    vehicle.tell(sea_up_m=560.0)
    assert vehicle.words is not None
    assert vehicle.asks_up_m == pytest.approx(0.0, abs=SURELY_M)


STEPS_M = st.one_of(st.just(0.0), st.floats(-2_000.0, 2_000.0), st.floats(-3.0, 3.0))


@settings(max_examples=40)
@given(st.lists(st.tuples(STEPS_M, STEPS_M, st.integers(1, 4), st.booleans()), max_size=20))
def test_no_moved_reference_ever_changes_the_height_that_is_asked_for(
    moves: list[tuple[float, float, int, bool]],
) -> None:
    """Home jumps or walks, or both references jump at once, with up to three positions lost in between."""
    vehicle = Vehicle()
    for home_up_m, sea_up_m, after, both in moves:
        elapsed_s = 1e-3 * PERIOD_MS * after
        jump_m = MOVED_M + 0.5 * ACCELERATION_M_S2 * elapsed_s**2 + 0.5
        if both:
            # A small step of both at once is a step of the vehicle's own estimate.
            home_up_m, sea_up_m = (step if abs(step) > jump_m else 0.0 for step in (home_up_m, sea_up_m))
        vehicle.tell(home_up_m=home_up_m, sea_up_m=sea_up_m if both else 0.0, after_ms=after * PERIOD_MS)
        assert vehicle.asks_up_m == pytest.approx(0.0, abs=0.06)


@settings(max_examples=25)
@given(
    walk_m=st.floats(-0.4, 0.4).filter(lambda walk: abs(walk) > 0.01),
    of_home=st.booleans(),
    climbs_m=st.lists(st.floats(-0.2, 0.2), min_size=100, max_size=100),
)
def test_whatever_walks_however_slowly_nothing_moves_it_and_it_is_said(
    walk_m: float, of_home: bool, climbs_m: list[float]
) -> None:
    vehicle, truth_m = Vehicle(), 0.0
    for climb_m in climbs_m:
        truth_m += climb_m
        vehicle.tell(up_m=climb_m, home_up_m=walk_m if of_home else 0.0, sea_up_m=0.0 if of_home else walk_m)
        # Towards the height that it left, or not at all: a walk never drives it farther away.
        assert min(0.0, -truth_m) - 0.06 <= vehicle.asks_up_m <= max(0.0, -truth_m) + 0.06
    walked_m = abs(walk_m) * len(climbs_m)
    if abs(walked_m - MOVED_M) > SURELY_M:
        assert (vehicle.words is not None) == (walked_m > MOVED_M)
