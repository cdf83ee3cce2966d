"""SET_POSITION_TARGET_LOCAL_NED as ArduCopter interprets it, for the kinds that obey its velocities and positions."""

from __future__ import annotations

import math
from dataclasses import dataclass

from companion.geo.degrees import is_on_earth
from sim.vehicles.craft import Body, Command, Message, Surroundings

# POSITION_TARGET_TYPEMASK and MAV_FRAME (mavlink.io).
POSITION_IGNORED = 0x007
VELOCITY_IGNORED = 0x038
YAW_IGNORED = 0x400
YAW_RATE_IGNORED = 0x800
_FRAME_LOCAL, _FRAME_LOCAL_OFFSET, _FRAME_BODY, _FRAME_BODY_OFFSET = 1, 7, 8, 9
_WORLD_FRAMES = frozenset({_FRAME_LOCAL, _FRAME_LOCAL_OFFSET})
"""Frames in which vectors are relative to true north."""
_BODY_FRAMES = frozenset({_FRAME_BODY, _FRAME_BODY_OFFSET})
"""Frames in which vectors are relative to the nose."""
_SANE_VELOCITY_M_S = 1000.0
"""Velocity components of this size or more are refused as invalid."""
SANE_POSITION_M = 1e6
"""Lengths and altitudes of this size or more are refused as invalid."""
ABSOLUTE_FRAMES = frozenset({0, 5})
"""MAV_FRAME_GLOBAL and MAV_FRAME_GLOBAL_INT: the altitude is above sea level."""
RELATIVE_FRAMES = frozenset({3, 6})
"""MAV_FRAME_GLOBAL_RELATIVE_ALT and MAV_FRAME_GLOBAL_RELATIVE_ALT_INT: the altitude is above home."""


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What a setpoint asks for: a velocity (north, east, up; along true north), or a place in the mission's plane."""

    t_s: float
    velocity_m_s: tuple[float, float, float]
    place_m: tuple[float, float, float] | None = None
    """Place in the plane (north, east) and altitude above sea level; None: the velocity counts."""
    yaw_rad: float | None = None
    """Yaw from true north; None: not asked for."""
    yaw_rate_rad_s: float | None = None


def understood(message: Message, body: Body, around: Surroundings, now_s: float) -> Setpoint | None:
    """Return what a SET_POSITION_TARGET_LOCAL_NED asks for; None if it is invalid or asks for no motion."""
    frame, mask = message.coordinate_frame, message.type_mask
    if frame not in _WORLD_FRAMES and frame not in _BODY_FRAMES:
        return None
    place_m, velocity_m_s = None, (0.0, 0.0, 0.0)
    if not mask & POSITION_IGNORED:
        place_m = _place(message, body, around)
        if place_m is None:
            return None
    elif not mask & VELOCITY_IGNORED:
        north_m_s, east_m_s, down_m_s = message.vx, message.vy, message.vz
        # Comparisons with NaN are false, so this also refuses NaN.
        if not all(abs(speed_m_s) < _SANE_VELOCITY_M_S for speed_m_s in (north_m_s, east_m_s, down_m_s)):
            return None
        if frame in _BODY_FRAMES:
            north_m_s, east_m_s = rotated(north_m_s, east_m_s, body.heading_rad + around.convergence_rad)
        velocity_m_s = (north_m_s, east_m_s, -down_m_s)
    else:
        return None
    return Setpoint(
        now_s,
        velocity_m_s,
        place_m,
        None if mask & YAW_IGNORED or not math.isfinite(message.yaw) else message.yaw,
        None if mask & YAW_RATE_IGNORED or not math.isfinite(message.yaw_rate) else message.yaw_rate,
    )


def global_place_m(command: Command, around: Surroundings) -> tuple[float, float, float] | None:
    """Return the place in a COMMAND_INT as (north, east) of the plane and altitude; None if it is invalid."""
    if not (abs(command.z) < SANE_POSITION_M and is_on_earth(command.x, command.y)):
        return None
    if command.frame in RELATIVE_FRAMES:
        altitude_m = around.home.altitude_m + command.z
    elif command.frame in ABSOLUTE_FRAMES:
        altitude_m = command.z
    else:
        return None
    north_m, east_m = around.to_plane(command.x / 1e7, command.y / 1e7)
    return north_m, east_m, altitude_m


def rotated(north: float, east: float, angle_rad: float) -> tuple[float, float]:
    """Return a horizontal vector (north, east), turned clockwise by an angle."""
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return north * cosine - east * sine, north * sine + east * cosine


def clip(value: float, least: float, greatest: float) -> float:
    """Return the value, limited to the bounds."""
    return min(max(value, least), greatest)


def followed_share(dt_s: float, lag_s: float) -> float:
    """Return the share of a difference that something with a time constant of `lag_s` makes up in `dt_s`."""
    return -math.expm1(-dt_s / lag_s)


def _place(message: Message, body: Body, around: Surroundings) -> tuple[float, float, float] | None:
    """Return a setpoint's position as (north, east) of the plane and altitude; None if it is invalid.

    The position is relative to the local frame's origin in frame 1, and to the vehicle in the other frames.
    """
    x_m, y_m, z_m = message.x, message.y, message.z
    if not all(abs(metres) < SANE_POSITION_M for metres in (x_m, y_m, z_m)):
        return None
    if message.coordinate_frame == _FRAME_LOCAL:
        north_m, east_m = around.local_to_plane(x_m, y_m)
        return north_m, east_m, around.origin_altitude_m - z_m
    if message.coordinate_frame in _BODY_FRAMES:
        x_m, y_m = rotated(x_m, y_m, body.heading_rad + around.convergence_rad)
    north_m, east_m = rotated(x_m, y_m, -around.convergence_rad)
    return body.north_m + north_m, body.east_m + east_m, body.altitude_m - z_m
