"""The whole companion on autopilots that resume by themselves, and every reason for silence and for each stage."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.autopilot.adapter import Abilities
from companion.autopilot.arducopter import ArduCopterAdapter
from companion.autopilot.stream import STREAM_GAP_S
from companion.onboard.authority import FAILSAFE_STATES, State
from companion.onboard.companion import Companion
from companion.onboard.config import AutopilotSection, Config
from companion.onboard.decision import Decision, Purpose
from companion.onboard.failsafe import ABILITIES_CHANGED, Stage
from companion.protocol.codec import Directive, ThreatEntry
from tests.companion.onboard.companion_flight import CONFIG, GUIDED, KINDS, ME, SYSTEM, Flight, ObedientCopter, guided

HOLD_MODE = 4 << 16 | 3 << 24
"""PX4's AUTO.LOITER: where a person, or a failsafe, puts it."""
RTL = 6
"""ArduCopter's RTL."""
PACE_S = 0.1


def px4(config: Config = CONFIG, was: State = State.WAITING) -> Flight:
    """Return a PX4 copter in the air, in HOLD, with a picture."""
    flight = Flight(config, "px4-copter", was)
    flight.heartbeat(GUIDED, HOLD_MODE)
    flight.landed(common.MAV_LANDED_STATE_IN_AIR)
    flight.position()
    flight.broadcast()
    return flight


def streamed(flight: Flight) -> common.MAVLink_message | None:
    """Return what the companion sends in the next slot between decisions."""
    flight.now_s += PACE_S
    frames = Flight.parsed(flight.companion.repeat(flight.now_s))
    assert len(frames) <= 1
    return frames[0] if frames else None


def handed_over(config: Config = CONFIG) -> Flight:
    """Return a flight whose vehicle a person has put into OFFBOARD."""
    flight = px4(config)
    flight.tick()
    flight.now_s += PACE_S
    flight.heartbeat()
    assert flight.tick()[0].purpose is Purpose.TARGET
    return flight


def px4_without_picture() -> Flight:
    """Return a flight whose vehicle was put into OFFBOARD, where it stands and waits for a picture."""
    flight = Flight(kind="px4-copter")
    flight.heartbeat(GUIDED, HOLD_MODE)
    flight.landed(common.MAV_LANDED_STATE_IN_AIR)
    flight.position()
    flight.tick()
    flight.heartbeat()
    flight.tick()
    return flight


# PX4: the stream


def test_before_it_is_handed_over_it_streams_a_standstill() -> None:
    flight = px4()
    decision, held = flight.tick()
    assert (decision.purpose, decision.setpoint) == (Purpose.IDLE, None)
    assert held is not None
    assert (held.vx, held.vy, held.vz) == (0.0, 0.0, 0.0)
    assert streamed(flight) is not None


@pytest.mark.parametrize("kind", KINDS)
def test_where_the_mode_alone_decides_nothing_is_streamed_before_it_is_handed_over(kind: str) -> None:
    flight = Flight(kind=kind)
    flight.heartbeat(GUIDED, 5)
    flight.position()
    flight.broadcast()
    assert flight.tick()[1] is None
    assert streamed(flight) is None


def test_on_the_ground_nothing_is_streamed() -> None:
    flight = px4()
    flight.landed()
    assert flight.tick()[1] is None


def test_before_it_is_told_to_be_in_the_air_nothing_is_streamed() -> None:
    flight = Flight(kind="px4-copter")
    flight.heartbeat(GUIDED, HOLD_MODE)
    flight.position()
    assert flight.tick()[1] is None
    flight.landed(common.MAV_LANDED_STATE_IN_AIR)
    assert flight.tick()[1] is not None


def test_without_a_picture_it_holds_in_offboard_and_steers_on_the_tick_after_the_first() -> None:
    flight = Flight(kind="px4-copter")
    flight.heartbeat(GUIDED, HOLD_MODE)
    flight.landed(common.MAV_LANDED_STATE_IN_AIR)
    flight.position()
    assert flight.tick()[1] is not None
    flight.heartbeat()
    decision, held = flight.tick()
    assert (decision.purpose, decision.reason) == (Purpose.IDLE, "no picture")
    assert held is not None
    assert (held.vx, held.vy) == (0.0, 0.0)
    flight.broadcast()
    assert flight.tick()[0].purpose is Purpose.TARGET


def test_from_the_take_over_on_nothing_is_sent_whatever_the_mode_becomes() -> None:
    flight = handed_over()
    flight.heartbeat(GUIDED, HOLD_MODE)
    assert streamed(flight) is None
    for custom_mode in (HOLD_MODE, None, HOLD_MODE, None):
        flight.heartbeat(GUIDED, custom_mode)
        decision, setpoint = flight.tick()
        assert decision.purpose is Purpose.IDLE
        assert decision.reason == "taken over: the mode was changed; nothing is sent until it is disarmed"
        assert setpoint is None
        assert streamed(flight) is None


def test_a_take_over_that_is_taken_back_between_two_ticks_counts() -> None:
    flight = handed_over()
    flight.heartbeat(GUIDED, HOLD_MODE)
    flight.heartbeat()
    assert flight.tick()[1] is None


def test_disarmed_and_flown_again_it_can_be_handed_over_again() -> None:
    flight = handed_over()
    flight.heartbeat(GUIDED, HOLD_MODE)
    for _ in range(2):
        flight.now_s += 1.0
        flight.heartbeat(common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, HOLD_MODE)
    flight.position()
    flight.heartbeat(GUIDED, HOLD_MODE)
    assert flight.tick()[1] is not None
    flight.heartbeat()
    assert flight.tick()[0].purpose is Purpose.TARGET


def test_cleared_on_the_spot_it_can_be_handed_over_again() -> None:
    section = AutopilotSection(kind="px4-copter", link="udpin:127.0.0.1:14540", clear="signal")
    flight = handed_over(CONFIG.model_copy(update={"autopilot": section}))
    flight.heartbeat(GUIDED, HOLD_MODE)
    decision, _ = flight.tick()
    assert decision.reason.endswith("nothing is sent until it is disarmed or cleared by a signal")
    flight.companion.clear(flight.now_s)
    assert flight.tick()[1] is not None
    flight.heartbeat()
    assert flight.tick()[0].purpose is Purpose.TARGET


@pytest.mark.parametrize("state", sorted(FAILSAFE_STATES))
def test_the_autopilots_failsafe_ends_the_stream_for_good(state: int) -> None:
    flight = handed_over()
    flight.heartbeat(state=state)
    assert streamed(flight) is None
    flight.heartbeat()
    assert flight.tick()[1] is None


def test_a_restart_of_the_autopilot_in_flight_ends_the_stream_for_good() -> None:
    flight = handed_over()
    for _ in range(5):
        flight.now_s += 0.2
        flight.heartbeat()
        assert flight.tick()[1] is not None
    flight.boot_ms = 0
    for _ in range(3):
        flight.now_s += 0.1
        flight.position()
    decision, setpoint = flight.tick()
    assert decision.reason.startswith("autopilot restarted in flight")
    assert setpoint is None


@pytest.mark.parametrize("picture", [True, False], ids=["steered", "held"])
def test_a_gap_longer_than_the_autopilot_bears_ends_the_stream_for_good(picture: bool) -> None:
    flight = handed_over() if picture else px4_without_picture()
    flight.now_s += STREAM_GAP_S + 0.01
    flight.position()
    assert not Flight.parsed(flight.companion.repeat(flight.now_s))
    decision, setpoint = flight.tick()
    assert decision.reason.startswith("setpoints stopped: this companion was held up")
    assert setpoint is None


def test_a_shorter_gap_is_borne() -> None:
    flight = handed_over()
    flight.now_s += STREAM_GAP_S - 0.01
    flight.position()
    assert Flight.parsed(flight.companion.repeat(flight.now_s))
    assert flight.tick()[0].purpose is Purpose.TARGET


def test_telemetry_that_stops_for_longer_than_the_autopilot_bears_ends_the_stream_for_good() -> None:
    flight = handed_over()
    began_s = flight.now_s
    reasons = []
    while flight.now_s < began_s + 4.0:
        flight.heartbeat()
        reasons.append(flight.tick()[0].reason)
        flight.now_s += 0.25
    assert "position too old" in reasons
    decision, setpoint = flight.at()
    assert decision.reason.startswith("setpoints stopped: position too old")
    assert setpoint is None


def test_one_that_finds_offboard_on_when_it_starts_sends_nothing() -> None:
    flight = Flight(kind="px4-copter")
    flight.heartbeat()
    flight.position()
    flight.broadcast()
    decision, setpoint = flight.tick()
    assert decision.reason.startswith("OFFBOARD was on before this companion began")
    assert setpoint is None
    assert flight.companion.authority.kept is State.LOCKED


def test_one_that_had_the_vehicle_before_it_died_steers_on_its_first_tick() -> None:
    flight = Flight(kind="px4-copter", was=State.ENGAGED)
    flight.heartbeat()
    flight.position()
    flight.broadcast()
    assert flight.tick()[0].purpose is Purpose.TARGET
    assert flight.companion.authority.kept is State.ENGAGED


def test_one_that_had_been_taken_over_from_before_it_died_sends_nothing() -> None:
    before = handed_over()
    before.heartbeat(GUIDED, HOLD_MODE)
    flight = Flight(kind="px4-copter", was=before.companion.authority.kept)
    flight.heartbeat()
    flight.position()
    flight.broadcast()
    decision, setpoint = flight.tick()
    assert decision.reason.startswith("locked before the restart")
    assert setpoint is None


def test_a_take_over_that_is_taken_back_within_one_datagram_counts() -> None:
    flight = handed_over()
    px4_says = common.MAVLink(None, srcSystem=9, srcComponent=common.MAV_COMP_ID_AUTOPILOT1)
    modes = (HOLD_MODE, flight.identity.guided_mode)
    said = [common.MAVLink_heartbeat_message(2, flight.identity.autopilot, GUIDED, mode, 4, 3) for mode in modes]
    flight.companion.receive(b"".join(bytes(one.pack(px4_says)) for one in said), flight.now_s)
    assert flight.companion.authority.locked
    assert streamed(flight) is None


events = st.sampled_from(["offboard", "hold", "disarm", "critical", "position", "picture", "wait", "reboot", "clear"])


@pytest.mark.slow
@settings(max_examples=150)
@given(st.lists(events, max_size=25), st.sampled_from(State))
def test_whatever_happens_nothing_is_sent_outside_offboard_after_an_engagement_until_it_is_cleared(
    history: list[str], was: State
) -> None:
    flight = Flight(kind="px4-copter", was=was)
    actions: dict[str, Callable[[], object]] = {
        "offboard": flight.heartbeat,
        "hold": lambda: flight.heartbeat(GUIDED, HOLD_MODE),
        "disarm": lambda: flight.heartbeat(common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, HOLD_MODE),
        "critical": lambda: flight.heartbeat(state=common.MAV_STATE_CRITICAL),
        "position": flight.position,
        "picture": flight.broadcast,
        "reboot": lambda: setattr(flight, "boot_ms", 0),
        "clear": lambda: flight.companion.clear(flight.now_s),
    }
    may_stream, ever_offboard = was is not State.LOCKED, was is State.ENGAGED
    for event in ["position", *history]:
        if event == "wait":
            flight.now_s += 0.5
        else:
            actions[event]()
        decision, setpoint = flight.tick()
        if event in ("disarm", "clear"):
            may_stream, ever_offboard = True, False
        elif event == "offboard":
            ever_offboard = True
        elif event in ("hold", "critical") and ever_offboard:
            may_stream = False
        if not may_stream:
            assert setpoint is None
            assert decision.purpose is Purpose.IDLE


# Silence


@pytest.mark.parametrize("state", sorted(FAILSAFE_STATES))
def test_where_the_mode_alone_decides_a_status_word_is_told_and_changes_nothing(state: int) -> None:
    flight = guided()
    flight.broadcast()
    assert flight.at()[0].note is None
    flight.heartbeat(state=state)
    decision, setpoint = flight.at()
    assert decision.purpose is Purpose.TARGET
    assert setpoint is not None
    assert decision.note == f"the autopilot says {FAILSAFE_STATES[state]}"
    flight.heartbeat(GUIDED, RTL)
    decision, setpoint = flight.tick()
    assert (decision.purpose, setpoint) == (Purpose.IDLE, None)


def test_a_copter_that_returns_on_a_low_battery_comes_home_though_its_autopilot_warns() -> None:
    flight = guided()
    flight.home(-400.0, 0.0)
    flight.broadcast()
    flight.battery(20)
    flight.heartbeat(state=common.MAV_STATE_CRITICAL)
    for north_m in (0.0, -200.0, -300.0):
        decision, setpoint = flight.at(north_m, 0.0, (-8.0, 0.0), 18_000)
        assert (decision.purpose, decision.reason) == (Purpose.RETURN, "battery low")
        assert setpoint is not None and setpoint.vx < -1.0


def test_what_the_adapter_keeps_of_a_steering_ends_with_it_once(monkeypatch: pytest.MonkeyPatch) -> None:
    flight, released = guided(), []
    monkeypatch.setattr(flight.companion.adapter, "release", lambda: released.append(flight.now_s))
    flight.broadcast()
    flight.at()
    assert released == []
    flight.heartbeat(GUIDED, 5)
    flight.tick()
    flight.tick()
    assert released == [flight.now_s]


def test_without_a_fix_it_is_silent() -> None:
    flight = guided()
    flight.broadcast()
    flight.gps(fix=1)
    decision, setpoint = flight.tick()
    assert (decision.reason, setpoint) == ("no GPS fix", None)
    flight.gps(fix=3)
    assert flight.tick()[0].purpose is Purpose.TARGET


def test_what_its_kind_needs_and_the_autopilot_does_not_tell_silences_it(monkeypatch: pytest.MonkeyPatch) -> None:
    flight = guided()
    flight.broadcast()
    monkeypatch.setattr(ObedientCopter, "missing_telemetry", "no local position")
    decision, setpoint = flight.tick()
    assert (decision.reason, setpoint) == ("no local position", None)
    monkeypatch.undo()
    assert flight.tick()[0].purpose is Purpose.TARGET


def test_frozen_telemetry_silences_it_when_it_is_too_old() -> None:
    flight = guided()
    flight.broadcast()
    for _ in range(30):
        flight.now_s += 0.1
        flight.boot_ms = 0
        decision, setpoint = flight.at()
    assert (decision.reason, setpoint) == ("position too old", None)


def test_two_autopilots_with_one_id_silence_it_and_the_remedy_is_told() -> None:
    flight = guided()
    flight.broadcast()
    for step in range(6):
        for began_ms in (0, 60_000):
            flight.boot_ms = began_ms + 200 * step
            flight.now_s += 0.1
            decision, setpoint = flight.at()
    assert "two autopilots say they are system 9" in decision.reason
    assert setpoint is None


def test_another_kind_than_the_configured_one_is_never_steered() -> None:
    flight = Flight(kind="px4-copter")
    flight.identity = ObedientCopter.identity
    flight.heartbeat()
    flight.position()
    flight.broadcast()
    decision, setpoint = flight.tick()
    assert "set autopilot.kind to arducopter" in decision.reason
    assert setpoint is None


FENCED = CONFIG.model_copy(
    update={
        "limits": CONFIG.limits.model_copy(
            update={"fence": ((-900.0, -900.0), (9_000.0, -900.0), (9_000.0, 900.0), (-900.0, 900.0))}
        )
    }
)


def test_outside_the_fence_it_does_not_engage() -> None:
    flight = guided(FENCED)
    flight.broadcast()
    decision, setpoint = flight.at(0.0, 950.0)
    words = "outside the fence: fly inside in another mode, then hand over again"
    assert (decision.reason, setpoint) == (words, None)
    assert flight.at(0.0, 850.0)[0].purpose is Purpose.TARGET


def real_copter(config: Config = CONFIG) -> Flight:
    """Return a flight whose autopilot has parameters, as told by `tell`."""
    flight = Flight(config)
    flight.companion = Companion(config, ArduCopterAdapter(SYSTEM))
    flight.heartbeat()
    flight.position()
    flight.broadcast()
    return flight


def tell(flight: Flight, **parameters: float) -> None:
    for name, value in parameters.items():
        kind = common.MAV_PARAM_TYPE_REAL32
        flight.tell(common.MAVLink_param_value_message(name.encode(), value, kind, len(parameters), 0))


DEFAULTS = dict(
    WPNAV_ACCEL=250.0, ANGLE_MAX=3000.0, GUID_TIMEOUT=3.0, FS_GCS_ENABLE=0.0, FENCE_ENABLE=0.0, FENCE_ACTION=1.0
)


def test_what_it_can_do_is_read_before_it_engages() -> None:
    flight = real_copter()
    decision, frames = flight.companion.tick(flight.now_s)
    assert decision.reason == "reading the autopilot's parameters"
    assert not Flight.parsed(frames)
    tell(flight, **DEFAULTS)
    assert flight.companion.tick(flight.now_s)[0].purpose is Purpose.TARGET


def test_it_is_reckoned_with_as_what_its_parameters_say() -> None:
    flight = real_copter()
    tell(flight, **DEFAULTS)
    flight.companion.tick(flight.now_s)
    assert flight.companion.steering.config.limits.n_max == pytest.approx(0.7 * 2.5 / 9.80665, abs=1e-3)
    assert flight.companion.steering.config.limits.speed_m_s < CONFIG.limits.speed_m_s
    assert flight.companion.config.limits == CONFIG.limits


def test_what_changes_while_it_is_engaged_makes_it_loiter_until_it_is_handed_over_anew() -> None:
    flight = real_copter()
    tell(flight, **DEFAULTS)
    flight.companion.tick(flight.now_s)
    before = flight.companion.steering.config.limits
    tell(flight, WPNAV_ACCEL=100.0)
    decision, _ = flight.companion.tick(flight.now_s)
    assert flight.companion.steering.config.limits == before
    assert (decision.stage, decision.purpose, decision.reason) == (Stage.LOITERING, Purpose.LOITER, ABILITIES_CHANGED)
    flight.heartbeat(GUIDED, 5)
    flight.companion.tick(flight.now_s)
    flight.companion.tick(flight.now_s)
    assert flight.companion.steering.config.limits.n_max == pytest.approx(0.7 * 1.0 / 9.80665, abs=1e-3)
    flight.now_s += 1.0
    flight.heartbeat()
    flight.position()
    assert flight.companion.tick(flight.now_s)[0].purpose is Purpose.TARGET


def test_what_is_changed_back_while_it_is_engaged_lets_it_go_on() -> None:
    flight = real_copter()
    tell(flight, **DEFAULTS)
    flight.companion.tick(flight.now_s)
    tell(flight, WPNAV_ACCEL=100.0)
    assert flight.companion.tick(flight.now_s)[0].purpose is Purpose.LOITER
    tell(flight, WPNAV_ACCEL=250.0)
    flight.now_s += 1.0
    flight.position()
    assert flight.companion.tick(flight.now_s)[0].purpose is Purpose.TARGET


def test_in_a_wind_that_leaves_it_no_speed_it_does_not_engage() -> None:
    windy = CONFIG.limits.model_copy(update={"wind_m_s": 9.5})
    flight = real_copter(CONFIG.model_copy(update={"limits": windy}))
    tell(flight, **DEFAULTS)
    decision, _ = flight.companion.tick(flight.now_s)
    assert decision.reason.startswith("limits.wind_m_s 9.5 is not below the 8.")


def test_a_speed_and_a_wind_beyond_its_airspeed_keep_it_from_engaging() -> None:
    windy = CONFIG.limits.model_copy(update={"speed_m_s": 8.0, "wind_m_s": 5.0})
    flight = real_copter(CONFIG.model_copy(update={"limits": windy}))
    tell(flight, **DEFAULTS)
    decision, _ = flight.companion.tick(flight.now_s)
    assert decision.reason == (
        "limits.speed_m_s 8 + wind_m_s 5 = 13 m/s through the air; it reaches 10.3 (ANGLE_MAX 3000): "
        "set speed_m_s to 5.3 or wind_m_s to 2.3 or ANGLE_MAX to 4500 (15 m/s)"
    )
    tell(flight, ANGLE_MAX=4500.0)
    assert flight.companion.tick(flight.now_s)[0].purpose is Purpose.TARGET


def test_a_lean_that_is_lowered_in_flight_makes_it_loiter_in_its_wind() -> None:
    windy = CONFIG.limits.model_copy(update={"speed_m_s": 8.0, "wind_m_s": 5.0})
    flight = real_copter(CONFIG.model_copy(update={"limits": windy}))
    tell(flight, **{**DEFAULTS, "ANGLE_MAX": 4500.0})
    assert flight.companion.tick(flight.now_s)[0].purpose is Purpose.TARGET
    tell(flight, ANGLE_MAX=3000.0)
    assert flight.companion.tick(flight.now_s)[0].reason == ABILITIES_CHANGED


def test_a_parameter_that_no_vehicle_has_keeps_it_from_engaging() -> None:
    flight = real_copter()
    tell(flight, **{**DEFAULTS, "ANGLE_MAX": 0.0})
    decision, _ = flight.companion.tick(flight.now_s)
    assert decision.reason == "ANGLE_MAX 0 is not a sane value (1000 to 8000): correct it on the autopilot"


class Crawler(ObedientCopter):
    """A point that cannot stop and hardly moves."""

    can_stop = False
    abilities = Abilities(speed_min_m_s=0.1, speed_max_m_s=0.1)


def test_one_whose_parameters_leave_nothing_to_fly_by_does_not_engage() -> None:
    flight = Flight()
    flight.companion = Companion(CONFIG, Crawler(SYSTEM))
    flight.heartbeat()
    flight.broadcast()
    decision, setpoint = flight.at()
    assert decision.reason.startswith("its parameters leave 0.1 m/s")
    assert setpoint is None


# Each stage's triggers


def afterwards(flight: Flight, wait_s: float, place: tuple[float, float] = (0.0, 0.0)) -> Decision:
    """Return the decision after a while in which all goes on."""
    until_s = flight.now_s + wait_s
    while flight.now_s < until_s - 1e-6:
        flight.now_s += 0.5
        flight.broadcast()
        decision, _ = flight.at(*place, (10.0, 0.0))
    return decision


def steered(config: Config = CONFIG, kind: str = "kinematic") -> Flight:
    flight = guided(config, kind)
    flight.home(-5_000.0, 0.0)
    assert afterwards(flight, 0.5).purpose is Purpose.TARGET
    return flight


@pytest.mark.parametrize("kind", [*KINDS, "px4-copter"])
def test_a_low_battery_brings_it_home_and_a_good_one_sets_it_going_again(kind: str) -> None:
    flight = handed_over() if kind == "px4-copter" else steered(kind=kind)
    flight.home(-5_000.0, 0.0)
    flight.battery(25)
    decision = afterwards(flight, 0.5)
    assert (decision.stage, decision.purpose, decision.reason) == (Stage.RETURNING, Purpose.RETURN, "battery low")
    flight.battery(29)
    assert afterwards(flight, 3.0).purpose is Purpose.RETURN
    flight.battery(31)
    assert afterwards(flight, 1.0).purpose is Purpose.TARGET


def test_a_position_not_known_well_enough_makes_it_loiter_until_it_is() -> None:
    flight = steered()
    flight.gps(accuracy_m=12.0)
    decision = afterwards(flight, 0.5)
    assert (decision.stage, decision.purpose) == (Stage.LOITERING, Purpose.LOITER)
    assert decision.reason == "position not known well enough"
    flight.gps(accuracy_m=2.0)
    assert afterwards(flight, 0.5).purpose is Purpose.LOITER
    assert afterwards(flight, 0.5).purpose is Purpose.TARGET


def test_outside_the_fence_it_comes_home_and_inside_it_goes_on() -> None:
    flight = steered(FENCED)
    decision = afterwards(flight, 0.5, (0.0, 901.0))
    assert (decision.stage, decision.purpose, decision.reason) == (Stage.RETURNING, Purpose.RETURN, "outside the fence")
    assert afterwards(flight, 1.5, (0.0, 700.0)).purpose is Purpose.TARGET


def in_an_attack_disc(law: str, wait_s: float) -> Decision:
    flight = steered(CONFIG.model_copy(update={"law": law}))
    until_s = flight.now_s + wait_s
    while flight.now_s < until_s - 1e-6:
        flight.now_s += 0.5
        flight.broadcast(threats=(ThreatEntry(2, 0.0, 0.0, 300.0, 200.0, 0.0),))
        decision, _ = flight.at(100.0, 0.0, (10.0, 0.0))
        assert decision.uncertified
    return decision


def test_without_a_certified_back_up_for_long_it_makes_for_no_target() -> None:
    assert in_an_attack_disc("routed", 5.0).stage is Stage.FRESH
    decision = in_an_attack_disc("routed", 6.0)
    assert (decision.stage, decision.reason) == (Stage.LOITERING, "no certified back-up")


def test_being_without_a_back_up_is_counted_anew_when_it_is_handed_over_again() -> None:
    flight = steered()
    flight.broadcast(threats=(ThreatEntry(2, 0.0, 0.0, 300.0, 200.0, 0.0),))
    assert flight.at(100.0, 0.0, (10.0, 0.0))[0].uncertified
    flight.heartbeat(GUIDED, 5)
    flight.tick()
    flight.now_s += 10.0
    flight.heartbeat()
    assert flight.at(100.0, 0.0, (10.0, 0.0))[0].stage is Stage.FRESH


def test_the_papers_laws_are_flown_without_a_back_up_to_see_what_they_do() -> None:
    assert in_an_attack_disc("step", 8.0).stage is Stage.FRESH


def test_a_clock_that_was_stepped_is_named_and_changes_nothing_else() -> None:
    flight = steered()
    assert flight.companion.note_clock(3_600.0)
    decision = afterwards(flight, 0.5)
    assert (decision.stage, decision.purpose) == (Stage.COASTING, Purpose.TARGET)
    assert decision.triggers == ("clock stepped by +3600.0 s",)
    assert decision.picture_age_s == pytest.approx(0.0)
    assert flight.companion.note_clock(0.0)
    assert afterwards(flight, 1.5).stage is Stage.FRESH


@given(st.lists(st.floats(-0.49, 0.49), max_size=20))
def test_a_clock_that_wavers_is_no_news(offsets_s: list[float]) -> None:
    companion = Companion(CONFIG)
    assert not any(companion.note_clock(offset_s) for offset_s in offsets_s)


def test_a_directive_stands_beside_the_ladder() -> None:
    flight = steered()
    flight.broadcast(directive=Directive.HOLD)
    decision, _ = flight.at(velocity=(10.0, 0.0))
    assert (decision.stage, decision.reason) == (Stage.FRESH, "directive hold")


# Who else is in the air


def test_a_vehicle_far_away_that_uses_our_agent_id_is_a_stranger_and_it_is_said() -> None:
    flight = steered()
    flight.neighbour(40.0, 0.0, (-10.0, 0.0), callsign=b"OW%05d" % ME)
    decision = afterwards(flight, 0.5)
    assert decision.note == f"another vehicle uses agent id {ME}"
    assert decision.gave_way is not None


def test_our_own_echo_near_us_is_nobody() -> None:
    flight = steered()
    flight.neighbour(15.0, 0.0, (10.0, 0.0), callsign=b"OW%05d" % ME)
    decision = afterwards(flight, 0.5)
    assert (decision.note, decision.gave_way) == (None, None)


# The turn limit of a vehicle that obeys late


@pytest.mark.parametrize("reaction_s", [0.0, 0.2, 0.4])
def test_a_turn_begins_where_the_last_setpoint_will_have_led_when_the_next_one_acts(reaction_s: float) -> None:
    limits = CONFIG.limits.model_copy(update={"reaction_s": reaction_s, "n_max": 0.2})
    flight = guided(CONFIG.model_copy(update={"limits": limits}), "kinematic")
    flight.broadcast((0.0, 5_000.0))
    first, _ = flight.at(velocity=(10.0, 0.0))
    flight.now_s += CONFIG.guidance_step_s
    assert first.setpoint is not None
    rate_rad_s = 0.2 * 9.80665 / 10.0
    turned_rad = first.setpoint.heading_rad - rate_rad_s * reaction_s
    second, _ = flight.at(velocity=(10.0 * math.cos(turned_rad), 10.0 * math.sin(turned_rad)))
    assert second.setpoint is not None
    further_rad = second.setpoint.heading_rad - first.setpoint.heading_rad
    assert further_rad == pytest.approx(rate_rad_s * CONFIG.guidance_step_s, abs=0.002)
