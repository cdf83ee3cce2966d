"""What live sources say and is not believed, or not taken in: counted by source, and told in a line each.

The table of causes is bounded (groundstation/refusals.py), and so are the words, which hold keys from outside.
"""

from __future__ import annotations

from collections import Counter, defaultdict

from groundstation.plausibility import Verdict, Weighed
from groundstation.refusals import Refusals
from groundstation.sources.thing import SourceKey

_REASONS = {
    "ahead": "stamped in the future",
    "behind": "stamped too long ago",
    Verdict.BEYOND.value: "farther away than anything flies in the time",
    Verdict.JUMP.value: "jumped, and not confirmed",
    "too fast": "faster than anything of its kind",
    "too far": "too far from the mission",
    "claimed": "of what another source sees too",
    "declined": "not taken in by the ground station",
}
"""Words for the causes."""


class Doubts:
    """Counts and tells what is doubted of all sources of a run."""

    def __init__(self) -> None:
        self.refused: Counter[str] = Counter()
        """Number of sightings that were not believed, by source."""
        self.reasons: defaultdict[str, Counter[str]] = defaultdict(Counter)
        """The same by source and reason."""
        self._refusals = Refusals()

    def news(self, now_s: float) -> list[str]:
        """Return the lines that are due."""
        return self._refusals.news(now_s)

    def ahead(self, source: str, by_s: float, most_s: float) -> None:
        """Note a sighting that is stamped in the future."""
        clock = f"its clock is {by_s:.1f} s ahead of this computer's; allowed: {most_s:g} s"
        self._refuse(source, "ahead", f"{{}} sightings refused, stamped in the future: {clock}")

    def behind(self, source: str, by_s: float, most_s: float) -> None:
        """Note a sighting that is stamped too long ago."""
        clock = f"they are old, or its clock is {by_s:.1f} s behind; allowed: {most_s:g} s"
        self._refuse(source, "behind", f"{{}} sightings refused, stamped too long ago: {clock}")

    def unlikely(self, key: SourceKey, weighed: Weighed, fastest_m_s: float) -> None:
        """Note a sighting that the gate of a thing did not let through; one that is merely late is no fault."""
        if weighed.verdict is Verdict.BEYOND:
            why = f"was seen {weighed.off_m:.0f} m from where {fastest_m_s:g} m/s can take it"
        elif weighed.verdict is Verdict.JUMP:
            why = f"jumped {weighed.off_m:.0f} m: believed when confirmed"
        else:
            return
        self._refuse(key.source, weighed.verdict.value, f"{{}} sightings not believed; {_plain(key.key)} {why}")

    def too_fast(self, key: SourceKey, told_m_s: float, most_m_s: float) -> None:
        """Note a sighting that tells a velocity that no thing of its category has."""
        words = f"{{}} sightings not believed; {_plain(key.key)} tells {told_m_s:.0f} m/s; allowed: {most_m_s:g} m/s"
        self._refuse(key.source, "too fast", words)

    def too_far(self, key: SourceKey, away_m: float, most_m: float) -> None:
        """Note a sighting of an agent that is nowhere near the mission."""
        where = f"{_plain(key.key)} is {away_m / 1e3:.1f} km from the mission; allowed: within_m {most_m:g}"
        self._refuse(key.source, "too far", f"{{}} sightings of agents not believed; {where}")

    def claimed(self, key: SourceKey, other: str, apart_m: float) -> None:
        """Note a sighting of a thing whose place another source says, `apart_m` from this one."""
        differ = f"the two differ by {apart_m:.0f} m"
        words = f"{{}} sightings left out of {_plain(key.key)}, which {_plain(other)} sees too: {differ}"
        self._refuse(key.source, "claimed", words)

    def stranger(self, key: SourceKey) -> None:
        """Note a sighting of an agent that the mission does not have."""
        self._tell(key.source, "unknown", f"{{}} sightings of agents that the mission lacks, such as {_plain(key.key)}")

    def flooded(self, source: str, most: int) -> None:
        """Note that a thing was forgotten, as a source sees too many."""
        self._tell(source, "flood", f"more than {most} things at once: {{}} forgotten; allowed: a greater most")

    def overrun(self, source: str, number: int) -> None:
        """Note that sightings were left out, as more come than are weighed."""
        self.refused[source] += number
        self._tell(
            source, "overrun", f"more sightings than can be weighed: the oldest left out, {number} now ({{}} times)"
        )

    def full(self, source: str, left: int, most: int) -> None:
        """Note that things were left out of a picture that has enough of a source's."""
        words = f"{left} things left out, as {most} are in the picture; allowed: a greater most ({{}} times)"
        self._tell(source, "full", words)

    def declined(self, source: str, why: str) -> None:
        """Note that the ground station did not do what a source asked."""
        self._refuse(source, "declined", f"not taken in, {{}} times: {_plain(why)}")

    def unread(self, source: str, words: str) -> None:
        """Note that messages of a source could not be used; `words` say how many there were, and why."""
        self._tell(source, "unread", _plain(words))

    def _refuse(self, source: str, cause: str, words: str) -> None:
        self.refused[source] += 1
        self.reasons[source][_REASONS.get(cause, cause)] += 1
        self._tell(source, cause, words)

    def _tell(self, source: str, cause: str, words: str) -> None:
        self._refusals.add((source, cause), f"{_plain(source)}: {words}")


def _plain(text: str) -> str:
    """Return a text from outside without the braces that would stand for a number."""
    return text.replace("{", "(").replace("}", ")")
