"""A stand-in autopilot's side of MAVLink's parameter protocol, and parameters that a user sets before a flight."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from pymavlink.dialects.v20 import common as mavlink

from companion.errors import InputError, nearest_hint
from sim.mavlink_sender import MavlinkSender
from sim.vehicles.craft import Craft, Message, Parameter
from sim.vehicles.named import Named

if TYPE_CHECKING:
    from sim.vehicles.stand_in import StandIn


def set_parameters(vehicle: StandIn, parameters: Iterable[tuple[str, float]]) -> None:
    """Set parameters by name, as `--param` names them.

    Raises:
        InputError: a name that the vehicle's firmware does not have, or a value out of its range.

    """
    known = vehicle.named
    for name, value in parameters:
        if name not in known:
            raise InputError(f"--param: unknown '{name}'{nearest_hint(name, known)}; allowed: {', '.join(known)}")
        least, greatest = known[name].parameter.least, known[name].parameter.greatest
        if not least <= value <= greatest:
            raise InputError(f"--param: {name}={value:g}; allowed: {least:g} to {greatest:g}")
        known[name].set(vehicle.parameters, value)


class ParameterProtocol:
    """Reads and sets a craft's parameters on request, and answers with PARAM_VALUE."""

    def __init__(self, craft: Craft, named: Mapping[str, Named], sender: MavlinkSender) -> None:
        """Serve the parameters of `craft` by their names on the wire, with replies packed by `sender`."""
        self._craft = craft
        self._sender = sender
        self._named = named
        self._order = list(named)

    def on_param_set(self, message: Message, t_s: float) -> list[bytes]:
        """Set a parameter and return its PARAM_VALUE; a value out of range is refused, and the old one is returned."""
        named = self._named.get(message.param_id)
        if named is None:
            return []
        value = message.param_value
        if self._is_bytewise(named.parameter):
            value = float(struct.unpack("<i", struct.pack("<f", value))[0])
        if named.parameter.least <= value <= named.parameter.greatest:
            named.set(self._craft.values, value)
        return [self._param_value(named.parameter.name)]

    def on_param_request_read(self, message: Message, t_s: float) -> list[bytes]:
        """Return the PARAM_VALUE of the parameter with the requested index or name; nothing if there is none."""
        name = message.param_id
        if 0 <= message.param_index < len(self._order):
            name = self._order[message.param_index]
        return [self._param_value(name)] if name in self._named else []

    def on_param_request_list(self, message: Message, t_s: float) -> list[bytes]:
        """Return the PARAM_VALUE of every parameter."""
        return [self._param_value(name) for name in self._order]

    def _is_bytewise(self, parameter: Parameter) -> bool:
        """Return whether the float field holds the bytes of an integer: only in PX4; ArduPilot sends floats alone."""
        return parameter.integer and self._craft.mav_autopilot == mavlink.MAV_AUTOPILOT_PX4

    def _param_value(self, name: str) -> bytes:
        named = self._named[name]
        value, kind = named.value(self._craft.values), mavlink.MAV_PARAM_TYPE_REAL32
        if self._is_bytewise(named.parameter):
            value, kind = struct.unpack("<f", struct.pack("<i", round(value)))[0], mavlink.MAV_PARAM_TYPE_INT32
        order = self._order
        message = self._sender.mav.param_value_encode(name.encode(), value, kind, len(order), order.index(name))
        return self._sender.pack(message)
