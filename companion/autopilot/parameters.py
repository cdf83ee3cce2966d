"""The autopilot's parameters: requested by name, a few at a time, and decoded in ArduPilot's or PX4's encoding.

They decide what the vehicle can do, and what it does when its companion dies. An autopilot may not answer: parameter
names differ between versions, and a request may be lost.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from pymavlink.dialects.v20 import common

from companion.autopilot.intake import Message
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
    least: float = -math.inf
    greatest: float = math.inf
    """The sane values, in the unit of `name`: a value outside is told to the person and never reckoned with."""
    optional: bool = False
    """Whether only some vehicles have it: nobody waits for it, and a vehicle that does not tell it lacks it."""
    switch: str | None = None
    """First name of another parameter: while that is 0, or not told, the vehicle has not this one."""

    @property
    def names(self) -> tuple[str, ...]:
        """All names of the parameter, the first name first."""
        return (self.name, *(name for name, _ in self.others))

    def is_sane(self, value: float) -> bool:
        """Return whether a value, in the unit of `name`, is one that a vehicle can have."""
        return math.isfinite(value) and self.least <= value <= self.greatest


class Told(NamedTuple):
    """A parameter as one vehicle calls it."""

    name: str
    """Its name in the vehicle's firmware."""
    value: float
    """Its value in the unit of that name."""
    factor: float
    """Factor that converts the value to the unit of the first name in `Wanted`."""

    def __str__(self) -> str:
        """Return name and value, as messages say them."""
        return f"{self.name} {self.value:g}"

    def in_its_unit(self, value: float) -> float:
        """Return in the unit of this name a value given in the unit of the first name."""
        return value / self.factor


class ParameterReader:
    """Requests parameters and stores their values. Times are the caller's, in seconds of one clock."""

    def __init__(self, wanted: Iterable[Wanted], bytewise: bool) -> None:
        """Read the wanted parameters; `bytewise` is true for PX4, which writes integers bytewise into the float."""
        self._wanted = {one.name: one for one in wanted}
        self._bytewise = bytewise
        self._meanings = {one.name: (one.name, 1.0) for one in self._wanted.values()}
        for one in self._wanted.values():
            self._meanings.update({name: (one.name, factor) for name, factor in one.others})
        self._demanded = tuple(one.name for one in self._wanted.values() if not one.optional)
        self._told: dict[str, Told] = {}
        self._insane: dict[str, str] = {}
        self._tries = dict.fromkeys(self._wanted, 0)
        self._answered: set[str] = set()
        self._asked_s: dict[str, float] = {}
        self._next_s = -math.inf
        self._given_up = False

    def add(self, wanted: Iterable[Wanted]) -> None:
        """Read these parameters, too; one that is read already stays as it is."""
        for one in wanted:
            if one.name not in self._wanted:
                self._wanted[one.name] = one
                self._meanings |= {one.name: (one.name, 1.0)} | {name: (one.name, by) for name, by in one.others}
                self._tries[one.name] = 0

    def settled(self, now_s: float) -> bool:
        """Return whether each parameter, also those that only some vehicles have, was received or asked for in vain."""
        return all(self._spent(name, now_s) for name in self._wanted)

    @property
    def values(self) -> Mapping[str, float]:
        """The finite values that the autopilot sent, by the first name of each parameter and in that name's unit."""
        return {name: told.value * told.factor for name, told in self._told.items()}

    @property
    def all_known(self) -> bool:
        """Whether each parameter that is not optional was received, or requested TRIES times in vain."""
        return self._given_up or all(name in self._told for name in self._demanded)

    @property
    def assumed(self) -> tuple[str, ...]:
        """The first names of the parameters that are not optional and that the autopilot has not sent."""
        return tuple(name for name in self._demanded if name not in self._told)

    @property
    def insane(self) -> tuple[str, ...]:
        """What is wrong with the values that no vehicle can have, one sentence each, by the name that was heard."""
        return tuple(self._insane.values())

    def value(self, name: str) -> float:
        """Return a parameter's value by its first name; its default if it was not received or is not sane."""
        one = self._wanted[name]
        told = self._told.get(name)
        value = one.default if told is None else told.value * told.factor
        return value if one.is_sane(value) else one.default

    def heard(self, name: str) -> bool:
        """Return whether the autopilot sent a sane value of a parameter, by its first name."""
        return name in self._told and name not in self._insane

    def names_of(self, name: str) -> tuple[Told, ...]:
        """Return a parameter, by its first name, as each version calls it, with its default in that version's unit."""
        one = self._wanted[name]
        return (Told(name, one.default, 1.0), *(Told(other, one.default / by, by) for other, by in one.others))

    def told_as(self, name: str) -> Told:
        """Return a parameter, by its first name, as the vehicle calls it; as its first name if it was not received."""
        return self._told.get(name) or Told(name, self._wanted[name].default, 1.0)

    def restart(self) -> None:
        """Request all parameters again after the autopilot has restarted; earlier values are used until it answers."""
        self._tries = dict.fromkeys(self._wanted, 0)
        self._answered.clear()
        self._asked_s.clear()

    def take(self, message: Message) -> None:
        """Store a PARAM_VALUE, requested or not."""
        heard = message.param_id.rstrip("\0")
        if heard in self._meanings:
            self.tell(heard, _value(message, self._bytewise))

    def tell(self, heard: str, value: float) -> None:
        """Store a value by one of a parameter's names; an unknown one is ignored, a value that is not sane is named."""
        name, factor = self._meanings.get(heard, (None, 0.0))
        if name is None:
            return
        one = self._wanted[name]
        self._insane.pop(name, None)
        if not one.is_sane(value * factor) and (one.least, one.greatest) != (-math.inf, math.inf):
            sane = f"{one.least / factor:g} to {one.greatest / factor:g}"
            self._insane[name] = f"{heard} {value:g} is not a sane value ({sane})"
        if math.isfinite(value):
            self._told[name] = Told(heard, value, factor)
            self._answered.add(name)

    def due(self, now_s: float) -> list[str]:
        """Return the names to request now, all names of each parameter that is due."""
        if now_s < self._next_s:
            return []
        self._given_up = self._given_up or all(self._spent(name, now_s) for name in self._demanded)
        waiting = [one for one in self._wanted.values() if self._may_ask(one.name, now_s)][:REQUESTS_AT_ONCE]
        for one in waiting:
            self._tries[one.name] += 1
            self._asked_s[one.name] = now_s
        if waiting:
            self._next_s = now_s + REQUESTS_PERIOD_S
        return [name for one in waiting for name in one.names]

    def _may_ask(self, name: str, now_s: float) -> bool:
        return (
            name not in self._answered
            and not self._is_off(name)
            and self._tries[name] < TRIES
            and self._waited(name, now_s)
        )

    def _spent(self, name: str, now_s: float) -> bool:
        switch = self._wanted[name].switch
        if switch is not None and self._is_off(name):
            return self._spent(switch, now_s)
        return name in self._answered or (self._tries[name] >= TRIES and self._waited(name, now_s))

    def _is_off(self, name: str) -> bool:
        switch = self._wanted[name].switch
        return switch is not None and (switch not in self._told or self._told[switch].value == 0.0)

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
