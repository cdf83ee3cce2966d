"""Who may steer: the mode alone on ArduPilot, and on PX4 nobody after a take-over until a person clears it."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.autopilot.telemetry import Telemetry
from companion.onboard.authority import (
    DIED_BEFORE,
    DISARMED,
    FAILSAFE,
    LOCKED_BEFORE,
    MODE_LEFT,
    NOT_OURS,
    RESTARTED,
    Authority,
    State,
)

FLYING = Telemetry(system_id=1, heartbeat_at_s=0.0, armed=True, in_air=True, system_status=common.MAV_STATE_ACTIVE)
ON_THE_GROUND = replace(FLYING, armed=False, in_air=False)
IN_FAILSAFE = replace(FLYING, system_status=common.MAV_STATE_CRITICAL)


def px4(was: State = State.WAITING) -> Authority:
    return Authority(resumes_on_stream=True, was=was)


def engaged() -> Authority:
    authority = px4()
    authority.note(FLYING, steerable=False)
    authority.note(FLYING, steerable=True)
    assert authority.state is State.ENGAGED
    return authority


def taken_over() -> Authority:
    authority = engaged()
    authority.note(FLYING, steerable=False)
    assert authority.state is State.LOCKED
    return authority


@pytest.mark.parametrize("steps", [(True, False, True), (True,), (False, True, False), (True, False)])
def test_on_ardupilot_the_mode_alone_decides(steps: tuple[bool, ...]) -> None:
    authority = Authority(resumes_on_stream=False)
    for steerable in steps:
        authority.note(replace(IN_FAILSAFE, restarts=len(steps)), steerable)
        assert authority.state is (State.ENGAGED if steerable else State.WAITING)


def test_a_px4_that_is_handed_over_is_engaged() -> None:
    assert engaged().kept is State.ENGAGED


def test_a_mode_change_locks_it() -> None:
    assert taken_over().reason == MODE_LEFT


def test_after_a_take_over_offboard_alone_gives_nothing_back() -> None:
    authority = taken_over()
    authority.note(FLYING, steerable=True)
    assert authority.state is State.LOCKED


def say(authority: Authority, telemetry: Telemetry, *times_s: float) -> None:
    """Note a vehicle that is not steerable, by heartbeats at some times."""
    for at_s in times_s:
        authority.note(replace(telemetry, heartbeat_at_s=at_s), steerable=False)


def test_disarming_clears_a_take_over() -> None:
    authority = taken_over()
    say(authority, ON_THE_GROUND, 1.0, 2.0)
    assert (authority.state, authority.kept) == (State.WAITING, State.WAITING)
    authority.note(FLYING, steerable=True)
    assert authority.state is State.ENGAGED


def test_one_disarmed_heartbeat_clears_nothing() -> None:
    authority = taken_over()
    for at_s in (1.0, 3.0, 5.0):
        say(authority, ON_THE_GROUND, at_s, at_s)
        say(authority, FLYING, at_s + 1.0)
        assert authority.state is State.LOCKED


def test_one_disarmed_heartbeat_ends_an_engagement_and_does_not_bring_it_back() -> None:
    authority = engaged()
    say(authority, ON_THE_GROUND, 1.0)
    assert (authority.state, authority.reason) == (State.LOCKED, DISARMED)
    authority.note(replace(FLYING, heartbeat_at_s=2.0), steerable=True)
    assert authority.state is State.LOCKED


def test_where_the_mode_alone_decides_one_heartbeat_of_another_mode_does_not_unlock_what_was_left() -> None:
    authority = Authority(resumes_on_stream=False)
    authority.note(FLYING, steerable=True)
    authority.leave("does not obey")
    say(authority, FLYING, 1.0)
    authority.note(replace(FLYING, heartbeat_at_s=2.0), steerable=True)
    assert authority.locked
    say(authority, FLYING, 3.0, 4.0)
    assert authority.state is State.WAITING


def test_a_person_clears_a_take_over_on_the_spot() -> None:
    authority = taken_over()
    authority.clear()
    assert authority.state is State.WAITING


def test_a_failsafe_locks_it_even_in_offboard() -> None:
    authority = engaged()
    authority.note(IN_FAILSAFE, steerable=True)
    assert (authority.state, authority.reason) == (State.LOCKED, FAILSAFE)
    authority.note(FLYING, steerable=True)
    assert authority.state is State.LOCKED


def test_a_restart_of_the_autopilot_locks_it() -> None:
    authority = engaged()
    authority.note(replace(FLYING, restarts=1), steerable=True)
    assert (authority.state, authority.reason) == (State.LOCKED, RESTARTED)


def test_a_gap_in_the_stream_locks_it() -> None:
    authority = engaged()
    authority.note_gap("position too old")
    assert (authority.state, authority.reason) == (State.LOCKED, "setpoints stopped: position too old")


def test_a_gap_means_nothing_to_a_person_who_has_the_vehicle_nor_to_ardupilot() -> None:
    waiting = px4()
    waiting.note(FLYING, steerable=False)
    copter = Authority(resumes_on_stream=False)
    copter.note(FLYING, steerable=True)
    for authority in (waiting, copter):
        state = authority.state
        authority.note_gap("no reason")
        assert authority.state is state


def test_a_companion_that_finds_offboard_on_when_it_starts_sends_nothing() -> None:
    authority = px4()
    authority.note(FLYING, steerable=True)
    assert (authority.state, authority.reason) == (State.LOCKED, NOT_OURS)


def test_a_companion_that_had_the_vehicle_before_it_died_goes_on() -> None:
    authority = px4(State.ENGAGED)
    assert authority.kept is State.ENGAGED
    authority.note(FLYING, steerable=True)
    assert authority.state is State.ENGAGED


def test_what_ended_while_the_companion_was_dead_is_over() -> None:
    authority = px4(State.ENGAGED)
    authority.note(FLYING, steerable=False)
    assert (authority.state, authority.reason) == (State.LOCKED, DIED_BEFORE)


@pytest.mark.parametrize("in_offboard", [True, False])
def test_what_was_locked_is_locked_after_a_restart_whatever_the_mode_is_now(in_offboard: bool) -> None:
    again = px4(taken_over().kept)
    again.note(FLYING, steerable=in_offboard)
    assert (again.state, again.reason, again.kept) == (State.LOCKED, LOCKED_BEFORE, State.LOCKED)


def test_disarming_or_a_person_clears_a_lock_from_before_a_restart() -> None:
    disarmed, cleared = px4(State.LOCKED), px4(State.LOCKED)
    say(disarmed, ON_THE_GROUND, 1.0, 2.0)
    cleared.clear()
    assert disarmed.kept is cleared.kept is State.WAITING


def test_a_lock_is_kept_even_if_no_autopilot_is_heard_before_the_next_restart() -> None:
    assert px4(px4(State.LOCKED).kept).locked


def test_a_lock_from_before_a_restart_means_nothing_to_ardupilot() -> None:
    authority = Authority(resumes_on_stream=False, was=State.LOCKED)
    authority.note(FLYING, steerable=True)
    assert authority.state is State.ENGAGED


def test_on_the_ground_nothing_is_engaged() -> None:
    authority = px4()
    authority.note(ON_THE_GROUND, steerable=False)
    authority.note(replace(FLYING, in_air=False), steerable=True)
    assert authority.state is State.WAITING


def test_before_the_first_heartbeat_nothing_is_decided() -> None:
    authority = px4(State.ENGAGED)
    authority.note(Telemetry(), steerable=False)
    assert (authority.state, authority.kept) == (State.WAITING, State.ENGAGED)


telemetries = st.builds(
    replace,
    st.just(FLYING),
    armed=st.booleans(),
    in_air=st.sampled_from([True, False, None]),
    system_status=st.sampled_from([common.MAV_STATE_ACTIVE, common.MAV_STATE_CRITICAL]),
    restarts=st.integers(0, 2),
)


@pytest.mark.slow
@given(st.lists(st.tuples(telemetries, st.booleans()), max_size=30), st.sampled_from(State))
def test_from_a_lock_nothing_but_disarming_leads_out(history: list[tuple[Telemetry, bool]], was: State) -> None:
    authority, disarmed = px4(was), 0
    for at_s, (telemetry, in_offboard) in enumerate(history):
        was_locked = authority.locked
        authority.note(replace(telemetry, heartbeat_at_s=at_s), steerable=telemetry.armed and in_offboard)
        disarmed = 0 if telemetry.armed else disarmed + 1
        if was_locked:
            assert authority.locked is (disarmed < 2)
        if authority.state is State.ENGAGED:
            assert telemetry.armed
            assert in_offboard
            assert telemetry.system_status == common.MAV_STATE_ACTIVE


@given(st.lists(st.tuples(telemetries, st.booleans()), max_size=30))
def test_noting_the_same_twice_changes_nothing(history: list[tuple[Telemetry, bool]]) -> None:
    once, twice = px4(), px4()
    for telemetry, in_offboard in history:
        steerable = telemetry.armed and in_offboard
        once.note(telemetry, steerable)
        twice.note(telemetry, steerable)
        twice.note(telemetry, steerable)
        assert (once.state, once.reason, once.kept) == (twice.state, twice.reason, twice.kept)
