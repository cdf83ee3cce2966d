"""The input of a guidance law: the vehicle's world model at one moment as arrays, and the traffic that is detected."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

NOBODY = 0
"""The id that stands for "not a known agent"; agent ids begin at 1."""


def _no_rows() -> np.ndarray:  # (0, 2)
    return np.zeros((0, 2))


def _no_ids() -> np.ndarray:  # (0,)
    return np.zeros(0, dtype=int)


def _nothing() -> np.ndarray:  # (0,)
    return np.zeros(0)


@dataclass(frozen=True)
class Others:
    """The other aircraft as they were last known: first those that the own detector shows, then those told.

    Of an agent that is both seen and told only what is seen is here.
    """

    ids: np.ndarray = field(default_factory=_no_ids)  # (Q,) int, NOBODY for one that is not a known agent
    places_ned_m: np.ndarray = field(default_factory=_no_rows)  # (Q, 2) m, when they were known
    velocities_m_s: np.ndarray = field(default_factory=_no_rows)  # (Q, 2) m/s, zero where none was told
    ages_s: np.ndarray = field(default_factory=_nothing)  # (Q,) s, since place and velocity were both true
    moving_told: np.ndarray = field(default_factory=_nothing)  # (Q,) bool, whether a velocity was told
    rounding_m: np.ndarray = field(default_factory=_nothing)  # (Q,) m, greatest error of a place by the wire's rounding
    seen: int = 0
    """How many of them, the first ones, the own detector shows."""


@dataclass(frozen=True)
class View:
    """The world model at one moment, as arrays for the guidance law."""

    target_ned_m: tuple[float, float] | None
    target_age_s: float
    threats_ned_m: np.ndarray  # (M, 2) m, last broadcast positions
    detection_radius_m: np.ndarray  # (M,) m, grown by how far the threat may have moved since
    attack_radius_m: np.ndarray  # (M,) m, grown by the same
    threat_speed_m_s: np.ndarray  # (M,) m/s, upper bounds
    threat_ids: np.ndarray  # (M,) int
    threat_velocity_m_s: np.ndarray  # (M, 2) m/s, as broadcast; zero where none was
    threat_age_s: np.ndarray  # (M,) s
    peers_ned_m: np.ndarray  # (P, 2) m, extrapolated to now
    peer_ids: np.ndarray  # (P,) int, NOBODY for one that is not a known agent
    loitering_ned_m: np.ndarray  # (Q, 2) m, positions of the peers whose loiter place has precedence
    rivals: tuple[tuple[int, tuple[float, float]], ...] = ()
    """Detected agents that go to the same target as this vehicle: id, and (north, east) in metres."""
    claimed_ned_m: np.ndarray = field(default_factory=_no_rows)
    """(C, 2) m, targets assigned to other agents, which a vehicle that loiters leaves room to reach."""
    traffic_ned_m: np.ndarray = field(default_factory=_no_rows)  # (S, 2) m, all detected aircraft
    traffic_velocity_m_s: np.ndarray = field(default_factory=_no_rows)  # (S, 2) m/s
    others: Others = field(default_factory=Others)
    """Everybody who may count to the right of way."""
    threat_pictures: np.ndarray | None = None
    """(M,) int, number of the picture that the last word on each threat was of; None: one has told of all."""
    unit_m: float = 0.0
    """Unit of the threats' places and radii as they were told, m."""
    whole: bool = True
    """Whether every threat of the broadcast's picture was heard; if not, nothing can be certified."""

    def keep_out_m(self, keep_out: Literal["attack", "detection"]) -> np.ndarray:  # (M,) m
        """Return the radii that a vehicle keeps out of: the threats' attack or their detection radii."""
        return self.attack_radius_m if keep_out == "attack" else self.detection_radius_m


@dataclass(frozen=True)
class Traffic:
    """Another aircraft that the vehicle's own detector sees, extrapolated to now on the mission's plane."""

    agent_id: int | None
    """Its agent id; None for an aircraft that is not of the fleet."""
    position_ned_m: tuple[float, float]
    velocity_m_s: tuple[float, float]
    age_s: float = 0.0
    """Time since it was seen; its position is that of then, carried on by its velocity."""
