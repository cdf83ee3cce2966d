"""A stand-in has the parameters of the firmware that it says it is, by that firmware's names and in its units."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import common

from companion.autopilot.firmware import FAMILIES, PX4, TABLE, Firmware, known, versions
from companion.errors import InputError
from companion.geo.local_frame import LocalFrame
from sim.vehicles import CRAFTS, Setup, StandIn
from sim.vehicles.named import NO_COPTERS, NO_PLANES, firmware_of
from sim.vehicles.parameters import set_parameters
from sim.vehicles.px4 import HOLD, LAND
from tests.field.rig import Rig


def stand_in(kind: str, version: tuple[int, int] | None = None) -> StandIn:
    return StandIn(CRAFTS[kind], Setup(1, LocalFrame(47.0, 8.0), firmware=version))


EVERY = [(kind, version) for kind in CRAFTS for version in versions(FAMILIES[kind])]


@pytest.mark.parametrize(("kind", "version"), EVERY)
def test_every_version_has_its_own_names_and_no_others(kind: str, version: tuple[int, int]) -> None:
    firmware = Firmware(FAMILIES[kind], version)
    named = stand_in(kind, version).named
    other_craft = NO_COPTERS if kind == "px4-copter" else NO_PLANES if kind == "px4-plane" else ("\0",)
    for row in TABLE:
        if row.family != firmware.family or row.name.startswith(other_craft):
            continue
        assert (row.name in named) == row.is_in(firmware), row.name


@pytest.mark.parametrize(("kind", "version"), EVERY)
def test_the_version_is_told(kind: str, version: tuple[int, int]) -> None:
    ask = common.MAVLink_command_long_message(1, 1, common.MAV_CMD_REQUEST_MESSAGE, 0, 148.0, 0, 0, 0, 0, 0, 0)
    replies = stand_in(kind, version).receive(bytes(ask.pack(common.MAVLink(None, srcSystem=255))), 0.0)
    (told,) = [
        message
        for frame in replies
        for message in common.MAVLink(None).parse_buffer(bytearray(frame))
        if message.get_type() == "AUTOPILOT_VERSION"
    ]
    assert told.flight_sw_version >> 16 == version[0] << 8 | version[1]


def test_a_value_is_set_and_told_in_the_versions_unit() -> None:
    vehicle = stand_in("arducopter", (4, 7))
    assert vehicle.named["WP_ACC"].value(vehicle.parameters) == pytest.approx(2.5)
    set_parameters(vehicle, [("WP_ACC", 4.0), ("ATC_ANGLE_MAX", 40.0)])
    assert (vehicle.parameters["WPNAV_ACCEL"], vehicle.parameters["ANGLE_MAX"]) == (400.0, 4000.0)


def test_another_versions_name_is_unknown() -> None:
    with pytest.raises(InputError, match="unknown 'WPNAV_ACCEL'"):
        set_parameters(stand_in("arducopter", (4, 7)), [("WPNAV_ACCEL", 400.0)])


def test_px4s_choices_are_integers_and_its_other_parameters_are_not() -> None:
    for kind in ("px4-copter", "px4-plane"):
        for name, named in stand_in(kind).named.items():
            row = known(kind, name)
            if row is not None and row.family == PX4:
                assert named.parameter.integer == (not row.unit), name


@pytest.mark.parametrize(("kind", "version"), [("arducopter", (3, 6)), ("px4-plane", (4, 6)), ("kinematic", (4, 6))])
def test_a_version_that_the_table_lacks_is_refused_with_what_is_allowed(kind: str, version: tuple[int, int]) -> None:
    with pytest.raises(InputError, match="--firmware: .*; allowed: "):
        firmware_of(kind, version)


@pytest.mark.parametrize(("version", "mode"), [((1, 13), LAND), ((1, 14), HOLD)])
def test_a_px4_of_1_13_does_what_its_second_parameter_says_when_the_stream_ends(
    version: tuple[int, int], mode: int
) -> None:
    rig: Rig = type("Versioned", (Rig,), {"firmware": version})("px4-copter", COM_OBL_RC_ACT=5.0)
    assert ("COM_OBL_ACT" in rig.vehicle.named) == (version == (1, 13))
    rig.run(6.0)
    assert rig.last.setpoint is not None
    rig.vehicle.step_to(rig.now_s + 3.0)
    assert rig.vehicle.mode == mode


def test_request_data_stream_sets_the_rates_of_a_group_on_ardupilot_alone() -> None:
    for kind, rate_hz in (("arducopter", 1), ("px4-copter", 10)):
        vehicle = stand_in(kind)
        ask = common.MAVLink_request_data_stream_message(1, 1, common.MAV_DATA_STREAM_POSITION, 1, 1)
        vehicle.receive(bytes(ask.pack(common.MAVLink(None, srcSystem=255))), 0.0)
        frames = [frame for tick in range(1, 51) for frame in vehicle.telemetry(tick / 10)]
        positions = sum(frame[7] == common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT for frame in frames)
        assert positions in range(5 * rate_hz, 5 * rate_hz + 2)
