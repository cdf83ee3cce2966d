"""The pattern as pure functions, and the room that it takes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.guard.fence import Fence
from companion.guard.types import Discs, Motion
from companion.onboard.config import LimitsSection
from companion.onboard.identification.pattern import Act, Pattern, Progress, advanced, begun, pattern_of, wanted
from companion.onboard.identification.room import clearance_m, room_of, stopping_m

LIMITS = LimitsSection(speed_m_s=8.0, n_max=0.2, reaction_s=0.2)
NORTH = Motion(0.0, 0.0, 0.0, 8.0)
NO_DISCS = Discs(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
STEP_S = 0.5


def pattern(can_stop: bool = True, limits: LimitsSection = LIMITS, first_rad: float = 0.0) -> Pattern:
    return pattern_of(limits, can_stop, 0.5 * limits.speed_m_s if can_stop else None, STEP_S, first_rad)


def test_it_turns_as_often_to_the_left_as_to_the_right() -> None:
    words = [leg.words for leg in pattern().legs]
    assert sum(word.startswith("right") for word in words) == sum(word.startswith("left") for word in words) == 3


def test_one_that_can_stop_stops_and_holds_and_a_plane_circles() -> None:
    assert [leg.act for leg in pattern().legs][-1] is Act.HOLD
    acts = [leg.act for leg in pattern(can_stop=False).legs]
    assert acts[-1] is Act.CIRCLE and Act.STOP not in acts


def test_a_slow_turner_gets_smaller_steps_of_course() -> None:
    slow = pattern(limits=LIMITS.model_copy(update={"n_max": 0.02}))
    turns = np.abs(np.diff([leg.course_rad for leg in slow.legs]))
    assert 0.0 < turns.max() < math.radians(20.0)


def test_a_leg_goes_on_until_what_it_asks_for_was_held_for_a_while() -> None:
    progress = begun(pattern(), NORTH, 0.0)
    for t_s in (0.5, 1.0, 1.5, 2.0, 2.5):
        following = advanced(pattern(), progress, NORTH, t_s)
        assert following is not None and following.leg == 0
        progress = following
    following = advanced(pattern(), progress, NORTH, 3.0)
    assert following is not None and following.leg == 1


def test_a_leg_that_is_never_reached_ends_after_its_time() -> None:
    progress = Progress(1, 0.0, (0.0, 0.0))
    following = advanced(pattern(), progress, NORTH, pattern().legs[1].most_s)
    assert following is not None and following.leg == 2


def test_away_from_its_place_a_vehicle_that_holds_is_moved_back_slowly() -> None:
    hold = Progress(len(pattern().legs) - 1, 0.0, (0.0, 0.0))
    heading_rad, speed_m_s = wanted(pattern(), hold, Motion(-4.0, 0.0, 1.0, 0.0))
    assert heading_rad == pytest.approx(0.0) and 0.0 < speed_m_s <= 1.0
    assert wanted(pattern(), hold, Motion(0.1, 0.0, 1.0, 0.0))[1] == 0.0


@settings(max_examples=20, deadline=None)
@given(st.floats(2.0, 25.0), st.floats(0.05, 1.0), st.booleans(), st.floats(0.0, 6.0))
def test_every_pattern_ends_within_its_legs_times_wherever_it_begins(
    speed_m_s: float, n_max: float, can_stop: bool, first_rad: float
) -> None:
    limits = LIMITS.model_copy(update={"speed_m_s": speed_m_s, "n_max": n_max})
    flown = pattern(can_stop, limits, first_rad)
    room = room_of(flown, NORTH, limits, STEP_S, None, NO_DISCS)
    assert room.lasts_s <= sum(leg.most_s for leg in flown.legs) + STEP_S * (len(flown.legs) + 1)
    assert math.isinf(room.clear_m) and room.across_m > 0.0


def test_the_room_shrinks_with_the_fence_and_with_what_a_threat_may_do_meanwhile() -> None:
    square = ((900.0, 900.0), (900.0, -900.0), (-900.0, -900.0), (-900.0, 900.0))
    disc = Discs(np.array([[-700.0, 0.0]]), np.array([100.0]), np.array([2.0]))
    wide = room_of(pattern(), NORTH, LIMITS, STEP_S, Fence(square), NO_DISCS)
    narrow = room_of(pattern(), NORTH, LIMITS, STEP_S, Fence([(0.6 * n, 0.6 * e) for n, e in square]), NO_DISCS)
    beside = room_of(pattern(), NORTH, LIMITS, STEP_S, Fence(square), disc)
    assert narrow.clear_m < wide.clear_m
    assert beside.clear_m < 600.0 - 2.0 * 60.0


def test_a_place_in_a_disc_has_no_clearance() -> None:
    disc = Discs(np.array([[10.0, 0.0]]), np.array([50.0]), np.array([0.0]))
    assert clearance_m((0.0, 0.0), None, disc) == pytest.approx(-40.0)


def test_a_plane_needs_nine_seconds_and_a_copter_its_way_to_a_stop() -> None:
    assert stopping_m(LIMITS, False, 22.0) == pytest.approx(198.0)
    assert stopping_m(LIMITS, True, 8.0) == pytest.approx(8.0 + 16.0)
