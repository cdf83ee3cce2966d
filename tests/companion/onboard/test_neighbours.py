"""Who counts to the right of way: whoever is seen, and whom the broadcast told, with what it may have flown since."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from companion.geo.right_of_way import Rules, greatest_growth_m, growth_m
from companion.guard.types import Motion
from companion.guidance.view import NOBODY, Others, Traffic, View
from companion.onboard.config import Config, LimitsSection
from companion.onboard.neighbours import Neighbours, neighbours_of
from companion.onboard.senses import sense_of_others, without_a_sense
from companion.onboard.world_model import WorldModel
from companion.protocol.codec import AgentEntry, AgentMotion, Directive, MotionFrame, Stamp, StateFrame

EPOCH_S = 1_790_000_000
ROUNDING_M = math.sqrt(0.5) * 0.1
RULES = Rules(separation_m=20.0, n_max=0.2, speed_m_s=8.0, can_stop=True, braking_m_s2=2.0)
CONFIG = Config(
    agent_id=1,
    limits=LimitsSection(speed_m_s=8.0, n_max=0.2),
    separation_m=20.0,
    detector_range_m=400.0,
    peer_memory_s=30.0,
)
HERE = Motion(0.0, 0.0, 0.0, 0.0)


def heard(*, moving: AgentMotion | None = None, motion_ms: int = 500) -> WorldModel:
    """Return a picture of agent 3, told to be 100 m north at the second 0 of the epoch."""
    model = WorldModel(1)
    agents = (AgentEntry(1, 0.0, 0.0, None), AgentEntry(3, 100.0, 0.0, None))
    state = StateFrame(Stamp(EPOCH_S, 0, 1, 0, 1), 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 10, agents, (), ())
    model.take(state, EPOCH_S + 0.1)
    if moving is not None:
        stamp = Stamp(EPOCH_S, motion_ms, 1, 0, 1)
        model.take(MotionFrame(stamp, (moving,), (), ()), EPOCH_S + motion_ms / 1e3 + 0.1)
    return model


def around(view: View, config: Config = CONFIG) -> Neighbours:
    return neighbours_of(view, HERE, RULES, config)


def only(neighbours: Neighbours) -> tuple[complex, complex, float, float]:
    (row,) = neighbours.peers.rows()
    return row


def test_who_was_told_counts_where_it_was_told_grown_by_its_age() -> None:
    view = heard(moving=AgentMotion(3, 0.0, 4.0, 0.0)).view(EPOCH_S + 2.0)
    place, velocity, age_s, grown_m = only(around(view))
    assert (place, velocity, age_s) == (100.0, 4.0, 2.0)
    assert grown_m == pytest.approx(growth_m(4.0, 2.0, True, RULES, 0.5) + ROUNDING_M)


def test_a_velocity_older_than_the_place_makes_the_word_older() -> None:
    view = heard(moving=AgentMotion(3, 0.0, 4.0, 1.5)).view(EPOCH_S + 2.0)
    place, _, age_s, _ = only(around(view))
    assert age_s == pytest.approx(3.0)
    assert place + 4.0 * age_s == pytest.approx(100.0 + 4.0 * 2.0)


def test_who_was_told_without_a_velocity_may_have_gone_anywhere() -> None:
    grown_m = only(around(heard().view(EPOCH_S + 2.0)))[3]
    assert grown_m == pytest.approx(growth_m(0.0, 2.0, False, RULES, 0.5) + ROUNDING_M)


def test_who_is_told_to_stand_stands() -> None:
    view = heard(moving=AgentMotion(3, None, 0.0, 0.0)).view(EPOCH_S + 2.0)
    assert only(around(view))[3] == pytest.approx(growth_m(0.0, 2.0, True, RULES, 0.5) + ROUNDING_M)


def test_who_is_seen_counts_as_seen_and_not_as_told() -> None:
    model = heard(moving=AgentMotion(3, 0.0, 4.0, 0.0))
    view = model.with_traffic(model.view(EPOCH_S + 2.0), [Traffic(3, (110.0, 2.0), (0.0, 1.0), 0.5)])
    place, _, age_s, grown_m = only(around(view))
    assert (place, age_s) == (110.0 + 1.5j, 0.5)
    assert grown_m == growth_m(1.0, 0.5, True, RULES, 0.5)


def test_who_is_seen_at_another_height_does_not_count_as_told_either() -> None:
    model, above = heard(), Traffic(3, (110.0, 2.0), (0.0, 1.0), 0.5)
    assert len(around(model.with_traffic(model.view(EPOCH_S + 2.0), [], [above])).ids) == 0


def test_an_old_word_forbids_no_more_than_the_other_could_and_that_is_said() -> None:
    view = heard().view(EPOCH_S + 12.0)
    neighbours = around(view)
    assert only(neighbours)[3] == greatest_growth_m(RULES, 0.5)
    assert neighbours.unseparated == "agent 3 heard over 10 s ago: no separation from it"


def test_a_forgotten_word_does_not_count_and_that_is_said() -> None:
    neighbours = around(heard().view(EPOCH_S + 31.0))
    assert len(neighbours.ids) == 0
    assert neighbours.unseparated == "agent 3 heard over 30 s ago: no separation from it"


def test_of_who_cannot_be_near_nothing_is_said() -> None:
    far = replace(heard().view(EPOCH_S + 12.0).others, places_ned_m=np.array([(9_000.0, 0.0)]))
    view = replace(heard().view(EPOCH_S + 12.0), others=far)
    neighbours = around(view)
    assert (len(neighbours.ids), neighbours.unseparated) == (0, None)


def test_who_is_told_beyond_the_range_of_a_detector_that_works_is_left_to_it() -> None:
    view = heard().view(EPOCH_S + 1.0)
    stranger = Traffic(None, (50.0, 0.0), (0.0, 0.0))
    short = CONFIG.model_copy(update={"detector_range_m": 90.0})
    with_stranger = heard().with_traffic(view, [stranger])
    assert around(with_stranger).ids.tolist() == [NOBODY, 3]
    assert around(with_stranger, short).ids.tolist() == [NOBODY]
    assert around(view, short).ids.tolist() == [3]


def test_without_a_detector_by_configuration_nobody_counts() -> None:
    config = CONFIG.model_copy(update={"detector": "none"})
    assert len(around(heard().view(EPOCH_S + 1.0), config).ids) == 0


def test_a_view_of_nobody_has_no_neighbours() -> None:
    assert len(around(replace(heard().view(EPOCH_S + 1.0), others=Others())).ids) == 0


@pytest.mark.parametrize(
    ("detector", "told", "sees", "exists", "words"),
    [
        ("adsb", (2, 2), True, True, "others: own receiver (ADSB_VEHICLE); places of the broadcast"),
        ("adsb", (2, 2), None, True, "others: ADSB_VEHICLE asked for, none came; places of the broadcast"),
        ("adsb", (2, 2), False, True, "others: no receiver (ADSB_TYPE 0); places of the broadcast"),
        ("adsb", (2, 0), None, True, "others: ADSB_VEHICLE asked for, none came; no places in the broadcast"),
        ("adsb", (2, 0), False, False, "no sense of others: no receiver (ADSB_TYPE 0), no places in the broadcast"),
        ("broadcast", (2, 0), True, True, "others: no receiver configured; no places in the broadcast"),
        ("broadcast", (2, 0), None, False, "no sense of others: no receiver configured, no places in the broadcast"),
        ("broadcast", (0, 0), None, True, "others: no receiver configured; none in the broadcast"),
        ("none", (2, 2), True, False, "no sense of others is configured: separation_m 20 is not kept"),
    ],
)
def test_the_sense_of_others_is_said_in_words(
    detector: str, told: tuple[int, int], sees: bool | None, exists: bool, words: str
) -> None:
    config = CONFIG.model_copy(update={"detector": detector})
    sense = sense_of_others(config, told, sees, asked=True)
    assert sense.exists is exists
    assert sense.words.startswith(words)
    assert (without_a_sense(config, told, sees) is None) is exists
