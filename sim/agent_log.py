"""What the companion of one agent decided in a flight, as far as its result tells of it."""

from __future__ import annotations

import re
from collections import Counter
from typing import NamedTuple

from companion.onboard.decision import Certificate, Decision, Purpose

PICTURE_S = 0.05
"""Least difference of two pictures' times that makes them two."""
_NUMBERS = re.compile(r"\d+(\.\d+)?")
_RANK = {certificate: rank for rank, certificate in enumerate(Certificate)}


class CertificateLoss(NamedTuple):
    """When an agent first had a lesser certificate than at the start, which one, and why."""

    t_s: float
    certificate: str
    why: str


class Broken(NamedTuple):
    """How often the guard found an assumption broken, and when first."""

    times: int
    first_t_s: float


class AgentLog:
    """The decisions of one agent's companion, taken in one by one."""

    def __init__(self) -> None:
        self.decisions = 0
        self.guarded = 0
        """Number of decisions that the guard changed."""
        self.guard_changes: Counter[str] = Counter()
        """How often the guard changed what, by its own words."""
        self.start: Decision | None = None
        """The first decision by which the vehicle was steered on a picture; its certificate is that of the start."""
        self.loss: CertificateLoss | None = None
        self.broken: dict[str, Broken] = {}
        """The assumptions that broke, by the guard's words."""
        self.last: Decision | None = None
        self.last_t_s = 0.0
        self.target_id: int | None = None
        """Id of the target that it last flew to."""
        self.pictures: list[tuple[float, float]] = []
        """When it first decided on another picture, and the time of that picture, s."""
        self.reasons: list[tuple[float, str]] = []
        """When it first decided for another reason, whatever the numbers in it, and what it said of it."""
        self._reason = ""

    def note(self, decision: Decision, t_s: float) -> None:
        """Take in a decision made at a time of the flight."""
        self.decisions += 1
        self.last, self.last_t_s = decision, t_s
        self._tell(decision, t_s)
        if decision.target_id is not None:
            self.target_id = decision.target_id
        if decision.guard_changes:
            self.guarded += 1
            self.guard_changes.update(decision.guard_changes)
        for assumption in decision.broken:
            before = self.broken.get(assumption, Broken(0, t_s))
            self.broken[assumption] = before._replace(times=before.times + 1)
        if decision.purpose is Purpose.IDLE or decision.picture_age_s is None:
            return
        if self.start is None:
            self.start = decision
        elif self.loss is None and _RANK[decision.certificate] < _RANK[self.start.certificate]:
            self.loss = CertificateLoss(t_s, decision.certificate_words, _why(decision))

    def _tell(self, decision: Decision, t_s: float) -> None:
        """Note when picture and reason became others."""
        if decision.picture_age_s is not None:
            picture_s = t_s - decision.picture_age_s
            if not self.pictures or abs(picture_s - self.pictures[-1][1]) > PICTURE_S:
                self.pictures.append((round(t_s, 1), round(picture_s, 2)))
        target = "" if decision.target_id is None else f" {decision.target_id}"
        certified = decision.certificate.value
        words = f"{decision.stage.value}, {decision.purpose.value}{target}: {decision.reason}; certified {certified}"
        reason = _NUMBERS.sub("", words) + target
        if reason != self._reason:
            self._reason = reason
            self.reasons.append((round(t_s, 1), words))


def _why(decision: Decision) -> str:
    """Return what a decision says of the state in which it has its certificate."""
    remarks = (decision.stay, decision.note, decision.reckons)
    told = (*decision.broken, *decision.triggers, *decision.guard_changes, *remarks)
    return "; ".join(dict.fromkeys(str(word) for word in told if word)) or decision.reason
