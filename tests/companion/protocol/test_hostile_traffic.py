"""A sample of the hostile-traffic bench (tests/benchmarks/hostile.py runs it over millions of datagrams)."""

from __future__ import annotations

import tracemalloc

import pytest

from tests.companion.protocol.hostile import AUTHENTICATIONS, Outcome, run

SAMPLE = 6000


def outcome_of(authentication: str, *, seed: int = 1, count: int = SAMPLE, is_stream: bool = False) -> Outcome:
    *_, outcome = run(count, authentication, seed, is_stream=is_stream)
    return outcome


@pytest.mark.parametrize("is_stream", [False, True], ids=["datagrams", "byte stream"])
@pytest.mark.parametrize("authentication", AUTHENTICATIONS)
def test_among_hostile_traffic_all_genuine_frames_and_nothing_else_are_accepted(
    authentication: str, is_stream: bool
) -> None:
    outcome = outcome_of(authentication, is_stream=is_stream)
    assert outcome.forged == 0
    assert outcome.accepted == outcome.genuine > 50
    # Every kind was there; a frame held back and a copy are genuine too, and refused like any other old news.
    assert len(outcome.sent) == 18
    assert outcome.late > 0
    assert outcome.twice > 0


def test_a_late_frame_and_a_copy_are_refused_as_old_and_as_repeated() -> None:
    outcome = outcome_of("both")
    assert outcome.rejected["old sequence"] >= outcome.late
    assert outcome.rejected["repeated"] >= outcome.twice


def test_hostile_traffic_raises_nothing_where_nobody_is_authenticated() -> None:
    outcome = outcome_of("unsigned")
    # Without a key a forgery with a right CRC passes: this is what the word "unsigned" says.
    assert outcome.forged > 0


@pytest.mark.slow
def test_memory_stays_flat_under_hostile_traffic() -> None:
    steps = iter(run(8000, "both", 2))
    for _ in range(3):
        next(steps)
    tracemalloc.start()
    try:
        next(steps)
        before_bytes, _ = tracemalloc.get_traced_memory()
        for _ in steps:
            pass
        after_bytes, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after_bytes - before_bytes < 200_000
