"""The beat of the setpoint loop, and the figures of how even it was."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.runtime.rate import LONG_GAP_S, STALL_S, Greatest, Lateness, LoopRate, SetpointGaps, next_due_s


def gaps_of(*times_s: float) -> SetpointGaps:
    gaps = SetpointGaps()
    for time_s in times_s:
        gaps.note(time_s)
    return gaps


def test_slots_are_on_the_grid_however_late_each_was_done() -> None:
    beat = LoopRate(0.1, 5.0)
    assert [beat.next_after(late_s) for late_s in (5.03, 5.199, 5.2)] == pytest.approx([5.1, 5.2, 5.3])


def test_slots_that_were_slept_through_are_left_out() -> None:
    assert LoopRate(0.1, 5.0).next_after(7.25) == pytest.approx(7.3)


@given(st.floats(0.02, 10.0), st.lists(st.floats(0.0, 30.0), min_size=1, max_size=20))
def test_the_next_slot_is_to_come_and_within_a_period(period_s: float, delays_s: list[float]) -> None:
    beat, now_s = LoopRate(period_s, 1_000.0), 1_000.0
    for delay_s in delays_s:
        now_s += delay_s
        due_s = beat.next_after(now_s)
        assert now_s - 1e-9 <= due_s <= now_s + period_s + 1e-9
        now_s = max(now_s, due_s)


@pytest.mark.parametrize("step_s", [0.1, 0.25, 0.5, 0.73])
def test_decisions_keep_their_step_on_average_though_each_falls_into_a_slot(step_s: float) -> None:
    due_s, made_s = 0.0, []
    for slot in range(1_000):
        slot_s = slot / 10
        if slot_s >= due_s - 0.05:
            made_s.append(slot_s)
            due_s = next_due_s(due_s, slot_s, step_s)
    assert len(made_s) == pytest.approx(100.0 / step_s, abs=2)


def test_decisions_out_of_turn_do_not_put_off_the_next() -> None:
    due_s = 0.0
    for slot in range(100):
        due_s = next_due_s(due_s, slot / 10, 0.5)
    assert due_s == pytest.approx(9.9 + 0.5)


def test_a_decision_slept_through_is_not_made_up_for() -> None:
    assert next_due_s(1.0, 7.0, 0.5) == 7.5


def test_quantiles_and_the_longest_gap_are_told_to_the_millisecond() -> None:
    times_s = [index / 10 for index in range(100)] + [10.1]
    gaps = gaps_of(*times_s)
    assert gaps.count == 100
    assert gaps.quantile_s(0.5) == pytest.approx(0.1)
    assert gaps.quantile_s(0.99) == pytest.approx(0.1)
    assert gaps.quantile_s(1.0) == pytest.approx(0.2)
    assert gaps.max_s == pytest.approx(0.2)


def test_a_gap_over_the_limit_is_counted() -> None:
    gaps = gaps_of(0.0, LONG_GAP_S, 2.0 * LONG_GAP_S + 0.1)
    assert gaps.long == 1
    assert "1 over 0.5 s" in gaps.summary


def test_a_pause_in_the_steering_is_no_gap() -> None:
    gaps = gaps_of(0.0, 0.1)
    gaps.end(0.2)
    gaps.end(0.3)
    gaps.note(0.9)
    assert gaps.count == 2
    assert gaps.max_s == pytest.approx(0.1)


@pytest.mark.parametrize("stood_still_s", [0.6, 2.9, 3.0, 7.0, 3_600.0])
@pytest.mark.parametrize("sends_after", [True, False])
def test_a_gap_is_told_whatever_its_length_and_whatever_follows_it(stood_still_s: float, sends_after: bool) -> None:
    gaps = gaps_of(0.0, 0.1)
    (gaps.note if sends_after else gaps.end)(0.1 + stood_still_s)
    assert gaps.max_s == gaps.recent.take() == pytest.approx(stood_still_s)
    assert gaps.long == 1


def test_a_late_slot_is_a_stall_and_says_whether_the_program_had_a_processor() -> None:
    lateness = Lateness()
    assert lateness.note(0.0, 0.001, 1.0) is None
    stood = lateness.note(0.1, 3.3, 1.01)
    busy = lateness.note(3.4, 4.2, 1.8)
    assert stood is not None and stood.words == "this computer stood still for 3.2 s"
    assert busy is not None and busy.words == "this program was busy for 0.8 s"
    assert lateness.summary == "slots at most 3200 ms late, 2 by 0.2 s or more"


@given(st.lists(st.floats(0.0, 5.0), max_size=20))
def test_no_lateness_is_lost_however_often_it_is_looked_at(lates_s: list[float]) -> None:
    lateness, told_s = Lateness(), []
    for slot, late_s in enumerate(lates_s):
        lateness.note(10.0 * slot, 10.0 * slot + late_s, 0.0)
        told_s.append(lateness.of_decision.take())
    assert told_s == pytest.approx(lates_s)
    assert lateness.stalls == sum(10.0 * slot + late_s - 10.0 * slot >= STALL_S for slot, late_s in enumerate(lates_s))


def test_the_greatest_value_is_taken_once() -> None:
    greatest = Greatest()
    for value in (0.1, 0.3, 0.2):
        greatest.note(value)
    assert greatest.take() == 0.3
    assert greatest.take() == 0.0


def test_without_setpoints_there_is_nothing_to_say_of_gaps() -> None:
    assert math.isnan(SetpointGaps().quantile_s(0.5))
    assert SetpointGaps().summary == "no setpoints sent"
