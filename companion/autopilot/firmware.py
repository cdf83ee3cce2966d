"""What each firmware calls the parameters that the companion reads, checks or names, and in which unit: a table.

A remedy in another firmware's words is dangerous: WPNAV_ACCEL 250 is 2.5 m/s^2, and WP_ACC 250 would be a hundred times
that. docs/parameters.md is written from this table.

What it rests on. ArduPilot 4.3 to 4.7: names, units and ranges were read in its public parameter reference
(github.com/ArduPilot/ParameterRepository, Copter, Plane and Rover; Rover has no 4.3 of its own there, and its 4.2 and
4.4 are alike), as 4.7 has them; what it comes with is from memory, and agrees with what the simulators of Copter and
Plane 4.7.0-dev told, but for what their vehicles set themselves. That 4.7.0-dev still had WPNAV_ACCEL and ANGLE_MAX.
PX4: the COM and NAV rows but NAV_TRAFF_AVOID were read in commander_params.c of 1.15.2. Every name but COM_OBL_ACT is
one that the simulators of PX4 1.16.1 told, with this value but for what their vehicles set themselves; the ranges of
the other rows and what 1.13, 1.14 and 1.17 have were not read in a source. Where versions differ in the range alone,
the widest stands here. The rows of FENCE_AUTOENABLE, BATT2_ and AFS_ are from memory, not read in a source.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import NamedTuple

Version = tuple[int, int]
"""Major and minor number of a firmware."""
ARDUPILOT_VERSIONS: tuple[Version, ...] = ((4, 3), (4, 4), (4, 5), (4, 6), (4, 7))
"""The versions of ArduPilot that the table covers."""
PX4_VERSIONS: tuple[Version, ...] = ((1, 13), (1, 14), (1, 15), (1, 16), (1, 17))
"""The versions of PX4 that the table covers."""
PX4 = "PX4"
FAMILIES = {
    "arducopter": "Copter",
    "arduplane": "Plane",
    "ardurover": "Rover",
    "px4-copter": PX4,
    "px4-plane": PX4,
}
"""The firmware of each kind of autopilot; the simulator's point has none."""


def _batteries(low_volt: float, greatest_action: int) -> str:
    """Return the rows of ArduPilot's two batteries: the voltage that is low, and the greatest number of an action."""
    return "".join(
        f"""
    {battery}_MONITOR - 0 0 32
    {battery}_CAPACITY mAh 3300 - -
    {battery}_LOW_VOLT V {low_volt:g} - -
    {battery}_LOW_MAH mAh 0 - -
    {battery}_FS_LOW_ACT - 0 0 {greatest_action}
    {battery}_CRT_VOLT V 0 - -
    {battery}_CRT_MAH mAh 0 - -
    {battery}_FS_CRT_ACT - 0 0 {greatest_action}
"""
        for battery in ("BATT", "BATT2")
    )


_COPTER = (
    """
    GUID_TIMEOUT s 3 0.1 5
    WPNAV_ACCEL cm/s^2 250 50 500 ..4.6
    WP_ACC m/s^2 2.5 0.5 5 4.7..
    ANGLE_MAX cdeg 3000 1000 8000 ..4.6
    ATC_ANGLE_MAX deg 30 10 80 4.7..
    FS_GCS_ENABLE - 0 0 7
    FS_THR_ENABLE - 1 0 7
    FS_OPTIONS - 16 0 63
    FS_EKF_ACTION - 1 0 3
    FS_EKF_THRESH - 0.8 0 1
    FENCE_ENABLE - 0 0 1
    FENCE_AUTOENABLE - 0 0 3 4.6..
    FENCE_ACTION - 1 0 5
    FENCE_TYPE - 7 0 15
    FENCE_ALT_MAX m 100 10 1000
    FENCE_ALT_MIN m -10 -100 100
    FENCE_RADIUS m 300 30 10000
    FENCE_MARGIN m 2 1 10
"""
    + _batteries(10.5, 7)
    + """
    AFS_ENABLE - 0 0 1
    AFS_TERM_ACTION - 0 - -
    AVD_ENABLE - 0 0 1
    AVD_F_ACTION - 2 0 6
    ADSB_TYPE - 0 0 4
    SYSID_THISMAV - 1 1 255 ..4.6
    MAV_SYSID - 1 1 255 4.7..
"""
)
_PLANE = (
    """
    ROLL_LIMIT_DEG deg 45 0 90 4.5..
    LIM_ROLL_CD cdeg 4500 0 9000 ..4.4
    WP_LOITER_RAD m 60 -32767 32767
    AIRSPEED_MIN m/s 9 5 100 4.5..
    ARSPD_FBW_MIN m/s 9 5 100 ..4.4
    AIRSPEED_MAX m/s 22 5 100 4.5..
    ARSPD_FBW_MAX m/s 22 5 100 ..4.4
    AIRSPEED_CRUISE m/s 12 - - 4.5..
    TRIM_ARSPD_CM cm/s 1200 - - ..4.4
    FS_GCS_ENABL - 0 0 3
    THR_FAILSAFE - 1 0 2
    FS_SHORT_ACTN - 0 0 4
    FS_LONG_ACTN - 0 0 5
    FENCE_ENABLE - 0 0 1
    FENCE_AUTOENABLE - 0 0 3
    FENCE_ACTION - 1 0 8
    FENCE_TYPE - 4 0 15
    FENCE_ALT_MAX m 100 10 1000
    FENCE_ALT_MIN m -10 -100 100
    FENCE_RADIUS m 300 30 10000
    FENCE_MARGIN m 2 1 10
"""
    + _batteries(0, 7)
    + """
    AFS_ENABLE - 0 0 1
    AFS_TERM_ACTION - 0 - -
    AVD_ENABLE - 0 0 1
    AVD_F_ACTION - 2 0 6
    ADSB_TYPE - 0 0 4
    SYSID_THISMAV - 1 1 255 ..4.6
    MAV_SYSID - 1 1 255 4.7..
"""
)
_ROVER = (
    """
    CRUISE_SPEED m/s 2 0 100
    WP_SPEED m/s 2 0 100
    ATC_TURN_MAX_G g 0.6 0.1 10
    ATC_ACCEL_MAX m/s^2 1 0 10
    FS_GCS_ENABLE - 0 0 2
    FS_THR_ENABLE - 1 0 2
    FS_ACTION - 2 0 6
    FS_EKF_ACTION - 1 0 2
    FENCE_ENABLE - 0 0 1
    FENCE_ACTION - 1 0 6
    FENCE_TYPE - 6 0 6
    FENCE_RADIUS m 300 30 10000
    FENCE_MARGIN m 2 1 10
"""
    + _batteries(10.5, 6)
    + """
    AFS_ENABLE - 0 0 1
    AFS_TERM_ACTION - 0 - -
    SYSID_THISMAV - 1 1 255 ..4.6
    MAV_SYSID - 1 1 255 4.7..
"""
)
_PX4 = """
    COM_OF_LOSS_T s 1 0 60
    COM_OBL_RC_ACT - 0 0 7
    COM_OBL_ACT - 0 -1 2 ..1.13
    COM_RC_IN_MODE - 3 0 8
    COM_RCL_EXCEPT - 0 0 31
    NAV_RCL_ACT - 2 0 6
    NAV_DLL_ACT - 0 0 6
    COM_DLL_EXCEPT - 0 0 31 1.16..
    COM_LOW_BAT_ACT - 0 0 3
    BAT_LOW_THR norm 0.15 0.12 0.5
    BAT_CRIT_THR norm 0.07 0.05 0.5
    BAT_EMERGEN_THR norm 0.05 0.03 0.5
    GF_ACTION - 2 0 5
    GF_MAX_HOR_DIST m 0 0 10000
    GF_MAX_VER_DIST m 0 0 10000
    NAV_TRAFF_AVOID - 1 0 4
    MAV_SYS_ID - 1 1 250
    MPC_ACC_HOR m/s^2 3 2 15
    MPC_XY_VEL_MAX m/s 12 0 20
    MPC_TILTMAX_AIR deg 45 20 89
    FW_AIRSPD_TRIM m/s 15 0.5 -
    FW_R_LIM deg 50 35 65
    SIH_KDV N/(m/s) 1 0 -
    SIH_MASS kg 1 0 -
"""
_NOTHING = "-"
"""What stands in a row for no unit, and for a bound that there is not."""


class Firmware(NamedTuple):
    """The firmware of an autopilot."""

    family: str
    """Copter, Plane, Rover or PX4."""
    version: Version

    def __str__(self) -> str:
        """Return the firmware in words: "Copter 4.6"."""
        return f"{self.family} {in_words(self.version)}"


class Known(NamedTuple):
    """A parameter as some versions of a firmware have it."""

    family: str
    name: str
    unit: str
    """The unit of its value; empty for a choice, a number or a set of bits."""
    default: float
    least: float
    """The least value of the parameter reference; -inf where it names none."""
    greatest: float
    since: Version
    """The first version of those covered that has it."""
    until: Version
    """The last version of those covered that has it."""

    def is_in(self, firmware: Firmware) -> bool:
        """Return whether a firmware has it; one beyond the table counts as its nearest."""
        first, *_, last = versions(self.family)
        return self.family == firmware.family and self.since <= min(max(firmware.version, first), last) <= self.until

    @property
    def span(self) -> str:
        """The versions that have it, in words; empty for all."""
        first, *_, last = versions(self.family)
        if (self.since, self.until) == (first, last):
            return ""
        if self.since == first:
            return f"until {in_words(self.until)}"
        return (
            f"from {in_words(self.since)}"
            if self.until == last
            else f"{in_words(self.since)} to {in_words(self.until)}"
        )


def versions(family: str) -> tuple[Version, ...]:
    """Return the versions of a firmware that the table covers."""
    return PX4_VERSIONS if family == PX4 else ARDUPILOT_VERSIONS


def in_words(version: Version) -> str:
    """Return a version as it is written: "4.6"."""
    return ".".join(map(str, version))


def firmware_of(kind: str, flight_sw_version: int) -> Firmware | None:
    """Return the firmware that an autopilot of a kind names in AUTOPILOT_VERSION; None if it names none.

    MAVLink: the version's major, minor and patch number are its three highest bytes.
    """
    family, major, minor = FAMILIES.get(kind), flight_sw_version >> 24 & 0xFF, flight_sw_version >> 16 & 0xFF
    return None if family is None or major == 0 else Firmware(family, (major, minor))


def _rows(family: str, text: str) -> Iterator[Known]:
    first, *_, last = versions(family)
    for line in text.split("\n"):
        if not line.strip():
            continue
        name, unit, default, least, greatest, *span = line.split()
        since, _, until = (span or [".."])[0].partition("..")
        yield Known(
            family,
            name,
            "" if unit == _NOTHING else unit,
            float(default),
            -math.inf if least == _NOTHING else float(least),
            math.inf if greatest == _NOTHING else float(greatest),
            _version(since) or first,
            _version(until) or last,
        )


def _version(text: str) -> Version | None:
    if not text:
        return None
    major, minor = text.split(".")
    return int(major), int(minor)


TABLE: tuple[Known, ...] = (
    *_rows("Copter", _COPTER),
    *_rows("Plane", _PLANE),
    *_rows("Rover", _ROVER),
    *_rows(PX4, _PX4),
)
"""Every parameter that the companion reads, checks or names, of each firmware."""
_BY_NAME = {(row.family, row.name): row for row in TABLE}


_FENCES = ("FENCE_ENABLE", "FENCE_ACTION", "FENCE_TYPE", "FENCE_RADIUS", "FENCE_MARGIN")
_HEIGHTS = ("FENCE_ALT_MAX", "FENCE_ALT_MIN")
_BATTERY = (
    *("BATT_MONITOR", "BATT_CAPACITY", "BATT_LOW_VOLT", "BATT_LOW_MAH", "BATT_FS_LOW_ACT"),
    *("BATT_CRT_VOLT", "BATT_CRT_MAH", "BATT_FS_CRT_ACT"),
)
_SECOND_BATTERY = tuple(name.replace("BATT_", "BATT2_") for name in _BATTERY)
_TERMINATION = ("AFS_ENABLE", "AFS_TERM_ACTION")
_OWN = (
    *_FENCES,
    "FENCE_AUTOENABLE",
    *_HEIGHTS,
    *_BATTERY,
    *_SECOND_BATTERY,
    *_TERMINATION,
    "AVD_ENABLE",
    "AVD_F_ACTION",
)
SWITCHES = {
    **dict.fromkeys(_SECOND_BATTERY[1:], _SECOND_BATTERY[0]),
    _TERMINATION[1]: _TERMINATION[0],
}
"""Parameters that ArduPilot hides while another is 0, with that one: they are asked for once it is told as more."""
ENDINGS: Mapping[str, tuple[str, ...]] = {
    "Copter": ("FS_THR_ENABLE", "FS_OPTIONS", "FS_EKF_ACTION", *_OWN),
    "Plane": ("THR_FAILSAFE", "FS_SHORT_ACTN", "FS_LONG_ACTN", *_OWN),
    "Rover": ("FS_THR_ENABLE", "FS_ACTION", "FS_EKF_ACTION", *_FENCES, *_BATTERY, *_SECOND_BATTERY, *_TERMINATION),
    PX4: (
        *("NAV_RCL_ACT", "COM_RCL_EXCEPT", "COM_RC_IN_MODE", "NAV_DLL_ACT", "COM_DLL_EXCEPT", "GF_ACTION"),
        *("GF_MAX_HOR_DIST", "GF_MAX_VER_DIST", "COM_LOW_BAT_ACT", "BAT_CRIT_THR", "NAV_TRAFF_AVOID"),
    ),
}
"""The parameters by which an autopilot itself ends GUIDED or OFFBOARD, by firmware."""


def names(family: str) -> frozenset[str]:
    """Return every name that a firmware has in some version."""
    return frozenset(row.name for row in TABLE if row.family == family)


def known(kind: str, name: str) -> Known | None:
    """Return what is known of a parameter of a kind of autopilot, by its name in some version; None: nothing."""
    return _BY_NAME.get((FAMILIES.get(kind, ""), name))
