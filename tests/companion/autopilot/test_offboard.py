"""MAVSDK in a process of its own: what it lets through, and that nothing of it outlives the loop that ticks."""

from __future__ import annotations

import asyncio
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from itertools import pairwise
from pathlib import Path

import pytest
from pymavlink.dialects.v20 import common

from companion.autopilot import offboard as offboard_module
from companion.autopilot.adapter import SetpointFrame, Velocity
from companion.autopilot.offboard import SILENCE_S, Offboard, is_setpoint
from companion.autopilot.offboard_child import SETPOINT, SETPOINT_FIELDS, TICK_TIMEOUT_S
from companion.autopilot.px4_copter import Px4CopterAdapter
from companion.autopilot.stream import STREAM_GAP_S
from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.errors import InputError
from companion.guard.types import Setpoint

SYSTEM = 3
WANTED = Velocity(1.0, -2.0, 0.25, math.radians(30.0))
READY_WITHIN_S = 20.0
_MAV = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
HEARTBEAT = bytes(common.MAVLink_heartbeat_message(2, 12, 0x81, 4 << 16, 4, 3).pack(_MAV))


def on_the_wire(frame: bytes) -> tuple[float, float, float, float]:
    """Return velocity and yaw of a SET_POSITION_TARGET_LOCAL_NED frame."""
    (message,) = common.MAVLink(None).parse_buffer(bytearray(frame))
    return message.vx, message.vy, message.vz, message.yaw


def adapter(yaw_rad: float) -> Px4CopterAdapter:
    """Return an adapter that has heard its vehicle, whose nose points somewhere."""
    heard = Px4CopterAdapter(SYSTEM)
    heard.receive(HEARTBEAT, 0.0)
    place = common.MAVLink_global_position_int_message(1, 470_000_000, 80_000_000, 0, 0, 0, 0, 0, _cdeg(yaw_rad))
    heard.receive(bytes(place.pack(_MAV)), 0.0)
    return heard


def _cdeg(angle_rad: float) -> int:
    return round(math.degrees(angle_rad) * 100.0)


def test_a_setpoints_velocity_and_yaw_are_read_off_the_wire() -> None:
    (frame,) = adapter(0.0).encode(Setpoint(0.5, 5.0, 20.0), 0.0, 1.0)
    assert isinstance(frame, SetpointFrame)
    assert frame.velocity == pytest.approx(on_the_wire(frame), abs=1e-5)
    assert frame.velocity.north_m_s > 0.0


def test_a_setpoint_whose_zeros_were_cut_is_read_too() -> None:
    (frame,) = adapter(0.0).hold(1.0)
    assert isinstance(frame, SetpointFrame)
    assert frame.velocity == on_the_wire(frame) == (0.0, 0.0, 0.0, 0.0)


def test_what_is_no_velocity_setpoint_is_left_alone() -> None:
    attitude = common.MAVLink_set_attitude_target_message(0, SYSTEM, 1, 0xC6, [1, 0, 0, 0], 0, 0, 0, 0.5).pack(_MAV)
    assert not isinstance(adapter(0.0).heartbeat(), SetpointFrame)
    assert not is_setpoint(HEARTBEAT)
    assert is_setpoint(bytes(attitude))


def test_a_missing_mavsdk_is_told_with_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"not installed; allowed: after pip install 'mavsdk>=4.1', or direct"):
        offboard_module.require_mavsdk()


class Sent:
    """What came out for the autopilot, and when by the monotonic clock."""

    def __init__(self) -> None:
        self.frames: list[tuple[float, bytes]] = []

    def __call__(self, frame: bytes) -> None:
        self.frames.append((time.monotonic(), frame))

    @property
    def last_s(self) -> float:
        return self.frames[-1][0]


async def tick_until(offboard: Offboard, condition: Callable[[], bool], wanted: tuple[float, ...] | None) -> None:
    patience_ends_s = time.monotonic() + READY_WITHIN_S
    while not condition():
        assert time.monotonic() < patience_ends_s
        offboard.receive(HEARTBEAT)
        offboard.tick(SYSTEM, wanted)  # type: ignore[arg-type]
        await asyncio.sleep(0.05)


@asynccontextmanager
async def steering(sent: Sent, may_go_on: Callable[[], bool] = lambda: True) -> AsyncIterator[Offboard]:
    offboard = Offboard(sent, may_go_on)
    try:
        await tick_until(offboard, lambda: all(child.ready for child in offboard._children), None)
        await tick_until(offboard, lambda: len(sent.frames) >= 10, WANTED)
        yield offboard
    finally:
        offboard.close()


@pytest.mark.slow
def test_mavsdk_steers_only_while_it_is_told_to() -> None:
    async def body() -> None:
        sent = Sent()
        async with steering(sent) as offboard:
            assert all(on_the_wire(frame) == pytest.approx(WANTED, abs=1e-5) for _, frame in sent.frames)
            first = common.MAVLink(None).parse_buffer(sent.frames[0][1])[0]
            assert (first.type_mask, first.coordinate_frame, first.target_system) == (0x9C7, 1, SYSTEM)
            assert (first.get_srcSystem(), first.get_srcComponent()) == (SYSTEM, COMPANION_COMPONENT)
            # A person takes over: nothing leaves any more, and the next child is there for another day.
            offboard.tick(SYSTEM, None)
            count = len(sent.frames)
            await asyncio.sleep(0.3)
            offboard.tick(SYSTEM, None)
            await asyncio.sleep(0.1)
            assert len(sent.frames) == count
            assert offboard.ready
            await tick_until(offboard, lambda: len(sent.frames) >= count + 5, WANTED)

    asyncio.run(body())


@pytest.mark.slow
def test_when_the_child_that_steers_dies_the_next_goes_on() -> None:
    async def body() -> None:
        sent = Sent()
        async with steering(sent) as offboard:
            (active,) = [child for child in offboard._children if child.steers]
            os.kill(active._process.pid, signal.SIGKILL)
            killed_s, count = time.monotonic(), len(sent.frames)
            await tick_until(offboard, lambda: len(sent.frames) >= count + 5, WANTED)
            assert sent.frames[count + 4][0] - killed_s < TICK_TIMEOUT_S
            assert offboard.ended == 1

    asyncio.run(body())


@pytest.mark.slow
def test_when_the_child_that_steers_hangs_the_next_goes_on_before_the_stream_has_ended() -> None:
    async def body() -> None:
        sent = Sent()
        async with steering(sent, lambda: pytest.fail("the stream had ended")) as offboard:
            stop_the_one_that_steers(offboard)
            await asyncio.sleep(0.02)
            count = len(sent.frames)
            await tick_until(offboard, lambda: len(sent.frames) >= count + 5, WANTED)
            assert SILENCE_S < longest_gap_s(sent) < STREAM_GAP_S
            assert offboard.ended == 1

    asyncio.run(body())


@pytest.mark.slow
def test_after_a_gap_of_what_left_nothing_leaves_unless_the_caller_says_so() -> None:
    async def body() -> None:
        sent, asked = Sent(), list[float]()

        def may_go_on() -> bool:
            asked.append(time.monotonic())
            return len(asked) > 3

        async with steering(sent, may_go_on) as offboard:
            # Nobody stands ready, so the next has to be started first.
            for child in offboard._children:
                os.kill(child._process.pid, signal.SIGKILL)
            await asyncio.sleep(0.02)
            count = len(sent.frames)
            while not offboard.silent:
                # Told nothing of the autopilot, it is not ready before.
                offboard.tick(SYSTEM, WANTED)
                await asyncio.sleep(0.05)
            assert (asked, len(sent.frames)) == ([], count)
            await tick_until(offboard, lambda: len(sent.frames) > count, WANTED)
            assert sent.frames[count][0] >= asked[3]
            assert not offboard.silent
            await tick_until(offboard, lambda: len(sent.frames) >= count + 5, WANTED)
            assert len(asked) == 4

    asyncio.run(body())


@pytest.mark.slow
def test_before_the_first_setpoint_there_is_no_gap_however_long_it_takes() -> None:
    async def body() -> None:
        offboard = Offboard(lambda frame: None, lambda: pytest.fail("no stream had begun"))
        try:
            began_s = time.monotonic()
            await tick_until(offboard, lambda: time.monotonic() - began_s > STREAM_GAP_S + 0.1, WANTED)
            assert not offboard.silent
            await tick_until(offboard, lambda: offboard._left_s is not None, WANTED)
        finally:
            offboard.close()

    asyncio.run(body())


@pytest.mark.slow
def test_a_flood_of_telemetry_ends_no_child_that_still_imports() -> None:
    async def body() -> None:
        offboard = Offboard(lambda frame: None, lambda: True)
        try:
            patience_ends_s = time.monotonic() + READY_WITHIN_S
            while not all(child.ready for child in offboard._children):
                assert time.monotonic() < patience_ends_s
                for _ in range(200):
                    offboard.receive(HEARTBEAT)
                offboard.tick(SYSTEM, None)
                await asyncio.sleep(0.05)
            assert offboard.ended == 0
        finally:
            offboard.close()

    asyncio.run(body())


@pytest.mark.slow
def test_the_signal_that_clears_a_take_over_ends_no_child_from_its_first_moment_on() -> None:
    async def body() -> None:
        offboard = Offboard(lambda frame: None, lambda: True)
        try:
            for child in offboard._children:
                os.kill(child._process.pid, signal.SIGUSR1)
            await tick_until(offboard, lambda: all(child.ready for child in offboard._children), None)
            for child in offboard._children:
                os.kill(child._process.pid, signal.SIGUSR1)
            await asyncio.sleep(0.1)
            offboard.tick(SYSTEM, None)
            assert [child._process.poll() for child in offboard._children] == [None, None]
            assert offboard.ended == 0
            # Only the children are deaf to it.
            assert signal.SIGUSR1 not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
        finally:
            offboard.close()

    asyncio.run(body())


def stop_the_one_that_steers(offboard: Offboard) -> None:
    (active,) = [child for child in offboard._children if child.steers]
    os.kill(active._process.pid, signal.SIGSTOP)


def longest_gap_s(sent: Sent) -> float:
    times_s = [at_s for at_s, _ in sent.frames]
    return max(after_s - before_s for before_s, after_s in pairwise(times_s))


@pytest.mark.slow
def test_without_a_tick_nothing_more_is_let_through_and_the_children_end() -> None:
    async def body() -> None:
        sent = Sent()
        async with steering(sent) as offboard:
            processes = [child._process for child in offboard._children]
            hung_s = time.monotonic()
            offboard.tick(SYSTEM, WANTED)
            # The event loop goes on, but nothing ticks.
            await asyncio.sleep(TICK_TIMEOUT_S + 0.3)
            assert TICK_TIMEOUT_S - 0.2 < sent.last_s - hung_s < TICK_TIMEOUT_S + 0.1
            assert [process.poll() for process in processes] == [-signal.SIGALRM] * 2

    asyncio.run(body())


@pytest.mark.slow
def test_what_mavsdk_said_while_the_loop_hung_is_dropped() -> None:
    async def body() -> None:
        sent = Sent()
        async with steering(sent) as offboard:
            offboard.tick(SYSTEM, WANTED)
            count = len(sent.frames)
            time.sleep(TICK_TIMEOUT_S + 0.2)
            await asyncio.sleep(0.1)
            assert len(sent.frames) == count

    asyncio.run(body())


PARENT = """
import asyncio, time
from companion.autopilot.offboard import Offboard
from tests.companion.autopilot.test_offboard import HEARTBEAT, SYSTEM, WANTED, on_the_wire

def send(frame):
    print("sent", on_the_wire(frame)[0], flush=True)

async def main():
    offboard = Offboard(send, lambda: True)
    while True:
        offboard.receive(HEARTBEAT)
        # The velocity north is the time of the tick, so that one sees when what is sent was made.
        offboard.tick(SYSTEM, WANTED._replace(north_m_s=time.monotonic() - {epoch_s}))
        print("children", *(child._process.pid for child in offboard._children), flush=True)
        await asyncio.sleep(0.1)

asyncio.run(main())
"""


@pytest.mark.slow
def test_children_end_within_their_time_when_the_parent_is_stopped(tmp_path: Path) -> None:
    output = tmp_path / "said.txt"
    root = Path(__file__).parents[3]
    epoch_s = time.monotonic()
    with output.open("w") as file:
        code, environment = PARENT.format(epoch_s=epoch_s), {**os.environ, "PYTHONPATH": str(root)}
        parent = subprocess.Popen([sys.executable, "-c", code], stdout=file, cwd=root, env=environment)
    try:
        patience_ends_s = time.monotonic() + READY_WITHIN_S
        while output.read_text().count("sent") < 10:
            assert time.monotonic() < patience_ends_s
            time.sleep(0.05)
        children = [int(pid) for pid in output.read_text().rpartition("children")[2].split("\n")[0].split()]
        stopped_s = time.monotonic()
        parent.send_signal(signal.SIGSTOP)
        while any(is_running(child) for child in children):
            assert time.monotonic() - stopped_s < 5.0
            time.sleep(0.01)
        assert time.monotonic() - stopped_s < TICK_TIMEOUT_S + 0.3
        time.sleep(max(0.0, stopped_s + TICK_TIMEOUT_S + 0.1 - time.monotonic()))
        # Woken again, it sends nothing that was made before.
        count = output.read_text().count("sent")
        woken_s = time.monotonic()
        parent.send_signal(signal.SIGCONT)
        while not (sent := output.read_text().split("sent ")[count + 1 :]):
            assert time.monotonic() - woken_s < READY_WITHIN_S
            time.sleep(0.05)
        assert all(float(velocity.split()[0]) > woken_s - epoch_s - 0.01 for velocity in sent)
    finally:
        parent.kill()
        parent.wait()


def is_running(pid: int) -> bool:
    """Return whether a process still runs code: a zombie waits only to be asked how it ended."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.slow
def test_the_childs_alarm_rings_even_while_python_hangs() -> None:
    code = f"""
import signal, socket, struct, threading
from companion.autopilot.offboard_child import _Child
ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
_Child(theirs).take({SETPOINT!r}, {SETPOINT_FIELDS.pack(*WANTED)!r})
print("ticked", flush=True)
while True:
    pass
"""
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE) as child:
        assert child.stdout is not None
        child.stdout.readline()
        began_s = time.monotonic()
        assert child.wait(timeout=5.0) == -signal.SIGALRM
        assert time.monotonic() - began_s < TICK_TIMEOUT_S + 0.3
