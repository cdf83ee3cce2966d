"""The ladder: each stage begins exactly where it should, at once, and ends only after its reason has been gone."""

import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.onboard.answer import Answer, Rung
from companion.onboard.failsafe import (
    BATTERY_MARGIN_PERCENT,
    SEVERITY,
    Cause,
    FailsafeInputs,
    FailsafeStatus,
    FailsafeThresholds,
    Stage,
    assess,
)

BEFORE, AFTER = -math.inf, math.inf
GOOD = FailsafeInputs(picture_age_s=0.0, position_accuracy_m=1.0, battery_percent=90.0)
LIMITS = FailsafeThresholds()


def standing(
    inputs: FailsafeInputs,
    thresholds: FailsafeThresholds = LIMITS,
    before: FailsafeStatus | None = None,
    t_s: float = 0.0,
) -> FailsafeStatus:
    return assess(inputs, thresholds, before or FailsafeStatus(), t_s)


def by_age(age_s: float | None, thresholds: FailsafeThresholds = LIMITS) -> Stage:
    return standing(replace(GOOD, picture_age_s=age_s), thresholds).stage


# The age of the picture


@pytest.mark.parametrize(
    ("age_s", "stage"),
    [
        (0.0, Stage.FRESH),
        (math.nextafter(15.0, BEFORE), Stage.FRESH),
        (15.0, Stage.COASTING),
        (math.nextafter(60.0, BEFORE), Stage.COASTING),
        (60.0, Stage.LOITERING),
        (math.nextafter(300.0, BEFORE), Stage.LOITERING),
        (300.0, Stage.RETURNING),
        (math.nextafter(300.0, AFTER), Stage.RETURNING),
        (math.inf, Stage.RETURNING),
    ],
)
def test_each_stage_begins_exactly_at_its_age(age_s: float, stage: Stage) -> None:
    assert by_age(age_s) is stage


def test_without_any_picture_ever_there_is_nowhere_to_go_and_the_vehicle_loiters() -> None:
    assert by_age(None) is Stage.LOITERING


@pytest.mark.parametrize(
    ("age_s", "stage"), [(0.9, Stage.FRESH), (1.0, Stage.COASTING), (2.0, Stage.LOITERING), (3.0, Stage.RETURNING)]
)
def test_the_ages_are_those_of_the_configuration(age_s: float, stage: Stage) -> None:
    assert by_age(age_s, FailsafeThresholds(1.0, 2.0, 3.0)) is stage


@pytest.mark.parametrize(("age_s", "stage"), [(9.9, Stage.FRESH), (10.0, Stage.RETURNING)])
def test_stages_that_begin_together_give_the_last_of_them(age_s: float, stage: Stage) -> None:
    assert by_age(age_s, FailsafeThresholds(10.0, 10.0, 10.0)) is stage


def test_a_picture_never_gets_fresher_by_ageing() -> None:
    order = list(Stage)
    stages = [order.index(by_age(age_s / 2.0)) for age_s in range(1000)]
    assert stages == sorted(stages)


# Every other trigger


@pytest.mark.parametrize(
    ("change", "stage", "words"),
    [
        ({"picture_age_s": 15.0}, Stage.COASTING, "picture late"),
        ({"picture_age_s": 60.0}, Stage.LOITERING, "picture too old"),
        ({"picture_age_s": 300.0}, Stage.RETURNING, "blind"),
        ({"picture_age_s": None}, Stage.LOITERING, "no picture"),
        ({"position_accuracy_m": 10.1}, Stage.LOITERING, "position not known well enough"),
        ({"battery_percent": 25.0}, Stage.RETURNING, "battery low"),
        ({"out_of_range": True}, Stage.RETURNING, "range"),
        ({"outside_fence": True}, Stage.RETURNING, "outside the fence"),
        ({"uncertified_s": 5.0}, Stage.LOITERING, "no certified back-up"),
        ({"clock_offset_s": 3600.0}, Stage.COASTING, "clock stepped by +3600.0 s"),
        ({"clock_offset_s": -1.0}, Stage.COASTING, "clock stepped by -1.0 s"),
    ],
)
def test_each_trigger_leads_to_its_stage_and_says_why(change: dict[str, Any], stage: Stage, words: str) -> None:
    found = standing(replace(GOOD, **change))
    assert (found.stage, found.words, len(found.triggers)) == (stage, words, 1)


@pytest.mark.parametrize(
    "change",
    [
        {"position_accuracy_m": 10.0},
        {"position_accuracy_m": math.nan},
        {"battery_percent": 25.1},
        {"battery_percent": None},
        {"uncertified_s": 4.9},
        {"clock_offset_s": 0.99},
    ],
)
def test_short_of_its_limit_or_untold_nothing_triggers(change: dict[str, Any]) -> None:
    assert standing(replace(GOOD, **change)) == FailsafeStatus()


def test_a_battery_limit_of_zero_never_returns() -> None:
    assert (
        standing(replace(GOOD, battery_percent=0.0), FailsafeThresholds(battery_return_percent=0.0)).stage
        is Stage.FRESH
    )


def test_the_most_severe_trigger_wins_and_the_others_are_kept() -> None:
    found = standing(replace(GOOD, picture_age_s=20.0, battery_percent=10.0, position_accuracy_m=50.0))
    assert found.stage is Stage.RETURNING
    assert [trigger.cause for trigger in found.triggers] == [Cause.BATTERY, Cause.POSITION, Cause.BROADCAST]


# Hysteresis


def test_a_milder_stage_comes_only_after_the_reason_has_been_gone_for_a_while() -> None:
    bad = standing(replace(GOOD, picture_age_s=400.0), t_s=10.0)
    soon = standing(GOOD, before=bad, t_s=10.9)
    assert (soon.stage, soon.words) == (Stage.RETURNING, "blind")
    assert standing(GOOD, before=soon, t_s=11.0).stage is Stage.FRESH


def test_a_reason_that_comes_back_meanwhile_starts_the_wait_again() -> None:
    late = replace(GOOD, picture_age_s=20.0)
    before = standing(late, t_s=0.0)
    for step in range(1, 20):
        before = standing(late if step % 2 == 0 else GOOD, before=before, t_s=0.6 * step)
        assert before.stage is Stage.COASTING


def test_a_graver_stage_begins_at_once() -> None:
    before = standing(replace(GOOD, picture_age_s=20.0), t_s=0.0)
    assert standing(replace(GOOD, battery_percent=5.0), before=before, t_s=0.0).stage is Stage.RETURNING


def test_the_first_picture_ever_ends_the_wait_for_one_at_once() -> None:
    before = standing(replace(GOOD, picture_age_s=None), t_s=0.0)
    assert standing(GOOD, before=before, t_s=0.0).stage is Stage.FRESH


def test_what_is_missing_of_the_picture_ends_as_a_trigger_as_soon_as_it_is_heard() -> None:
    before = standing(replace(GOOD, missing="3 of 5 threats heard"))
    assert (before.stage, before.triggers[0].cause) == (Stage.LOITERING, Cause.PICTURE)
    assert standing(replace(GOOD, missing="4 of 5 threats heard"), before=before).words == "4 of 5 threats heard"
    assert standing(GOOD, before=before, t_s=0.1).stage is Stage.FRESH


def test_a_battery_that_was_low_must_recover_well_above_its_limit() -> None:
    before = standing(replace(GOOD, battery_percent=25.0), t_s=0.0)
    margin = 25.0 + BATTERY_MARGIN_PERCENT
    before = standing(replace(GOOD, battery_percent=margin), before=before, t_s=100.0)
    assert before.stage is Stage.RETURNING
    before = standing(replace(GOOD, battery_percent=margin + 1.0), before=before, t_s=101.0)
    assert before.stage is Stage.FRESH


@pytest.mark.parametrize(
    ("bad", "unknown"),
    [
        ({"battery_percent": 5.0}, {"battery_percent": None}),
        ({"position_accuracy_m": 99.0}, {"position_accuracy_m": math.nan}),
    ],
)
def test_what_was_bad_and_is_no_longer_told_stays_bad(bad: dict[str, Any], unknown: dict[str, Any]) -> None:
    before = standing(replace(GOOD, **bad), t_s=0.0)
    after = standing(replace(GOOD, **unknown), before=before, t_s=1e6)
    assert after == before


inputs = st.builds(
    FailsafeInputs,
    picture_age_s=st.none() | st.floats(0.0, 400.0),
    position_accuracy_m=st.floats(0.0, 30.0) | st.just(math.nan),
    battery_percent=st.none() | st.floats(0.0, 100.0),
    out_of_range=st.booleans(),
    outside_fence=st.booleans(),
    uncertified_s=st.floats(0.0, 10.0),
    clock_offset_s=st.floats(-3.0, 3.0),
)


@pytest.mark.slow
@given(st.lists(st.tuples(inputs, st.floats(0.0, 3.0)), min_size=1, max_size=20))
def test_whatever_happens_the_stage_is_never_milder_than_the_inputs_alone_ask_for(
    history: list[tuple[FailsafeInputs, float]],
) -> None:
    before, now_s = FailsafeStatus(), 0.0
    for now, wait_s in history:
        now_s += wait_s
        before = assess(now, LIMITS, before, now_s)
        assert SEVERITY[before.stage] >= SEVERITY[assess(now, LIMITS, FailsafeStatus(), now_s).stage]
        assert before.stage is max(
            (trigger.stage for trigger in before.triggers), key=SEVERITY.__getitem__, default=Stage.FRESH
        )


@pytest.mark.slow
@given(st.lists(st.tuples(inputs, st.floats(0.0, 3.0)), max_size=20))
def test_whatever_happened_when_all_is_well_for_long_enough_nothing_stands(
    history: list[tuple[FailsafeInputs, float]],
) -> None:
    before, now_s = FailsafeStatus(), 0.0
    for now, wait_s in history:
        now_s += wait_s
        before = assess(now, LIMITS, before, now_s)
    assert assess(GOOD, LIMITS, before, now_s + LIMITS.recover_after_s + 1e-6) == FailsafeStatus()


@given(inputs, st.floats(0.0, 0.99))
def test_a_stage_stands_for_its_time_whatever_its_reason(bad: FailsafeInputs, wait_s: float) -> None:
    before = assess(bad, LIMITS, FailsafeStatus(), 0.0)
    after = assess(GOOD, LIMITS, before, wait_s)
    waiting = [trigger for trigger in before.triggers if trigger.words != "no picture"]
    assert list(after.triggers) == waiting


# Whether the vehicle answers


@pytest.mark.parametrize(
    ("rung", "stage"), [(Rung.ANSWERS, Stage.FRESH), (Rung.SLOWED, Stage.COASTING), (Rung.STOPPED, Stage.LOITERING)]
)
def test_a_vehicle_that_does_not_answer_is_not_steered_to_a_target_once_it_is_stopped(rung: Rung, stage: Stage) -> None:
    assert standing(replace(GOOD, answer=Answer(rung, words="does not turn"))).stage is stage


def test_what_was_asked_and_not_done_is_the_reason() -> None:
    status = standing(replace(GOOD, answer=Answer(Rung.STOPPED, words="does not turn: 0.3 of 15.0 deg/s")))
    assert status.words == "stopped: does not turn: 0.3 of 15.0 deg/s"


def test_a_vehicle_that_answers_again_is_steered_on_at_once_as_the_ladder_has_its_own_times() -> None:
    before = standing(replace(GOOD, answer=Answer(Rung.SLOWED, words="does not turn")))
    assert standing(GOOD, before=before, t_s=0.1).stage is Stage.FRESH
