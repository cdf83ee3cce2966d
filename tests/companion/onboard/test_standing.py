"""Vehicles that can stop stand at their place soon after they arrive, in wind and behind a lag, and stay there.

The vehicle is a small model: its velocity follows the commanded one with a lag, up to an acceleration and an airspeed.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.geo.kinematics import GRAVITY_M_S2
from companion.guard.types import Motion
from companion.guidance.approach import SPEED_LAG_S, STANDING_M_S, Flown, approach_m
from companion.guidance.view import View
from companion.onboard.config import Config, LimitsSection
from companion.onboard.decision import Purpose
from companion.onboard.directives import Directives
from companion.onboard.engagement import Engagement, GridSetpoint
from companion.onboard.failsafe import FailsafeStatus
from companion.onboard.goal import Situation, choose_goal
from companion.onboard.standing import pace_of, standing_place
from companion.onboard.steering import Moment, Steered, steer, steering_of
from companion.onboard.world_model import WorldModel
from companion.protocol.codec import Directive

ME = 3
STEP_S = 0.5
SUBSTEPS = 10
TARGET_NED_M = (0.0, 0.0)
HOME_NED_M = (-400.0, 0.0)
WITHIN_M = 3.0
WITHIN_S, SLOW_WITHIN_S = 15.0, 20.0
"""Time in which it stands, with a configured reaction of at most QUICK_S, and with a longer one."""
QUICK_S = 0.5


@dataclass(frozen=True)
class Scene:
    """A vehicle, where it begins, and what blows; its place to go to is the origin."""

    speed_m_s: float = 8.0
    braking_m_s2: float = 2.0
    sideways_m_s2: float = 1.75
    lag_s: float = 0.6
    reaction_s: float = 0.2
    wind: complex = 0j
    arrival_radius_m: float = 20.0
    place: complex = -150 + 0j
    heading_rad: float = 0.0
    start_m_s: float = 8.0
    directive: Directive = Directive.NORMAL

    @property
    def config(self) -> Config:
        """The companion's configuration, true to the vehicle."""
        limits = LimitsSection(
            speed_m_s=self.speed_m_s,
            n_max=self.sideways_m_s2 / GRAVITY_M_S2,
            braking_m_s2=self.braking_m_s2,
            reaction_s=self.reaction_s,
            wind_m_s=abs(self.wind),
        )
        return Config(agent_id=ME, limits=limits, arrival_radius_m=self.arrival_radius_m, separation_m=20.0)


class Sample(NamedTuple):
    """One guidance step of a flight."""

    t_s: float
    place: complex
    velocity_m_s: complex
    steered: Steered


def flown(scene: Scene, lasts_s: float) -> list[Sample]:
    """Return the guidance steps of a flight by the steering of the companion."""
    config, view = scene.config, replace(WorldModel(ME).view(0.0), target_ned_m=TARGET_NED_M)
    steering = steering_of(config, can_stop=True)
    place, velocity = scene.place, cmath.rect(scene.start_m_s, scene.heading_rad)
    before, came_from, samples = Engagement(), None, []
    for step in range(round(lasts_s / STEP_S)):
        motion = Motion(place.real, place.imag, math.atan2(velocity.imag, velocity.real) % math.tau, abs(velocity))
        directives = Directives(scene.directive)
        situation = Situation(motion.position_ned_m, HOME_NED_M, view, FailsafeStatus(), directives, came_from)
        goal = choose_goal(situation, before, config, steering.loiter)
        steered = steer(steering, goal, Moment(motion, view, 0.0, step * STEP_S), before)
        samples.append(Sample(step * STEP_S, place, velocity, steered))
        setpoint = steered.verdict.setpoint
        assert setpoint is not None
        before = Engagement(
            arrived_ned_m=goal.arrived_ned_m,
            at_home=goal.at_home,
            loiter_place_ned_m=steered.loiter_place_ned_m,
            loiter_about_ned_m=steered.loiter_about_ned_m,
            setpoint=GridSetpoint(setpoint, 0.0),
        )
        came_from = motion.position_ned_m
        for _ in range(SUBSTEPS):
            velocity = followed(velocity, cmath.rect(setpoint.speed_m_s, setpoint.heading_rad), scene)
            place += velocity * (STEP_S / SUBSTEPS)
    return samples


def followed(velocity: complex, commanded: complex, scene: Scene) -> complex:
    """Return the velocity a part of a step later: as fast as lag, acceleration and airspeed allow."""
    dt_s = STEP_S / SUBSTEPS
    change = (commanded - velocity) * (-math.expm1(-dt_s / scene.lag_s) if scene.lag_s else 1.0)
    most_m_s = 1.25 * max(scene.braking_m_s2, scene.sideways_m_s2) * dt_s
    change *= min(1.0, most_m_s / max(abs(change), 1e-12))
    through_air = velocity + change - scene.wind
    fastest_m_s = 1.2 * (scene.speed_m_s + abs(scene.wind))
    return scene.wind + through_air * min(1.0, fastest_m_s / max(abs(through_air), 1e-12))


def arrived(samples: list[Sample]) -> list[Sample]:
    """Return the samples from the first one that loiters on."""
    begins_s = next(sample.t_s for sample in samples if sample.steered.purpose is Purpose.LOITER)
    return [sample for sample in samples if sample.t_s >= begins_s]


def place_of(samples: list[Sample]) -> complex:
    found = samples[-1].steered.loiter_place_ned_m
    assert found is not None
    return complex(*found)


def assert_stands(samples: list[Sample], within_s: float = WITHIN_S) -> None:
    """Assert that from a time after the first sample the vehicle stands at its last place."""
    place = place_of(samples)
    for sample in samples:
        if sample.t_s >= samples[0].t_s + within_s + STEP_S:
            assert abs(sample.velocity_m_s) < STANDING_M_S
            assert abs(sample.place - place) < WITHIN_M


# What is arrived at, over kinds of vehicles


@st.composite
def _scenes(draw: st.DrawFn) -> Scene:
    """Draw a vehicle that needs at most five seconds to stop or to turn, whose configured reaction holds its lag."""
    speed_m_s = draw(st.floats(2.0, 15.0))
    lag_s = draw(st.floats(0.0, 1.0))
    bearing_rad, heading_rad = draw(st.floats(0.0, math.tau)), draw(st.floats(0.0, math.tau))
    return Scene(
        speed_m_s=speed_m_s,
        braking_m_s2=draw(st.floats(max(1.0, speed_m_s / 5.0), 5.0)),
        sideways_m_s2=draw(st.floats(max(1.0, speed_m_s / 5.0), 5.0)),
        lag_s=lag_s,
        reaction_s=draw(st.floats(max(0.0, lag_s - SPEED_LAG_S), 1.0)),
        wind=cmath.rect(draw(st.floats(0.0, 0.6)) * speed_m_s, draw(st.floats(0.0, math.tau))),
        arrival_radius_m=draw(st.floats(5.0, 100.0)),
        place=cmath.rect(draw(st.floats(100.0, 140.0)), bearing_rad),
        heading_rad=heading_rad,
        start_m_s=draw(st.sampled_from([0.0, speed_m_s])),
    )


def within_of(scene: Scene) -> float:
    """Return the time in which a vehicle must stand: one that reckons with a slow reaction brakes early, and creeps."""
    return WITHIN_S if scene.reaction_s <= QUICK_S else SLOW_WITHIN_S


@settings(max_examples=25)
@given(scene=_scenes())
def test_who_arrives_stands_at_the_target_within_twenty_seconds_without_a_wider_loop(scene: Scene) -> None:
    samples = arrived(flown(scene, 180.0 / scene.speed_m_s + 40.0))
    assert_stands(samples, within_of(scene))
    assert abs(place_of(samples)) <= scene.arrival_radius_m
    place = place_of(samples)
    assert max(abs(sample.place - place) for sample in samples) <= scene.arrival_radius_m


@settings(max_examples=25)
@given(scene=_scenes(), share=st.floats(0.0, 0.79), bearing_rad=st.floats(0.0, math.tau))
def test_who_finds_itself_arrived_at_any_speed_stands_as_soon(scene: Scene, share: float, bearing_rad: float) -> None:
    near = cmath.rect(share * scene.arrival_radius_m, bearing_rad)
    samples = arrived(flown(replace(scene, place=near, start_m_s=scene.speed_m_s), 40.0))
    assert_stands(samples, within_of(scene))
    # It gets no farther from the target than the way on which it comes to a stop leads it.
    stops_m = approach_m(scene.speed_m_s, pace_of(scene.config))
    assert max(abs(sample.place) for sample in samples) <= abs(near) + stops_m + 1.0


@settings(max_examples=15)
@given(scene=_scenes())
def test_who_must_wait_stops_ahead_and_does_not_turn_back(scene: Scene) -> None:
    samples = flown(replace(scene, directive=Directive.HOLD, start_m_s=scene.speed_m_s), 30.0)
    assert_stands(samples, within_s=20.0)
    ahead = cmath.rect(1.0, -scene.heading_rad)
    along_m = [((sample.place - scene.place) * ahead).real for sample in samples]
    assert max(along_m) - along_m[-1] < WITHIN_M


# Where it stands


COPTER = Scene()
CRUISING = Flown(0.0, 8.0)


def place(view: View, at: tuple[float, float], about: tuple[float, float] | None, scene: Scene = COPTER) -> complex:
    return complex(*standing_place(scene.config, view, at, CRUISING, about))


def seen(*discs: tuple[float, float, float]) -> View:
    """Return a view with standing discs (north, east, radius in m)."""
    centres = np.array([disc[:2] for disc in discs]).reshape(-1, 2)
    radii, still = np.array([disc[2] for disc in discs]), np.zeros(len(discs))
    return replace(
        WorldModel(ME).view(0.0),
        threats_ned_m=centres,
        detection_radius_m=radii,
        attack_radius_m=radii / 2,
        threat_speed_m_s=still,
    )


def test_the_place_is_the_target_that_it_has_reached() -> None:
    assert place(seen(), (-40.0, 0.0), TARGET_NED_M) == 0j


def test_a_target_too_far_away_to_stand_at_soon_is_approached_as_far_as_there_is_time_for() -> None:
    found = place(seen(), (-90.0, 0.0), TARGET_NED_M)
    assert found.imag == 0.0
    assert -50.0 < found.real < -10.0


def test_in_front_of_a_disc_about_the_target_it_stands_outside() -> None:
    found = place(seen((10.0, 0.0, 19.0)), (-40.0, 0.0), TARGET_NED_M)
    assert abs(found - 10.0) > 19.5
    assert found.real > -25.0


def test_behind_a_disc_on_the_way_there_is_no_place() -> None:
    found = place(seen((-12.0, 0.0, 4.0)), (-60.0, 0.0), TARGET_NED_M)
    assert found.real < -16.0


def test_with_nothing_to_loiter_at_the_place_is_where_it_comes_to_a_stop() -> None:
    found = place(seen(), (0.0, 0.0), None)
    assert found == pytest.approx(approach_m(8.0, pace_of(COPTER.config)))


def test_who_stands_and_has_nothing_to_loiter_at_stays() -> None:
    assert standing_place(COPTER.config, seen(), (5.0, 7.0), Flown(0.0, 0.0), None) == (5.0, 7.0)


def test_who_comes_home_stands_at_home() -> None:
    samples = arrived(flown(replace(COPTER, place=-200 + 50j, directive=Directive.RETURN), 60.0))
    assert_stands(samples)
    assert place_of(samples) == complex(*HOME_NED_M)


def test_who_stands_and_must_only_wait_keeps_its_place() -> None:
    samples = flown(COPTER, 60.0)
    steering, last = steering_of(COPTER.config, can_stop=True), samples[-1]
    before = Engagement(
        loiter_place_ned_m=last.steered.loiter_place_ned_m, loiter_about_ned_m=last.steered.loiter_about_ned_m
    )
    view = replace(WorldModel(ME).view(0.0), target_ned_m=TARGET_NED_M)
    here_ned_m = (last.place.real, last.place.imag)
    situation = Situation(here_ned_m, HOME_NED_M, view, FailsafeStatus(), Directives(Directive.HOLD), None)
    goal = choose_goal(situation, before, COPTER.config, steering.loiter)
    motion = Motion(last.place.real, last.place.imag, 0.0, 0.0)
    held = steer(steering, goal, Moment(motion, view, 0.0, 0.0), before)
    assert held.reason == "directive hold"
    assert held.loiter_place_ned_m == TARGET_NED_M
