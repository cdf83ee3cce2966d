"""What gets its share of costly work in a flood, and how much work that is."""

from __future__ import annotations

import math
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.runtime.fair_share import WINDOW_S, FairShare

BURST_CHECKS = 400


@pytest.mark.slow
def test_nobody_gains_by_the_place_of_a_frame_in_a_burst() -> None:
    drawn = [0, 0, 0]
    for seed in range(1500):
        gate: FairShare[bytes] = FairShare(200.0, BURST_CHECKS, random.Random(seed))
        for _ in range(BURST_CHECKS):
            gate.offer(b"", 0.0)
        gate.due(WINDOW_S)
        raws = [b"%d" % index for index in range(300)]
        for raw in raws:
            assert not gate.offer(raw, WINDOW_S)
        chosen = gate.due(2.1 * WINDOW_S)
        drawn = [count + (raws[place] in chosen) for count, place in zip(drawn, (0, 150, 299), strict=True)]
    # Twenty checks for 300 frames, half of them saved while the first window was open: a chance of one in fifteen.
    assert all(60 <= count <= 140 for count in drawn), drawn


def test_frames_drawn_come_in_the_order_in_which_they_arrived() -> None:
    gate: FairShare[bytes] = FairShare(200.0, BURST_CHECKS, random.Random(1))
    for _ in range(BURST_CHECKS // 2 + 1):
        gate.offer(b"", 0.0)
    for index in range(1000):
        gate.offer(index.to_bytes(2, "big"), 0.01)
    drawn = [raw for raw in gate.due(1.0) if raw]
    assert drawn == sorted(drawn)
    assert len(drawn) > 100


def test_a_gate_keeps_to_its_rate_however_frames_come() -> None:
    rng = random.Random(2)
    gate: FairShare[bytes] = FairShare(100.0, BURST_CHECKS, rng)
    now_s, given_checks = 0.0, 0
    for _ in range(200_000):
        now_s += rng.choice((0.0, 0.0001, 0.001))
        given_checks += len(gate.due(now_s)) + gate.offer(b"", now_s)
    assert now_s * 100 * 0.95 <= given_checks <= now_s * 100 + BURST_CHECKS


def test_in_quiet_times_nothing_waits() -> None:
    gate: FairShare[bytes] = FairShare(200.0, BURST_CHECKS, random.Random(1))
    assert all(gate.offer(b"", step / 100) for step in range(10_000))


def test_what_was_drawn_is_handed_out_a_few_at_a_time_and_in_order() -> None:
    share: FairShare[int] = FairShare(200.0, 2.0, random.Random(1))
    at_once = [number for number in range(5) if share.offer(number, 0.0)]
    assert at_once == [0, 1]
    assert [share.due(1.0, 1) for _ in range(4)] == [[2], [3], [4], []]
    assert share.due_s() == math.inf


@given(st.floats(1e-5, 0.5), st.floats(0.01, 0.9), st.integers(1, 40))
def test_work_keeps_to_its_share_of_the_time_whatever_one_thing_costs(
    cost_s: float, share_of: float, each: int
) -> None:
    share: FairShare[bytes] = FairShare(share_of, 1.0, random.Random(1), cost=1e-4)
    now_s = spent_s = 0.0
    for _ in range(2_000):
        now_s += 0.01
        count = sum(share.offer(b"", now_s) for _ in range(each)) + len(share.due(now_s))
        share.settle(count * cost_s, count)
        spent_s += count * cost_s
    # What the first ones cost, of a step and of the window after it, is known only after them.
    assert spent_s <= share_of * now_s + 1.0 + 8 * each * cost_s
