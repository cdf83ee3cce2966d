"""What becomes of a source's things, by its section of the mission and by what things of their category do."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

from companion.mission.sources import SourceKind, SourceSpec
from companion.mission.values import MAX_THREAT_SPEED_M_S
from groundstation.filter import LONGEST_S, Noise
from groundstation.plausibility import Bound
from groundstation.sources.sighting import Category, Sighting

_FASTER = 1.25
"""Least ratio of a bound to the velocity that is told, so that not every gust of wind makes a new bound."""
_FASTER_STILL, _STEP_M_S = 1.15, 25.0
"""Ratio, and the step in which bounds are made, above the greatest bound of a category."""
AHEAD_S = 2.0
"""Greatest time by which a sighting may be stamped ahead of this computer's clock, as of a sensor's detections."""


class Traits(NamedTuple):
    """What things of a category do. Chosen with margin; the fastest of each kind are above what is in common use."""

    bounds_m_s: tuple[float, ...]
    """Speed bounds that are told, so few that one that climbs out makes few; the last is that of one that does not tell
    its velocity."""
    fastest_m_s: float
    """Speed above which a way between two sightings is no thing's."""
    acceleration_m_s2: float
    timeout_s: float
    """Time without a sighting after which it is retired."""


TRAITS = {
    Category.AIRCRAFT: Traits((100.0, 255.0), 700.0, 30.0, 30.0),
    Category.SHIP: Traits((15.0, 25.0), 60.0, 3.0, 600.0),
    Category.VEHICLE: Traits((20.0, 50.0), 150.0, 10.0, 60.0),
}
"""Aircraft tell where they are twice a second, and sailing ships every three minutes while they are moored."""


class _OfKind(NamedTuple):
    """What is assumed of a kind of source."""

    category: Category
    """Category of things whose own is not told."""
    error_m: float
    """Greatest error of a sighting, with what the thing moves while it is under way to here."""
    behind_s: float
    """Greatest age of a sighting."""
    confirmed_by: int
    """Number of sightings that agree before a thing is taken in."""


_OF_KIND: dict[SourceKind, _OfKind] = {
    "telemetry": _OfKind(Category.VEHICLE, 30.0, 30.0, 1),
    "adsb": _OfKind(Category.AIRCRAFT, 200.0, 35.0, 2),
    "basestation": _OfKind(Category.AIRCRAFT, 200.0, 30.0, 2),
    "ais": _OfKind(Category.SHIP, 100.0, 90.0, 2),
    "cot": _OfKind(Category.VEHICLE, 50.0, 60.0, 1),
    "csv": _OfKind(Category.AIRCRAFT, 30.0, 30.0, 1),
    "jsonl": _OfKind(Category.AIRCRAFT, 30.0, 30.0, 1),
    "sensor": _OfKind(Category.VEHICLE, 30.0, 30.0, 3),
}
"""A receiver of ADS-B hears an aircraft's checked frames, but a bit error in 1 of 2^24 passes; so two must agree."""
_NAMESPACES: dict[SourceKind, str] = {"adsb": "icao", "basestation": "icao", "ais": "mmsi", "cot": "uid"}
"""Kinds whose keys are the same wherever they are heard; those of others are their own."""


@dataclass(frozen=True)
class Rules:
    """The rules of one source."""

    spec: SourceSpec

    @cached_property
    def ids(self) -> dict[str, int]:
        """Ids by keys as the source's parser writes them."""
        return {self._key(key): identity for key, identity in self.spec.ids.items()}

    @cached_property
    def ignored(self) -> frozenset[str]:
        """Keys that are never taken in."""
        return frozenset(map(self._key, self.spec.ignore))

    def _key(self, key: str) -> str:
        # Addresses are written in either case.
        return key.upper() if self.spec.kind in ("adsb", "basestation") else key

    @property
    def behind_s(self) -> float:
        """Greatest age of a sighting when it comes in."""
        return _OF_KIND[self.spec.kind].behind_s

    @property
    def is_stamped(self) -> bool:
        """Whether its sightings have the times of its own clock, and not those of arrival here."""
        return self.spec.kind == "cot"

    @property
    def confirmed_by(self) -> int:
        """Number of sightings that agree before a thing is taken in."""
        return _OF_KIND[self.spec.kind].confirmed_by

    def claim(self, key: str) -> tuple[str, str]:
        """Return by what a thing is known to be the same one that another source sees."""
        return _NAMESPACES.get(self.spec.kind, f"source {self.spec.name}"), key

    def category(self, sighting: Sighting) -> Category:
        """Return what a thing is."""
        return sighting.category or _OF_KIND[self.spec.kind].category

    def timeout_s(self, category: Category) -> float:
        """Return the time without a sighting after which a thing is retired."""
        return self.spec.timeout_s or TRAITS[category].timeout_s

    def bound(self, sighting: Sighting, since_s: float) -> Bound:
        """Return how fast a thing may be and how well it is seen, `since_s` after it was seen before."""
        traits = TRAITS[self.category(sighting)]
        error_m = self.spec.error_m or max(sighting.error_m or 0.0, _OF_KIND[self.spec.kind].error_m)
        fastest_m_s = max(traits.fastest_m_s, self.spec.speed_bound_m_s or 0.0)
        noise = Noise(error_m, traits.acceleration_m_s2)
        # After longer, constant velocity expects nothing, and the fastest way there is all that is known.
        return Bound(fastest_m_s, noise, is_gated=since_s <= LONGEST_S)

    def speed_bound_m_s(self, category: Category, speed_m_s: float | None) -> float:
        """Return the speed bound of a thing that tells a speed, or none."""
        given_m_s, bounds_m_s = self.spec.speed_bound_m_s, TRAITS[category].bounds_m_s
        if speed_m_s is None:
            return given_m_s or bounds_m_s[-1]
        if given_m_s is not None and speed_m_s <= given_m_s:
            return given_m_s
        for bound_m_s in bounds_m_s:
            if _FASTER * speed_m_s <= bound_m_s:
                return bound_m_s
        still_m_s = math.ceil(_FASTER_STILL * speed_m_s / _STEP_M_S) * _STEP_M_S
        return min(max(bounds_m_s[-1], still_m_s), MAX_THREAT_SPEED_M_S)

    def is_high_or_low(self, sighting: Sighting, margin_m: float) -> bool:
        """Return whether a thing is above the ceiling or below the floor by more than its datum's error and a margin.

        One that does not tell its height is at none that could be left out.
        """
        if sighting.altitude_m is None:
            return False
        slack_m = sighting.datum.value + margin_m
        floor_m, ceiling_m = self.spec.floor_m, self.spec.ceiling_m
        is_low = floor_m is not None and sighting.altitude_m + slack_m < floor_m
        return is_low or (ceiling_m is not None and sighting.altitude_m - slack_m > ceiling_m)
