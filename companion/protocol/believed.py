"""Which broadcasts were believed already, so that none is believed twice: not after a restart, nor after a leap.

A broadcast is known by its epoch and sequence, of which only newer ones are believed. Where the vehicle's clock is not
compared with the stamps, one that leapt far ahead must not shut all others out for good: what was believed is then kept
as spans, and after a silence an older broadcast may begin anew if it lies in none of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from companion.protocol.frame import FrameStamp
from companion.protocol.freshness import LEAP_S, OLD_EPOCH, OLD_SEQUENCE, overtaken

BEFORE_START = "sent before this program's start"

MOST_SPANS = 16
"""Greatest number of spans kept; beyond it two that lie beside each other become one, with what lies between them."""
LEAP_BROADCASTS = 1000
"""Number of broadcasts by which the sequence may be ahead of what a second-long silence explains, in one run."""
MOST_BROADCASTS_PER_S = 100.0
"""Greatest rate of broadcasts; the fastest mission has ten a second."""
UNSAVED_S = 5.0
"""Time by the sender's clock about that of the newest saved broadcast in which others may have been believed that were
not saved: a change is saved within a second of the save before it, a disk may take a while, and a clock be set."""

Key = tuple[int, int]
"""Epoch and sequence of a broadcast."""


class Span(NamedTuple):
    """The broadcasts from one to another, both included, of which some or all were believed."""

    first: Key
    last: Key


@dataclass(frozen=True)
class Kept:
    """What is known of the broadcasts believed by the programs before this one."""

    newest: Key | None = None
    """The one believed last."""
    newest_unix_s: float | None = None
    """Its time by the sender's clock, in Unix seconds."""
    spans: tuple[Span, ...] = ()
    is_open: bool = False
    """Whether the program that kept this ran on after it, so that it may have believed more."""


class Rules(NamedTuple):
    """What of the trust settings the order of broadcasts depends on."""

    keyed: bool
    """Whether keys authenticate the broadcast; if not, anybody can make one, and nothing keeps a recording out."""
    centre_only: bool
    """Whether only the ground station can make a broadcast (Ed25519)."""
    clock_checked: bool
    ahead_s: float
    """Greatest time that a stamp may be ahead of the vehicle's clock."""


class BelievedBroadcasts:
    """Decides which broadcasts are new. All times are Unix seconds by the vehicle's clock, but for the stamps."""

    def __init__(self, rules: Rules, kept: Kept | None) -> None:
        """Start from what was kept; None: no program before this one has believed anything."""
        self._rules = rules
        self._kept = kept or Kept()
        self._restarted = kept is not None
        self._newest = self._kept.newest
        self._newest_unix_s = self._kept.newest_unix_s
        self._closed = self._kept.spans
        self._open: Span | None = None
        """The span that the newest broadcast extends; None before this program believed any."""
        self._began_s: float | None = None
        """Time of the first call."""
        self._quiet_since_s = -math.inf
        """Time at which the last frame was believed; before any was, that of the first call."""

    @property
    def kept(self) -> Kept:
        """What to keep over a restart; complete if nothing is believed after it."""
        spans = self._closed if self._open is None else (*self._closed, self._open)
        return Kept(self._newest, self._newest_unix_s, tuple(sorted(spans)))

    def begin(self, now_s: float) -> None:
        """Note the time of a call; the first one is when this program began to listen."""
        if self._began_s is None:
            self._began_s = self._quiet_since_s = now_s

    def silent(self, now_s: float) -> bool:
        """Return whether nothing was believed for so long that an older broadcast may begin anew."""
        return overtaken(FrameStamp(0, 0, 0), (1, 0), now_s - self._quiet_since_s) is None

    def refusal(self, stamp: FrameStamp, now_s: float) -> str | None:
        """Return the reason why a frame is refused as old, None if it is of the newest broadcast or a newer one."""
        key = (stamp.epoch_s, stamp.sequence)
        if self._may_be_unsaved(stamp.unix_s):
            return BEFORE_START
        if self._newest is None:
            return None
        if self._was_believed(key):
            return OLD_EPOCH if key[0] < self._newest[0] else OLD_SEQUENCE
        # Of the newest broadcast more frames may come, but not after a restart: which ones came before is not known.
        least = self._newest if self._open is not None else (self._newest[0], self._newest[1] + 1)
        silent_s = now_s - self._quiet_since_s if self._may_begin_anew(stamp.unix_s) else 0.0
        return overtaken(stamp, least, silent_s)

    def is_newest(self, stamp: FrameStamp) -> bool:
        """Return whether a frame is of the broadcast believed last, of which single frames may be repeated."""
        return (stamp.epoch_s, stamp.sequence) == self._newest

    def note(self, stamp: FrameStamp, now_s: float) -> None:
        """Note a broadcast of which a frame is believed."""
        key = (stamp.epoch_s, stamp.sequence)
        if self._continues(key, stamp.unix_s, now_s - self._quiet_since_s):
            assert self._open is not None
            self._open = Span(self._open.first, key)
        else:
            if self._open is not None:
                self._closed = _bounded((*self._closed, self._open), key)
            self._open = Span(key, key)
        self._newest, self._newest_unix_s, self._quiet_since_s = key, stamp.unix_s, now_s

    def _may_be_unsaved(self, unix_s: float) -> bool:
        """Return whether a program before this one may have believed a frame of a stamp without having saved that."""
        if not (self._rules.keyed and self._restarted) or self._began_s is None:
            return False
        if self._rules.clock_checked:
            # Whatever was believed before was stamped at most `ahead_s` after its arrival.
            return unix_s < self._began_s + (self._rules.ahead_s if self._kept.is_open else 0.0)
        saved_s = self._kept.newest_unix_s
        return self._kept.is_open and saved_s is not None and abs(unix_s - saved_s) <= UNSAVED_S

    def _was_believed(self, key: Key) -> bool:
        """Return whether a broadcast lies in a span; of the newest broadcast of all more frames may come."""
        if self._rules.clock_checked or not self._rules.keyed:
            # There the clock, or MAVLink's time, keeps out what an older stamp would let in.
            return False
        if any(span.first <= key <= span.last for span in self._closed):
            return True
        return self._open is not None and self._open.first <= key < self._open.last

    def _may_begin_anew(self, unix_s: float) -> bool:
        """Return whether a silence lets in a stamp older than the newest.

        Where others than the ground station can make a frame, one stamped ahead must not shut it out for good. Where
        only the ground station can, its clock must have been wrong: the newest stamp was far ahead of this one.
        """
        if not self._rules.centre_only:
            return True
        newest_s = self._newest_unix_s
        return not self._rules.clock_checked and newest_s is not None and unix_s < newest_s - LEAP_S

    def _continues(self, key: Key, unix_s: float, passed_s: float) -> bool:
        """Return whether a broadcast follows on the newest one as the time that has passed explains."""
        if self._open is None or self._newest_unix_s is None or key < self._open.last:
            return False
        if unix_s - self._newest_unix_s > passed_s + LEAP_S:
            return False
        (epoch_s, sequence), (newest_epoch_s, newest_sequence) = key, self._open.last
        most = LEAP_BROADCASTS + MOST_BROADCASTS_PER_S * max(0.0, passed_s)
        return epoch_s != newest_epoch_s or sequence - newest_sequence <= most


def _bounded(spans: Iterable[Span], newest: Key) -> tuple[Span, ...]:
    """Return at most MOST_SPANS that hold the same; two neighbours without the newest broadcast between become one."""
    kept = sorted(spans)
    while len(kept) > MOST_SPANS:
        at = next(at for at in range(len(kept) - 1) if not kept[at].last < newest < kept[at + 1].first)
        kept[at : at + 2] = [Span(kept[at].first, max(kept[at].last, kept[at + 1].last))]
    return tuple(kept)
