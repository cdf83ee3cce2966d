"""The other aircraft that the vehicle's own detector has seen (ADSB_VEHICLE), in a table that keeps the nearest."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from pymavlink.dialects.v20 import common

from companion.autopilot.intake import Message
from companion.geo.degrees import is_on_earth, metres_between

CALLSIGN_PATTERN = r"OW(\d{5})"
"""Regular expression of the fleet's callsigns: OW and the agent id in five digits."""
NEIGHBOUR_MEMORY_S = 5.0
"""Time after which a neighbour that is no longer seen is forgotten."""
MAX_NEIGHBOURS = 100
"""Greatest number of neighbours that are stored: the nearest ones."""
_GEOMETRIC = int(common.ADSB_ALTITUDE_TYPE_GEOMETRIC)


@dataclass(frozen=True)
class Neighbour:
    """Another aircraft as the vehicle's own detector last saw it. Velocities are along local true north and east."""

    agent_id: int | None
    """Its agent id; None for an aircraft that is not of the fleet."""
    lat_deg: float
    lon_deg: float
    velocity_north_m_s: float
    velocity_east_m_s: float
    seen_at_s: float
    altitude_m: float = math.nan
    """Altitude above mean sea level; NaN if it is not reported, or reported as a pressure altitude: that is another
    datum, hundreds of metres away on some days."""


def neighbour_of(message: Message, now_s: float) -> Neighbour | str:
    """Return the aircraft of an ADSB_VEHICLE, or in a word or two why it does not count."""
    flags = message.flags
    if not flags & common.ADSB_FLAGS_VALID_COORDS:
        return "no coordinates"
    if not is_on_earth(message.lat, message.lon):
        return "out of range"
    if message.tslc > NEIGHBOUR_MEMORY_S:
        return "seen too long ago"
    moves = flags & common.ADSB_FLAGS_VALID_HEADING and flags & common.ADSB_FLAGS_VALID_VELOCITY
    speed_m_s = message.hor_velocity / 100.0 if moves else 0.0
    course_rad = math.radians(message.heading / 100.0)
    above_sea = flags & common.ADSB_FLAGS_VALID_ALTITUDE and message.altitude_type == _GEOMETRIC
    return Neighbour(
        agent_id=_agent_id(message.callsign) if flags & common.ADSB_FLAGS_VALID_CALLSIGN else None,
        lat_deg=message.lat / 1e7,
        lon_deg=message.lon / 1e7,
        velocity_north_m_s=speed_m_s * math.cos(course_rad),
        velocity_east_m_s=speed_m_s * math.sin(course_rad),
        seen_at_s=now_s - message.tslc,
        altitude_m=message.altitude / 1000.0 if above_sea else math.nan,
    )


def entered(
    table: dict[int, Neighbour], address: int, seen: Neighbour, here_deg: tuple[float, float], now_s: float
) -> bool:
    """Enter an aircraft in the table, by its ICAO address; return whether there was room for it.

    Whoever is no longer seen is forgotten first. In a full table it takes the place of the farthest one, if that is
    farther away than it is.

    Args:
        table: The aircraft that are known; it is changed.
        address: The aircraft's ICAO address.
        seen: The aircraft as it was seen.
        here_deg: Latitude and longitude of the own vehicle; NaN: not known, and a full table stays as it is.
        now_s: Time by this vehicle's clock.

    """
    for key in [key for key, known in table.items() if now_s - known.seen_at_s > NEIGHBOUR_MEMORY_S]:
        del table[key]
    if address not in table and len(table) >= MAX_NEIGHBOURS:
        farthest = max(table, key=lambda key: _apart_m(table[key], here_deg))
        if not _apart_m(seen, here_deg) < _apart_m(table[farthest], here_deg):
            return False
        del table[farthest]
    table[address] = seen
    return True


def _apart_m(one: Neighbour, here_deg: tuple[float, float]) -> float:
    """Return about how far away an aircraft is; which of two is nearer needs no more."""
    return math.hypot(*metres_between(here_deg, (one.lat_deg, one.lon_deg)))


def _agent_id(callsign: str) -> int | None:
    """Return the agent id in a callsign of the fleet (CALLSIGN_PATTERN); None for any other callsign and for id 0."""
    match = re.fullmatch(CALLSIGN_PATTERN, callsign.rstrip())
    identity = int(match.group(1)) if match else 0
    return identity or None
