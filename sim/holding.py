"""Which way a point circles until its companion has a picture: to where there is room, as its pilot would choose."""

from __future__ import annotations

import math

from companion.geo.kinematics import turn_rate_rad_s
from companion.geo.polygon import inside_polygon
from companion.mission.model import AgentSpec, Mission, is_obstacle

PLACES = 36
"""Number of places on a circle at which fence and exclusions are looked at."""
RIGHT, LEFT = 1.0, -1.0


def holding_side(mission: Mission, spec: AgentSpec) -> float:
    """Return RIGHT, or LEFT if only the tightest circle to the left is clear of threats, fence and exclusions."""
    return LEFT if not _is_clear(mission, spec, RIGHT) and _is_clear(mission, spec, LEFT) else RIGHT


def _is_clear(mission: Mission, spec: AgentSpec, side: float) -> bool:
    radius_m = spec.speed_m_s / turn_rate_rad_s(spec.speed_m_s, spec.n_max)
    heading_rad = math.radians(spec.heading_deg or 0.0)
    north_m = spec.position_ned_m[0] - side * radius_m * math.sin(heading_rad)
    east_m = spec.position_ned_m[1] + side * radius_m * math.cos(heading_rad)
    for threat in mission.threats:
        apart_m = abs(math.dist((north_m, east_m), threat.position_ned_m) - radius_m)
        if apart_m < threat.detection_radius_m and is_obstacle(mission, spec.id, threat):
            return False
    angles_rad = (math.tau * count / PLACES for count in range(PLACES))
    places = [(north_m + radius_m * math.cos(angle), east_m + radius_m * math.sin(angle)) for angle in angles_rad]
    if mission.fence is not None and not all(inside_polygon(place, mission.fence) for place in places):
        return False
    return not any(inside_polygon(place, exclusion) for exclusion in mission.exclusions for place in places)
