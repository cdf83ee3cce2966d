"""The values that go into the guard."""

from __future__ import annotations

from companion.guard.types import Motion


def test_a_motion_says_where_it_is() -> None:
    assert Motion(3.0, 4.0, 0.1, 20.0).position_ned_m == (3.0, 4.0)
