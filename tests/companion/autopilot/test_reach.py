"""What a vehicle reaches, by the parameters that it tells: airspeeds, and values that no vehicle has."""

from __future__ import annotations

import math
from dataclasses import astuple
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.autopilot.air import ALTITUDE_STEP_M, AirDensity
from companion.autopilot.heartbeat import IDENTITIES
from companion.autopilot.linked import LinkedAdapter
from companion.autopilot.parameters import TRIES, Wanted
from companion.autopilot.px4_copter import DRAG_UNKNOWN
from companion.autopilot.registry import ADAPTERS
from companion.geo.air_density import ALTITUDE_MAX_M, true_per_indicated
from companion.guard.types import Setpoint

PAGE = Path(__file__).parents[3] / "docs" / "autopilots.md"
SYSTEM = 7
REAL_KINDS = sorted(set(ADAPTERS) - {"kinematic"})
_LINK = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)


def tell(adapter: LinkedAdapter, message: common.MAVLink_message, now_s: float = 0.0) -> None:
    adapter.receive(bytes(message.pack(_LINK)), now_s)


def vehicle(kind: str, altitude_m: float = 0.0, **values: float) -> LinkedAdapter:
    """Return an adapter that has heard its vehicle fly at an altitude above sea level, with these parameters."""
    adapter = ADAPTERS[kind](SYSTEM)
    identity = next(one for one in IDENTITIES if one.kind.name == kind)
    tell(adapter, common.MAVLink_heartbeat_message(min(identity.types or (0,)), identity.autopilot, 1, 0, 3, 3))
    at(adapter, altitude_m, 100)
    for name, value in values.items():
        kind_of = common.MAV_PARAM_TYPE_REAL32
        tell(adapter, common.MAVLink_param_value_message(name.encode(), value, kind_of, 1, 0))
    return adapter


def at(adapter: LinkedAdapter, altitude_m: float, boot_ms: int) -> None:
    place = (470_000_000, 80_000_000, round(1e3 * altitude_m), 80_000)
    tell(adapter, common.MAVLink_global_position_int_message(boot_ms, *place, 2_000, 0, 0, 0))
    tell(adapter, common.MAVLink_attitude_message(boot_ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))


# The air


@given(st.floats(0.0, ALTITUDE_MAX_M), st.floats(0.0, ALTITUDE_MAX_M))
def test_the_higher_the_more_true_airspeed_for_an_indicated_one(low_m: float, high_m: float) -> None:
    low_m, high_m = sorted((low_m, high_m))
    assert 1.0 <= true_per_indicated(low_m) <= true_per_indicated(high_m) < 1.84


@pytest.mark.parametrize(
    ("altitude_m", "ratio"),
    # The standard atmosphere's densities: 1.225, 1.1579, 1.1117 and 0.7361 kg/m^3.
    [(0.0, 1.0), (584.0, 1.0286), (1_000.0, 1.0498), (5_000.0, 1.2900), (math.nan, 1.0)],
)
def test_the_ratio_is_that_of_the_standard_atmosphere(altitude_m: float, ratio: float) -> None:
    assert true_per_indicated(altitude_m) == pytest.approx(ratio, abs=2e-4)


@given(st.floats(allow_nan=True, allow_infinity=True))
def test_whatever_altitude_is_told_the_ratio_is_sane(altitude_m: float) -> None:
    assert 0.9 < true_per_indicated(altitude_m) < 1.84


def test_in_an_engagement_the_limits_keep_the_air_that_it_began_in() -> None:
    air = AirDensity()
    air.note(500.0)
    began = air.ratio
    air.engage()
    air.note(1_500.0)
    assert air.ratio == began
    air.release()
    air.note(500.0 + 0.9 * ALTITUDE_STEP_M)
    assert air.ratio == began
    air.note(1_500.0)
    assert air.ratio == pytest.approx(true_per_indicated(1_500.0))


# Copters


@pytest.mark.parametrize(
    ("values", "airspeed_m_s", "by", "remedy"),
    [
        ({"ANGLE_MAX": 3000.0}, 10.3, "ANGLE_MAX 3000", "ANGLE_MAX to 4500 (15 m/s)"),
        ({"ATC_ANGLE_MAX": 30.0}, 10.3, "ATC_ANGLE_MAX 30", "ATC_ANGLE_MAX to 45 (15 m/s)"),
        ({"ATC_ANGLE_MAX": 45.0}, 15.0, "ATC_ANGLE_MAX 45", ""),
    ],
)
def test_an_arducopters_lean_bounds_its_airspeed_in_its_own_words(
    values: dict[str, float], airspeed_m_s: float, by: str, remedy: str
) -> None:
    abilities = vehicle("arducopter", **values).abilities
    assert abilities.airspeed_max_m_s == pytest.approx(airspeed_m_s)
    assert (abilities.airspeed_by, abilities.airspeed_remedy) == (by, remedy)


def test_px4s_simulator_tells_its_drag() -> None:
    values = {"MPC_TILTMAX_AIR": 45.0, "SIH_KDV": 1.0, "SIH_MASS": 1.0}
    abilities = vehicle("px4-copter", **values).abilities
    assert abilities.airspeed_max_m_s == pytest.approx(9.807, abs=1e-3)
    assert abilities.airspeed_by == "MPC_TILTMAX_AIR 45, SIH_KDV 1, SIH_MASS 1"


def test_a_real_px4_copter_tells_none_and_nobody_waits_for_it() -> None:
    adapter = vehicle("px4-copter", COM_OF_LOSS_T=1.0, COM_OBL_RC_ACT=5.0, GF_ACTION=2.0, MPC_ACC_HOR=3.0)
    assert not adapter.parameters_known
    tell(adapter, common.MAVLink_param_value_message(b"MPC_XY_VEL_MAX", 12.0, 9, 1, 0))
    assert adapter.parameters_known
    assert (adapter.abilities.airspeed_max_m_s, adapter.abilities.airspeed_by) == (math.inf, DRAG_UNKNOWN)
    assert adapter.abilities.assumed == ()


# Planes


def commanded_m_s(adapter: LinkedAdapter, speed_m_s: float, now_s: float) -> float:
    """Return the indicated airspeed that an ArduPlane is commanded for a true one."""
    frames = adapter.encode(Setpoint(0.0, speed_m_s, 80.0), 0.0, now_s)
    messages = [message for frame in frames for message in common.MAVLink(None).parse_buffer(bytearray(frame))]
    (speed,) = (one for one in messages if getattr(one, "command", 0) == common.MAV_CMD_GUIDED_CHANGE_SPEED)
    return float(speed.param2)


def test_an_arduplane_is_commanded_the_indicated_airspeed_of_a_true_one() -> None:
    adapter = vehicle("arduplane", 584.0, AIRSPEED_MIN=9.0, AIRSPEED_MAX=30.0)
    assert commanded_m_s(adapter, 22.0, 5.0) == pytest.approx(21.39, abs=0.01)
    assert commanded_m_s(vehicle("arduplane", 0.0), 22.0, 5.0) == pytest.approx(22.0)


@given(st.floats(0.0, 200.0), st.floats(-400.0, 6_000.0))
@settings(max_examples=30)
def test_an_arduplane_is_never_commanded_an_airspeed_that_it_refuses(speed_m_s: float, altitude_m: float) -> None:
    adapter = vehicle("arduplane", altitude_m, AIRSPEED_MIN=9.0, AIRSPEED_MAX=30.0)
    assert 9.0 <= commanded_m_s(adapter, speed_m_s, 5.0) <= 30.0


def test_the_airspeeds_of_a_planes_parameters_are_indicated_and_its_limits_are_true() -> None:
    ratio = true_per_indicated(2_000.0)
    ardupilot = vehicle("arduplane", 2_000.0, AIRSPEED_MIN=9.0, AIRSPEED_MAX=30.0).abilities
    assert (ardupilot.speed_min_m_s, ardupilot.speed_max_m_s) == pytest.approx((9.0 * ratio, 30.0 * ratio))
    px4 = vehicle("px4-plane", 2_000.0, FW_AIRSPD_TRIM=15.0).abilities
    assert (px4.speed_min_m_s, px4.speed_max_m_s, px4.airspeed_max_m_s) == pytest.approx((15.0 * ratio,) * 3)


# Values that no vehicle has


@pytest.mark.parametrize(
    ("kind", "name", "value", "words"),
    [
        ("arduplane", "AIRSPEED_MIN", 1e30, "AIRSPEED_MIN 1e+30 is not a sane value (5 to 60)"),
        ("arduplane", "ARSPD_FBW_MIN", 0.0, "ARSPD_FBW_MIN 0 is not a sane value (5 to 60)"),
        ("arduplane", "LIM_ROLL_CD", 45.0, "LIM_ROLL_CD 45 is not a sane value (1000 to 8500)"),
        ("arducopter", "ANGLE_MAX", 0.0, "ANGLE_MAX 0 is not a sane value (1000 to 8000)"),
        ("arducopter", "ATC_ANGLE_MAX", 3000.0, "ATC_ANGLE_MAX 3000 is not a sane value (10 to 80)"),
        ("arducopter", "WP_ACC", 250.0, "WP_ACC 250 is not a sane value (0.25 to 20)"),
        ("px4-plane", "FW_AIRSPD_TRIM", math.nan, "FW_AIRSPD_TRIM nan is not a sane value (5 to 60)"),
        ("px4-copter", "MPC_ACC_HOR", -3.0, "MPC_ACC_HOR -3 is not a sane value (0.3 to 30)"),
    ],
)
def test_a_value_that_no_vehicle_has_is_named_and_not_adopted(kind: str, name: str, value: float, words: str) -> None:
    adapter = vehicle(kind, **{name: value})
    assert adapter.abilities.insane == (words,)
    told = {key: number for key, number in vars(adapter.abilities).items() if isinstance(number, float)}
    assumed = {key: number for key, number in vars(vehicle(kind).abilities).items() if isinstance(number, float)}
    assert told == assumed


def test_a_value_that_was_corrected_counts_again() -> None:
    adapter = vehicle("arducopter", ANGLE_MAX=0.0)
    tell(adapter, common.MAVLink_param_value_message(b"ANGLE_MAX", 4500.0, 9, 1, 0))
    assert adapter.abilities.insane == ()
    assert adapter.abilities.airspeed_max_m_s == pytest.approx(15.0)


def test_least_and_greatest_airspeed_that_contradict_each_other_are_named() -> None:
    abilities = vehicle("arduplane", AIRSPEED_MIN=30.0, AIRSPEED_MAX=20.0).abilities
    assert abilities.insane == ("AIRSPEED_MAX 20 is below AIRSPEED_MIN 30",)
    assert abilities.speed_min_m_s <= abilities.speed_max_m_s


NUMBERS = st.one_of(
    st.floats(width=32), st.sampled_from([0.0, -1.0, 1e30, -1e30, math.nan, math.inf, -math.inf, 45.0, 3000.0])
)


@pytest.mark.parametrize("kind", REAL_KINDS)
@settings(max_examples=60)
@given(st.data())
def test_whatever_a_vehicle_tells_its_abilities_are_sane_and_each_refusal_names_the_number(
    kind: str, data: st.DataObject
) -> None:
    wanted: list[Wanted] = list(ADAPTERS[kind]().wanted)
    one = data.draw(st.sampled_from(wanted))
    values = {data.draw(st.sampled_from(one.names)): data.draw(NUMBERS) for one in (one, *data.draw(subset(wanted)))}
    adapter = vehicle(kind, data.draw(st.floats(-400.0, 6_000.0)), **values)
    abilities = adapter.abilities
    assert 0.0 <= abilities.speed_min_m_s <= abilities.speed_max_m_s <= 250.0
    assert 0.0 < abilities.n_max <= 10.0
    assert abilities.airspeed_max_m_s > 0.0
    assert not any(math.isnan(number) for number in astuple(abilities) if isinstance(number, float))
    if kind != "px4-plane" and kind != "arduplane":
        assert 0.0 < abilities.braking_m_s2 <= 30.0
    for words in abilities.insane:
        assert any(f"{name} {number:g} " in words or f"{name} {number:g}" in words for name, number in values.items())


def subset(wanted: list[Wanted]) -> st.SearchStrategy[list[Wanted]]:
    return st.lists(st.sampled_from(wanted), max_size=3)


def test_an_optional_parameter_is_asked_for_a_few_times_like_any_other() -> None:
    adapter = vehicle("px4-copter")
    asked = [name for step in range(200) for name in adapter.parameters.due(0.1 * step)]
    assert asked.count("SIH_KDV") == TRIES


def test_the_page_lists_which_values_are_sane() -> None:
    page = PAGE.read_text(encoding="utf-8").split("<!-- sane -->")[1]
    rows = [
        f"| `{kind}` | {' or '.join(one.names)} | {sane_words(one)} |"
        for kind in ADAPTERS
        for one in ADAPTERS[kind]().wanted
        if one.least > -math.inf
    ]
    assert page.strip().splitlines()[2:] == rows


def sane_words(one: Wanted) -> str:
    """Return the sane values of a parameter in the unit of each of its names."""
    factors = (1.0, *(factor for _, factor in one.others))
    return " or ".join(dict.fromkeys(f"{one.least / factor:g} to {one.greatest / factor:g}" for factor in factors))
