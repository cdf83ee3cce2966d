"""What is kept from the hand-over of a vehicle: by it height and place are told from what merely says otherwise.

It begins when the vehicle is handed over in the air, and ends when a person has it again: a wait for a picture, or a
silence as after lost telemetry, is no end, so that what moves meanwhile is noticed too. From one hand-over to the next
of the same flight home is followed: a person who hands over again, as asked to when home has moved, gets no vehicle
that seeks its height above the home that moved.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.autopilot.telemetry import Telemetry
from companion.onboard.position_gate import Track, as_tracked, track_after, track_of
from companion.onboard.references import References, as_handed_over, fallen_m, references_after, references_of


class HandOver(NamedTuple):
    """The frames of reference as at the hand-over, and the track of the vehicle since."""

    references: References
    track: Track


def handed_over(flight: References | None, told: Telemetry, turning_m_s2: float = 0.0) -> HandOver:
    """Return what is kept of a vehicle that is steered from now on; its telemetry has a position.

    `flight` has the references as they were followed before; None: this is the first that is known of the flight.
    `turning_m_s2`: acceleration of the vehicle's turn limit.
    """
    references = references_of(told, 0.0 if flight is None else fallen_m(flight, told))
    return HandOver(references, track_of(told, turning_m_s2))


def flight_after(flight: References | None, told: Telemetry) -> References | None:
    """Return the references of a flight after new telemetry of a vehicle that a person has; None on the ground.

    They begin in the air: until it has taken off an autopilot sets home itself, PX4 with the take-off once more.
    """
    if not told.armed or told.in_air is False:
        return None
    if not math.isfinite(told.height_m) or not math.isfinite(told.altitude_m):
        return flight
    return references_of(told) if flight is None else references_after(flight, told)


def followed(kept: HandOver, told: Telemetry, now_s: float) -> HandOver:
    """Return what is kept after new telemetry, which was received at `now_s`; the same object if nothing changed."""
    references = references_after(kept.references, told)
    track = track_after(kept.track, told, now_s)
    if references is kept.references and track is kept.track:
        return kept
    return HandOver(references, track)


def believed_before(flight: References | None, told: Telemetry) -> Telemetry:
    """Return the telemetry as it will be believed if the vehicle is handed over now; see `handed_over`."""
    home_m = 0.0 if flight is None else fallen_m(flight, told)
    return as_handed_over(references_of(told, home_m), told) if home_m else told


def believed(kept: HandOver, told: Telemetry) -> Telemetry:
    """Return the telemetry as it is believed: by the references of the hand-over, and without positions that jump."""
    return as_tracked(kept.track, as_handed_over(kept.references, told))
