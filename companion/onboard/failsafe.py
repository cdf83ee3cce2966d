"""The failsafe: in named stages, how far picture and vehicle can still be trusted (docs/design.md, rule 3).

Each input has its own trigger, and the most severe trigger gives the stage. A stage begins at once and is left only
when its reason has been gone for a while. A fault that makes steering impossible is no stage: no setpoint is sent then.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from companion.onboard.answer import Answer, Rung
from companion.onboard.config import Config

CLOCK_DIGITS = 3
"""Decimals of the seconds to which clock offsets are rounded, so that a log (in microseconds) stores them exactly."""
BATTERY_MARGIN_PERCENT = 5.0
"""Hysteresis: a low battery counts as good again this far above the limit, as its voltage recovers with less load."""
OUT_OF_RANGE = "range"
UNCERTIFIED = "no certified back-up"
ABILITIES_CHANGED = "the autopilot's parameters were changed in flight"


class Stage(Enum):
    """What the vehicle may still do, the mildest stage first. The order is on the wire, and the values are in logs."""

    FRESH = "fresh"
    """Nothing is wrong: no trigger holds."""
    COASTING = "coasting"
    """The picture is late or the clock has stepped: the vehicle goes on, and the threats' discs grow with their age."""
    LOITERING = "loitering"
    """The picture or the vehicle is not good enough to fly to a target: it loiters."""
    RETURNING = "returning"
    """The vehicle returns home."""


SEVERITY = {stage: rank for rank, stage in enumerate(Stage)}
"""Rank of each stage: the higher, the more severe."""


class Cause(Enum):
    """The input that a trigger comes from, in the order in which triggers of equal stage are reported."""

    BROADCAST = "broadcast"
    PICTURE = "picture"
    FENCE = "fence"
    BATTERY = "battery"
    RANGE = "range"
    GUARD = "guard"
    REFERENCES = "references"
    ESTIMATE = "estimate"
    ABILITIES = "abilities"
    OBEDIENCE = "obedience"
    POSITION = "position"
    TELEMETRY = "telemetry"
    CLOCK = "clock"


@dataclass(frozen=True)
class FailsafeThresholds:
    """Limits at which the stages begin; the configuration's sections `staleness` and `health` explain them."""

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
    """Everything that the stage depends on, as known now."""

    picture_age_s: float | None = None
    """Age of the picture; None: nothing was heard yet."""
    missing: str | None = None
    """What of the picture was not heard yet, in words; None: nothing is missing."""
    position_accuracy_m: float = math.nan
    """Accuracy of the position by the autopilot's estimate; NaN: not reported."""
    moved: str | None = None
    """Which frames of reference have moved since the hand-over, in words; None: none has."""
    misplaced: str | None = None
    """Why the position is not to be flown by to a target, in words; None: nothing speaks against it."""
    doubted: str | None = None
    """That the position jumped a moment ago and is not believed yet, in words; None: it is believed."""
    too_seldom: str | None = None
    """Which message of the autopilot comes too seldom to steer by, in words; None: none does."""
    battery_percent: float | None = None
    """Remaining charge; None: not reported."""
    out_of_range: bool = False
    outside_fence: bool = False
    uncertified_s: float = 0.0
    """Time for which the guard has had no certified back-up."""
    abilities_changed: bool = False
    """Whether the vehicle's abilities now give other limits than those that it is steered by."""
    answer: Answer = Answer()
    """Whether the vehicle answers its setpoints."""
    clock_offset_s: float = 0.0
    """Offset of the computer's system clock from the clock that ages are computed with."""


@dataclass(frozen=True)
class Trigger:
    """One reason for a stage."""

    cause: Cause
    stage: Stage
    words: str
    held_at_s: float
    """Time when the reason last held; -inf for a trigger that ends at once with its reason."""


@dataclass(frozen=True)
class FailsafeStatus:
    """The stage, and the triggers of it and of milder stages, the most severe first."""

    stage: Stage = Stage.FRESH
    triggers: tuple[Trigger, ...] = ()

    @property
    def words(self) -> str:
        """The reason for the stage; empty in the stage FRESH."""
        return self.triggers[0].words if self.triggers else ""

    @property
    def all_words(self) -> tuple[str, ...]:
        """The reasons for the stage and for milder ones, the most severe first."""
        return tuple(trigger.words for trigger in self.triggers)


@dataclass(frozen=True)
class _Found:
    """The stage that one input asks for by itself, and the reason in words."""

    stage: Stage = Stage.FRESH
    words: str = ""
    unknown: bool = False
    """Whether the input is not known: then its earlier trigger, if any, stays."""
    sticky: bool = True
    """Whether the trigger stays for `recover_after_s` after its reason has gone."""


_NOTHING = _Found()
_UNKNOWN = _Found(unknown=True)
_FINE = FailsafeStatus()


class Failsafe:
    """Follows how far picture and vehicle of one companion can be trusted."""

    def __init__(self, config: Config) -> None:
        self.status = _FINE
        """The status as of the last update."""
        self.clock_offset_s = 0.0
        """Offset of the computer's system clock from the clock that ages are computed with, as last noted."""
        self._thresholds = thresholds_of(config)

    def update(self, inputs: FailsafeInputs, now_s: float) -> FailsafeStatus:
        """Update the status by the inputs as they are now; return it."""
        self.status = assess(inputs, self._thresholds, self.status, now_s)
        return self.status

    def note_clock(self, offset_s: float) -> bool:
        """Note the offset of the computer's system clock if it changed by half a clock step; return whether it did."""
        offset_s = round(offset_s, CLOCK_DIGITS)
        change_s = round(abs(offset_s - self.clock_offset_s), CLOCK_DIGITS)
        news = change_s >= 0.5 * self._thresholds.clock_step_s
        if news:
            self.clock_offset_s = offset_s
        return news


def thresholds_of(config: Config) -> FailsafeThresholds:
    """Return the limits of a configuration at which the stages begin."""
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
    """Return the status now, from the inputs and the status before.

    A trigger becomes more severe at once, and milder only when its reason has been gone for `recover_after_s`.
    """
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
    """Return the stage that each input asks for, in the order of Cause; `was_low`: the battery was low before."""
    uncertified = inputs.uncertified_s >= thresholds.infeasible_after_s
    return (
        (Cause.BROADCAST, _by_age(inputs.picture_age_s, thresholds)),
        (Cause.PICTURE, _by_missing(inputs.missing)),
        (Cause.FENCE, _if(inputs.outside_fence, Stage.RETURNING, "outside the fence")),
        (Cause.BATTERY, _by_battery(inputs.battery_percent, thresholds, was_low)),
        (Cause.RANGE, _if(inputs.out_of_range, Stage.RETURNING, OUT_OF_RANGE)),
        (Cause.GUARD, _if(uncertified, Stage.LOITERING, UNCERTIFIED)),
        (Cause.REFERENCES, _by_words(Stage.LOITERING, inputs.moved)),
        (Cause.ESTIMATE, _by_words(*_of_estimate(inputs))),
        (Cause.ABILITIES, _if(inputs.abilities_changed, Stage.LOITERING, ABILITIES_CHANGED)),
        (Cause.OBEDIENCE, _by_answer(inputs.answer)),
        (Cause.POSITION, _by_accuracy(inputs.position_accuracy_m, thresholds)),
        (Cause.TELEMETRY, _NOTHING if inputs.too_seldom is None else _Found(Stage.LOITERING, inputs.too_seldom)),
        (Cause.CLOCK, _by_clock(inputs.clock_offset_s, thresholds)),
    )


def _if(holds: bool, stage: Stage, words: str) -> _Found:
    return _Found(stage, words) if holds else _NOTHING


def _by_words(stage: Stage, words: str | None) -> _Found:
    return _NOTHING if words is None else _Found(stage, words)


def _of_estimate(inputs: FailsafeInputs) -> tuple[Stage, str | None]:
    if inputs.misplaced is not None:
        return Stage.LOITERING, inputs.misplaced
    return Stage.COASTING, inputs.doubted


def _by_age(age_s: float | None, thresholds: FailsafeThresholds) -> _Found:
    if age_s is None:
        # Not sticky: the first picture counts at once, as there is no fault that might come back.
        return _Found(Stage.LOITERING, "no picture", sticky=False)
    if age_s >= thresholds.returning_after_s:
        return _Found(Stage.RETURNING, "blind")
    if age_s >= thresholds.loitering_after_s:
        return _Found(Stage.LOITERING, "picture too old")
    if age_s >= thresholds.coasting_after_s:
        return _Found(Stage.COASTING, "picture late")
    return _NOTHING


def _by_missing(missing: str | None) -> _Found:
    # Not sticky: once the rest was heard there is no fault that might come back.
    return _NOTHING if missing is None else _Found(Stage.LOITERING, missing, sticky=False)


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


def _by_answer(answer: Answer) -> _Found:
    # Not sticky: the ladder has times of its own.
    if answer.trigger is None:
        return _NOTHING
    stage = Stage.COASTING if answer.rung is Rung.SLOWED else Stage.LOITERING
    return _Found(stage, answer.trigger, sticky=False)


def _by_clock(offset_s: float, thresholds: FailsafeThresholds) -> _Found:
    if abs(offset_s) < thresholds.clock_step_s:
        return _NOTHING
    return _Found(Stage.COASTING, f"clock stepped by {offset_s:+.1f} s")
