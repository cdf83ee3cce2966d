"""KML as a map's shapes. A document type is refused, and with it every entity: none is ever expanded.

The library leaves out what it cannot make sense of. A keep-out that vanishes is worse than a refusal, so that what came
out is counted against what is in the file.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from xml.dom import minidom
from xml.parsers.expat import ExpatError

import kml2geojson
from defusedxml import DefusedXmlException
from defusedxml import minidom as safe

from companion.errors import InputError, one_line
from groundstation.imports.drawing import Drawing, check_number, plain
from groundstation.imports.geojson import shape_of
from groundstation.imports.shapes import draw

GEOMETRIES = ("Point", "LineString", "Polygon", "Track", "gx:Track")
FOLDERS = ("Folder", "Document")


def read_kml(content: bytes) -> Drawing:
    """Return what a KML document draws.

    Raises:
        InputError: it is no XML or no KML, or a place in it is none.

    """
    try:
        document = safe.parseString(content, forbid_dtd=True)
    except DefusedXmlException as error:
        raise InputError("a document type or an entity; allowed: KML without them") from error
    except (ExpatError, ValueError, LookupError) as error:
        raise InputError(f"not valid XML: {one_line(str(error))}") from error
    root = document.documentElement
    if root is None or root.tagName != "kml":
        raise InputError(f"its root is <{plain(root.tagName if root is not None else '')}>; allowed: <kml>")
    shapes, notes = [], []
    for tag in ("NetworkLink", "GroundOverlay", "PhotoOverlay", "ScreenOverlay"):
        if count := len(document.getElementsByTagName(tag)):
            notes.append(f"{tag}: {count} left out")
    schema = _from_library("Schema", kml2geojson.build_schema, document)
    marks = document.getElementsByTagName("Placemark")
    check_number(len(marks), "Placemark")
    for index, mark in enumerate(marks):
        where = f"Placemark {index + 1}"
        feature = _from_library(where, kml2geojson.build_feature, mark, schema)
        _check_whole(mark, feature["geometry"], where)
        shape = shape_of(feature, where, _folders(mark))
        if shape is None:
            notes.append(f"{where}: left out: it has no place")
        else:
            shapes.append(shape)
    return draw(shapes, notes)


def _from_library(where: str, read: Callable[..., Any], *given: object) -> Any:  # noqa: ANN401 what the library returns
    """Return what the library reads; raise InputError for whatever it cannot make sense of, coordinates mostly."""
    try:
        return read(*given)
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise InputError(f"{where}: {one_line(str(error))}; allowed: coordinates lon,lat[,alt]") from error


def _folders(mark: minidom.Element) -> tuple[str, ...]:
    """Return the names of the folders about a placemark, the nearest first."""
    names, node = [], mark.parentNode
    while isinstance(node, minidom.Element):
        if node.tagName in FOLDERS:
            own = [child for child in node.childNodes if isinstance(child, minidom.Element) and child.tagName == "name"]
            names += [plain(kml2geojson.val(name)) for name in own[:1]]
        node = node.parentNode
    return tuple(names)


def _check_whole(mark: minidom.Element, geometry: object, where: str) -> None:
    """Raise InputError if a part of a placemark did not come out."""
    written = sum(len(mark.getElementsByTagName(tag)) for tag in GEOMETRIES)
    rings = len(mark.getElementsByTagName("LinearRing"))
    inside = sum(len(polygon.getElementsByTagName("LinearRing")) for polygon in mark.getElementsByTagName("Polygon"))
    if _counted(geometry) != (written + rings - inside, inside):
        raise InputError(
            f"{where}: a point, line or polygon without enough coordinates; allowed: 1 for a point, 2 for a line, 3 "
            "corners for each ring of a polygon"
        )


def _counted(geometry: object) -> tuple[int, int]:
    """Return how many geometries a GeoJSON geometry holds, and how many rings their polygons have."""
    if not isinstance(geometry, dict):
        return 0, 0
    parts = geometry["geometries"] if geometry["type"] == "GeometryCollection" else [geometry]
    return len(parts), sum(len(part["coordinates"]) for part in parts if part["type"] == "Polygon")
