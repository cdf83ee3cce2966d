"""What is reckoned with is never bolder than the configuration, nor than the vehicle can."""

import math
import re

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from companion.autopilot.adapter import Abilities
from companion.onboard.config import LimitsSection
from companion.onboard.limits import beyond_airspeed, unable, within

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


# The air that it flies through

COPTER = Abilities(
    speed_max_m_s=8.755,
    airspeed_max_m_s=10.3,
    airspeed_by="ANGLE_MAX 3000",
    airspeed_remedy="ANGLE_MAX to 4500 (15 m/s)",
)


def limits_of(speed_m_s: float, wind_m_s: float, airspeed_max_m_s: float | None = None) -> LimitsSection:
    return LimitsSection(speed_m_s=speed_m_s, wind_m_s=wind_m_s, airspeed_max_m_s=airspeed_max_m_s)


def test_a_speed_and_a_wind_beyond_the_airspeed_are_refused_with_both_numbers_and_the_remedy() -> None:
    shortage = beyond_airspeed(limits_of(8.0, 5.0), COPTER)
    assert shortage is not None
    assert shortage.words == (
        "limits.speed_m_s 8 + wind_m_s 5 = 13 m/s through the air; it reaches 10.3 (ANGLE_MAX 3000)"
    )
    assert shortage.remedy == "set speed_m_s to 5.3 or wind_m_s to 2.3 or ANGLE_MAX to 4500 (15 m/s)"


@pytest.mark.parametrize(("speed_m_s", "wind_m_s"), [(8.0, 0.0), (8.0, 2.3), (5.3, 5.0), (10.0, 1.5)])
def test_within_the_airspeed_nothing_is_refused(speed_m_s: float, wind_m_s: float) -> None:
    # The last is slowed to 8.755 m/s by its own parameters.
    assert unable(limits_of(speed_m_s, wind_m_s), COPTER, can_stop=True) is None


def test_a_plane_flies_at_its_airspeed_whatever_the_wind() -> None:
    plane = Abilities(speed_min_m_s=9.0, speed_max_m_s=22.0, airspeed_max_m_s=22.0, airspeed_by="AIRSPEED_MAX 22")
    assert unable(limits_of(22.0, 7.0), plane, can_stop=False) is None


def test_a_stated_airspeed_counts_where_it_is_less() -> None:
    shortage = beyond_airspeed(limits_of(5.0, 3.0, airspeed_max_m_s=7.0), COPTER)
    assert shortage is not None
    assert "it reaches 7 (limits.airspeed_max_m_s)" in shortage.words
    assert "ANGLE_MAX" not in shortage.remedy
    assert beyond_airspeed(limits_of(8.0, 5.0, airspeed_max_m_s=20.0), COPTER) is not None


def test_where_nothing_is_known_of_the_drag_a_stated_airspeed_alone_counts() -> None:
    unknown = Abilities(airspeed_by="not told by its parameters")
    assert beyond_airspeed(limits_of(10.0, 9.0), unknown) is None
    assert beyond_airspeed(limits_of(10.0, 9.0, airspeed_max_m_s=13.0), unknown) is not None


@given(st.floats(0.5, 30.0), st.floats(0.0, 30.0), st.floats(0.5, 30.0))
def test_each_remedy_alone_is_enough(speed_m_s: float, wind_m_s: float, airspeed_m_s: float) -> None:
    assume(wind_m_s < speed_m_s)
    able = Abilities(airspeed_max_m_s=airspeed_m_s, airspeed_by="by")
    shortage = beyond_airspeed(limits_of(speed_m_s, wind_m_s), able)
    assert (shortage is None) == (speed_m_s + wind_m_s <= airspeed_m_s + 1e-6)
    if shortage is None or "together" in shortage.remedy:
        return
    for key, value in re.findall(r"(speed_m_s|wind_m_s) to ([0-9.e-]+)", shortage.remedy):
        now = {"speed_m_s": speed_m_s, "wind_m_s": wind_m_s, key: float(value)}
        assert now["wind_m_s"] < now["speed_m_s"] or math.isclose(now["wind_m_s"], now["speed_m_s"], abs_tol=0.011)
        assert now["speed_m_s"] + now["wind_m_s"] <= airspeed_m_s + 1e-5


def test_a_value_that_no_vehicle_has_is_a_reason_of_its_own() -> None:
    words = unable(
        limits_of(8.0, 0.0), Abilities(insane=("ANGLE_MAX 0 is not a sane value (1000 to 8000)",)), can_stop=True
    )
    assert words == "ANGLE_MAX 0 is not a sane value (1000 to 8000): correct it on the autopilot"
