"""The lossy broadcast link from the ground station to one vehicle: it loses, delays, repeats and reorders datagrams."""

from __future__ import annotations

import heapq
from collections.abc import Callable

import numpy as np

from companion.mission.model import LinkSpec

LINK_STREAM = 3
"""Number of the seed's random stream for links; each receiver has its own stream within it."""

Tamper = Callable[[bytes, np.random.Generator], bytes]
"""Function that returns a datagram as the receiver gets it, changed or not; for tests and measurements."""


class LossyLink:
    """One receiver's link. Deterministic: what arrives when follows from the generator and what was sent when."""

    def __init__(
        self,
        spec: LinkSpec,
        generator: np.random.Generator,
        hold_back_s: float,
        tamper: Tamper | None = None,
    ) -> None:
        """Begin without datagrams under way; a reordered one is late by up to `hold_back_s`, so that others pass it."""
        self._spec = spec
        self._generator = generator
        self._hold_back_s = hold_back_s
        self._tamper = tamper
        self._bad = False
        self._sent = 0
        self._under_way: list[tuple[float, int, bytes]] = []
        self.lost = 0

    def send(self, datagram: bytes, t_s: float) -> None:
        """Take a datagram from the sender at the time `t_s`, and lose it or schedule its arrival."""
        if self._loses():
            self.lost += 1
            return
        copies = 2 if self._generator.random() < self._spec.duplicate else 1
        for _ in range(copies):
            delay_s = self._spec.delay_s + self._generator.uniform(0.0, self._spec.jitter_s)
            if self._generator.random() < self._spec.reorder:
                delay_s += self._generator.uniform(0.0, self._hold_back_s)
            carried = datagram if self._tamper is None else self._tamper(datagram, self._generator)
            self._sent += 1
            heapq.heappush(self._under_way, (t_s + delay_s, self._sent, carried))

    def deliver(self, t_s: float) -> list[tuple[float, bytes]]:
        """Return the datagrams that have arrived since the last call and by `t_s`, each with its time of arrival."""
        arrived = []
        while self._under_way and self._under_way[0][0] <= t_s:
            arrival_s, _, datagram = heapq.heappop(self._under_way)
            arrived.append((arrival_s, datagram))
        return arrived

    def _loses(self) -> bool:
        if self._generator.random() < self._spec.loss:
            return True
        burst = self._spec.burst
        if burst is None:
            return False
        turn = burst.leave if self._bad else burst.enter
        if self._generator.random() < turn:
            self._bad = not self._bad
        return self._bad and bool(self._generator.random() < burst.loss)
