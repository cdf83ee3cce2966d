"""The path between two samples of a trajectory, on which arrivals, entries and least distances are judged.

A kinematic vehicle turns at its greatest rate and then flies straight on, while the wind carries it away
(`companion.geo.kinematics.turn_towards`). Its poses at both samples determine that path, to the rounding of the file.
Of any other vehicle the path is an arc between the two positions that turns by as much as its heading did. Targets and
threats move straight from sample to sample.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from companion.geo.kinematics import turn_rate_rad_s
from companion.mission.model import Mission
from sim.trajectory import Trajectory

ROUNDING_M = 0.01
"""Error of a path between two samples, whose positions and headings are rounded (trajectory.csv): what comes this near
to a limit between samples has not passed it."""
_OFF_M = 0.05
"""Distance from its sample at which the path of a kinematic vehicle may end, beyond the drift in the greatest wind."""
_GREATEST_ARC_RAD = 0.5 * math.pi
"""Greatest turn between two samples that is taken for an arc; a vehicle that turned by more may have flown anything."""
_PARTS = 16
"""Number of parts of a path that are searched for the nearest place; within a part there is only one."""
_NARROWINGS = 24
"""Number of golden sections of two parts: to 1e-6 of the path's length."""
_HALVINGS = 40
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


class Crafts(NamedTuple):
    """What agents can fly, in the order of a mission's list."""

    speed_m_s: np.ndarray  # (N,) m/s through the air
    rate_rad_s: np.ndarray  # (N,) rad/s, greatest turn rate
    wind_m_s: float
    """Greatest speed of the wind."""

    def reach_m(self, chord_m: np.ndarray, lasts_s: np.ndarray) -> np.ndarray:  # (S, N), (S, 1) -> (S, N)
        """Return a length that no path between samples `chord_m` apart exceeds."""
        point_m = (self.speed_m_s + self.wind_m_s) * lasts_s + _OFF_M
        # An arc of at most _GREATEST_ARC_RAD is less than 1.2 times as long as its chord.
        reach_m: np.ndarray = np.maximum(point_m, 1.2 * chord_m)
        return reach_m


class Pose(NamedTuple):
    """Positions and headings at one end of L paths, as in the file."""

    ned_m: np.ndarray  # (L, 2) m
    heading_deg: np.ndarray  # (L,) deg


class Paths(NamedTuple):
    """L paths between two samples: a turn, then straight on, while everything drifts."""

    start_ned_m: np.ndarray  # (L, 2) m
    heading_rad: np.ndarray  # (L,) rad at the start
    turn_rad: np.ndarray  # (L,) rad, positive to the right
    turning_s: np.ndarray  # (L,) s
    speed_m_s: np.ndarray  # (L,) m/s
    drift_m_s: np.ndarray  # (L, 2) m/s
    lasts_s: np.ndarray  # (L,) s

    def at(self, t_s: np.ndarray) -> np.ndarray:  # (L,) -> (L, 2)
        """Return the positions at times since the start of each path."""
        turned_s = np.minimum(t_s, self.turning_s)
        half_rad = 0.5 * self.turn_rad * turned_s / np.maximum(self.turning_s, np.finfo(float).tiny)
        chord_m = self.speed_m_s * turned_s * np.sinc(half_rad / math.pi)
        straight_m = self.speed_m_s * (t_s - turned_s)
        middle_rad, end_rad = self.heading_rad + half_rad, self.heading_rad + self.turn_rad
        north_m = chord_m * np.cos(middle_rad) + straight_m * np.cos(end_rad)
        east_m = chord_m * np.sin(middle_rad) + straight_m * np.sin(end_rad)
        places_m: np.ndarray = self.start_ned_m + np.stack((north_m, east_m), axis=-1) + self.drift_m_s * t_s[:, None]
        return places_m


def crafts_of(mission: Mission) -> Crafts:
    """Return what a mission's agents can fly."""
    return Crafts(
        np.array([agent.speed_m_s for agent in mission.agents]),
        np.array([turn_rate_rad_s(agent.speed_m_s, agent.n_max) for agent in mission.agents]),
        mission.wind.speed_m_s + mission.wind.gust_m_s,
    )


def straight(from_ned_m: np.ndarray, to_ned_m: np.ndarray, lasts_s: np.ndarray) -> Paths:
    """Return straight paths between positions (L, 2), at a steady speed."""
    still = np.zeros(len(lasts_s))
    return Paths(from_ned_m, still, still, still, still, (to_ned_m - from_ned_m) / lasts_s[:, None], lasts_s)


def flown(before: Pose, after: Pose, lasts_s: np.ndarray, crafts: Crafts) -> Paths:
    """Return the paths that agents flew between two samples; `crafts` has the agent of each path."""
    turn_rad = np.radians((after.heading_deg - before.heading_deg + 180.0) % 360.0 - 180.0)
    heading_rad = np.radians(before.heading_deg)
    along_m = after.ned_m - before.ned_m
    # As a kinematic vehicle: what is left between the end of its path and the sample is the wind's.
    point = Paths(
        before.ned_m,
        heading_rad,
        turn_rad,
        np.minimum(np.abs(turn_rad) / crafts.rate_rad_s, lasts_s),
        crafts.speed_m_s,
        np.zeros_like(along_m),
        lasts_s,
    )
    off_m = after.ned_m - point.at(lasts_s)
    is_point = np.hypot(off_m[:, 0], off_m[:, 1]) <= crafts.wind_m_s * lasts_s + _OFF_M
    # As anything else: an arc over the whole time, whose chord lies between the samples.
    arc_rad = np.where(np.abs(turn_rad) <= _GREATEST_ARC_RAD, turn_rad, 0.0)
    arc_m_s = np.hypot(along_m[:, 0], along_m[:, 1]) / (lasts_s * np.sinc(0.5 * arc_rad / math.pi))
    return Paths(
        before.ned_m,
        np.where(is_point, heading_rad, np.arctan2(along_m[:, 1], along_m[:, 0]) - 0.5 * arc_rad),
        np.where(is_point, turn_rad, arc_rad),
        np.where(is_point, point.turning_s, lasts_s),
        np.where(is_point, crafts.speed_m_s, arc_m_s),
        np.where(is_point[:, None], off_m / lasts_s[:, None], 0.0),
        lasts_s,
    )


def flown_by(trajectory: Trajectory, crafts: Crafts, segments: np.ndarray, agents: np.ndarray) -> Paths:
    """Return L paths of a trajectory: of agents (L,) by index, from the samples `segments` (L,) to the next ones."""
    before, after = (
        Pose(trajectory.agents_ned_m[samples, agents], trajectory.agents_heading_deg[samples, agents])
        for samples in (segments, segments + 1)
    )
    lasts_s = trajectory.t_s[segments + 1] - trajectory.t_s[segments]
    own = Crafts(crafts.speed_m_s[agents], crafts.rate_rad_s[agents], crafts.wind_m_s)
    return flown(before, after, lasts_s, own)


def moved(trajectory: Trajectory, places_ned_m: np.ndarray, segments: np.ndarray, things: np.ndarray) -> Paths:
    """Return L straight paths of targets or threats, whose positions are (S, K, 2), as `flown_by` does of agents."""
    lasts_s = trajectory.t_s[segments + 1] - trajectory.t_s[segments]
    return straight(places_ned_m[segments, things], places_ned_m[segments + 1, things], lasts_s)


def apart_m(first: Paths, second: Paths, t_s: np.ndarray) -> np.ndarray:  # (L,) -> (L,)
    """Return the distances between two paths each at times since their start."""
    offset_m = first.at(t_s) - second.at(t_s)
    distance_m: np.ndarray = np.hypot(offset_m[:, 0], offset_m[:, 1])
    return distance_m


def nearest(first: Paths, second: Paths) -> tuple[np.ndarray, np.ndarray]:  # (L,) s, (L,) m
    """Return when two paths each are nearest, since their start, and how far apart they are then."""
    if len(first.lasts_s) == 0:
        return np.zeros(0), np.zeros(0)
    shares = np.linspace(0.0, 1.0, _PARTS + 1)
    parts_m = np.stack([apart_m(first, second, share * first.lasts_s) for share in shares])
    best = parts_m.argmin(axis=0)
    low_s = shares[np.maximum(best - 1, 0)] * first.lasts_s
    high_s = shares[np.minimum(best + 1, _PARTS)] * first.lasts_s
    for _ in range(_NARROWINGS):
        left_s, right_s = high_s - _GOLDEN * (high_s - low_s), low_s + _GOLDEN * (high_s - low_s)
        nearer = apart_m(first, second, left_s) <= apart_m(first, second, right_s)
        low_s, high_s = np.where(nearer, low_s, left_s), np.where(nearer, right_s, high_s)
    t_s = 0.5 * (low_s + high_s)
    found_m, part_m = apart_m(first, second, t_s), parts_m.min(axis=0)
    at_part = part_m <= found_m
    return np.where(at_part, shares[best] * first.lasts_s, t_s), np.where(at_part, part_m, found_m)


def first_within(first: Paths, second: Paths, radius_m: float) -> np.ndarray:  # (L,) s
    """Return when two paths each are first within a radius, since their start; inf where they never are."""
    nearest_s, nearest_m = nearest(first, second)
    shares = np.linspace(0.0, 1.0, _PARTS + 1)
    inside = np.stack([apart_m(first, second, share * first.lasts_s) <= radius_m for share in shares])
    # Every part before the first end inside ends outside; the nearest place may lie within such a part.
    part = np.where(inside.any(axis=0), inside.argmax(axis=0), _PARTS)
    high_s, before = shares[part] * first.lasts_s, np.maximum(part - 1, 0)
    within_part = (nearest_m <= radius_m) & (nearest_s < high_s)
    before = np.where(within_part, np.floor(nearest_s / first.lasts_s * _PARTS), before)
    high_s = np.where(within_part, nearest_s, high_s)
    low_s = before / _PARTS * first.lasts_s
    for _ in range(_HALVINGS):
        middle_s = 0.5 * (low_s + high_s)
        is_within = apart_m(first, second, middle_s) <= radius_m
        low_s, high_s = np.where(is_within, low_s, middle_s), np.where(is_within, middle_s, high_s)
    found_s: np.ndarray = np.where(inside[0], 0.0, np.where(nearest_m <= radius_m, high_s, np.inf))
    return found_s
