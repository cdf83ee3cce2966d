"""Which frames are new: what begins an epoch says so, and what was overtaken is refused."""

from __future__ import annotations

from companion.onboard.frame_order import Acceptance, FrameOrder
from companion.protocol.codec import Stamp
from companion.protocol.freshness import RESTART_AFTER_S

EPOCH_S = 1_790_000_000


def stamp(sequence: int, index: int = 0, count: int = 1, epoch_s: int = EPOCH_S) -> Stamp:
    return Stamp(epoch_s, 1_000 * sequence, sequence, index, count)


def order_of(*stamps: Stamp) -> FrameOrder:
    order = FrameOrder()
    for one in stamps:
        order.take_part(one, 0.0)
    return order


def test_the_first_frame_of_an_epoch_begins_it_and_the_next_goes_on() -> None:
    order = FrameOrder()
    assert order.take_part(stamp(1), 0.0) is Acceptance.ANEW
    assert order.take_part(stamp(2), 0.0) is Acceptance.NEXT


def test_a_part_that_was_heard_is_refused() -> None:
    assert order_of(stamp(1, 0, 2)).take_part(stamp(1, 0, 2), 0.0) is Acceptance.REFUSED
    assert order_of(stamp(1, 0, 2)).take_part(stamp(1, 1, 2), 0.0) is Acceptance.NEXT


def test_a_lower_sequence_begins_its_epoch_again_only_after_a_silence() -> None:
    assert order_of(stamp(5)).take_part(stamp(1), RESTART_AFTER_S - 0.1) is Acceptance.REFUSED
    assert order_of(stamp(5)).take_part(stamp(1), RESTART_AFTER_S) is Acceptance.ANEW


def test_a_broadcast_is_whole_when_every_part_was_heard() -> None:
    last = stamp(1, 1, 2)
    assert not order_of(stamp(1, 0, 2)).is_whole(last)
    assert order_of(stamp(1, 0, 2), last).is_whole(last)


def test_what_does_not_change_within_an_epoch_is_never_overtaken() -> None:
    assert order_of(stamp(5)).take_constant(stamp(1), 0.0) is Acceptance.NEXT


def test_a_refused_constant_does_not_put_off_the_end_of_a_silence() -> None:
    order = order_of(stamp(5))
    assert order.take_constant(stamp(1, epoch_s=EPOCH_S - 1), 20.0) is Acceptance.REFUSED
    assert order.take_constant(stamp(1, epoch_s=EPOCH_S - 1), RESTART_AFTER_S) is Acceptance.ANEW


def test_motion_is_refused_of_another_epoch_and_where_newer_was_heard() -> None:
    order = order_of(stamp(2))
    assert not order.take_motion(stamp(2, epoch_s=EPOCH_S + 1))
    assert not order.take_motion(stamp(1))
    assert order.take_motion(stamp(3))
    assert not order.take_motion(stamp(2))
