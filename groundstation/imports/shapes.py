"""What a shape of a map becomes in a mission: by its role, which it says itself or its name or folder tells.

KML and GeoJSON both come here: a map has points, lines and polygons, and only a word says which polygon is to be kept
inside of and which outside of.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from geojson_pydantic.geometries import (
    Geometry,
    GeometryCollection,
    LineString,
    MultiLineString,
    MultiPoint,
    MultiPolygon,
    Point,
    Polygon,
)

from companion.errors import InputError, nearest_hint
from companion.geo.polygon import inside_polygon
from groundstation.imports.drawing import Disc, Drawing, Home, Ring, Spot, plain, position, radius_m, ring, shown

ROLES: dict[str, tuple[str, ...]] = {
    "fence": ("fence", "geofence", "inclusion", "boundary"),
    "exclusion": ("exclusion", "keep-out", "keepout", "no-fly", "nofly", "obstacle"),
    "threat": ("threat",),
    "home": ("home", "launch", "origin"),
    "agent": ("agent", "vehicle"),
    "target": ("target", "waypoint"),
}
"""Roles, each with the words in a name that tell it."""
ROLE_KEY = "role"
RADIUS_KEY = "radius_m"
_POLYGON_ROLES = ("fence", "exclusion")
_POINT_ROLES = ("home", "agent", "target", "threat")


@dataclass(frozen=True)
class Shape:
    """One feature of a map."""

    where: str
    names: tuple[str, ...]
    """Its name, and those of the folders about it, the nearest first."""
    properties: Mapping[str, Any]
    geometry: Geometry

    @property
    def name(self) -> str:
        """Its own name on one line; empty if it has none."""
        return plain(self.names[0]) if self.names else ""


def draw(shapes: Sequence[Shape], notes: Sequence[str]) -> Drawing:
    """Return what the shapes of a map draw; `notes` say what of it has become no shape.

    Raises:
        InputError: a shape cannot have its role, or a place in it is none.

    """
    drawing, undecided = Drawing(notes=list(notes)), list[Ring]()
    for shape in shapes:
        _draw(shape, shape.geometry, shape.where, drawing, undecided)
    points = [spot.position for spot in (*drawing.targets, *drawing.agents)]
    points += [drawing.home.position] if drawing.home is not None else []
    about = [one for one in undecided if points and all(inside_polygon(point, one.corners) for point in points)]
    if len(about) == 1 and not drawing.fences:
        drawing.fences = about
        undecided.remove(about[0])
        drawing.notes.append(f"{about[0].where}: all points lie inside, so that it became the fence")
    drawing.exclusions += undecided
    return drawing


def _draw(shape: Shape, geometry: Geometry, where: str, drawing: Drawing, undecided: list[Ring]) -> None:
    """Add a geometry of a shape to a drawing, or to the polygons of which nothing tells a role."""
    if isinstance(geometry, GeometryCollection):
        for index, part in enumerate(geometry.geometries):
            _draw(shape, part, f"{where}.geometries[{index}]", drawing, undecided)
    elif isinstance(geometry, Polygon | MultiPolygon):
        polygons = [geometry.coordinates] if isinstance(geometry, Polygon) else geometry.coordinates
        role = _role(shape, _POLYGON_ROLES)
        for index, rings in enumerate(polygons):
            at = where if isinstance(geometry, Polygon) else f"{where}.coordinates[{index}]"
            drawn = _polygon(rings, at, shape.name)
            {"fence": drawing.fences, "exclusion": drawing.exclusions, None: undecided}[role].append(drawn)
    else:
        _draw_points(shape, geometry, where, drawing)


def _polygon(rings: Sequence[Sequence[Sequence[float]]], where: str, name: str) -> Ring:
    if len(rings) != 1:
        holes = f"{len(rings) - 1} holes" if rings else "no corners"
        raise InputError(f"{where}{_named(name)}: {holes}; allowed: none: draw each as a polygon of its own")
    return ring((position(corner, where, first="lon") for corner in rings[0]), where + _named(name), name)


def _draw_points(shape: Shape, geometry: Geometry, where: str, drawing: Drawing) -> None:
    role = _role(shape, _POINT_ROLES)
    where = where + _named(shape.name)
    spots = [Spot(where, shape.name, position(point, where, first="lon")) for point in _points(geometry)]
    given = shape.properties.get(RADIUS_KEY)
    if given is not None or role == "threat":
        length_m = radius_m(_number(given), f"{where}: {RADIUS_KEY}")
        drawing.discs += [Disc(where, shape.name, spot.position, length_m) for spot in spots]
    elif role == "home":
        if drawing.home is not None or len(spots) != 1:
            raise InputError(f"{where}: a second home; allowed: one point")
        heights = [float(point[2]) for point in _points(geometry) if len(point) > 2 and point[2]]
        drawing.home = Home(where, spots[0].position, heights[0] if heights else None)
    else:
        (drawing.agents if role == "agent" else drawing.targets).extend(spots)


def _points(geometry: Geometry) -> list[Sequence[float]]:
    if isinstance(geometry, Point):
        return [geometry.coordinates]
    if isinstance(geometry, MultiPoint | LineString):
        return list(geometry.coordinates)
    assert isinstance(geometry, MultiLineString)
    return [point for line in geometry.coordinates for point in line]


def _role(shape: Shape, allowed: Sequence[str]) -> str | None:
    """Return a shape's role, as it says itself, or as the nearest name with a word for it tells; None if none does.

    Raises:
        InputError: it says a role that a shape like it cannot have.

    """
    said = shape.properties.get(ROLE_KEY)
    if said is not None:
        if said not in allowed:
            hint = nearest_hint(str(said), allowed)
            choice = f"{ROLE_KEY} {shown(said)}{hint}; allowed: {', '.join(allowed)}"
            raise InputError(f"{shape.where}{_named(shape.name)}: {choice}")
        return str(said)
    for name in shape.names:
        words = re.split(r"[^\w-]+", name.lower())
        for role in allowed:
            if any(word in words or word + "s" in words for word in ROLES[role]):
                return role
    return None


def _number(value: object) -> object:
    """Return a number that is written as text, as KML has all its data; anything else as it is."""
    try:
        return float(value) if isinstance(value, str) else value
    except ValueError:
        return value


def _named(name: str) -> str:
    return f" '{name}'" if name else ""
