"""The parts of the shell of `companion run`, each by itself; whole flights of it are in test_service_flight.py."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common

from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.errors import InputError
from companion.files import kept_file
from companion.files.tlog import TlogWriter, read_tlog
from companion.onboard.authority import State
from companion.onboard.companion import Companion
from companion.onboard.config import Config
from companion.onboard.flight_log import FlightLog
from companion.onboard.inputs import AutopilotInput, BroadcastInput
from companion.onboard.recording import RecordedCompanion
from companion.onboard.state_files import AuthorityStateFile, authority_text, write_authority
from companion.protocol.codec import Directive, FrameWriter, Stamp, StateFrame
from companion.protocol.v2_extension import wrap
from companion.runtime.clock import SteadyClock
from companion.runtime.io_thread import IoThread

CONFIG = Config.model_validate(
    {
        "agent_id": 1,
        "autopilot": {"kind": "arducopter", "link": "udpin:127.0.0.1:14550", "system_id": 1},
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


def test_who_has_the_vehicle_is_written_when_it_changes(tmp_path: Path) -> None:
    path = tmp_path / "authority.state"
    for states in ((State.WAITING,), (State.WAITING, State.ENGAGED, State.ENGAGED, State.LOCKED)):
        files = IoThread("files")
        state_file = AuthorityStateFile(str(path), files)
        for authority in states:
            state_file.write(authority)
        files.close()
        assert json.loads(path.read_text()) == {"engagement": states[-1].value}


def test_a_state_that_cannot_be_written_is_told_once_tried_again_and_told_when_it_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(kept_file, "RETRY_S", 0.0)
    (tmp_path / "state").write_text("a file where the folder should be")
    path = tmp_path / "state" / "authority.json"
    files = IoThread("files")
    state_file = AuthorityStateFile(str(path), files)
    for _ in range(3):
        state_file.write(State.ENGAGED)
        done_by(files)
    (tmp_path / "state").unlink()
    state_file.write(State.ENGAGED)
    done_by(files)
    assert json.loads(path.read_text()) == {"engagement": "engaged"}
    said = capsys.readouterr()
    assert said.err.count("warning: ") == 1
    assert "; it is tried again; a restart now would not know who had the vehicle" in said.err
    assert said.out == f"companion: {path}: the state is written again\n"
    files.close()


def test_who_has_the_vehicle_is_kept_on_a_full_disk_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "authority.json"
    write_authority(path, authority_text(State.WAITING))

    def full(path: Path, text: str) -> None:
        raise InputError(f"{path}: cannot write the state: No space left on device")

    monkeypatch.setattr("companion.onboard.state_files.write_state_file", full)
    for state in State:
        write_authority(path, authority_text(state))
        assert json.loads(path.read_text()) == {"engagement": state.value}


def done_by(files: IoThread) -> None:
    """Wait until a thread has done all that it was given."""
    done = threading.Event()
    files.do(done.set)
    assert done.wait(10.0)
