"""What is read from a flight, on synthetic vehicles whose truth is known."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.autopilot.adapter import Abilities
from companion.onboard.config import LimitsSection
from companion.onboard.identification.estimators import circle_of, identify
from companion.onboard.identification.track import Track, stretches

LIMITS = LimitsSection(speed_m_s=8.0, n_max=0.2)
SPEED_M_S = 8.0
FINE_S = 0.01


class Vehicle(NamedTuple):
    """A synthetic vehicle: it obeys after a delay, at bounded rates, and is seen with noise."""

    acceleration_m_s2: float = 2.5
    braking_m_s2: float = 2.0
    reaction_s: float = 0.3
    reaches_m_s: float = 50.0
    noise_m_s: float = 0.05
    wind_ned_m_s: tuple[float, float] = (0.0, 0.0)
    wander_m: float = 0.0
    """Standard deviation of its distance from its place, north and east each."""


def track(vehicle: Vehicle, speeds_m_s: list[float], seed: int = 0, turn_rad: float = 0.0, repeats: int = 16) -> Track:
    """Return the track of a vehicle that is asked, every 0.5 s, for each speed `repeats` times and to turn further."""
    rng = np.random.default_rng(seed)
    command_s = 0.5 * np.arange(repeats * len(speeds_m_s))
    asked_m_s = np.repeat(speeds_m_s, repeats).astype(float)
    heading_rad = np.cumsum(np.full(len(command_s), turn_rad))
    fine_s = np.arange(0.0, command_s[-1] + 0.5, FINE_S)
    speed_m_s, rows = asked_m_s[0], []
    for t_s in fine_s.tolist():
        index = max(0, int((t_s - vehicle.reaction_s) / 0.5))
        wanted_m_s = min(asked_m_s[index], vehicle.reaches_m_s)
        change_m_s = wanted_m_s - speed_m_s
        speed_m_s += min(max(change_m_s, -vehicle.braking_m_s2 * FINE_S), vehicle.acceleration_m_s2 * FINE_S)
        rows.append((speed_m_s * math.cos(heading_rad[index]), speed_m_s * math.sin(heading_rad[index])))
    velocity_m_s = np.array(rows) + vehicle.wind_ned_m_s
    place_m = np.cumsum(velocity_m_s, axis=0) * FINE_S
    chosen = np.arange(5, len(fine_s), round(1.0 / rng.uniform(5.0, 10.0) / FINE_S))
    chosen = chosen[rng.random(len(chosen)) > 0.1]
    seen_m_s = velocity_m_s[chosen] + rng.normal(0.0, vehicle.noise_m_s, (len(chosen), 2))
    seen_m = place_m[chosen] + rng.normal(0.0, vehicle.wander_m, (len(chosen), 2))
    boot_s = fine_s[chosen]
    heard_s = np.maximum.accumulate(boot_s + rng.exponential(0.02, len(boot_s)))
    return Track(
        np.column_stack((command_s, heading_rad, asked_m_s)),
        np.column_stack((heard_s, boot_s, seen_m, seen_m_s)),
        np.zeros((0, 3)),
        Abilities(),
    )


@settings(max_examples=10, deadline=None)
@given(st.floats(1.6, 4.0), st.floats(1.6, 4.0), st.integers(0, 1_000))
def test_acceleration_and_braking_are_those_of_the_vehicle(up_m_s2: float, down_m_s2: float, seed: int) -> None:
    found = identify(track(Vehicle(up_m_s2, down_m_s2), [8.0, 0.0, 8.0, 4.0, 8.0, 0.0], seed), LIMITS, True)
    assert found.acceleration_m_s2 is not None and found.braking_m_s2 is not None
    assert found.acceleration_m_s2.value == pytest.approx(up_m_s2, rel=0.1)
    assert found.braking_m_s2.value == pytest.approx(down_m_s2, rel=0.1)


def test_nine_of_ten_intervals_of_braking_hold_the_truth() -> None:
    rng, held = np.random.default_rng(3), 0
    for seed in range(20):
        braking_m_s2 = float(rng.uniform(1.6, 4.0))
        vehicle = Vehicle(braking_m_s2=braking_m_s2, noise_m_s=float(rng.uniform(0.02, 0.3)))
        found = identify(track(vehicle, [8.0, 0.0, 8.0, 0.0], seed), LIMITS, True).braking_m_s2
        assert found is not None
        held += found.low <= braking_m_s2 <= found.high
    assert held >= 18


def test_a_speed_that_is_not_reached_is_told_and_one_that_is_reached_is_known_to_be_reached() -> None:
    speeds_m_s = [8.0, 8.0, 8.0]
    slow = identify(track(Vehicle(reaches_m_s=6.5), speeds_m_s), LIMITS, True).top_speed_m_s
    fast = identify(track(Vehicle(), speeds_m_s), LIMITS, True).top_speed_m_s
    assert slow is not None and slow.low <= 6.5 <= slow.high and slow.high < 7.0
    assert fast is not None and fast.low > 7.7 and math.isinf(fast.high)


def test_a_vehicle_that_ignores_the_speed_asked_for_shows_no_acceleration() -> None:
    deaf = Vehicle(reaction_s=1_000.0)
    assert identify(track(deaf, [8.0, 4.0, 8.0]), LIMITS, True).acceleration_m_s2 is None


def test_how_well_a_place_is_held_is_the_distance_of_95_of_100() -> None:
    # 95 % of distances in two directions with a deviation of 0.5 m each are within 0.5 sqrt(-2 ln 0.05) = 1.22 m; the
    # place itself is known as well as one position.
    found = identify(track(Vehicle(wander_m=0.5), [8.0, 0.0, 0.0, 0.0, 0.0]), LIMITS, True).hold_m
    assert found is not None and found.low <= found.value <= found.high and 0.9 < found.value < 3.0


@settings(max_examples=10, deadline=None)
@given(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0), st.floats(0.02, 0.4), st.integers(0, 1_000))
def test_a_plane_that_circles_finds_the_wind(north_m_s: float, east_m_s: float, noise_m_s: float, seed: int) -> None:
    vehicle = Vehicle(noise_m_s=noise_m_s, wind_ned_m_s=(north_m_s, east_m_s))
    found = identify(track(vehicle, [15.0] * 4, seed, turn_rad=0.15), LIMITS, False)
    assert found.wind_ned_m_s == pytest.approx((north_m_s, east_m_s), abs=0.5)
    assert found.top_speed_m_s is not None and found.top_speed_m_s.value == pytest.approx(15.0, abs=0.5)


def test_a_copter_knows_the_wind_that_its_autopilot_tells() -> None:
    told = np.column_stack((np.arange(20.0), np.full(20, 3.0), np.full(20, 4.0)))
    found = identify(track(Vehicle(), [8.0, 0.0])._replace(winds=told), LIMITS, True)
    assert found.wind_ned_m_s == (3.0, 4.0)
    assert found.wind_m_s is not None and found.wind_m_s.value == 5.0


def test_a_turn_that_is_asked_for_fast_shows_reaction_and_turn_rate() -> None:
    found = identify(track(Vehicle(), [8.0, 8.0, 8.0], turn_rad=0.12), LIMITS, True)
    assert found.reaction_s is not None
    assert found.rate_share is not None and math.isinf(found.rate_share.high)


def test_a_turn_that_is_asked_for_slowly_shows_neither() -> None:
    found = identify(track(Vehicle(), [8.0, 8.0, 8.0], turn_rad=0.05), LIMITS, True)
    assert found.reaction_s is None and found.rate_share is None


def test_a_heading_told_to_a_copter_that_stands_is_no_turn_of_its_course() -> None:
    started = track(Vehicle(), [0.0, 8.0, 8.0, 8.0], turn_rad=0.02)
    started.commands[:17, 1] -= 2.0
    found = identify(started, LIMITS, True)
    assert found.reaction_s is None and found.rate_share is None


def test_a_turn_while_a_copter_changes_its_speed_does_not_count() -> None:
    turning = track(Vehicle(), [8.0, 6.0, 4.0, 6.0] * 4, turn_rad=0.16, repeats=4)
    assert identify(turning, LIMITS, True).rate_share is None


def test_a_turn_seen_with_gaps_does_not_count() -> None:
    turning = track(Vehicle(), [8.0, 8.0, 8.0], turn_rad=0.12)
    seen = turning.motions[turning.motions[:, 1] % 4.0 > 1.5]
    assert identify(turning._replace(motions=seen), LIMITS, True).rate_share is None


def test_a_speed_that_is_ramped_down_shows_no_braking() -> None:
    ramp_m_s = [8.0] * 16 + [7.0, 6.0, 5.0, 4.0, 3.0, 2.0, 1.0] + [0.0] * 16
    found = identify(track(Vehicle(), ramp_m_s * 2, repeats=1), LIMITS, True)
    assert found.braking_m_s2 is None


def test_a_small_step_of_speed_shows_no_braking() -> None:
    assert identify(track(Vehicle(), [8.0, 6.5, 5.0]), LIMITS, True).braking_m_s2 is None


def test_a_copter_that_is_told_to_creep_does_not_hold_a_place() -> None:
    assert identify(track(Vehicle(), [8.0, 0.4, 0.4, 0.4]), LIMITS, True).hold_m is None


def test_a_plane_that_flies_straight_on_cannot_tell_wind_from_airspeed() -> None:
    assert identify(track(Vehicle(), [15.0] * 4), LIMITS, False).wind_m_s is None


def test_the_circle_through_points_on_a_circle_is_that_circle() -> None:
    angles = np.linspace(0.0, 5.0, 30)
    points = np.column_stack((3.0 + 7.0 * np.cos(angles), -2.0 + 7.0 * np.sin(angles)))
    assert circle_of(points) == pytest.approx((3.0, -2.0, 7.0))


def test_an_empty_track_shows_nothing() -> None:
    empty = Track(np.zeros((0, 3)), np.zeros((0, 6)), np.zeros((0, 3)), Abilities())
    assert not any(identify(empty, LIMITS, True)[:6])


def test_a_pause_of_the_setpoints_begins_a_new_stretch() -> None:
    whole = track(Vehicle(), [8.0, 0.0, 8.0])
    paused = whole.commands.copy()
    paused[10:20, 1] = math.nan
    assert len(list(stretches(whole))) == 1
    assert len(list(stretches(whole._replace(commands=paused)))) == 2


def test_the_jitter_of_a_link_does_not_move_the_times_of_a_stretch() -> None:
    whole = track(Vehicle(), [8.0, 0.0, 8.0])
    (stretch,) = stretches(whole)
    assert np.diff(stretch.reply_s).min() > 0.0
    assert np.std(stretch.reply_s - whole.motions[: len(stretch.reply_s), 1]) < 1e-9
