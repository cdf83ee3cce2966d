"""LinkMonitor: what is heard against what must have been sent, judged from the frames that were heard."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.protocol.freshness import SenderClock
from companion.protocol.link_quality import MAX_ARRIVALS, LinkMonitor, LinkQuality, Warnings
from companion.protocol.messages import Detection, DetectionsFrame, Directive, Kind, MotionFrame, Stamp, StateFrame

EPOCH_S = 1_800_000_000


def state(sequence: int, at_s: float, index: int = 0, count: int = 1, epoch_s: int = EPOCH_S) -> StateFrame:
    stamp = Stamp(epoch_s, round((at_s - epoch_s) * 1000), sequence, index, count)
    return StateFrame(stamp, 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, (), (), ())


def heard(seconds: int, keep: int, of: int, *, period_s: float = 1.0) -> tuple[LinkMonitor, float]:
    """Return a link monitor that heard `keep` of every `of` broadcasts, and the time at the end."""
    link_monitor = LinkMonitor()
    for number in range(round(seconds / period_s)):
        at_s = EPOCH_S + number * period_s
        if number % of < keep:
            link_monitor.note(state(number, at_s), at_s)
    return link_monitor, EPOCH_S + seconds - 0.5 * period_s


def quality_of(share: float) -> LinkQuality:
    return LinkQuality(round(100 * share), 100, share, 0.0, {})


def test_before_anything_is_heard_nothing_is_known() -> None:
    quality = LinkMonitor().quality(EPOCH_S)
    assert (quality.received, quality.expected, quality.share, quality.last_good_s) == (0, 0, 0.0, None)
    assert quality.ages_s == {}


@pytest.mark.parametrize("period_s", [0.2, 1.0, 5.0])
def test_all_frames_heard_are_a_share_of_one(period_s: float) -> None:
    link_monitor, now_s = heard(200, 1, 1, period_s=period_s)
    quality = link_monitor.quality(now_s)
    assert quality.received == quality.expected == round(60 / period_s)
    assert quality.share == 1.0


@pytest.mark.parametrize(("keep", "of"), [(9, 10), (1, 2), (1, 5), (1, 20)])
def test_the_share_heard_is_found_from_the_frames_alone(keep: int, of: int) -> None:
    link_monitor, now_s = heard(200, keep, of)
    assert link_monitor.quality(now_s).share == pytest.approx(keep / of, abs=0.02)


def test_every_frame_of_a_broadcast_in_parts_is_expected() -> None:
    link_monitor = LinkMonitor()
    for number in range(100):
        for index in range(3):
            link_monitor.note(state(number, EPOCH_S + number, index, count=4), EPOCH_S + number)
    assert link_monitor.quality(EPOCH_S + 99.5).share == pytest.approx(0.75)


@settings(max_examples=60, deadline=None)
@given(
    sizes=st.lists(st.tuples(st.integers(1, 40), st.integers(1, 30)), min_size=1, max_size=4),
    period_s=st.floats(0.5, 5.0),
    stretch=st.floats(0.2, 8.0),
)
def test_with_nothing_lost_reception_is_never_bad_whatever_the_sizes_of_the_broadcasts(
    sizes: list[tuple[int, int]], period_s: float, stretch: float
) -> None:
    link_monitor, warnings = LinkMonitor(), Warnings()
    at_s, number = float(EPOCH_S), 0
    for part, (count, broadcasts) in enumerate(sizes):
        lasts_s = period_s * (stretch if part % 2 else 1.0)
        for _ in range(broadcasts):
            for index in range(count):
                link_monitor.note(state(number, at_s, index, count), at_s)
                assert warnings.update(link_monitor.quality(at_s)) is None
                # The frames of a broadcast are sent over its period.
                at_s += lasts_s / count
            number += 1


def test_a_broadcast_of_which_nothing_is_heard_counts_as_one_of_their_mean_size() -> None:
    link_monitor = LinkMonitor()
    for number in range(100):
        for index in range(3 if number % 2 else 0):
            link_monitor.note(state(number, EPOCH_S + number, index, count=3), EPOCH_S + number)
    assert link_monitor.quality(EPOCH_S + 99.9).share == pytest.approx(0.5, abs=0.02)


def test_silence_counts_as_loss_until_nothing_is_left() -> None:
    link_monitor, now_s = heard(100, 1, 1)
    assert link_monitor.quality(now_s + 30).share == pytest.approx(0.5)
    quality = link_monitor.quality(now_s + 61)
    assert (quality.received, quality.share) == (0, 0.0)
    assert quality.last_good_s == EPOCH_S + 99


def test_a_leap_of_the_sequence_is_no_loss() -> None:
    link_monitor = LinkMonitor()
    for number in range(100):
        sequence = number if number < 50 else number + 1_000_000
        link_monitor.note(state(sequence, EPOCH_S + number), EPOCH_S + number)
    assert link_monitor.quality(EPOCH_S + 99.5).share == 1.0


def test_a_restarted_ground_station_is_no_loss() -> None:
    link_monitor = LinkMonitor()
    for number in range(100):
        epoch_s = EPOCH_S + (50 if number >= 50 else 0)
        link_monitor.note(state(number % 50, EPOCH_S + number, epoch_s=epoch_s), EPOCH_S + number)
    assert link_monitor.quality(EPOCH_S + 99.5).share == 1.0


def test_each_kind_of_news_has_its_own_age() -> None:
    link_monitor = LinkMonitor()
    link_monitor.note(state(1, EPOCH_S + 1), EPOCH_S + 2)
    link_monitor.note(MotionFrame(Stamp(EPOCH_S, 4000, 1), (), (), ()), EPOCH_S + 5)
    assert link_monitor.quality(EPOCH_S + 10).ages_s == {"state": 9.0, "motion": 6.0}
    assert link_monitor.quality(EPOCH_S + 10).last_good_s == EPOCH_S + 5


def test_older_news_that_comes_later_makes_nothing_older() -> None:
    link_monitor = LinkMonitor()
    link_monitor.note(state(1, EPOCH_S + 9), EPOCH_S + 9)
    link_monitor.note(state(1, EPOCH_S + 4), EPOCH_S + 9)
    assert link_monitor.quality(EPOCH_S + 10).ages_s == {"state": 1.0}


def test_a_sender_whose_clock_is_ahead_makes_no_age_negative() -> None:
    link_monitor = LinkMonitor()
    link_monitor.note(state(1, EPOCH_S + 5), EPOCH_S + 2)
    assert link_monitor.quality(EPOCH_S + 3).ages_s == {"state": 1.0}


def test_a_frame_that_is_no_broadcast_is_not_counted() -> None:
    link_monitor = LinkMonitor()
    look = DetectionsFrame(EPOCH_S, 0, 47.0, 8.0, (Detection(Kind.AGENT, 1, 0.0, 0.0, 0.0, 0.0),))
    link_monitor.note(look, EPOCH_S)
    assert link_monitor.quality(EPOCH_S).last_good_s is None


def test_memory_is_bounded() -> None:
    link_monitor = LinkMonitor()
    frame = state(1, EPOCH_S)
    for _ in range(MAX_ARRIVALS + 100):
        link_monitor.note(frame, EPOCH_S)
    assert link_monitor.quality(EPOCH_S).received == MAX_ARRIVALS


def test_a_warning_begins_below_a_half_and_ends_above_seven_tenths() -> None:
    warnings = Warnings()
    said = [warnings.update(quality_of(share)) for share in (0.9, 0.55, 0.49, 0.45, 0.6, 0.69, 0.71, 0.6, 0.4)]
    assert [line is not None for line in said] == [False, False, True, False, False, False, True, False, True]
    assert said[2] == "warning: reception is bad: 49 of 100 frames heard"
    assert said[6] == "reception is good again: 71 of 100 frames heard"
    assert warnings.active


def test_the_first_few_frames_are_no_reason_to_warn() -> None:
    assert Warnings().update(LinkQuality(1, 9, 0.11, 0.0, {})) is None
    assert Warnings().update(LinkQuality(1, 10, 0.1, 0.0, {})) is not None


@pytest.mark.parametrize("offset_s", [-3_600.0, 0.0, 3_600.0])
def test_where_clocks_do_not_agree_a_frame_is_late_by_what_it_took_more_than_the_quickest(offset_s: float) -> None:
    clock = SenderClock(agrees=False)
    late_s = []
    for number, delay_s in enumerate([0.5, 0.2, 7.2, 0.2]):
        arrived_s = EPOCH_S + number + offset_s + delay_s
        late_s.append(arrived_s - clock.true_at_s(state(number, EPOCH_S + number).stamp, arrived_s))
    assert late_s == pytest.approx([0.0, 0.0, 7.0, 0.0], abs=1e-6)


def test_a_new_run_of_the_sender_is_measured_anew_where_clocks_do_not_agree() -> None:
    clock = SenderClock(agrees=False)
    clock.true_at_s(Stamp(EPOCH_S, 0, 1), EPOCH_S)
    assert clock.true_at_s(Stamp(EPOCH_S + 60, 0, 1), EPOCH_S + 3_660.0) == EPOCH_S + 3_660.0


def test_ages_do_not_hold_the_difference_of_clocks_that_do_not_agree() -> None:
    link_monitor = LinkMonitor(clocks_agree=False)
    link_monitor.note(state(1, EPOCH_S + 1.0), EPOCH_S + 3_601.0)
    assert link_monitor.quality(EPOCH_S + 3_603.0).ages_s == {"state": pytest.approx(2.0)}
