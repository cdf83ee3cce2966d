"""The whole companion when frames of reference move, positions jump, and the autopilot's estimate is in doubt."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import ardupilotmega, common

from companion.onboard.companion import JUMPS
from companion.onboard.decision import Purpose
from companion.onboard.failsafe import Stage
from companion.protocol.codec import Directive
from tests.companion.onboard.companion_flight import CONFIG, FRAME, GUIDED, HOME_ALTITUDE_M, Flight, guided

HOLD_MODE = 4 << 16 | 3 << 24
STABILIZE = 0
RAISED_M = 560.0
KNOWS, BLIND, GLITCH = 0x33F, 0x25, 0x833F


def position(
    flight: Flight, home_up_m: float = 0.0, north_m: float = 0.0, east_m: float = 0.0, after_s: float = 0.1
) -> None:
    """Let the autopilot tell the place after a time; it is 30 m above where home was at first."""
    lat_deg, lon_deg = FRAME.to_global(north_m, east_m)
    flight.boot_ms += round(1e3 * after_s)
    flight.now_s += after_s
    flight.heartbeat(GUIDED)
    flight.tell(
        common.MAVLink_global_position_int_message(
            *(flight.boot_ms, round(lat_deg * 1e7), round(lon_deg * 1e7), round(1e3 * (HOME_ALTITUDE_M + 30.0))),
            *(round(1e3 * (30.0 - home_up_m)), 0, 0, 0, 0),
        )
    )


def engaged() -> Flight:
    flight = guided()
    flight.broadcast()
    position(flight)
    assert flight.tick()[0].purpose is Purpose.TARGET
    return flight


def ekf(flight: Flight, flags: int = KNOWS, ratio: float = 0.01) -> None:
    flight.tell(ardupilotmega.MAVLink_ekf_status_report_message(flags, 0.01, ratio, 0.01, 0.01, 0.0))


@pytest.mark.parametrize("home_up_m", [RAISED_M, -RAISED_M])
def test_a_moved_home_makes_it_loiter_at_its_height_and_say_so(home_up_m: float) -> None:
    flight = engaged()
    position(flight, home_up_m)
    decision, setpoint = flight.tick()
    assert (decision.purpose, decision.stage) == (Purpose.LOITER, Stage.LOITERING)
    assert decision.reason.startswith("home moved 560 m")
    assert decision.reason.endswith("hand over again")
    assert setpoint is not None
    assert setpoint.vz == pytest.approx(0.0, abs=1e-6)


def test_the_setpoint_in_force_does_not_follow_a_home_that_moves_between_two_decisions() -> None:
    flight = engaged()
    position(flight, -RAISED_M)
    (repeated,) = Flight.parsed(flight.companion.repeat(flight.now_s))
    assert repeated.vz == pytest.approx(0.0, abs=1e-6)


def test_a_home_that_moves_while_a_handed_over_vehicle_waits_for_a_picture_is_noticed() -> None:
    flight = guided()
    position(flight)
    assert flight.tick()[0].purpose is Purpose.IDLE
    position(flight, -RAISED_M)
    flight.broadcast()
    decision, setpoint = flight.tick()
    assert decision.reason.startswith("home moved 560 m down")
    assert setpoint is not None
    assert setpoint.vz == pytest.approx(0.0, abs=1e-6)


def test_a_silence_of_the_autopilot_is_no_hand_over() -> None:
    flight = engaged()
    flight.now_s += 5.0
    assert flight.tick()[0].purpose is Purpose.IDLE
    flight.boot_ms += 5_000
    flight.broadcast()
    position(flight, -RAISED_M)
    assert flight.tick()[0].reason.startswith("home moved 560 m down")


def test_a_new_hand_over_ends_the_wait_and_keeps_the_height() -> None:
    flight = engaged()
    position(flight, -20.0)
    assert flight.tick()[0].purpose is Purpose.LOITER
    flight.heartbeat(GUIDED, STABILIZE)
    flight.tick()
    flight.now_s += 1.5
    position(flight, -20.0)
    decision, setpoint = flight.tick()
    assert (decision.purpose, decision.triggers) == (Purpose.TARGET, ())
    assert decision.note is not None
    assert "home had moved 20 m down in flight: heights count from where it was" in decision.note
    assert setpoint is not None
    assert setpoint.vz == pytest.approx(0.0, abs=1e-6)


def test_it_returns_to_the_home_of_the_hand_over() -> None:
    flight = guided()
    flight.home(-3_000.0, 0.0)
    flight.broadcast(directive=Directive.RETURN)
    position(flight)
    assert flight.tick()[0].wanted_heading_rad == pytest.approx(3.1416, abs=0.01)
    flight.home(3_000.0, 0.0)
    decision, _ = flight.tick()
    assert decision.wanted_heading_rad == pytest.approx(3.1416, abs=0.01)
    assert decision.triggers == ("home moved 6000 m aside in flight: the old one counts; hand over again",)


def test_a_position_that_jumps_swings_no_setpoint_and_is_told() -> None:
    flight = engaged()
    before = flight.tick()[0]
    position(flight, east_m=500.0)
    decision, _ = flight.tick()
    assert (decision.purpose, decision.stage) == (Purpose.TARGET, Stage.COASTING)
    assert decision.wanted_heading_rad == pytest.approx(before.wanted_heading_rad, abs=1e-3)
    assert decision.triggers == ("position jumped 500 m: not believed before it has stood for 2 s",)


def test_a_position_that_jumped_and_stayed_makes_it_loiter_where_it_is_until_it_has_jumped_back() -> None:
    flight = engaged()
    for _ in range(22):
        position(flight, east_m=500.0)
        decision, _ = flight.tick()
    assert decision.purpose is Purpose.LOITER
    assert decision.reason.startswith("position jumped 500 m at ")
    engagement = flight.companion.engagement
    assert engagement is not None
    assert engagement.loiter_place_ned_m is not None
    # Where it comes to a stop, by the place that is now believed.
    assert engagement.loiter_place_ned_m[1] == pytest.approx(500.0, abs=5.0)
    for _ in range(34):
        position(flight)
        decision, _ = flight.tick()
    assert decision.purpose is Purpose.TARGET


def test_a_jump_over_the_fence_brings_nobody_home() -> None:
    limits = CONFIG.limits.model_copy(
        update={"fence": ((-500.0, -500.0), (-500.0, 500.0), (9e3, 500.0), (9e3, -500.0))}
    )
    flight = guided(CONFIG.model_copy(update={"limits": limits}))
    flight.broadcast()
    purposes = set()
    for sample in range(40):
        position(flight, east_m=2_000.0 if sample > 5 else 0.0)
        flight.broadcast()
        purposes.add(flight.tick()[0].purpose)
    assert Purpose.RETURN not in purposes


def test_positions_that_jump_about_silence_it() -> None:
    flight = engaged()
    for sample in range(14):
        # Faster than any vehicle they would be two autopilots.
        position(flight, east_m=40.0 + 25.0 * (sample % 2), after_s=0.5)
        decision, setpoint = flight.tick()
    assert (decision.reason, setpoint) == (JUMPS, None)


def test_with_an_estimate_that_has_no_position_it_is_silent_whatever_the_receivers_say() -> None:
    flight = engaged()
    flight.gps(fix=6)
    ekf(flight, BLIND)
    assert flight.tick()[0].reason == "the autopilot's estimate has no position"


def test_while_the_estimate_holds_without_any_fix_it_loiters() -> None:
    flight = engaged()
    flight.gps(fix=1)
    ekf(flight)
    decision, setpoint = flight.tick()
    assert (decision.purpose, decision.reason) == (Purpose.LOITER, "no GPS fix: only the autopilot's estimate holds")
    assert setpoint is not None


def test_without_any_fix_it_does_not_begin() -> None:
    flight = guided()
    flight.broadcast()
    flight.gps(fix=1)
    ekf(flight)
    decision, setpoint = flight.tick()
    assert (decision.reason, setpoint) == ("no GPS fix: only the autopilot's estimate holds", None)


def test_an_old_word_of_the_estimate_does_not_count_and_the_fix_decides() -> None:
    flight = engaged()
    ekf(flight)
    flight.gps(fix=1)
    flight.now_s += 4.0
    flight.boot_ms += 4_000
    position(flight)
    assert flight.tick()[0].reason == "no GPS fix"


def test_a_glitch_that_the_autopilot_tells_makes_it_loiter() -> None:
    flight = engaged()
    ekf(flight, GLITCH)
    decision, _ = flight.tick()
    assert (decision.purpose, decision.reason) == (Purpose.LOITER, "the autopilot's estimate says GPS glitch")


def test_a_px4_that_goes_back_to_offboard_by_itself_when_gps_is_back_gets_nothing() -> None:
    """Measured: LAND 6 s after GPS is lost, and OFFBOARD again 2.4 s after it is back."""
    flight = Flight(CONFIG, "px4-copter")
    flight.heartbeat(GUIDED, HOLD_MODE)
    flight.landed(common.MAV_LANDED_STATE_IN_AIR)
    flight.position()
    flight.broadcast()
    flight.tick()
    flight.heartbeat()
    assert flight.tick()[0].purpose is Purpose.TARGET
    flight.heartbeat(GUIDED, 4 << 16 | 6 << 24, common.MAV_STATE_CRITICAL)
    flight.tick()
    for _ in range(10):
        flight.now_s += 1.0
        flight.position()
        flight.heartbeat()
        decision, setpoint = flight.tick()
        assert (decision.purpose, setpoint) == (Purpose.IDLE, None)
