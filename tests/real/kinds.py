"""The kinds of real vehicles that are flown, as data: their programs, their parameters and their pilot's modes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Modes:
    """The custom modes of a firmware; PX4's main mode is in bits 16 to 23, its sub-mode in bits 24 to 31."""

    take_off: int
    wait: int
    """Mode in which the vehicle holds its place at its height, without radio control."""
    guided: int
    return_home: int
    land: int | None
    """None for a vehicle that has no such mode."""

    def name_of(self, mode: int) -> str:
        """Return what a custom mode is called here; its number if it is none of these."""
        named = {number: name.replace("_", " ") for name, number in vars(self).items() if number is not None}
        # GUIDED comes after TAKE OFF, which it is the same as on ArduCopter.
        return named.get(mode, str(mode))


_PX4_AUTO = 4 << 16
_COPTER = Modes(take_off=4, wait=17, guided=4, return_home=6, land=9)
"""GUIDED, BRAKE, GUIDED, RTL, LAND: LOITER without sticks sinks (docs/autopilots.md)."""
_PLANE = Modes(take_off=13, wait=12, guided=15, return_home=11, land=None)
"""TAKEOFF, LOITER, GUIDED, RTL."""
_PX4 = Modes(
    take_off=_PX4_AUTO | 2 << 24,
    wait=_PX4_AUTO | 3 << 24,
    guided=6 << 16,
    return_home=_PX4_AUTO | 5 << 24,
    land=_PX4_AUTO | 6 << 24,
)
"""AUTO.TAKEOFF, HOLD, OFFBOARD, RTL, LAND."""


@dataclass(frozen=True)
class Kind:
    """One kind of real vehicle."""

    name: str
    """The companion's name of the kind of autopilot, which is also that of the stand-in and of the configuration."""
    firmware: str
    """`ArduPilot` or `PX4`."""
    model: str
    """What the firmware's simulator flies."""
    modes: Modes
    speed_m_s: float
    """Cruise speed of the missions."""
    height_m: float
    """Height above home at which they are flown."""
    can_stop: bool
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Parameters at its start: what `companion check` demands, and what a flight without radio control needs."""
    config: Mapping[str, Any] = field(default_factory=dict)
    """Keys of the companion's configuration that are this vehicle's own."""
    stand_in: Mapping[str, float] = field(default_factory=dict)
    """Parameters that make the stand-in the same vehicle."""
    note: str = ""
    """What sets it apart from others of its kind, for tables."""

    @property
    def title(self) -> str:
        """Name in tables."""
        return f"{self.name} {self.note}".strip()


_PX4_DEMANDS = {"COM_OBL_RC_ACT": 5, "COM_OF_LOSS_T": 1, "NAV_DLL_ACT": 0, "COM_RC_IN_MODE": 4}
_QUAD = {**_PX4_DEMANDS, "MIS_TAKEOFF_ALT": 30}
# PX4 does not tell how fast it can be: m g tan(45 degrees) / SIH_KDV is 9.8 m/s as it comes, 49 with low drag.
KINDS = {
    "arducopter": Kind(
        "arducopter", "ArduPilot", "copter", _COPTER, 8.0, 30.0, True,
        {"GUID_TIMEOUT": 1, "FS_GCS_ENABLE": 0, "SIM_WIND_T": 1},
    ),
    "arduplane": Kind(
        "arduplane", "ArduPilot", "plane", _PLANE, 22.0, 80.0, False,
        {"TKOFF_ALT": 80, "FS_GCS_ENABL": 0, "SIM_WIND_T": 1},
    ),
    "px4-copter": Kind(
        "px4-copter", "PX4", "sihsim_quadx", _PX4, 8.0, 30.0, True, _QUAD,
        {"limits": {"airspeed_max_m_s": 9.8}}, {"SIH_KDV": 1}, "SIH_KDV 1",
    ),
    "px4-copter-low-drag": Kind(
        "px4-copter", "PX4", "sihsim_quadx", _PX4, 8.0, 30.0, True, {**_QUAD, "SIH_KDV": 0.2},
        {"limits": {"airspeed_max_m_s": 20}},
        stand_in={"SIH_KDV": 0.2}, note="SIH_KDV 0.2",
    ),
    "px4-plane": Kind(
        "px4-plane", "PX4", "sihsim_airplane", _PX4, 15.0, 80.0, False, {**_PX4_DEMANDS, "MIS_TAKEOFF_ALT": 80}
    ),
}  # fmt: skip
"""The kinds by the name under which the lane flies them."""
