"""What is reckoned with is never bolder than the configuration, nor than the vehicle can."""

from hypothesis import given
from hypothesis import strategies as st

from companion.autopilot.adapter import Abilities
from companion.onboard.config import LimitsSection
from companion.onboard.limits import within

CONFIGURED = LimitsSection(
    speed_m_s=10.0, n_max=0.5, braking_m_s2=2.0, reaction_s=0.2, position_error_m=3.0, wind_m_s=4.0
)


def test_a_perfect_vehicle_changes_nothing() -> None:
    assert within(CONFIGURED, Abilities()) == CONFIGURED


def test_a_lesser_vehicle_lowers_what_it_cannot_do() -> None:
    less = Abilities(speed_max_m_s=8.0, n_max=0.2, reaction_s=0.6, braking_m_s2=1.5, tracking_m=2.0)
    found = within(CONFIGURED, less)
    assert (found.speed_m_s, found.n_max, found.reaction_s, found.braking_m_s2) == (8.0, 0.2, 0.6, 1.5)
    assert found.position_error_m == 5.0


def test_one_that_flies_no_slower_is_reckoned_with_at_the_speed_it_flies() -> None:
    assert within(CONFIGURED, Abilities(speed_min_m_s=15.0, speed_max_m_s=15.0)).speed_m_s == 15.0


@given(
    st.builds(
        Abilities,
        speed_max_m_s=st.floats(0.0, 100.0),
        n_max=st.floats(0.0, 10.0),
        reaction_s=st.floats(0.0, 5.0),
        braking_m_s2=st.floats(0.0, 10.0),
        tracking_m=st.floats(0.0, 50.0),
    )
)
def test_whatever_the_vehicle_can_the_limits_are_at_most_both(abilities: Abilities) -> None:
    found = within(CONFIGURED, abilities)
    assert found.speed_m_s <= min(CONFIGURED.speed_m_s, abilities.speed_max_m_s)
    assert found.n_max <= min(CONFIGURED.n_max, abilities.n_max)
    assert found.braking_m_s2 <= min(CONFIGURED.braking_m_s2, abilities.braking_m_s2)
    assert found.reaction_s >= max(CONFIGURED.reaction_s, abilities.reaction_s)
    assert found.position_error_m >= CONFIGURED.position_error_m + abilities.tracking_m
    assert found.wind_m_s == CONFIGURED.wind_m_s
