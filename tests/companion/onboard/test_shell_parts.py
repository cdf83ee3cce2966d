"""The parts of the shell of `companion run`, each by itself; whole flights of it are in test_service_flight.py."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common

from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.errors import InputError
from companion.files.tlog import TlogWriter, read_tlog
from companion.onboard.authority import State
from companion.onboard.companion import Companion
from companion.onboard.config import Config
from companion.onboard.flight_log import FlightLog
from companion.onboard.inputs import AutopilotInput, BroadcastInput
from companion.onboard.log_folder import LogFolder
from companion.onboard.recording import RecordedCompanion
from companion.onboard.state_files import AuthorityStateFile
from companion.protocol.codec import Directive, FrameWriter, Stamp, StateFrame
from companion.protocol.v2_extension import wrap
from companion.runtime.clock import SteadyClock
from companion.runtime.io_thread import IoThread

CONFIG = Config.model_validate(
    {
        "agent_id": 1,
        "autopilot": {"kind": "arducopter", "link": "udpin:127.0.0.1:14550"},
        "broadcast": {"link": "autopilot", "trust": "unsigned"},
    }
)


def heartbeat(component: int = common.MAV_COMP_ID_AUTOPILOT1) -> bytes:
    mav = common.MAVLink(None, srcSystem=1, srcComponent=component)
    autopilot = common.MAV_AUTOPILOT_ARDUPILOTMEGA
    return bytes(common.MAVLink_heartbeat_message(common.MAV_TYPE_QUADROTOR, autopilot, 1, 4, 4, 3).pack(mav))


def state(now_s: float) -> bytes:
    return FrameWriter().encode(
        StateFrame(Stamp(int(now_s), 0, 1), 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, (), (), ())
    )


def recorded(folder: Path) -> tuple[RecordedCompanion, FlightLog]:
    log = FlightLog(TlogWriter(folder / "vehicle.tlog"))
    return RecordedCompanion(Companion(CONFIG), SteadyClock(), log), log


def test_what_the_autopilot_says_is_heard_and_logged(tmp_path: Path) -> None:
    flight, log = recorded(tmp_path)
    AutopilotInput(flight, None, None).receive(heartbeat())
    log.close()
    assert flight.companion.adapter.telemetry.system_id == 1
    assert [frame for _, frame in read_tlog(tmp_path / "vehicle.tlog")] == [heartbeat()]


def test_what_others_say_on_the_autopilots_link_is_neither_heard_nor_logged(tmp_path: Path) -> None:
    flight, log = recorded(tmp_path)
    link = AutopilotInput(flight, None, None)
    link.receive(heartbeat(COMPANION_COMPONENT))
    link.receive(state(flight.clock.now_s()))
    log.close()
    assert flight.companion.adapter.telemetry.system_id is None
    assert list(read_tlog(tmp_path / "vehicle.tlog")) == []


def test_the_broadcast_that_one_radio_carries_is_heard_behind_the_autopilot(tmp_path: Path) -> None:
    flight, log = recorded(tmp_path)
    broadcast = BroadcastInput(flight, FlightLog(TlogWriter(tmp_path / "broadcast.tlog")), is_stream=False)
    AutopilotInput(flight, broadcast.receive, None).receive(wrap(state(flight.clock.now_s()), 0))
    log.close()
    assert flight.companion.authenticator.state.epoch_s is not None
    assert len(list(read_tlog(tmp_path / "vehicle.tlog"))) == 1


def test_who_has_the_vehicle_is_written_when_it_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "authority.state"
    written: list[str] = []
    monkeypatch.setattr("companion.onboard.state_files.write_state_file", lambda path, text: written.append(text))
    files = IoThread("files")
    state_file = AuthorityStateFile(str(path), State.WAITING, files)
    for authority in (State.WAITING, State.ENGAGED, State.ENGAGED, State.LOCKED):
        state_file.write(authority)
    files.close()
    assert [json.loads(text) for text in written] == [{"engagement": "engaged"}, {"engagement": "locked"}]


def test_a_state_that_cannot_be_written_is_warned_of_and_ends_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(path: Path, text: str) -> None:
        raise InputError(f"{path}: cannot write the state: No space left on device; allowed: a writable folder")

    monkeypatch.setattr("companion.onboard.state_files.write_state_file", fails)
    files = IoThread("files")
    AuthorityStateFile("x.state", State.WAITING, files).write(State.ENGAGED)
    files.close()
    assert capsys.readouterr().err.startswith("companion: warning: x.state: cannot write the state: No space left")


def test_a_run_without_a_folder_of_logs_has_none_to_remove() -> None:
    LogFolder(None, FlightLog(None), FlightLog(None), None).remove()
