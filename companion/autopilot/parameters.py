"""The autopilot's parameters: requested by name, a few at a time, and decoded in ArduPilot's or PX4's encoding.

They decide what the vehicle can do, and what it does when its companion dies. An autopilot may not answer: parameter
names differ between versions, and a request may be lost.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from pymavlink.dialects.v20 import common

from companion.autopilot.telemetry import Message
from companion.files.mavlink_layout import frame_parts

TRIES = 5
"""Number of times that a parameter is requested before it counts as unknown."""
RETRY_S = 1.0
"""Time without an answer after which a parameter is requested again."""
REQUESTS_AT_ONCE = 2
"""Greatest number of parameters requested in one REQUESTS_PERIOD_S."""
REQUESTS_PERIOD_S = 0.2
"""Least time between two groups of requests, so that they leave room for other messages on a telemetry radio."""
_NAME_BYTES = 16
"""Size of a parameter's name in MAVLink."""
_INTEGERS = {
    common.MAV_PARAM_TYPE_UINT8: "<B3x",
    common.MAV_PARAM_TYPE_INT8: "<b3x",
    common.MAV_PARAM_TYPE_UINT16: "<H2x",
    common.MAV_PARAM_TYPE_INT16: "<h2x",
    common.MAV_PARAM_TYPE_UINT32: "<I",
    common.MAV_PARAM_TYPE_INT32: "<i",
}
"""Format in which PX4 writes an integer parameter into the four bytes of the message's float, by MAV_PARAM_TYPE."""


@dataclass(frozen=True)
class Wanted:
    """A parameter that the companion requests, with the default value that the autopilot's documentation gives."""

    name: str
    default: float
    others: tuple[tuple[str, float], ...] = ()
    """The parameter's names in other versions, each with the factor that converts its value to that of `name`."""

    optional: bool = False
    """Whether nothing waits for it: not every autopilot of the kind has it."""

    @property
    def names(self) -> tuple[str, ...]:
        """All names of the parameter, the first name first."""
        return (self.name, *(name for name, _ in self.others))


class ParameterReader:
    """Requests parameters and stores their values. Times are the caller's, in seconds of one clock."""

    def __init__(self, wanted: Iterable[Wanted], bytewise: bool) -> None:
        """Read the wanted parameters; `bytewise` is true for PX4, which writes integers bytewise into the float."""
        self._wanted = tuple(wanted)
        self._bytewise = bytewise
        self._meanings = {one.name: (one.name, 1.0) for one in self._wanted}
        for one in self._wanted:
            self._meanings.update({name: (one.name, factor) for name, factor in one.others})
        self._defaults = {one.name: one.default for one in self._wanted}
        self._needed = tuple(one.name for one in self._wanted if not one.optional)
        self._told: dict[str, float] = {}
        self._tries = dict.fromkeys(self._defaults, 0)
        self._answered: set[str] = set()
        self._asked_s: dict[str, float] = {}
        self._next_s = -math.inf
        self._given_up = False

    @property
    def values(self) -> Mapping[str, float]:
        """The values that the autopilot sent, by the first name of each parameter."""
        return self._told

    @property
    def all_known(self) -> bool:
        """Whether each parameter that is not optional was received, or requested TRIES times in vain."""
        return self._given_up or all(name in self._told for name in self._needed)

    @property
    def assumed(self) -> tuple[str, ...]:
        """The first names of the parameters that the autopilot has not sent."""
        return tuple(name for name in self._defaults if name not in self._told)

    def value(self, name: str) -> float:
        """Return the value of a parameter (by its first name) as received, or else its documented default."""
        return self._told.get(name, self._defaults[name])

    def restart(self) -> None:
        """Request all parameters again after the autopilot has restarted; earlier values are used until it answers."""
        self._tries = dict.fromkeys(self._defaults, 0)
        self._answered.clear()
        self._asked_s.clear()

    def take(self, message: Message) -> None:
        """Store a PARAM_VALUE, requested or not; unknown parameters and values that are not finite are ignored."""
        name, factor = self._meanings.get(message.param_id.rstrip("\0"), (None, 0.0))
        value = _value(message, self._bytewise)
        if name is not None and math.isfinite(value):
            self._told[name] = value * factor
            self._answered.add(name)

    def due(self, now_s: float) -> list[str]:
        """Return the names to request now, all names of each parameter that is due."""
        if now_s < self._next_s:
            return []
        self._given_up = self._given_up or all(self._spent(name, now_s) for name in self._needed)
        waiting = [one for one in self._wanted if self._may_ask(one.name, now_s)][:REQUESTS_AT_ONCE]
        for one in waiting:
            self._tries[one.name] += 1
            self._asked_s[one.name] = now_s
        if waiting:
            self._next_s = now_s + REQUESTS_PERIOD_S
        return [name for one in waiting for name in one.names]

    def _may_ask(self, name: str, now_s: float) -> bool:
        return name not in self._answered and self._tries[name] < TRIES and self._waited(name, now_s)

    def _spent(self, name: str, now_s: float) -> bool:
        return name in self._answered or (self._tries[name] >= TRIES and self._waited(name, now_s))

    def _waited(self, name: str, now_s: float) -> bool:
        return now_s - self._asked_s.get(name, -math.inf) >= RETRY_S


def request(name: str, system_id: int) -> common.MAVLink_param_request_read_message:
    """Return the PARAM_REQUEST_READ of a parameter by name."""
    return common.MAVLink_param_request_read_message(
        system_id, common.MAV_COMP_ID_AUTOPILOT1, name.encode("ascii")[:_NAME_BYTES], -1
    )


def _value(message: Message, bytewise: bool) -> float:
    form = _INTEGERS.get(message.param_type) if bytewise else None
    if form is None:
        return float(message.param_value)
    # Read from the received bytes, because as a float some integers would be NaN.
    frame = bytes(message.get_msgbuf())
    return float(struct.unpack_from(form, frame, frame_parts(frame)[1])[0])
