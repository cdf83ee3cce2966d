"""What happens when a person gives a vehicle back outside its limits: it climbs, or the person is told what to do."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.onboard.config import AutopilotSection, Config
from companion.onboard.decision import Purpose
from companion.protocol.codec import ThreatEntry
from tests.companion.onboard.companion_flight import CONFIG, Flight, guided

LINK = "udpin:127.0.0.1:14540"
LIMITS = CONFIG.limits.model_copy(update={"height_min_m": 20.0, "height_max_m": 60.0})
CLIMBING = AutopilotSection(kind="arducopter", link=LINK, below_height="climb")
LOW_MM = 8_500


def config_of(section: AutopilotSection | None = None) -> Config:
    return CONFIG.model_copy(update={"limits": LIMITS, "autopilot": section})


def low(
    section: AutopilotSection | None = None, height_mm: int = LOW_MM, threats: tuple[ThreatEntry, ...] = ()
) -> Flight:
    """Return a flight whose copter was handed over at a height, standing, with a target."""
    flight = guided(config_of(section))
    flight.broadcast(threats=threats)
    flight.position(height_mm=height_mm)
    return flight


def test_below_its_height_the_person_is_told_what_to_do() -> None:
    decision, setpoint = low().tick()
    assert (decision.purpose, setpoint) == (Purpose.IDLE, None)
    assert decision.reason == ("below limits.height_min_m 20 m at 8.5 m: climb in another mode, then hand over again")


def test_a_copter_that_is_to_climb_does_so_where_it_stands_and_then_goes_to_its_target() -> None:
    flight = low(CLIMBING)
    decision, setpoint = flight.tick()
    assert (decision.purpose, decision.reason) == (
        Purpose.LOITER,
        "below limits.height_min_m 20 m at 8.5 m: climbs",
    )
    assert setpoint is not None
    assert (setpoint.vx, setpoint.vy) == (0.0, 0.0)
    assert setpoint.vz < 0.0
    flight.now_s += 0.5
    flight.position(height_mm=19_900)
    assert flight.tick()[0].reason.endswith("climbs")
    flight.now_s += 0.5
    flight.position(height_mm=20_000)
    assert flight.tick()[0].purpose is Purpose.TARGET


def test_one_that_still_moves_is_not_taken_up() -> None:
    flight = low(CLIMBING)
    flight.position(velocity=(3.0, 0.0), height_mm=LOW_MM)
    decision, setpoint = flight.tick()
    assert (decision.purpose, setpoint) == (Purpose.IDLE, None)
    assert "then hand over again" in decision.reason


def test_inside_a_disc_nothing_climbs_because_the_guard_would_fly_it_sideways() -> None:
    flight = low(CLIMBING, threats=(ThreatEntry(1, 50.0, 0.0, 200.0, 100.0, 0.0),))
    decision, setpoint = flight.tick()
    assert (decision.purpose, setpoint) == (Purpose.IDLE, None)
    assert "no room to climb here" in decision.reason


def test_one_that_sinks_while_it_is_steered_goes_on() -> None:
    flight = low(CLIMBING, height_mm=25_000)
    assert flight.tick()[0].purpose is Purpose.TARGET
    flight.position(height_mm=19_000)
    assert flight.tick()[0].purpose is Purpose.TARGET


def test_a_take_over_while_it_climbs_ends_it_at_once() -> None:
    flight = low(CLIMBING)
    assert flight.tick()[1] is not None
    flight.heartbeat(common.MAV_MODE_FLAG_SAFETY_ARMED | common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 5)
    assert flight.tick()[1] is None


def test_only_vehicles_that_can_stop_may_climb() -> None:
    with pytest.raises(ValueError, match="below_height: 'climb' with kind 'arduplane'; allowed: say"):
        AutopilotSection(kind="arduplane", link=LINK, below_height="climb")


def test_above_its_height_it_descends_and_says_so() -> None:
    flight = low(height_mm=75_000)
    decision, setpoint = flight.tick()
    assert decision.purpose is Purpose.TARGET
    assert decision.note == "above limits.height_max_m 60 m at 75.0 m: descends to 30 m"
    assert setpoint is not None and setpoint.vz > 0.0


def test_faster_than_its_limit_it_slows_down_and_says_so() -> None:
    flight = low(height_mm=30_000)
    flight.position(velocity=(15.0, 0.0))
    assert flight.tick()[0].note == "faster than limits.speed_m_s 10 m/s at 15: slows down"


@given(st.floats(-10.0, 200.0), st.sampled_from([None, CLIMBING]), st.floats(-20.0, 20.0))
def test_whatever_height_and_speed_it_is_given_back_at_it_moves_or_says_what_to_do(
    height_m: float, section: AutopilotSection | None, speed_m_s: float
) -> None:
    flight = guided(config_of(section))
    flight.broadcast()
    flight.position(velocity=(speed_m_s, 0.0), height_mm=round(1e3 * height_m))
    decision, setpoint = flight.tick()
    assert setpoint is not None or decision.reason.endswith("then hand over again")
    assert flight.companion.is_waited_for(decision) == (setpoint is None)


@pytest.mark.parametrize("home_down_mm", [560_000, -560_000])
def test_with_a_home_that_moved_in_a_persons_hands_it_goes_on_at_its_height(home_down_mm: int) -> None:
    flight = low(height_mm=30_000)
    assert flight.tick()[0].purpose is Purpose.TARGET
    flight.heartbeat(common.MAV_MODE_FLAG_SAFETY_ARMED | common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 5)
    assert flight.tick()[0].purpose is Purpose.IDLE
    flight.position(height_mm=30_000)
    flight.move_home(-home_down_mm)
    flight.heartbeat(common.MAV_MODE_FLAG_SAFETY_ARMED | common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 4)
    decision, setpoint = flight.tick()
    assert decision.purpose is Purpose.TARGET
    assert setpoint is not None and setpoint.vz == pytest.approx(0.0, abs=1e-6)
    assert decision.note is not None and "heights count from where it was" in decision.note


def test_a_home_that_the_autopilot_sets_before_the_take_off_is_the_flights_home() -> None:
    flight = low(height_mm=30_000)
    flight.heartbeat(common.MAV_MODE_FLAG_SAFETY_ARMED | common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, 5)
    flight.landed()
    flight.position(height_mm=30_000)
    flight.move_home(-20_000)
    flight.landed(common.MAV_LANDED_STATE_IN_AIR)
    flight.move_home(-20_000)
    assert flight.companion.telemetry.height_m == pytest.approx(50.0)
    flight.move_home(-40_000)
    assert flight.companion.telemetry.height_m == pytest.approx(50.0)
