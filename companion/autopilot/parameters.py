"""The autopilot's parameters: asked for by name, a few at a time, and read in either of the ways they travel.

What a vehicle can do, and what it does when its companion dies, rests on them. An autopilot need not answer: names come
and go with its versions, and a request may be lost.
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
RETRY_S = 1.0
REQUESTS_AT_ONCE = 2
REQUESTS_PERIOD_S = 0.2
"""At most REQUESTS_AT_ONCE requests in this time: a telemetry radio has other things to carry."""
_NAME_BYTES = 16
_INTEGERS = {
    common.MAV_PARAM_TYPE_UINT8: "<B3x",
    common.MAV_PARAM_TYPE_INT8: "<b3x",
    common.MAV_PARAM_TYPE_UINT16: "<H2x",
    common.MAV_PARAM_TYPE_INT16: "<h2x",
    common.MAV_PARAM_TYPE_UINT32: "<I",
    common.MAV_PARAM_TYPE_INT32: "<i",
}
"""How PX4 writes an integer into the four bytes of the float."""


@dataclass(frozen=True)
class Wanted:
    """A parameter worth asking for, with the value that the autopilot's makers document as its default."""

    name: str
    default: float
    others: tuple[tuple[str, float], ...] = ()
    """What other versions call it, and by what their value is multiplied to mean the same."""

    @property
    def names(self) -> tuple[str, ...]:
        """Every name of it."""
        return (self.name, *(name for name, _ in self.others))


class ParameterReader:
    """Asks for parameters and keeps their values. Times are given by the caller."""

    def __init__(self, wanted: Iterable[Wanted], bytewise: bool) -> None:
        """Read these; `bytewise` for an autopilot that writes integers bytewise into the float (PX4)."""
        self._wanted = tuple(wanted)
        self._bytewise = bytewise
        self._meanings = {one.name: (one.name, 1.0) for one in self._wanted}
        for one in self._wanted:
            self._meanings.update({name: (one.name, factor) for name, factor in one.others})
        self._defaults = {one.name: one.default for one in self._wanted}
        self._told: dict[str, float] = {}
        self._tries = dict.fromkeys(self._defaults, 0)
        self._answered: set[str] = set()
        self._asked_s: dict[str, float] = {}
        self._next_s = -math.inf
        self._given_up = False

    @property
    def values(self) -> Mapping[str, float]:
        """What the autopilot told, by the first name of each."""
        return self._told

    @property
    def all_known(self) -> bool:
        """Whether each was told, or asked for in vain as often as it is worth."""
        return self._given_up or len(self._told) == len(self._defaults)

    @property
    def assumed(self) -> tuple[str, ...]:
        """Those that the autopilot did not tell."""
        return tuple(name for name in self._defaults if name not in self._told)

    def value(self, name: str) -> float:
        """Return a parameter as told, or its documented default."""
        return self._told.get(name, self._defaults[name])

    def restart(self) -> None:
        """Ask for all of them again: the autopilot started anew. What it told before holds until it answers."""
        self._tries = dict.fromkeys(self._defaults, 0)
        self._answered.clear()
        self._asked_s.clear()

    def take(self, message: Message) -> None:
        """Note a PARAM_VALUE, asked for or not; others, and values that are not finite, are ignored."""
        name, factor = self._meanings.get(message.param_id.rstrip("\0"), (None, 0.0))
        value = _value(message, self._bytewise)
        if name is not None and math.isfinite(value):
            self._told[name] = value * factor
            self._answered.add(name)

    def due(self, now_s: float) -> list[str]:
        """Return the names to ask for now."""
        if now_s < self._next_s:
            return []
        self._given_up = self._given_up or all(self._spent(name, now_s) for name in self._defaults)
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
    """Return the request for a parameter by name."""
    return common.MAVLink_param_request_read_message(
        system_id, common.MAV_COMP_ID_AUTOPILOT1, name.encode("ascii")[:_NAME_BYTES], -1
    )


def _value(message: Message, bytewise: bool) -> float:
    form = _INTEGERS.get(message.param_type) if bytewise else None
    if form is None:
        return float(message.param_value)
    # From the bytes as they came: as a float, some integers would be numbers that are none.
    frame = bytes(message.get_msgbuf())
    return float(struct.unpack_from(form, frame, frame_parts(frame)[1])[0])
