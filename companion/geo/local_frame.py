"""The projection between WGS84 and the mission's plane that all programs share.

Both ends of the broadcast and the stand-ins must agree on what (north, east) means, so they all use this azimuthal
equidistant projection about the mission origin (docs/method.md section 1). Away from the origin grid north and local
true north differ; a heading sent to an autopilot is turned by that difference, the convergence.
"""

from __future__ import annotations

import math

from pyproj import Geod

_WGS84 = Geod(ellps="WGS84")


class LocalFrame:
    """The azimuthal equidistant projection of WGS84 about an origin, onto a plane with coordinates north, east in m."""

    def __init__(self, lat_deg: float, lon_deg: float) -> None:
        self.lat_deg = lat_deg
        self.lon_deg = lon_deg

    def to_local(self, lat_deg: float, lon_deg: float) -> tuple[float, float]:
        """Return (north_m, east_m) of a WGS84 position in degrees."""
        azimuth_deg, _, distance_m = _WGS84.inv(self.lon_deg, self.lat_deg, lon_deg, lat_deg)
        azimuth_rad = math.radians(azimuth_deg)
        return distance_m * math.cos(azimuth_rad), distance_m * math.sin(azimuth_rad)

    def to_global(self, north_m: float, east_m: float) -> tuple[float, float]:
        """Return the WGS84 (lat_deg, lon_deg) of a position in the plane."""
        azimuth_deg = math.degrees(math.atan2(east_m, north_m))
        lon_deg, lat_deg, _ = _WGS84.fwd(self.lon_deg, self.lat_deg, azimuth_deg, math.hypot(north_m, east_m))
        return lat_deg, lon_deg

    def to_global_with_convergence(self, north_m: float, east_m: float) -> tuple[float, float, float]:
        """Return (lat_deg, lon_deg, convergence_rad); see `convergence_rad`."""
        azimuth_deg = math.degrees(math.atan2(east_m, north_m))
        lon_deg, lat_deg, back_deg = _WGS84.fwd(self.lon_deg, self.lat_deg, azimuth_deg, math.hypot(north_m, east_m))
        return lat_deg, lon_deg, _wrapped(math.radians(back_deg + 180.0 - azimuth_deg))

    def to_local_with_convergence(self, lat_deg: float, lon_deg: float) -> tuple[float, float, float]:
        """Return (north_m, east_m, convergence_rad); see `convergence_rad`."""
        azimuth_deg, back_deg, distance_m = _WGS84.inv(self.lon_deg, self.lat_deg, lon_deg, lat_deg)
        azimuth_rad = math.radians(azimuth_deg)
        convergence_rad = _wrapped(math.radians(back_deg + 180.0 - azimuth_deg))
        return distance_m * math.cos(azimuth_rad), distance_m * math.sin(azimuth_rad), convergence_rad

    def convergence_rad(self, north_m: float, east_m: float) -> float:
        """Return the angle to add to a heading from grid north at this point to get the heading from local true north.

        The projection is exact along the radial direction from the origin, so the angle by which that direction turns
        along its geodesic is the convergence.
        """
        return self.to_global_with_convergence(north_m, east_m)[2]


def to_grid(north: float, east: float, convergence_rad: float) -> tuple[float, float]:
    """Return the grid (north, east) components of a vector given by its local true (north, east) components."""
    cosine, sine = math.cos(convergence_rad), math.sin(convergence_rad)
    return north * cosine + east * sine, east * cosine - north * sine


def _wrapped(angle_rad: float) -> float:
    return math.remainder(angle_rad, math.tau)
