"""Positions that jump: none is believed at once, a setpoint does not swing, and what stays is told."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.autopilot.telemetry import Telemetry
from companion.geo.degrees import metres_between
from companion.geo.kinematics import GRAVITY_M_S2
from companion.onboard.position_gate import (
    DOUBT_S,
    JUMP_M,
    LOST_S,
    PARTED_M,
    Track,
    as_tracked,
    doubted,
    jumped,
    track_after,
    track_of,
)

PERIOD_S = 0.1
NOW_S = 1_790_000_000.0
SPEED_M_S = 10.0
PLACE_DEG = (47.0, 8.0)
DEG_PER_M = math.degrees(1.0 / 6_371_000.0)


class Vehicle:
    """A vehicle that flies north at 10 m/s, told by an autopilot whose place is off by what the test says."""

    def __init__(self, accuracy_m: float = math.nan) -> None:
        self.told = Telemetry(
            boot_ms=1_000,
            position_at_s=NOW_S,
            lat_deg=PLACE_DEG[0],
            lon_deg=PLACE_DEG[1],
            velocity_north_m_s=SPEED_M_S,
            velocity_east_m_s=0.0,
            position_accuracy_m=accuracy_m,
        )
        self.track: Track = track_of(self.told)
        self.flown_s = 0.0

    def tell(self, north_m: float = 0.0, *, after_s: float = PERIOD_S, speed_m_s: float = SPEED_M_S) -> None:
        """Tell the place, off to the north."""
        assert self.told.boot_ms is not None
        self.flown_s += after_s
        self.told = replace(
            self.told,
            boot_ms=self.told.boot_ms + round(1e3 * after_s),
            lat_deg=PLACE_DEG[0] + (SPEED_M_S * self.flown_s + north_m) * DEG_PER_M,
            velocity_north_m_s=speed_m_s,
        )
        self.track = track_after(self.track, self.told, NOW_S + self.flown_s)

    @property
    def off_m(self) -> float:
        """How far from where it is the vehicle is taken to be."""
        seen = as_tracked(self.track, self.told)
        north_m, east_m = metres_between(PLACE_DEG, (seen.lat_deg, seen.lon_deg))
        return math.hypot(north_m - SPEED_M_S * self.flown_s, east_m)


def test_positions_that_follow_from_one_another_are_those_that_are_told() -> None:
    vehicle = Vehicle()
    for _ in range(20):
        vehicle.tell()
        assert as_tracked(vehicle.track, vehicle.told) is vehicle.told
    assert (doubted(vehicle.track), jumped(vehicle.track)) == (None, None)


@pytest.mark.parametrize("metres", [3.0, 10.0, -14.0])
def test_a_reset_by_metres_is_believed_at_once(metres: float) -> None:
    vehicle = Vehicle()
    vehicle.tell(metres)
    assert as_tracked(vehicle.track, vehicle.told) is vehicle.told


def test_a_position_that_is_told_to_be_inexact_may_be_wrong_by_more() -> None:
    vehicle = Vehicle(accuracy_m=8.0)
    vehicle.tell(35.0)
    assert as_tracked(vehicle.track, vehicle.told) is vehicle.told


def test_a_jump_and_back_moves_nothing() -> None:
    vehicle = Vehicle()
    for _ in range(15):
        vehicle.tell(300.0)
        assert vehicle.off_m < 0.5
    assert doubted(vehicle.track) == "position jumped 300 m: not believed before it has stood for 2 s"
    vehicle.tell()
    assert (doubted(vehicle.track), jumped(vehicle.track), vehicle.track.jumps) == (None, None, 0)


def test_a_jump_that_stays_is_believed_after_its_time_and_told() -> None:
    vehicle = Vehicle()
    for _ in range(round(DOUBT_S / PERIOD_S)):
        vehicle.tell(300.0)
        assert vehicle.off_m < 0.5
    vehicle.tell(300.0)
    assert vehicle.off_m == pytest.approx(300.0, abs=0.5)
    assert (doubted(vehicle.track), vehicle.track.jumps) == (None, 1)
    assert jumped(vehicle.track) == ("position jumped 300 m at 14:13:20 UTC: where it is nobody knows; hand over again")


def test_a_position_that_jumps_back_is_again_where_it_was() -> None:
    vehicle = Vehicle()
    for off_m in (300.0, 0.0):
        for _ in range(30):
            vehicle.tell(off_m)
    assert (jumped(vehicle.track), vehicle.track.jumps) == (None, 2)


def test_positions_that_jump_about_are_none_after_a_while() -> None:
    vehicle = Vehicle()
    for sample in range(round(LOST_S / PERIOD_S) + 2):
        assert not vehicle.track.is_lost
        vehicle.tell(300.0 * (1 + sample % 7))
    assert vehicle.track.is_lost


def test_a_velocity_that_jumps_with_the_place_is_not_reckoned_by() -> None:
    vehicle = Vehicle()
    for _ in range(15):
        vehicle.tell(300.0, speed_m_s=90.0)
        assert vehicle.off_m < 0.5


def test_after_a_gap_a_place_that_the_vehicle_can_have_reached_is_believed() -> None:
    vehicle = Vehicle()
    vehicle.tell(15.0, after_s=1.5)
    assert as_tracked(vehicle.track, vehicle.told) is vehicle.told


def test_a_position_that_stands_still_is_reckoned_then_told_and_believed_when_it_is_back() -> None:
    vehicle = Vehicle()
    for sample in range(80):
        vehicle.tell(-SPEED_M_S * PERIOD_S * (sample + 1))
        assert vehicle.off_m <= PARTED_M + 2.0
    assert jumped(vehicle.track) == (
        "position stands still while the velocity says 10.0 m/s: not believed before it is back; or hand over again"
    )
    assert vehicle.off_m < 2.0
    vehicle.tell()
    assert as_tracked(vehicle.track, vehicle.told) is vehicle.told
    assert (doubted(vehicle.track), jumped(vehicle.track), vehicle.track.jumps) == (None, None, 0)


def test_a_position_that_stood_still_is_not_back_because_the_vehicle_stops() -> None:
    vehicle = Vehicle()
    for sample in range(40):
        vehicle.tell(-SPEED_M_S * PERIOD_S * (sample + 1))
    frozen_deg = vehicle.told.lat_deg
    for _ in range(600):
        boot_ms = vehicle.told.boot_ms
        assert boot_ms is not None
        vehicle.told = replace(vehicle.told, boot_ms=boot_ms + 100, lat_deg=frozen_deg, velocity_north_m_s=0.0)
        vehicle.track = track_after(vehicle.track, vehicle.told, NOW_S)
    assert jumped(vehicle.track) is not None


@settings(max_examples=40)
@given(
    apart_m_s=st.floats(3.0, 12.0),
    towards_rad=st.floats(0.0, math.tau),
    period_s=st.sampled_from((0.1, 0.2, 0.5)),
    accuracy_m=st.floats(0.3, 1.5),
)
def test_a_position_that_parts_from_its_velocity_by_three_metres_a_second_is_told_within_ten_seconds(
    apart_m_s: float, towards_rad: float, period_s: float, accuracy_m: float
) -> None:
    vehicle = Vehicle(accuracy_m)
    for sample in range(1, round(10.0 / period_s) + 1):
        away_m = apart_m_s * period_s * sample
        vehicle.told = replace(vehicle.told, lon_deg=PLACE_DEG[1] + 1.466 * DEG_PER_M * away_m * math.sin(towards_rad))
        vehicle.tell(away_m * math.cos(towards_rad), after_s=period_s)
    assert jumped(vehicle.track) is not None
    assert vehicle.track.jumps == 0


@settings(max_examples=40)
@given(
    accelerations_m_s2=st.lists(st.tuples(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0)), min_size=8, max_size=24),
    period_s=st.sampled_from((0.1, 0.2, 0.5)),
    bias_m_s=st.floats(-0.3, 0.3),
    reset_m=st.floats(-14.0, 14.0),
    data=st.data(),
)
def test_a_genuine_track_with_noise_loss_turns_and_a_reset_is_always_believed(
    accelerations_m_s2: list[tuple[float, float]],
    period_s: float,
    bias_m_s: float,
    reset_m: float,
    data: st.DataObject,
) -> None:
    vehicle = Vehicle(1.0)
    north_m = east_m = east_m_s = 0.0
    north_m_s = SPEED_M_S
    reset_at = data.draw(st.integers(0, len(accelerations_m_s2) - 1))
    random = data.draw(st.randoms(use_true_random=False))
    silent = 0
    for second, (north_m_s2, east_m_s2) in enumerate(accelerations_m_s2):
        for _ in range(round(1.0 / period_s)):
            north_m += (north_m_s + 0.5 * north_m_s2 * period_s) * period_s
            east_m += (east_m_s + 0.5 * east_m_s2 * period_s) * period_s
            north_m_s, east_m_s = north_m_s + north_m_s2 * period_s, east_m_s + east_m_s2 * period_s
            assert vehicle.told.boot_ms is not None
            silent += 1
            if random.random() < 0.3 and silent * period_s < 1.0:
                continue
            off_m = random.uniform(-0.5, 0.5) + (reset_m if second >= reset_at else 0.0)
            vehicle.told = replace(
                vehicle.told,
                boot_ms=vehicle.told.boot_ms + round(1e3 * period_s * silent),
                lat_deg=PLACE_DEG[0] + (north_m + off_m) * DEG_PER_M,
                lon_deg=PLACE_DEG[1] + east_m * DEG_PER_M / math.cos(math.radians(PLACE_DEG[0])),
                velocity_north_m_s=north_m_s + bias_m_s,
                velocity_east_m_s=east_m_s,
            )
            silent = 0
            vehicle.track = track_after(vehicle.track, vehicle.told, NOW_S)
            assert as_tracked(vehicle.track, vehicle.told) is vehicle.told


@settings(max_examples=40)
@given(
    offsets_m=st.lists(st.one_of(st.just(0.0), st.floats(2.0 * JUMP_M + 2.0 * LOST_S, 5_000.0)), max_size=40),
    period_s=st.sampled_from((0.1, 0.2, 0.5)),
)
def test_whatever_glitches_a_vehicle_is_never_taken_to_be_elsewhere_within_two_seconds(
    offsets_m: list[float], period_s: float
) -> None:
    vehicle, apart_s = Vehicle(), 0.0
    for off_m in offsets_m:
        vehicle.tell(off_m, after_s=period_s)
        apart_s = 0.0 if off_m == 0.0 else apart_s + period_s
        if apart_s <= DOUBT_S and vehicle.track.jumps == 0:
            assert vehicle.off_m < 2.0


@settings(max_examples=60, deadline=None)
@given(
    st.floats(1.0, 100.0),
    st.floats(0.2, 20.0),
    st.sampled_from([0.1, 0.5, 1.0, 2.0, 5.0]),
    st.floats(0.0, 10.0),
)
def test_a_vehicle_that_turns_as_hard_as_it_may_is_believed_however_seldom_it_tells_its_place(
    speed_m_s: float, n_max: float, period_s: float, straight_s: float
) -> None:
    turning_m_s2 = n_max * GRAVITY_M_S2
    radius_m, rate_rad_s = speed_m_s**2 / turning_m_s2, turning_m_s2 / speed_m_s

    def told(t_s: float) -> Telemetry:
        angle_rad = rate_rad_s * max(0.0, t_s - straight_s)
        north_m = speed_m_s * min(t_s, straight_s) + radius_m * math.sin(angle_rad)
        east_m = radius_m * (1.0 - math.cos(angle_rad))
        return Telemetry(
            boot_ms=1_000 + round(1e3 * t_s),
            position_at_s=NOW_S + t_s,
            lat_deg=PLACE_DEG[0] + north_m * DEG_PER_M,
            lon_deg=PLACE_DEG[1] + east_m * DEG_PER_M / math.cos(math.radians(PLACE_DEG[0])),
            velocity_north_m_s=speed_m_s * math.cos(angle_rad),
            velocity_east_m_s=speed_m_s * math.sin(angle_rad),
        )

    track = track_of(told(0.0), turning_m_s2)
    for step in range(1, 60):
        track = track_after(track, told(step * period_s), NOW_S + step * period_s)
        assert (doubted(track), jumped(track)) == (None, None)
