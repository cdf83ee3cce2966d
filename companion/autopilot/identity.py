"""Which frames on a link are the autopilot's, and newer than what it said before: nothing else is believed.

An autopilot is a system, the component 1, an autopilot and a type of vehicle in its HEARTBEAT, and a continuity of its
clock and its sequence numbers. Routers, scripts, gimbals, other vehicles, copies that come by a second way and frames
that come late change nothing. Every decision here is a function of the frames and their times of arrival.
"""

from __future__ import annotations

import math
import struct
from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

from pymavlink.dialects.v20 import common

from companion.autopilot.boot_clock import SHARED_MEMORY_S, BootClock, Clocked
from companion.autopilot.frame_order import DUPLICATE, LATE, FrameOrder
from companion.autopilot.heartbeat import HeartbeatIdentity, identified
from companion.files.mavlink_layout import SEQUENCE_AT, SEQUENCE_V1_AT
from companion.protocol.frame import RawFrame

CHOOSE_AFTER_S = 1.5
"""Time of listening, from the first heartbeat of a fitting autopilot, after which one is chosen without a system id:
each sends a heartbeat a second, so every one was heard."""
STRAY_MEMORY_S = 5.0
"""Time after which an autopilot of which one heartbeat was heard is forgotten."""
OTHERS_MEMORY_S = 30.0
"""Time after which an autopilot that was heard more often is forgotten."""
MAX_COMPONENTS = 8
"""Greatest number of components beside the autopilot whose frames are kept in order."""
STANDS_STILL = "clock stands still"
"""Reason for a new frame with the time of the one before."""
AUTOPILOT_COMPONENT = common.MAV_COMP_ID_AUTOPILOT1
_NO_VEHICLES = frozenset(
    {
        common.MAV_TYPE_ANTENNA_TRACKER,
        common.MAV_TYPE_GCS,
        common.MAV_TYPE_ONBOARD_CONTROLLER,
        common.MAV_TYPE_GIMBAL,
        common.MAV_TYPE_ADSB,
        common.MAV_TYPE_CAMERA,
        common.MAV_TYPE_CHARGING_STATION,
        common.MAV_TYPE_FLARM,
        common.MAV_TYPE_SERVO,
        common.MAV_TYPE_ODID,
        common.MAV_TYPE_BATTERY,
        common.MAV_TYPE_PARACHUTE,
        common.MAV_TYPE_LOG,
        common.MAV_TYPE_OSD,
        common.MAV_TYPE_IMU,
        common.MAV_TYPE_GPS,
        common.MAV_TYPE_WINCH,
    }
)
"""The MAV_TYPEs that no vehicle has, whatever else its heartbeat says."""
_TIMED = frozenset(
    {
        common.MAVLINK_MSG_ID_ATTITUDE,
        common.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
        common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    }
)
"""The messages that begin with time_boot_ms."""
_KEYS = {
    common.MAVLINK_MSG_ID_PARAM_VALUE: slice(8, 24),
    common.MAVLINK_MSG_ID_COMMAND_ACK: slice(0, 2),
    common.MAVLINK_MSG_ID_ADSB_VEHICLE: slice(0, 4),
}
"""The part of the payload that says what a message is about, where that is newer or older for itself: a parameter's
name, a command's number, an aircraft's address."""
_HEARTBEAT = struct.Struct("<IBBBBB")
_PLACE = struct.Struct("<Iii")
_AUTOPILOTS = {
    common.MAV_AUTOPILOT_GENERIC: "generic",
    common.MAV_AUTOPILOT_ARDUPILOTMEGA: "ArduPilot",
    common.MAV_AUTOPILOT_PX4: "PX4",
}


class Verdict(NamedTuple):
    """What a frame on the link is: the autopilot's and newer than what it said before, or the reason why not."""

    reason: str | None
    """Why the frame is not to be read; None if it is."""
    at_s: float = math.nan
    """When it would have arrived without delay, as far as newer frames show that it is late."""


@dataclass
class _Heard:
    """One system whose heartbeat says that it is an autopilot."""

    autopilot: int
    mav_type: int
    first_s: float
    last_s: float
    times: int = 0
    armed: bool = False

    def is_present(self, now_s: float) -> bool:
        """Return whether it was heard lately; a single heartbeat is soon forgotten."""
        return now_s - self.last_s <= (STRAY_MEMORY_S if self.times < 2 else OTHERS_MEMORY_S)


class Systems:
    """Chooses the autopilot among the systems on a link."""

    def __init__(self, kind: HeartbeatIdentity, system_id: int | None) -> None:
        """Choose one of this kind, with this system id; None: the one that is there, if there is only one."""
        self.kind = kind
        self.system_id = system_id
        self.chosen: int | None = None
        self._fitting: dict[int, _Heard] = {}
        self._others: dict[int, _Heard] = {}
        self._armed_since_s: float | None = None

    def hear(self, frame: RawFrame, now_s: float) -> bool:
        """Take in a HEARTBEAT of the autopilot's component; return whether it is the chosen one's."""
        _, mav_type, autopilot, base_mode, _, _ = _heartbeat(frame)
        if autopilot == common.MAV_AUTOPILOT_INVALID or mav_type in _NO_VEHICLES:
            return False
        fits = identified(autopilot, mav_type) is self.kind
        heard = (self._fitting if fits else self._others).setdefault(
            frame.system, _Heard(autopilot, mav_type, now_s, now_s)
        )
        if not heard.is_present(now_s):
            heard.first_s, heard.times = now_s, 0
        heard.autopilot, heard.mav_type, heard.last_s, heard.times = autopilot, mav_type, now_s, heard.times + 1
        heard.armed = bool(base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED)
        if fits and self.chosen is None:
            self._choose(now_s)
        if not fits or frame.system != self.chosen:
            return False
        if not base_mode & common.MAV_MODE_FLAG_SAFETY_ARMED:
            self._armed_since_s = None
        elif self._armed_since_s is None:
            self._armed_since_s = now_s
        return True

    def rivals(self, now_s: float) -> list[int]:
        """Return the ids of the fitting autopilots beside which the chosen one is not sure to be this vehicle's own.

        Of those that came while it was armed none is: it flies, and what comes near it later changes nothing.
        """
        if self.system_id is not None:
            return []
        armed_since_s = math.inf if self._armed_since_s is None else self._armed_since_s
        present = [one for one, heard in self._fitting.items() if heard.is_present(now_s)]
        rivals = [one for one in present if one != self.chosen and self._fitting[one].first_s <= armed_since_s]
        return sorted({*rivals, *([] if self.chosen is None else [self.chosen])}) if rivals else []

    def beside(self, now_s: float) -> str | None:
        """Return which other autopilots are on the link, in words; None if there are none."""
        there = sorted((self._fitting | self._others).items())
        words = [
            f"system {one}{' (armed)' if heard.armed else ''}"
            for one, heard in there
            if one != self.chosen and heard.is_present(now_s)
        ]
        return ", ".join(words) or None

    def refusal(self, now_s: float) -> str | None:
        """Return why none is steered, and the remedy; None if one is chosen, or none was heard."""
        rivals = self.rivals(now_s)
        if len(rivals) > 1:
            named = ", ".join(map(str, rivals))
            return f"several autopilots are heard, systems {named}: set autopilot.system_id to this vehicle's own"
        if self.chosen is not None:
            return None
        present = {one: heard for one, heard in self._fitting.items() if heard.is_present(now_s)}
        others = {one: heard for one, heard in self._others.items() if heard.is_present(now_s)}
        if self.system_id in others or (self.system_id is None and others and not present):
            heard = others.get(self.system_id or 0) or next(iter(others.values()))
            return _of_another_kind(heard, self.kind)
        if self.system_id is None or not present | others:
            return None
        foreign = ", ".join(map(str, sorted(present | others)))
        return (
            f"heard system {foreign}, configured autopilot.system_id {self.system_id}: "
            "correct it, or the vehicle's own id"
        )

    def _choose(self, now_s: float) -> None:
        """Choose the configured system, or the only one that is there after a time of listening."""
        if self.system_id is not None:
            self.chosen = self.system_id if self.system_id in self._fitting else None
            return
        present = {one: heard for one, heard in self._fitting.items() if heard.is_present(now_s)}
        if len(present) == 1:
            ((one, heard),) = present.items()
            self.chosen = one if now_s - heard.first_s >= CHOOSE_AFTER_S else None


class Identity:
    """Judges every frame on the link of one autopilot."""

    def __init__(self, kind: HeartbeatIdentity, system_id: int | None, rejected: Counter[str]) -> None:
        """Listen to an autopilot of this kind, with this system id if one is given; count what is not it by reason."""
        self.rejected = rejected
        self._systems = Systems(kind, system_id)
        self._clock = BootClock()
        self._order = FrameOrder()
        self._components: dict[int, FrameOrder] = {}
        self._newest_ms: dict[int, tuple[int, bytes]] = {}
        self._restarts = 0
        self._now_s = -math.inf

    @property
    def system_id(self) -> int | None:
        """The system id of the autopilot; None until it is chosen."""
        return self._systems.chosen

    @property
    def restarts(self) -> int:
        """Number of times that the autopilot's clock began anew."""
        return self._clock.restarts

    @property
    def beside(self) -> str | None:
        """Which other autopilots are on the link, in words; None if there are none."""
        return self._systems.beside(self._now_s)

    @property
    def refusal(self) -> str | None:
        """Why the autopilot is not steered, and the remedy; None if nothing speaks against it."""
        if self._now_s - self._clock.two.noticed_s <= SHARED_MEMORY_S:
            return (
                f"two autopilots say they are system {self.system_id}: give each a system id of its own "
                "(ArduPilot: SYSID_THISMAV or MAV_SYSID, PX4: MAV_SYS_ID)"
            )
        return self._systems.refusal(self._now_s)

    def take(self, frame: RawFrame, now_s: float) -> Verdict:
        """Judge a whole frame whose CRC is right."""
        self._now_s = now_s
        verdict = self._judged(frame, now_s)
        if verdict.reason is not None:
            self.rejected[verdict.reason] += 1
        return verdict

    def _judged(self, frame: RawFrame, now_s: float) -> Verdict:
        is_heartbeat = frame.message_id == common.MAVLINK_MSG_ID_HEARTBEAT
        is_autopilot = frame.component == AUTOPILOT_COMPONENT
        if is_heartbeat and (not is_autopilot or not self._systems.hear(frame, now_s)):
            if frame.system != self.system_id:
                return Verdict("other system")
            return Verdict("other type" if is_autopilot else "other component")
        if frame.system != self.system_id:
            return Verdict("other system")
        if is_autopilot:
            return self._timed(frame, now_s) if frame.message_id in _TIMED else self._untimed(self._order, frame, now_s)
        if frame.message_id != common.MAVLINK_MSG_ID_ADSB_VEHICLE:
            return Verdict("other component")
        # The detector on the vehicle may send them itself, with numbers of its own.
        if frame.component not in self._components and len(self._components) >= MAX_COMPONENTS:
            return Verdict("other component")
        return self._untimed(self._components.setdefault(frame.component, FrameOrder()), frame, now_s)

    def _timed(self, frame: RawFrame, now_s: float) -> Verdict:
        """Judge a frame by the autopilot's clock; each kind of message has its own newest time."""
        boot_ms, lat_e7, lon_e7 = _PLACE.unpack_from(frame.payload.ljust(_PLACE.size, b"\0"))
        clocked = self._clock.take(boot_ms, now_s)
        if clocked in (Clocked.UNCONFIRMED, Clocked.BEFORE):
            return Verdict(clocked.value)
        if self._clock.restarts != self._restarts:
            self._restarts = self._clock.restarts
            self._newest_ms.clear()
            self._order.restart()
        if clocked is Clocked.NEWER:
            self._order.anchor(_number(frame), now_s)
        is_place = frame.message_id == common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
        late_by_s = self._clock.late_by_s(boot_ms)
        newest = self._newest_ms.get(frame.message_id)
        if newest is not None and self._clock.late_by_s(newest[0]) <= late_by_s:
            if frame.data == newest[1]:
                return Verdict(DUPLICATE)
            if is_place:
                self._clock.compare_place(boot_ms, lat_e7, lon_e7, now_s)
            return Verdict(STANDS_STILL if boot_ms == newest[0] else LATE)
        self._newest_ms[frame.message_id] = boot_ms, frame.data
        if is_place:
            self._clock.note_place(boot_ms, lat_e7, lon_e7, now_s)
        return Verdict(None, now_s - late_by_s)

    def _untimed(self, order: FrameOrder, frame: RawFrame, now_s: float) -> Verdict:
        """Judge a frame by its number and content."""
        payload = frame.payload
        about = _KEYS.get(frame.message_id)
        key = frame.message_id if about is None else (frame.message_id, payload[about])
        reason, late_by_s = order.take(_number(frame), key, payload, frame.data, now_s)
        return Verdict(reason, now_s - late_by_s)


def _number(frame: RawFrame) -> int:
    """Return MAVLink's sequence number of a frame."""
    return frame.data[SEQUENCE_AT if frame.version == 2 else SEQUENCE_V1_AT]


def _heartbeat(frame: RawFrame) -> tuple[int, ...]:
    """Return custom mode, type, autopilot, base mode, state and version of a HEARTBEAT."""
    return _HEARTBEAT.unpack_from(frame.payload.ljust(_HEARTBEAT.size, b"\0"))


def _of_another_kind(heard: _Heard, kind: HeartbeatIdentity) -> str:
    """Return in words that an autopilot is of another kind than the configured one, and the remedy."""
    words = _AUTOPILOTS.get(heard.autopilot, f"autopilot {heard.autopilot}")
    other = identified(heard.autopilot, heard.mav_type)
    remedy = "this vehicle cannot be steered" if other is None else f"set autopilot.kind to {other.kind.name}"
    return f"heard {words} of MAV_TYPE {heard.mav_type}, configured autopilot.kind {kind.kind.name}: {remedy}"
