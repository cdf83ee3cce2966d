"""The true state of a stand-in's vehicle: its craft in its surroundings, its sensors and its battery, on one clock."""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.geo.degrees import is_on_earth
from companion.geo.local_frame import LocalFrame
from sim.vehicles.craft import Craft, Home, Surroundings
from sim.vehicles.references import References
from sim.vehicles.sensors import Sensors
from sim.vehicles.setpoint import clip

CELLS = 3
"""Number of cells of the battery, in series."""
_FULL_CELL_MV, _EMPTY_CELL_MV = 4200, 3500
"""Voltage of one LiPo cell at 100 and at 0 percent of its charge."""


@dataclass(frozen=True, slots=True)
class Truth:
    """Where the vehicle really is, in the mission's plane. The heading is the nose's, clockwise from grid north.

    The speed is over the ground; in wind the course differs from the heading.
    """

    north_m: float
    east_m: float
    altitude_m: float
    heading_rad: float
    speed_m_s: float


@dataclass(slots=True)
class Battery:
    """A battery whose voltage falls linearly with its charge."""

    percent: float = 100.0
    drain_percent_s: float = 0.0
    """Discharge rate while the vehicle is armed, in percent of the full charge per second."""

    def discharge(self, duration_s: float) -> None:
        """Drain the battery for a time; an empty one stays at 0."""
        self.percent = max(0.0, self.percent - self.drain_percent_s * duration_s)

    def voltage_mv(self) -> int:
        """Return the voltage of all cells in series."""
        cell_mv = _EMPTY_CELL_MV + (_FULL_CELL_MV - _EMPTY_CELL_MV) * clip(self.percent, 0.0, 100.0) / 100.0
        return round(CELLS * cell_mv)


class FlightDynamics:
    """Where the vehicle is and what moves it. The owner sets the wind, which stays constant within a step."""

    def __init__(self, craft: Craft, home: Home, frame: LocalFrame, sensors: Sensors, start_s: float) -> None:
        """Begin at `start_s` with the craft's present state, in still air; `frame` is the mission's plane."""
        self.craft = craft
        self.references = References(home, frame)
        self.sensors = sensors
        self.battery = Battery()
        self._frame = frame
        self._wind_m_s = (0.0, 0.0)
        self.now_s = start_s
        self._geodetic: tuple[float, float, float] | None = None

    @property
    def truth(self) -> Truth:
        """Where the vehicle really is, after the last step."""
        body = self.craft.body
        speed_m_s = math.hypot(body.velocity_north_m_s, body.velocity_east_m_s)
        return Truth(body.north_m, body.east_m, body.altitude_m, body.heading_rad, speed_m_s)

    @property
    def wind_m_s(self) -> tuple[float, float]:
        """Velocity of the air (north, east) along the grid: where the wind blows to, not where it comes from."""
        return self._wind_m_s

    @wind_m_s.setter
    def wind_m_s(self, wind_m_s: tuple[float, float]) -> None:
        self._wind_m_s = wind_m_s
        if self.craft.in_air:
            self.craft.blow(wind_m_s)

    def step_to(self, t_s: float) -> None:
        """Advance the vehicle to the time `t_s`, which is later than the last."""
        around = self.surroundings()
        if self.craft.armed:
            self.battery.discharge(t_s - self.now_s)
        while self.now_s < t_s:
            until_s = min(t_s, self.now_s + self.craft.longest_step_s)
            self.craft.step(self.now_s, until_s - self.now_s, around)
            self.now_s = until_s
            self.sensors.remember(self.craft.body, until_s)
            self.craft.watch(until_s, self.sensors.has_fix, self.battery.voltage_mv() / 1000.0, around)
        self._geodetic = None

    def surroundings(self) -> Surroundings:
        """Return what the craft needs from the world around it now."""
        convergence_rad = self.geodetic()[2]
        references = self.references
        return Surroundings(
            self._wind_m_s,
            references.home,
            references.ground_m,
            references.origin_altitude_m,
            convergence_rad,
            self._frame.to_local,
            self._local_to_plane,
        )

    def geodetic(self) -> tuple[float, float, float]:
        """Return latitude and longitude in degrees and the grid's convergence in radians where the vehicle is."""
        if self._geodetic is None:
            body = self.craft.body
            self._geodetic = self.geodetic_of(body.north_m, body.east_m)
        return self._geodetic

    def geodetic_of(self, north_m: float, east_m: float) -> tuple[float, float, float]:
        """Return latitude and longitude in degrees and the grid's convergence in radians at a place of the plane."""
        return self._frame.to_global_with_convergence(north_m, east_m)

    def place_on_earth(self, lat_deg: float, lon_deg: float) -> tuple[float, float] | None:
        """Return north and east on the mission's plane of a place in degrees; None for one that is not on the Earth."""
        if not is_on_earth(lat_deg * 1e7, lon_deg * 1e7):
            return None
        return self._frame.to_local(lat_deg, lon_deg)

    def _local_to_plane(self, north_m: float, east_m: float) -> tuple[float, float]:
        return self._frame.to_local(*self.references.origin_frame.to_global(north_m, east_m))
