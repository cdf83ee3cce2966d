"""Where the places in the ground station's picture come from, and how often one jumped beyond its bound."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from companion.protocol.codec import Kind
from groundstation.sightings import Key

MISSION, SENSOR, REPORT, LAST_RUN = "mission", "sensor", "report", "last run"
"""Names of the sources that are always there: the mission's own word, the sensor's link, reports, and what was kept."""
SEEN_S = 5.0
"""Age up to which the position of an agent that somebody saw counts as where it is; an older one is dead-reckoned."""


MOST_UNKNOWN = 64
"""Greatest number of unknown things that are remembered."""


REPORTS = 10
"""Number of an agent's last reports by which its link is estimated."""
MOST_STRANGERS = 256
"""Greatest number of sightings of unknown things that wait: more than one datagram has."""


class Observation(NamedTuple):
    """Where a live source has an agent, target or threat; the source has judged by itself whether that can be."""

    kind: Kind
    id: int
    place: complex
    """North + i east on the mission's plane, in m."""
    velocity: complex
    """Along the axes of the plane, in m/s; 0 where none is told."""
    at_s: float
    """Time at which it was there, by the clock of the ground station."""
    error_m: float
    source: str


class Unknown(NamedTuple):
    """Something that a source sees and the mission does not have."""

    source: str
    place: complex
    at_s: float
    times: int
    """Number of its sightings."""


class Stranger(NamedTuple):
    """One sighting by the sensor of something that the mission does not have."""

    key: Key
    place: complex
    velocity: complex
    at_s: float


@dataclass
class Origins:
    """Sources of the present places."""

    by: dict[Key, str] = field(default_factory=dict)
    """Name of the source of a thing's place, by kind and id; none: the mission's word."""
    error_m: dict[Key, float] = field(default_factory=dict)
    """Greatest error of a thing's place, where its source tells one."""
    seen_at_s: dict[int, float] = field(default_factory=dict)
    """Time at which an agent was last seen by anybody, by its id."""
    reported: set[int] = field(default_factory=set)
    """Ids of the agents whose last word on where they are is a report of their own."""
    report_times_s: dict[int, deque[float]] = field(default_factory=dict)
    """Times of an agent's last REPORTS + 1 reports, by its id."""
    unknown: dict[Key, Unknown] = field(default_factory=dict)
    """What the sensor sees and the mission does not have, by kind and id; the last MOST_UNKNOWN of them."""
    strangers: deque[Stranger] = field(default_factory=lambda: deque(maxlen=MOST_STRANGERS))
    """Sightings of those that nobody has looked at yet."""
    jumps: int = 0
    """How often a threat was seen, or placed, farther away than its bound allows, which vehicles rely on."""

    def note(self, key: Key, source: str, at_s: float, error_m: float) -> None:
        """Note who has seen a thing at a time."""
        self.by[key], self.error_m[key] = source, error_m
        if key[0] is Kind.AGENT:
            self.reported.discard(key[1])
            self.seen_at_s[key[1]] = max(at_s, self.seen_at_s.get(key[1], -math.inf))

    def report(self, agent_id: int, at_s: float) -> None:
        """Note that an agent has reported where it was at a time."""
        self.reported.add(agent_id)
        self.report_times_s.setdefault(agent_id, deque(maxlen=REPORTS + 1)).append(at_s)

    def heard_share(self, agent_id: int, period_s: float, now_s: float) -> float | None:
        """Return the share of an agent's last reports, one in each period, that came; None before the second is due."""
        times_s = self.report_times_s.get(agent_id, ())
        due = 0 if not times_s else min(REPORTS, math.floor((now_s - times_s[0]) / period_s))
        if due < 1:
            return None
        return min(1.0, sum(now_s - at_s <= due * period_s for at_s in times_s) / due)

    def meet(self, stranger: Stranger) -> None:
        """Note a thing that the sensor sees and the mission does not have."""
        key = stranger.key
        known = self.unknown.pop(key, None)
        self.unknown[key] = Unknown(SENSOR, stranger.place, stranger.at_s, 1 if known is None else known.times + 1)
        self.strangers.append(stranger)
        if len(self.unknown) > MOST_UNKNOWN:
            del self.unknown[next(iter(self.unknown))]

    def forget(self, key: Key) -> None:
        """Forget a thing, or that its place was not the mission's word."""
        self.by.pop(key, None)
        self.error_m.pop(key, None)

    def is_seen(self, agent_id: int, now_s: float) -> bool:
        """Return whether an agent is where somebody has just seen it."""
        return now_s - self.seen_at_s.get(agent_id, -math.inf) <= SEEN_S
