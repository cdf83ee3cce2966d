"""Places of the mission file that stand in degrees, converted to metres on the mission's plane.

A place is written as north_m and east_m or as lat_deg and lon_deg, each as its author has it, and is converted once,
when the file is loaded: behind the mission file there are only metres.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, NamedTuple

from pydantic import Field

from companion.files.yaml import Section
from companion.geo.local_frame import LocalFrame
from companion.mission.values import MAX_COORDINATE_M

IN_METRES = ("north_m", "east_m")
IN_DEGREES = ("lat_deg", "lon_deg")
MOST_DEG = (90.0, 180.0)
"""Greatest latitude and longitude, north or south, east or west."""
Latitude = Annotated[float, Field(ge=-MOST_DEG[0], le=MOST_DEG[0])]
Longitude = Annotated[float, Field(ge=-MOST_DEG[1], le=MOST_DEG[1])]
DEGREE_DECIMALS = 7
"""Decimals of degrees that are written: a centimetre."""
DECIMALS = 3
"""Decimals to which converted places are rounded: millimetres, so that a written file reads well."""
FORMS = "lat_deg and lon_deg (degrees), or north_m and east_m (metres)"


class Position(NamedTuple):
    """A place on the Earth (WGS84), in degrees."""

    lat_deg: float
    lon_deg: float

    @property
    def turned(self) -> Position:
        """The place with latitude and longitude exchanged, as files that begin with the longitude have them."""
        return Position(self.lon_deg, self.lat_deg)

    def __str__(self) -> str:
        return f"lat_deg {self.lat_deg:g}, lon_deg {self.lon_deg:g}"


class Origin(Section):
    """WGS84 position of the point (0, 0) of the mission's plane."""

    lat_deg: Latitude = 47.0
    lon_deg: Longitude = 8.0
    alt_m: Annotated[float, Field(ge=-1_000, le=20_000)] = 500.0


class Plane:
    """The plane of a mission, about its origin."""

    def __init__(self, origin: Origin) -> None:
        self.origin = origin
        self._frame = LocalFrame(origin.lat_deg, origin.lon_deg)

    def place_m(self, position: Position, where: str) -> tuple[float, float]:
        """Return (north, east) in metres of a position; `where` names it in errors.

        Raises:
            ValueError: it is no place on the Earth, or too far from the origin.

        """
        for key, value, most in zip(IN_DEGREES, position, MOST_DEG, strict=True):
            if not abs(value) <= most:
                raise ValueError(
                    f"{where}.{key}: {value:g}; allowed: -{most:g} to {most:g} degrees{self._hint(position)}"
                )
        north_m, east_m = self._frame.to_local(*position)
        if max(abs(north_m), abs(east_m)) > MAX_COORDINATE_M:
            raise ValueError(
                f"{where}: {position} is {math.hypot(north_m, east_m) / 1000.0:.0f} km from the origin, "
                f"{Position(self.origin.lat_deg, self.origin.lon_deg)}; allowed: at most "
                f"{MAX_COORDINATE_M / 1000.0:g} km north and east{self._hint(position)}"
            )
        return round(north_m, DECIMALS), round(east_m, DECIMALS)

    def position(self, north_m: float, east_m: float) -> Position:
        """Return the position of a place in metres."""
        return Position(*self._frame.to_global(north_m, east_m))

    def _hint(self, position: Position) -> str:
        """Return the question whether a place is turned round, if it would then be near the origin."""
        turned = position.turned
        if any(abs(value) > most for value, most in zip(turned, MOST_DEG, strict=True)):
            return ""
        near = max(map(abs, self._frame.to_local(*turned))) <= MAX_COORDINATE_M
        return f"; were latitude and longitude exchanged? {turned} is near it" if near else ""


def in_metres(item: Mapping[str, object], plane: Plane | None, where: str) -> dict[str, object]:
    """Return a mapping of the mission file with its place, if it has one in degrees, in metres.

    `plane` is None where the file says no origin about which degrees could be converted; `where` names it in errors.

    Raises:
        ValueError: the place is given in part or twice, or is none, or there is no origin for it.

    """
    given = [key for key in IN_DEGREES if key in item]
    if not given:
        return dict(item)
    beside = [key for key in IN_METRES if item.get(key) is not None]
    if beside:
        raise ValueError(f"{where}.{given[0]}: given beside {beside[0]}; allowed: {FORMS}")
    if len(given) == 1:
        missing = next(key for key in IN_DEGREES if key not in item)
        raise ValueError(f"{where}.{missing}: missing beside {given[0]}; allowed: {FORMS}")
    position = Position(*(_degrees(item[key], f"{where}.{key}") for key in IN_DEGREES))
    if plane is None:
        raise ValueError(
            f"origin.lat_deg: missing, with a place in degrees, {where}; allowed: lat_deg and lon_deg of the origin, "
            "about which the mission's plane lies"
        )
    north_m, east_m = plane.place_m(position, where)
    kept = {key: value for key, value in item.items() if key not in (*IN_DEGREES, *IN_METRES)}
    return {**kept, "north_m": north_m, "east_m": east_m}


def as_list(point: object, plane: Plane | None, where: str, first: tuple[str, ...] = ()) -> object:
    """Return a point of a polygon or a path as the list that the model has: [north_m, east_m].

    A mapping may stand for it; what is none is returned as it is. `first` are the keys of the values that come before
    the place in the list, such as a path's time.

    Raises:
        ValueError: a key of the mapping is unknown or missing, or its place is none.

    """
    if not isinstance(point, Mapping):
        return point
    keys = (*first, *IN_METRES)
    item = in_metres(point, plane, where)
    allowed = ", ".join((*first, FORMS))
    for key in item:
        if key not in keys:
            raise ValueError(f"{where}: unknown key '{str(key)[:40]}'; allowed: {allowed}")
    for key in keys:
        if key not in item:
            raise ValueError(f"{where}.{key}: missing; allowed: {allowed}")
    return [item[key] for key in keys]


def _degrees(value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= MOST_DEG[1] * 1e3:
        raise ValueError(f"{where}: {str(value)[:40]!r}; allowed: a number of degrees")
    return float(value)
