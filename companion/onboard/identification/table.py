"""The table of what was measured beside what is reckoned with, with a verdict and a remedy for each line."""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.onboard.config import LimitsSection
from companion.onboard.identification.estimators import REACHED_SHARE, Identified
from companion.onboard.identification.follower import Estimate

REACTION_TOLERANCE_S = 0.05
"""Difference from the reaction reckoned with that counts as none: to that the adapters' own are known
(tests/benchmarks/lags.py), and the way flown in it is less than `Abilities.tracking_m`."""
SHARE_TOLERANCE = 0.05
"""Share of a turn rate that is none where reaction and turn rate are judged together: telemetry tells it no better."""
UNKNOWN = "not shown by this flight"
WIND = "wind"
"""Name of the wind's row: the only one that says nothing of the vehicle."""


class Row(NamedTuple):
    """One line of the table; `remedy` holds the key of `limits` and its value where the measured value is worse."""

    name: str
    measured: str
    reckoned: str
    worse: bool
    remedy: tuple[str, float] | None = None

    @property
    def shown(self) -> bool:
        """Whether the flight shows the value at all."""
        return self.measured != UNKNOWN

    @property
    def text(self) -> str:
        """The line as it is printed."""
        verdict = "ok"
        if self.worse:
            verdict = "worse" if self.remedy is None else f"worse: set limits.{self.remedy[0]} to {self.remedy[1]:g}"
        if not self.shown:
            verdict = "-"
        return f"{self.name:<24} {self.measured:<30} {self.reckoned:<26} {verdict}"


HEADING = f"{'':<24} {'measured, 95 % interval':<30} {'reckoned with':<26}"


def rows(found: Identified, limits: LimitsSection, can_stop: bool, radius_m: float) -> list[Row]:
    """Return the table of what was found beside the limits that the vehicle is steered by.

    `radius_m`: distance from its place within which a vehicle counts as arrived, with which holding is compared.
    """
    table = [
        _slow_to_react("reaction to a course", found.reaction_s, limits, found.turns_denied),
        _least("turn rate, of n_max g/v", found.rate_share, "", ("rate_share", limits.rate_share), found.turns_denied),
        Row("acceleration", _text(found.acceleration_m_s2, "m/s^2"), "-", False),
    ]
    if can_stop:
        braking = ("braking_m_s2", limits.braking_m_s2)
        table.append(_slow_to_react("reaction to a speed", found.speed_reaction_s, limits))
        table.append(_least("braking", found.braking_m_s2, "m/s^2", braking))
    return [*table, _speed(found, limits, can_stop), _hold(found.hold_m, can_stop, radius_m), _wind(found, limits)]


def obedience_shown(table: list[Row]) -> bool:
    """Return whether a table says anything of how the vehicle obeys."""
    return any(row.shown for row in table if row.name != WIND)


def remedies(table: list[Row]) -> dict[str, float]:
    """Return the keys of `limits` with the values that the table asks for; of several values the most cautious."""
    found: dict[str, float] = {}
    for key, value in (row.remedy for row in table if row.worse and row.remedy is not None):
        cautious = max if key in ("reaction_s", "wind_m_s") else min
        found[key] = cautious(found.get(key, value), value)
    return found


def _slow_to_react(name: str, found: Estimate | None, limits: LimitsSection, denied: bool = False) -> Row:
    """Return the row of a reaction; of a pair that is denied the value itself counts, not its whole interval."""
    most_s = limits.reaction_s + REACTION_TOLERANCE_S
    worse = found is not None and (found.value if denied else found.low) > most_s
    remedy = None if found is None or not worse else ("reaction_s", _up(found.high))
    return Row(name, _text(found, "s"), f"reaction_s {limits.reaction_s:g}", worse, remedy)


def _least(name: str, found: Estimate | None, unit: str, limit: tuple[str, float], denied: bool = False) -> Row:
    """Return the row of a value that must not be less than a limit, given as key and value; `denied` as above."""
    key, least = limit
    worse = found is not None and (found.value if denied else found.high) < least * (1.0 - SHARE_TOLERANCE * denied)
    remedy = None if found is None or not worse else (key, _down(found.low))
    return Row(name, _text(found, unit), f"{key} {least:.3g}", worse, remedy)


def _speed(found: Identified, limits: LimitsSection, can_stop: bool) -> Row:
    name = "top speed" if can_stop else "airspeed"
    top, asked_m_s = found.top_speed_m_s, found.asked_m_s
    worse = top is not None and top.high < REACHED_SHARE * min(asked_m_s, limits.speed_m_s)
    # A plane flies the airspeed of its autopilot's parameters, whatever is configured here.
    remedy = None if top is None or not worse or not can_stop else ("speed_m_s", _down(top.low))
    return Row(name, _text(top, "m/s"), f"speed_m_s {limits.speed_m_s:.3g}", worse, remedy)


def _hold(found: Estimate | None, can_stop: bool, radius_m: float) -> Row:
    name = "off its place, 95 %" if can_stop else "off its circle, 95 %"
    worse = found is not None and found.low > radius_m
    return Row(name, _text(found, "m"), f"arrival_radius_m {radius_m:g}", worse)


def _wind(found: Identified, limits: LimitsSection) -> Row:
    wind = found.wind_m_s
    worse = wind is not None and wind.low > limits.wind_m_s
    remedy = None if wind is None or not worse else ("wind_m_s", _up(wind.high))
    text = _text(wind, "m/s")
    if found.wind_ned_m_s is not None:
        north_m_s, east_m_s = found.wind_ned_m_s
        text += f" from {math.degrees(math.atan2(-east_m_s, -north_m_s)) % 360.0:.0f} deg"
    return Row(WIND, text, f"wind_m_s {limits.wind_m_s:g}", worse, remedy)


def _text(found: Estimate | None, unit: str) -> str:
    if found is None:
        return UNKNOWN
    behind = f" {unit}" if unit else ""
    if math.isinf(found.high):
        return f"at least {found.low:.2f}{behind}"
    return f"{found.value:.2f}{behind} ({found.low:.2f} to {found.high:.2f})"


def _up(value: float) -> float:
    """Return a value rounded up to the next twentieth."""
    return round(math.ceil(value * 20.0 - 1e-9) / 20.0, 2)


def _down(value: float) -> float:
    """Return a value rounded down to the next twentieth, or to a hundredth where nothing would be left."""
    return round(math.floor(value * 20.0 + 1e-9) / 20.0, 2) or max(round(math.floor(value * 100.0) / 100.0, 2), 0.01)
