"""Deciding which frames of the broadcast are new, by epoch, by sequence and by their part of one broadcast."""

from __future__ import annotations

import math
from enum import Enum

from companion.protocol.freshness import overtaken
from companion.protocol.messages import Stamp


class Acceptance(Enum):
    """Whether a frame is used, and whether it begins an epoch."""

    REFUSED = "refused"
    """The frame is old or a copy, and is not used."""
    NEXT = "next"
    """The frame continues the epoch."""
    ANEW = "anew"
    """The frame begins an epoch, or begins it again after a long silence: what held for the last one is void."""


class FrameOrder:
    """Follows the stamps of one ground station's broadcasts; the caller gives the times, by this vehicle's clock."""

    def __init__(self) -> None:
        self.epoch_s: int | None = None
        self.sequence = -1
        """Sequence of the newest broadcast of this epoch; -1 before any."""
        self._received_s = -math.inf
        self._parts: set[int] = set()
        """Indices of those frames of the newest broadcast that were heard."""
        self._motion_order = self._bands_order = (-1, -1)
        """Sequence and time of the newest motion frame and of the newest bands frame."""

    def take_part(self, stamp: Stamp, now_s: float) -> Acceptance:
        """Return whether a state or fleet frame, which is one part of its broadcast, is new; if so, note its stamp."""
        acceptance = self._accept(stamp, now_s)
        if acceptance is Acceptance.REFUSED:
            return acceptance
        if stamp.sequence > self.sequence:
            self._parts = set()
        elif stamp.frame_index in self._parts:
            return Acceptance.REFUSED
        self.sequence = stamp.sequence
        self._parts.add(stamp.frame_index)
        self._received_s = now_s
        return acceptance

    def take_constant(self, stamp: Stamp, now_s: float) -> Acceptance:
        """Return whether a frame whose content holds for an epoch is of this or a new one; if new, note its stamp."""
        if stamp.epoch_s == self.epoch_s:
            return Acceptance.NEXT
        acceptance = self._accept(stamp, now_s)
        if acceptance is not Acceptance.REFUSED:
            self._received_s = now_s
        return acceptance

    def take_motion(self, stamp: Stamp) -> bool:
        """Return whether a motion frame is of this epoch and not older than the last one; if so, note its stamp."""
        if self._is_behind(stamp, self._motion_order):
            return False
        self._motion_order = (stamp.sequence, stamp.time_ms)
        return True

    def take_bands(self, stamp: Stamp) -> bool:
        """Return whether a bands frame is of this epoch and not older than the last one; if so, note its stamp."""
        if self._is_behind(stamp, self._bands_order):
            return False
        self._bands_order = (stamp.sequence, stamp.time_ms)
        return True

    def is_whole(self, stamp: Stamp) -> bool:
        """Return whether every frame of the newest broadcast was heard; `stamp` is that of one of them."""
        return len(self._parts) == stamp.frame_count

    def _is_behind(self, stamp: Stamp, newest: tuple[int, int]) -> bool:
        if stamp.epoch_s != self.epoch_s or stamp.sequence < self.sequence:
            return True
        return (stamp.sequence, stamp.time_ms) < newest

    def _accept(self, stamp: Stamp, now_s: float) -> Acceptance:
        silent_s = now_s - self._received_s
        if self.epoch_s is not None and overtaken(stamp, (self.epoch_s, self.sequence), silent_s) is not None:
            return Acceptance.REFUSED
        if stamp.epoch_s == self.epoch_s and stamp.sequence >= self.sequence:
            return Acceptance.NEXT
        self.epoch_s = stamp.epoch_s
        self.sequence = -1
        self._parts = set()
        self._motion_order = self._bands_order = (-1, -1)
        return Acceptance.ANEW
