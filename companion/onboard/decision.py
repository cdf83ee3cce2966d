"""The decision of one tick, with its reasons (docs/design.md, rule 6)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from companion.guard.types import NO_BACKUP, Setpoint
from companion.onboard.failsafe import Stage


class Purpose(Enum):
    """What the companion is doing. The order of the members is on the wire, and their values are in logs."""

    IDLE = "idle"
    """Not steering: without telemetry, not ready, or the safety pilot controls the vehicle."""
    TARGET = "target"
    LOITER = "loiter"
    RETURN = "return"


class Certificate(Enum):
    """How long the guard certifies that no threat's disc is entered. The order of the members is on the wire."""

    NONE = "none"
    UNTIL = "until t"
    """For a stated time only: threats may come that nothing can be certified against for ever."""
    FOR_EVER = "for ever"


def certificate_of(certified_s: float) -> Certificate:
    """Return the kind of a certificate that holds for `certified_s` seconds."""
    if math.isinf(certified_s):
        return Certificate.FOR_EVER
    return Certificate.UNTIL if certified_s > 0.0 else Certificate.NONE


def certificate_in_words(certified_s: float) -> str:
    """Return the certificate in words: "for ever", "until 12 s" (from now) or "none"."""
    kind = certificate_of(certified_s)
    return f"until {certified_s:.3g} s" if kind is Certificate.UNTIL else str(kind.value)


@dataclass(frozen=True)
class Decision:
    """One tick's decision and its reasons. Headings are from grid north."""

    t_s: float
    purpose: Purpose
    reason: str
    stage: Stage
    picture_age_s: float | None
    """Age of the picture; None: nothing was heard yet."""
    target_id: int | None = None
    wanted_heading_rad: float = math.nan
    """Heading that the law wants, before right of way, turn limit and guard; NaN while not steering."""
    turn_limited: bool = False
    setpoint: Setpoint | None = None
    guard_changes: tuple[str, ...] = ()
    broken: tuple[str, ...] = ()
    """Assumptions of the guard that do not hold (docs/guard.md)."""
    gave_way: str | None = None
    """Why the right of way changed heading or speed; None if it did not."""
    note: str | None = None
    """Remarks of law and companion, e.g. that another vehicle uses this agent id."""
    reckons: str | None = None
    """What is reckoned with because it was measured to be worse than configured; None if nothing is."""
    stay: str | None = None
    """Why the law loiters instead of going to the goal's place; None if it does not."""
    opposed: bool = False
    """Whether the surrogate's component against the route was dropped."""
    triggers: tuple[str, ...] = ()
    """Reasons for the stage and for milder ones, the most severe first."""
    certified_s: float = 0.0
    """For how long from now the guard certifies the flight (docs/guard.md): inf for ever, 0 not at all."""

    @property
    def certificate(self) -> Certificate:
        """The kind of certificate that the flight has."""
        return certificate_of(self.certified_s)

    @property
    def certificate_words(self) -> str:
        """The certificate in words: "for ever", "until 12 s" (from now) or "none"."""
        return certificate_in_words(self.certified_s)

    @property
    def uncertified(self) -> bool:
        """Whether the guard had no certified back-up for this decision."""
        return NO_BACKUP in self.guard_changes
