"""A PX4 copter steered through MAVSDK by the real shell: handed over, taken over, and left alone from then on."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common

from companion.files.tlog import read_tlog
from companion.onboard.config import parse_config
from companion.onboard.replay import replay
from companion.onboard.service import run_companion
from companion.protocol.codec import Directive, FrameWriter, Stamp, StateFrame
from companion.transport.endpoints import open_sender, parse_link
from sim.safety_pilot import SafetyPilot
from sim.vehicle_service import VehicleOptions, run_vehicle
from tests.ports import free_ports

pytestmark = pytest.mark.slow

WITHIN_S = 25.0
HOLD = (4, 3)
"""PX4's main and sub mode."""
OFFBOARD = 6 << 16
CONFIG = """
agent_id: 1
autopilot: {{kind: px4-copter, link: "udpin:127.0.0.1:{autopilot}", state_file: {folder}/engaged.json}}
broadcast: {{link: "udpin:127.0.0.1:{broadcast}", trust: unsigned}}
limits: {{speed_m_s: 5, n_max: 0.2, height_min_m: 3, height_max_m: 60}}
height_m: 20
log_dir: {folder}/logs
"""


class Ground:
    """A person at a ground-control program: sees the mode, and changes it."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.connect(("127.0.0.1", port))
        self._socket.setblocking(False)
        self._mav = common.MAVLink(None, srcSystem=255, srcComponent=190)
        self.safety_pilot = SafetyPilot("px4-copter", 1)
        self.modes: list[int] = []

    def send(self, *frames: bytes) -> None:
        for frame in frames:
            with suppress(ConnectionRefusedError):
                self._socket.send(frame)

    def listen(self) -> None:
        with suppress(BlockingIOError, ConnectionRefusedError):
            while True:
                for message in common.MAVLink(None).parse_buffer(self._socket.recv(65_536)) or ():
                    if message.get_type() == "HEARTBEAT" and message.get_srcComponent() == 1:
                        self.modes.append(message.custom_mode)

    def hand_over(self, t_s: float) -> None:
        self.send(self.safety_pilot.heartbeat(), *self.safety_pilot.orders(t_s, self.modes[-1] if self.modes else None))

    def take_over(self) -> None:
        order = common.MAVLink_command_long_message(1, 1, common.MAV_CMD_DO_SET_MODE, 0, 1, *HOLD, 0, 0, 0, 0)
        self.send(bytes(order.pack(self._mav)))

    def close(self) -> None:
        self._socket.close()


async def _broadcast(port: int, stop: asyncio.Event) -> None:
    sender = await open_sender(parse_link(f"udpout:127.0.0.1:{port}"))
    writer, epoch_s, sequence = FrameWriter(), int(time.time()), 0
    while not stop.is_set():
        sequence += 1
        stamp = Stamp(epoch_s, round(1e3 * (time.time() - epoch_s)), sequence)
        sender.send(writer.encode(StateFrame(stamp, 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, (), (), ())))
        await asyncio.sleep(0.2)
    sender.close()


def stop_mavsdk() -> None:
    """Stop the processes that hold MAVSDK, as a kernel without memory or a debugger would."""
    for listed in Path("/proc/self/task").glob("*/children"):
        for pid in listed.read_text().split():
            with suppress(FileNotFoundError):
                if b"companion.autopilot.offboard_child" in Path(f"/proc/{pid}/cmdline").read_bytes():
                    os.kill(int(pid), signal.SIGSTOP)


@pytest.mark.parametrize("ending", ["a person changes the mode", "MAVSDK hangs"])
def test_after_its_stream_has_ended_mavsdk_streams_no_more_and_px4_does_not_go_back_to_offboard(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], ending: str
) -> None:
    autopilot, broadcast, ground_port = free_ports(3)
    config = parse_config(CONFIG.format(autopilot=autopilot, broadcast=broadcast, folder=tmp_path), "c.yaml")
    links = (parse_link(f"udpout:127.0.0.1:{autopilot}"), parse_link(f"udpin:127.0.0.1:{ground_port}"))
    ground = Ground(ground_port)
    said = ""

    def says(words: str) -> bool:
        nonlocal said
        said += capfd.readouterr().out
        return words in said

    async def until(condition: Callable[[], bool], meanwhile: Callable[[], None]) -> None:
        ends_s = time.monotonic() + WITHIN_S
        while not condition():
            assert time.monotonic() < ends_s, said
            meanwhile()
            ground.listen()
            await asyncio.sleep(0.1)

    async def body() -> None:
        stop, began_s = asyncio.Event(), time.monotonic()
        tasks = [
            asyncio.create_task(run_vehicle(VehicleOptions("px4-copter", links, in_air_m=20.0), stop=stop)),
            asyncio.create_task(run_companion(config, stop)),
            asyncio.create_task(_broadcast(broadcast, stop)),
        ]
        try:
            await until(lambda: says("loiter (no target)"), lambda: ground.hand_over(time.monotonic() - began_s))
            # The disk is waited for on a thread of its own, which may come after the terminal's.
            await until((tmp_path / "engaged.json").exists, lambda: None)
            if ending == "MAVSDK hangs":
                await until(lambda: says("MAVSDK sent nothing; nothing is sent until it is disarmed"), stop_mavsdk)
                await until(lambda: ground.modes[-1] != OFFBOARD, lambda: None)
            else:
                ground.take_over()
                await until(lambda: says("nothing is sent until it is disarmed"), lambda: None)
            ground.modes.clear()
            # Long enough for PX4 to go back to OFFBOARD by itself, had the stream gone on or begun again.
            await until(lambda: len(ground.modes) >= 3, lambda: None)
            assert OFFBOARD not in ground.modes
            assert ending == "MAVSDK hangs" or set(ground.modes) == {HOLD[0] << 16 | HOLD[1] << 24}
        finally:
            stop.set()
            await asyncio.gather(*tasks)
            ground.close()

    asyncio.run(body())
    (folder,) = (tmp_path / "logs").iterdir()
    assert all(one.same for one in replay(read_tlog(folder / "vehicle-1.tlog"), config))
