"""The traffic that the vehicle's own detector shows, with positions carried on to now, on the picture's plane."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import NamedTuple

from companion.autopilot.aircraft import NEIGHBOUR_MEMORY_S, Neighbour
from companion.geo.local_frame import LocalFrame, to_grid
from companion.guard.types import Motion
from companion.guidance.view import Traffic
from companion.onboard.config import Config

OWN_TRANSPONDER_S = 3.0
"""Time of flight within which a neighbour with this vehicle's callsign is taken for its own transponder."""


class Detected(NamedTuple):
    """The traffic of one tick."""

    traffic: tuple[Traffic, ...] = ()
    duplicate_agent_id: bool = False
    """Whether another vehicle uses this vehicle's agent id in its callsign."""
    elsewhere: tuple[Traffic, ...] = ()
    """Agents that are seen, but at a height or a distance at which they do not matter."""


def detected(
    neighbours: Collection[Neighbour],
    plane: LocalFrame,
    motion: Motion,
    altitude_m: float,
    config: Config,
    now_s: float,
) -> Detected:
    """Return the neighbours within `detector_range_m`, without those that `vertical_separation_m` keeps apart.

    Args:
        neighbours: All that the detector has reported, however long ago.
        plane: The picture's plane.
        motion: Motion of this vehicle on that plane.
        altitude_m: Altitude of this vehicle above sea level.
        config: The configuration, with limits that the vehicle can keep.
        now_s: Time by this vehicle's clock.

    """
    traffic: list[Traffic] = []
    elsewhere: list[Traffic] = []
    duplicate = False
    own_transponder_m = max(config.separation_m, OWN_TRANSPONDER_S * config.limits.speed_m_s)
    for neighbour in neighbours:
        age_s = max(0.0, now_s - neighbour.seen_at_s)
        if age_s > NEIGHBOUR_MEMORY_S:
            continue
        north_m, east_m, convergence_rad = plane.to_local_with_convergence(neighbour.lat_deg, neighbour.lon_deg)
        north_m_s, east_m_s = to_grid(neighbour.velocity_north_m_s, neighbour.velocity_east_m_s, convergence_rad)
        north_m, east_m = north_m + age_s * north_m_s, east_m + age_s * east_m_s
        apart_m = math.dist((north_m, east_m), (motion.north_m, motion.east_m))
        identity = neighbour.agent_id
        if identity == config.agent_id:
            if apart_m <= own_transponder_m:
                continue
            duplicate, identity = True, None
        above_m = abs(neighbour.altitude_m - altitude_m)
        over_or_under = 0.0 < config.vertical_separation_m <= above_m
        seen = Traffic(identity, (north_m, east_m), (north_m_s, east_m_s), age_s)
        if not over_or_under and apart_m <= config.detector_range_m:
            traffic.append(seen)
        elif identity is not None:
            elsewhere.append(seen)
    return Detected(tuple(traffic), duplicate, tuple(elsewhere))
