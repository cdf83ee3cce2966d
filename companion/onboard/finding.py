"""The result of one check of `companion check`."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """The result of one check: whether it passed, what was found, and what to do if it did not pass."""

    passed: bool
    text: str
    remedy: str = ""
    warns: bool = False
    """Whether it passed, but a person should know of it, and of the remedy."""
    sets: tuple[tuple[str, float], ...] = ()
    """Names and values of the autopilot's parameters that make it pass, as this vehicle's firmware has them."""

    @property
    def word(self) -> str:
        """The result in a word: pass, warn or FAIL."""
        return "FAIL" if not self.passed else "warn" if self.warns else "pass"


def warning(text: str, remedy: str = "") -> Finding:
    """Return a finding that passed and that a person should know of."""
    return Finding(True, text, remedy, warns=True)
