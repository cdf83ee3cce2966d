"""The companion as a whole: real frames in, a setpoint and its reasons out, and silence whenever a person steers."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.adapters import ADAPTERS
from companion.adapters.velocity import GUIDED_MODE
from companion.config import Config, LimitsSection, StalenessSection
from companion.core import ARRIVAL_SHARE, HEARTBEAT_TIMEOUT_S, Companion, Decision, Purpose
from companion.geodesy import LocalFrame
from companion.mission import CostWeights
from companion.staleness import Stage
from companion.wire import (
    AgentEntry,
    AgentMotion,
    Directive,
    FrameWriter,
    MotionFrame,
    PointMotion,
    Stamp,
    StateFrame,
    TargetEntry,
    ThreatEntry,
)

ME = 3
SYSTEM = 9
EPOCH_S = 1_790_000_000
NOW_S = EPOCH_S + 100.0
ORIGIN_DEG = (47.0, 8.0)
FRAME = LocalFrame(*ORIGIN_DEG)
GUIDED = common.MAV_MODE_FLAG_SAFETY_ARMED | common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
CONFIG = Config(
    agent_id=ME,
    limits=LimitsSection(speed_m_s=10.0, n_max=1.0, range_m=50_000.0),
    weights=CostWeights(k_d=1e6, k_a=1e6, k_c=1e5, k_l=1e5),
    arrival_radius_m=100.0,
    separation_m=20.0,
    staleness=StalenessSection(coasting_after_s=15.0, loitering_after_s=60.0, blind_after_s=300.0),
)


class Flight:
    """A companion, and what the world tells it."""

    def __init__(self, config: Config = CONFIG, kind: str = "arducopter") -> None:
        self.companion = Companion(config, ADAPTERS[kind]())
        self.now_s = NOW_S
        self.sequence = 0
        self._modes: tuple[int, int] | None = None
        self._writer = FrameWriter()
        self._autopilot = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=common.MAV_COMP_ID_AUTOPILOT1)

    def heartbeat(self, base_mode: int = GUIDED, custom_mode: int = GUIDED_MODE) -> None:
        self._modes = (base_mode, custom_mode)
        self._tell(
            common.MAVLink_heartbeat_message(
                common.MAV_TYPE_QUADROTOR,
                common.MAV_AUTOPILOT_ARDUPILOTMEGA,
                base_mode,
                custom_mode,
                common.MAV_STATE_ACTIVE,
                3,
            )
        )

    def position(
        self, north_m: float = 0.0, east_m: float = 0.0, velocity: tuple[float, float] = (0.0, 0.0), hdg: int = 0
    ) -> None:
        if self._modes is not None:
            # An autopilot says both all the time.
            self.heartbeat(*self._modes)
        lat_deg, lon_deg = FRAME.to_global(north_m, east_m)
        vx, vy = (round(100 * speed) for speed in velocity)
        self._tell(
            common.MAVLink_global_position_int_message(
                0, round(lat_deg * 1e7), round(lon_deg * 1e7), 530_000, 30_000, vx, vy, 0, hdg
            )
        )

    def home(self, north_m: float, east_m: float) -> None:
        lat_deg, lon_deg = FRAME.to_global(north_m, east_m)
        self._tell(
            common.MAVLink_home_position_message(
                round(lat_deg * 1e7), round(lon_deg * 1e7), 500_000, 0, 0, 0, [1.0, 0.0, 0.0, 0.0], 0, 0, 0
            )
        )

    def broadcast(
        self,
        target: tuple[float, float] | None = (5_000.0, 0.0),
        *,
        directive: Directive = Directive.NORMAL,
        threats: tuple[ThreatEntry, ...] = (),
        agents: tuple[AgentEntry, ...] = (),
    ) -> None:
        self.sequence += 1
        stamp = Stamp(EPOCH_S, round((self.now_s - EPOCH_S) * 1000), self.sequence)
        targets = () if target is None else (TargetEntry(4, *target),)
        me = AgentEntry(ME, 0.0, 0.0, 4 if targets else None)
        frame = StateFrame(stamp, *ORIGIN_DEG, directive, (me, *agents), targets, threats)
        self.companion.hear(self._writer.encode(frame), self.now_s)

    def tick(self) -> tuple[Decision, common.MAVLink_message | None]:
        """Return the decision and the setpoint sent with it."""
        decision, datagrams = self.companion.tick(self.now_s)
        messages = [common.MAVLink(None).parse_buffer(bytearray(datagram))[0] for datagram in datagrams]
        setpoints = [m for m in messages if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
        assert len(setpoints) <= 1
        assert {m.get_type() for m in messages} <= {"SET_POSITION_TARGET_LOCAL_NED", "HEARTBEAT"}
        return decision, setpoints[0] if setpoints else None

    def at(
        self, north_m: float = 0.0, east_m: float = 0.0, velocity: tuple[float, float] = (0.0, 0.0), hdg: int = 0
    ) -> tuple[Decision, common.MAVLink_message | None]:
        """Be at a place and decide."""
        self.position(north_m, east_m, velocity, hdg)
        return self.tick()

    @staticmethod
    def parsed(frames: list[bytes]) -> list[common.MAVLink_message]:
        """Return the setpoints among frames."""
        messages = common.MAVLink(None).parse_buffer(b"".join(frames)) or []
        return [message for message in messages if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]

    def _tell(self, message: common.MAVLink_message) -> None:
        self.companion.receive(bytes(message.pack(self._autopilot)), self.now_s)


def guided(config: Config = CONFIG, kind: str = "arducopter") -> Flight:
    flight = Flight(config, kind)
    flight.heartbeat()
    flight.position()
    return flight


# When it steers at all


def test_it_is_idle_until_an_autopilot_is_heard() -> None:
    flight = Flight()
    flight.broadcast()
    decision, setpoint = flight.tick()
    assert (decision.purpose, decision.reason, setpoint) == (Purpose.IDLE, "no autopilot heard", None)


@pytest.mark.parametrize(
    ("base_mode", "custom_mode"),
    [
        (common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, GUIDED_MODE),
        (GUIDED, 5),
        (GUIDED, 6),
        (common.MAV_MODE_FLAG_SAFETY_ARMED, GUIDED_MODE),
    ],
)
def test_it_is_idle_until_a_person_arms_and_chooses_guided(base_mode: int, custom_mode: int) -> None:
    flight = Flight()
    flight.broadcast()
    flight.heartbeat(base_mode, custom_mode)
    decision, setpoint = flight.at()
    assert (decision.purpose, decision.reason, setpoint) == (Purpose.IDLE, "not armed and in the guided mode", None)


def test_it_is_idle_until_it_knows_where_it_is() -> None:
    flight = Flight()
    flight.broadcast()
    flight.heartbeat()
    decision, setpoint = flight.tick()
    assert (decision.purpose, decision.reason, setpoint) == (Purpose.IDLE, "no position yet", None)


def test_it_is_idle_when_its_position_is_too_old() -> None:
    flight = guided()
    flight.broadcast()
    flight.now_s += CONFIG.telemetry_timeout_s
    assert flight.tick()[1] is not None
    flight.now_s += 0.1
    decision, setpoint = flight.tick()
    assert (decision.purpose, decision.reason, setpoint) == (Purpose.IDLE, "position too old", None)


def test_a_change_of_mode_stops_the_setpoints_with_the_next_tick() -> None:
    flight = guided()
    flight.broadcast()
    assert flight.tick()[1] is not None
    flight.heartbeat(GUIDED, 5)
    decision, setpoint = flight.tick()
    assert (decision.purpose, setpoint) == (Purpose.IDLE, None)


def test_it_steers_again_when_the_person_gives_it_back() -> None:
    flight = guided()
    flight.broadcast()
    flight.heartbeat(GUIDED, 5)
    flight.tick()
    flight.heartbeat()
    assert flight.tick()[0].purpose is Purpose.TARGET


def test_a_heartbeat_goes_out_once_a_second_even_when_idle() -> None:
    companion = Companion(CONFIG)
    beats_s = []
    for step in range(50):
        _, datagrams = companion.tick(NOW_S + 0.1 * step)
        for datagram in datagrams:
            (message,) = common.MAVLink(None).parse_buffer(bytearray(datagram))
            assert message.type == common.MAV_TYPE_ONBOARD_CONTROLLER
            beats_s.append(0.1 * step)
    assert len(beats_s) == pytest.approx(5, abs=1)
    assert all(later - sooner >= 1.0 - 1e-6 for sooner, later in zip(beats_s, beats_s[1:], strict=False))


# What it does


@pytest.mark.parametrize("kind", ADAPTERS)
def test_without_a_picture_it_loiters_where_it_is(kind: str) -> None:
    flight = guided(kind=kind)
    decision, setpoint = flight.tick()
    assert (decision.purpose, decision.reason, decision.picture_age_s) == (Purpose.LOITER, "no picture", None)
    assert setpoint is not None
    assert math.hypot(setpoint.vx, setpoint.vy) == pytest.approx(0.0 if kind == "arducopter" else 10.0, abs=1e-3)


def test_with_a_target_it_heads_for_it_at_full_speed() -> None:
    flight = guided()
    flight.broadcast((4_000.0, 3_000.0))
    # Already under way, so that the turn limit has nothing to say.
    decision, setpoint = flight.at(velocity=(8.0, 6.0))
    assert (decision.purpose, decision.reason, decision.target_id) == (Purpose.TARGET, "assigned", 4)
    assert decision.wanted_heading_rad == pytest.approx(math.atan2(3_000.0, 4_000.0), abs=0.01)
    assert setpoint is not None
    assert (setpoint.vx, setpoint.vy) == pytest.approx((8.0, 6.0), abs=0.1)
    assert setpoint.target_system == SYSTEM


def test_a_turn_faster_than_the_limit_is_cut_and_said_to_be() -> None:
    flight = guided(CONFIG.model_copy(update={"limits": CONFIG.limits.model_copy(update={"n_max": 0.1})}))
    flight.broadcast((-5_000.0, 1.0))
    decision, setpoint = flight.at(velocity=(10.0, 0.0))
    assert decision.turn_limited
    assert setpoint is not None
    greatest_rad = 0.1 * 9.80665 / 10.0 * CONFIG.guidance_step_s
    assert abs(math.atan2(setpoint.vy, setpoint.vx)) == pytest.approx(greatest_rad, abs=1e-3)


def test_far_from_the_origin_the_heading_is_turned_to_local_north() -> None:
    flight = Flight()
    flight.heartbeat()
    flight.broadcast((0.0, 200_000.0))
    convergence_rad = FRAME.convergence_rad(0.0, 150_000.0)
    assert abs(convergence_rad) > math.radians(1.0)
    _, setpoint = flight.at(0.0, 150_000.0, (10.0 * math.cos(math.pi / 2), 10.0))
    assert setpoint is not None
    heading_rad = math.atan2(setpoint.vy, setpoint.vx)
    assert heading_rad == pytest.approx(math.pi / 2 + convergence_rad, abs=0.005)


def test_it_turns_away_from_a_threat_in_its_way() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0), threats=(ThreatEntry(1, 1_000.0, 100.0, 400.0, 200.0, 0.0),))
    decision, _ = flight.at(600.0, 0.0, (10.0, 0.0))
    assert math.remainder(decision.wanted_heading_rad, math.tau) < -0.05


def test_the_guard_has_the_last_word_and_says_so() -> None:
    blind_law = CONFIG.model_copy(update={"law": "step", "keep_out": "attack"})
    flight = guided(blind_law)
    flight.broadcast((5_000.0, 0.0), threats=(ThreatEntry(1, 1_000.0, 0.0, 400.0, 200.0, 0.0),))
    decision, setpoint = flight.at(770.0, 0.0, (10.0, 0.0))
    assert decision.guard_changes == ("keep-out",)
    assert setpoint is not None
    assert (setpoint.vx, setpoint.vy) != pytest.approx((10.0, 0.0), abs=0.1)


def test_the_guard_keeps_out_of_the_detection_disc_unless_told_otherwise() -> None:
    flight = guided(CONFIG.model_copy(update={"law": "step"}))
    flight.broadcast((5_000.0, 0.0), threats=(ThreatEntry(1, 1_000.0, 0.0, 400.0, 200.0, 0.0),))
    assert flight.at(570.0, 0.0, (10.0, 0.0))[0].guard_changes == ("keep-out",)


def test_arrived_it_loiters() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0))
    decision, _ = flight.at(5_000.0 - ARRIVAL_SHARE * 100.0 + 1.0, 0.0)
    assert (decision.purpose, decision.reason) == (Purpose.LOITER, "arrived")


def test_arriving_takes_a_smaller_circle_than_leaving() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0))
    between_m = 0.9 * 100.0
    assert flight.at(5_000.0 - between_m)[0].purpose is Purpose.TARGET
    assert flight.at(5_000.0)[0].purpose is Purpose.LOITER
    assert flight.at(5_000.0 - between_m)[0].purpose is Purpose.LOITER
    assert flight.at(5_000.0 - 101.0)[0].purpose is Purpose.TARGET


def test_a_person_taking_over_makes_it_forget_that_it_had_arrived() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0))
    flight.at(5_000.0)
    flight.heartbeat(GUIDED, 5)
    flight.tick()
    flight.heartbeat()
    assert flight.at(5_000.0 - 90.0)[0].purpose is Purpose.TARGET


def test_without_a_target_it_loiters() -> None:
    flight = guided()
    flight.broadcast(None)
    decision, _ = flight.tick()
    assert (decision.purpose, decision.reason, decision.target_id) == (Purpose.LOITER, "no target", None)


def test_it_holds_on_the_directive_hold() -> None:
    flight = guided()
    flight.broadcast(directive=Directive.HOLD)
    decision, setpoint = flight.tick()
    assert (decision.purpose, decision.reason) == (Purpose.LOITER, "directive hold")
    assert setpoint is not None
    assert math.hypot(setpoint.vx, setpoint.vy) == pytest.approx(0.0, abs=1e-3)


def test_it_comes_home_on_the_directive_return_and_loiters_there() -> None:
    flight = guided()
    flight.home(-2_000.0, 0.0)
    flight.broadcast(directive=Directive.RETURN)
    decision, _ = flight.at(velocity=(-10.0, 0.0))
    assert (decision.purpose, decision.reason) == (Purpose.RETURN, "directive return")
    assert abs(decision.wanted_heading_rad) == pytest.approx(math.pi, abs=0.01)
    decision, _ = flight.at(-1_990.0, 0.0)
    assert (decision.purpose, decision.reason) == (Purpose.LOITER, "directive return: home")


def test_without_a_home_it_returns_to_where_it_began_to_steer() -> None:
    flight = guided()
    flight.broadcast()
    flight.at(0.0, 0.0)
    flight.broadcast(directive=Directive.RETURN)
    decision, _ = flight.at(0.0, 3_000.0, (0.0, -10.0))
    assert decision.purpose is Purpose.RETURN
    assert decision.wanted_heading_rad == pytest.approx(1.5 * math.pi, abs=0.01)


def test_the_directive_normal_sets_it_going_again() -> None:
    flight = guided()
    flight.broadcast(directive=Directive.HOLD)
    flight.tick()
    flight.broadcast()
    assert flight.tick()[0].purpose is Purpose.TARGET


# Losing the broadcast


@pytest.mark.parametrize(
    ("age_s", "stage", "purpose", "reason"),
    [
        (0.0, Stage.FRESH, Purpose.TARGET, "assigned"),
        (14.9, Stage.FRESH, Purpose.TARGET, "assigned"),
        (15.0, Stage.COASTING, Purpose.TARGET, "assigned"),
        (59.9, Stage.COASTING, Purpose.TARGET, "assigned"),
        (60.0, Stage.LOITERING, Purpose.LOITER, "picture too old"),
        (299.9, Stage.LOITERING, Purpose.LOITER, "picture too old"),
        (300.0, Stage.RETURNING, Purpose.RETURN, "blind"),
        (1e5, Stage.RETURNING, Purpose.RETURN, "blind"),
    ],
)
def test_losing_the_broadcast_walks_the_stages(age_s: float, stage: Stage, purpose: Purpose, reason: str) -> None:
    flight = guided()
    flight.home(-2_000.0, 0.0)
    flight.broadcast()
    flight.now_s += age_s
    decision, setpoint = flight.at()
    assert (decision.stage, decision.purpose, decision.reason) == (stage, purpose, reason)
    assert decision.picture_age_s == pytest.approx(age_s)
    assert setpoint is not None


def test_regaining_the_broadcast_walks_back() -> None:
    flight = guided()
    flight.home(-2_000.0, 0.0)
    flight.broadcast()
    flight.now_s += 400.0
    assert flight.at()[0].purpose is Purpose.RETURN
    flight.broadcast()
    assert flight.at()[0].purpose is Purpose.TARGET


def test_a_repeated_frame_does_not_count_as_regaining_it() -> None:
    flight = guided()
    flight.broadcast()
    flight.now_s += 100.0
    flight.sequence -= 1
    flight.broadcast()
    assert flight.at()[0].stage is Stage.LOITERING


# Range


def with_range(policy: str) -> Flight:
    limits = CONFIG.limits.model_copy(update={"range_m": 2_000.0})
    flight = guided(CONFIG.model_copy(update={"limits": limits, "range_policy": policy}))
    flight.home(0.0, 0.0)
    return flight


def flown(flight: Flight, *norths_m: float) -> Decision:
    decisions = []
    for north_m in norths_m:
        flight.broadcast((50_000.0, 0.0))
        decisions.append(flight.at(north_m, 0.0, (10.0, 0.0))[0])
    return decisions[-1]


def test_within_its_range_it_goes_on() -> None:
    assert flown(with_range("return"), 0.0, 500.0, 900.0).purpose is Purpose.TARGET


def test_it_turns_home_while_its_range_still_reaches() -> None:
    decision = flown(with_range("return"), 0.0, 500.0, 960.0)
    assert (decision.purpose, decision.reason) == (Purpose.RETURN, "range")


def test_having_turned_home_for_its_range_it_keeps_to_it() -> None:
    decision = flown(with_range("return"), 0.0, 500.0, 960.0, 500.0, 300.0)
    assert (decision.purpose, decision.reason) == (Purpose.RETURN, "range")


def test_the_policy_arrive_goes_on_whatever_the_range() -> None:
    assert flown(with_range("arrive"), 0.0, 500.0, 960.0, 1_500.0).purpose is Purpose.TARGET


# Hostile bytes


@settings(max_examples=60)
@given(st.lists(st.tuples(st.booleans(), st.binary(max_size=300)), max_size=20))
def test_random_bytes_on_either_link_change_nothing(junk: list[tuple[bool, bytes]]) -> None:
    def decide(datagrams: list[tuple[bool, bytes]]) -> Decision:
        flight = guided()
        flight.broadcast()
        for from_broadcast, datagram in datagrams:
            (flight.companion.hear if from_broadcast else flight.companion.receive)(datagram, flight.now_s)
        return flight.tick()[0]

    assert decide(junk) == decide([])


def test_the_autopilots_bytes_on_the_broadcast_link_steer_nothing() -> None:
    flight = Flight()
    autopilot = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
    beat = common.MAVLink_heartbeat_message(2, common.MAV_AUTOPILOT_ARDUPILOTMEGA, GUIDED, GUIDED_MODE, 4, 3)
    flight.companion.hear(bytes(beat.pack(autopilot)), NOW_S)
    assert flight.tick()[0].reason == "no autopilot heard"


places_m = st.floats(-300_000.0, 300_000.0)
pairs = st.tuples(places_m, places_m)


@settings(max_examples=150, deadline=None)
@given(
    st.sampled_from(sorted(ADAPTERS)),
    st.sampled_from(["seed", "ramp", "step"]),
    pairs,
    st.none() | pairs,
    st.lists(st.tuples(pairs, st.floats(1.0, 1e5), st.floats(0.01, 1.0), st.floats(0.0, 255.0)), max_size=4),
    st.lists(pairs, max_size=3),
    st.sampled_from(Directive),
    st.tuples(st.floats(-300.0, 300.0), st.floats(-300.0, 300.0)),
    st.floats(0.0, 1e4),
)
def test_whatever_is_broadcast_the_velocity_asked_for_is_finite_and_within_the_limits(
    kind: str,
    law: str,
    place: tuple[float, float],
    target: tuple[float, float] | None,
    threats: list[tuple[tuple[float, float], float, float, float]],
    peers: list[tuple[float, float]],
    directive: Directive,
    velocity: tuple[float, float],
    age_s: float,
) -> None:
    flight = Flight(CONFIG.model_copy(update={"law": law}), kind)
    flight.heartbeat()
    flight.broadcast(
        target,
        directive=directive,
        threats=tuple(
            ThreatEntry(k, *centre, radius_m, radius_m * share, bound_m_s)
            for k, (centre, radius_m, share, bound_m_s) in enumerate(threats)
        ),
        agents=tuple(AgentEntry(10 + k, *peer, None) for k, peer in enumerate(peers)),
    )
    flight.now_s += age_s
    decision, setpoint = flight.at(*place, velocity)
    assert setpoint is not None
    assert decision.reason
    assert all(map(math.isfinite, (setpoint.vx, setpoint.vy, setpoint.vz)))
    assert math.hypot(setpoint.vx, setpoint.vy) <= CONFIG.limits.speed_m_s + 1e-3


@given(st.lists(st.sampled_from(["beat", "manual", "place", "state", "hold", "wait", "long wait"]), max_size=12))
def test_every_decision_carries_its_reason(events: list[str]) -> None:
    flight = Flight()
    actions = {
        "beat": flight.heartbeat,
        "manual": lambda: flight.heartbeat(GUIDED, 5),
        "place": flight.position,
        "state": flight.broadcast,
        "hold": lambda: flight.broadcast(directive=Directive.HOLD),
    }
    for event in events:
        if event in actions:
            actions[event]()
        else:
            flight.now_s += 1.0 if event == "wait" else 70.0
        decision, setpoint = flight.tick()
        assert decision.reason
        assert decision.t_s == flight.now_s
        assert (decision.purpose is Purpose.IDLE) == (setpoint is None) == (decision.setpoint is None)


def test_a_motion_frame_alone_is_no_picture() -> None:
    flight = guided()
    stamp = Stamp(EPOCH_S, 100_000, 1)
    frame = MotionFrame(stamp, (AgentMotion(ME, 0.0, 10.0, 0.0),), (PointMotion(4, 1.0, 0.0, 0.0),), ())
    flight.companion.hear(FrameWriter().encode(frame), NOW_S)
    assert flight.tick()[0].reason == "no picture"


def test_the_companion_takes_its_adapter_from_its_configuration() -> None:
    links = {"autopilot": {"kind": "arducopter", "link": "udpin:127.0.0.1:14540"}}
    companion = Companion(Config.model_validate({"agent_id": 1, **links}))
    assert companion.adapter.can_stop


def test_another_companion_hearing_the_same_decides_the_same() -> None:
    def decide() -> list[Decision]:
        flight = guided()
        flight.broadcast(threats=(ThreatEntry(1, 900.0, 50.0, 400.0, 200.0, 5.0),))
        return [flight.at(10.0 * step, 0.0, (10.0, 0.0))[0] for step in range(50)]

    assert decide() == decide()


def test_an_autopilot_whose_heartbeat_is_lost_is_not_steered() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0))
    companion = flight.companion
    assert companion.adapter.telemetry.heartbeat_at_s is not None
    late_s = companion.adapter.telemetry.heartbeat_at_s + HEARTBEAT_TIMEOUT_S + 0.1
    decision, _ = companion.tick(late_s)
    assert (decision.purpose, decision.reason) == (Purpose.IDLE, "autopilot's heartbeat lost")


def test_between_decisions_the_last_setpoint_is_repeated_as_it_was() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0))
    _, first = flight.at()
    assert first is not None
    again = flight.parsed(flight.companion.repeat(flight.now_s + 0.5))
    assert [(message.vx, message.vy) for message in again] == [(first.vx, first.vy)]


def test_nothing_is_repeated_once_a_person_has_the_vehicle() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0))
    flight.at()
    flight.heartbeat(custom_mode=5)
    assert flight.parsed(flight.companion.repeat(flight.now_s + 0.5)) == []
    flight.heartbeat()
    assert flight.parsed(flight.companion.repeat(flight.now_s + 0.6)) == []


def test_having_come_home_blind_it_stays_home_though_its_circle_is_wide() -> None:
    flight = guided()
    flight.broadcast((5_000.0, 0.0))
    flight.at()
    flight.now_s += 1_000.0
    near, wide = 0.79 * 100.0, 1.2 * 100.0
    reasons = [flight.at(place, 0.0, (10.0, 0.0))[0].purpose for place in (wide, near, wide, 400.0)]
    assert reasons == [Purpose.RETURN, Purpose.LOITER, Purpose.LOITER, Purpose.RETURN]
