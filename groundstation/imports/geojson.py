"""GeoJSON (RFC 7946) as a map's shapes."""

from __future__ import annotations

from typing import Any

from geojson_pydantic import Feature
from geojson_pydantic.geometries import Geometry
from pydantic import TypeAdapter, ValidationError

from companion.errors import InputError
from groundstation.imports.drawing import Drawing, check_number, fault_text, plain, shown
from groundstation.imports.shapes import Shape, draw

GEOMETRIES = (
    "Point", "MultiPoint", "LineString", "MultiLineString", "Polygon", "MultiPolygon", "GeometryCollection",
)  # fmt: skip
WGS84 = ("CRS84", "4326")
"""Ends of the names of the coordinate reference systems that are WGS84 degrees."""
KEYS = ("geometry", "geometries", "coordinates", "properties", "type")
"""Keys of a feature that are named in messages."""
NAME_KEYS = ("name", "Name", "title")
_FEATURE = TypeAdapter(Feature[Geometry, dict[str, Any]])
_GEOMETRY: TypeAdapter[Geometry] = TypeAdapter(Geometry)


def read_geojson(data: dict[str, Any]) -> Drawing:
    """Return what a GeoJSON document draws.

    Raises:
        InputError: it is none, or a place in it is none; the message begins with its key.

    """
    _check_degrees(data.get("crs"))
    kind = data.get("type")
    if kind == "FeatureCollection":
        features = data.get("features")
        if not isinstance(features, list):
            raise InputError(f"features: {shown(features)}; allowed: a list of features")
        check_number(len(features), "features")
        numbered = [(feature, f"features[{index}]") for index, feature in enumerate(features)]
    elif kind == "Feature":
        numbered = [(data, "the feature")]
    elif kind in GEOMETRIES:
        numbered = [({"type": "Feature", "properties": {}, "geometry": data}, "the geometry")]
    else:
        raise InputError(f"type: {shown(kind)}; allowed: FeatureCollection, Feature, {', '.join(GEOMETRIES)}")
    shapes, notes = [], []
    for feature, where in numbered:
        shape = shape_of(feature, where, ())
        if shape is None:
            notes.append(f"{where}: left out: it has no place")
        else:
            shapes.append(shape)
    return draw(shapes, notes)


def shape_of(data: object, where: str, folders: tuple[str, ...]) -> Shape | None:
    """Return a feature as a shape, or None if it has no geometry; `folders` are the names of those about it.

    Raises:
        InputError: it is no feature.

    """
    try:
        feature = _FEATURE.validate_python(data)
    except ValidationError as error:
        raise InputError(_fault(error, where)) from error
    if feature.geometry is None:
        return None
    properties = feature.properties or {}
    name = next((properties[key] for key in NAME_KEYS if isinstance(properties.get(key), str)), "")
    return Shape(where, (plain(name), *folders), properties, feature.geometry)


def _check_degrees(crs: object) -> None:
    """Raise InputError for coordinates that are no WGS84 degrees, as files before RFC 7946 could have them."""
    properties = crs.get("properties") if isinstance(crs, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    if crs is not None and not (isinstance(name, str) and name.endswith(WGS84)):
        raise InputError(f"crs: {shown(name or crs)}; allowed: WGS84 degrees, as RFC 7946 has them, and no crs")


def _fault(error: ValidationError, where: str) -> str:
    """Return the first fault of a feature on one line: the part of it, and why."""
    details = error.errors()[0]
    if "NamedTuple" in details["msg"]:
        details["msg"] = "longitude, latitude and perhaps a height, whose decimal marks are points"
    # Between the keys of the file stand the names of the models that were tried.
    return fault_text(details, where, KEYS)
