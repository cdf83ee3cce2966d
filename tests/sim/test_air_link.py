"""The lossy link: what it loses, delays, repeats, reorders and changes, and that it repeats itself from its seed."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.mission.model import Burst, LinkSpec
from sim.air_link import LossyLink

FRAMES = [bytes([index % 256, index // 256]) for index in range(2_000)]


def link_of(spec: LinkSpec, seed: int = 1) -> LossyLink:
    return LossyLink(spec, np.random.default_rng(seed), hold_back_s=5.0)


def heard(spec: LinkSpec, seed: int = 1) -> list[tuple[float, bytes]]:
    link = link_of(spec, seed)
    for index, frame in enumerate(FRAMES):
        link.send(frame, float(index))
    return link.deliver(math.inf)


def test_a_perfect_link_delivers_everything_in_order_after_its_delay() -> None:
    assert heard(LinkSpec(delay_s=0.1)) == [(index + 0.1, frame) for index, frame in enumerate(FRAMES)]


def test_nothing_arrives_before_its_time() -> None:
    link = link_of(LinkSpec(delay_s=0.5))
    link.send(b"frame", 10.0)
    assert link.deliver(10.4) == []
    assert link.deliver(10.5) == [(10.5, b"frame")]
    assert link.deliver(99.0) == []


@pytest.mark.parametrize("loss", [0.1, 0.5, 0.9])
def test_frames_are_lost_at_the_rate_asked_for_and_counted(loss: float) -> None:
    link = link_of(LinkSpec(loss=loss))
    for frame in FRAMES:
        link.send(frame, 0.0)
    assert link.lost == pytest.approx(loss * len(FRAMES), rel=0.1)
    assert len(link.deliver(math.inf)) == len(FRAMES) - link.lost


def test_a_cut_link_delivers_nothing() -> None:
    assert heard(LinkSpec(loss=1.0)) == []


def test_bursts_lose_frames_in_runs() -> None:
    arrived = {frame for _, frame in heard(LinkSpec(burst=Burst(enter=0.05, leave=0.2)))}
    lost = [frame not in arrived for frame in FRAMES]
    ends = sum(a and not b for a, b in zip(lost, lost[1:], strict=False))
    # A run lasts 1 / leave frames on average; independent losses at the same rate would last about 1.25.
    assert sum(lost) / ends == pytest.approx(5.0, rel=0.25)
    assert sum(lost) / len(lost) == pytest.approx(0.2, abs=0.05)


def test_a_burst_may_let_some_frames_through() -> None:
    always_bad = Burst(enter=1.0, leave=1e-9, loss=0.5)
    assert len(heard(LinkSpec(burst=always_bad))) == pytest.approx(len(FRAMES) / 2, rel=0.1)


def test_jitter_delays_within_its_bound() -> None:
    waits_s = [at_s - (frame[0] + 256 * frame[1]) for at_s, frame in heard(LinkSpec(delay_s=0.1, jitter_s=0.4))]
    assert min(waits_s) >= 0.1 - 1e-9
    assert max(waits_s) <= 0.5 + 1e-9
    assert max(waits_s) - min(waits_s) > 0.35


def test_duplicates_arrive_twice() -> None:
    assert len(heard(LinkSpec(duplicate=0.3))) == pytest.approx(1.3 * len(FRAMES), rel=0.05)


def test_reordered_frames_are_overtaken() -> None:
    order = [frame[0] + 256 * frame[1] for _, frame in heard(LinkSpec(reorder=0.3))]
    assert sorted(order) == list(range(len(FRAMES)))
    assert sum(later < earlier for earlier, later in zip(order, order[1:], strict=False)) > 100


def test_the_same_seed_loses_the_same_frames() -> None:
    spec = LinkSpec(loss=0.3, jitter_s=1.0, duplicate=0.1, reorder=0.1)
    assert heard(spec, 7) == heard(spec, 7)
    assert heard(spec, 7) != heard(spec, 8)


def test_what_is_changed_on_the_way_arrives_changed() -> None:
    link = LossyLink(LinkSpec(), np.random.default_rng(1), 5.0, lambda data, generator: data[::-1])
    link.send(b"abc", 0.0)
    assert link.deliver(1.0) == [(0.1, b"cba")]
