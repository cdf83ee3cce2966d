"""Assembly of the packed frames of one picture: a threat's place, its radii and the origin come in different frames."""

from __future__ import annotations

from dataclasses import dataclass

from companion.onboard.beliefs import Heard, put
from companion.protocol.codec import BandEntry, FleetFrame, RadiiEntry, ThreatEntry, ThreatPlace


@dataclass(frozen=True)
class PlacedThreat:
    """The place of a threat from a fleet frame, which does not tell its radii."""

    place: ThreatPlace
    rounding_m: float
    """Greatest error of the place by rounding in the frame."""
    heard: Heard


@dataclass(frozen=True)
class JoinedThreat:
    """A threat whose place and radii are both known."""

    threat: ThreatEntry
    band: BandEntry | None
    """Floor and ceiling; None for a threat that has neither."""
    heard: Heard


class FleetAssembly:
    """Content of the fleet, radii and mission frames of one picture, kept until it can be put together."""

    def __init__(self, origin_told: bool = False) -> None:
        self.placed: dict[int, PlacedThreat] = {}
        """Places of threats, by id; a threat enters the picture once its radii are known, too."""
        self.radii: dict[int, RadiiEntry] = {}
        self.origin_told = origin_told
        """Whether the epoch's origin was heard: without it the places in a fleet frame cannot be used."""
        self._waiting: dict[int, tuple[FleetFrame, float]] = {}

    def place(self, threat: PlacedThreat) -> None:
        """Take the newest place of a threat."""
        put(self.placed, threat.place.id, threat)

    def size(self, threat: RadiiEntry) -> None:
        """Take the newest radii of a threat."""
        put(self.radii, threat.id, threat)

    def wait(self, frame: FleetFrame, received_s: float) -> None:
        """Keep a fleet frame until the origin is heard; it replaces an older one of the same index."""
        self._waiting[frame.stamp.frame_index] = (frame, received_s)

    def take_waiting(self) -> list[tuple[FleetFrame, float]]:
        """Return the fleet frames that waited, each with the time when it came, the oldest first; keep none of them."""
        waiting, self._waiting = self._waiting, {}
        return sorted(waiting.values(), key=lambda item: item[0].stamp.sequence)

    def joined(self, identity: int) -> JoinedThreat | None:
        """Return a threat whose place and radii are both known, or None.

        Its radii are enlarged by the rounding of the place and by what the threat may have moved until it was sent.
        """
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
