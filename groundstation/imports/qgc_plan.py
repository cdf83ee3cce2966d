"""QGroundControl's plan files, as its developers' guide documents them: geofence, mission and rally points.

Way points become targets, or rally points where there are none; the planned home becomes the origin. Heights above the
ground, speeds of single items, cameras and whatever else a plan holds has no place in a mission, and is left out.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from companion.autopilot.kinds import ARDUCOPTER, ARDUPLANE, ARDUROVER, PX4_COPTER, PX4_PLANE
from companion.errors import InputError
from companion.geo.local_frame import LocalFrame
from companion.mission.places import Position
from groundstation.imports.drawing import Disc, Drawing, Home, Ring, Spot, fault_text, position, radius_m, ring, shown

CIRCLE_CORNERS = 36
"""Corners of the polygon inside an inclusion circle."""
WAYPOINTS = {
    16: "way point", 17: "loiter", 18: "loiter turns", 19: "loiter time", 31: "loiter to altitude", 82: "spline",
}  # fmt: skip
"""MAV_CMD numbers of the items that are flown to."""
GLOBAL_FRAMES = (0, 3, 5, 6, 10, 11)
"""MAV_FRAME numbers with latitude and longitude: global, and relative to home or to the ground."""
RELATIVE_FRAME = 3
KINDS = {
    (3, 1): ARDUPLANE, (3, 2): ARDUCOPTER, (3, 13): ARDUCOPTER, (3, 14): ARDUCOPTER, (3, 10): ARDUROVER,
    (3, 11): ARDUROVER, (12, 1): PX4_PLANE, (12, 2): PX4_COPTER, (12, 13): PX4_COPTER, (12, 14): PX4_COPTER,
}  # fmt: skip
"""Kinds by MAV_AUTOPILOT and MAV_TYPE."""
FIXED_WING = 1

Numbers = list[float | None]
"""Numbers of a place: QGroundControl writes null for a height that it does not know."""
ItemT = TypeVar("ItemT")
PartT = TypeVar("PartT", bound="_Part")


class _Part(BaseModel):
    model_config = ConfigDict(strict=True, allow_inf_nan=False)


class _Circle(_Part):
    center: Numbers
    radius: float


class _FenceCircle(_Part):
    circle: _Circle
    inclusion: bool


class _FencePolygon(_Part):
    polygon: list[Numbers]
    inclusion: bool


class _GeoFence(_Part):
    version: Literal[2] = 2
    circles: list[_FenceCircle] = []
    polygons: list[_FencePolygon] = []


class _SimpleItem(_Part):
    command: int
    frame: int
    params: Annotated[Numbers, Field(min_length=7, max_length=7)]


class _Transects(_Part):
    items: Annotated[list[_SimpleItem], Field(alias="Items")] = []
    points: Annotated[list[Numbers], Field(alias="VisualTransectPoints")] = []


class _Complex(_Part):
    transects: Annotated[_Transects | None, Field(alias="TransectStyleComplexItem")] = None
    polyline: list[Numbers] = []
    polygon: list[Numbers] = []


class _Mission(_Part):
    version: Literal[2] = 2
    items: list[dict[str, Any]] = []
    home: Annotated[Numbers | None, Field(alias="plannedHomePosition")] = None
    firmware: Annotated[int | None, Field(alias="firmwareType")] = None
    vehicle: Annotated[int | None, Field(alias="vehicleType")] = None
    cruise_m_s: Annotated[float | None, Field(alias="cruiseSpeed")] = None
    hover_m_s: Annotated[float | None, Field(alias="hoverSpeed")] = None


class _RallyPoints(_Part):
    version: Literal[1, 2] = 2
    points: list[Numbers] = []


class _Plan(_Part):
    version: Literal[1]
    mission: _Mission
    fence: Annotated[_GeoFence, Field(alias="geoFence")] = _GeoFence()
    rally: Annotated[_RallyPoints, Field(alias="rallyPoints")] = _RallyPoints()


def read_plan(data: dict[str, Any]) -> Drawing:
    """Return what a plan draws; `data` is its JSON.

    Raises:
        InputError: it is not as documented, or a place in it is none; the message begins with its key.

    """
    try:
        plan = _Plan.model_validate(data)
    except ValidationError as error:
        raise InputError(fault_text(error.errors()[0], "")) from error
    drawing = Drawing()
    _read_fence(plan.fence, drawing)
    _read_mission(plan.mission, drawing)
    points = _numbered(plan.rally.points, "rallyPoints.points")
    rally = [Spot(where, "", position(point, where)) for point, where in points]
    if not drawing.targets:
        drawing.targets = rally
    elif rally:
        drawing.notes.append(f"rallyPoints: {len(rally)} left out: the way points are the targets")
    return drawing


def _read_fence(fence: _GeoFence, drawing: Drawing) -> None:
    for polygon, where in _numbered(fence.polygons, "geoFence.polygons"):
        corners = [position(corner, at) for corner, at in _numbered(polygon.polygon, f"{where}.polygon")]
        drawn = ring(corners, where, "")
        (drawing.fences if polygon.inclusion else drawing.exclusions).append(drawn)
    for one, where in _numbered(fence.circles, "geoFence.circles"):
        centre = position(one.circle.center, f"{where}.circle.center")
        length_m = radius_m(one.circle.radius, f"{where}.circle.radius")
        if one.inclusion:
            drawing.fences.append(Ring(where, "", _circle(centre, length_m)))
            drawing.notes.append(f"{where}: the circle became a polygon of {CIRCLE_CORNERS} corners inside it")
        else:
            drawing.discs.append(Disc(where, "", centre, length_m))


def _circle(centre: Position, length_m: float) -> tuple[Position, ...]:
    """Return the corners of a regular polygon inside a circle."""
    frame = LocalFrame(*centre)
    angles = (2.0 * math.pi * index / CIRCLE_CORNERS for index in range(CIRCLE_CORNERS))
    return tuple(Position(*frame.to_global(length_m * math.cos(angle), length_m * math.sin(angle))) for angle in angles)


def _read_mission(mission: _Mission, drawing: Drawing) -> None:
    if mission.home is not None:
        where = "mission.plannedHomePosition"
        alt_m = mission.home[2] if len(mission.home) > 2 else None
        drawing.home = Home(where, position(mission.home, where), alt_m)
    if mission.firmware is not None and mission.vehicle is not None:
        kind = KINDS.get((mission.firmware, mission.vehicle))
        drawing.kind = None if kind is None else kind.name
        is_plane = mission.vehicle == FIXED_WING
        drawing.speed_m_s = mission.cruise_m_s if is_plane else mission.hover_m_s
    others: dict[str, int] = {}
    for item, where in _numbered(mission.items, "mission.items"):
        for what in _read_item(item, where, drawing):
            others[what] = others.get(what, 0) + 1
    for what, count in others.items():
        drawing.notes.append(f"mission.items: {count} left out: {what}")


def _read_item(item: dict[str, Any], where: str, drawing: Drawing) -> list[str]:
    """Add an item's way points to the targets; return what was left out of it, in words."""
    kind = item.get("type")
    if kind == "SimpleItem":
        simple = _model(_SimpleItem, item, where)
        return _read_simple(simple, f"{where}.params", drawing)
    if kind != "ComplexItem":
        raise InputError(f"{where}.type: {shown(kind)}; allowed: SimpleItem, ComplexItem")
    name = item.get("complexItemType")
    found = _model(_Complex, item, where)
    before = len(drawing.targets)
    left: list[str] = []
    at = f"{where}.TransectStyleComplexItem"
    if found.transects is not None:
        for simple, place in _numbered(found.transects.items, f"{at}.Items"):
            left += _read_simple(simple, f"{place}.params", drawing)
    points, place = (found.polyline, f"{where}.polyline") if found.polyline else (found.polygon, f"{where}.polygon")
    if found.transects is not None and found.transects.points:
        points, place = found.transects.points, f"{at}.VisualTransectPoints"
    if len(drawing.targets) == before:
        drawing.targets += [Spot(spot, "", position(point, spot)) for point, spot in _numbered(points, place)]
    return left if len(drawing.targets) > before else [*left, f"complex item {shown(name)} without points"]


def _read_simple(item: _SimpleItem, where: str, drawing: Drawing) -> list[str]:
    if item.command not in WAYPOINTS:
        return [f"MAV_CMD {item.command}"]
    if item.frame not in GLOBAL_FRAMES:
        return [f"{WAYPOINTS[item.command]} in frame {item.frame}, which has no latitude and longitude"]
    if drawing.height_m is None and item.frame == RELATIVE_FRAME and item.params[6] is not None:
        drawing.height_m = item.params[6]
    drawing.targets.append(Spot(where, "", position(item.params[4:6], where)))
    return []


def _model(model: type[PartT], data: object, where: str) -> PartT:
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise InputError(fault_text(error.errors()[0], where)) from error


def _numbered(items: list[ItemT], where: str) -> list[tuple[ItemT, str]]:
    """Return items, each with its place in the file."""
    return [(item, f"{where}[{index}]") for index, item in enumerate(items)]
