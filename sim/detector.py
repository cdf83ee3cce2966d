"""A vehicle's own detector of its neighbours: an ADS-B receiver, whose messages the autopilot forwards.

In Case II the ground station does not see the agents, so near neighbours must be seen from the vehicle itself
(docs/method.md section 1, item 7). Detections reach the companion as standard ADSB_VEHICLE frames. Noise and misses are
not modelled: every vehicle within the range is detected.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from companion.geo.local_frame import LocalFrame
from sim.mavlink_sender import MavlinkSender
from sim.vehicles import StandIn

_FLAGS = (
    mavlink.ADSB_FLAGS_VALID_COORDS
    | mavlink.ADSB_FLAGS_VALID_ALTITUDE
    | mavlink.ADSB_FLAGS_VALID_HEADING
    | mavlink.ADSB_FLAGS_VALID_VELOCITY
    | mavlink.ADSB_FLAGS_VALID_CALLSIGN
)
_CLIMB_CM_S, _AGE_S, _SQUAWK = 0, 0, 0
"""Fields of ADSB_VEHICLE that are not modelled: the climb rate and the squawk are 0 and not flagged as valid, and the
age is 0, as for a vehicle heard just now."""
_UINT16_MAX = 2**16 - 1


@dataclass(frozen=True)
class Fleet:
    """The true state of all vehicles alive at one time, gathered once for all their detectors."""

    ids: np.ndarray  # (N,) agent ids
    positions_ned_m: np.ndarray  # (N, 2) north, east
    velocities_ned_m_s: np.ndarray  # (N, 2) over the ground, along the grid
    altitudes_m: np.ndarray  # (N,) above sea level

    @classmethod
    def of(cls, vehicles: Mapping[int, StandIn]) -> Self:
        """Gather the state of stand-ins, given by agent id."""
        truths = [vehicle.truth for vehicle in vehicles.values()]
        return cls(
            ids=np.array(list(vehicles), dtype=int),
            positions_ned_m=np.array([(truth.north_m, truth.east_m) for truth in truths]).reshape(-1, 2),
            velocities_ned_m_s=np.array([vehicle.ground_velocity_m_s for vehicle in vehicles.values()]).reshape(-1, 2),
            altitudes_m=np.array([truth.altitude_m for truth in truths]),
        )


class Transponder:
    """Packs the state of vehicles as their transponders tell it."""

    def __init__(self, system_id: int, frame: LocalFrame) -> None:
        """Pack frames of the MAVLink system id `system_id`, for positions on the plane of `frame`."""
        self._frame = frame
        self._sender = MavlinkSender(system_id, mavlink.MAV_COMP_ID_ADSB)

    def squitter(self, fleet: Fleet, index: int = 0) -> bytes:
        """Return the ADSB_VEHICLE frame of one vehicle of a fleet, given by its place in it."""
        identity = int(fleet.ids[index])
        lat_deg, lon_deg, convergence_rad = self._frame.to_global_with_convergence(
            *fleet.positions_ned_m[index].tolist()
        )
        north_m_s, east_m_s = fleet.velocities_ned_m_s[index].tolist()
        # A vehicle that stands still has no course; the field then holds grid north.
        course_deg = math.degrees(math.atan2(east_m_s, north_m_s) + convergence_rad)
        message = self._sender.mav.adsb_vehicle_encode(
            identity,
            round(lat_deg * 1e7),
            round(lon_deg * 1e7),
            mavlink.ADSB_ALTITUDE_TYPE_GEOMETRIC,
            round(float(fleet.altitudes_m[index]) * 1000.0),
            round(course_deg * 100.0) % 36000,
            # A mission's speed may be greater than the field can hold.
            min(round(math.hypot(north_m_s, east_m_s) * 100.0), _UINT16_MAX),
            _CLIMB_CM_S,
            f"OW{identity:05d}".encode(),
            mavlink.ADSB_EMITTER_TYPE_UAV,
            _AGE_S,
            _FLAGS,
            _SQUAWK,
        )
        return self._sender.pack(message)


class Detector:
    """The detector on board one vehicle, with a range."""

    def __init__(self, agent_id: int, system_id: int, frame: LocalFrame, range_m: float) -> None:
        """Mount the detector on an agent with the MAVLink system id `system_id`; its horizontal range is `range_m`."""
        self._agent_id = agent_id
        self._range_m = range_m
        self._transponder = Transponder(system_id, frame)

    def look(self, fleet: Fleet) -> list[bytes]:
        """Return an ADSB_VEHICLE frame for each neighbour within the range; the fleet must hold the vehicle itself."""
        others = fleet.ids != self._agent_id
        (own,) = np.flatnonzero(~others)
        own_ned_m = fleet.positions_ned_m[own]
        apart_m = np.hypot(*(fleet.positions_ned_m - own_ned_m).T)
        return [
            self._transponder.squitter(fleet, int(index))
            for index in np.flatnonzero(others & (apart_m <= self._range_m))
        ]
