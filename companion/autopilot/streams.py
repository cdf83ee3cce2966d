"""What the autopilot was asked to send, what of it arrives, and when it is asked again.

Other programs share the autopilot, and each may change the rate of any message (a ground station's REQUEST_DATA_STREAM,
another SET_MESSAGE_INTERVAL); a slow radio lowers them all. So each message is measured for as long as the autopilot is
heard. What safety rests on and arrives too seldom is said; whatever does is asked for again, less and less often, so
that two programs that want different rates do not fill a radio with their requests.

Only SET_MESSAGE_INTERVAL asks: every ArduPilot from 4.0 and PX4 from 1.9 on has it (docs/autopilots.md).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from pymavlink.dialects.v20 import ardupilotmega

WINDOW_S = 3.0
"""Time over which the rate of a frequent message is measured."""
WINDOW_PERIODS = 5.0
"""Number of the asked periods over which the rate of a rare message is measured at least."""
SETTLING_S = 2.0
"""Time after the autopilot is first heard, or heard after a restart, before the measuring begins: the questions go out
one after the other."""
LEAST_SHARE = 0.4
"""Share of the asked rate below which a message arrives too seldom. Chosen: a lossy radio delivers more, and what
lowers a rate on purpose lowers it to less."""
LINK_DEAD_S = 3.5
"""Time without any message of the autopilot after which the link counts as dead: then no single message is missed."""
FIRST_WAIT_S = 3.0
"""Time between the first two times that a message is asked for again; each further one is twice as long."""
LONGEST_WAIT_S = 60.0
"""Longest time between two times that a message is asked for again."""
SPARSE_AGAIN_S = 30.0
"""Time after which a sparse message, once it came, is asked for again: perhaps there is only nothing to tell."""
RESTS_ON: Mapping[int, str] = {
    ardupilotmega.MAVLINK_MSG_ID_HEARTBEAT: "mode and arming",
    ardupilotmega.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: "the position",
    ardupilotmega.MAVLINK_MSG_ID_SYS_STATUS: "the battery",
    ardupilotmega.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: "whether it flies",
    ardupilotmega.MAVLINK_MSG_ID_GPS_RAW_INT: "the fix",
    ardupilotmega.MAVLINK_MSG_ID_HOME_POSITION: "home",
    ardupilotmega.MAVLINK_MSG_ID_EKF_STATUS_REPORT: "the estimate",
    ardupilotmega.MAVLINK_MSG_ID_ESTIMATOR_STATUS: "the estimate",
}
"""What safety rests on, by the message that tells it; a kind may have more (`LinkedAdapter.rests_on`)."""
SPARSE = frozenset({ardupilotmega.MAVLINK_MSG_ID_ADSB_VEHICLE})
"""Messages that come only while there is something to tell, so that none of them is no sign."""
IF_ANY = frozenset({ardupilotmega.MAVLINK_MSG_ID_GPS2_RAW, ardupilotmega.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN})
"""Messages of what not every vehicle has, a second receiver or a local frame: they are missed once they have come."""
UNASKED = frozenset({ardupilotmega.MAVLINK_MSG_ID_HEARTBEAT})
"""Messages that every autopilot sends by itself, so that they are asked for only when they come too seldom."""
STOPPED_PERIODS = 6.0
"""Number of the asked periods without a message after which it is asked for again, before its rate is measured."""
WITHIN_AGE = 3.0
"""Number of messages that must come within the age beyond which one is not steered by: two in a row may be lost."""
SAID_AT_ONCE = 3
"""Greatest number of shortfalls named in one line."""


class Shortfall(NamedTuple):
    """A message that arrives much more seldom than it was asked for."""

    message_id: int
    rate_hz: float
    """The rate at which it arrives; 0 if it does not."""
    asked_hz: float
    rests_on: str | None
    """What safety rests on it, in words; None if nothing does."""

    def __str__(self) -> str:
        """Return the message with both rates: "GLOBAL_POSITION_INT 1.0 Hz of 10 asked"."""
        rate = f"{self.rate_hz:.1f}" if self.rate_hz else "0"
        return f"{message_name(self.message_id)} {rate} Hz of {self.asked_hz:g} asked"


class _Asked(NamedTuple):
    at_s: float
    wait_s: float


class StreamWatch:
    """Measures the messages of one autopilot. Times are the caller's, in seconds of one clock.

    What it tells depends on what arrived, and when, alone: a recording tells the same again.
    """

    def __init__(self, asked_hz: Mapping[int, float], rests_on: Mapping[int, str] = RESTS_ON) -> None:
        """Watch messages for the rates that are asked for, by message id; `rests_on`: as `RESTS_ON`."""
        self._asked_hz = dict(asked_hz)
        self._rests_on = rests_on
        self._windows_s = {one: max(WINDOW_S, WINDOW_PERIODS / hz) for one, hz in asked_hz.items()}
        # As many as make a message frequent enough: of one that is not, all within the window are kept.
        self._arrived_s: dict[int, deque[float]] = {
            one: deque(maxlen=math.ceil(LEAST_SHARE * hz * self._windows_s[one]))
            for one, hz in asked_hz.items()
            if one not in SPARSE
        }
        self._began_s, self._newest_s = math.inf, -math.inf
        """Since when is measured, and when the newest message of any kind came."""
        self._last: dict[int, _Asked] = {}

    @property
    def asked_hz(self) -> Mapping[int, float]:
        """The rates that are asked for, by message id."""
        return self._asked_hz

    def begin(self, now_s: float) -> None:
        """Begin anew: the autopilot is first heard, or has restarted, and knows nothing of what it was asked."""
        self._measure_anew(now_s)
        self._last = {one: _Asked(now_s, FIRST_WAIT_S) for one in UNASKED}

    def arrived(self, message_id: int, now_s: float) -> None:
        """Count a message of the autopilot; of one that was not asked for, only that the link is alive."""
        if now_s - self._newest_s > LINK_DEAD_S:
            # What was not heard in a gap of the link may have been sent.
            self._measure_anew(now_s)
        self._newest_s = now_s
        arrived_s = self._arrived_s.get(message_id)
        if arrived_s is not None:
            arrived_s.append(now_s)

    def due(self, now_s: float, seen_s: float = -math.inf) -> list[int]:
        """Return the ids of the messages to ask for now; they count as asked.

        `seen_s`: when the newest sparse message came; -inf if none did.
        """
        due = []
        for message_id in self._asked_hz:
            last = self._last.get(message_id)
            if last is None:
                self._last[message_id] = _Asked(now_s, FIRST_WAIT_S)
            elif message_id in SPARSE:
                if math.isinf(seen_s) or now_s - max(last.at_s, seen_s) < SPARSE_AGAIN_S:
                    continue
                self._last[message_id] = last._replace(at_s=now_s)
            elif now_s - last.at_s < last.wait_s:
                continue
            elif self._stopped(message_id, now_s) or self.shortfall(message_id, now_s) is not None:
                self._last[message_id] = _Asked(now_s, min(2.0 * last.wait_s, LONGEST_WAIT_S))
            else:
                if now_s - last.at_s >= LONGEST_WAIT_S and last.wait_s > FIRST_WAIT_S:
                    self._last[message_id] = last._replace(wait_s=FIRST_WAIT_S)
                continue
            due.append(message_id)
        return due

    def shortfall(self, message_id: int, now_s: float) -> Shortfall | None:
        """Return how far a message is behind its rate.

        None if it is not, if it was not measured for long enough, or if the whole link is dead.
        """
        window_s, arrived_s = self._windows_s.get(message_id, 0.0), self._arrived_s.get(message_id)
        if arrived_s is None or now_s - self._began_s < SETTLING_S + window_s or now_s - self._newest_s > LINK_DEAD_S:
            return None
        if message_id in IF_ANY and not arrived_s:
            return None
        since_s = now_s - window_s
        if len(arrived_s) == arrived_s.maxlen and arrived_s[0] > since_s:
            return None
        rate_hz = _rate_hz([at_s for at_s in arrived_s if at_s > since_s], window_s, now_s)
        return Shortfall(message_id, rate_hz, self._asked_hz[message_id], self._rests_on.get(message_id))

    def arrives(self, message_id: int) -> bool:
        """Return whether a message was measured, and came as it was asked for when the newest one came."""
        window_s = self._windows_s.get(message_id, math.inf)
        measured = self._newest_s - self._began_s >= SETTLING_S + window_s
        return measured and message_id not in SPARSE and self.shortfall(message_id, self._newest_s) is None

    def shortfalls(self, now_s: float) -> tuple[Shortfall, ...]:
        """Return every message that arrives too seldom and that safety rests on."""
        if now_s - self._began_s < SETTLING_S:
            return ()
        found = (self.shortfall(message_id, now_s) for message_id in self._arrived_s if message_id in self._rests_on)
        return tuple(one for one in found if one is not None)

    def too_seldom(self, ages_s: Mapping[int, float], now_s: float) -> str | None:
        """Return which message comes too seldom to steer by, with its rates; None if none does.

        `ages_s`: the age beyond which a message is not steered by, by its id. Where that age comes and goes, so would
        the steering.
        """
        for message_id, age_s in ages_s.items():
            short = self.shortfall(message_id, now_s)
            if short is not None and short.rate_hz < (needed_hz := least_hz(short.asked_hz, age_s)):
                return f"{short}, {needed_hz:.2g} needed"
        return None

    def measured(self, now_s: float, within_s: float) -> bool:
        """Return whether every message whose measuring takes at most `within_s` has been measured."""
        longest_s = max((one for one in self._windows_s.values() if one <= within_s), default=0.0)
        return not self._windows_s or now_s - self._began_s >= SETTLING_S + longest_s

    def _measure_anew(self, now_s: float) -> None:
        self._began_s = now_s
        for arrived_s in self._arrived_s.values():
            arrived_s.clear()

    def _stopped(self, message_id: int, now_s: float) -> bool:
        """Return whether a message that came does so no more, while others do."""
        arrived_s = self._arrived_s[message_id]
        if not arrived_s or now_s - self._began_s < SETTLING_S:
            return False
        return self._newest_s - arrived_s[-1] > STOPPED_PERIODS / self._asked_hz[message_id]


def least_hz(asked_hz: float, age_s: float) -> float:
    """Return the least rate to steer by of a message that may be `age_s` old and is asked for `asked_hz` times."""
    return min(WITHIN_AGE / age_s, LEAST_SHARE * asked_hz)


def message_name(message_id: int) -> str:
    """Return the name of a message of ArduPilot's dialect, which has all of `common`; its number if it has none."""
    message = ardupilotmega.mavlink_map.get(message_id)
    return f"message {message_id}" if message is None else str(message.msgname)


def in_words(shortfalls: Iterable[Shortfall], said: Iterable[str] = ()) -> str | None:
    """Return shortfalls in one line, the first SAID_AT_ONCE by name; None if there are none but those in `said`."""
    words = [str(one) for one in shortfalls]
    words = [one for one in words if not any(one in line for line in said)]
    if len(words) > SAID_AT_ONCE:
        words = [*words[:SAID_AT_ONCE], f"{len(words) - SAID_AT_ONCE} more"]
    return ", ".join(words) or None


def _rate_hz(arrived_s: list[float], window_s: float, now_s: float) -> float:
    """Return the rate of messages that came within the window: by their distance, or if they stopped by their count."""
    if len(arrived_s) >= 2:
        period_s = (arrived_s[-1] - arrived_s[0]) / (len(arrived_s) - 1)
        if 0.0 < period_s and now_s - arrived_s[-1] <= 1.5 * period_s:
            return 1.0 / period_s
    return len(arrived_s) / window_s
