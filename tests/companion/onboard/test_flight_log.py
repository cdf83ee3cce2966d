"""What a flight leaves behind: whole frames, no secrets, and words for what was decided."""

from __future__ import annotations

import io
import math
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common

from companion.files.tlog import TlogWriter, read_tlog
from companion.guard.types import NO_BACKUP, Setpoint
from companion.onboard.decision import Decision, Purpose
from companion.onboard.failsafe import Stage
from companion.onboard.flight_log import LOG_BURST_S, FlightLog, decision_frame, summary_line, unused
from companion.protocol.codec import Directive, FrameWriter, Stamp, StateFrame, decode_frame
from companion.protocol.frame import raw_frame
from companion.protocol.mavlink_signing import MavlinkSigner
from companion.protocol.messages import DecisionFlag

FRAME = FrameWriter().encode(StateFrame(Stamp(1_000, 0, 1), 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, (), (), ()))


def test_a_signature_is_cut_off_before_a_frame_is_kept() -> None:
    file = io.BytesIO()
    FlightLog(TlogWriter(file)).record(1.0, MavlinkSigner(bytes(range(32)), 0).sign(FRAME, 1.8e9))
    assert file.getvalue()[8:] == FRAME


def test_a_logged_decision_says_what_was_decided() -> None:
    setpoint = Setpoint(1.5, 20.0, 30.0)
    decision = Decision(1_000.25, Purpose.TARGET, "assigned", Stage.COASTING, 1.5, 3, 0.5, True, setpoint, (NO_BACKUP,))
    frame = decode_frame(raw_frame(FrameWriter().encode(decision_frame(decision))))
    assert frame == decision_frame(decision)
    assert (frame.time_us, frame.target_id, frame.heading_rad) == (1_000_250_000, 3, 1.5)
    assert frame.flags == DecisionFlag.TURN_LIMITED | DecisionFlag.GUARD_CHANGED | DecisionFlag.UNCERTIFIED


def test_decisions_that_differ_in_words_alone_are_logged_differently() -> None:
    one, other = (Decision(1.0, Purpose.LOITER, reason, Stage.FRESH, 0.0) for reason in ("arrived", "no target"))
    assert decision_frame(one).words_crc != decision_frame(other).words_crc


def test_without_a_picture_the_line_says_none() -> None:
    decision = Decision(0.0, Purpose.IDLE, "no autopilot heard", Stage.LOITERING, None)
    assert summary_line(decision) == "idle (no autopilot heard), picture none"


def test_the_line_names_target_stage_and_what_the_guard_changed() -> None:
    decision = Decision(0.0, Purpose.TARGET, "assigned", Stage.FRESH, 1.0, target_id=3, guard_changes=("keep-out",))
    assert summary_line(decision) == "target 3 (assigned), picture fresh, not certified, guard: keep-out"


@pytest.mark.parametrize(
    ("certified_s", "words"),
    [
        (math.inf, "certified for ever"),
        (30.5, "certified for a time only"),
        (2.0, "certified for a time only"),
        (0.0, "not certified"),
    ],
)
def test_the_line_names_the_kind_of_the_certificate_but_not_the_seconds(certified_s: float, words: str) -> None:
    decision = Decision(0.0, Purpose.LOITER, "arrived", Stage.FRESH, 1.0, certified_s=certified_s)
    assert summary_line(decision) == f"loiter (arrived), picture fresh, {words}"


class FullDisk(io.BytesIO):
    def write(self, data: object) -> int:
        raise OSError(28, "No space left on device")


def test_a_log_that_cannot_be_written_is_told_of_once(capsys: pytest.CaptureFixture[str]) -> None:
    log = FlightLog(TlogWriter(FullDisk()))
    for _ in range(3):
        log.record(1.0, FRAME)
    log.close()
    assert capsys.readouterr().err == ("companion: warning: no logs: No space left on device; flying without them\n")


def test_a_log_holds_the_frames_of_each_datagram_and_no_junk() -> None:
    file = io.BytesIO()
    log = FlightLog(TlogWriter(file))
    log.record(1.0, FRAME + FRAME + b"junk")
    log.record(2.0, b"junk")
    assert file.getvalue().count(FRAME) == 2
    assert len(file.getvalue()) == 2 * (8 + len(FRAME))


def test_without_a_folder_nothing_is_logged() -> None:
    log = FlightLog(None)
    log.record(1.0, FRAME)
    log.close()


def test_a_bounded_log_leaves_out_and_counts_what_a_flood_brings() -> None:
    file = io.BytesIO()
    log = FlightLog(TlogWriter(file), most_bytes_per_s=100.0)
    for number in range(2_000):
        log.record(1_000.0 + 0.01 * number, FRAME)
    written = len(file.getvalue()) // (8 + len(FRAME))
    assert 0 < written * len(FRAME) <= 100.0 * (20.0 + LOG_BURST_S)
    assert log.left_out == 2_000 - written


def test_what_is_logged_is_on_disk_a_second_later(tmp_path: Path) -> None:
    log = FlightLog(TlogWriter(tmp_path / "flight.tlog"))
    for t_s in (0.0, 0.5, 1.0):
        log.record(t_s, FRAME)
    assert (tmp_path / "flight.tlog").stat().st_size == 3 * (8 + len(FRAME))


def test_words_are_logged_in_parts_that_a_ground_control_program_joins(tmp_path: Path) -> None:
    log = FlightLog(TlogWriter(tmp_path / "flight.tlog"))
    log.tell(1.0, "a" * 50 + "b" * 7)
    log.tell(2.0, "c")
    log.close()
    reader = common.MAVLink(None)
    messages = [reader.decode(bytearray(frame)) for _, frame in read_tlog(tmp_path / "flight.tlog")]
    assert [(message.id, message.chunk_seq, message.text) for message in messages] == [
        (1, 0, "a" * 50),
        (1, 1, "b" * 7),
        (2, 0, "c"),
    ]


def test_a_log_of_a_name_that_is_taken_is_numbered(tmp_path: Path) -> None:
    names = []
    for _ in range(3):
        path = unused(tmp_path / "broadcast.tlog")
        path.touch()
        names.append(path.name)
    assert names == ["broadcast.tlog", "broadcast-2.tlog", "broadcast-3.tlog"]
