"""The parent's side of MAVSDK for PX4: it passes velocities to a child process with MAVSDK, and its setpoints on.

The parent owns the only link to the autopilot. It passes what the autopilot sends to the child, and from the child it
passes on nothing but setpoints, and those only while its own loop ticks. A second child is always ready. When the
safety pilot takes over, the child that steered is ended at once, because MAVSDK would repeat its last setpoint; when it
dies or falls silent, the second one takes its place. PX4 re-enters OFFBOARD by itself when a stream that ended comes
back, so after a gap in the setpoints that were sent none is sent before `may_go_on` has allowed it.
"""

from __future__ import annotations

import asyncio
import importlib.util
import math
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from pymavlink.dialects.v20 import common

from companion.autopilot.adapter import Velocity
from companion.autopilot.offboard_child import (
    FRAME,
    IDENTITY,
    IDENTITY_FIELDS,
    MESSAGE_BYTES,
    READY,
    RECEIVED,
    SETPOINT,
    SETPOINT_FIELDS,
    TICK,
    TICK_TIMEOUT_S,
    UP,
)
from companion.autopilot.stream import STREAM_GAP_S
from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.errors import InputError
from companion.protocol.frame import raw_frame, raw_frames

CHILDREN = 2
"""Number of child processes: one that steers and one that is ready to replace it."""
SILENCE_S = 0.3
"""Time without a setpoint after which the child that steers counts as hung. Chosen: six of MAVSDK's periods of 50 ms,
and early enough that the next child takes over within STREAM_GAP_S."""
SEND_BUFFER_BYTES = 1_048_576
"""Requested size of the send buffer to a child; the kernel grants at most net.core.wmem_max. A message occupies some
hundred bytes more than its length."""
MAVSDK_SILENT = "MAVSDK sent nothing"
"""Reason, in messages and logs, for a gap in the stream of setpoints that MAVSDK should have sent."""
RESPAWN_S = 1.0
"""Least time between two starts of a child, so that one that cannot start does not keep the processor busy."""
SETPOINT_ID = common.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
"""The message that a child's setpoints consist of."""
SETPOINT_IDS = (
    SETPOINT_ID,
    common.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
    common.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
)
"""All messages that steer a vehicle."""


def require_mavsdk() -> None:
    """Raise InputError if the package mavsdk is not installed."""
    if importlib.util.find_spec("mavsdk") is None:
        raise InputError(
            "autopilot.offboard: 'mavsdk', which is not installed; allowed: after pip install 'mavsdk>=4.1', or direct"
        )


def is_setpoint(frame: bytes) -> bool:
    """Return whether a complete MAVLink frame is a setpoint (one of SETPOINT_IDS)."""
    return raw_frame(frame).message_id in SETPOINT_IDS


class Offboard:
    """Passes setpoints to MAVSDK in a child process; all times are those of the event loop's monotonic clock."""

    def __init__(self, send: Callable[[bytes], None], may_go_on: Callable[[], bool]) -> None:
        """Start the children; raises InputError if MAVSDK is missing.

        `send` sends one frame to the autopilot. `may_go_on` is called after a gap in the stream and returns whether it
        may begin again.
        """
        require_mavsdk()
        self._send = send
        self._may_go_on = may_go_on
        self._wanted = False
        self._left_s: float | None = None
        self._loop = asyncio.get_running_loop()
        self._ticked_s = -math.inf
        self._spawned_s = -math.inf
        self._children = [_Child(self._from_child) for _ in range(CHILDREN)]
        self._killed: list[_Child] = []
        """Children that were killed and may still be there: the loop does not wait until the kernel has ended them."""
        self.ended = 0
        """Number of children that ended by themselves or hung."""

    @property
    def ready(self) -> bool:
        """Whether at least one child has found the autopilot and can steer."""
        return any(child.ready for child in self._children)

    @property
    def silent(self) -> bool:
        """Whether a wanted stream that had begun has a gap: no setpoint was sent for STREAM_GAP_S."""
        return self._wanted and self._left_s is not None and self._loop.time() - self._left_s > STREAM_GAP_S

    def receive(self, datagram: bytes) -> None:
        """Pass a datagram from the autopilot on to all children."""
        for child in self._children:
            child.pass_on(datagram)

    def tick(self, system_id: int | None, wanted: Velocity | None) -> None:
        """Tell the children that the loop is alive and which velocity is wanted; None ends the child that steers.

        `system_id` is the autopilot's, or None until it is known.
        """
        self._ticked_s = self._loop.time()
        self._wanted = wanted is not None
        if wanted is None:
            for child in [child for child in self._children if child.steers]:
                self._kill(child)
                self._spawned_s = -math.inf
        self._end_the_hung()
        steering = self._steering() if wanted is not None else None
        for child in self._children:
            child.identify(system_id)
            if child is steering and wanted is not None:
                child.steer(self._ticked_s)
                child.tell(SETPOINT + SETPOINT_FIELDS.pack(*wanted))
            else:
                child.tell(TICK)
        self._replace_the_dead()

    def close(self) -> None:
        """End all child processes."""
        for child in list(self._children):
            self._kill(child)
        for child in self._killed:
            child.wait()
        self._killed.clear()

    def _kill(self, child: _Child) -> None:
        child.kill()
        self._children.remove(child)
        self._killed.append(child)

    def _steering(self) -> _Child | None:
        """Return the child that is to steer: the one that steers already, else the first that is ready, else None."""
        ready = [child for child in self._children if child.ready]
        return min(ready, key=lambda child: not child.steers, default=None)

    def _end_the_hung(self) -> None:
        spare = any(child.ready and not child.steers for child in self._children)
        # Without a ready replacement the child gets more time, since it may still come back.
        patience_s = SILENCE_S if spare else STREAM_GAP_S
        for child in [child for child in self._children if child.steers]:
            if self._ticked_s - child.steered_s > patience_s:
                child.dead = True
        self._replace_the_dead()

    def _replace_the_dead(self) -> None:
        for child in [child for child in self._children if child.dead]:
            self._kill(child)
            self.ended += 1
        self._killed = [child for child in self._killed if not child.is_gone()]
        if len(self._children) < CHILDREN and self._ticked_s - self._spawned_s >= RESPAWN_S:
            self._spawned_s = self._ticked_s
            self._children.append(_Child(self._from_child))

    def _from_child(self, child: _Child, sent: bytes) -> None:
        if not child.steers or self._loop.time() - self._ticked_s > TICK_TIMEOUT_S:
            # After this process was stopped, setpoints that a child sent meanwhile may be old.
            return
        for frame in raw_frames(sent):
            if frame.version == 2 and frame.message_id == SETPOINT_ID:
                child.steered_s = self._loop.time()
                if not self.silent or self._may_go_on():
                    self._left_s = child.steered_s
                    self._send(frame.data)


@contextmanager
def _blocked(number: signal.Signals) -> Iterator[None]:
    """Block a signal; a process started meanwhile inherits the block, from before its first line and for good."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {number})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Child:
    """One child process and the socket to it, a sequenced-packet socket that keeps message boundaries."""

    def __init__(self, on_frame: Callable[[_Child, bytes], None]) -> None:
        self.ready = self.steers = self.dead = False
        self.steered_s = math.inf
        """Time of its last setpoint, or when it was first told to steer, whichever is later."""
        self._up = self._identified = False
        self._on_frame = on_frame
        self._socket, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.setblocking(False)
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER_BYTES)
        with theirs, _blocked(signal.SIGUSR1):
            self._process = subprocess.Popen(
                [sys.executable, "-m", "companion.autopilot.offboard_child", str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=(theirs.fileno(),),
            )
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._socket, self._read)

    def identify(self, system_id: int | None) -> None:
        """Tell the child, once, the system id with which it sends as the onboard computer."""
        if not self._identified and system_id is not None:
            self._identified = True
            self.tell(IDENTITY + IDENTITY_FIELDS.pack(system_id, COMPANION_COMPONENT))

    def steer(self, now_s: float) -> None:
        """Mark the child as the one that steers from now on."""
        if not self.steers:
            self.steers, self.steered_s = True, now_s

    def pass_on(self, datagram: bytes) -> None:
        """Pass on a datagram from the autopilot; drop it if the child does not read yet or its socket is full."""
        if self._up:
            with suppress(OSError):
                self._socket.send(RECEIVED + datagram)

    def tell(self, message: bytes) -> None:
        """Send a message to the child; if that fails, the child counts as dead."""
        try:
            self._socket.send(message)
        except OSError:
            self.dead = True

    def kill(self) -> None:
        """Close the socket and kill the process at once."""
        if self._socket.fileno() >= 0:
            self._loop.remove_reader(self._socket)
            self._socket.close()
        self._process.kill()

    def is_gone(self) -> bool:
        """Return whether the killed process has ended."""
        return self._process.poll() is not None

    def wait(self) -> None:
        """Wait until the killed process has ended."""
        self._process.wait()

    def _read(self) -> None:
        try:
            message = self._socket.recv(MESSAGE_BYTES)
        except BlockingIOError:
            return
        except OSError:
            message = b""
        if not message:
            self.dead = True
            self._loop.remove_reader(self._socket)
        elif message[:1] == UP:
            self._up = True
        elif message[:1] == READY:
            self.ready = True
        elif message[:1] == FRAME:
            self._on_frame(self, message[1:])
