"""The packed frames of one epoch put together: place, radii and origin are told by different frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from companion.onboard.beliefs import Heard
from companion.protocol.codec import BandEntry, FleetFrame, RadiiEntry, ThreatEntry, ThreatPlace


@dataclass(frozen=True)
class PlacedThreat:
    """Where a threat was heard to be, its radii being told elsewhere."""

    place: ThreatPlace
    rounding_m: float
    heard: Heard


@dataclass(frozen=True)
class JoinedThreat:
    """A threat whose place and radii are both known."""

    threat: ThreatEntry
    band: BandEntry | None
    """None where neither floor nor ceiling was told."""
    heard: Heard


class FleetAssembly:
    """What the fleet, radii and mission frames of one epoch told."""

    def __init__(self) -> None:
        self.placed: dict[int, PlacedThreat] = {}
        """By id; a threat is believed once its radii are known."""
        self.radii: dict[int, RadiiEntry] = {}
        self.origin_told = False
        """Whether the origin was told: until then nobody can say where a fleet frame's places are."""
        self._waiting: dict[int, tuple[FleetFrame, float]] = {}

    def wait(self, frame: FleetFrame, received_s: float) -> None:
        """Keep a fleet frame, as the newest of its index, until the origin is told."""
        self._waiting[frame.stamp.frame_index] = (frame, received_s)

    def take_waiting(self) -> list[tuple[FleetFrame, float]]:
        """Return the fleet frames that waited, each with the time when it came, the oldest first; they wait no more."""
        waiting, self._waiting = self._waiting, {}
        return sorted(waiting.values(), key=lambda item: item[0].stamp.sequence)

    def forget_placed(self, is_gone: Callable[[Heard], bool]) -> None:
        """Forget the places that were heard in broadcasts that are gone."""
        self.placed = {key: placed for key, placed in self.placed.items() if not is_gone(placed.heard)}

    def joined(self, identity: int) -> JoinedThreat | None:
        """Return a threat whose place and radii are known, grown by what it moved before it was told of."""
        placed, radii = self.placed.get(identity), self.radii.get(identity)
        if placed is None or radii is None:
            return None
        place, growth_m = placed.place, placed.rounding_m + radii.speed_bound_m_s * placed.place.age_s
        threat = ThreatEntry(
            id=identity,
            north_m=place.north_m,
            east_m=place.east_m,
            detection_radius_m=radii.detection_radius_m + growth_m,
            attack_radius_m=radii.attack_radius_m + growth_m,
            speed_bound_m_s=radii.speed_bound_m_s,
        )
        reaches_all = radii.floor_m is None and radii.ceiling_m is None
        band = None if reaches_all else BandEntry(identity, radii.floor_m, radii.ceiling_m)
        return JoinedThreat(threat, band, placed.heard)
