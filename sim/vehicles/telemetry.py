"""What a stand-in sends unasked: message streams at their rates, texts, and a heartbeat when its state changes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from sim.mavlink_sender import MavlinkSender
from sim.vehicles.adsb import AdsbReceiver
from sim.vehicles.craft import Craft
from sim.vehicles.messages import MessageEncoder

_DUE_TOLERANCE_S = 1e-6
"""Time by which a message may be early and still counts as due."""
_SHORTEST_INTERVAL_S = 0.02
"""Shortest stream interval that a SET_MESSAGE_INTERVAL can set."""
_PX4_HOME_LATE_S = 0.5
"""Time after which PX4 tells of a home that was set anew (measured: 0.1 to 0.85 s)."""
_TEXT_BYTES = 50
"""Length of the text field of STATUSTEXT."""

DEFAULT_RATES_HZ: Mapping[int, float] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 4.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 4.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 2.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.2,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 0.2,
}
"""Default stream rates, by message id."""

STREAM_GROUPS: Mapping[int, tuple[int, ...]] = {
    mavlink.MAV_DATA_STREAM_EXTENDED_STATUS: (mavlink.MAVLINK_MSG_ID_SYS_STATUS, mavlink.MAVLINK_MSG_ID_GPS_RAW_INT),
    mavlink.MAV_DATA_STREAM_POSITION: (
        mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    ),
    mavlink.MAV_DATA_STREAM_EXTRA1: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
    mavlink.MAV_DATA_STREAM_EXTRA2: (mavlink.MAVLINK_MSG_ID_VFR_HUD,),
    mavlink.MAV_DATA_STREAM_EXTRA3: (mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,),
}
"""Messages of each group whose rate a REQUEST_DATA_STREAM sets, in ArduPilot alone (GCS_Common.cpp)."""

LOCKSTEP_RATES_HZ: Mapping[int, float] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 0.2,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 0.1,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.02,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 2.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 1.0,
}
"""Stream rates in lockstep, by message id: only what a companion needs at a guidance step of 0.5 s, and a log's reader.
More would be slow, as packing messages is most of a step's computing time."""


@dataclass(slots=True)
class _Stream:
    period_s: float
    due_s: float


class Streams:
    """The schedule of the message streams: when each message is due."""

    def __init__(self, rates_hz: Mapping[int, float], start_s: float) -> None:
        """Begin with the default rates, by message id; every message is due at `start_s`."""
        self._default_rates_hz = dict(rates_hz)
        self._streams: dict[int, _Stream] = {}
        self.restart(start_s)

    def restart(self, t_s: float) -> None:
        """Return to the default rates; every message is due at `t_s`."""
        self._streams = {
            message_id: _Stream(1.0 / rate_hz, t_s)
            for message_id, rate_hz in self._default_rates_hz.items()
            if rate_hz > 0.0
        }

    def set_interval(self, message_id: int, interval_us: float, t_s: float) -> None:
        """Set a stream's interval, as SET_MESSAGE_INTERVAL does: 0 restores the default, below 0 ends the stream."""
        rate_hz = 1e6 / interval_us if interval_us > 0.0 else 0.0
        if interval_us == 0.0:
            rate_hz = self._default_rates_hz.get(message_id, 0.0)
        self._streams.pop(message_id, None)
        if rate_hz > 0.0:
            self._streams[message_id] = _Stream(max(1.0 / rate_hz, _SHORTEST_INTERVAL_S), t_s)

    def set_group(self, group: int, rate_hz: float, t_s: float) -> None:
        """Set the rate of a group of streams, as REQUEST_DATA_STREAM does: of all groups for MAV_DATA_STREAM_ALL."""
        whole = group == mavlink.MAV_DATA_STREAM_ALL
        for message_id in [one for key, ids in STREAM_GROUPS.items() if whole or key == group for one in ids]:
            self.set_interval(message_id, 1e6 / rate_hz if rate_hz > 0.0 else -1.0, t_s)

    def make_due(self, message_id: int, t_s: float) -> None:
        """Make a message due at `t_s`, if it is streamed."""
        stream = self._streams.get(message_id)
        if stream is not None:
            stream.due_s = t_s

    def take_due(self, t_s: float, held_back: int | None) -> list[int]:
        """Return the ids of the messages due at `t_s`, except `held_back`, and schedule the next of each."""
        due = []
        horizon_s = t_s + _DUE_TOLERANCE_S
        for message_id, stream in self._streams.items():
            if stream.due_s <= horizon_s and message_id != held_back:
                due.append(message_id)
                stream.due_s += stream.period_s
                if stream.due_s <= t_s:
                    stream.due_s = t_s + stream.period_s
        return due


class Telemetry:
    """The messages that one autopilot sends unasked."""

    def __init__(self, craft: Craft, encoder: MessageEncoder, streams: Streams, sender: MavlinkSender) -> None:
        """Send for `craft` the messages that `encoder` makes, when `streams` has them due, packed by `sender`."""
        self.encoder = encoder
        self.streams = streams
        self.adsb = AdsbReceiver(craft, sender)
        self._craft = craft
        self._sender = sender
        self._silent_until_s = -math.inf

    def is_silent(self, t_s: float) -> bool:
        """Return whether the autopilot is still rebooting, so that it neither sends nor receives."""
        return t_s < self._silent_until_s

    def reboot(self, t_s: float, silent_s: float) -> None:
        """Reboot: nothing is sent for `silent_s`, `time_boot_ms` restarts at 0, the streams at their defaults."""
        self.encoder.boot_s = t_s
        self._silent_until_s = t_s + silent_s
        self.streams.restart(self._silent_until_s)

    def due(self, t_s: float) -> list[bytes]:
        """Return the frames of every text and message that is due at `t_s`."""
        if t_s < self._silent_until_s - _DUE_TOLERANCE_S:
            return []
        frames = [self.text(text, mavlink.MAV_SEVERITY_INFO) for text in self._craft.texts]
        self._craft.texts.clear()
        # There is no home position before the autopilot is ready.
        held_back = None if self._craft.ready else mavlink.MAVLINK_MSG_ID_HOME_POSITION
        for message_id in self.streams.take_due(t_s, held_back):
            if message_id == mavlink.MAVLINK_MSG_ID_GPS2_RAW and not self.encoder.has_second_receiver:
                continue
            if message_id != mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE:
                frames.append(self._sender.pack(self.encoder.encode(message_id, t_s)))
            elif (listed := self.adsb.next_listed(t_s)) is not None:
                frames.append(listed)
        return frames

    def announce_home(self, t_s: float) -> None:
        """Tell a home that was set anew: ArduPilot does so at once, PX4 within a second (measured)."""
        late_s = _PX4_HOME_LATE_S if self._craft.mav_autopilot == mavlink.MAV_AUTOPILOT_PX4 else 0.0
        self.streams.make_due(mavlink.MAVLINK_MSG_ID_HOME_POSITION, t_s + late_s)

    def announce_origin(self, t_s: float) -> None:
        """Tell an origin of the local frame that was set anew, as PX4 does at once (measured)."""
        self.streams.make_due(mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, t_s)

    def streamable(self, message_id: int) -> bool:
        """Return whether a message can be streamed by this autopilot."""
        if message_id == mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE:
            return self._craft.lists_adsb
        return self.encoder.knows(message_id)

    def message(self, message_id: int, t_s: float) -> bytes:
        """Return the frame of the message with this id, as of `t_s`; raise KeyError for an unknown id."""
        return self._sender.pack(self.encoder.encode(message_id, t_s))

    def text(self, text: str, severity: int) -> bytes:
        """Return the frame of a STATUSTEXT; a longer text is cut to 50 bytes."""
        return self._sender.pack(self._sender.mav.statustext_encode(severity, text.encode()[:_TEXT_BYTES]))

    def heartbeat_state(self) -> tuple[int, bool, bool, bool]:
        """Return the state whose change is announced by a HEARTBEAT at once: mode, armed, failsafe, warned."""
        return self._craft.mode, self._craft.armed, self._craft.failsafe, self._craft.warned

    def announce_change(self, before: tuple[int, bool, bool, bool], t_s: float) -> list[bytes]:
        """Return a heartbeat if the state changed since `before`, and make the streamed one due as well.

        The returned one goes to the link that the change came from, the streamed one to all.
        """
        if before == self.heartbeat_state() or not self._craft.announces:
            return []
        self.streams.make_due(mavlink.MAVLINK_MSG_ID_HEARTBEAT, t_s)
        return [self.message(mavlink.MAVLINK_MSG_ID_HEARTBEAT, t_s)]
