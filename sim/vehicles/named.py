"""What a stand-in calls its parameters on the wire: the names, units and further parameters of one firmware's version.

A craft computes with parameters of its own names. Over MAVLink they have those of the firmware that the stand-in says
it is (companion/autopilot/firmware.py), beside the parameters of that firmware that the craft does not compute with:
these only hold their values.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, MutableMapping
from typing import NamedTuple

from companion.autopilot.firmware import FAMILIES, PX4, TABLE, Firmware, in_words, known, versions
from companion.autopilot.registry import ADAPTERS
from companion.errors import InputError
from sim.vehicles.craft import Craft, Parameter

DEFAULT_VERSIONS = {"Copter": (4, 6), "Plane": (4, 6), PX4: (1, 16)}
"""The version that a stand-in says it is, by firmware: the newest that has the names of its craft."""
SIMULATOR_VALUES = {"BATT_MONITOR": 4.0}
"""Values with which the autopilots' own simulators come, where they are other than the firmware's defaults."""
NO_COPTERS = ("FW_",)
"""Beginnings of names that a PX4 copter lacks."""
NO_PLANES = ("MPC_", "SIH_")
"""Beginnings of names that a PX4 plane lacks, or that its craft has otherwise."""
_FURTHER = {
    "TRIM_ARSPD_CM": ("AIRSPEED_CRUISE", 0.01),
    "ALT_HOLD_RTL": ("RTL_ALTITUDE", 0.01),
    "WP_SPD": ("WPNAV_SPEED", 100.0),
}
"""Names that only the stand-ins know: the craft's name, and the factor to its unit."""


class Named(NamedTuple):
    """A parameter on the wire."""

    own: str
    """The craft's name for it."""
    factor: float
    """Factor that converts the wire's value to the craft's."""
    parameter: Parameter
    """Name, default and range on the wire."""

    def value(self, values: Mapping[str, float]) -> float:
        """Return the value on the wire."""
        return values[self.own] / self.factor

    def set(self, values: MutableMapping[str, float], value: float) -> None:
        """Store a value from the wire."""
        values[self.own] = value * self.factor


def firmware_of(kind: str, version: tuple[int, int] | None) -> Firmware | None:
    """Return the firmware of a stand-in; None for the simulator's point, which has none. None as version: the default.

    Raises:
        InputError: the firmware's table has no such version.

    """
    family = FAMILIES.get(kind)
    if family is None:
        if version is not None:
            raise InputError(f"--firmware: {in_words(version)} with {kind}; allowed: none, for it has no firmware")
        return None
    version = version or DEFAULT_VERSIONS[family]
    if version not in versions(family):
        allowed = ", ".join(map(in_words, versions(family)))
        raise InputError(f"--firmware: {in_words(version)} with {kind}; allowed: {allowed}")
    return Firmware(family, version)


def named_parameters(craft: Craft, firmware: Firmware | None) -> dict[str, Named]:
    """Return the parameters of a craft by their names on the wire; those that it lacks are added to its values."""
    other_names = dict(_other_names(craft.kind))
    found = {}
    for parameter in craft.parameters:
        named = _in_its_words(parameter, other_names, craft.kind, firmware)
        if named is not None:
            found[named.parameter.name] = named
    owns = {one.own for one in found.values()} | {parameter.name for parameter in craft.parameters}
    for parameter in _further(craft.kind, firmware):
        if parameter.name not in found and other_names.get(parameter.name, ("",))[0] not in owns:
            craft.values.setdefault(parameter.name, parameter.default)
            found[parameter.name] = Named(parameter.name, 1.0, parameter)
    return found


def _in_its_words(
    parameter: Parameter, other_names: Mapping[str, tuple[str, float]], kind: str, firmware: Firmware | None
) -> Named | None:
    """Return a craft's parameter as a firmware has it; None if that version has none."""
    names = {parameter.name: 1.0} | {other: by for other, (own, by) in other_names.items() if own == parameter.name}
    rows = {name: known(kind, name) for name in names}
    if firmware is None or not any(rows.values()):
        return Named(parameter.name, 1.0, parameter)
    for name, by in names.items():
        row = rows[name]
        if row is not None and row.is_in(firmware):
            bounds = parameter.default / by, parameter.least / by, parameter.greatest / by
            return Named(parameter.name, by, Parameter(name, *bounds, parameter.integer))
    return None


def _other_names(kind: str) -> Iterator[tuple[str, tuple[str, float]]]:
    yield from _FURTHER.items()
    for wanted in getattr(ADAPTERS.get(kind), "wanted", ()):
        yield from ((other, (wanted.name, by)) for other, by in wanted.others)


def _further(kind: str, firmware: Firmware | None) -> Iterator[Parameter]:
    """Yield the parameters of a firmware that a vehicle of this kind has."""
    lacks = NO_COPTERS if kind == "px4-copter" else NO_PLANES if kind == "px4-plane" else ()
    for row in TABLE:
        if firmware is not None and row.is_in(firmware) and not row.name.startswith(lacks or ("\0",)):
            integer = row.family == PX4 and not row.unit
            # A float of 32 bits holds no more.
            least, greatest = max(row.least, -1e9), min(row.greatest, 1e9)
            default = SIMULATOR_VALUES.get(row.name, row.default)
            yield Parameter(row.name, default, least, greatest, integer)


def version_number(firmware: Firmware | None) -> int:
    """Return AUTOPILOT_VERSION's flight_sw_version of a firmware's release; 0 without one."""
    if firmware is None:
        return 0
    (major, minor), official = firmware.version, 255
    return major << 24 | minor << 16 | official
