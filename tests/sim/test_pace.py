"""The pace of the virtual clock: as fast as asked, standing in a pause, and without a leap when that changes."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim.pace import LATE_S, Pace


def test_without_a_speed_nothing_is_waited_for() -> None:
    assert Pace().wait_s(1_000.0, 0.0) == 0.0


def test_a_tick_is_due_when_the_wall_clock_has_come_as_far() -> None:
    pace = Pace(20.0, wall_s=5.0)
    assert pace.wait_s(40.0, 5.5) == pytest.approx(1.5)
    assert pace.wait_s(40.0, 8.0) == 0.0


@pytest.mark.parametrize("late_s", [0.06, 1.0, 30.0])
def test_what_was_late_is_not_made_up_for_by_going_faster_than_asked(late_s: float) -> None:
    pace = Pace(20.0).kept(20.0, 1.0 + late_s)
    assert pace.wait_s(20.0, 1.0 + late_s) == 0.0
    assert pace.wait_s(40.0, 1.0 + late_s) == pytest.approx(1.0 - LATE_S)


def test_what_a_sleep_was_too_long_is_made_up_for() -> None:
    pace = Pace(20.0)
    assert pace.kept(20.0, 1.0 + 0.5 * LATE_S) is pace


def test_a_clock_that_stands_is_never_due() -> None:
    assert Pace(None, playing=False).wait_s(0.0, 1e9) is None


@given(st.floats(0.1, 1_000.0), st.floats(0.1, 1_000.0), st.floats(0.0, 1e4), st.floats(0.0, 1e4))
def test_a_pause_and_another_speed_make_no_leap(speed: float, other: float, t_s: float, paused_s: float) -> None:
    pace = Pace(speed).changed(t_s, t_s / speed, playing=False)
    again_s = t_s / speed + paused_s
    pace = pace.changed(t_s, again_s, speed=other, playing=True)
    assert pace.wait_s(t_s, again_s) == 0.0
    assert pace.wait_s(t_s + 1.0, again_s) == pytest.approx(1.0 / other, abs=1e-6)
