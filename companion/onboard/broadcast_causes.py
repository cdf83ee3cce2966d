"""Watches the broadcast link for the causes of what is not believed; see causes.py for what they are."""

from __future__ import annotations

import math

from companion.onboard.causes import WINDOW_S, Cause, Causes, Facts, Tally, causes_of, followed, news, window_of
from companion.onboard.world_model import WorldModel
from companion.protocol.authenticator import Authenticator
from companion.protocol.deframer import DAMAGED, INCOMPLETE
from companion.protocol.frame import RawFrame
from companion.protocol.link_quality import LinkMonitor
from companion.protocol.other_dialect import OtherDialect, other_dialect
from companion.transport.link import Link
from companion.transport.silence import Silence, why_silent

LOOK_S = 1.0
"""Time between two looks."""
TALLIES = 5
"""Number of tallies kept: one every WINDOW_S / TALLIES."""
ONE_RADIO_SILENCE = Silence(
    "no V2_EXTENSION with the broadcast comes through the autopilot",
    "look at the ground station's link and whether the autopilot forwards V2_EXTENSION to this port",
)


class CauseWatch:
    """Follows the causes of one broadcast link; the caller gives the times, Unix seconds by this vehicle's clock."""

    def __init__(self, authenticator: Authenticator, link: Link | None, coasting_after_s: float = math.inf) -> None:
        """Watch what an authenticator accepts and refuses; `link`: None where the broadcast comes by the autopilot."""
        self.causes: Causes = ()
        self._authenticator = authenticator
        self._link = link
        self._coasting_after_s = coasting_after_s
        self._tallies: tuple[tuple[float, Tally], ...] = ((-math.inf, Tally()),)
        """Counts with their times; the first is that of the window's beginning."""
        self._looked_s = -math.inf
        self._dialect: tuple[OtherDialect | None, int] = (None, 0)
        """The other dialect that the last look suspected, and how often in a row."""

    def news(self, world: WorldModel, quality: LinkMonitor, now_s: float) -> list[str]:
        """Return the lines to print about causes that began or ended since the last call."""
        if 0.0 <= now_s - self._looked_s < LOOK_S:
            return []
        self._looked_s = now_s
        accepted, _ = window_of(self._tallies, Tally(self._authenticator.accepted, self._authenticator.rejected))
        before, seen = self.causes, self.seen(world, quality, now_s)
        self.causes = followed(before, seen, now_s, is_believed=accepted > 0)
        self._keep(now_s)
        return news(before, self.causes)

    @property
    def stopping(self) -> Cause | None:
        """The first cause told for which nothing of the broadcast is believed; None without one."""
        return next((told.cause for told in self.causes if told.is_told and told.cause.stops), None)

    def seen(self, world: WorldModel, quality: LinkMonitor, now_s: float) -> list[Cause]:
        """Return the causes that explain what came within the window, without waiting whether they stay."""
        gate = self._authenticator
        accepted, refused = window_of(self._tallies, Tally(gate.accepted, gate.rejected))
        self._suspect_dialect(accepted == 0 and refused[DAMAGED] + refused[INCOMPLETE] > 0)
        told = world.agents_told
        facts = Facts(
            trust=gate.trust,
            accepted=accepted,
            refused=refused,
            accepted_late_s=gate.lateness.accepted.least_s(now_s),
            refused_late_s=gate.lateness.refused.least_s(now_s),
            other_late_s=gate.lateness.other.least_s(now_s),
            dialect=self._dialect[0] if self._dialect[1] > 1 else None,
            signed_by=None if gate.trust.keyed or gate.newest is None else signed_by(gate.newest),
            agents=None if told is None else (world.agent_id, told),
            period_s=quality.period_s,
            coasting_after_s=self._coasting_after_s,
            silence=ONE_RADIO_SILENCE if self._link is None or accepted or refused else why_silent(self._link),
        )
        return causes_of(facts)

    def _suspect_dialect(self, is_damaged: bool) -> None:
        found = other_dialect(self._authenticator.sample) if is_damaged else None
        before, times = self._dialect
        if found is not None:
            self._dialect = (found, times + 1 if found == before else 1)
        elif not is_damaged:
            self._dialect = (None, 0)

    def _keep(self, now_s: float) -> None:
        """Keep a tally for the window, and forget those from before it."""
        if now_s - self._tallies[-1][0] < WINDOW_S / TALLIES:
            return
        kept = [*self._tallies, (now_s, Tally(self._authenticator.accepted, self._authenticator.rejected))]
        while now_s - kept[1][0] >= WINDOW_S:
            del kept[0]
        self._tallies = tuple(kept)


def signed_by(raw: RawFrame) -> str | None:
    """Return which signatures a frame of the broadcast carries, in words; None if it carries none."""
    names = []
    if raw.is_signed:
        names.append("MAVLink signing")
    if raw.payload_length > raw.content_length:
        names.append("Ed25519")
    return " and ".join(names) or None
