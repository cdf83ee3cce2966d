"""Messages to the operator about the broadcast: how well it is heard, and which ground station sends it."""

from __future__ import annotations

import math
from collections import Counter

from companion.onboard.broadcast_causes import CauseWatch
from companion.onboard.companion import Companion
from companion.onboard.config import ONE_RADIO
from companion.protocol.authenticator import EXPECTED
from companion.protocol.link_quality import LinkQuality, Warnings
from companion.transport.endpoints import parse_link

STATUS_PERIOD_S = 60.0
"""Time between two messages about the state of the broadcast link."""


class BroadcastMonitor:
    """Notices changes in how well the broadcast is heard and why, and a restarted ground station."""

    def __init__(self, companion: Companion) -> None:
        self._companion = companion
        self._warnings = Warnings()
        self._causes = _cause_watch(companion)
        self._epoch_s: int | None = None
        self._any_refused = False
        """Whether, by the last call, any frame not EXPECTED had been refused."""
        self._status_at_s = -math.inf

    def news(self, now_s: float) -> list[str]:
        """Return the messages that are new since the last call, one line each."""
        refused = self._companion.authenticator.rejected
        quality = self._companion.link_monitor.quality(now_s)
        companion = self._companion
        lines = [*self._takeover(), *self._causes.news(companion.world_model, companion.link_monitor, now_s)]
        warning = self._warnings.update(quality)
        if warning is not None:
            lines.append(warning)
        if self._status_is_due(refused, now_s):
            lines.append(self._status(refused, quality))
        return lines

    @property
    def stopped_by(self) -> str | None:
        """The cause for which nothing of the broadcast is believed, in words; None without one."""
        cause = self._causes.stopping
        return None if cause is None else cause.words

    def _takeover(self) -> list[str]:
        before_s, self._epoch_s = self._epoch_s, self._companion.world_model.order.epoch_s
        if before_s is None or before_s == self._epoch_s:
            return []
        return [f"another run of a ground station took over (epoch {self._epoch_s})"]

    def _status_is_due(self, refused: Counter[str], now_s: float) -> bool:
        any_before = self._any_refused
        self._any_refused = any(refused[reason] for reason in refused.keys() - set(EXPECTED))
        is_first = self._any_refused and not any_before
        if not is_first and now_s - self._status_at_s < STATUS_PERIOD_S:
            return False
        self._status_at_s = now_s
        return True

    def _status(self, refused: Counter[str], quality: LinkQuality) -> str:
        trust = self._companion.authenticator.trust
        unexpected = [(count, reason) for reason, count in refused.most_common() if reason not in EXPECTED]
        reasons = ", ".join(f"{count} {reason}" for count, reason in unexpected)
        ages = ", ".join(f"{kind} {age_s:.1f} s" for kind, age_s in quality.ages_s.items())
        return (
            f"broadcast ({trust.words}): {quality.share:.0%} of its frames heard, "
            f"age of {ages or 'nothing'}; refused: {reasons or 'none'}"
        )


def _cause_watch(companion: Companion) -> CauseWatch:
    section, coasting_after_s = companion.config.broadcast, companion.config.staleness.coasting_after_s
    link = None if section is None or section.link == ONE_RADIO else parse_link(section.link)
    return CauseWatch(companion.authenticator, link, coasting_after_s)
