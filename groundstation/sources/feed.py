"""One source while it runs: its parser, the sightings that wait, and its health, without any socket.

What comes in is parsed where it comes in and waits in a queue of bounded length, from which each tick takes its share;
in a flood the oldest are left out and counted, so that no source can keep the broadcast waiting.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Hashable
from dataclasses import dataclass
from typing import Literal, NamedTuple

from companion.geo.local_frame import LocalFrame
from companion.mission.sources import SourceSpec
from groundstation.sources.ais import AisParser
from groundstation.sources.basestation import ON_GROUND, BaseStationParser
from groundstation.sources.cot import NO_THING, CotParser
from groundstation.sources.mavlink import AdsbParser, TelemetryParser
from groundstation.sources.recording import OTHER_KIND, RecordingParser
from groundstation.sources.sighting import Parser, Sighting, count

MOST_WAITING = 2_000
"""Greatest number of sightings of a source that wait."""
RATE_S = 10.0
"""Time over which a rate is counted."""
LATE_PERIODS = 3.0
"""Number of its mean periods without a sighting after which a source is late."""
LEAST_LATE_S = 3.0
"""Least time without a sighting after which a source is late."""
SILENT_S = 30.0
"""Time without a sighting after which a source is silent, or several of its periods if that is longer."""
_SILENT_PERIODS = 10.0
LEFT_OUT = frozenset((ON_GROUND, OTHER_KIND, NO_THING))
"""Reasons that are no fault of a source."""
_GAIN = 0.2
"""Weight of the newest time between two sightings in the mean."""

State = Literal["good", "late", "silent", "failed"]


class Health(NamedTuple):
    """How a source does."""

    state: State
    rate_hz: float
    age_s: float | None
    """Time since the newest sighting; None: there was none."""
    detail: str


@dataclass
class Link:
    """What the source's link or file is doing, as its shell says."""

    fault: str | None = None
    """Why nothing can come; None: it is open, or begins to be."""
    note: str = ""
    """What is heard; nothing yet if empty."""

    @property
    def is_opening(self) -> bool:
        """Whether it has neither been opened nor failed yet."""
        return not self.note and self.fault is None


def parser_of(spec: SourceSpec, frame: LocalFrame) -> Parser:
    """Return a new parser for a source; `frame` is the mission's plane."""
    match spec.kind:
        case "telemetry":
            return TelemetryParser()
        case "adsb":
            return AdsbParser()
        case "basestation":
            return BaseStationParser(takes_grounded=spec.things == "agents")
        case "ais":
            return AisParser()
        case "cot":
            return CotParser()
        case "csv" | "jsonl":
            return RecordingParser(frame, spec.things, is_json=spec.kind == "jsonl")
    raise ValueError(f"a source of the kind {spec.kind} has no parser")


class Pulse:
    """The health of something that is heard, by when it was."""

    def __init__(self) -> None:
        self.link = Link()
        self.heard = 0
        """Number of sightings, or of frames."""
        self._counts: deque[tuple[float, int]] = deque()
        """Number by second of the clock, for the rate."""
        self._newest_s: float | None = None
        self._period_s = 0.0

    def note(self, number: int, now_s: float) -> None:
        """Take note that something was heard."""
        self.heard += number
        if self._newest_s is not None:
            period_s = min(RATE_S * LATE_PERIODS, (now_s - self._newest_s) / number)
            self._period_s += _GAIN * (period_s - self._period_s)
        self._newest_s = now_s
        second_s = math.floor(now_s)
        if self._counts and self._counts[-1][0] == second_s:
            number += self._counts.pop()[1]
        self._counts.append((second_s, number))

    def health(self, now_s: float) -> Health:
        """Return how it does."""
        while self._counts and now_s - self._counts[0][0] > RATE_S:
            self._counts.popleft()
        rate_hz = sum(number for _, number in self._counts) / RATE_S
        age_s = None if self._newest_s is None else max(0.0, now_s - self._newest_s)
        if self.link.fault is not None:
            return Health("failed", rate_hz, age_s, self.link.fault)
        if age_s is None or age_s > max(SILENT_S, _SILENT_PERIODS * self._period_s):
            return Health("silent", rate_hz, age_s, self.link.note)
        is_late = age_s > max(LEAST_LATE_S, LATE_PERIODS * self._period_s)
        return Health("late" if is_late else "good", rate_hz, age_s, self.link.note)


class Feed:
    """One source's parser, and the sightings that wait."""

    def __init__(self, spec: SourceSpec, frame: LocalFrame) -> None:
        self.spec = spec
        self.parser = parser_of(spec, frame)
        self.pulse = Pulse()
        self.dropped = 0
        """Number of sightings that were left out in floods and not told yet."""
        self._waiting: deque[Sighting] = deque()
        self._told = 0
        """Number of refusals when they were last told."""

    @property
    def link(self) -> Link:
        """What the source's link or file is doing."""
        return self.pulse.link

    @property
    def refused(self) -> int:
        """Number of messages that could not be used, but for those that are none of a thing that counts."""
        return _faults(self.parser.refused).total()

    def parse(self, data: bytes, now_s: float, peer: Hashable = None) -> list[Sighting]:
        """Return the sightings that bytes of one sender complete; never raises, as what a library does is counted."""
        try:
            return self.parser.feed(data, now_s, peer)
        except Exception as error:  # noqa: BLE001 - a library's fault with bytes from outside must not end the run
            count(self.parser.refused, f"fault of a library: {type(error).__name__}")
            return []

    def hear(self, data: bytes, now_s: float, peer: Hashable = None) -> None:
        """Take in bytes as they came."""
        self.offer(self.parse(data, now_s, peer), now_s)

    def offer(self, sightings: list[Sighting], now_s: float) -> None:
        """Take in sightings that were made elsewhere, as of a recording."""
        if not sightings:
            return
        self.pulse.note(len(sightings), now_s)
        self._waiting.extend(sightings)
        while len(self._waiting) > MOST_WAITING:
            self._waiting.popleft()
            self.dropped += 1

    def detail(self, health: Health, doubted: Counter[str] | None = None) -> str:
        """Return what its link does, and the main reason for which messages, or sightings in them, were not used.

        `doubted` are the numbers of sightings that were read and not believed, by reason.
        """
        reasons = self.parser.refused + (doubted or Counter())
        if not reasons:
            return health.detail
        reason, number = (_faults(reasons) or reasons).most_common(1)[0]
        return f"{health.detail}; {number} {reason}"

    def news(self) -> str | None:
        """Return what could not be read since the last call, in words with the main reason; None if there is nothing.

        It holds the numbers since the beginning.
        """
        faults = _faults(self.parser.refused)
        refused = faults.total()
        if refused == self._told:
            return None
        self._told = refused
        number, reason = max((number, reason) for reason, number in faults.items())
        main = reason if number == refused else f"{number} {reason}"
        return f"{refused} message{'' if refused == 1 else 's'} could not be used: {main}"

    def next(self) -> Sighting | None:
        """Return the sighting that has waited longest, which waits no more."""
        return self._waiting.popleft() if self._waiting else None


def _faults(reasons: Counter[str]) -> Counter[str]:
    """Return the reasons that are a fault of their source, with their numbers."""
    return Counter({reason: number for reason, number in reasons.items() if reason not in LEFT_OUT})
