"""The frames of reference of a stand-in autopilot, which others may move in flight: home, local origin, sea level.

As measured (docs/autopilots.md): home may be set by anybody on the link, in flight too. It changes the height above
home and HOME_POSITION alone, neither altitude nor motion, nor an altitude that was commanded before. Only PX4 lets the
origin of its local frame be moved: places and setpoints in that frame are then about the new one, and nothing else.
"""

from __future__ import annotations

from companion.geo.local_frame import LocalFrame
from sim.vehicles.craft import Home


class References:
    """What heights and places of one autopilot are told about."""

    def __init__(self, home: Home, frame: LocalFrame) -> None:
        """Begin with the local frame's origin, and the ground everywhere, at home; `frame` is the mission's plane."""
        self.home = home
        self.ground_m = home.altitude_m
        """Altitude of the ground above sea level."""
        self.sea_up_m = 0.0
        """By how much the altitude that is told is too high: a datum that has moved. The height above home is not."""
        self._frame = frame
        self.home_deg = frame.to_global(home.north_m, home.east_m)
        self.origin_frame = LocalFrame(*self.home_deg)
        self.origin_altitude_m = home.altitude_m

    def move_home(self, home: Home) -> None:
        """Set home anew."""
        self.home = home
        self.home_deg = self._frame.to_global(home.north_m, home.east_m)

    def move_origin(self, origin: Home) -> None:
        """Set the origin of the local frame anew."""
        self.origin_frame = LocalFrame(*self._frame.to_global(origin.north_m, origin.east_m))
        self.origin_altitude_m = origin.altitude_m
