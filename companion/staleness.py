"""The named, bounded stages of losing the broadcast, and of regaining it (DESIGN.md, rules of the air, 3)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Stage(Enum):
    """How far the picture can still be trusted."""

    FRESH = "fresh"
    COASTING = "coasting"
    """Late, but the discs only grow: go on."""
    LOITERING = "loitering"
    """Too old to make for a target: loiter."""
    RETURNING = "returning"
    """Blind: return to where the flight began."""


@dataclass(frozen=True)
class Thresholds:
    """Ages of the picture at which each stage begins, in seconds."""

    coasting_after_s: float = 15.0
    loitering_after_s: float = 60.0
    returning_after_s: float = 300.0


def stage_of(age_s: float | None, thresholds: Thresholds) -> Stage:
    """Return the stage for a picture of this age. None, no picture ever, is LOITERING: there is nowhere to go."""
    if age_s is None:
        return Stage.LOITERING
    if age_s >= thresholds.returning_after_s:
        return Stage.RETURNING
    if age_s >= thresholds.loitering_after_s:
        return Stage.LOITERING
    if age_s >= thresholds.coasting_after_s:
        return Stage.COASTING
    return Stage.FRESH
