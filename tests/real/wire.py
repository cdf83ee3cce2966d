"""Lies between a companion and its autopilot: it carries every frame, and has the field's troubles when told to."""

from __future__ import annotations

import heapq
import random
import select
import socket
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Literal

from pymavlink.dialects.v20 import common as mavlink

from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.protocol.frame import raw_frame
from tests.real.kinds import Kind
from tests.real.score import SETPOINTS

Trouble = Literal["copies", "impostors", "stranger"]
"""`copies`: every frame of the autopilot comes a second time, late. `impostors`: HEARTBEATs of a router, of another
vehicle and of a script that calls itself 1/1 come beside the autopilot's. `stranger`: one byte, 50 times a second, from
another address."""
PORT = 14700
"""Port of agent 0's companion when there is a wire; each agent has the next one."""
LATE_S = (0.1, 5.0)
"""How late a copy is: that of a second, worse path of a mobile network."""
STRANGER_PERIOD_S = 0.02
IMPOSTOR_PERIOD_S = 0.2
LOWERED = (
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    mavlink.MAVLINK_MSG_ID_ATTITUDE,
    mavlink.MAVLINK_MSG_ID_VFR_HUD,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE,
)
"""Messages that another program slows down on PX4, which has no stream of all of them."""
SLOW_US = 4e6
"""Interval to which it slows them down: longer than telemetry counts."""
_POLL_S = 0.005
_READ_BYTES = 65_536
_ROUTER_SYSTEM = 125


def whole_frames(received: bytearray) -> Iterator[bytes]:
    """Take the whole frames off the beginning of what an autopilot sent; what is not whole yet stays."""
    while len(received) > 2:
        if received[0] == 0xFD:
            length = received[1] + (25 if received[2] & 1 else 12)
        elif received[0] == 0xFE:
            length = received[1] + 8
        else:
            del received[0]
            continue
        if len(received) < length:
            return
        yield bytes(received[:length])
        del received[:length]


class Wire:
    """Carries frames between one autopilot and one companion in a thread of its own."""

    def __init__(self, kind: Kind, instance: int, agent_id: int, troubles: Iterable[Trouble]) -> None:
        """Connect to the autopilot, and speak to the companion at PORT + its agent's id."""
        self._kind, self._system = kind, instance + 1
        self._up = _to_px4(14540 + instance) if kind.firmware == "PX4" else _to_ardupilot(5760 + 10 * instance)
        self._down, self._elsewhere = (socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2))
        self._companion = ("127.0.0.1", PORT + agent_id)
        self._autopilot: tuple[str, int] | None = None
        self.troubles = set(troubles)
        self.delivered_s: list[float] = []
        """Unix times at which setpoints went on to the autopilot."""
        self.told_s: list[float] = []
        """Unix times at which the autopilot's HEARTBEAT went on to the companion with another mode than the last."""
        self._mode: bytes | None = None
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def lower_rates(self) -> None:
        """Have another program on the companion's own link ask for no messages, or of PX4 for slow ones."""
        other = mavlink.MAVLink(None, srcSystem=255, srcComponent=mavlink.MAV_COMP_ID_MISSIONPLANNER)
        if self._kind.firmware == "ArduPilot":
            asked: list[Any] = [mavlink.MAVLink_request_data_stream_message(self._system, 1, 0, 0, 0)]
        else:
            interval = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
            asked = [
                mavlink.MAVLink_command_long_message(self._system, 1, interval, 0, number, SLOW_US, *[0.0] * 5)
                for number in LOWERED
            ]
        for message in asked:
            self._send_up(message.pack(other))

    def close(self) -> None:
        """End the thread and close the sockets."""
        self._ends.set()
        self._thread.join()
        for opened in (self._up, self._down, self._elsewhere):
            opened.close()

    def _run(self) -> None:
        received = bytearray()
        late: list[tuple[float, bytes]] = []
        chance = random.Random(1)
        impostors = _Now(IMPOSTOR_PERIOD_S, self._impersonate)
        stranger = _Now(STRANGER_PERIOD_S, lambda: self._elsewhere.sendto(b"\0", self._companion))
        while not self._ends.is_set():
            for ready in select.select([self._up, self._down], [], [], _POLL_S)[0]:
                if ready is self._down:
                    self._carry_up()
                    continue
                for frame in self._heard(received):
                    self._send_down(frame)
                    self._note_mode(frame)
                    if "copies" in self.troubles:
                        heapq.heappush(late, (time.time() + chance.uniform(*LATE_S), frame))
            while late and late[0][0] <= time.time():
                self._send_down(heapq.heappop(late)[1])
            if "impostors" in self.troubles:
                impostors.do()
            if "stranger" in self.troubles:
                stranger.do()

    def _heard(self, received: bytearray) -> list[bytes]:
        data, address = self._up.recvfrom(_READ_BYTES)
        self._autopilot = address
        received += data
        return list(whole_frames(received))

    def _carry_up(self) -> None:
        data = self._down.recv(_READ_BYTES)
        frame = raw_frame(data)
        if frame.component == COMPANION_COMPONENT and frame.message_id in SETPOINTS:
            self.delivered_s.append(time.time())
        self._send_up(data)

    def _note_mode(self, data: bytes) -> None:
        frame = raw_frame(data)
        autopilot = (self._system, mavlink.MAV_COMP_ID_AUTOPILOT1, mavlink.MAVLINK_MSG_ID_HEARTBEAT)
        if (*frame.sender, frame.message_id) == autopilot and frame.payload[:4] != self._mode:
            self._mode = frame.payload[:4]
            self.told_s.append(time.time())

    def _send_up(self, data: bytes) -> None:
        if self._kind.firmware == "ArduPilot":
            self._up.send(data)
        elif self._autopilot is not None:
            self._up.sendto(data, self._autopilot)

    def _send_down(self, frame: bytes) -> None:
        self._down.sendto(frame, self._companion)

    def _impersonate(self) -> None:
        quadrotor, ardupilot = mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
        script, no_autopilot = mavlink.MAV_TYPE_ONBOARD_CONTROLLER, mavlink.MAV_AUTOPILOT_INVALID
        for system, kind, autopilot in (
            (_ROUTER_SYSTEM, mavlink.MAV_TYPE_GCS, no_autopilot),
            (self._system + 50, quadrotor, ardupilot),
            (self._system, script, no_autopilot),
        ):
            sender = mavlink.MAVLink(None, srcSystem=system, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
            heartbeat = mavlink.MAVLink_heartbeat_message(kind, autopilot, 0, 0, mavlink.MAV_STATE_STANDBY, 3)
            self._send_down(heartbeat.pack(sender))


class _Now:
    """Does something each period, at the calls that come."""

    def __init__(self, period_s: float, action: Callable[[], object]) -> None:
        self._period_s, self._action = period_s, action
        self._due_s = 0.0

    def do(self) -> None:
        """Do it if it is due."""
        if time.monotonic() >= self._due_s:
            self._due_s = time.monotonic() + self._period_s
            self._action()


def _to_ardupilot(port: int) -> socket.socket:
    return socket.create_connection(("127.0.0.1", port), timeout=5.0)


def _to_px4(port: int) -> socket.socket:
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    opened.bind(("127.0.0.1", port))
    return opened
