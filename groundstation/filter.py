"""The constant-velocity filter of a track: where the next sighting is expected, and how far from there it may be.

The same noise counts along north and east, so one covariance of position and speed (2x2) holds for both, and position
and velocity are complex numbers, north + i east. The covariance's own step is FilterPy's (`filterpy.kalman`).
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

LONGEST_S = 10.0
"""Time for which a track is carried on at constant velocity; what is seen later must fit where that ended."""
GATE_SIGMAS = 3.0
"""Greatest innovation in standard deviations: an error bound counts as that many."""

Covariance = tuple[float, float, float]
"""Variance of the position in m^2, covariance in m^2/s, variance of the speed in m^2/s^2; each along one axis."""


class Noise(NamedTuple):
    """How well a thing is seen, and how suddenly it moves."""

    error_m: float
    """Greatest error of a sighting."""
    acceleration_m_s2: float
    """Greatest acceleration between two sightings."""


@dataclass(frozen=True)
class Motion:
    """Position and velocity of a track by the filter, at the time of a sighting."""

    place: complex
    velocity: complex
    covariance: Covariance
    at_s: float

    @staticmethod
    def begun(place: complex, at_s: float, noise: Noise, speed_m_s: float) -> Motion:
        """Return the motion of something first seen, whose velocity may be anything up to `speed_m_s`."""
        return Motion(place, 0j, ((noise.error_m / GATE_SIGMAS) ** 2, 0.0, speed_m_s**2), at_s)

    def expected(self, at_s: float) -> complex:
        """Return the position at a later time, carried on at constant velocity for LONGEST_S at most."""
        return self.place + self.velocity * _carried_s(self.at_s, at_s)

    def gate_m(self, at_s: float, noise: Noise) -> float:
        """Return how far from the expected position a sighting at a later time may be."""
        return GATE_SIGMAS * math.sqrt(_step(self.covariance, _carried_s(self.at_s, at_s), noise).innovation_m2)

    def updated(self, place: complex, at_s: float, noise: Noise) -> Motion:
        """Return the motion after a sighting at a later time."""
        step = _step(self.covariance, _carried_s(self.at_s, at_s), noise)
        expected = self.expected(at_s)
        off = place - expected
        return Motion(
            expected + step.gain[0] * off, self.velocity + step.gain[1] * off, step.covariance, max(self.at_s, at_s)
        )


class _Step(NamedTuple):
    """What a step of the filter does to everything but the position and velocity themselves."""

    innovation_m2: float
    """Variance of the innovation along one axis."""
    gain: tuple[float, float]
    """By how much an innovation moves the position, and the velocity (in 1/s)."""
    covariance: Covariance


@functools.lru_cache(maxsize=4096)
def _step(covariance: Covariance, dt_s: float, noise: Noise) -> _Step:
    """Return one step of the filter; it is the same for all things that are seen as well, and at the same intervals."""
    # Loaded at the first sighting: a ground station without a sensor needs none of it.
    from filterpy.kalman import predict, update

    position_m2, mixed, speed_m2_s2 = covariance
    before = np.array([[position_m2, mixed], [mixed, speed_m2_s2]])
    # The bounds count as GATE_SIGMAS standard deviations; an acceleration holds for the whole step.
    by_acceleration = np.array([[0.5 * dt_s**2], [dt_s]]) * (noise.acceleration_m_s2 / GATE_SIGMAS)
    nothing, sees = np.zeros((2, 1)), np.array([[1.0, 0.0]])
    _, ahead = predict(nothing, before, np.array([[1.0, dt_s], [0.0, 1.0]]), by_acceleration @ by_acceleration.T)
    error_m2 = np.array([[(noise.error_m / GATE_SIGMAS) ** 2]])
    # An innovation of 1 m moves the state by the gain.
    gain, after = update(nothing, ahead, np.array([[1.0]]), error_m2, sees)
    return _Step(
        float(ahead[0, 0] + error_m2[0, 0]),
        (float(gain[0, 0]), float(gain[1, 0])),
        (float(after[0, 0]), float(after[0, 1]), float(after[1, 1])),
    )


def _carried_s(from_s: float, to_s: float) -> float:
    """Return for how long a track is carried on, to the millisecond in which sightings are stamped."""
    return round(min(max(0.0, to_s - from_s), LONGEST_S), 3)
