"""What the companion's shell says when the broadcast changes hands; its sockets are tested with the three programs."""

from __future__ import annotations

from companion.core import Decision, Purpose
from companion.picture import Picture
from companion.service import SteadyClock, _line, _Listening
from companion.staleness import Stage
from companion.wire import Directive, Stamp, StateFrame


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


def test_the_clock_never_runs_backwards() -> None:
    clock = SteadyClock()
    times_s = [clock.now_s() for _ in range(100)]
    assert times_s == sorted(times_s)
