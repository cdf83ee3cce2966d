"""What the companion's shell says and keeps; its sockets are tested with the three programs."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack
from pathlib import Path

import pytest

from companion.autopilot.telemetry import Telemetry
from companion.errors import InputError
from companion.onboard.broadcast_monitor import BroadcastMonitor
from companion.onboard.companion import Companion
from companion.onboard.config import BroadcastSection, Config
from companion.onboard.decision import Decision, Purpose
from companion.onboard.failsafe import Stage
from companion.onboard.log_folder import VehicleLog, open_log_folder
from companion.onboard.service import run_companion
from companion.onboard.state_files import AuthenticatorStateFile
from companion.onboard.trust import trust_of
from companion.protocol.authenticator import Authenticator, AuthenticatorState, Trust
from companion.protocol.codec import Directive, FrameWriter, Stamp, StateFrame
from companion.protocol.keys import keygen
from companion.runtime.clock import SteadyClock
from companion.runtime.io_thread import IoThread
from companion.runtime.rate import Evenness


def state(epoch_s: int, sequence: int, after_s: int = 0) -> bytes:
    stamp = Stamp(epoch_s, 1_000 * after_s, sequence)
    return FrameWriter().encode(StateFrame(stamp, 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, (), (), ()))


def monitored() -> tuple[Companion, BroadcastMonitor]:
    companion = Companion(Config(agent_id=1))
    monitor = BroadcastMonitor(companion)
    monitor.news(1_000.0)
    return companion, monitor


def test_the_trust_word_is_said_with_the_first_status() -> None:
    companion = Companion(Config(agent_id=1))
    (line,) = BroadcastMonitor(companion).news(1_000.0)
    assert line == "broadcast (unsigned): 0% of its frames heard, age of nothing; refused: none"


def test_the_first_ground_station_is_no_news() -> None:
    companion, monitor = monitored()
    companion.hear(state(1_000, 1), 1_000.0)
    assert monitor.news(1_000.0) == []


def test_a_restarted_ground_station_is_said_once() -> None:
    companion, monitor = monitored()
    companion.hear(state(1_000, 1), 1_000.0)
    monitor.news(1_000.0)
    companion.hear(state(1_002, 1), 1_002.0)
    assert monitor.news(1_002.0) == ["another run of a ground station took over (epoch 1002)"]
    assert monitor.news(1_002.0) == []


def test_two_ground_stations_at_once_are_warned_of_once() -> None:
    companion, monitor = monitored()
    companion.hear(state(1_010, 1), 1_010.0)
    monitor.news(1_010.0)
    for sequence in (5, 6):
        companion.hear(state(1_000, sequence), 1_011.0)
    assert "two ground stations" in monitor.news(1_011.0)[0]
    assert monitor.news(1_011.0) == []


def test_the_first_refusal_is_told_with_its_reason_and_then_once_a_minute() -> None:
    companion, monitor = monitored()
    companion.hear(state(900, 1), 1_000.0)
    assert monitor.news(1_000.0) == [
        "broadcast (unsigned): 0% of its frames heard, age of nothing; refused: 1 stamped too long ago"
    ]
    assert monitor.news(1_059.0) == []
    assert len(monitor.news(1_060.0)) == 1


def test_copies_that_are_sent_on_purpose_are_no_news() -> None:
    companion, monitor = monitored()
    for _ in range(2):
        companion.hear(state(1_000, 1), 1_000.0)
    assert companion.authenticator.rejected == {"repeated": 1}
    assert monitor.news(1_000.0) == []


def test_bad_reception_is_warned_of_once_and_its_end_told() -> None:
    companion, monitor = monitored()
    said = []
    for second in range(1_000, 1_400):
        if second % 10 == 0 or second > 1_200:
            companion.hear(state(1_000, second - 999, second - 1_000), float(second))
        said += [line for line in monitor.news(float(second)) if "reception" in line]
    assert [line.split(":")[0] for line in said] == ["warning", "reception is good again"]


def section(trust: str, folder: Path) -> BroadcastSection:
    """Keys as `groundstation keygen` writes them, and what of them a trust word needs."""
    needs = {"unsigned": [], "mavlink": ["mavlink_key"], "ed25519": ["public_key"]}
    needs["both"] = needs["mavlink"] + needs["ed25519"]
    names = {"mavlink_key": "broadcast.mavlink", "public_key": "broadcast.public"}
    files = {key: str(folder / names[key]) for key in needs[trust]}
    state_file = None if trust == "unsigned" else str(folder / "state.json")
    return BroadcastSection.model_validate(
        {"link": "udpin:127.0.0.1:14600", "trust": trust, "state_file": state_file, **files}
    )


@pytest.mark.parametrize(
    ("trust", "words"),
    [
        ("unsigned", "unsigned"),
        ("mavlink", "MAVLink signing"),
        ("ed25519", "Ed25519"),
        ("both", "MAVLink signing and Ed25519"),
    ],
)
def test_a_trust_word_takes_its_keys_from_their_files(tmp_path: Path, trust: str, words: str) -> None:
    keygen(tmp_path / "keys")
    assert trust_of(section(trust, tmp_path / "keys")).words == words


def test_a_state_is_kept_only_when_there_is_something_new(tmp_path: Path) -> None:
    path = tmp_path / "state" / "broadcast.json"
    authenticator = Authenticator(Trust())
    files = IoThread("files")
    state_file = AuthenticatorStateFile(str(path), authenticator, files)
    state_file.write()
    authenticator.admit(state(1_000, 4), 1_000.0)
    assert not path.exists()
    state_file.write()
    files.close()
    assert AuthenticatorState.from_json(path.read_text()).sequence == 4


def test_a_restarted_companion_refuses_what_was_accepted_before_it(tmp_path: Path) -> None:
    path = tmp_path / "broadcast.json"
    before = Authenticator(Trust())
    files = IoThread("files")
    state_file = AuthenticatorStateFile(str(path), before, files)
    before.admit(state(1_000, 4), 1_000.0)
    state_file.write_if_due(1_000.0)
    files.close()
    after = Authenticator(Trust(), AuthenticatorState.from_json(path.read_text()))
    assert after.admit(state(1_000, 3), 1_001.0) == []
    assert len(after.admit(state(1_000, 5), 1_001.0)) == 1


def test_the_clock_never_runs_backwards() -> None:
    clock = SteadyClock()
    times_s = [clock.now_s() for _ in range(100)]
    assert times_s == sorted(times_s)


def test_the_clock_counts_whole_microseconds_so_that_a_log_holds_its_very_times() -> None:
    now_s = SteadyClock().now_s()
    assert round(now_s * 1e6) / 1e6 == now_s


def test_each_run_logs_into_a_folder_of_its_own(tmp_path: Path) -> None:
    config = Config(agent_id=7, log_dir=str(tmp_path))
    for _ in range(2):
        with ExitStack() as stack:
            files = IoThread("files")
            stack.callback(files.close)
            logs = open_log_folder(config, files, stack, VehicleLog())
            assert logs.decisions is not None
            logs.vehicle.record(1.0, state(1_000, 1))
            logs.broadcast.record(1.0, state(1_000, 1))
            logs.decisions.add(Decision(1.0, Purpose.IDLE, "", Stage.FRESH, None), Telemetry(), Evenness())
    folders = sorted(tmp_path.iterdir())
    assert len(folders) == 2
    for folder in folders:
        assert {path.name for path in folder.iterdir()} == {
            "vehicle-7.tlog",
            "broadcast-7.tlog",
            "decisions-7.csv",
            "companion-7.yaml",
        }


def test_a_run_whose_port_is_missing_leaves_no_folder(tmp_path: Path) -> None:
    autopilot = {"kind": "arducopter", "link": f"serial:{tmp_path}/nothing:57600"}
    broadcast = {"link": "file:" + str(tmp_path / "heard.tlog"), "trust": "unsigned"}
    (tmp_path / "heard.tlog").write_bytes(b"")
    logs = tmp_path / "logs"
    config = Config.model_validate(
        {"agent_id": 7, "log_dir": str(logs), "autopilot": autopilot, "broadcast": broadcast}
    )
    with pytest.raises(InputError, match="nothing"):
        asyncio.run(run_companion(config, asyncio.Event()))
    assert not logs.exists() or list(logs.iterdir()) == []
