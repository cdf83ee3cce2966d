"""Which frames of the broadcast are new: by epoch, sequence, and part of one broadcast."""

from __future__ import annotations

import math
from enum import Enum

from companion.protocol.freshness import overtaken
from companion.protocol.messages import Stamp


class Acceptance(Enum):
    """What becomes of a frame."""

    REFUSED = "refused"
    NEXT = "next"
    """It goes on from what was heard."""
    ANEW = "anew"
    """It begins an epoch, or begins one again after a long silence: what was told of the last one is over."""


class FrameOrder:
    """Follows the stamps of one ground station's broadcasts. Times are this vehicle's clock, given by the caller."""

    def __init__(self) -> None:
        self.epoch_s: int | None = None
        self.sequence = -1
        """Of the newest broadcast of this epoch; -1 before any."""
        self._received_s = -math.inf
        self._parts: set[int] = set()
        """Indices of the frames heard of the newest broadcast."""
        self._motion_order = self._bands_order = (-1, -1)
        """Sequence and time of the newest motion frame and of the newest bands frame."""

    def take_part(self, stamp: Stamp, now_s: float) -> Acceptance:
        """Take a state or fleet frame, which is a part of its broadcast."""
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
        """Take a frame that tells what does not change within an epoch."""
        if stamp.epoch_s == self.epoch_s:
            return Acceptance.NEXT
        acceptance = self._accept(stamp, now_s)
        if acceptance is not Acceptance.REFUSED:
            self._received_s = now_s
        return acceptance

    def take_motion(self, stamp: Stamp) -> bool:
        """Return whether a motion frame is of this epoch and not overtaken."""
        if self._is_behind(stamp, self._motion_order):
            return False
        self._motion_order = (stamp.sequence, stamp.time_ms)
        return True

    def take_bands(self, stamp: Stamp) -> bool:
        """Return whether a bands frame is of this epoch and not overtaken."""
        if self._is_behind(stamp, self._bands_order):
            return False
        self._bands_order = (stamp.sequence, stamp.time_ms)
        return True

    def is_whole(self, stamp: Stamp) -> bool:
        """Return whether every part of the newest broadcast was heard; `stamp` is of one of them."""
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
