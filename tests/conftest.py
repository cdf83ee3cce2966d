"""What all tests share: how Hypothesis draws its examples."""

from __future__ import annotations

from hypothesis import settings

# An example that takes longer than Hypothesis' 200 ms says that the machine is busy, and nothing about the code.
settings.register_profile("oneway", deadline=None)
settings.load_profile("oneway")
