"""The ground station's transmitter in a flight: it counts and logs the broadcast, and wraps it where required."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from companion.files.tlog import TlogWriter
from companion.protocol.v2_extension import wrap
from groundstation.schedule import Broadcaster
from sim.loop import START_S

RADIO_TICK_S = 0.05
"""Time between two calls of the broadcaster, as in the ground station's program."""


class Transmitter:
    """Sends the frames of a broadcaster, at the times at which its radio's budget allows them."""

    def __init__(
        self,
        broadcaster: Broadcaster,
        period_s: float = RADIO_TICK_S,
        wraps: bool = False,
        log: TlogWriter | None = None,
    ) -> None:
        """Let each `transmit` cover `period_s` from its time on; with `wraps` send every frame inside V2_EXTENSION."""
        self._broadcaster = broadcaster
        # A radio's frames leave one after the other within a tick, not all at its beginning.
        self._ticks_s = np.arange(0.0, period_s, RADIO_TICK_S)
        self._wraps = wraps
        self._log = log
        self.frames = 0
        self.bytes = 0

    def transmit(self, t_s: float) -> Iterator[tuple[float, bytes]]:
        """Yield the datagrams that are sent from a time of the flight on, each with its time."""
        for at_s in t_s + self._ticks_s:
            for sent in self._broadcaster.tick(START_S + at_s):
                datagram = wrap(sent, self.frames) if self._wraps else sent
                self.frames += 1
                self.bytes += len(datagram)
                if self._log is not None:
                    self._log.write(START_S + at_s, datagram)
                yield at_s, datagram
