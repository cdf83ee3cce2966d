"""Which picture of the threats is in force, and what was heard of it: whole, or how many threats are missing."""

from __future__ import annotations

from collections.abc import Iterable

from companion.mission.values import MAX_ITEMS
from companion.protocol.messages import REVISIONS


class Picture:
    """Follows the revisions that the frames of one epoch name, and the threats heard of the newest one.

    A picture is whole once as many threats were heard of its revision as it has. Nothing that was heard of an earlier
    revision counts, unless the same mission digest says that the threats are the same ones.
    """

    def __init__(self) -> None:
        self.revision: int | None = None
        """Number of the picture; None before any frame of the epoch."""
        self._sequence = -1
        """Sequence of the newest broadcast of the epoch of which a frame was followed."""
        self._threats: int | None = None
        """Number of its threats; None while that was not heard."""
        self._heard: set[int] = set()
        """Ids of the threats heard of it."""
        self._digest: bytes | None = None
        """Mission digest of the picture; None while no mission frame named one."""
        self._digest_before: bytes | None = None
        self._heard_before: set[int] = set()
        """Ids of the threats whose newest word is of the picture that had `_digest_before`."""
        self._was_whole = False
        """Whether any picture was whole before."""
        self._too_many = False
        """Whether it has more threats than can be known."""

    @property
    def whole(self) -> bool:
        """Whether every threat of the picture was heard."""
        return self._threats is not None and len(self._heard) >= self._threats and not self._too_many

    @property
    def missing(self) -> str | None:
        """What of the picture was not heard yet, in words; None if it is whole or nothing at all was heard."""
        if self.revision is None or self.whole:
            return None
        if self._too_many:
            return f"more than {MAX_ITEMS} threats"
        new = "new revision: " if self._was_whole else ""
        if self._threats is None:
            return f"{new}{len(self._heard)} threats heard, of how many is not known"
        return f"{new}{len(self._heard)} of {self._threats} threats heard"

    def begin_epoch(self) -> None:
        """Begin an epoch, whose revisions have nothing to do with those before."""
        self._begin(None)
        self._sequence = -1

    def follow(self, revision: int, sequence: int) -> bool:
        """Note revision and sequence of a frame of this epoch; return whether its picture is another one.

        A frame of an old picture must not be given: see `is_old`. Where so many broadcasts were missed that the number
        of the revision may have come round, the picture counts as another one.
        """
        missed = sequence - self._sequence
        self._sequence = max(self._sequence, sequence)
        if revision == self.revision and missed < REVISIONS:
            return False
        self._begin(revision)
        return True

    def is_old(self, revision: int, sequence: int) -> bool:
        """Return whether the picture of a frame of this epoch was overtaken by the one in force.

        All frames of a broadcast are of one revision, and at most one begins with each, so that the number is the same
        only for the same revision unless REVISIONS broadcasts lie between.
        """
        behind = self._sequence - sequence
        return behind > 0 and (revision != self.revision or behind >= REVISIONS)

    def count(self, threats: int) -> None:
        """Note how many threats the picture has."""
        self._threats = threats
        self._was_whole |= self.whole

    def hear(self, threat_ids: Iterable[int]) -> None:
        """Note that threats of the picture were heard."""
        self._heard.update(threat_ids)
        self._heard_before.difference_update(self._heard)
        self._was_whole |= self.whole

    def overflow(self) -> None:
        """Note that the picture has more threats than can be known, so that it will never be whole."""
        self._too_many = True

    def name(self, digest: bytes) -> bool:
        """Note the mission digest of the picture; return whether the picture before had another one.

        If it had the same, what was heard of it counts.
        """
        self._digest = digest
        if digest == self._digest_before:
            self.hear(self._heard_before.copy())
        return self._digest_before not in (None, digest)

    def forget(self) -> None:
        """Forget which threats were heard: their places are of no use any more."""
        self._heard.clear()
        self._heard_before.clear()

    def has_heard(self, threat_id: int) -> bool:
        """Return whether a threat of the picture was heard."""
        return threat_id in self._heard

    def _begin(self, revision: int | None) -> None:
        if self._digest is not None:
            self._digest_before, self._heard_before = self._digest, self._heard
        self.revision, self._threats, self._digest = revision, None, None
        self._heard = set()
        self._too_many = False
