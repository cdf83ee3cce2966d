"""A stand-in autopilot's side of MAVLink's parameter protocol, and parameters that a user sets before a flight."""

from __future__ import annotations

import struct
from collections.abc import Iterable

from pymavlink.dialects.v20 import common as mavlink

from companion.errors import InputError, nearest_hint
from sim.mavlink_sender import MavlinkSender
from sim.vehicles.craft import Craft, Message, Parameter


def set_parameters(craft: Craft, parameters: Iterable[tuple[str, float]]) -> None:
    """Set parameters by name, as `--param` names them.

    Raises:
        InputError: a name that the kind does not have, or a value out of its range.

    """
    known = {parameter.name: parameter for parameter in craft.parameters}
    for name, value in parameters:
        if name not in known:
            raise InputError(f"--param: unknown '{name}'{nearest_hint(name, known)}; allowed: {', '.join(known)}")
        least, greatest = known[name].least, known[name].greatest
        if not least <= value <= greatest:
            raise InputError(f"--param: {name}={value:g}; allowed: {least:g} to {greatest:g}")
        craft.values[name] = value


class ParameterProtocol:
    """Reads and sets a craft's parameters on request, and answers with PARAM_VALUE."""

    def __init__(self, craft: Craft, sender: MavlinkSender) -> None:
        """Serve the parameters of `craft`, with replies packed by `sender`."""
        self._craft = craft
        self._sender = sender
        self._ranges = {parameter.name: parameter for parameter in craft.parameters}

    def on_param_set(self, message: Message, t_s: float) -> list[bytes]:
        """Set a parameter and return its PARAM_VALUE; a value out of range is refused, and the old one is returned."""
        allowed = self._ranges.get(message.param_id)
        if allowed is None:
            return []
        value = message.param_value
        if self._is_bytewise(allowed):
            value = float(struct.unpack("<i", struct.pack("<f", value))[0])
        if allowed.least <= value <= allowed.greatest:
            self._craft.values[allowed.name] = value
        return [self._param_value(allowed.name)]

    def on_param_request_read(self, message: Message, t_s: float) -> list[bytes]:
        """Return the PARAM_VALUE of the parameter with the requested index or name; nothing if there is none."""
        names = list(self._craft.values)
        name = message.param_id
        if 0 <= message.param_index < len(names):
            name = names[message.param_index]
        return [self._param_value(name)] if name in self._craft.values else []

    def on_param_request_list(self, message: Message, t_s: float) -> list[bytes]:
        """Return the PARAM_VALUE of every parameter."""
        return [self._param_value(name) for name in self._craft.values]

    def _is_bytewise(self, parameter: Parameter) -> bool:
        """Return whether the float field holds the bytes of an integer: only in PX4; ArduPilot sends floats alone."""
        return parameter.integer and self._craft.mav_autopilot == mavlink.MAV_AUTOPILOT_PX4

    def _param_value(self, name: str) -> bytes:
        names = list(self._craft.values)
        value, kind = self._craft.values[name], mavlink.MAV_PARAM_TYPE_REAL32
        if self._is_bytewise(self._ranges[name]):
            value, kind = struct.unpack("<f", struct.pack("<i", round(value)))[0], mavlink.MAV_PARAM_TYPE_INT32
        message = self._sender.mav.param_value_encode(name.encode(), value, kind, len(names), names.index(name))
        return self._sender.pack(message)
