"""Which address is the autopilot's: what is sent goes there, and no stranger draws it away."""

from __future__ import annotations

import itertools

from hypothesis import given
from hypothesis import strategies as st

from companion.onboard.peer import FRAMES, MAX_ADDRESSES, SILENT_S, Peer
from companion.protocol.frame import RawFrame, raw_frame
from companion.transport.endpoints import Address
from tests.companion.autopilot.autopilot_stream import START_S, SYSTEM, Autopilot

HOME, OTHER, STRANGER = ("10.0.0.1", 14550), ("10.0.0.2", 14550), ("10.0.0.9", 9)


class Bound(Peer):
    """A peer with the addresses that it was told to bind."""

    def __init__(self) -> None:
        super().__init__()
        self.told: list[Address] = []
        self.bind = self.told.append


def frames(number: int) -> list[RawFrame]:
    sent = itertools.chain.from_iterable(Autopilot().seconds(1 + number // 24))
    return [raw_frame(one) for one in itertools.islice((one for one in sent if isinstance(one, bytes)), number)]


def test_before_the_autopilot_is_known_whoever_speaks_as_one_is_answered() -> None:
    peer = Bound()
    peer.note_speaker(STRANGER)
    peer.note_speaker(HOME)
    peer.note_believed(HOME, 1, START_S)
    peer.note_speaker(STRANGER)
    assert peer.told == [STRANGER, HOME, HOME]


@given(st.lists(st.tuples(st.sampled_from([OTHER, STRANGER]), st.integers(1, 5)), max_size=30))
def test_while_the_autopilots_address_goes_on_no_other_one_takes_its_place(others: list[tuple[Address, int]]) -> None:
    peer = Bound()
    for step, (address, number) in enumerate(others):
        peer.note_believed(HOME, 1, START_S + 0.1 * step)
        peer.note_believed(address, number, START_S + 0.1 * step + 0.05)
    assert set(peer.told) <= {HOME}


def test_once_it_is_silent_one_that_goes_on_takes_its_place() -> None:
    peer = Bound()
    peer.note_believed(HOME, 1, START_S)
    for step in range(FRAMES + 1):
        peer.note_believed(OTHER, 1, START_S + SILENT_S / 2 + 0.1 * step)
    assert peer.told == [HOME, OTHER]


def test_one_frame_from_elsewhere_takes_no_place_however_long_it_was_silent() -> None:
    peer = Bound()
    peer.note_believed(HOME, 1, START_S)
    peer.note_believed(STRANGER, 1, START_S + 60.0)
    assert peer.told == [HOME]


def test_a_frame_in_the_autopilots_name_from_elsewhere_is_a_strangers_while_the_address_is_heard() -> None:
    peer = Bound()
    (frame,) = frames(1)
    assert not peer.is_stranger(STRANGER, frame, SYSTEM, START_S)
    peer.note_believed(HOME, 1, START_S)
    assert peer.is_stranger(STRANGER, frame, SYSTEM, START_S + 0.1)
    assert not peer.is_stranger(HOME, frame, SYSTEM, START_S + 0.1)
    assert not peer.is_stranger(STRANGER, frame, SYSTEM + 1, START_S + 0.1)
    assert not peer.is_stranger(STRANGER, frame, SYSTEM, START_S + SILENT_S)


def test_copying_the_autopilots_frames_makes_nobody_less_of_a_stranger() -> None:
    peer = Bound()
    peer.note_believed(HOME, 1, START_S)
    (*copied, newer) = frames(21)
    for frame in copied:
        assert not peer.is_stranger(HOME, frame, SYSTEM, START_S)
        assert peer.is_stranger(OTHER, frame, SYSTEM, START_S)
    assert peer.is_stranger(OTHER, newer, SYSTEM, START_S)


def test_any_number_of_addresses_is_survived_and_few_are_kept() -> None:
    peer = Bound()
    peer.note_believed(HOME, 1, START_S)
    for port, frame in enumerate(frames(4 * MAX_ADDRESSES)):
        peer.is_stranger(("10.0.0.3", port), frame, SYSTEM, START_S)
        peer.note_believed(("10.0.0.3", port), 1, START_S)
    assert len(peer._frames) <= MAX_ADDRESSES
