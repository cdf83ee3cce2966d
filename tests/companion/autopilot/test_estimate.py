"""What the autopilot says of its own estimate, which receiver counts, and which aircraft are kept."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega, common

from companion.autopilot.aircraft import MAX_NEIGHBOURS, NEIGHBOUR_MEMORY_S, Neighbour, entered, neighbour_of
from companion.autopilot.estimate import (
    ESTIMATE_MAX_AGE_S,
    RECEIVER_MAX_AGE_S,
    Estimate,
    Receiver,
    better,
    ekf_status,
    estimator_status,
    fresh,
)

HERE_DEG = (47.0, 8.0)
NOW_S = 100.0


def ekf(flags: int, ratio: float = 0.1, before: Estimate | None = None) -> Estimate:
    message = ardupilotmega.MAVLink_ekf_status_report_message(flags, 0.1, ratio, 0.1, 0.1, 0.0)
    return ekf_status(message, before, NOW_S)


def px4(flags: int, ratio: float = 0.1, before: Estimate | None = None) -> Estimate:
    message = common.MAVLink_estimator_status_message(0, flags, 0.1, ratio, 0.1, 0.1, 0.1, 0.1, 1.5, 0.5)
    return estimator_status(message, before, NOW_S)


@pytest.mark.parametrize(
    ("flags", "absolute"),
    [
        # As ArduPilot 4.7 said them: flying; with GPS lost on a copter, on a plane; before the first fix.
        (0x33F, True),
        (0x25, False),
        (0x12F, False),
        (0xA7, False),
        (0, False),
        # A position while it assumes to stand still.
        (0x3BF, False),
    ],
)
def test_the_flags_of_ardupilot_say_whether_it_knows_its_place(flags: int, absolute: bool) -> None:
    assert ekf(flags).absolute is absolute


@pytest.mark.parametrize(("flags", "absolute"), [(0x37F, True), (0x17F, True), (0x365, False), (0x65, False)])
def test_the_flags_of_px4_say_whether_it_knows_its_place(flags: int, absolute: bool) -> None:
    assert px4(flags).absolute is absolute


def test_a_glitch_is_told_by_another_flag_of_each() -> None:
    assert [one.doubt for one in (ekf(0x33F), px4(0x33F))] == [None, None]
    glitch = "the autopilot's estimate says GPS glitch"
    assert [one.doubt for one in (ekf(0x833F), px4(0x73F))] == [glitch, glitch]
    # ArduPilot's bit 10 says that it is not initialised.
    assert ekf(0x733F).doubt is None


@pytest.mark.parametrize("status", [ekf, px4])
def test_a_position_is_in_doubt_when_two_reports_in_a_row_reject_what_is_measured(status: object) -> None:
    assert callable(status)
    first = status(0x33F, 1.2)
    assert first.doubt is None
    assert status(0x33F, 1.3, first).doubt == (
        "the autopilot's estimate rejects the position it measures (test ratio 1.3)"
    )
    assert status(0x33F, 0.9, first).doubt is None
    assert status(0x33F, math.nan, first).doubt is None


def test_what_was_said_of_the_estimate_counts_for_a_while() -> None:
    told = Estimate(NOW_S, True)
    assert fresh(told, NOW_S + ESTIMATE_MAX_AGE_S) is told
    assert fresh(told, NOW_S + ESTIMATE_MAX_AGE_S + 0.1) is None
    assert fresh(None, NOW_S) is None


def test_the_receiver_with_the_better_fix_counts_then_the_more_exact_one() -> None:
    dead, good = Receiver(NOW_S, 1, 0.5), Receiver(NOW_S, 3, 2.0)
    exact, silent = Receiver(NOW_S, 3, 0.8), Receiver(NOW_S, 3, math.nan)
    assert better({"GPS_RAW_INT": dead, "GPS2_RAW": good}, NOW_S) is good
    assert better({"GPS_RAW_INT": good, "GPS2_RAW": exact}, NOW_S) is exact
    assert better({"GPS_RAW_INT": silent, "GPS2_RAW": good}, NOW_S) is good


def test_a_receiver_that_is_no_longer_told_of_does_not_count_beside_one_that_is() -> None:
    old, poor = Receiver(NOW_S, 6, 0.5), Receiver(NOW_S + RECEIVER_MAX_AGE_S + 1.0, 1, math.nan)
    assert better({"GPS_RAW_INT": old, "GPS2_RAW": poor}, poor.at_s) is poor
    assert better({"GPS_RAW_INT": old}, poor.at_s) is old


def adsb(altitude_type: int = common.ADSB_ALTITUDE_TYPE_GEOMETRIC, tslc: int = 0) -> Neighbour | str:
    message = common.MAVLink_adsb_vehicle_message(
        *(1, 470_000_000, 80_000_000, altitude_type, 530_000, 9_000, 2_000, 0, b"OW00007", 14, tslc, 0x1F, 0)
    )
    return neighbour_of(message, NOW_S)


def test_a_pressure_altitude_is_no_altitude_above_sea_level() -> None:
    geometric, pressure = adsb(), adsb(common.ADSB_ALTITUDE_TYPE_PRESSURE_QNH)
    assert isinstance(geometric, Neighbour)
    assert isinstance(pressure, Neighbour)
    assert geometric.altitude_m == 530.0
    assert math.isnan(pressure.altitude_m)


def test_an_aircraft_that_was_last_heard_long_ago_does_not_count() -> None:
    assert isinstance(adsb(tslc=int(NEIGHBOUR_MEMORY_S)), Neighbour)
    assert adsb(tslc=int(NEIGHBOUR_MEMORY_S) + 1) == "seen too long ago"


def at(north_deg: float, seen_at_s: float = NOW_S) -> Neighbour:
    return Neighbour(None, HERE_DEG[0] + north_deg, HERE_DEG[1], 0.0, 0.0, seen_at_s)


def test_in_a_full_table_a_near_aircraft_takes_the_place_of_the_farthest() -> None:
    table = {number: at(0.1 + 0.001 * number) for number in range(MAX_NEIGHBOURS)}
    assert entered(table, 1_000, at(0.01), HERE_DEG, NOW_S)
    assert 1_000 in table
    assert MAX_NEIGHBOURS - 1 not in table
    assert len(table) == MAX_NEIGHBOURS
    assert not entered(table, 1_001, at(0.5), HERE_DEG, NOW_S)
    # One that is known is followed however far it flies.
    assert entered(table, 1_000, at(0.6), HERE_DEG, NOW_S)


def test_where_the_own_place_is_not_known_a_full_table_stays() -> None:
    table = {number: at(0.1) for number in range(MAX_NEIGHBOURS)}
    assert not entered(table, 1_000, at(0.01), (math.nan, math.nan), NOW_S)
    assert 1_000 not in table
