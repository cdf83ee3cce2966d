"""What anybody may have sent has its turns, and no more than its share of the time."""

from __future__ import annotations

import heapq
import itertools
import math
import random
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.onboard.turn_queue import TURN_S, TurnQueue
from companion.runtime.fair_share import WINDOW_S

SHARE = 0.25
MOST_ROUNDS = 100_000
"""Rounds of the event loop that no run of these tests needs."""


class Call:
    """A call that was asked for."""

    def __init__(self, callback: Callable[[], None]) -> None:
        self.callback: Callable[[], None] | None = callback

    def cancel(self) -> None:
        self.callback = None


class FakeLoop:
    """An event loop whose time passes only when a test lets it, or when what it runs takes some."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self._due: list[tuple[float, int, Call]] = []
        self._number = itertools.count()

    def time(self) -> float:
        return self.now_s

    def call_soon(self, callback: Callable[[], None], /) -> Call:
        return self.call_later(0.0, callback)

    def call_later(self, delay_s: float, callback: Callable[[], None], /) -> Call:
        call = Call(callback)
        heapq.heappush(self._due, (self.now_s + delay_s, next(self._number), call))
        return call

    def run_until(self, until_s: float) -> None:
        """Run what is due until a time."""
        for _ in range(MOST_ROUNDS):
            if not self._due or self._due[0][0] > until_s:
                break
            at_s, _, call = heapq.heappop(self._due)
            self.now_s = max(self.now_s, at_s)
            if call.callback is not None:
                call.callback()
        else:
            raise AssertionError(f"the same is asked for again and again at {self.now_s} s")
        self.now_s = max(self.now_s, until_s)


class Worked:
    """A queue, and what it handed on."""

    def __init__(self, cost_s: float = 0.0) -> None:
        self.loop = FakeLoop()
        self.cost_s = cost_s
        self.taken: list[object] = []
        self.spent_s = 0.0
        self.queue = TurnQueue[object](self._take, SHARE, self.loop, rng=random.Random(1))

    def _take(self, thing: object) -> None:
        self.taken.append(thing)
        self.loop.now_s += self.cost_s
        self.spent_s += self.cost_s


def test_in_quiet_times_everything_is_taken_at_once_and_in_order() -> None:
    worked = Worked(1e-5)
    for number in range(100):
        worked.queue.offer(number)
        worked.loop.run_until(number / 100)
    worked.loop.run_until(1.0)
    assert worked.taken == list(range(100))
    assert worked.queue.dropped == 0


def test_a_whole_broadcast_at_once_loses_nothing() -> None:
    worked = Worked(0.0003)
    for number in range(255):
        worked.queue.offer(number)
    worked.loop.run_until(1.0)
    assert worked.taken == list(range(255))


def test_nothing_is_taken_while_a_decision_is_made() -> None:
    worked = Worked()
    worked.queue.hold()
    worked.queue.offer("early")
    worked.loop.run_until(1.0)
    assert worked.taken == []
    worked.queue.go_on(0.1)
    worked.loop.run_until(2.0)
    assert worked.taken == ["early"]


def test_turns_end_before_the_next_slot_is_due() -> None:
    worked = Worked(0.0005)
    for number in range(1_000):
        worked.queue.offer(number)
    worked.queue.go_on(0.1)
    worked.loop.run_until(0.1)
    assert 0 < worked.spent_s <= 0.1
    assert worked.loop.now_s <= 0.1 + worked.cost_s


def test_on_an_overloaded_computer_each_slot_leaves_one_turn() -> None:
    worked = Worked(0.001)
    for number in range(10):
        worked.queue.offer(number)
    worked.queue.go_on(-5.0)
    worked.loop.run_until(0.1)
    assert 1 <= len(worked.taken) <= 2.0 * TURN_S / worked.cost_s


@settings(max_examples=30, deadline=None)
@given(
    st.lists(st.tuples(st.floats(1e-6, 0.02), st.integers(0, 300)), min_size=5, max_size=40),
    st.floats(0.02, 0.5),
)
def test_work_keeps_to_its_share_whatever_comes_and_whatever_it_costs(
    steps: list[tuple[float, int]], period_s: float
) -> None:
    worked = Worked()
    for cost_s, count in steps:
        worked.cost_s = cost_s
        for _ in range(count):
            worked.queue.offer(None)
        worked.loop.run_until(worked.loop.now_s + period_s)
    # Beyond the share: what was saved up, and the one thing that was begun before its cost was known, in each turn.
    assert worked.spent_s <= SHARE * (worked.loop.now_s + 4.0 + WINDOW_S) + TURN_S + 0.02 * len(steps)


def test_a_pause_that_rounding_leaves_of_nothing_is_not_asked_for_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    worked = Worked(1e-3)
    monkeypatch.setattr(worked.queue._share, "pause_s", lambda now_s: 1e-18 if now_s < 1.0 else 0.0)
    worked.loop.now_s = 0.9
    worked.queue.offer(None)
    worked.loop.run_until(2.0)
    assert worked.taken == [None]


def test_a_sender_in_step_with_the_setpoints_gets_its_chance_in_a_flood() -> None:
    worked = Worked(0.001)
    sent = 0
    for slot in range(600):
        worked.queue.hold()
        worked.queue.go_on(0.1)
        for _ in range(20):
            for _ in range(10):
                worked.queue.offer("junk")
            worked.loop.run_until(worked.loop.now_s + 0.1 / 20)
        if slot % 5 == 0:
            worked.queue.offer("genuine")
            sent += 1
    got, junk = worked.taken.count("genuine"), worked.taken.count("junk")
    # A genuine one has the same chance as any other: an eighth of 120, give or take three deviations.
    chance = (junk + got) / worked.queue.offered
    assert abs(got - chance * sent) <= 3.0 * math.sqrt(sent * chance)
    assert got > 0


def test_checks_that_wait_are_done_though_nothing_else_comes() -> None:
    loop, waiting = FakeLoop(), [3]

    def check() -> float:
        waiting[0] = max(0, waiting[0] - 1)
        return 0.0 if waiting[0] else math.inf

    TurnQueue[object](lambda _: None, SHARE, loop, check).go_on(0.1)
    loop.run_until(0.05)
    assert waiting == [0]
