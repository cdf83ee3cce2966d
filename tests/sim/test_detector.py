"""What a vehicle's own detector sees must reach the companion in the standard frames, right to the digit they hold."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.geo.local_frame import LocalFrame
from sim.detector import Detector, Fleet
from sim.vehicles import Home, Setup, StandIn, kinematic_profile

FRAME = LocalFrame(47.0, 8.0)
OWN, SYSTEM = 1, 7


def fleet(*rows: tuple[float, ...]) -> Fleet:
    """Make a fleet of rows id, north m, east m, velocity north m/s, velocity east m/s, altitude m."""
    table = np.array(rows)
    return Fleet(table[:, 0].astype(int), table[:, 1:3], table[:, 3:5], table[:, 5])


def own(north_m: float = 0.0, east_m: float = 0.0) -> tuple[float, ...]:
    return OWN, north_m, east_m, 60.0, 0.0, 600.0


def seen(them: Fleet, range_m: float = 2_000.0) -> list[Any]:
    messages = []
    for frame in Detector(OWN, SYSTEM, FRAME, range_m).look(them):
        (message,) = common.MAVLink(None).parse_buffer(frame) or []
        messages.append(message)
    return messages


def test_who_is_within_the_range_over_the_ground_is_seen_and_nobody_else() -> None:
    them = fleet(
        own(100.0, 100.0),
        (2, 100.0, 2_100.0, 0.0, 0.0, 600.0),
        (3, 100.0, 2_100.1, 0.0, 0.0, 600.0),
        (4, -1_300.0, -1_300.0, 0.0, 0.0, 9_000.0),
        (5, -1_320.0, -1_320.0, 0.0, 0.0, 600.0),
    )
    assert [message.ICAO_address for message in seen(them)] == [2, 4]


@pytest.mark.parametrize("range_m", [0.0, 1e6])
def test_a_vehicle_alone_sees_nobody_and_not_itself(range_m: float) -> None:
    assert seen(fleet(own()), range_m) == []


def test_a_vehicle_that_is_not_among_those_alive_may_not_look() -> None:
    with pytest.raises(ValueError, match="unpack"):
        seen(fleet((2, 0.0, 0.0, 0.0, 0.0, 600.0)))


def test_every_field_is_what_the_standard_says() -> None:
    (message,) = seen(fleet((23, 0.0, 0.0, 0.0, 25.5, 623.4), own(10.0)))
    assert message.get_type() == "ADSB_VEHICLE"
    assert (message.get_srcSystem(), message.get_srcComponent()) == (SYSTEM, common.MAV_COMP_ID_ADSB)
    assert (message.ICAO_address, message.callsign) == (23, "OW00023")
    assert (message.lat, message.lon) == (470_000_000, 80_000_000)
    assert (message.altitude_type, message.altitude) == (common.ADSB_ALTITUDE_TYPE_GEOMETRIC, 623_400)
    assert (message.heading, message.hor_velocity, message.ver_velocity) == (9_000, 2_550, 0)
    assert (message.emitter_type, message.tslc, message.squawk) == (common.ADSB_EMITTER_TYPE_UAV, 0, 0)
    # Coordinates, altitude, heading, velocity and callsign, by the numbers of ADSB_FLAGS.
    assert message.flags == 1 | 2 | 4 | 8 | 16


def test_the_greatest_id_has_a_callsign_of_seven_characters() -> None:
    (message,) = seen(fleet(own(), (65_535, 1.0, 0.0, 0.0, 0.0, 600.0)))
    assert message.callsign == "OW65535"


@given(st.floats(-math.pi, math.pi), st.floats(0.0, 2_000.0))
def test_a_place_is_told_to_a_decimetre_two_hundred_kilometres_out(bearing: float, apart_m: float) -> None:
    there = (200_000.0 * math.cos(bearing), 200_000.0 * math.sin(bearing))
    them = fleet(own(there[0] - apart_m * 0.999, there[1]), (2, *there, 0.0, 0.0, 600.0))
    (message,) = seen(them)
    assert math.dist(FRAME.to_local(message.lat / 1e7, message.lon / 1e7), there) < 0.1


@given(st.floats(-math.pi, math.pi), st.floats(1.0, 100.0))
def test_the_course_is_from_true_north_there(course: float, speed_m_s: float) -> None:
    there = (150_000.0, 150_000.0)
    velocity_m_s = (speed_m_s * math.cos(course), speed_m_s * math.sin(course))
    (message,) = seen(fleet(own(*there), (2, *there, *velocity_m_s, 600.0)))
    start = LocalFrame(*FRAME.to_global(*there))
    moved_m = start.to_local(*FRAME.to_global(there[0] + velocity_m_s[0], there[1] + velocity_m_s[1]))
    off_deg = message.heading / 100.0 - math.degrees(math.atan2(moved_m[1], moved_m[0]))
    # Half the field's digit, and as much again by which the plane bends directions out there.
    assert math.remainder(off_deg, 360.0) == pytest.approx(0.0, abs=0.011)
    assert abs(FRAME.convergence_rad(*there)) > math.radians(0.5)


def test_a_speed_beyond_the_field_is_told_as_its_greatest() -> None:
    (message,) = seen(fleet(own(), (2, 0.0, 0.0, 1_000.0, 0.0, 600.0)))
    assert message.hor_velocity == 65_535


def test_frames_of_one_detector_are_numbered_through() -> None:
    detector = Detector(OWN, SYSTEM, FRAME, 2_000.0)
    them = fleet(own(), (2, 1.0, 0.0, 0.0, 0.0, 600.0), (3, 2.0, 0.0, 0.0, 0.0, 600.0))
    frames = [frame for _ in range(200) for frame in detector.look(them)]
    assert [common.MAVLink(None).parse_buffer(frame)[0].get_seq() for frame in frames] == [n % 256 for n in range(400)]


def test_a_fleet_is_gathered_with_velocities_over_the_ground() -> None:
    def flying(north_m: float) -> StandIn:
        return StandIn(
            kinematic_profile(2.0, 60.0, 60.0),
            Setup(
                1,
                FRAME,
                north_m=north_m,
                east_m=5.0,
                altitude_m=600.0 + north_m,
                speed_m_s=60.0,
                home=Home(0.0, 0.0, 500.0),
                in_air=True,
            ),
        )

    first, second = flying(10.0), flying(20.0)
    second.wind_m_s = (-3.0, 4.0)
    them = Fleet.of({8: first, 3: second})
    assert them.ids.tolist() == [8, 3]
    assert them.positions_ned_m.tolist() == [[10.0, 5.0], [20.0, 5.0]]
    assert them.velocities_ned_m_s == pytest.approx(np.array([[60.0, 0.0], [57.0, 4.0]]))
    assert them.altitudes_m.tolist() == [610.0, 620.0]
