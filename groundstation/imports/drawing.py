"""What a file of another program draws, in degrees, whatever its format.

Every part knows where in its file it stands, for messages.
"""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from pydantic_core import ErrorDetails

from companion.errors import InputError, one_line
from companion.mission.places import MOST_DEG, Position

MAX_FILE_BYTES = 10_000_000
"""Largest file that is read."""
MAX_SHAPES = 10_000
"""Most features of a map: five times what a mission has of one kind."""
_SHOWN_CHARACTERS = 60
"""Length to which names are cut."""


class Spot(NamedTuple):
    """A point."""

    where: str
    name: str
    position: Position


class Disc(NamedTuple):
    """A circle to keep out of."""

    where: str
    name: str
    position: Position
    radius_m: float


class Ring(NamedTuple):
    """A polygon, whose last corner is not its first again."""

    where: str
    name: str
    corners: tuple[Position, ...]


class Home(NamedTuple):
    """Where the vehicles start, and how high that is above sea level; None where nothing says it."""

    where: str
    position: Position
    alt_m: float | None


@dataclass
class Drawing:
    """The parts of a file, gathered while it is gone through."""

    home: Home | None = None
    fences: list[Ring] = field(default_factory=list)
    exclusions: list[Ring] = field(default_factory=list)
    discs: list[Disc] = field(default_factory=list)
    targets: list[Spot] = field(default_factory=list)
    agents: list[Spot] = field(default_factory=list)
    kind: str | None = None
    """Kind of autopilot that the file was made for."""
    speed_m_s: float | None = None
    height_m: float | None = None
    notes: list[str] = field(default_factory=list)
    """What was left out, or understood in a way that its author may not expect."""


def position(values: Sequence[object], where: str, *, first: str = "lat") -> Position:
    """Return the position in a list of two or more numbers, in degrees; `first` says which of the two comes first.

    Raises:
        InputError: there are fewer than two, or they are no place on the Earth.

    """
    order = ("lat", "lon") if first == "lat" else ("lon", "lat")
    if len(values) < 2:
        raise InputError(f"{where}: {len(values)} numbers; allowed: [{order[0]}, {order[1]}] in degrees")
    named = dict(zip(order, values, strict=False))
    numbers = []
    for key, most in zip(("lat", "lon"), MOST_DEG, strict=True):
        value = named[key]
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= most:
            hint = f"; it holds [{order[0]}, {order[1]}]: are they exchanged?" if isinstance(value, int | float) else ""
            raise InputError(f"{where}: {key} {shown(value)}; allowed: -{most:g} to {most:g} degrees{hint}")
        numbers.append(float(value))
    return Position(*numbers)


def ring(corners: Iterable[Position], where: str, name: str) -> Ring:
    """Return a polygon without corners that are given again at once, as closed and hand-drawn ones have them.

    Raises:
        InputError: fewer than three corners are left.

    """
    kept: list[Position] = []
    for corner in corners:
        if not kept or corner != kept[-1]:
            kept.append(corner)
    if len(kept) > 1 and kept[0] == kept[-1]:
        kept.pop()
    if len(kept) < 3:
        raise InputError(f"{where}: {len(kept)} corners; allowed: at least 3")
    return Ring(where, name, tuple(kept))


def radius_m(value: object, where: str) -> float:
    """Return a radius in metres.

    Raises:
        InputError: it is no number above 0.

    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value <= sys.float_info.max:
        raise InputError(f"{where}: {shown(value)}; allowed: a number of metres greater than 0")
    return float(value)


def check_number(count: int, what: str) -> None:
    """Raise InputError if a map has more features, called `what`, than are gone through one by one."""
    if count > MAX_SHAPES:
        raise InputError(f"{what}: {count} in the file; allowed: at most {MAX_SHAPES}")


def shown(value: object) -> str:
    """Return a value of a file as text for a message, cut."""
    text = one_line(repr(value))
    return text if len(text) <= _SHOWN_CHARACTERS else text[: _SHOWN_CHARACTERS - 3] + "..."


def fault_text(details: ErrorDetails, where: str, keys: Collection[str] | None = None) -> str:
    """Return one line about a fault that pydantic found: the place of it after `where`, the value, and what is allowed.

    `keys` are those that are named; all unless given.
    """
    for part in details["loc"]:
        if isinstance(part, int):
            where += f"[{part}]"
        elif keys is None or part in keys:
            where += f".{part}" if where else part
    if details["type"] == "missing":
        return f"{where}: missing"
    message = one_line(details["msg"]).removeprefix("Value error, ").removeprefix("Input should be ")
    return f"{where}: {shown(details['input'])}; allowed: {message}"


def plain(name: object) -> str:
    """Return a name of a file as one line of printable characters, cut; empty if it is no text."""
    if not isinstance(name, str):
        return ""
    text = "".join(character if character.isprintable() else " " for character in one_line(name))
    return text[:_SHOWN_CHARACTERS]
