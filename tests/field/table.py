"""All field situations, by area, and their table as docs/field.md shows it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from tests.field import causes, check, estimate, files, gate, ground, ground_shell, link, references, streams, turns
from tests.field.situation import BEFORE, Situation

AREAS: Mapping[str, tuple[Situation, ...]] = {
    "The autopilot's link": link.SITUATIONS,
    "Frames of reference that move": references.SITUATIONS,
    "The autopilot's own estimate": estimate.SITUATIONS,
    "What was asked of the autopilot": streams.SITUATIONS,
    "Before a flight": check.SITUATIONS,
    "Floods and stalls": turns.SITUATIONS,
    "Disks and files": files.SITUATIONS,
    "What the gate remembers": gate.SITUATIONS,
    "The cause in words": causes.SITUATIONS,
    "The ground station's inputs": (*ground.SITUATIONS, *ground_shell.SITUATIONS),
}
"""The situations of each area, in the order of the page."""


def by_title() -> dict[str, Situation]:
    """Return all situations by their titles."""
    return {situation.title: situation for situations in AREAS.values() for situation in situations}


def markdown() -> Iterator[str]:
    """Play every situation and yield the lines of the tables, one table an area."""
    for area, situations in AREAS.items():
        yield from (f"### {area}", "", f"| situation | wanted | seen on {BEFORE} | seen |", "|---|---|---|---|")
        for one in situations:
            yield f"| {one.title} | {one.wanted} | {one.before} | {one.play()} |"
        yield ""
