"""The playback of a store: at any time it tells what was known then, and nothing of what came later."""

from __future__ import annotations

import asyncio
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from companion.errors import InputError
from groundstation.store.database import Database
from groundstation.store.playback import Playback
from groundstation.store.recordings import StoredRun
from groundstation.store.rows import Batch
from groundstation.web.feed import Refused
from groundstation.web.pipe import Message, Who
from tests.groundstation.store.recorded import NOW_S, recorded_store
from tests.ports import free_port


class Screen:
    def __init__(self) -> None:
        self.messages: list[dict[str, Any]] = []
        self.heard_s: list[float] = []
        self.forgot = 0

    def message(self, message: Message) -> None:
        self.messages.append(dict(message))

    def frames(self, t_s: float, datagrams: Sequence[bytes]) -> None:
        self.heard_s.append(t_s)

    def forget(self) -> None:
        self.forgot += 1

    def taken(self, kind: str) -> list[dict[str, Any]]:
        found = [message for message in self.messages if message["type"] == kind]
        self.messages = [message for message in self.messages if message["type"] != kind]
        return found


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("store") / "day.state"
    recorded_store(path)
    return path


@pytest.fixture
def played(path: Path) -> Iterator[tuple[Playback, Screen]]:
    run = StoredRun(path)
    yield Playback(run), Screen()
    run.close()


def set_to(playback: Playback, **control: float) -> Message:
    return asyncio.run(playback.playback(control))


def threats(mission: dict[str, Any]) -> list[int]:
    return [threat["id"] for threat in mission["mission"]["threats"]]


def test_it_begins_at_the_beginning_and_goes_on_as_fast_as_it_is_told(played: tuple[Playback, Screen]) -> None:
    playback, screen = played
    playback.step(screen, 0.0)
    assert [one["t_s"] for one in screen.taken("picture")] == [NOW_S]
    set_to(playback, speed=5.0)
    playback.step(screen, 1.0)
    (shown,) = screen.taken("picture")
    assert (shown["t_s"], shown["mode"]) == (NOW_S + 5.0, "playback")
    assert screen.taken("playback")[-1]["at_s"] == NOW_S + 5.0
    assert screen.heard_s == [NOW_S + second for second in range(6)]


def test_a_jump_tells_events_mission_and_frames_up_to_there_and_forgets_what_came_later(
    played: tuple[Playback, Screen],
) -> None:
    playback, screen = played
    set_to(playback, at_s=NOW_S + 35.0)
    playback.step(screen, 0.0)
    assert [one["event"]["number"] for one in screen.taken("event")] == [1, 2, 3, 4]
    assert threats(screen.taken("mission")[-1]) == [5]
    forgotten = screen.forgot
    screen.heard_s.clear()
    set_to(playback, at_s=NOW_S + 21.0)
    playback.step(screen, 0.0)
    assert screen.forgot == forgotten + 1
    assert [one["event"]["number"] for one in screen.taken("event")] == [1, 2, 3]
    assert threats(screen.taken("mission")[-1]) == [4, 5]
    assert screen.heard_s == [NOW_S + second for second in range(22)]


def test_it_stands_still_when_told_to_and_at_its_end_and_then_begins_anew(played: tuple[Playback, Screen]) -> None:
    playback, screen = played
    set_to(playback, playing=False)
    playback.step(screen, 5.0)
    assert set_to(playback)["at_s"] == NOW_S
    set_to(playback, playing=True)
    playback.step(screen, 1_000.0)
    assert (set_to(playback)["at_s"], set_to(playback)["playing"]) == (NOW_S + 39.0, False)
    assert set_to(playback, playing=True)["at_s"] == NOW_S


def test_a_jump_beyond_the_ends_stops_there(played: tuple[Playback, Screen]) -> None:
    playback, _ = played
    assert set_to(playback, at_s=0.0)["at_s"] == NOW_S
    assert set_to(playback, at_s=1e12)["at_s"] == NOW_S + 39.0


def test_it_takes_no_commands(played: tuple[Playback, Screen]) -> None:
    playback, _ = played
    with pytest.raises(Refused, match="this is a playback: what was flown stays as it was"):
        asyncio.run(playback.command(Who("anna", "operator"), {"do": "pause"}))


def test_nothing_is_told_twice_while_time_goes_on(played: tuple[Playback, Screen]) -> None:
    playback, screen = played
    for _ in range(60):
        playback.step(screen, 0.5)
    numbers = [one["event"]["number"] for one in screen.taken("event")]
    times_s = [one["t_s"] for one in screen.taken("picture")]
    assert numbers == sorted(set(numbers))
    assert times_s == sorted(set(times_s))
    assert screen.heard_s == sorted(set(screen.heard_s))


def test_the_mission_at_a_time_is_the_same_whatever_was_asked_for_before(path: Path) -> None:
    run = StoredRun(path)
    for second in (5, 12, 25, 25, 39, 12, 35, 0):
        alone = StoredRun(path)
        assert run.mission_at(NOW_S + second) == alone.mission_at(NOW_S + second), second
        alone.close()
    run.close()


def test_a_store_with_nothing_in_it_is_refused(tmp_path: Path) -> None:
    Database.create(tmp_path / "x.state", Batch()).close()
    with pytest.raises(InputError, match="x.state: no events and no pictures; allowed: the store of a run"):
        StoredRun(tmp_path / "x.state")


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_playback_that_is_told_to_stop_ends_without_a_word_of_failure(path: Path, number: signal.Signals) -> None:
    command = [sys.executable, "-m", "groundstation", "log", str(path), "--ui", f"127.0.0.1:{free_port()}"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        assert "page: http" in program.stdout.readline()
        program.send_signal(number)
        _, said = program.communicate(timeout=60.0)
    assert (program.returncode, said) == (0, "")
