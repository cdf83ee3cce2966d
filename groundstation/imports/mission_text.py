"""The text of a mission that does what a drawing shows, in degrees, with its numbers for one kind of vehicle.

A drawing says where; how fast, how tight and how near follows from the vehicle: the numbers below, which can be changed
in the file.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from companion.autopilot.kinds import CRUISE_M_S, KINDS
from companion.errors import InputError
from companion.geo.polygon import polygon_fault
from companion.mission.model import parse_mission
from companion.mission.places import DEGREE_DECIMALS, Origin, Plane, Position
from companion.mission.resolve import resolve
from companion.mission.values import MAX_ITEMS
from companion.onboard.lint.fleet import abilities_of, speeds_instead
from groundstation.imports.drawing import Drawing, Home

PAPER_SPEED_M_S, PAPER_WEIGHTS = 60.0, {"k_d": 1.0e11, "k_a": 1.0e11, "k_c": 1.0e10, "k_l": 1.0e10}
"""Speed for which the paper's penalties are, which are areas: they go with its square."""
MOST_N_MAX = 10.0
RANGE_S = 1_000.0
"""Time at its speed for which a vehicle is said to fly."""
STOPPING = {"arrival_radius_m": 10.0, "separation_m": 15.0}
CIRCLING = {"arrival_radius_m": 60.0, "separation_m": 50.0}
"""Radii for vehicles that can stop, and for those that circle."""
BROADCAST_PERIOD_S, ASSIGNMENT_PERIOD_S, MAX_TIME_S = 1.0, 5.0, 7_200.0
SPACING = 2.0
"""Distance of two vehicles that start at one home, in separations."""
_THING = re.compile(r"(?P<key>agents|targets|exclusions)\[(?P<index>\d+)\]|threat (?P<id>\d+)")
"""How a message about a mission names its things; threats by their ids, which count from 1."""
MAX_HEIGHT_M = 120.0
"""Greatest height that is taken from a file; a companion's own limit unless it is given another."""


@dataclass(frozen=True)
class Wanted:
    """What is wanted beside the file."""

    kind: str | None
    """Kind of autopilot; None: the file's, or a copter's."""
    agents: int
    home: tuple[Position, float | None] | None
    """Where the vehicles start, in place of the file's home, and its height above sea level."""


def mission_text(drawing: Drawing, wanted: Wanted, name: str, source: str) -> tuple[str, list[str]]:
    """Return a mission as YAML text, and what must be said about it; errors name `source`, the file.

    Raises:
        InputError: the drawing makes no mission, or none that can be flown.

    """
    notes = list(drawing.notes)
    try:
        home = _home(drawing, wanted)
        plane = Plane(Origin(lat_deg=home.position.lat_deg, lon_deg=home.position.lon_deg))
        _check_places(drawing, plane)
    except (InputError, ValueError) as error:
        raise InputError(f"{source}: {error}") from error
    if home.alt_m is None:
        notes.append("origin.alt_m: 0, as the file does not say how high the home is: --home LAT,LON,ALT does")
    if drawing.agents and wanted.agents > 1:
        notes.append(f"agents: the {len(drawing.agents)} of the file; --agents {wanted.agents} counts for nothing then")
    kind, speed_m_s = _vehicle(drawing, wanted, notes)
    starts = [Start(spot.name, spot.position) for spot in drawing.agents] or _row(plane, home, wanted.agents, kind)
    lines = [
        f"# Imported from {name}: the places. The numbers are of the kind {kind}; change what yours has otherwise.",
        f"name: {_quoted(name)}",
        *_origin(home),
        *_numbers(kind, speed_m_s, _height_m(drawing, notes)),
        *_areas(drawing),
        *_listed("agents", ((start.position, "heading_deg: 0", start.name) for start in starts)),
        *_listed("targets", ((spot.position, "", spot.name) for spot in drawing.targets)),
        *_listed("threats", ((disc.position, f"radius_m: {disc.radius_m:.7g}", disc.name) for disc in drawing.discs)),
    ]
    if len(drawing.targets) > len(starts):
        lines.append("queue: true   # who has arrived takes the next target")
    text = "\n".join(lines) + "\n"
    try:
        resolve(parse_mission(text, source), 1, source)  # refuses what cannot be flown
    except InputError as error:
        raise InputError(_with_places(str(error), drawing, home)) from error
    # Where coordinates were exchanged everything fits together, in another part of the world.
    notes.append(f"origin: at {_words(home.position)}")
    return text, notes


def _with_places(message: str, drawing: Drawing, home: Home) -> str:
    """Return a message about a mission with the place in the file of each thing that it names."""
    agents = [spot.where for spot in drawing.agents]

    def named(found: re.Match[str]) -> str:
        """Return what was found, with the place in the file."""
        key, number = found["key"] or "threats", int(found["index"] or found["id"] or 0)
        wheres = {
            "agents": agents or [home.where] * (number + 1),
            "targets": [spot.where for spot in drawing.targets],
            "threats": [""] + [disc.where for disc in drawing.discs],
            "exclusions": [one.where for one in drawing.exclusions],
        }[key]
        return f"{found[0]} ({wheres[number]})" if number < len(wheres) else found[0]

    message = _THING.sub(named, message)
    fence = drawing.fences[0].where if drawing.fences else ""
    return message.replace("inside the fence", f"inside the fence ({fence})")


def _words(place: Position) -> str:
    """Return a place in words, such as 47.39770 N, 8.54560 E."""
    lat, lon = ("N" if place.lat_deg >= 0.0 else "S"), ("E" if place.lon_deg >= 0.0 else "W")
    return f"{abs(place.lat_deg):.5f} {lat}, {abs(place.lon_deg):.5f} {lon}"


class Start(NamedTuple):
    """Where a vehicle starts."""

    name: str
    position: Position


def _home(drawing: Drawing, wanted: Wanted) -> Home:
    if wanted.home is not None:
        return Home("--home", *wanted.home)
    if drawing.home is not None:
        return drawing.home
    if drawing.agents:
        return Home(drawing.agents[0].where, drawing.agents[0].position, None)
    raise InputError(
        "home: nothing says where the vehicles start; allowed: --home LAT,LON[,ALT], or a point named home"
    )


def _check_places(drawing: Drawing, plane: Plane) -> None:
    """Raise InputError or ValueError if a place is far from home, a polygon is none, or there are too many of them."""
    if len(drawing.fences) > 1:
        first, second = drawing.fences[:2]
        raise InputError(f"{second.where}: a second fence, beside {first.where}; allowed: one area to stay inside of")
    if not drawing.targets:
        raise InputError("targets: none; allowed: at least one way point, rally point or point of a map")
    for key, items in (("targets", drawing.targets), ("threats", drawing.discs), ("exclusions", drawing.exclusions)):
        if len(items) > MAX_ITEMS:
            raise InputError(f"{key}: {len(items)} in the file; allowed: at most {MAX_ITEMS}")
    spots = [(spot.position, spot.where) for spot in (*drawing.targets, *drawing.agents)]
    for place, where in [*spots, *((disc.position, disc.where) for disc in drawing.discs)]:
        plane.place_m(place, where)
    for one in (*drawing.fences, *drawing.exclusions):
        if len(one.corners) > MAX_ITEMS:
            raise InputError(f"{one.where}: {len(one.corners)} corners; allowed: at most {MAX_ITEMS}")
        fault = polygon_fault([plane.place_m(_rounded(corner), one.where) for corner in one.corners])
        if fault is not None:
            raise InputError(f"{one.where}: {fault}; allowed: a simple polygon, whose edges do not cross")


def _vehicle(drawing: Drawing, wanted: Wanted, notes: list[str]) -> tuple[str, float]:
    """Return the kind of vehicle and the speed that it flies."""
    kind = wanted.kind or drawing.kind
    if kind is None:
        kind = "arducopter"
        notes.append(f"agents: numbers of an {kind}, as the file does not say what flies: --autopilot does")
    abilities = abilities_of(kind, ())
    cruise_m_s = CRUISE_M_S.get(kind, min(abilities.speed_max_m_s, PAPER_SPEED_M_S))
    if drawing.speed_m_s is None or drawing.speed_m_s <= 0.0:
        return kind, cruise_m_s
    allowed = speeds_instead(drawing.speed_m_s, abilities)
    if allowed is None:
        return kind, drawing.speed_m_s
    notes.append(
        f"speed_m_s: {cruise_m_s:g} m/s instead of the file's {drawing.speed_m_s:g}, as {kind} flies {allowed}"
    )
    return kind, cruise_m_s


def _height_m(drawing: Drawing, notes: list[str]) -> float | None:
    """Return the height of the first way point, at which all fly; None if there is none, or none that is flown."""
    if drawing.height_m is None:
        return None
    if not 1.0 <= drawing.height_m <= MAX_HEIGHT_M:
        notes.append(f"height_m: {drawing.height_m:g} m of the first way point left out: not 1 to {MAX_HEIGHT_M:g}")
        return None
    notes.append(f"height_m: {drawing.height_m:g} m for all, that of the first way point")
    return drawing.height_m


def _origin(home: Home) -> list[str]:
    return [f"origin: {{{_degrees(home.position)}, alt_m: {home.alt_m or 0.0:g}}}"]


def _numbers(kind: str, speed_m_s: float, height_m: float | None) -> list[str]:
    """Return the lines of the numbers that follow from the vehicle."""
    n_max = math.floor(min(abilities_of(kind, ()).n_max, MOST_N_MAX) * 1000.0) / 1000.0
    share = (speed_m_s / PAPER_SPEED_M_S) ** 2
    weights = ", ".join(f"{key}: {share * value:.4g}" for key, value in PAPER_WEIGHTS.items())
    agent = f"speed_m_s: {speed_m_s:g}, n_max: {n_max:g}, range_m: {RANGE_S * speed_m_s:g}"
    agent += "" if height_m is None else f", height_m: {height_m:g}"
    return [
        f"defaults: {{agent: {{{agent}}}}}",
        *(f"{key}: {value:g}" for key, value in (STOPPING if KINDS[kind].can_stop else CIRCLING).items()),
        f"weights: {{{weights}}}",
        f"broadcast_period_s: {BROADCAST_PERIOD_S:g}",
        f"assignment_period_s: {ASSIGNMENT_PERIOD_S:g}",
        f"max_time_s: {MAX_TIME_S:g}",
    ]


def _areas(drawing: Drawing) -> list[str]:
    """Return the lines of fence and exclusions."""
    lines = []
    for fence in drawing.fences:
        lines += [f"fence:{_comment(fence.name)}", *(f"  - {{{_degrees(corner)}}}" for corner in fence.corners)]
    lines += ["exclusions:"] if drawing.exclusions else []
    for exclusion in drawing.exclusions:
        first, *others = (f"- {{{_degrees(corner)}}}" for corner in exclusion.corners)
        lines += [f"  - {first}{_comment(exclusion.name)}", *(f"    {other}" for other in others)]
    return lines


def _row(plane: Plane, home: Home, count: int, kind: str) -> list[Start]:
    """Return places of vehicles that start at one home: there, and on in a row to the east."""
    apart_m = SPACING * (STOPPING if KINDS[kind].can_stop else CIRCLING)["separation_m"]
    return [Start("", home.position if not index else plane.position(0.0, index * apart_m)) for index in range(count)]


def _listed(key: str, items: Iterable[tuple[Position, str, str]]) -> list[str]:
    """Return the lines of a list of things, each with its place, more of its keys and its name; none for none."""
    lines = []
    for index, (place, more, name) in enumerate(items):
        inside = ", ".join(part for part in (f"id: {index + 1}", _degrees(place), more) if part)
        lines.append(f"  - {{{inside}}}{_comment(name)}")
    return [f"{key}:", *lines] if lines else []


def _degrees(place: Position) -> str:
    return f"lat_deg: {place.lat_deg:.{DEGREE_DECIMALS}f}, lon_deg: {place.lon_deg:.{DEGREE_DECIMALS}f}"


def _rounded(place: Position) -> Position:
    return Position(round(place.lat_deg, DEGREE_DECIMALS), round(place.lon_deg, DEGREE_DECIMALS))


def _comment(name: str) -> str:
    return f"   # {name}" if name else ""


def _quoted(name: str) -> str:
    return "'" + name.replace("'", "''") + "'"
