"""What a stand-in autopilot sends by itself: streams at their rates, texts, and a heartbeat where something changed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import common as mavlink

from sim.mavlink_sender import MavlinkSender
from sim.vehicles.craft import Craft
from sim.vehicles.messages import MessageEncoder

_DUE_TOLERANCE_S = 1e-6
_SHORTEST_INTERVAL_S = 0.02
_TEXT_BYTES = 50

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
"""What is streamed unless the owner or a SET_MESSAGE_INTERVAL says otherwise, by message id."""

LOCKSTEP_RATES_HZ: Mapping[int, float] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 0.2,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 0.1,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.02,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 2.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 1.0,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 1.0,
}
"""What a companion lives on at a guidance step of 0.5 s and a log is read by: packing is most of a step's cost."""


@dataclass(slots=True)
class _Stream:
    period_s: float
    due_s: float


class Streams:
    """When each message is due."""

    def __init__(self, rates_hz: Mapping[int, float], start_s: float) -> None:
        """Begin with the default rates, by message id; everything is due at `start_s`."""
        self._default_rates_hz = dict(rates_hz)
        self._streams: dict[int, _Stream] = {}
        self.restart(start_s)

    def restart(self, t_s: float) -> None:
        """Forget what was asked for; everything is due at a time."""
        self._streams = {
            message_id: _Stream(1.0 / rate_hz, t_s)
            for message_id, rate_hz in self._default_rates_hz.items()
            if rate_hz > 0.0
        }

    def set_interval(self, message_id: int, interval_us: float, t_s: float) -> None:
        """Obey a SET_MESSAGE_INTERVAL: 0 is the default rate, a negative interval ends the stream."""
        rate_hz = 1e6 / interval_us if interval_us > 0.0 else 0.0
        if interval_us == 0.0:
            rate_hz = self._default_rates_hz.get(message_id, 0.0)
        self._streams.pop(message_id, None)
        if rate_hz > 0.0:
            self._streams[message_id] = _Stream(max(1.0 / rate_hz, _SHORTEST_INTERVAL_S), t_s)

    def make_due(self, message_id: int, t_s: float) -> None:
        """Let a message be due at a time, if it is streamed at all."""
        stream = self._streams.get(message_id)
        if stream is not None:
            stream.due_s = t_s

    def take_due(self, t_s: float, held_back: int | None) -> list[int]:
        """Return the messages that are due, but for one that is held back, and take them as sent."""
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
    """One autopilot's own words."""

    def __init__(self, craft: Craft, encoder: MessageEncoder, streams: Streams, sender: MavlinkSender) -> None:
        """Speak for a craft."""
        self.encoder = encoder
        self.streams = streams
        self._craft = craft
        self._sender = sender
        self._silent_until_s = -math.inf

    def is_silent(self, t_s: float) -> bool:
        """Return whether the autopilot is still starting and neither hears nor says anything."""
        return t_s < self._silent_until_s

    def reboot(self, t_s: float, silent_s: float) -> None:
        """Begin anew at a time, after a while without a word, the clock from 0."""
        self.encoder.boot_s = t_s
        self._silent_until_s = t_s + silent_s
        self.streams.restart(self._silent_until_s)

    def due(self, t_s: float) -> list[bytes]:
        """Return every frame that is due at `t_s`."""
        if t_s < self._silent_until_s - _DUE_TOLERANCE_S:
            return []
        frames = [self.text(text, mavlink.MAV_SEVERITY_INFO) for text in self._craft.texts]
        self._craft.texts.clear()
        # There is no home before the autopilot has come up.
        held_back = None if self._craft.ready else mavlink.MAVLINK_MSG_ID_HOME_POSITION
        pack, encode = self._sender.pack, self.encoder.encode
        frames += [pack(encode(message_id, t_s)) for message_id in self.streams.take_due(t_s, held_back)]
        return frames

    def message(self, message_id: int, t_s: float) -> bytes:
        """Return a message as of a time; KeyError for one that the autopilot does not know."""
        return self._sender.pack(self.encoder.encode(message_id, t_s))

    def text(self, text: str, severity: int) -> bytes:
        """Return a STATUSTEXT."""
        return self._sender.pack(self._sender.mav.statustext_encode(severity, text.encode()[:_TEXT_BYTES]))

    def heartbeat_state(self) -> tuple[int, bool, bool]:
        """Return what a HEARTBEAT is sent for at once where it changes: mode, arming, failsafe."""
        return self._craft.mode, self._craft.armed, self._craft.failsafe

    def announce_change(self, before: tuple[int, bool, bool], t_s: float) -> list[bytes]:
        """Return a heartbeat for whoever changed something, and make one due for everybody else."""
        if before == self.heartbeat_state() or not self._craft.announces:
            return []
        self.streams.make_due(mavlink.MAVLINK_MSG_ID_HEARTBEAT, t_s)
        return [self.message(mavlink.MAVLINK_MSG_ID_HEARTBEAT, t_s)]
