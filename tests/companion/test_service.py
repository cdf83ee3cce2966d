"""What the companion's shell says when the broadcast changes hands; its sockets are tested with the three programs."""

from __future__ import annotations

import io

import pytest

from companion.core import Decision, Purpose
from companion.picture import Picture
from companion.process import SteadyClock
from companion.service import FlightLog, _line, _Listening
from companion.staleness import Stage
from companion.tlog import TlogWriter
from companion.wire import Directive, FrameWriter, Stamp, StateFrame

FRAME = FrameWriter().encode(StateFrame(Stamp(1_000, 0, 1), 47.0, 8.0, Directive.NORMAL, (), (), ()))


def state(epoch_s: int, sequence: int) -> StateFrame:
    return StateFrame(Stamp(epoch_s, 0, sequence), 47.0, 8.0, Directive.NORMAL, (), (), ())


def test_the_first_ground_station_is_no_news() -> None:
    picture, listening = Picture(1), _Listening()
    picture.take_state(state(1_000, 1), 1_000.0)
    assert listening.news(picture) == []


def test_a_restarted_ground_station_is_said_once() -> None:
    picture, listening = Picture(1), _Listening()
    picture.take_state(state(1_000, 1), 1_000.0)
    listening.news(picture)
    picture.take_state(state(1_010, 1), 1_010.0)
    assert listening.news(picture) == ["another run of a ground station took over (epoch 1010)"]
    assert listening.news(picture) == []


def test_two_ground_stations_at_once_are_warned_of_once() -> None:
    picture, listening = Picture(1), _Listening()
    picture.take_state(state(1_010, 1), 1_010.0)
    listening.news(picture)
    for sequence in (5, 6):
        picture.take_state(state(1_000, sequence), 1_011.0)
    (line,) = listening.news(picture)
    assert "two ground stations" in line
    assert listening.news(picture) == []


def test_without_a_picture_the_line_says_none() -> None:
    decision = Decision(0.0, Purpose.IDLE, "no autopilot heard", Stage.LOITERING, None)
    assert _line(decision) == "idle (no autopilot heard), picture none"


def test_the_line_names_target_stage_and_what_the_guard_changed() -> None:
    decision = Decision(0.0, Purpose.TARGET, "assigned", Stage.FRESH, 1.0, target_id=3, guard_changes=("keep-out",))
    assert _line(decision) == "target 3 (assigned), picture fresh, guard: keep-out"


class FullDisk(io.BytesIO):
    def write(self, data: object) -> int:
        raise OSError(28, "No space left on device")


def test_a_log_that_cannot_be_written_is_given_up_with_one_word(capsys: pytest.CaptureFixture[str]) -> None:
    log = FlightLog(TlogWriter(FullDisk()))
    for _ in range(3):
        log.record(1.0, FRAME)
    log.close()
    assert capsys.readouterr().err == "companion: warning: no longer logging: No space left on device\n"


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


def test_the_clock_never_runs_backwards() -> None:
    clock = SteadyClock()
    times_s = [clock.now_s() for _ in range(100)]
    assert times_s == sorted(times_s)
