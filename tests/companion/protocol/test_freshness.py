"""Newest wins by epoch and sequence; the clock decides how old is too old."""

from __future__ import annotations

import pytest

from companion.protocol.freshness import (
    FUTURE_STAMP,
    OLD_EPOCH,
    OLD_SEQUENCE,
    PAST_STAMP,
    RESTART_AFTER_S,
    Lateness,
    SenderClock,
    off_the_clock,
    overtaken,
)
from companion.protocol.messages import Stamp

EPOCH_S = 1_800_000_000


@pytest.mark.parametrize(
    ("epoch_s", "sequence", "reason"),
    [
        (EPOCH_S, 7, None),
        (EPOCH_S, 8, None),
        (EPOCH_S, 6, OLD_SEQUENCE),
        (EPOCH_S - 1, 900, OLD_EPOCH),
        (EPOCH_S + 1, 0, None),
    ],
)
def test_epoch_and_sequence_together_are_the_order_of_age(epoch_s: int, sequence: int, reason: str | None) -> None:
    assert overtaken(Stamp(epoch_s, 0, sequence), (EPOCH_S, 7), 0.0) == reason


def test_after_a_long_silence_no_stamp_is_too_old() -> None:
    old = Stamp(EPOCH_S - 1, 0, 1)
    assert overtaken(old, (EPOCH_S, 7), RESTART_AFTER_S - 0.1) == OLD_EPOCH
    assert overtaken(old, (EPOCH_S, 7), RESTART_AFTER_S) is None


@pytest.mark.parametrize(
    ("age_s", "reason"), [(0.0, None), (29.9, None), (30.1, PAST_STAMP), (-1.9, None), (-2.1, FUTURE_STAMP)]
)
def test_a_stamp_is_refused_that_is_too_old_or_ahead_by_the_clock(age_s: float, reason: str | None) -> None:
    stamp = Stamp(EPOCH_S, 5_500, 1)
    assert off_the_clock(stamp, EPOCH_S + 5.5 + age_s, ahead_s=2.0, max_age_s=30.0) == reason


@pytest.mark.parametrize("ahead_s", [100.0, 86_400.0])
def test_a_stamp_far_ahead_does_not_make_all_that_follow_old_for_good(ahead_s: float) -> None:
    clock = SenderClock(agrees=False)
    clock.true_at_s(Stamp(EPOCH_S, 0, 1), 50.0)
    clock.true_at_s(Stamp(EPOCH_S, round(1000 * ahead_s), 2), 51.0)
    assert clock.true_at_s(Stamp(EPOCH_S, 2000, 3), 52.0) == pytest.approx(52.0)


def test_a_delay_is_no_clock_that_was_set_right() -> None:
    clock = SenderClock(agrees=False)
    clock.true_at_s(Stamp(EPOCH_S, 0, 1), 50.0)
    assert clock.true_at_s(Stamp(EPOCH_S, 1000, 2), 150.0) == pytest.approx(51.0)


def test_the_least_lateness_is_that_of_the_quickest_frame_of_the_window() -> None:
    lateness = Lateness(window_s=10.0)
    assert lateness.least_s(0.0) is None
    for at_s, late_s in ((0.0, 3.0), (1.0, -1.0), (12.0, 5.0)):
        lateness.note(late_s, at_s)
    assert lateness.least_s(13.0) == -1.0
    assert lateness.least_s(23.0) == 5.0
    assert lateness.least_s(100.0) is None
