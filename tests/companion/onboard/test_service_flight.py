"""The companion's shell on real sockets, in one process with an autopilot and a broadcast that the test plays."""

from __future__ import annotations

import asyncio
import csv
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common

from companion.autopilot.offboard import SETPOINT_IDS
from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.files.tlog import read_tlog, whole_frames
from companion.onboard.config import Config, parse_config
from companion.onboard.decision import Decision, Purpose
from companion.onboard.failsafe import Stage
from companion.onboard.flight_log import Mark, decision_frame, mark_frame, mark_of
from companion.onboard.replay import replay
from companion.onboard.service import run_companion
from companion.protocol.codec import Directive, FrameWriter, Stamp, StateFrame
from companion.protocol.frame import raw_frame
from companion.protocol.v2_extension import wrap
from companion.transport.endpoints import open_sender, parse_link
from tests.ports import free_port

pytestmark = pytest.mark.slow

HERE = "127.0.0.1"
GUIDED = 4
WITHIN_S = 10.0
CONFIG = """
agent_id: 1
autopilot: {{kind: kinematic, link: "udpin:127.0.0.1:{autopilot}"{autopilot_more}}}
broadcast: {{link: "{broadcast}", trust: unsigned}}
limits: {{speed_m_s: 5, n_max: 0.2, height_min_m: 3, height_max_m: 60}}
height_m: 20
guidance_step_s: 0.2
log_dir: {logs}
{more}
"""


class Vehicle:
    """An autopilot in the air, and whoever has it; it speaks ten times a second and counts what it is told."""

    def __init__(self, port: int) -> None:
        self._mav = common.MAVLink(None, srcSystem=1, srcComponent=common.MAV_COMP_ID_AUTOPILOT1)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect((HERE, port))
        self._socket.setblocking(False)
        self._began_s = time.monotonic()
        self.mode = GUIDED
        self.told: list[tuple[float, common.MAVLink_message]] = []

    def speak(self) -> None:
        boot_ms = round(1e3 * (time.monotonic() - self._began_s))
        armed = common.MAV_MODE_FLAG_SAFETY_ARMED | common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        for message in (
            common.MAVLink_heartbeat_message(2, common.MAV_AUTOPILOT_GENERIC, armed, self.mode, 4, 3),
            common.MAVLink_global_position_int_message(boot_ms, 470_000_000, 80_000_000, 520_000, 20_000, 0, 0, 0, 0),
            common.MAVLink_extended_sys_state_message(0, common.MAV_LANDED_STATE_IN_AIR),
            common.MAVLink_home_position_message(470_000_000, 80_000_000, 500_000, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0),
        ):
            self.send(bytes(message.pack(self._mav)))
        self._listen()

    def send(self, frame: bytes) -> None:
        try:
            self._socket.send(frame)
        except ConnectionRefusedError:
            return

    def count(self, *message_ids: int, since_s: float = 0.0) -> int:
        """Return how many messages of these ids came since a time."""
        return sum(message.get_msgId() in message_ids for at_s, message in self.told if at_s >= since_s)

    def close(self) -> None:
        self._socket.close()

    def _listen(self) -> None:
        while True:
            try:
                datagram = self._socket.recv(65_536)
            except (BlockingIOError, ConnectionRefusedError):
                return
            parser = common.MAVLink(None)
            for frame in whole_frames(datagram):
                for message in parser.parse_buffer(frame) or ():
                    self.told.append((time.monotonic(), message))


class Scene:
    """A companion that runs, its vehicle and its broadcast."""

    def __init__(
        self, folder: Path, *, more: str = "", autopilot_more: str = "", one_radio: bool = False, silent: bool = False
    ) -> None:
        port, broadcast = free_port(), free_port()
        link = "autopilot" if one_radio else f"udpin:127.0.0.1:{broadcast}"
        text = CONFIG.format(
            autopilot=port, broadcast=link, logs=folder / "logs", more=more, autopilot_more=autopilot_more
        )
        self.folder = folder
        self.config: Config = parse_config(text, "c.yaml")
        self.vehicle = Vehicle(port)
        self._broadcast_port, self._silent = broadcast, silent
        self._writer, self._epoch_s, self._sequence = FrameWriter(), int(time.time()), 0

    def frame(self) -> bytes:
        """Return the next frame of the broadcast."""
        self._sequence += 1
        stamp = Stamp(self._epoch_s, round(1e3 * (time.time() - self._epoch_s)), self._sequence)
        return self._writer.encode(StateFrame(stamp, 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, (), (), ()))

    def play(self, script: Callable[[Scene], Awaitable[None]]) -> None:
        """Run the companion while a script goes on, and a moment longer."""
        asyncio.run(asyncio.wait_for(self._play(script), 2.0 * WITHIN_S))

    async def until(self, condition: Callable[[], bool]) -> None:
        ends_s = time.monotonic() + WITHIN_S
        while not condition():
            assert time.monotonic() < ends_s, f"it never came: {Counter(m.get_type() for _, m in self.vehicle.told)}"
            await asyncio.sleep(0.02)

    async def _play(self, script: Callable[[Scene], Awaitable[None]]) -> None:
        stop = asyncio.Event()
        tasks = [asyncio.create_task(run_companion(self.config, stop)), asyncio.create_task(self._world(stop))]
        try:
            await script(self)
        finally:
            stop.set()
            await asyncio.gather(*tasks)
            self.vehicle.close()

    async def _world(self, stop: asyncio.Event) -> None:
        sender = await open_sender(parse_link(f"udpout:127.0.0.1:{self._broadcast_port}"))
        while not stop.is_set():
            self.vehicle.speak()
            if not self._silent:
                sender.send(self.frame())
            await asyncio.sleep(0.1)
        sender.close()

    @property
    def logs(self) -> Path:
        """The folder of the only run."""
        (folder,) = (self.folder / "logs").iterdir()
        return folder


async def _steered(scene: Scene) -> None:
    await scene.until(lambda: scene.vehicle.count(*SETPOINT_IDS) >= 5)


def test_setpoints_stop_with_the_next_slot_after_a_person_changed_the_mode(tmp_path: Path) -> None:
    async def script(scene: Scene) -> None:
        await _steered(scene)
        scene.vehicle.mode = 9
        scene.vehicle.speak()
        changed_s = time.monotonic()
        await asyncio.sleep(0.6)
        # Two slots of the grid and a little, for the way there and back.
        assert scene.vehicle.count(*SETPOINT_IDS, since_s=changed_s + 0.25) == 0
        scene.vehicle.mode = GUIDED
        await scene.until(lambda: scene.vehicle.count(*SETPOINT_IDS, since_s=changed_s + 0.6) >= 3)

    Scene(tmp_path).play(script)


def test_a_flight_is_logged_decided_again_and_tabled(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    scene = Scene(tmp_path)
    scene.play(_steered)
    again = list(replay(read_tlog(scene.logs / "vehicle-1.tlog"), scene.config))
    assert again and all(one.same for one in again)
    with (scene.logs / "decisions-1.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["purpose"] for row in rows] == [one.decision.purpose.value for one in again]
    assert [float(row["time_unix_s"]) for row in rows] == pytest.approx([one.decision.t_s for one in again], abs=1e-6)
    said = capfd.readouterr().out
    assert "companion: loiter (no target), picture fresh" in said
    assert "setpoint gaps: median" in said


def test_the_status_comes_on_the_autopilot_link(tmp_path: Path) -> None:
    async def script(scene: Scene) -> None:
        await _steered(scene)
        ids = (common.MAVLINK_MSG_ID_STATUSTEXT, common.MAVLINK_MSG_ID_NAMED_VALUE_INT)
        await scene.until(lambda: all(scene.vehicle.count(one) for one in ids))

    scene = Scene(tmp_path, more="status: {period_s: 1}")
    scene.play(script)
    names = {m.name for _, m in scene.vehicle.told if m.get_type() == "NAMED_VALUE_INT"}
    assert names == {"OW_STAGE", "OW_PURPOSE", "OW_TARGET", "OW_GUARD", "OW_CERT", "OW_GAP_MS", "OW_LATE_MS"}


@pytest.mark.parametrize("more", ["status: {quiet: true}", "case: II"])
def test_a_quiet_companion_sends_heartbeats_questions_and_setpoints_only(tmp_path: Path, more: str) -> None:
    async def script(scene: Scene) -> None:
        await _steered(scene)
        await scene.until(lambda: scene.vehicle.count(common.MAVLINK_MSG_ID_HEARTBEAT) > 0)

    scene = Scene(tmp_path, more=more)
    scene.play(script)
    kinds = {message.get_type() for _, message in scene.vehicle.told}
    assert {"HEARTBEAT", "SET_POSITION_TARGET_LOCAL_NED"} <= kinds
    assert kinds.isdisjoint({"STATUSTEXT", "NAMED_VALUE_INT", "NAMED_VALUE_FLOAT"})


def test_with_one_radio_the_broadcast_comes_wrapped_through_the_autopilot(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    async def script(scene: Scene) -> None:
        # As it is, the broadcast is not believed on this link: any program beside the autopilot could speak so.
        for _ in range(5):
            scene.vehicle.send(scene.frame())
            await asyncio.sleep(0.1)
        assert scene.vehicle.count(*SETPOINT_IDS) == 0
        for sequence in range(5):
            scene.vehicle.send(wrap(scene.frame(), sequence))
            await asyncio.sleep(0.1)
        await _steered(scene)

    scene = Scene(tmp_path, one_radio=True, silent=True)
    scene.play(script)
    assert "broadcast on autopilot (unsigned)" in capfd.readouterr().out
    again = list(replay(read_tlog(scene.logs / "vehicle-1.tlog"), scene.config))
    assert all(one.same for one in again)
    assert sum(1 for _ in read_tlog(scene.logs / "broadcast-1.tlog")) == 5


def test_nobody_on_the_autopilots_link_speaks_in_the_logs_for_the_ground_station_or_for_us(tmp_path: Path) -> None:
    async def script(scene: Scene) -> None:
        mark = mark_frame(Mark.CLEARED, 1)
        decision = FrameWriter(1, COMPANION_COMPONENT).encode(
            decision_frame(Decision(0.0, Purpose.IDLE, "", Stage.FRESH, 0.0))
        )
        for _ in range(5):
            for forged in (scene.frame(), mark, decision):
                scene.vehicle.send(forged)
            await asyncio.sleep(0.1)

    scene = Scene(tmp_path, silent=True)
    scene.play(script)
    records = list(read_tlog(scene.logs / "vehicle-1.tlog"))
    assert not any(mark_of(raw_frame(frame)) for _, frame in records if is_companions(frame))
    again = list(replay(records, scene.config))
    assert again and all(one.same and one.decision.picture_age_s is None for one in again)


def test_whether_it_steers_is_kept_for_the_next_one(tmp_path: Path) -> None:
    path = tmp_path / "engaged.json"

    async def script(scene: Scene) -> None:
        await _steered(scene)
        await scene.until(lambda: path.exists() and json.loads(path.read_text()) == {"engagement": "engaged"})
        scene.vehicle.mode = 9
        await scene.until(lambda: json.loads(path.read_text()) == {"engagement": "waiting"})

    Scene(tmp_path, autopilot_more=f", state_file: {path}").play(script)


def test_a_signal_that_is_not_configured_ends_nothing(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    async def script(scene: Scene) -> None:
        await _steered(scene)
        os.kill(os.getpid(), signal.SIGUSR1)
        count = scene.vehicle.count(*SETPOINT_IDS)
        await scene.until(lambda: scene.vehicle.count(*SETPOINT_IDS) >= count + 3)

    Scene(tmp_path).play(script)
    assert "SIGUSR1 ignored; it counts only with autopilot.clear: signal" in capfd.readouterr().out


def test_the_program_is_deaf_to_the_signal_before_its_imports_are_done() -> None:
    code = """
import os, signal, sys
import companion.cli
companion.cli.run_program = lambda *_: os.kill(os.getpid(), signal.SIGUSR1)
assert not {"numpy", "pydantic", "pymavlink", "companion.onboard.service"} & set(sys.modules)
companion.cli.main()
print("lives")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=WITHIN_S)
    assert (done.stdout, done.stderr) == ("lives\n", "")


def test_a_configured_signal_is_logged_for_the_replay(tmp_path: Path) -> None:
    async def script(scene: Scene) -> None:
        await _steered(scene)
        os.kill(os.getpid(), signal.SIGUSR1)
        await asyncio.sleep(0.2)

    scene = Scene(tmp_path, autopilot_more=", clear: signal")
    scene.play(script)
    marks = [mark_of(raw_frame(frame)) for _, frame in read_tlog(scene.logs / "vehicle-1.tlog") if is_companions(frame)]
    assert marks.count(Mark.CLEARED) == 1
    assert all(one.same for one in replay(read_tlog(scene.logs / "vehicle-1.tlog"), scene.config))


def is_companions(frame: bytes) -> bool:
    return bool(raw_frame(frame).component == COMPANION_COMPONENT)


def test_systemd_hears_that_the_loop_lives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said: Counter[bytes] = Counter()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.setblocking(False)
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))

        async def script(scene: Scene) -> None:
            asyncio.get_running_loop().add_reader(systemd, lambda: said.update([systemd.recv(1_000)]))
            await _steered(scene)

        Scene(tmp_path).play(script)
        with suppress(BlockingIOError):
            said[systemd.recv(1_000)] += 1
    assert said[b"READY=1"] == said[b"STOPPING=1"] == 1
    assert said[b"WATCHDOG=1"] >= 5
    assert any(line.startswith(b"STATUS=loiter") for line in said)
