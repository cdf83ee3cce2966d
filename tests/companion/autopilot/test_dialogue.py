"""Whether the autopilot answers, in which version of MAVLink it is spoken to, and what is said of it."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import common

from companion.autopilot.arducopter import ArduCopterAdapter
from companion.autopilot.dialogue import OLD_AFTER_S, SIGNS, SILENT_AFTER_S, SPEAKS_OLD, packed
from companion.autopilot.intake import decode, is_whole
from companion.autopilot.linked import LinkedAdapter
from companion.autopilot.registry import ADAPTERS
from companion.protocol.frame import raw_frame
from tests.companion.autopilot.autopilot_stream import START_S, SYSTEM, Autopilot


def talk(
    adapter: LinkedAdapter, seconds: int, *, old: bool, answers: bool = False, from_s: float = START_S
) -> set[int]:
    """Let an autopilot be heard and asked; return the versions of MAVLink in which it was asked in the last second."""
    autopilot = Autopilot()
    versions: set[int] = set()
    for step in range(10 * seconds):
        now_s = from_s + 0.1 * step
        quad = common.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3)
        adapter.receive(autopilot.sends(quad, now_s, force_mavlink1=old).frame, now_s)
        asked = {raw_frame(frame).version for frame in adapter.requests(now_s)}
        versions = asked if step % 10 == 0 else versions | asked
        if answers and asked:
            ack = common.MAVLink_command_ack_message(common.MAV_CMD_SET_MESSAGE_INTERVAL, 0)
            adapter.receive(autopilot.sends(ack, now_s, force_mavlink1=old).frame, now_s)
    return versions


def test_an_autopilot_that_sends_mavlink_1_and_answers_is_spoken_to_in_mavlink_2() -> None:
    adapter = ArduCopterAdapter(SYSTEM)
    assert talk(adapter, 4, old=True, answers=True) == {2}
    assert adapter.unusual == SPEAKS_OLD


def test_one_that_sends_mavlink_1_and_does_not_answer_is_spoken_to_in_mavlink_1() -> None:
    adapter = ArduCopterAdapter(SYSTEM)
    assert talk(adapter, int(OLD_AFTER_S) + 2, old=True) == {1}
    assert raw_frame(adapter.heartbeat()).version == 1
    # It stays so once it answers, and ends when MAVLink 2 is heard.
    assert talk(adapter, 2, old=True, answers=True, from_s=START_S + 20.0) <= {1}
    talk(adapter, 1, old=False, from_s=START_S + 30.0)
    assert raw_frame(adapter.heartbeat()).version == 2
    assert adapter.unusual is None


@pytest.mark.parametrize("kind", sorted(ADAPTERS))
def test_what_is_sent_in_mavlink_1_is_read_as_it_was_meant(kind: str) -> None:
    mav = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=191)
    attitude = common.MAVLink_set_attitude_target_message(5, SYSTEM, 1, 0xC6, [1.0, 0.0, 0.0, 0.0], 0.1, 0.2, 0.3, 0.5)
    velocity = common.MAVLink_set_position_target_local_ned_message(5, SYSTEM, 1, 1, 0x9C7, *[1.5] * 11)
    for message in (attitude, velocity, common.MAVLink_param_request_read_message(SYSTEM, 1, b"GUID_TIMEOUT", -1)):
        old, new = (raw_frame(packed(message, mav, in_old_version)) for in_old_version in (True, False))
        assert (old.version, new.version) == (1, 2)
        assert is_whole(old)
        assert str(decode(old)) == str(decode(new))
    assert len(packed(attitude, mav, True)) == 6 + 39 + 2


def test_an_autopilot_that_answers_nothing_is_said_to() -> None:
    adapter = ArduCopterAdapter(SYSTEM)
    talk(adapter, int(SILENT_AFTER_S) + 2, old=False)
    words = adapter.silence(START_S + SILENT_AFTER_S + 2.0)
    assert words is not None and words.startswith("the autopilot answers nothing: check the way to it")


def test_one_that_signs_its_frames_and_answers_nothing_takes_only_signed_ones() -> None:
    adapter = ArduCopterAdapter(SYSTEM)
    assert adapter.note_signed() and not adapter.note_signed()
    talk(adapter, int(SILENT_AFTER_S) + 2, old=False)
    words = adapter.silence(START_S + SILENT_AFTER_S + 2.0)
    assert words is not None and words.startswith(f"{SIGNS} and answers nothing")


def test_one_that_answers_anything_is_not_silent() -> None:
    adapter = ArduCopterAdapter(SYSTEM)
    talk(adapter, int(SILENT_AFTER_S) + 2, old=False, answers=True)
    assert adapter.silence(START_S + 60.0) is None
