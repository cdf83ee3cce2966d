"""Stand-ins whose home and origin others move, or whose estimate is in doubt, tell it as the real ones do."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from companion.geo.local_frame import LocalFrame
from sim.mavlink_sender import MavlinkSender
from sim.vehicles import CRAFTS, Setup, StandIn
from sim.vehicles.craft import Home

ARDUPILOT, PX4 = ("arducopter", "arduplane"), ("px4-copter", "px4-plane")
KINDS = (*ARDUPILOT, *PX4)
GROUND = MavlinkSender(255, 190)
PLACE_E7 = (470_000_000, 80_000_000)
ASKED = (
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS,
    mavlink.MAVLINK_MSG_ID_GPS2_RAW,
    mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,
)


class Asked:
    """A stand-in at 530 m, 30 m above home, that was asked for what is told of its estimate."""

    def __init__(self, kind: str) -> None:
        self.vehicle = StandIn(
            CRAFTS[kind],
            Setup(1, LocalFrame(47.0, 8.0), altitude_m=530.0, home=Home(0.0, 0.0, 500.0), in_air=True, armed=True),
        )
        self.t_s = 0.0
        self.told: dict[str, Any] = {}
        for message_id in ASKED:
            self.order(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 1e5)
        self.fly(1.0)

    def order(self, command: int, *params: float) -> int:
        """Send a COMMAND_LONG of a ground station; return its MAV_RESULT."""
        values = [*map(float, params), *[0.0] * (7 - len(params))]
        return self.say(GROUND.mav.command_long_encode(1, 1, command, 0, *values))

    def say(self, message: Any) -> int:  # noqa: ANN401 - of pymavlink, which has no types
        replies = self.vehicle.receive(GROUND.pack(message), self.t_s)
        return next((one.result for one in parsed(replies) if one.get_type() == "COMMAND_ACK"), -1)

    def fly(self, lasts_s: float) -> None:
        """Fly on, and keep the newest message of each kind."""
        for _ in range(round(lasts_s * 10.0)):
            self.t_s += 0.1
            self.vehicle.step_to(self.t_s)
            self.told |= {one.get_type(): one for one in parsed(self.vehicle.telemetry(self.t_s))}

    def heights_m(self) -> tuple[float, float, float]:
        """Return altitude, height above home and height in the local frame, as they are told."""
        place = self.told["GLOBAL_POSITION_INT"]
        return place.alt / 1e3, place.relative_alt / 1e3, -self.told["LOCAL_POSITION_NED"].z


def parsed(frames: list[bytes]) -> list[Any]:
    return [one for frame in frames for one in mavlink.MAVLink(None).parse_buffer(bytearray(frame)) or ()]


@pytest.mark.parametrize("kind", KINDS)
def test_home_set_in_flight_moves_the_height_above_home_alone_and_is_told(kind: str) -> None:
    flight = Asked(kind)
    result = flight.say(
        GROUND.mav.command_int_encode(1, 1, 0, mavlink.MAV_CMD_DO_SET_HOME, 0, 0, 0.0, 0.0, 0.0, 0.0, *PLACE_E7, 24.0)
    )
    assert result == mavlink.MAV_RESULT_ACCEPTED
    flight.fly(1.0)
    assert flight.heights_m() == pytest.approx((530.0, 506.0, 30.0), abs=0.1)
    assert flight.told["HOME_POSITION"].altitude == 24_000
    assert flight.vehicle.truth.altitude_m == pytest.approx(530.0, abs=0.1)


def test_home_set_to_the_present_place_is_there() -> None:
    flight = Asked("arducopter")
    assert flight.order(mavlink.MAV_CMD_DO_SET_HOME, 1) == mavlink.MAV_RESULT_ACCEPTED
    flight.fly(0.5)
    assert flight.heights_m()[1] == pytest.approx(0.0, abs=0.01)


def test_a_home_that_is_no_place_is_refused() -> None:
    assert Asked("arducopter").order(mavlink.MAV_CMD_DO_SET_HOME, 0, 0, 0, 0, 95.0, 8.0, 500.0) == (
        mavlink.MAV_RESULT_DENIED
    )


@pytest.mark.parametrize("kind", ["arducopter", "px4-plane"])
@pytest.mark.parametrize("place_e7", [(950_000_000, 80_000_000), (2**31 - 1, -(2**31))])
def test_references_that_are_no_place_here_are_left_alone(kind: str, place_e7: tuple[int, int]) -> None:
    flight = Asked(kind)
    flight.say(GROUND.mav.set_home_position_encode(1, *place_e7, 0, 0.0, 0.0, 0.0, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0))
    flight.say(GROUND.mav.set_gps_global_origin_encode(1, *place_e7, 0))
    flight.fly(1.0)
    assert flight.heights_m() == pytest.approx((530.0, 30.0, 30.0), abs=0.2)


def test_an_ardupilot_takes_its_home_by_message_too() -> None:
    flight = Asked("arducopter")
    level = [1.0, 0.0, 0.0, 0.0]
    flight.say(GROUND.mav.set_home_position_encode(1, *PLACE_E7, 400_000, 0.0, 0.0, 0.0, level, 0.0, 0.0, 0.0))
    flight.fly(0.5)
    assert flight.heights_m()[1] == pytest.approx(130.0, abs=0.1)


@pytest.mark.parametrize("kind", KINDS)
def test_only_px4_lets_the_origin_of_its_local_frame_be_moved(kind: str) -> None:
    flight = Asked(kind)
    flight.say(GROUND.mav.set_gps_global_origin_encode(1, *PLACE_E7, 1_060_000))
    flight.fly(0.5)
    moved_m = -560.0 if kind in PX4 else 0.0
    assert flight.heights_m() == pytest.approx((530.0, 30.0, 30.0 + moved_m), abs=0.2)
    assert flight.told["GPS_GLOBAL_ORIGIN"].altitude == (1_060_000 if kind in PX4 else 500_000)


def test_a_sea_level_that_moves_is_in_the_altitude_alone() -> None:
    flight = Asked("px4-copter")
    flight.vehicle.move_sea_level(100.0)
    flight.fly(0.5)
    assert flight.heights_m() == pytest.approx((630.0, 30.0, 30.0), abs=0.1)


def test_with_two_receivers_the_estimate_holds_when_the_first_one_dies() -> None:
    flight = Asked("arducopter")
    assert "GPS2_RAW" not in flight.told
    flight.vehicle.sensors.receivers.fixes.append(True)
    flight.vehicle.lose_gps(True, receiver=0)
    flight.fly(10.0)
    assert flight.told["GPS_RAW_INT"].fix_type < mavlink.GPS_FIX_TYPE_3D_FIX
    assert flight.told["GPS2_RAW"].fix_type == mavlink.GPS_FIX_TYPE_3D_FIX
    assert flight.told["EKF_STATUS_REPORT"].flags & mavlink.EKF_POS_HORIZ_ABS


@pytest.mark.parametrize(("kind", "holds_s"), [("arducopter", 7.2), ("arduplane", 10.4), ("px4-copter", 5.6)])
def test_without_gps_the_estimate_knows_its_place_for_as_long_as_was_measured(kind: str, holds_s: float) -> None:
    flight = Asked(kind)
    name = "ESTIMATOR_STATUS" if kind in PX4 else "EKF_STATUS_REPORT"
    flight.vehicle.lose_gps(True)
    flight.fly(holds_s - 0.3)
    assert flight.told[name].flags & mavlink.EKF_POS_HORIZ_ABS
    flight.fly(0.6)
    assert not flight.told[name].flags & mavlink.EKF_POS_HORIZ_ABS
    flight.vehicle.lose_gps(False)
    flight.fly(2.0)
    assert flight.told[name].flags & mavlink.EKF_POS_HORIZ_ABS


@pytest.mark.parametrize(
    ("kind", "name", "flag"),
    [
        ("arduplane", "EKF_STATUS_REPORT", mavlink.EKF_GPS_GLITCHING),
        ("px4-plane", "ESTIMATOR_STATUS", mavlink.ESTIMATOR_GPS_GLITCH),
    ],
)
def test_an_estimate_that_rejects_its_receiver_says_so(kind: str, name: str, flag: int) -> None:
    flight = Asked(kind)
    assert not flight.told[name].flags & flag
    flight.vehicle.sensors.glitches = True
    flight.fly(0.3)
    assert flight.told[name].flags & flag


def test_an_estimate_that_gives_in_to_a_glitch_is_elsewhere_in_one_message() -> None:
    flight = Asked("arducopter")
    before = flight.told["GLOBAL_POSITION_INT"].lat
    flight.vehicle.sensors.jump_m = (111.0, 0.0)
    flight.fly(0.1)
    assert (flight.told["GLOBAL_POSITION_INT"].lat - before) / 1e7 * 111_200 == pytest.approx(111.0, abs=1.0)
    assert abs(flight.told["GLOBAL_POSITION_INT"].vx) < 10
