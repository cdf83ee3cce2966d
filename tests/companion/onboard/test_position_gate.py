"""Positions that jump: none is believed at once, a setpoint does not swing, and what stays is told."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.autopilot.telemetry import Telemetry
from companion.onboard.position_gate import (
    DOUBT_S,
    JUMP_M,
    LOST_S,
    Track,
    as_tracked,
    doubted,
    jumped,
    track_after,
    track_of,
)
from companion.onboard.references import metres_between

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
