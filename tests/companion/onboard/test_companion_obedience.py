"""A companion whose vehicle does not do what its model does: what it reckons with, tells and sends."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
import pytest
from pymavlink.dialects.v20 import common

from companion.guard.guard import Guard
from companion.guard.types import Discs, Limits, Motion, Setpoint
from companion.onboard.decision import Decision, Purpose
from companion.onboard.failsafe import Stage
from companion.onboard.flight_log import decision_frame, summary_line
from companion.protocol.codec import ThreatEntry
from tests.companion.onboard.companion_flight import CONFIG, Flight, guided
from tests.companion.onboard.test_obedience import COPTER, Vehicle

STEP_S = 0.5
SPEED_M_S = 10.0
MODE_LOITER = 5
MODE_HOLD = 4 << 16 | 3 << 24
"""PX4's AUTO.LOITER."""

DISCS = (
    ThreatEntry(1, 300.0, 10.0, 60.0, 30.0, 0.0),
    ThreatEntry(2, 420.0, -50.0, 45.0, 30.0, 0.0),
    ThreatEntry(3, 560.0, 30.0, 60.0, 30.0, 0.0),
)


class Drifter:
    """A vehicle that flies straight on, whatever it is asked."""

    def __init__(self, kind: str) -> None:
        self.east_m = 0.0
        self.decision: Decision | None = None
        self.setpoint: common.MAVLink_message | None = None
        self.speed_m_s = SPEED_M_S
        self.flight = guided(kind=kind)
        if self.flight.companion.adapter.resumes_on_stream:
            # Whoever is found in OFFBOARD is somebody else's.
            self.flight = Flight(kind=kind)
            self.flight.heartbeat(custom_mode=MODE_HOLD)
            self.flight.landed(common.MAV_LANDED_STATE_IN_AIR)
            self.fly(STEP_S)
            self.flight.heartbeat()

    def fly(self, duration_s: float) -> Decision:
        """Fly on; the target is in the north, and the vehicle flies east."""
        flight = self.flight
        for _ in range(round(duration_s / STEP_S)):
            flight.broadcast((5_000.0, 0.0))
            self.decision, self.setpoint = flight.at(0.0, self.east_m, (0.0, self.speed_m_s), 9_000)
            self.east_m += self.speed_m_s * STEP_S
            flight.now_s += STEP_S
        assert self.decision is not None
        return self.decision

    def fly_until(self, rung: str, longest_s: float = 60.0) -> Decision:
        """Fly on until a trigger of the failsafe begins with a word, or the vehicle is let go."""
        for _ in range(round(longest_s / STEP_S)):
            decision = self.fly(STEP_S)
            if any(words.startswith(rung) for words in (*decision.triggers, decision.reason)):
                return decision
        raise AssertionError(f"never {rung}")


def speed_of(setpoint: common.MAVLink_message | None) -> float:
    assert setpoint is not None
    return math.hypot(setpoint.vx, setpoint.vy)


def test_a_copter_that_does_not_turn_is_slowed_and_goes_on() -> None:
    drifter = Drifter("arducopter")
    decision = drifter.fly_until("slowed")
    assert decision.stage is Stage.COASTING
    assert decision.purpose is Purpose.TARGET
    assert "slowed: does not turn: 0.0 of " in summary_line(decision)
    drifter.fly(1.5)
    assert speed_of(drifter.setpoint) <= 0.5 * SPEED_M_S + 0.01


def test_a_copter_that_goes_on_not_to_turn_is_stopped() -> None:
    drifter = Drifter("arducopter")
    decision = drifter.fly_until("stopped")
    assert (decision.stage, decision.purpose) == (Stage.LOITERING, Purpose.LOITER)
    drifter.fly(3.0)
    assert speed_of(drifter.setpoint) <= 0.5 * SPEED_M_S


def test_a_copter_that_does_not_even_stop_is_let_go_until_it_is_handed_over_anew() -> None:
    drifter = Drifter("arducopter")
    decision = drifter.fly_until("does not", 120.0)
    assert decision.purpose is Purpose.IDLE
    assert decision.reason.endswith("nothing is sent until it is handed over anew")
    assert drifter.fly(5.0).purpose is Purpose.IDLE
    assert drifter.setpoint is None
    drifter.flight.heartbeat(custom_mode=MODE_LOITER)
    drifter.fly(1.0)
    drifter.flight.heartbeat()
    assert drifter.fly(STEP_S).purpose is Purpose.TARGET


def test_a_px4_that_does_not_even_stop_is_locked() -> None:
    drifter = Drifter("px4-copter")
    decision = drifter.fly_until("does not", 120.0)
    assert decision.reason.endswith("nothing is sent until it is disarmed")
    assert drifter.flight.companion.authority.locked


def test_a_plane_that_does_not_turn_is_let_go_to_its_autopilot() -> None:
    drifter = Drifter("kinematic")
    decision = drifter.fly_until("does not")
    assert (decision.purpose, drifter.setpoint) == (Purpose.IDLE, None)
    assert decision.reason.startswith("does not turn: 0.0 of ")


def test_a_new_engagement_begins_with_what_is_configured() -> None:
    drifter = Drifter("arducopter")
    drifter.fly_until("slowed")
    drifter.flight.heartbeat(custom_mode=MODE_LOITER)
    drifter.fly(STEP_S)
    drifter.flight.heartbeat()
    assert drifter.fly(STEP_S).stage is Stage.FRESH


def test_what_is_reckoned_with_is_a_part_of_the_decision_and_of_its_check_sum() -> None:
    decision = Drifter("arducopter").fly(2.0)
    reckoning = "reckons with turn rate share 0.35 measured"
    changed = Decision(**{**vars(decision), "reckons": reckoning})
    assert reckoning in summary_line(changed)
    assert decision_frame(changed).words_crc != decision_frame(decision).words_crc


@dataclass
class Way:
    """A flight of a small stand-in among discs: what was reckoned with, and how near the discs it came."""

    nearest_m: float = math.inf
    """Least distance from the edge of a disc."""
    reckoned: list[str] = field(default_factory=list)
    arrived: bool = False
    n_max: list[float] = field(default_factory=list)


def flown(vehicle: Vehicle, duration_s: float) -> Way:
    """Fly a vehicle, which heads away from its target at first, to the target behind three discs."""
    limits = vehicle.limits.model_copy(update={"range_m": 50_000.0, "wind_m_s": 0.0})
    vehicle.limits = limits
    flight = guided(CONFIG.model_copy(update={"limits": limits, "arrival_radius_m": 30.0}), "arducopter")
    north_m = east_m = 0.0
    way = Way()
    for step in range(round(duration_s / STEP_S)):
        if step % 2 == 0:
            flight.broadcast((800.0, 0.0), threats=DISCS)
        velocity = (vehicle.speed_m_s * math.cos(vehicle.course_rad), vehicle.speed_m_s * math.sin(vehicle.course_rad))
        decision, _sent = flight.at(north_m, east_m, velocity)
        way.arrived = way.arrived or decision.reason == "arrived"
        way.n_max.append(flight.companion.steering.config.limits.n_max)
        if decision.reckons is not None and decision.reckons not in way.reckoned:
            way.reckoned.append(decision.reckons)
        if decision.setpoint is None or way.arrived:
            break
        for part in range(10):
            part_s = STEP_S / 10.0
            vehicle.fly(decision.setpoint, flight.now_s + part * part_s, part_s)
            north_m += vehicle.speed_m_s * math.cos(vehicle.course_rad) * part_s
            east_m += vehicle.speed_m_s * math.sin(vehicle.course_rad) * part_s
            apart_m = [math.hypot(north_m - d.north_m, east_m - d.east_m) - d.detection_radius_m for d in DISCS]
            way.nearest_m = min(way.nearest_m, *apart_m)
        flight.now_s += STEP_S
    return way


def test_a_late_copter_among_discs_is_reckoned_with_as_late_enters_none_and_arrives() -> None:
    way = flown(Vehicle(COPTER, delay_s=2.5, course_rad=math.pi), 200.0)
    assert way.reckoned[0].startswith("reckons with reaction 2.")
    assert way.nearest_m > 0.0
    assert way.arrived


def test_an_obedient_copter_among_the_same_discs_is_reckoned_with_as_configured() -> None:
    way = flown(Vehicle(COPTER, course_rad=math.pi), 200.0)
    assert (way.reckoned, way.nearest_m > 0.0, way.arrived) == ([], True, True)
    assert set(way.n_max) == {COPTER.n_max}


def test_a_guard_that_takes_over_keeps_the_commands_in_flight() -> None:
    limits = Limits(8.0, 8.0, 1.0, 0.0, 100.0, reaction_s=1.0)
    discs = Discs(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    first, second = Guard(limits), Guard(Limits(8.0, 8.0, 0.5, 0.0, 100.0, reaction_s=1.0))
    motion = Motion(0.0, 0.0, 0.0, 8.0)
    sent = first.check(Setpoint(0.4, 8.0, 30.0), motion, discs, 0.0, 0.5).setpoint
    assert sent is not None
    second.succeed(first)
    after = second.check(Setpoint(sent.heading_rad, 8.0, 30.0), Motion(4.0, 0.0, 0.0, 8.0), discs, 0.5, 0.5)
    assert after.setpoint is not None
    # One that knew of no command in flight would begin its turn at the reported heading.
    assert after.setpoint.heading_rad == pytest.approx(sent.heading_rad, abs=0.01)
