"""A field situation: what other programs, strangers, bad links and bad disks do, played without a network."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

BEFORE = "06f58e9"
"""The commit that `Situation.before` tells of."""


@dataclass(frozen=True)
class Situation:
    """One row of docs/field.md and one test.

    `play` plays the situation, asserts what is wanted, and returns in a few words and figures what was seen.
    """

    title: str
    """What happens, such as "home is set 560 m higher in flight"."""
    wanted: str
    """What the programs should do then."""
    before: str
    """What was seen on the commit BEFORE, played there by this same function."""
    play: Callable[[], str]
