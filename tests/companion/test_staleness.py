"""Staleness: each stage begins exactly at its age."""

import math

import pytest

from companion.staleness import Stage, Thresholds, stage_of

BEFORE, AFTER = -math.inf, math.inf


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
    assert stage_of(age_s, Thresholds()) is stage


def test_without_any_picture_ever_there_is_nowhere_to_go_and_the_vehicle_loiters() -> None:
    assert stage_of(None, Thresholds()) is Stage.LOITERING


@pytest.mark.parametrize(
    ("age_s", "stage"),
    [
        (0.9, Stage.FRESH),
        (1.0, Stage.COASTING),
        (2.0, Stage.LOITERING),
        (3.0, Stage.RETURNING),
    ],
)
def test_the_ages_are_those_of_the_configuration(age_s: float, stage: Stage) -> None:
    assert stage_of(age_s, Thresholds(1.0, 2.0, 3.0)) is stage


@pytest.mark.parametrize(("age_s", "stage"), [(9.9, Stage.FRESH), (10.0, Stage.RETURNING)])
def test_stages_that_begin_together_give_the_last_of_them(age_s: float, stage: Stage) -> None:
    assert stage_of(age_s, Thresholds(10.0, 10.0, 10.0)) is stage


def test_a_picture_never_gets_fresher_by_ageing() -> None:
    order = list(Stage)
    stages = [order.index(stage_of(age_s / 2.0, Thresholds())) for age_s in range(1000)]
    assert stages == sorted(stages)
