"""What was asked of the autopilot is measured, said when it falls short, and asked for again within bounds."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.autopilot.streams import (
    FIRST_WAIT_S,
    LINK_DEAD_S,
    LONGEST_WAIT_S,
    SETTLING_S,
    SPARSE_AGAIN_S,
    WINDOW_S,
    StreamWatch,
    in_words,
    message_name,
)

POSITION = common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
BATTERY = common.MAVLINK_MSG_ID_SYS_STATUS
HOME = common.MAVLINK_MSG_ID_HOME_POSITION
ADSB = common.MAVLINK_MSG_ID_ADSB_VEHICLE
HEARTBEAT = common.MAVLINK_MSG_ID_HEARTBEAT
ASKED_HZ = {HEARTBEAT: 1.0, POSITION: 10.0, BATTERY: 1.0, HOME: 0.2, ADSB: 10.0}


def played(watch: StreamWatch, rates_hz: dict[int, float], start_s: float, end_s: float) -> list[tuple[float, int]]:
    """Let messages arrive at these rates from now on; return when which message was asked for."""
    asked = []
    for tick in range(round(start_s * 10), round(end_s * 10)):
        now_s = tick / 10
        for message_id, rate_hz in rates_hz.items():
            if rate_hz > 0.0 and tick % round(10 / rate_hz) == 0:
                watch.arrived(message_id, now_s)
        asked += [(now_s, message_id) for message_id in watch.due(now_s)]
    return asked


def watching(rates_hz: dict[int, float] | None = None, until_s: float = 0.0) -> StreamWatch:
    watch = StreamWatch(ASKED_HZ)
    watch.begin(0.0)
    played(watch, ASKED_HZ if rates_hz is None else rates_hz, 0.0, until_s)
    return watch


def test_everything_but_what_comes_by_itself_is_asked_for_once_at_the_start() -> None:
    watch = StreamWatch(ASKED_HZ)
    watch.begin(0.0)
    assert played(watch, ASKED_HZ, 0.0, 200.0) == [(0.0, POSITION), (0.0, BATTERY), (0.0, HOME), (0.0, ADSB)]


def test_a_message_that_comes_more_seldom_is_said_with_both_rates() -> None:
    watch = watching(ASKED_HZ | {POSITION: 1.0}, 30.0)
    (short,) = watch.shortfalls(30.0)
    assert str(short) == "GLOBAL_POSITION_INT 1.0 Hz of 10 asked"
    assert short.rests_on == "the position"


def test_a_message_that_does_not_come_is_said() -> None:
    assert in_words(watching(ASKED_HZ | {BATTERY: 0.0}, 30.0).shortfalls(30.0)) == "SYS_STATUS 0 Hz of 1 asked"


def test_of_many_the_first_three_are_named() -> None:
    watch = watching({ADSB: 10.0}, 60.0)
    assert in_words(watch.shortfalls(60.0)) == (
        "HEARTBEAT 0 Hz of 1 asked, GLOBAL_POSITION_INT 0 Hz of 10 asked, SYS_STATUS 0 Hz of 1 asked, 1 more"
    )


def test_what_another_line_says_already_is_left_out() -> None:
    shortfalls = watching(ASKED_HZ | {POSITION: 1.0}, 30.0).shortfalls(30.0)
    assert in_words(shortfalls, ["GLOBAL_POSITION_INT 1.0 Hz of 10 asked, 1.5 needed"]) is None


def test_nothing_is_said_before_it_was_measured() -> None:
    watch = watching({HEARTBEAT: 1.0})
    played(watch, {HEARTBEAT: 1.0}, 0.0, SETTLING_S + WINDOW_S - 0.1)
    assert watch.shortfalls(SETTLING_S + WINDOW_S - 0.1) == ()
    assert watch.shortfalls(SETTLING_S + WINDOW_S) != ()


def test_what_falls_short_is_asked_for_again_less_and_less_often() -> None:
    watch = watching(until_s=100.0)
    asked_s = [now_s for now_s, message_id in played(watch, ASKED_HZ | {POSITION: 1.0}, 100.0, 400.0)]
    waits_s = [after - before for before, after in zip(asked_s, asked_s[1:], strict=False)]
    assert asked_s[0] == pytest.approx(100.7, abs=0.2)
    assert waits_s == pytest.approx([6.0, 12.0, 24.0, 48.0, *[LONGEST_WAIT_S] * 3], abs=0.11)


def test_after_a_good_minute_it_is_asked_for_quickly_again() -> None:
    watch = watching(ASKED_HZ | {POSITION: 1.0}, 300.0)
    played(watch, ASKED_HZ, 300.0, 400.0)
    asked_s = [now_s for now_s, _ in played(watch, ASKED_HZ | {POSITION: 1.0}, 400.0, 430.0)]
    assert asked_s[1] - asked_s[0] == pytest.approx(2 * FIRST_WAIT_S, abs=0.11)


def test_a_heartbeat_is_asked_for_only_when_it_comes_too_seldom() -> None:
    watch = watching(until_s=50.0)
    assert HEARTBEAT in {message_id for _, message_id in played(watch, ASKED_HZ | {HEARTBEAT: 0.2}, 50.0, 70.0)}


def test_after_a_restart_everything_is_asked_for_again() -> None:
    watch = watching(until_s=50.0)
    watch.begin(50.0)
    assert {message_id for _, message_id in played(watch, ASKED_HZ, 50.0, 51.0)} == set(ASKED_HZ) - {HEARTBEAT}


def test_a_dead_link_is_no_single_message_that_is_missed() -> None:
    watch = watching(until_s=50.0)
    assert watch.shortfalls(50.0 + LINK_DEAD_S + 1.0) == ()
    assert played(watch, {}, 50.0 + LINK_DEAD_S, 200.0) == []
    # And when it is back nothing is asked for as long as all comes as it did before.
    assert played(watch, ASKED_HZ, 200.0, 260.0) == []


def test_a_sparse_message_is_no_shortfall_and_is_asked_for_again_some_time_after_the_last_one() -> None:
    watch = watching(ASKED_HZ | {ADSB: 0.0}, 100.0)
    assert watch.shortfalls(100.0) == ()
    assert watch.due(100.0 + SPARSE_AGAIN_S, seen_s=100.0) == [ADSB]
    assert watch.due(100.0 + SPARSE_AGAIN_S + 1.0, seen_s=100.0) == []


def test_too_seldom_to_steer_by_is_what_leaves_less_than_three_within_the_age_that_is_borne() -> None:
    slow = watching(ASKED_HZ | {POSITION: 1.0}, 30.0)
    assert slow.too_seldom({POSITION: 2.0}, 30.0) == "GLOBAL_POSITION_INT 1.0 Hz of 10 asked, 1.5 needed"
    assert slow.too_seldom({POSITION: 4.0}, 30.0) is None
    assert watching(until_s=30.0).too_seldom({POSITION: 0.1}, 30.0) is None


def test_a_message_that_no_dialect_names_has_its_number() -> None:
    assert message_name(60_001) == "message 60001"


def test_a_frequent_message_that_stops_is_asked_for_within_a_second() -> None:
    watch = watching(until_s=100.0)
    asked = played(watch, ASKED_HZ | {POSITION: 0.0}, 100.0, 101.0)
    assert [message_id for _, message_id in asked] == [POSITION]


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(sorted(ASKED_HZ)), st.floats(0.0, 20.0)), max_size=40))
def test_whatever_another_program_does_to_the_rates_the_questions_are_bounded(
    changes: list[tuple[int, float]],
) -> None:
    watch, rates_hz, asked = StreamWatch(ASKED_HZ), dict(ASKED_HZ), []
    watch.begin(0.0)
    for second in range(120):
        if second < 3 * len(changes) and second % 3 == 0:
            message_id, rate_hz = changes[second // 3]
            rates_hz[message_id] = min(rate_hz, 10.0)
        asked += played(watch, {one: hz for one, hz in rates_hz.items() if hz >= 0.01}, second, second + 1)
    for message_id in ASKED_HZ:
        times_s = [now_s for now_s, one in asked if one == message_id]
        # Doubling waits from 3 s: at most so many in two minutes, and never two within 3 s.
        assert len(times_s) <= 8
        assert all(b - a >= FIRST_WAIT_S - 0.05 for a, b in zip(times_s, times_s[1:], strict=False))


@settings(max_examples=50, deadline=None)
@given(st.integers(10, 90), st.sampled_from([POSITION, BATTERY]))
def test_a_shortfall_is_said_exactly_when_much_less_than_the_asked_rate_comes(period: int, message_id: int) -> None:
    watch, asked_hz, rate_hz = watching(until_s=10.0), ASKED_HZ[message_id], ASKED_HZ[message_id] * 10 / period
    arrivals = [(10.0 + 0.5 * count, HEARTBEAT) for count in range(60)]
    arrivals += [(10.0 + count / rate_hz, message_id) for count in range(round(30.0 * rate_hz))]
    for now_s, one in sorted(arrivals):
        watch.arrived(one, now_s)
    short = watch.shortfall(message_id, 40.0)
    # Within five periods one message more or less is a fifth of the rate.
    if rate_hz >= 0.6 * asked_hz:
        assert short is None
    elif rate_hz <= 0.15 * asked_hz:
        assert short is not None
        assert short.rate_hz == pytest.approx(rate_hz, abs=0.2 * asked_hz)
