"""The commanded course goes on where the vehicle does not follow: nothing keeps a vehicle on a course for ever."""

from __future__ import annotations

import math
from typing import NamedTuple, Protocol

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.guard.lead import MOST_LEAD_RAD
from companion.guard.types import Motion
from companion.guidance.view import View
from companion.mission.model import CostWeights
from companion.onboard.config import Config, LimitsSection
from companion.onboard.decision import Purpose
from companion.onboard.engagement import Engagement, GridSetpoint
from companion.onboard.goal import Goal
from companion.onboard.steering import Moment, steer, steering_of

SPEED_M_S = 8.0
N_MAX = 0.18
RATE_RAD_S = N_MAX * 9.80665 / SPEED_M_S
STEP_S = 0.5
FAR_M = 1e6
PARTS = 5
"""Number of steps of the vehicle's motion in one guidance step."""
LEAN_M_S2 = 9.80665 * math.tan(math.radians(30.0))
TOP_M_S = 10.3
"""Acceleration and airspeed of a copter that leans by 30 degrees against the drag."""


class Vehicle(Protocol):
    """A vehicle that is told a course and a speed over the ground."""

    velocity_m_s: complex
    """Velocity over the ground; north is the real part."""

    def fly(self, heading_rad: float, speed_m_s: float, dt_s: float) -> None: ...


class Turner:
    """A plane that turns its nose behind the command, late and slowly, and that the wind carries along."""

    def __init__(self, nose_rad: float, lag_s: float, share: float, wind_m_s: complex) -> None:
        self._nose_rad, self._lag_s, self._wind_m_s = nose_rad, lag_s, wind_m_s
        self._most_rad_s = share * RATE_RAD_S
        self.velocity_m_s = complex(0.0)
        self.fly(nose_rad, SPEED_M_S, 0.0)

    def fly(self, heading_rad: float, speed_m_s: float, dt_s: float) -> None:
        turn_rad = math.remainder(heading_rad - self._nose_rad, math.tau)
        turn_rad *= -math.expm1(-dt_s / max(self._lag_s, 1e-3))
        self._nose_rad += min(max(turn_rad, -self._most_rad_s * dt_s), self._most_rad_s * dt_s)
        self.velocity_m_s = speed_m_s * complex(math.cos(self._nose_rad), math.sin(self._nose_rad)) + self._wind_m_s


class Follower:
    """A copter that follows a velocity over the ground late and slowly, as far as its greatest airspeed allows."""

    def __init__(self, velocity_m_s: complex, lag_s: float, share: float, wind_m_s: complex) -> None:
        self._lag_s, self._wind_m_s = lag_s, wind_m_s
        self._most_m_s2 = share * N_MAX * 9.80665
        self.velocity_m_s = velocity_m_s

    def fly(self, heading_rad: float, speed_m_s: float, dt_s: float) -> None:
        lacking_m_s = speed_m_s * complex(math.cos(heading_rad), math.sin(heading_rad)) - self.velocity_m_s
        lacking_m_s *= -math.expm1(-dt_s / max(self._lag_s, 1e-3))
        self.velocity_m_s += lacking_m_s * min(1.0, self._most_m_s2 * dt_s / max(abs(lacking_m_s), 1e-9))
        air_m_s = self.velocity_m_s - self._wind_m_s
        self.velocity_m_s = self._wind_m_s + air_m_s * min(1.0, TOP_M_S / max(abs(air_m_s), 1e-9))


class Leaner:
    """A copter that leans towards the velocity it lacks, up to a greatest lean, against the drag of the air.

    Its integrator is what holds it on its course: it holds the lean that was needed and learns nothing at the limit.
    """

    def __init__(self, velocity_m_s: complex, wind_m_s: complex) -> None:
        self.velocity_m_s, self._wind_m_s = velocity_m_s, wind_m_s
        self._held_m_s2 = (velocity_m_s - wind_m_s) * (LEAN_M_S2 / TOP_M_S)

    def fly(self, heading_rad: float, speed_m_s: float, dt_s: float) -> None:
        lacking_m_s = speed_m_s * complex(math.cos(heading_rad), math.sin(heading_rad)) - self.velocity_m_s
        wanted_m_s2 = 2.0 * lacking_m_s + self._held_m_s2
        lean_m_s2 = wanted_m_s2 * min(1.0, LEAN_M_S2 / max(abs(wanted_m_s2), 1e-9))
        if lean_m_s2 == wanted_m_s2:
            self._held_m_s2 += lacking_m_s * dt_s
        drag_m_s2 = (self.velocity_m_s - self._wind_m_s) * (LEAN_M_S2 / TOP_M_S)
        self.velocity_m_s += (lean_m_s2 - drag_m_s2) * dt_s


class Commanded(NamedTuple):
    """What one guidance step commanded, and the course and the place that were measured before it."""

    heading_rad: float
    course_rad: float
    place_ned_m: complex


def nothing_known() -> View:
    none = np.zeros(0)
    return View(None, math.inf, np.zeros((0, 2)), none, none, none, none, np.zeros((0, 2)), none, np.zeros((0, 2)),
                none, np.zeros((0, 2)))  # fmt: skip


def flown(vehicle: Vehicle, target_rad: float, seconds: float, can_stop: bool) -> list[Commanded]:
    """Fly to a target that is far away in a direction; return what was commanded at each step."""
    config = Config(
        agent_id=1,
        limits=LimitsSection(speed_m_s=SPEED_M_S, n_max=N_MAX, range_m=2 * FAR_M),
        weights=CostWeights(k_d=1e6, k_a=1e6, k_c=1e5, k_l=1e5),
        arrival_radius_m=20.0,
        separation_m=20.0,
    )
    steering = steering_of(config, can_stop)
    place_m = complex(0.0)
    target_ned_m = (FAR_M * math.cos(target_rad), FAR_M * math.sin(target_rad))
    goal = Goal(Purpose.TARGET, "assigned", target_ned_m)
    before = Engagement()
    commands = []
    for index in range(round(seconds / STEP_S)):
        course_rad = math.atan2(vehicle.velocity_m_s.imag, vehicle.velocity_m_s.real)
        motion = Motion(place_m.real, place_m.imag, course_rad, abs(vehicle.velocity_m_s))
        steered = steer(steering, goal, Moment(motion, nothing_known(), 0.0, index * STEP_S), before)
        setpoint = steered.verdict.setpoint
        assert setpoint is not None
        before = Engagement(setpoint=GridSetpoint(setpoint, 0.0))
        commands.append(Commanded(setpoint.heading_rad, course_rad, place_m))
        for _ in range(PARTS):
            vehicle.fly(setpoint.heading_rad, setpoint.speed_m_s, STEP_S / PARTS)
            place_m += vehicle.velocity_m_s * (STEP_S / PARTS)
    return commands


def closing_m_s(commands: list[Commanded], target_rad: float) -> float:
    """Return how fast a flight comes nearer to its target in its last 20 s."""
    begin, end = commands[-41], commands[-1]
    way_m = (end.place_ned_m - begin.place_ned_m) * complex(math.cos(target_rad), -math.sin(target_rad))
    return way_m.real / (40 * STEP_S)


ANGLES = st.floats(-math.pi, math.pi)


@given(ANGLES, st.floats(0.0, 3.0), st.floats(0.1, 1.0), st.floats(0.0, 0.9), ANGLES)
@settings(max_examples=30)
def test_no_wind_lag_or_slow_turning_keeps_a_plane_from_its_target(
    target_rad: float, lag_s: float, share: float, wind_share: float, wind_rad: float
) -> None:
    wind_m_s = wind_share * SPEED_M_S * complex(math.cos(wind_rad), math.sin(wind_rad))
    seconds = 1.5 * math.pi / (share * RATE_RAD_S) + 10.0 * lag_s + 60.0
    commands = flown(Turner(0.0, lag_s, share, wind_m_s), target_rad, seconds, can_stop=False)
    assert closing_m_s(commands, target_rad) > 0.05 * SPEED_M_S


@given(ANGLES, st.floats(0.0, 3.0), st.floats(0.1, 1.0), st.floats(0.0, 0.9), ANGLES)
@settings(max_examples=30)
def test_no_wind_lag_or_slow_answer_keeps_a_copter_from_its_target(
    target_rad: float, lag_s: float, share: float, wind_share: float, wind_rad: float
) -> None:
    wind_m_s = wind_share * TOP_M_S * complex(math.cos(wind_rad), math.sin(wind_rad))
    seconds = 1.5 * math.pi / (share * RATE_RAD_S) + 10.0 * lag_s + 90.0
    vehicle = Follower(complex(SPEED_M_S, 0.0), lag_s, share, wind_m_s)
    commands = flown(vehicle, target_rad, seconds, can_stop=True)
    assert closing_m_s(commands, target_rad) > 0.05 * SPEED_M_S


@given(ANGLES, st.floats(0.0, 0.9), ANGLES)
@settings(max_examples=30)
def test_no_wind_keeps_a_copter_at_its_greatest_lean_from_its_target(
    target_rad: float, wind_share: float, wind_rad: float
) -> None:
    wind_m_s = wind_share * TOP_M_S * complex(math.cos(wind_rad), math.sin(wind_rad))
    vehicle = Leaner(complex(SPEED_M_S, 0.0), wind_m_s)
    commands = flown(vehicle, target_rad, 1.5 * math.pi / RATE_RAD_S + 90.0, can_stop=True)
    assert closing_m_s(commands, target_rad) > 0.05 * SPEED_M_S


@given(ANGLES, st.floats(0.0, 3.0), st.floats(0.1, 1.0))
@settings(max_examples=30)
def test_the_command_walks_at_the_turn_limit_and_leads_the_measured_course_by_a_bounded_angle(
    target_rad: float, lag_s: float, share: float
) -> None:
    commands = flown(Turner(0.0, lag_s, share, complex(0.0)), target_rad, 40.0, can_stop=False)
    for before, after in zip(commands, commands[1:], strict=False):
        walked_rad = abs(math.remainder(after.heading_rad - before.heading_rad, math.tau))
        lead_rad = abs(math.remainder(after.heading_rad - after.course_rad, math.tau))
        assert walked_rad <= RATE_RAD_S * STEP_S + 1e-9
        assert lead_rad <= MOST_LEAD_RAD + 1e-9


def test_a_vehicle_that_does_not_turn_at_all_is_commanded_a_quarter_turn_to_one_side() -> None:
    commands = flown(Turner(0.0, 0.0, 0.0, complex(0.0)), math.radians(178.0), 30.0, can_stop=False)
    assert math.degrees(commands[-1].heading_rad) == math.degrees(MOST_LEAD_RAD)


def test_a_course_that_is_measured_on_both_sides_of_the_opposite_is_turned_to_one_side() -> None:
    class Swinging(Turner):
        def fly(self, heading_rad: float, speed_m_s: float, dt_s: float) -> None:
            super().fly(heading_rad, speed_m_s, dt_s)
            self._nose_rad = -self._nose_rad

    commands = flown(Swinging(math.radians(1.0), 0.0, 0.0, complex(0.0)), math.pi, 30.0, can_stop=False)
    assert math.degrees(commands[-1].heading_rad) > 80.0
