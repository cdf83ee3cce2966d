"""The fit of a follower's delay and rate, on synthetic vehicles whose truth is known."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.onboard.identification.follower import Span, followed

STEP_S = 0.5
"""Time between two commands."""
RATE = 0.2
"""Rate of change of a value that a rate of 1 stands for, per second: a turn of 11 deg/s."""


def span_of(delay_s: float, rate: float, noise: float, seed: int, offset: float = 0.0) -> Span:
    """Return command and reply of a vehicle on two turns of 60 degrees, with noise and lost telemetry."""
    rng = np.random.default_rng(seed)
    command_s = np.arange(0.0, 40.0, STEP_S)
    wanted = np.where((command_s >= 3.0) & (command_s < 20.0), math.pi / 3.0, 0.0)
    command = np.zeros(len(command_s))
    for index in range(1, len(command)):
        most = RATE * STEP_S
        command[index] = command[index - 1] + min(max(wanted[index] - command[index - 1], -most), most)
    fine_s = np.arange(0.0, 40.0, 0.01)
    value, values = 0.0, []
    for t_s in fine_s.tolist():
        asked = command[max(0, int((t_s - delay_s) / STEP_S))] if t_s >= delay_s else 0.0
        value += min(max(asked - value, -rate * RATE * 0.01), rate * RATE * 0.01)
        values.append(value)
    reply_s = np.arange(0.1, 39.9, 1.0 / rng.uniform(5.0, 10.0))
    reply_s = reply_s[rng.random(len(reply_s)) > 0.1]
    reply = np.interp(reply_s, fine_s, values) + offset + rng.normal(0.0, noise, len(reply_s))
    return Span(command_s, command, reply_s, reply, np.full(len(reply), RATE), offset_free=True)


def test_without_noise_delay_and_rate_are_found() -> None:
    found = followed([span_of(0.63, 0.41, 1e-4, 1)], 0.04, 1.5)
    assert found is not None
    assert abs(found.delay_s.value - 0.63) < 0.03
    assert abs(found.rate.value - 0.41) < 0.01


def test_a_course_held_a_little_beside_the_one_asked_for_is_no_delay() -> None:
    found = followed([span_of(0.4, 0.6, 0.01, 2, offset=0.08)], 0.04, 1.5)
    assert found is not None and found.delay_s.low <= 0.4 <= found.delay_s.high


def test_a_vehicle_that_is_faster_than_it_is_asked_to_be_is_known_to_be_at_least_as_fast() -> None:
    span = span_of(0.4, 50.0, 1e-3, 3)
    found = followed([span._replace(command=np.minimum(span.command, 0.0))], 0.04, 1.5)
    assert found is not None and math.isinf(found.rate.high)


def test_what_is_reckoned_with_is_denied_by_a_flight_that_it_does_not_explain() -> None:
    span = span_of(0.8, 0.5, 0.01, 4)
    good, bad = followed([span], 0.04, 1.5, (0.8, 0.5)), followed([span], 0.04, 1.5, (0.2, 1.0))
    assert good is not None and not good.denied
    assert bad is not None and bad.denied


def test_a_turn_that_is_asked_for_slowly_says_only_that_the_vehicle_turns_as_fast() -> None:
    command_s = np.arange(0.0, 30.0, 0.2)
    command = np.clip(0.15 * RATE * (command_s - 5.0), 0.0, 0.4)
    reply_s = np.arange(0.1, 30.0, 0.1)
    reply = np.interp(reply_s - 0.4, command_s, command)
    found = followed([Span(command_s, command, reply_s, reply, np.full(len(reply), RATE), True)], 0.04, 1.5, (0.2, 1.0))
    assert found is not None and math.isinf(found.rate.high) and not found.denied


def test_no_flight_says_nothing() -> None:
    assert followed([], 0.04, 1.5) is None


@settings(max_examples=15, deadline=None)
@given(st.floats(0.1, 1.5), st.floats(0.3, 0.9), st.floats(0.005, 0.04), st.integers(0, 10_000))
def test_the_value_lies_within_its_interval_and_near_the_truth(
    delay_s: float, rate: float, noise: float, seed: int
) -> None:
    found = followed([span_of(delay_s, rate, noise, seed)], 0.04, 1.5)
    assert found is not None
    assert found.delay_s.low <= found.delay_s.value <= found.delay_s.high
    assert found.rate.low <= found.rate.value <= found.rate.high
    assert abs(found.delay_s.value - delay_s) < 0.3
    assert abs(found.rate.value / rate - 1.0) < 0.1


def test_nine_of_ten_intervals_hold_the_truth() -> None:
    rng, held = np.random.default_rng(7), []
    for seed in range(30):
        delay_s, rate, noise = rng.uniform(0.1, 1.5), rng.uniform(0.3, 0.9), rng.uniform(0.005, 0.04)
        found = followed([span_of(delay_s, rate, noise, seed)], 0.04, 1.5)
        assert found is not None
        held += [found.delay_s.low <= delay_s <= found.delay_s.high, found.rate.low <= rate <= found.rate.high]
    assert sum(held) >= 0.9 * len(held)
