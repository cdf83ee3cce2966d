"""The settings of Hypothesis that all tests share, and the number of processes that run them."""

from __future__ import annotations

import os

from hypothesis import settings

# No deadline: an example that takes longer than Hypothesis' 200 ms shows a busy machine, not a fault of the code.
settings.register_profile("oneway", deadline=None)
settings.load_profile("oneway")


def pytest_xdist_auto_num_workers() -> int:
    """Return the number of processes of `pytest -n auto`: one more than cores, as those with real programs wait."""
    return len(os.sched_getaffinity(0)) + 1
