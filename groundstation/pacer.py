"""Rate limit of the broadcast: a token bucket on a radio's budget, slowed down as that radio's buffer fills."""

from __future__ import annotations

from groundstation.radio import Radio

BURST_BYTES, BURST_S = 170.0, 0.03
"""Bytes that may pass at once beside one frame, or the time whose budget may, whichever is more.

So a shell that is late by 30 ms loses nothing. At 57600 baud more than half of a buffer of 1 KiB stays free, so that no
radio has cause to slow the broadcast down.
"""

TXBUF_VERY_LOW, TXBUF_LOW, TXBUF_HIGH, TXBUF_VERY_HIGH = 20, 50, 90, 95
"""Free shares of the radio's buffer, in percent, at which the rate changes: those of ArduPilot's own flow control."""
TXBUF_PERIOD_S = 1.0
"""Least time between two changes of the rate; radios report about once a second."""
_SLOWED_A_LOT, _SLOWED, _FASTER, _FASTER_A_LOT = 0.6, 0.85, 1.05, 1.25
"""Factors by which the rate changes below and above these shares."""
LEAST_PACE = 0.05
"""Least share of the budget that is used, so that a radio that always reports a full buffer is still sent something."""
_TOLERANCE = 1e-6
"""Tolerance for rounding, in seconds and in bytes."""


class Pacer:
    """A token bucket: over any time, no more bytes than rate times time plus one burst."""

    def __init__(self, bytes_per_s: float, burst_bytes: float) -> None:
        """Begin with a full bucket; no frame longer than `burst_bytes` can ever pass."""
        self._budget_bytes_per_s = bytes_per_s
        self._burst_bytes = burst_bytes
        self._tokens_bytes = burst_bytes
        self._filled_at_s: float | None = None
        self._heard_at_s: float | None = None
        self.pace = 1.0
        """Share of the budget that the radio's buffer allows, in [LEAST_PACE, 1]."""

    def take(self, count: int, now_s: float) -> bool:
        """Return whether `count` bytes may be sent now; if so, take them from the bucket."""
        self._fill(now_s)
        if count > self._tokens_bytes + _TOLERANCE:
            return False
        self._tokens_bytes -= count
        return True

    def wait_s(self, count: int, now_s: float) -> float:
        """Return the time from `now_s` until `count` bytes may be sent at the present pace."""
        self._fill(now_s)
        return max(0.0, count - self._tokens_bytes) / (self._budget_bytes_per_s * self.pace)

    def _fill(self, now_s: float) -> None:
        if self._filled_at_s is not None:
            gained = max(0.0, now_s - self._filled_at_s) * self._budget_bytes_per_s * self.pace
            self._tokens_bytes = min(self._burst_bytes, self._tokens_bytes + gained)
        self._filled_at_s = now_s

    def hear_txbuf(self, percent: int | None, now_s: float) -> None:
        """Change the pace by the free share of the radio's buffer; without a report (None) it recovers slowly."""
        if self._heard_at_s is not None and now_s - self._heard_at_s < TXBUF_PERIOD_S - _TOLERANCE:
            return
        self._heard_at_s = now_s
        if percent is None:
            factor = _FASTER
        elif percent < TXBUF_VERY_LOW:
            factor = _SLOWED_A_LOT
        elif percent < TXBUF_LOW:
            factor = _SLOWED
        elif percent > TXBUF_VERY_HIGH:
            factor = _FASTER_A_LOT
        elif percent > TXBUF_HIGH:
            factor = _FASTER
        else:
            factor = 1.0
        self.pace = min(1.0, max(LEAST_PACE, self.pace * factor))


def burst_bytes(radio: Radio) -> float:
    """Return the burst of a broadcast: the bytes that it may send beyond rate times time."""
    lateness_bytes = max(BURST_BYTES, BURST_S * radio.budget_bytes_per_s)
    return radio.max_frame_bytes + radio.outer_bytes + lateness_bytes
