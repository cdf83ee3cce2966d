"""The named, bounded stages of trusting picture and vehicle less, and of trusting them again (docs/design.md, rule 3).

Each input has its own trigger; the most severe one is the stage. A stage begins at once and is left only when
its reason has been gone for a while. What makes steering impossible is no stage but silence.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from companion.onboard.config import Config

CLOCK_DIGITS = 3
"""Offsets of the clock are kept to the millisecond: a log, which is exact to the microsecond, then tells the same."""
BATTERY_MARGIN_PERCENT = 5.0
"""A battery that was low is good again this far above its limit: its voltage recovers when the load is taken off."""
ABILITIES_CHANGED = "the autopilot's parameters were changed in flight"


class Stage(Enum):
    """What the vehicle may still do, from all to least. Order and values are on the wire and in logs."""

    FRESH = "fresh"
    COASTING = "coasting"
    """Late, but the discs only grow: go on."""
    LOITERING = "loitering"
    """Not good enough to make for a target: loiter."""
    RETURNING = "returning"
    """Return to where the flight began."""


SEVERITY = {stage: rank for rank, stage in enumerate(Stage)}


class Cause(Enum):
    """What a trigger is about; of several of one stage the first is told first."""

    BROADCAST = "broadcast"
    FENCE = "fence"
    BATTERY = "battery"
    RANGE = "range"
    GUARD = "guard"
    ABILITIES = "abilities"
    POSITION = "position"
    CLOCK = "clock"


@dataclass(frozen=True)
class FailsafeThresholds:
    """Where each stage begins. Ages of the picture and times in seconds."""

    coasting_after_s: float = 15.0
    loitering_after_s: float = 60.0
    returning_after_s: float = 300.0
    recover_after_s: float = 1.0
    battery_return_percent: float = 25.0
    position_accuracy_m: float = 10.0
    infeasible_after_s: float = 5.0
    clock_step_s: float = 1.0


@dataclass(frozen=True)
class FailsafeInputs:
    """What the stage depends on, as known now."""

    picture_age_s: float | None = None
    """None: there never was a picture."""
    position_accuracy_m: float = math.nan
    """NaN: not told."""
    battery_percent: float | None = None
    """None: not told."""
    out_of_range: bool = False
    outside_fence: bool = False
    uncertified_s: float = 0.0
    """For how long the guard has had no certified back-up."""
    abilities_changed: bool = False
    """Whether the vehicle can now do other things than it is reckoned with."""
    clock_offset_s: float = 0.0
    """How far the computer's clock is from the one that ages are told by."""


@dataclass(frozen=True)
class Trigger:
    """One reason for a stage."""

    cause: Cause
    stage: Stage
    words: str
    held_at_s: float
    """When its reason last held; -inf for one that goes as soon as its reason does."""


@dataclass(frozen=True)
class FailsafeStatus:
    """The stage, and all that would lead to it or a milder one, the most severe first."""

    stage: Stage = Stage.FRESH
    triggers: tuple[Trigger, ...] = ()

    @property
    def words(self) -> str:
        """The reason for the stage; nothing when there is none."""
        return self.triggers[0].words if self.triggers else ""

    @property
    def all_words(self) -> tuple[str, ...]:
        """The reasons for the stage and for milder ones, the most severe first."""
        return tuple(trigger.words for trigger in self.triggers)


@dataclass(frozen=True)
class _Found:
    """What one input says by itself: the stage, and why; `unknown` says nothing, so that what was before stays."""

    stage: Stage = Stage.FRESH
    words: str = ""
    unknown: bool = False
    sticky: bool = True
    """Whether it stays for a while after its reason has gone."""


_NOTHING = _Found()
_UNKNOWN = _Found(unknown=True)
_FINE = FailsafeStatus()


class Failsafe:
    """How far picture and vehicle of one companion can be trusted. Times are given by the caller."""

    def __init__(self, config: Config) -> None:
        self.status = _FINE
        """As of the last update."""
        self.clock_offset_s = 0.0
        """How far this computer's clock is from the one that times are told by."""
        self._thresholds = thresholds_of(config)

    def update(self, inputs: FailsafeInputs, now_s: float) -> FailsafeStatus:
        """Take in what is known now; return the status."""
        self.status = assess(inputs, self._thresholds, self.status, now_s)
        return self.status

    def note_clock(self, offset_s: float) -> bool:
        """Note how far this computer's clock is from the one that times are told by; return whether that is news."""
        offset_s = round(offset_s, CLOCK_DIGITS)
        change_s = round(abs(offset_s - self.clock_offset_s), CLOCK_DIGITS)
        news = change_s >= 0.5 * self._thresholds.clock_step_s
        if news:
            self.clock_offset_s = offset_s
        return news


def thresholds_of(config: Config) -> FailsafeThresholds:
    """Return where a configuration has each stage begin."""
    return FailsafeThresholds(
        coasting_after_s=config.staleness.coasting_after_s,
        loitering_after_s=config.staleness.loitering_after_s,
        returning_after_s=config.staleness.blind_after_s,
        recover_after_s=config.staleness.recover_after_s,
        battery_return_percent=config.health.battery_return_percent,
        position_accuracy_m=config.health.position_accuracy_m,
        infeasible_after_s=config.health.infeasible_after_s,
        clock_step_s=config.health.clock_step_s,
    )


def assess(
    inputs: FailsafeInputs, thresholds: FailsafeThresholds, before: FailsafeStatus, now_s: float
) -> FailsafeStatus:
    """Return the status by inputs and by the status before: up at once, down after `recover_after_s`."""
    earlier = {trigger.cause: trigger for trigger in before.triggers}
    triggers = [
        trigger
        for cause, found in _found(inputs, thresholds, Cause.BATTERY in earlier)
        if (trigger := _held(cause, found, earlier.get(cause), thresholds, now_s)) is not None
    ]
    if not triggers:
        return _FINE
    # Sorting keeps the order of causes among equals.
    triggers.sort(key=lambda trigger: -SEVERITY[trigger.stage])
    return FailsafeStatus(triggers[0].stage, tuple(triggers))


def _held(
    cause: Cause, found: _Found, earlier: Trigger | None, thresholds: FailsafeThresholds, now_s: float
) -> Trigger | None:
    if earlier is not None:
        milder = SEVERITY[found.stage] < SEVERITY[earlier.stage]
        if found.unknown or (milder and now_s - earlier.held_at_s < thresholds.recover_after_s):
            return earlier
    if found.stage is Stage.FRESH:
        return None
    return Trigger(cause, found.stage, found.words, now_s if found.sticky else -math.inf)


def _found(inputs: FailsafeInputs, thresholds: FailsafeThresholds, was_low: bool) -> tuple[tuple[Cause, _Found], ...]:
    """Return what each input says, in the order in which equals are told; `was_low`: the battery."""
    uncertified = inputs.uncertified_s >= thresholds.infeasible_after_s
    return (
        (Cause.BROADCAST, _by_age(inputs.picture_age_s, thresholds)),
        (Cause.FENCE, _if(inputs.outside_fence, Stage.RETURNING, "outside the fence")),
        (Cause.BATTERY, _by_battery(inputs.battery_percent, thresholds, was_low)),
        (Cause.RANGE, _if(inputs.out_of_range, Stage.RETURNING, "range")),
        (Cause.GUARD, _if(uncertified, Stage.LOITERING, "no certified back-up")),
        (Cause.ABILITIES, _if(inputs.abilities_changed, Stage.LOITERING, ABILITIES_CHANGED)),
        (Cause.POSITION, _by_accuracy(inputs.position_accuracy_m, thresholds)),
        (Cause.CLOCK, _by_clock(inputs.clock_offset_s, thresholds)),
    )


def _if(holds: bool, stage: Stage, words: str) -> _Found:
    return _Found(stage, words) if holds else _NOTHING


def _by_age(age_s: float | None, thresholds: FailsafeThresholds) -> _Found:
    if age_s is None:
        # Nothing to fall back from: the first picture is as good as any.
        return _Found(Stage.LOITERING, "no picture", sticky=False)
    if age_s >= thresholds.returning_after_s:
        return _Found(Stage.RETURNING, "blind")
    if age_s >= thresholds.loitering_after_s:
        return _Found(Stage.LOITERING, "picture too old")
    if age_s >= thresholds.coasting_after_s:
        return _Found(Stage.COASTING, "picture late")
    return _NOTHING


def _by_battery(percent: float | None, thresholds: FailsafeThresholds, was_low: bool) -> _Found:
    if percent is None:
        return _UNKNOWN
    limit = thresholds.battery_return_percent
    low = limit > 0.0 and percent <= limit + (BATTERY_MARGIN_PERCENT if was_low else 0.0)
    return _if(low, Stage.RETURNING, "battery low")


def _by_accuracy(accuracy_m: float, thresholds: FailsafeThresholds) -> _Found:
    if math.isnan(accuracy_m):
        return _UNKNOWN
    return _if(accuracy_m > thresholds.position_accuracy_m, Stage.LOITERING, "position not known well enough")


def _by_clock(offset_s: float, thresholds: FailsafeThresholds) -> _Found:
    if abs(offset_s) < thresholds.clock_step_s:
        return _NOTHING
    return _Found(Stage.COASTING, f"clock stepped by {offset_s:+.1f} s")
