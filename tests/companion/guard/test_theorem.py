"""The theorem: a certified start never ends inside a disc or outside the fence."""

from __future__ import annotations

import pytest

from tests.companion.guard.guard_flight import (
    WORLDS,
    World,
    flown_against,
)


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS.keys())
def test_a_certified_start_never_enters_whatever_the_adversary_wants(world: World) -> None:
    flights = [flown_against(world, seed, steps=100) for seed in range(3)]
    assert sum(steps for _, steps, _ in flights) >= 200
    assert sum(refused for refused, _, _ in flights) >= 10, "the adversary never tried"
