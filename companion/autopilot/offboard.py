"""The parent's side of MAVSDK for PX4: the companion's velocities in, what MAVSDK makes of them out.

The parent keeps the one link to the autopilot. It gives the child what the autopilot says, and lets through from it
nothing but setpoints, and those only while its own loop ticks. A second child waits ready: when the safety pilot takes
over, the one that steered is ended at once, because MAVSDK would repeat its last setpoint; when one dies or falls
silent the next goes on. PX4 obeys again by itself when a stream that ended comes back: so after a gap of what really
left no setpoint leaves before the caller was asked.
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
"""One that steers and one that waits."""
SILENCE_S = 0.3
"""A child that steers and sends no setpoint for this time is hung. Chosen: six of MAVSDK's periods of 50 ms, and early
enough that the next child goes on within STREAM_GAP_S."""
SEND_BUFFER_BYTES = 1_048_576
"""Asked for; the kernel gives what net.core.wmem_max allows. A message takes some hundred bytes more than it holds."""
MAVSDK_SILENT = "MAVSDK sent nothing"
RESPAWN_S = 1.0
"""A child that cannot start is not started over and over."""
SETPOINT_ID = common.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
SETPOINT_IDS = (
    SETPOINT_ID,
    common.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
    common.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
)


def require_mavsdk() -> None:
    """Raise InputError if MAVSDK is not installed."""
    if importlib.util.find_spec("mavsdk") is None:
        raise InputError(
            "autopilot.offboard: 'mavsdk', which is not installed; allowed: after pip install 'mavsdk>=4.1', or direct"
        )


def is_setpoint(frame: bytes) -> bool:
    """Return whether a whole frame is one that steers."""
    raw = raw_frame(frame)
    return raw.version == 2 and raw.message_id in SETPOINT_IDS


class Offboard:
    """Hands setpoints to MAVSDK in a child process; times are the event loop's, which are monotonic."""

    def __init__(self, send: Callable[[bytes], None], may_go_on: Callable[[], bool]) -> None:
        """Start the children; raises InputError if MAVSDK is missing.

        `send` gets each frame for the autopilot; `may_go_on` is asked after a gap, before the stream begins again.
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
        self.ended = 0
        """Children that ended by themselves, or hung."""

    @property
    def ready(self) -> bool:
        """Whether a child knows the autopilot and can steer."""
        return any(child.ready for child in self._children)

    @property
    def silent(self) -> bool:
        """Whether a stream is wanted that has begun before and now has a gap: no setpoint left for STREAM_GAP_S."""
        return self._wanted and self._left_s is not None and self._loop.time() - self._left_s > STREAM_GAP_S

    def receive(self, datagram: bytes) -> None:
        """Pass on what the autopilot said."""
        for child in self._children:
            child.pass_on(datagram)

    def tick(self, system_id: int | None, wanted: Velocity | None) -> None:
        """Say that the loop is alive and what it wants; None ends the child that steered, and with it its stream."""
        self._ticked_s = self._loop.time()
        self._wanted = wanted is not None
        if wanted is None:
            for child in [child for child in self._children if child.steers]:
                child.end()
                self._children.remove(child)
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
        """End all children."""
        for child in self._children:
            child.end()
        self._children.clear()

    def _steering(self) -> _Child | None:
        """Return who steers: who did so before, else the first that is ready."""
        ready = [child for child in self._children if child.ready]
        return min(ready, key=lambda child: not child.steers, default=None)

    def _end_the_hung(self) -> None:
        spare = any(child.ready and not child.steers for child in self._children)
        # Without another to go on it may still come back in time.
        patience_s = SILENCE_S if spare else STREAM_GAP_S
        for child in [child for child in self._children if child.steers]:
            if self._ticked_s - child.steered_s > patience_s:
                child.dead = True
        self._replace_the_dead()

    def _replace_the_dead(self) -> None:
        for child in [child for child in self._children if child.dead]:
            child.end()
            self._children.remove(child)
            self.ended += 1
        if len(self._children) < CHILDREN and self._ticked_s - self._spawned_s >= RESPAWN_S:
            self._spawned_s = self._ticked_s
            self._children.append(_Child(self._from_child))

    def _from_child(self, child: _Child, sent: bytes) -> None:
        if not child.steers or self._loop.time() - self._ticked_s > TICK_TIMEOUT_S:
            # What a child said while this process was stopped is older than it looks.
            return
        for frame in raw_frames(sent):
            if frame.version == 2 and frame.message_id == SETPOINT_ID:
                child.steered_s = self._loop.time()
                if not self.silent or self._may_go_on():
                    self._left_s = child.steered_s
                    self._send(frame.data)


@contextmanager
def _blocked(number: signal.Signals) -> Iterator[None]:
    """Hold a signal back; a process that is started meanwhile holds it back for ever, from before its first line on."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {number})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Child:
    """One child process and the socket to it, whose messages arrive whole."""

    def __init__(self, on_frame: Callable[[_Child, bytes], None]) -> None:
        self.ready = self.steers = self.dead = False
        self.steered_s = math.inf
        """When it last sent a setpoint, or was first told to."""
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
        """Say once whose onboard computer it speaks as."""
        if not self._identified and system_id is not None:
            self._identified = True
            self.tell(IDENTITY + IDENTITY_FIELDS.pack(system_id, COMPANION_COMPONENT))

    def steer(self, now_s: float) -> None:
        """Be the one that steers from now on."""
        if not self.steers:
            self.steers, self.steered_s = True, now_s

    def pass_on(self, datagram: bytes) -> None:
        """Pass on what the autopilot said, if the child reads already and keeps up: a flood of it kills no child."""
        if self._up:
            with suppress(OSError):
                self._socket.send(RECEIVED + datagram)

    def tell(self, message: bytes) -> None:
        """Send a message; a child that no longer reads counts as dead."""
        try:
            self._socket.send(message)
        except OSError:
            self.dead = True

    def end(self) -> None:
        """Kill the process, now."""
        if self._socket.fileno() >= 0:
            self._loop.remove_reader(self._socket)
            self._socket.close()
        self._process.kill()
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
