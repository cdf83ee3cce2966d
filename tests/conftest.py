"""The settings of Hypothesis that all tests share."""

from __future__ import annotations

from hypothesis import settings

# No deadline: an example that takes longer than Hypothesis' 200 ms shows a busy machine, not a fault of the code.
settings.register_profile("oneway", deadline=None)
settings.load_profile("oneway")
