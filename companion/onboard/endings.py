"""What of the autopilot's own rules ends GUIDED or OFFBOARD, by its parameters: losses, fences, batteries, avoidance.

A rule that ends the steering though nothing is wrong with the vehicle fails: a fence inside the mission's limits, the
loss of a ground station that is out of reach by design. One that ends it because something is wrong is told as what it
is. Parameters that a vehicle does not tell are not judged. docs/deploy.md has the list.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from companion.autopilot.firmware import known
from companion.onboard.config import Config
from companion.onboard.finding import Finding, warning

IN_GUIDED = 4.0
"""Bit of ArduCopter's FS_OPTIONS by which GUIDED goes on without radio control."""
IN_OFFBOARD = 4.0
"""Bit of PX4's COM_RCL_EXCEPT and COM_DLL_EXCEPT by which OFFBOARD goes on after that loss."""
NO_STICKS = 4.0
"""Value of PX4's COM_RC_IN_MODE that ignores sticks, and so their loss."""
FENCE_BY_HEIGHT, FENCE_BY_CIRCLE, FENCE_BY_FLOOR = 1, 2, 8
"""Bits of ArduPilot's FENCE_TYPE."""
PLANE_SHORT_ACTIONS = (1.0, 2.0, 4.0)
"""Values of ArduPlane's FS_SHORT_ACTN that take it out of GUIDED: CIRCLE, FBWA, FBWB."""
TERMINATES = {"arducopter": 5.0, "arduplane": 3.0, "ardurover": 5.0}
"""Value of BATT_FS_LOW_ACT and BATT_FS_CRT_ACT that stops the motors, by kind."""
AVOIDS_FROM = 2.0
"""Value of AVD_F_ACTION and NAV_TRAFF_AVOID from which the autopilot avoids others by itself: below it reports."""
COPTER_LANDS = (1.0, 3.0)
"""Values of ArduCopter's FS_EKF_ACTION that land."""
PARACHUTE = 3.0
"""Value of ArduPlane's FS_LONG_ACTN that releases the parachute."""
CRASHES = 42.0
"""Value of AFS_TERM_ACTION that ends the flight where the advanced failsafe terminates it."""
BATTERIES = ("BATT", "BATT2")
"""What the names of ArduPilot's parameters of a battery begin with."""
_PERCENT = 100.0


@dataclass(frozen=True)
class Told:
    """What is judged: the configuration, the kind of autopilot and the parameters that it told, by name."""

    config: Config
    kind: str
    values: Mapping[str, float]

    def __getitem__(self, name: str) -> float:
        """Return a parameter's value; NaN, which fulfils no condition, if it was not told."""
        return self.values.get(name, math.nan)

    @property
    def is_px4(self) -> bool:
        """Whether the autopilot is PX4."""
        return self.kind.startswith("px4")

    def has_bit(self, name: str, bit: float) -> bool:
        """Return whether a bit of a parameter is set; False if it was not told or is no set of bits."""
        value = self[name]
        return math.isfinite(value) and 0.0 <= value < 2**31 and bool(int(value) & int(bit))


def endings(config: Config, kind: str, values: Mapping[str, float]) -> Iterator[Finding]:
    """Yield what ends the steering of a vehicle of this kind by the parameters that it told."""
    told = Told(config, kind, values)
    rules = PX4_RULES if told.is_px4 else ARDUPILOT_RULES
    for rule in rules if kind != "kinematic" else ():
        yield from rule(told)


def _radio_control(told: Told) -> Iterator[Finding]:
    """Yield whether the loss of radio control ends GUIDED."""
    kind = told.kind
    if kind == "arduplane":
        if told["THR_FAILSAFE"] == 1.0 and (told["FS_SHORT_ACTN"] in PLANE_SHORT_ACTIONS or told["FS_LONG_ACTN"] > 0.0):
            if told["FS_LONG_ACTN"] == PARACHUTE:
                yield _must_be(
                    "FS_LONG_ACTN", 0.0, "FS_LONG_ACTN: 3; it releases the parachute where radio control is lost"
                )
                return
            actions = f"FS_SHORT_ACTN {told['FS_SHORT_ACTN']:g}, FS_LONG_ACTN {told['FS_LONG_ACTN']:g}"
            yield _radio("GUIDED", f"THR_FAILSAFE 1, {actions}", "FS_SHORT_ACTN to 0 and FS_LONG_ACTN to 0")
    elif kind == "ardurover":
        if told["FS_THR_ENABLE"] > 0.0 and told["FS_ACTION"] > 0.0:
            yield _radio(
                "GUIDED", f"FS_THR_ENABLE {told['FS_THR_ENABLE']:g}, FS_ACTION {told['FS_ACTION']:g}", "FS_ACTION to 0"
            )
    elif told["FS_THR_ENABLE"] > 0.0 and not told.has_bit("FS_OPTIONS", IN_GUIDED):
        options = told.values.get("FS_OPTIONS", 0.0)
        words = f"FS_THR_ENABLE {told['FS_THR_ENABLE']:g}, FS_OPTIONS {options:g}"
        yield _radio("GUIDED", words, f"FS_OPTIONS to {options + IN_GUIDED:g}")


def _px4_radio_control(told: Told) -> Iterator[Finding]:
    ignored = told["COM_RC_IN_MODE"] == NO_STICKS or told.has_bit("COM_RCL_EXCEPT", IN_OFFBOARD)
    if told["NAV_RCL_ACT"] > 0.0 and not ignored:
        exceptions = told.values.get("COM_RCL_EXCEPT", 0.0)
        words = f"NAV_RCL_ACT {told['NAV_RCL_ACT']:g}, COM_RCL_EXCEPT {exceptions:g}"
        yield _radio("OFFBOARD", words, f"COM_RCL_EXCEPT to {exceptions + IN_OFFBOARD:g}")


def _radio(mode: str, words: str, remedy: str) -> Finding:
    return warning(
        f"{words}: loss of radio control ends {mode}",
        f"where it flies on beyond the transmitter's reach, set {remedy}",
    )


def _px4_data_link(told: Told) -> Iterator[Finding]:
    """Yield whether the loss of a ground station ends OFFBOARD; ArduPilot's parameter for it is demanded to be 0."""
    if "NAV_DLL_ACT" not in told.values:
        return
    action = told["NAV_DLL_ACT"]
    stays = action == 0.0 or told.has_bit("COM_DLL_EXCEPT", IN_OFFBOARD)
    yield Finding(
        stays,
        f"NAV_DLL_ACT: {action:g}; allowed: 0; a vehicle that only listens is out of its ground station's reach "
        "by design",
        "set NAV_DLL_ACT to 0",
        sets=(("NAV_DLL_ACT", action if stays else 0.0),),
    )


def _fence(told: Told) -> Iterator[Finding]:
    """Yield which parts of ArduPilot's own fence lie inside the configured limits."""
    limits = told.config.limits
    # With a fence of its own the companion demands the autopilot's, so that it is judged as it will be.
    demanded = limits.fence is not None or bool(limits.exclusions)
    # By FENCE_AUTOENABLE a fence that is off is turned on at the take-off or when armed.
    turned_on = told["FENCE_ENABLE"] == 1.0 or told["FENCE_AUTOENABLE"] > 0.0
    if not demanded and (not turned_on or told["FENCE_ACTION"] == 0.0):
        return
    margin_m = max(told.values.get("FENCE_MARGIN", 0.0), 0.0)
    if told.has_bit("FENCE_TYPE", FENCE_BY_HEIGHT) and told.kind != "ardurover":
        yield from _wide_enough(told, "FENCE_ALT_MAX", limits.height_max_m + margin_m, "limits.height_max_m and margin")
    if told.has_bit("FENCE_TYPE", FENCE_BY_FLOOR) and told["FENCE_ALT_MIN"] + margin_m > limits.height_min_m:
        least_m = math.floor(limits.height_min_m - margin_m)
        yield Finding(
            False,
            f"FENCE_ALT_MIN: {told['FENCE_ALT_MIN']:g}; allowed: at most {least_m:g} (limits.height_min_m less "
            "margin); its own floor ends GUIDED",
            f"set FENCE_ALT_MIN to {least_m:g}, or raise limits.height_min_m",
            sets=(("FENCE_ALT_MIN", float(least_m)),),
        )
    if told.has_bit("FENCE_TYPE", FENCE_BY_CIRCLE):
        yield from _circle(told, "FENCE_RADIUS", margin_m)


def _px4_fence(told: Told) -> Iterator[Finding]:
    """Yield which parts of PX4's own fence lie inside the configured limits; 0 is no fence of that kind."""
    if not told["GF_ACTION"] >= 1.0:
        return
    if told["GF_MAX_VER_DIST"] > 0.0:
        yield from _wide_enough(told, "GF_MAX_VER_DIST", told.config.limits.height_max_m, "limits.height_max_m")
    if told["GF_MAX_HOR_DIST"] > 0.0:
        yield from _circle(told, "GF_MAX_HOR_DIST", 0.0)


def _wide_enough(told: Told, name: str, needed_m: float, of: str) -> Iterator[Finding]:
    """Yield whether a fence is as wide as the limits; one that cannot be is to be turned off."""
    row = known(told.kind, name)
    if name not in told.values or row is None:
        return
    mode = "OFFBOARD" if told.is_px4 else "GUIDED"
    least_m, wide = math.ceil(needed_m), told[name] >= needed_m
    fix = (name, told[name] if wide else float(least_m))
    if not wide and least_m > row.greatest:
        fix = (name, 0.0) if told.is_px4 else ("FENCE_TYPE", _within_reach(told))
    yield Finding(
        wide,
        f"{name}: {told[name]:g}; allowed: at least {least_m:g} ({of}); its own fence ends {mode}",
        f"set {fix[0]} to {fix[1]:g}, or lower the limits",
        sets=(fix,),
    )


def _within_reach(told: Told) -> float:
    """Return ArduPilot's FENCE_TYPE without the fences by height or circle that cannot be as wide as the limits."""
    kind, limits = told.kind, told.config.limits
    kinds = int(told["FENCE_TYPE"])
    needed_m = {
        "FENCE_ALT_MAX": (FENCE_BY_HEIGHT, limits.height_max_m),
        "FENCE_RADIUS": (FENCE_BY_CIRCLE, 0.0 if limits.fence is None else _greatest_distance_m(limits.fence) / 2.0),
    }
    for name, (bit, least_m) in needed_m.items():
        row = known(kind, name)
        if row is not None and least_m + max(told.values.get("FENCE_MARGIN", 0.0), 0.0) > row.greatest:
            kinds &= ~bit
    return float(kinds)


def _circle(told: Told, name: str, margin_m: float) -> Iterator[Finding]:
    """Yield whether a circle about home holds the mission's fence, or warn where there is none."""
    corners = told.config.limits.fence
    if corners is None:
        if name in told.values and told[name] < told.config.limits.range_m:
            yield warning(
                f"{name}: {told[name]:g}; a circle about home that ends the steering, and limits.range_m is "
                f"{told.config.limits.range_m:g}",
                "see that the mission lies inside, or raise it",
            )
        return
    # Wherever home is: no smaller circle holds the polygon.
    yield from _wide_enough(told, name, _greatest_distance_m(corners) / 2.0 + margin_m, "half of limits.fence")


def _greatest_distance_m(corners: Sequence[tuple[float, float]]) -> float:
    return max(math.dist(one, other) for one in corners for other in corners)


def _battery(told: Told) -> Iterator[Finding]:
    """Yield what ArduPilot does by itself about its batteries, and whether it measures the first at all.

    A companion that is told never to return for its battery leaves it to the autopilot.
    """
    least = told.config.health.battery_return_percent
    if told["BATT_MONITOR"] == 0.0 and least > 0.0:
        yield Finding(
            False,
            f"BATT_MONITOR: 0; no battery monitor, so that the vehicle cannot return at {least:g} %",
            "set up the autopilot's battery monitor, or set health.battery_return_percent to 0",
        )
    for battery, level in itertools.product(BATTERIES, ("LOW", "CRT")):
        action = f"{battery}_FS_{level}_ACT"
        if not told[action] > 0.0 or (battery != BATTERIES[0] and told[f"{battery}_MONITOR"] == 0.0):
            continue
        if told[action] == TERMINATES[told.kind]:
            yield Finding(
                False,
                f"{action}: {told[action]:g}; it stops the motors in flight",
                f"set {action} to 0, or to one that comes home",
                sets=((action, 0.0),),
            )
            continue
        yield from _battery_level(told, battery, level, least)


def _battery_level(told: Told, battery: str, level: str, least_percent: float) -> Iterator[Finding]:
    """Yield at which charge an action of ArduPilot's ends GUIDED, beside that at which the companion returns."""
    charge, volt = f"{battery}_{level}_MAH", f"{battery}_{level}_VOLT"
    capacity, action = f"{battery}_CAPACITY", f"{battery}_FS_{level}_ACT"
    if told[charge] > 0.0 and told[capacity] > 0.0 and least_percent > 0.0:
        percent = _PERCENT * told[charge] / told[capacity]
        most = math.floor(least_percent * told[capacity] / _PERCENT)
        yield Finding(
            percent <= least_percent,
            f"{charge}: {told[charge]:g} of {told[capacity]:g}, {percent:.0f} %; allowed: at most {least_percent:g} % "
            f"(health.battery_return_percent); {action} {told[action]:g} ends GUIDED there",
            f"set {charge} to {most:g}, or raise health.battery_return_percent",
            sets=((charge, float(min(most, told[charge]))),),
        )
    if told[volt] > 0.0 and least_percent > 0.0:
        yield warning(
            f"{action} {told[action]:g} ends GUIDED at {volt} {told[volt]:g}",
            f"see that the battery has less than {least_percent:g} % there: then the companion comes home first",
        )


def _termination(told: Told) -> Iterator[Finding]:
    """Yield what ArduPilot's advanced failsafe does: it ends the flight by rules of its own."""
    if told["AFS_ENABLE"] != 1.0:
        return
    if told["AFS_TERM_ACTION"] == CRASHES:
        words = "with AFS_TERM_ACTION 42 it ends the flight on the ground where a link or its fence is lost"
        yield _must_be("AFS_ENABLE", 0.0, f"AFS_ENABLE: 1; {words}")
    else:
        yield warning(
            "AFS_ENABLE 1: the advanced failsafe can end GUIDED by rules that are not checked here",
            "set AFS_ENABLE to 0, or see that none of its rules fits the mission",
        )


def _px4_battery(told: Told) -> Iterator[Finding]:
    """Yield at which charge PX4 ends OFFBOARD by itself: its levels are shares of the charge."""
    least = told.config.health.battery_return_percent
    if not told["COM_LOW_BAT_ACT"] >= 2.0 or "BAT_CRIT_THR" not in told.values or least == 0.0:
        return
    percent = _PERCENT * told["BAT_CRIT_THR"]
    yield Finding(
        percent <= least,
        f"BAT_CRIT_THR: {told['BAT_CRIT_THR']:.3g}; allowed: at most {least / _PERCENT:g} "
        f"(health.battery_return_percent); COM_LOW_BAT_ACT {told['COM_LOW_BAT_ACT']:g} ends OFFBOARD there",
        "set COM_LOW_BAT_ACT to 0, lower BAT_CRIT_THR, or raise health.battery_return_percent",
        sets=(("COM_LOW_BAT_ACT", 0.0 if percent > least else told["COM_LOW_BAT_ACT"]),),
    )


def _estimator(told: Told) -> Iterator[Finding]:
    """Yield what ArduPilot does when its estimate of the position is lost."""
    action = told["FS_EKF_ACTION"]
    if math.isnan(action):
        return
    if told.kind == "ardurover":
        ends, stays = action == 1.0, "FS_EKF_ACTION: {:g}; it drives on when its estimate is lost"
        text = "FS_EKF_ACTION: 1; GUIDED ends where the estimate is lost: it holds" if ends else stays.format(action)
        yield Finding(True, text) if ends else warning(text, "set FS_EKF_ACTION to 1")
    elif action in COPTER_LANDS:
        yield Finding(True, f"FS_EKF_ACTION: {action:g}; GUIDED ends where the estimate is lost: it lands")
    elif action == 0.0:
        yield warning("FS_EKF_ACTION: 0; it only reports that its estimate is lost", "set FS_EKF_ACTION to 1")
    else:
        words = "allowed: 1 or 3; ALT_HOLD, where the estimate is lost, drifts without sticks"
        yield _must_be("FS_EKF_ACTION", 1.0, f"FS_EKF_ACTION: {action:g}; {words}")


def _avoidance(told: Told) -> Iterator[Finding]:
    """Yield whether ArduPilot avoids aircraft by itself, which ends GUIDED."""
    if told["AVD_ENABLE"] == 1.0:
        yield from _avoids(told, "AVD_F_ACTION", "GUIDED")


def _px4_avoidance(told: Told) -> Iterator[Finding]:
    yield from _avoids(told, "NAV_TRAFF_AVOID", "OFFBOARD")


def _avoids(told: Told, name: str, mode: str) -> Iterator[Finding]:
    if told[name] >= AVOIDS_FROM:
        yield _must_be(name, 1.0, f"{name}: {told[name]:g}; allowed: 0 or 1; its own avoidance ends {mode}")


def _must_be(name: str, value: float, words: str) -> Finding:
    """Return that a parameter is not as it must be, with the value that it is to be set to."""
    return Finding(False, words, f"set {name} to {value:g}", sets=((name, value),))


Rule = Callable[[Told], Iterator[Finding]]
"""One kind of ending, judged by the parameters."""
ARDUPILOT_RULES: tuple[Rule, ...] = (_radio_control, _fence, _battery, _termination, _estimator, _avoidance)
PX4_RULES: tuple[Rule, ...] = (_px4_radio_control, _px4_data_link, _px4_fence, _px4_battery, _px4_avoidance)
