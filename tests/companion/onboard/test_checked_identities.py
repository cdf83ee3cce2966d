"""A transponder's word on an agent counts where the broadcast lets that agent be; else it is a stranger's."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from companion.guidance.view import NOBODY, Others, Traffic
from companion.onboard.world_view import IDENTITY_SLACK_M, checked_identities

FASTEST_M_S = 10.0
AGE_S = 2.0
MATE = 2
STILL = (0.0, 0.0)
PLACES = st.tuples(st.floats(-3e3, 3e3), st.floats(-3e3, 3e3))


def told_at(*places_ned_m: tuple[float, float], age_s: float = AGE_S) -> Others:
    """Return agents MATE, MATE + 1, ... that stood at places."""
    count = len(places_ned_m)
    return Others(
        ids=np.arange(MATE, MATE + count),
        places_ned_m=np.array(places_ned_m).reshape(-1, 2),
        velocities_m_s=np.zeros((count, 2)),
        ages_s=np.full(count, age_s),
        moving_told=np.ones(count, dtype=bool),
        rounding_m=np.ones(count),
    )


def test_an_agent_seen_near_where_it_was_told_to_be_is_that_agent() -> None:
    shown = checked_identities(told_at((0.0, 0.0)), [Traffic(MATE, (0.0, 30.0), STILL)], (), FASTEST_M_S)
    assert shown.seen[0].agent_id == MATE
    assert shown.placed == {MATE}


def test_who_claims_to_be_an_agent_where_it_cannot_be_is_a_stranger_and_the_agent_counts_as_told() -> None:
    shown = checked_identities(told_at((0.0, 0.0)), [Traffic(MATE, (0.0, 300.0), STILL)], (), FASTEST_M_S)
    assert shown.seen[0].agent_id is None
    assert not shown.placed


def test_nobody_is_removed_by_a_word_that_it_is_far_away() -> None:
    far = Traffic(MATE, (0.0, 9_000.0), STILL)
    assert checked_identities(told_at((0.0, 0.0)), (), [far], FASTEST_M_S).placed == frozenset()


def test_a_true_word_counts_beside_a_forged_one() -> None:
    both = [Traffic(MATE, (0.0, 300.0), STILL), Traffic(MATE, (1.0, 1.0), STILL)]
    shown = checked_identities(told_at((0.0, 0.0)), both, (), FASTEST_M_S)
    assert [other.agent_id for other in shown.seen] == [None, MATE]
    assert shown.placed == {MATE}


def test_a_forged_velocity_explains_no_place() -> None:
    quick = Traffic(MATE, (0.0, 300.0), (500.0, 0.0), age_s=1.0)
    assert checked_identities(told_at((0.0, 0.0)), [quick], (), FASTEST_M_S).seen[0].agent_id is None


def test_an_agent_whose_place_was_not_told_is_who_it_says() -> None:
    seen = [Traffic(9, (0.0, 300.0), STILL), Traffic(None, (1.0, 1.0), STILL)]
    assert checked_identities(told_at((0.0, 0.0)), seen, (), FASTEST_M_S).seen == tuple(seen)


@given(
    start=PLACES,
    turned_rad=st.floats(-math.pi, math.pi),
    told_rad=st.floats(-math.pi, math.pi),
    age_s=st.floats(0.0, 60.0),
    seen_age_s=st.floats(0.0, 5.0),
)
def test_an_agent_that_keeps_to_its_speed_is_always_recognised(
    start: tuple[float, float], turned_rad: float, told_rad: float, age_s: float, seen_age_s: float
) -> None:
    told = told_at(start, age_s=age_s)
    told.velocities_m_s[:] = FASTEST_M_S * np.array([math.cos(told_rad), math.sin(told_rad)])
    flown_m = FASTEST_M_S * age_s
    now = (start[0] + flown_m * math.cos(turned_rad), start[1] + flown_m * math.sin(turned_rad))
    seen = [Traffic(MATE, now, STILL, seen_age_s)]
    assert checked_identities(told, seen, (), FASTEST_M_S).placed == {MATE}


@given(
    told=st.lists(PLACES, min_size=1, max_size=4),
    forged=st.lists(st.tuples(st.integers(MATE, MATE + 4) | st.none(), PLACES, PLACES, st.booleans()), max_size=6),
)
def test_whatever_is_forged_every_agent_told_counts_where_it_was_told_to_be_or_close_by(
    told: list[tuple[float, float]], forged: list[tuple[int | None, tuple[float, float], tuple[float, float], bool]]
) -> None:
    others = told_at(*told)
    near = [Traffic(identity, place, velocity) for identity, place, velocity, is_near in forged if is_near]
    far = [Traffic(identity, place, velocity) for identity, place, velocity, is_near in forged if not is_near]
    shown = checked_identities(others, near, far, FASTEST_M_S)
    most_m = 1.0 + IDENTITY_SLACK_M + 2.0 * FASTEST_M_S * AGE_S
    for identity, place in zip(others.ids.tolist(), told, strict=True):
        if identity in shown.placed:
            named = [other for other in (*shown.seen, *far) if other.agent_id == identity]
            assert any(math.dist(other.position_ned_m, place) <= most_m for other in named)
    assert all((other.agent_id or NOBODY) in (NOBODY, *shown.placed) for other in shown.seen)
