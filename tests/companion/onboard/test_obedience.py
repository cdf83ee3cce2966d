"""Whether the vehicle obeys: what is measured of it, what is reckoned with, and what becomes of one that does not."""

from __future__ import annotations

import math
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.autopilot.adapter import Abilities
from companion.geo.kinematics import GRAVITY_M_S2
from companion.guard.types import Setpoint
from companion.onboard.answer import Rung
from companion.onboard.config import LimitsSection
from companion.onboard.limits import within
from companion.onboard.obedience import (
    NOTHING,
    Expected,
    Measured,
    Obedience,
    Seen,
    in_words,
    watch,
)

COPTER = LimitsSection(speed_m_s=8.0, n_max=0.21, reaction_s=0.2, braking_m_s2=2.0, wind_m_s=3.0)
"""It turns at 15 degrees a second."""
PLANE = LimitsSection(speed_m_s=16.0, n_max=0.5, reaction_s=0.2, wind_m_s=4.0)
LEAD_RAD = math.radians(60.0)
"""Greatest lead of the commanded course over the flown one in these tests."""
NEVER = Setpoint(math.nan, 0.0, 30.0)


@dataclass
class Vehicle:
    """A small stand-in: it obeys each setpoint after a delay, at shares of the rates that it should have."""

    limits: LimitsSection = COPTER
    can_stop: bool = True
    share: float = 1.0
    delay_s: float = 0.2
    acceleration_m_s2: float = 2.0
    braking_m_s2: float = 2.0
    pace: float = 1.0
    """Airspeed over the asked one."""
    deaf: bool = False
    """Whether it ignores every setpoint."""
    airspeed_max_m_s: float = math.inf
    """Airspeed at which it is saturated: then it reaches no more, and does not turn to what is near its course."""
    wind_m_s: tuple[float, float] = (0.0, 0.0)
    course_rad: float = 0.0
    speed_m_s: float = 8.0
    heard: deque[tuple[float, Setpoint]] = field(default_factory=deque)

    def fly(self, setpoint: Setpoint, now_s: float, dt_s: float) -> None:
        """Fly for a time with a new setpoint."""
        self.heard.append((now_s, setpoint))
        for k in range(max(1, round(dt_s / 0.05))):
            self._step(now_s + k * 0.05, min(0.05, dt_s))

    def _step(self, at_s: float, step_s: float) -> None:
        while len(self.heard) > 1 and self.heard[1][0] + self.delay_s <= at_s + 1e-9:
            self.heard.popleft()
        since_s, obeyed = self.heard[0]
        if self.deaf or since_s + self.delay_s > at_s + 1e-9:
            return
        turn_rad = math.remainder(obeyed.heading_rad - self.course_rad, math.tau)
        wanted_m_s = obeyed.speed_m_s * self.pace
        needed_m_s = math.hypot(
            wanted_m_s * math.cos(obeyed.heading_rad) - self.wind_m_s[0],
            wanted_m_s * math.sin(obeyed.heading_rad) - self.wind_m_s[1],
        )
        if needed_m_s > self.airspeed_max_m_s:
            wanted_m_s *= max(0.3, 1.0 - (needed_m_s - self.airspeed_max_m_s) / max(wanted_m_s, 0.1))
            turn_rad = 0.0 if abs(turn_rad) < math.radians(70.0) else turn_rad
        load_m_s2 = self.share * self.limits.n_max * GRAVITY_M_S2
        most_rad = load_m_s2 / max(self.speed_m_s, 0.5) * step_s
        self.course_rad += min(max(turn_rad, -most_rad), most_rad)
        change_m_s = wanted_m_s - self.speed_m_s
        self.speed_m_s += min(max(change_m_s, -self.braking_m_s2 * step_s), self.acceleration_m_s2 * step_s)


@dataclass
class Loop:
    """A vehicle, the monitor, and a command that is walked as guidance and guard walk it."""

    vehicle: Vehicle
    dt_s: float = 0.5
    noise_m_s: float = 0.0
    tells_wind: bool = False
    told_airspeed_max_m_s: float = math.inf
    now_s: float = 1000.0
    state: Obedience = Obedience()
    setpoint: Setpoint | None = None
    random: random.Random = field(default_factory=lambda: random.Random(1))

    @property
    def expected(self) -> Expected:
        return Expected(self.vehicle.limits, self.vehicle.can_stop, self.told_airspeed_max_m_s, self.dt_s)

    def seen(self) -> Seen:
        vehicle = self.vehicle
        off = [self.random.gauss(0.0, self.noise_m_s) if self.noise_m_s else 0.0 for _ in range(2)]
        north_m_s = vehicle.speed_m_s * math.cos(vehicle.course_rad) + off[0]
        east_m_s = vehicle.speed_m_s * math.sin(vehicle.course_rad) + off[1]
        air_m_s = (north_m_s - vehicle.wind_m_s[0], east_m_s - vehicle.wind_m_s[1])
        return Seen(
            at_s=self.now_s,
            course_rad=math.atan2(east_m_s, north_m_s),
            speed_m_s=math.hypot(north_m_s, east_m_s),
            asked=self.setpoint,
            yaw_rad=math.atan2(air_m_s[1], air_m_s[0]),
            airspeed_m_s=math.nan if vehicle.can_stop else math.hypot(*air_m_s),
            wind_ned_m_s=vehicle.wind_m_s if self.tells_wind else None,
        )

    def step(
        self, wanted_rad: float, speed_m_s: float | None = None, look: Callable[[Seen], Seen] = lambda seen: seen
    ) -> Obedience:
        """Let the monitor look, walk the command towards a course, and fly one step."""
        vehicle = self.vehicle
        self.state = watch(self.state, look(self.seen()), self.expected)
        limits = within(vehicle.limits, Abilities(), self.state.worse)
        asked_m_s = min(limits.speed_m_s, vehicle.limits.speed_m_s if speed_m_s is None else speed_m_s)
        asked_m_s *= self.state.answer.speed_share if vehicle.can_stop else 1.0
        before_rad = vehicle.course_rad if self.setpoint is None else self.setpoint.heading_rad
        most_rad = limits.n_max * GRAVITY_M_S2 / max(vehicle.speed_m_s, asked_m_s, 0.5) * self.dt_s
        turn_rad = math.remainder(wanted_rad - before_rad, math.tau)
        heading_rad = before_rad + min(max(turn_rad, -most_rad), most_rad)
        lead_rad = math.remainder(heading_rad - vehicle.course_rad, math.tau)
        heading_rad = vehicle.course_rad + min(max(lead_rad, -LEAD_RAD), LEAD_RAD)
        self.setpoint = Setpoint(heading_rad, asked_m_s, 30.0)
        vehicle.fly(self.setpoint, self.now_s, self.dt_s)
        self.now_s += self.dt_s
        return self.state

    def fly(self, wanted_rad: float, duration_s: float, speed_m_s: float | None = None) -> Obedience:
        for _ in range(round(duration_s / self.dt_s)):
            self.step(wanted_rad, speed_m_s)
        return self.state

    def zigzag(self, duration_s: float, leg_s: float = 10.0) -> Obedience:
        """Fly legs with turns of a right angle between them."""
        for leg in range(math.ceil(duration_s / leg_s)):
            self.fly((leg % 2) * math.pi / 2.0, leg_s)
        return self.state


TURN_RAD_S = COPTER.n_max * GRAVITY_M_S2 / COPTER.speed_m_s


def needed_s(share: float, delay_s: float) -> float:
    """Return the time that a turn of a right angle takes."""
    return delay_s + math.pi / 2.0 / (share * TURN_RAD_S)


# What is measured and reckoned with


def test_a_copter_that_turns_at_a_third_of_its_rate_is_reckoned_with_so() -> None:
    loop = Loop(Vehicle(share=1.0 / 3.0))
    loop.fly(0.0, 5.0)
    state = loop.fly(math.pi / 2.0, 6.0)
    assert state.worse.rate_share == pytest.approx(1.0 / 3.0, abs=0.08)
    assert state.answer.rung is Rung.ANSWERS
    assert within(COPTER, Abilities(), state.worse).n_max == pytest.approx(0.07, abs=0.02)
    assert (in_words(state) or "").startswith("reckons with turn rate share 0.3")


def test_a_late_vehicle_is_reckoned_with_its_reaction() -> None:
    state = Loop(Vehicle(delay_s=2.5)).zigzag(40.0)
    assert state.worse.reaction_s == pytest.approx(2.5, abs=0.6)
    assert state.worse.rate_share is None
    assert "reaction 2." in (in_words(state) or "")


@settings(max_examples=40, deadline=None)
@given(
    share=st.floats(0.1, 1.0),
    delay_s=st.floats(0.0, 3.0),
    dt_s=st.sampled_from([0.2, 0.5, 1.0]),
    noise_m_s=st.sampled_from([0.0, 0.2]),
)
def test_what_is_reckoned_with_is_what_it_does_or_it_is_slowed(
    share: float, delay_s: float, dt_s: float, noise_m_s: float
) -> None:
    loop = Loop(Vehicle(share=share, delay_s=delay_s), dt_s=dt_s, noise_m_s=noise_m_s)
    rungs = set()
    for _ in range(3):
        state = loop.zigzag(40.0, leg_s=20.0)
        rungs.add(state.answer.rung)
    limits = within(COPTER, Abilities(), state.worse)
    reckoned_s = needed_s(limits.n_max / COPTER.n_max, limits.reaction_s)
    true_s = needed_s(share, delay_s)
    assert reckoned_s >= 0.5 * true_s - 1.2 or rungs != {Rung.ANSWERS}


def test_a_copter_that_accelerates_and_brakes_at_a_third_is_measured_and_reckoned_with() -> None:
    loop = Loop(Vehicle(acceleration_m_s2=0.67, braking_m_s2=0.67, speed_m_s=0.0))
    loop.fly(0.0, 8.0)
    assert loop.state.measured.acceleration_m_s2 == pytest.approx(0.67, abs=0.15)
    loop.fly(0.0, 10.0)
    state = loop.fly(0.0, 9.0, speed_m_s=0.0)
    assert state.worse.braking_m_s2 == pytest.approx(0.67, abs=0.15)
    assert state.answer.rung is Rung.ANSWERS
    assert within(COPTER, Abilities(), state.worse).braking_m_s2 == state.worse.braking_m_s2


def test_a_plane_that_is_faster_than_asked_is_reckoned_to_turn_wider() -> None:
    plane = Vehicle(PLANE, can_stop=False, pace=1.25, speed_m_s=20.0)
    state = Loop(plane).fly(0.0, 20.0)
    assert state.worse.rate_share == pytest.approx(1.0 / 1.25**2, abs=0.02)


def test_a_wind_of_twice_the_configured_is_reckoned_with() -> None:
    loop = Loop(Vehicle(wind_m_s=(0.0, -6.0)), tells_wind=True)
    state = loop.fly(0.0, 15.0)
    assert state.worse.wind_m_s == pytest.approx(6.0)
    assert within(COPTER, Abilities(), state.worse).wind_m_s == pytest.approx(6.0)
    assert in_words(state) == "reckons with wind 6.0 m/s measured"


def test_a_planes_wind_is_estimated_from_nose_and_airspeed_where_none_is_told() -> None:
    plane = Vehicle(PLANE, can_stop=False, speed_m_s=16.0, wind_m_s=(3.0, -2.0))
    state = Loop(plane).fly(0.0, 10.0)
    assert state.measured.wind_ned_m_s == pytest.approx((3.0, -2.0))


def test_before_it_saturates_a_copter_is_slowed_to_what_the_wind_leaves() -> None:
    loop = Loop(Vehicle(wind_m_s=(-5.2, 0.0)), tells_wind=True, told_airspeed_max_m_s=10.3)
    state = loop.fly(0.0, 15.0)
    assert within(COPTER, Abilities(), state.worse).speed_m_s == pytest.approx(10.3 - 5.2)
    assert in_words(state) == "reckons with airspeed 10.3 m/s in 5.2 m/s of wind measured"


def test_a_copter_that_stays_slower_than_asked_is_asked_for_no_more() -> None:
    loop = Loop(Vehicle(pace=0.6, speed_m_s=4.8))
    state = loop.fly(0.0, 10.0)
    assert within(COPTER, Abilities(), state.worse).speed_m_s == pytest.approx(4.8, abs=0.2)


# What is never reckoned with


@settings(max_examples=40, deadline=None)
@given(
    dt_s=st.sampled_from([0.1, 0.2, 0.5, 1.0, 2.0, 5.0]),
    noise_m_s=st.floats(0.0, 0.3),
    late_s=st.floats(0.0, 0.5),
    plane=st.booleans(),
    legs=st.lists(st.tuples(st.floats(-math.pi, math.pi), st.floats(0.0, 1.0)), min_size=3, max_size=6),
    seed=st.integers(0, 1000),
)
def test_nothing_is_held_against_a_vehicle_that_obeys(
    dt_s: float, noise_m_s: float, late_s: float, plane: bool, legs: list[tuple[float, float]], seed: int
) -> None:
    limits = PLANE if plane else COPTER
    vehicle = Vehicle(limits, not plane, delay_s=limits.reaction_s + late_s, speed_m_s=limits.speed_m_s)
    loop = Loop(vehicle, dt_s, noise_m_s, random=random.Random(seed))
    for course_rad, speed_share in legs:
        # Whole turns, stops and starts among them.
        asked_m_s = limits.speed_m_s * (1.0 if plane or speed_share > 0.7 else speed_share)
        state = loop.fly(course_rad, max(12.0, 4.0 * dt_s), asked_m_s)
        assert (state.worse, state.answer.rung) == (NOTHING, Rung.ANSWERS)


def test_one_wrong_sample_changes_nothing() -> None:
    loop = Loop(Vehicle())
    loop.fly(1.0, 10.0)
    wrong: tuple[Callable[[Seen], Seen], ...] = (
        lambda seen: seen._replace(course_rad=3.0),
        lambda seen: seen._replace(speed_m_s=40.0),
        lambda seen: seen._replace(course_rad=math.nan),
        lambda seen: seen._replace(speed_m_s=-1.0),
    )
    for look in wrong:
        loop.step(1.0, look=look)
        state = loop.fly(1.0, 8.0)
        assert (state.worse, state.answer.rung) == (NOTHING, Rung.ANSWERS)


def test_telemetry_that_stands_still_tells_nothing() -> None:
    loop = Loop(Vehicle(deaf=True))
    loop.fly(1.0, 2.0)
    before = loop.state
    for _ in range(40):
        loop.step(1.0, look=lambda seen: seen._replace(at_s=before.samples[-1].at_s))
    assert loop.state is before


def test_after_a_gap_the_window_begins_anew() -> None:
    loop = Loop(Vehicle(deaf=True))
    loop.fly(1.0, 4.0)
    loop.now_s += 4.0
    loop.step(1.0)
    assert len(loop.state.samples) == 1
    assert loop.fly(1.0, 2.0).answer.rung is Rung.ANSWERS


def test_without_a_setpoint_in_force_nothing_is_held_against_it() -> None:
    loop = Loop(Vehicle(deaf=True))
    for _ in range(40):
        loop.state = watch(loop.state, loop.seen()._replace(asked=None), loop.expected)
        loop.now_s += 0.5
    assert loop.state == Obedience()


def test_the_window_is_bounded_whatever_the_step() -> None:
    for dt_s in (0.1, 0.5, 5.0):
        assert 4 <= len(Loop(Vehicle(), dt_s).fly(0.0, 60.0).samples) <= 32


# Better again


def test_it_gets_better_only_after_a_long_time_of_turns_and_never_beyond_what_is_configured() -> None:
    loop = Loop(Vehicle(share=1.0 / 3.0))
    state = loop.zigzag(30.0)
    found = state.worse.rate_share
    assert found is not None
    loop.vehicle.share = 1.0
    assert loop.zigzag(40.0).worse.rate_share == found
    for _ in range(20):
        loop.zigzag(60.0)
    assert loop.state.worse == NOTHING
    assert within(COPTER, Abilities(), loop.state.worse) == COPTER


def test_a_time_of_flying_straight_on_tells_nothing_of_turns() -> None:
    loop = Loop(Vehicle(share=1.0 / 3.0))
    found = loop.zigzag(30.0).worse.rate_share
    assert found is not None
    assert loop.fly(loop.vehicle.course_rad, 200.0).worse.rate_share == found


# Whether it answers at all


def test_a_deaf_copter_is_slowed_then_stopped_then_left_to_its_autopilot() -> None:
    loop = Loop(Vehicle(deaf=True))
    seen: list[Rung] = []
    for _ in range(120):
        rung = loop.step(math.pi / 2.0).answer.rung
        if rung not in seen:
            seen.append(rung)
    assert seen == [Rung.ANSWERS, Rung.SLOWED, Rung.STOPPED, Rung.LEFT]


def test_a_deaf_copter_is_slowed_within_seconds_and_why_is_said() -> None:
    loop = Loop(Vehicle(deaf=True))
    state = loop.fly(math.pi / 2.0, 6.0)
    assert state.answer.speed_share == 0.5
    assert (state.answer.trigger or "").startswith("slowed: does not turn: 0.0 of ")


def test_a_saturated_copter_that_flies_away_is_slowed_until_it_turns() -> None:
    vehicle = Vehicle(wind_m_s=(-4.0, -4.0), airspeed_max_m_s=10.3, course_rad=math.radians(64.0))
    loop = Loop(vehicle, tells_wind=True)
    wanted_rad = math.radians(110.0)
    slowest = 1.0
    for _ in range(60):
        slowest = min(slowest, loop.step(wanted_rad).answer.speed_share)
    assert slowest < 1.0
    assert abs(math.remainder(vehicle.course_rad - wanted_rad, math.tau)) < 0.1


def test_the_wind_and_what_is_reachable_stand_in_the_words() -> None:
    loop = Loop(Vehicle(wind_m_s=(-5.2, 0.0)), tells_wind=True, told_airspeed_max_m_s=10.3)
    loop.fly(0.0, 10.0)
    loop.vehicle.deaf = True
    words = ""
    for _ in range(20):
        state = loop.step(math.pi / 2.0)
        words = state.answer.words or words
    assert words.endswith("wind 5.2 m/s measured, 8 + 5.2 above the reachable 10.3 m/s")


def test_a_deaf_plane_is_left_to_its_autopilot() -> None:
    loop = Loop(Vehicle(PLANE, can_stop=False, deaf=True, speed_m_s=16.0))
    assert loop.fly(math.pi / 2.0, 10.0).answer.rung is Rung.LEFT


def test_a_plane_that_keeps_a_course_ten_degrees_beside_the_asked_one_answers() -> None:
    loop = Loop(Vehicle(PLANE, can_stop=False, speed_m_s=16.0))
    for _ in range(60):
        state = loop.step(0.0, look=lambda seen: seen._replace(course_rad=seen.course_rad - math.radians(10.0)))
        assert state.answer.rung is Rung.ANSWERS


def test_a_copter_that_answers_again_gets_its_speed_back_after_a_while() -> None:
    loop = Loop(Vehicle(deaf=True))
    loop.fly(math.pi / 2.0, 6.0)
    loop.vehicle.deaf = False
    assert loop.fly(math.pi / 2.0, 10.0).answer.rung is Rung.SLOWED
    assert loop.fly(math.pi / 2.0, 10.0).answer.rung is Rung.ANSWERS


def test_a_stopped_copter_that_stands_goes_on_slowed() -> None:
    loop = Loop(Vehicle(deaf=True))
    while loop.state.answer.rung is not Rung.STOPPED:
        loop.step(math.pi / 2.0)
    loop.vehicle.deaf = False
    loop.fly(math.pi / 2.0, 8.0)
    assert loop.vehicle.speed_m_s < 0.1
    assert loop.fly(math.pi / 2.0, 10.0).answer.rung is Rung.SLOWED


def test_a_copter_that_stays_on_the_spot_does_not_answer() -> None:
    loop = Loop(Vehicle(deaf=True, speed_m_s=0.0))
    state = loop.fly(0.0, 7.0)
    assert state.answer.words.startswith("does not gain speed: 0.0 m/s where 8.0 are asked")


def test_a_measurement_is_a_value() -> None:
    assert Measured().wind_m_s is None
    assert Measured(wind_ned_m_s=(3.0, 4.0)).wind_m_s == 5.0


@pytest.mark.parametrize(("beside_deg", "rung"), [(12.0, Rung.ANSWERS), (40.0, Rung.LEFT)])
def test_a_plane_that_the_wind_holds_somewhat_beside_its_course_answers(beside_deg: float, rung: Rung) -> None:
    limits = LimitsSection(speed_m_s=15.0, n_max=0.4, reaction_s=0.2, wind_m_s=7.0)
    state = Obedience()
    for step in range(60):
        seen = Seen(0.5 * step, math.radians(beside_deg), 6.2, Setpoint(0.0, 15.0, 80.0), wind_ned_m_s=(-7.0, 0.0))
        state = watch(state, seen, Expected(limits, False, 15.5, 0.5))
    assert state.answer.rung is rung
    assert "above the reachable" not in state.answer.words
