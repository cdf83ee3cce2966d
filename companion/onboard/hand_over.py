"""What is kept from the hand-over of a vehicle: by it height and place are told from what merely says otherwise.

It begins when the vehicle is handed over in the air, and ends when a person has it again: a wait for a picture, or a
silence as after lost telemetry, is no end, so that what moves meanwhile is noticed too.
"""

from __future__ import annotations

from typing import NamedTuple

from companion.autopilot.telemetry import Telemetry
from companion.onboard.position_gate import Track, as_tracked, track_after, track_of
from companion.onboard.references import References, as_handed_over, references_after, references_of


class HandOver(NamedTuple):
    """The frames of reference as at the hand-over, and the track of the vehicle since."""

    references: References
    track: Track


def handed_over(told: Telemetry) -> HandOver:
    """Return what is kept of a vehicle that is steered from now on; its telemetry has a position."""
    return HandOver(references_of(told), track_of(told))


def followed(kept: HandOver, told: Telemetry, now_s: float) -> HandOver:
    """Return what is kept after new telemetry, which was received at `now_s`; the same object if nothing changed."""
    references = references_after(kept.references, told)
    track = track_after(kept.track, told, now_s)
    if references is kept.references and track is kept.track:
        return kept
    return HandOver(references, track)


def believed(kept: HandOver, told: Telemetry) -> Telemetry:
    """Return the telemetry as it is believed: by the references of the hand-over, and without positions that jump."""
    return as_tracked(kept.track, as_handed_over(kept.references, told))
