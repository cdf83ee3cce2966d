"""Parameters: asked for sparingly, read as each autopilot writes them, and done without where it does not answer."""

from __future__ import annotations

import math
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.autopilot.parameters import REQUESTS_AT_ONCE, RETRY_S, TRIES, ParameterReader, Wanted, request

WANTED = (Wanted("GUID_TIMEOUT", 3.0), Wanted("WPNAV_ACCEL", 250.0, (("WP_ACC", 100.0),)), Wanted("ANGLE_MAX", 3000.0))

GOLDEN_REQUEST = "fd1000000007bf140000ffff0701475549445f54494d454f555410bf"


def message(name: str, value: float, kind: int = common.MAV_PARAM_TYPE_REAL32) -> common.MAVLink_message:
    """Return a PARAM_VALUE as it comes off the wire."""
    link = common.MAVLink(None, srcSystem=1, srcComponent=1)
    raw = common.MAVLink_param_value_message(name.encode(), value, kind, 1, 0).pack(link)
    (parsed,) = common.MAVLink(None).parse_buffer(bytearray(raw))
    return parsed


def bytewise(value: int, form: str = "<i") -> float:
    return float(struct.unpack("<f", struct.pack(form, value).ljust(4, b"\0"))[0])


def reader(*told: common.MAVLink_message, integers: bool = False) -> ParameterReader:
    made = ParameterReader(WANTED, bytewise=integers)
    for one in told:
        made.take(one)
    return made


def asked(made: ParameterReader, start_s: float, seconds: float) -> list[tuple[float, str]]:
    times_s = [start_s + 0.1 * step for step in range(round(10 * seconds))]
    return [(now_s, name) for now_s in times_s for name in made.due(now_s)]


def test_what_is_not_told_is_the_documented_default_and_said_so() -> None:
    made = reader(message("GUID_TIMEOUT", 1.5))
    assert (made.value("GUID_TIMEOUT"), made.value("WPNAV_ACCEL")) == (1.5, 250.0)
    assert made.assumed == ("WPNAV_ACCEL", "ANGLE_MAX")
    assert dict(made.values) == {"GUID_TIMEOUT": 1.5}


def test_another_versions_name_means_the_same_in_its_own_unit() -> None:
    assert reader(message("WP_ACC", 2.5)).value("WPNAV_ACCEL") == 250.0


def test_both_names_are_asked_for_until_one_answers() -> None:
    made = reader()
    first = [name for _, name in asked(made, 0.0, 0.9)]
    assert first == ["GUID_TIMEOUT", "WPNAV_ACCEL", "WP_ACC", "ANGLE_MAX"]
    made.take(message("WP_ACC", 2.5))
    assert {name for _, name in asked(made, 1.0, 30.0)} == {"GUID_TIMEOUT", "ANGLE_MAX"}


def test_each_is_asked_a_bounded_number_of_times_a_second_apart() -> None:
    times_s = [now_s for now_s, name in asked(reader(), 0.0, 60.0) if name == "ANGLE_MAX"]
    assert len(times_s) == TRIES
    assert min(after - before for before, after in zip(times_s, times_s[1:], strict=False)) >= RETRY_S - 1e-9


def test_few_are_asked_for_at_once() -> None:
    made = ParameterReader(tuple(Wanted(f"P{index}", 0.0) for index in range(30)), bytewise=False)
    assert len(made.due(0.0)) == REQUESTS_AT_ONCE
    assert made.due(0.1) == []
    assert len(asked(made, 0.2, 1.0)) <= 10


def test_it_is_settled_when_all_are_told() -> None:
    made = reader(message("GUID_TIMEOUT", 3.0), message("WPNAV_ACCEL", 250.0))
    assert not made.all_known
    made.take(message("ANGLE_MAX", 3000.0))
    assert made.all_known


def test_it_is_settled_when_asking_is_no_longer_worth_it() -> None:
    made = reader(message("GUID_TIMEOUT", 3.0))
    asked(made, 0.0, TRIES * RETRY_S - 0.5)
    assert not made.all_known
    asked(made, TRIES * RETRY_S, 5.0)
    assert made.all_known


def test_an_answer_that_comes_late_still_counts() -> None:
    made = reader()
    asked(made, 0.0, 60.0)
    made.take(message("ANGLE_MAX", 4500.0))
    assert made.value("ANGLE_MAX") == 4500.0


def test_a_parameter_that_a_person_changes_is_taken_over() -> None:
    made = reader(message("ANGLE_MAX", 3000.0), message("ANGLE_MAX", 4500.0))
    assert made.value("ANGLE_MAX") == 4500.0


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_not_finite_is_no_value(value: float) -> None:
    assert reader(message("ANGLE_MAX", value)).assumed == ("GUID_TIMEOUT", "WPNAV_ACCEL", "ANGLE_MAX")


def test_parameters_nobody_asked_for_are_ignored() -> None:
    assert not reader(message("SERVO1_FUNCTION", 73.0)).values


@given(st.integers(-(2**31), 2**31 - 1))
def test_an_integer_written_bytewise_is_read_exactly(value: int) -> None:
    number = bytewise(value)
    # A few large integers' bytes are signalling NaN, which no float of Python's carries: the sender here cannot.
    if struct.pack("<f", number) == struct.pack("<i", value):
        told = message("ANGLE_MAX", number, common.MAV_PARAM_TYPE_INT32)
        assert reader(told, integers=True).value("ANGLE_MAX") == value


@pytest.mark.parametrize(
    ("kind", "form", "value"),
    [
        (common.MAV_PARAM_TYPE_UINT8, "<B", 200),
        (common.MAV_PARAM_TYPE_INT8, "<b", -3),
        (common.MAV_PARAM_TYPE_UINT16, "<H", 60_000),
        (common.MAV_PARAM_TYPE_INT16, "<h", -300),
        (common.MAV_PARAM_TYPE_UINT32, "<I", 3_000_000_000),
        (common.MAV_PARAM_TYPE_INT32, "<i", -1),
    ],
)
def test_every_kind_of_integer_is_read_bytewise(kind: int, form: str, value: int) -> None:
    assert reader(message("ANGLE_MAX", bytewise(value, form), kind), integers=True).value("ANGLE_MAX") == value


def test_a_real_number_of_px4s_is_read_as_it_is() -> None:
    assert reader(message("GUID_TIMEOUT", 0.5), integers=True).value("GUID_TIMEOUT") == 0.5


def test_an_integer_of_ardupilots_is_written_as_a_number() -> None:
    assert reader(message("ANGLE_MAX", 4500.0, common.MAV_PARAM_TYPE_INT16)).value("ANGLE_MAX") == 4500.0


def test_the_bytes_of_a_request_are_pinned() -> None:
    link = common.MAVLink(None, srcSystem=7, srcComponent=191)
    assert bytes(request("GUID_TIMEOUT", 7).pack(link)).hex() == GOLDEN_REQUEST


def test_what_a_vehicle_hides_behind_a_switch_is_asked_for_once_that_is_told_as_on() -> None:
    hidden = Wanted("BATT2_LOW_MAH", 0.0, optional=True, switch="BATT2_MONITOR")
    wanted = (Wanted("BATT2_MONITOR", 0.0, optional=True), hidden)
    off = ParameterReader(wanted, bytewise=False)
    assert {name for _, name in asked(off, 0.0, 1.0)} == {"BATT2_MONITOR"}
    assert not off.settled(1.0)
    off.take(message("BATT2_MONITOR", 0.0))
    assert off.settled(1.0)
    assert asked(off, 1.0, 9.0) == []
    silent = ParameterReader(wanted, bytewise=False)
    assert len(asked(silent, 0.0, 20.0)) == TRIES
    assert silent.settled(20.0)
    silent.take(message("BATT2_MONITOR", 4.0))
    assert {name for _, name in asked(silent, 20.0, 1.0)} == {"BATT2_LOW_MAH"}
    assert not silent.settled(20.1)
