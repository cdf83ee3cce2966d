"""Position, heading and home of the vehicle on the picture's plane, and the distance that it has flown."""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.autopilot.telemetry import Telemetry
from companion.geo.local_frame import LocalFrame
from companion.geo.polygon import inside_polygon
from companion.guard.types import Motion
from companion.mission.values import RANGE_RESERVE
from companion.onboard.config import Config, LimitsSection
from companion.onboard.engagement import PositionFix
from companion.onboard.hand_over import HandOver
from companion.onboard.references import References

COURSE_SPEED_M_S = 1.0
"""Ground speed below which the course over ground means nothing and the yaw is used as heading."""
STEP_SHARE = 1.5
"""Longest step between two positions that counts as flown, as a share of what speed limit and wind allow."""


class Home(NamedTuple):
    """The place on the picture's plane that the vehicle returns to."""

    position_ned_m: tuple[float, float]
    too_far: bool
    """Whether the autopilot's home is out of range, so that home is where the companion first steered."""
    told_deg: tuple[float, float] | None
    """The autopilot's home (latitude, longitude) that this was computed from; None: it was not known."""


class Navigation(NamedTuple):
    """What is known of the flight up to a tick, over all engagements."""

    plane: LocalFrame | None = None
    """The picture's plane; None until the companion first steers."""
    start_deg: tuple[float, float] | None = None
    """Latitude and longitude at which the companion first steered."""
    heading_rad: float = 0.0
    """Heading from true north: the course over ground, or the yaw of a vehicle that hardly moves."""
    flown_m: float = 0.0
    """Distance flown under guidance."""
    out_of_range: bool = False
    """Whether the vehicle had to turn home to get there on its range; once true, it stays true."""
    home: Home | None = None
    """Home on `plane`."""
    hand_over: HandOver | None = None
    """What is kept from the hand-over; None while a person has the vehicle."""
    flight: References | None = None
    """The references since the vehicle took off, followed while a person has it; None on the ground."""


class Located(NamedTuple):
    """The vehicle at one tick, on the picture's plane."""

    fix: PositionFix
    """The newest position of the telemetry, which is a little old."""
    motion: Motion
    """Position and velocity now: the fix carried on to the time of the tick."""
    convergence_rad: float
    """Meridian convergence at the fix: true heading minus grid heading."""
    home: Home


def plane_of(origin_deg: tuple[float, float] | None, before: LocalFrame | None, telemetry: Telemetry) -> LocalFrame:
    """Return the plane about the picture's origin; without a picture the plane of before, or one about the vehicle."""
    if before is not None and (origin_deg is None or origin_deg == (before.lat_deg, before.lon_deg)):
        return before
    return LocalFrame(*(origin_deg or (telemetry.lat_deg, telemetry.lon_deg)))


def navigate(
    before: Navigation,
    plane: LocalFrame,
    last_fix: PositionFix | None,
    telemetry: Telemetry,
    config: Config,
    now_s: float,
) -> tuple[Navigation, Located]:
    """Return what is known of the flight now, and where the vehicle is.

    Args:
        before: What was known of the flight at the last tick.
        plane: The picture's plane.
        last_fix: Position of the vehicle on that plane at the last tick of this engagement, if any.
        telemetry: The newest telemetry; it has a position.
        config: The configuration, with limits that the vehicle can keep.
        now_s: Time by this vehicle's clock.

    """
    north_m, east_m, convergence_rad = plane.to_local_with_convergence(telemetry.lat_deg, telemetry.lon_deg)
    speed_m_s = math.hypot(telemetry.velocity_north_m_s, telemetry.velocity_east_m_s)
    true_heading_rad = _true_heading_rad(telemetry, speed_m_s, before.heading_rad)
    start_deg = before.start_deg or (telemetry.lat_deg, telemetry.lon_deg)
    position_at_s = now_s if telemetry.position_at_s is None else telemetry.position_at_s
    fix = PositionFix((north_m, east_m), position_at_s)
    flown_m = before.flown_m
    if last_fix is not None:
        step_m = math.dist(last_fix.position_ned_m, fix.position_ned_m)
        flown_m += min(step_m, _longest_step_m(position_at_s - last_fix.at_s, config.limits))
    heading_rad = (true_heading_rad - convergence_rad) % math.tau
    # Telemetry is a little old: the vehicle has gone on since.
    since_m = speed_m_s * (now_s - position_at_s)
    north_m += since_m * math.cos(heading_rad)
    east_m += since_m * math.sin(heading_rad)
    home = before.home
    if home is None or plane is not before.plane or home.told_deg != telemetry.home_deg:
        home = _home(plane, telemetry.home_deg, start_deg, config.limits.range_m)
    home_m = math.dist((north_m, east_m), home.position_ned_m)
    out_of_range = before.out_of_range or _is_out_of_range(home_m, flown_m, config)
    motion = Motion(north_m, east_m, heading_rad, speed_m_s)
    return (
        Navigation(plane, start_deg, true_heading_rad, flown_m, out_of_range, home, before.hand_over),
        Located(fix, motion, convergence_rad, home),
    )


def outside_fence(telemetry: Telemetry, origin_deg: tuple[float, float] | None, config: Config) -> bool:
    """Return whether the vehicle is outside the fence or inside an exclusion; False without a picture's origin."""
    limits = config.limits
    if (limits.fence is None and not limits.exclusions) or origin_deg is None:
        return False
    north_m, east_m, _ = LocalFrame(*origin_deg).to_local_with_convergence(telemetry.lat_deg, telemetry.lon_deg)
    place_ned_m = (north_m, east_m)
    if limits.fence is not None and not inside_polygon(place_ned_m, limits.fence):
        return True
    return any(inside_polygon(place_ned_m, exclusion) for exclusion in limits.exclusions)


def _true_heading_rad(telemetry: Telemetry, speed_m_s: float, before_rad: float) -> float:
    if speed_m_s >= COURSE_SPEED_M_S:
        return math.atan2(telemetry.velocity_east_m_s, telemetry.velocity_north_m_s)
    return before_rad if telemetry.yaw_rad is None else telemetry.yaw_rad


def _longest_step_m(elapsed_s: float, limits: LimitsSection) -> float:
    """Return the longest way that counts as flown in a time, so that one wrong position does not use up the range."""
    return STEP_SHARE * (limits.speed_m_s + limits.wind_m_s) * max(0.0, elapsed_s) + limits.position_error_m


def _home(
    plane: LocalFrame, told_deg: tuple[float, float] | None, start_deg: tuple[float, float], range_m: float
) -> Home:
    """Return the autopilot's home, or, if that is unknown or out of range, where the companion first steered."""
    start_ned_m = plane.to_local(*start_deg)
    if told_deg is None:
        return Home(start_ned_m, False, told_deg)
    home_ned_m = plane.to_local(*told_deg)
    if not math.dist(home_ned_m, start_ned_m) <= range_m:
        return Home(start_ned_m, True, told_deg)
    return Home(home_ned_m, False, told_deg)


def _is_out_of_range(home_m: float, flown_m: float, config: Config) -> bool:
    """Return whether the vehicle must turn home now to get there on its range."""
    if config.range_policy != "return":
        return False
    # If the range does not reach home any more, the vehicle goes on to its target. The margin of one step keeps the
    # moment to turn from falling between two decisions, however near home is.
    range_m = config.limits.range_m
    step_m = config.limits.speed_m_s * config.guidance_step_s
    short = range_m < flown_m + RANGE_RESERVE * home_m + step_m
    return short and flown_m + home_m <= range_m + step_m
