"""Why the broadcast is not believed, or less than it should be: each known cause in words, with its number.

Pure functions: from what came on the link within a window of time to the causes that explain it, and from the causes
told before and those seen now to the ones to tell, so that words neither flicker nor change with every figure.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from companion.errors import some_of
from companion.protocol.authenticator import (
    HEARTBEAT,
    NO_ED25519,
    OFF_THE_CLOCK,
    OTHER_MESSAGE,
    OTHER_SENDER,
    WRONG_ED25519,
    Trust,
)
from companion.protocol.believed import BEFORE_START
from companion.protocol.deframer import DAMAGED, FOREIGN, INCOMPLETE, JUNK, MAVLINK_1
from companion.protocol.freshness import OLD_EPOCH
from companion.protocol.mavlink_signing import UNSIGNED, WRONG_HASH
from companion.protocol.other_dialect import OtherDialect
from companion.transport.silence import Silence

AGENT = "agent"
"""Name of the cause that the broadcast does not tell of this vehicle's agent."""
CLOCKS = "clocks"
"""Name of the cause that the clocks differ."""
WINDOW_S = 10.0
"""Time over which what came is counted."""
LATE_S = 3.0
"""Least lateness of every frame that is a difference of clocks: the quickest frame of half a minute takes less."""
EARLY_S = 0.5
"""Time by which every frame is stamped ahead from which clocks differ."""
GPS_AHEAD_S = 18.0
"""GPS time is ahead of UTC by this, since 2017 (IERS Bulletin C)."""
GPS_NEAR_S = 1.5
"""How near a difference must be to GPS_AHEAD_S to be taken for it."""
HOUR_S = 3600.0
HOUR_NEAR_S = 60.0
"""How near a difference must be to whole hours to be taken for a time zone."""
UNSET_S = 300 * 86_400.0
"""Difference from which a clock was never set, rather than set wrong."""
END_S = 10.0
"""Time for which a cause must not have been seen before it is over, unless the broadcast is believed before."""
NEWS_SHARE = 0.25
"""Share by which a cause's number must have changed for its words to change."""
LEAST_FRAMES = 2
"""Least number of frames in a window that are evidence of a cause."""
MOST_NAMED = 8
"""Greatest number of the broadcast's agents that are named."""


class Cause(NamedTuple):
    """One cause: a name that stays the same, the number that it is told with, the words, and what to do."""

    name: str
    number: float
    words: str
    remedy: str
    stops: bool = True
    """Whether nothing of the broadcast is believed because of it."""
    begin_s: float = 3.0
    """Time for which it must be seen before it is told."""


@dataclass(frozen=True)
class Tally:
    """What came on the broadcast link since the program began."""

    accepted: int = 0
    refused: Mapping[str, int] | None = None
    """Refused frames, and runs of bytes that are none, by reason."""


@dataclass(frozen=True)
class Facts:
    """What is known beside the counts of a window."""

    trust: Trust
    accepted: int
    """Frames accepted within the window."""
    refused: Counter[str]
    """Frames refused within the window, by reason."""
    accepted_late_s: float | None = None
    """Least lateness of the frames accepted; None without one."""
    refused_late_s: float | None = None
    """The same of frames that are the ground station's and are refused by the clock alone."""
    other_late_s: float | None = None
    """The same of frames refused by the clock that anybody may have made."""
    dialect: OtherDialect | None = None
    signed_by: str | None = None
    """Signatures that the newest frame carries beyond those that are checked."""
    agents: tuple[int, tuple[int, ...]] | None = None
    """This vehicle's agent id and those that a whole broadcast tells of; None while none was heard whole."""
    period_s: float | None = None
    """Time between two broadcasts; None before two were heard."""
    coasting_after_s: float = math.inf
    silence: Silence = Silence("nothing arrives", "start the ground station")
    """What is to be said where nothing arrives at all."""


class Told(NamedTuple):
    """A cause that is seen, and since when; it is told from `told_s` on."""

    cause: Cause
    since_s: float
    seen_s: float
    is_told: bool = False


Causes = tuple[Told, ...]
"""The causes seen lately, the most important first."""


def causes_of(facts: Facts) -> list[Cause]:
    """Return the causes that explain what came, the most important first; none if there is nothing to explain."""
    found = _why_not_believed(facts) if facts.accepted == 0 else _why_less(facts)
    return [cause for cause in found if cause is not None]


def followed(before: Causes, seen: list[Cause], now_s: float, *, is_believed: bool = False) -> Causes:
    """Return the causes after a look at a time: one begins when it stays, and ends when it stays away.

    One for which nothing is believed ends at once when frames are accepted again (`is_believed`): it explains nothing
    any more.
    """
    old = {told.cause.name: told for told in before}
    after = [_again(old.get(cause.name), cause, now_s) for cause in seen]
    names = {cause.name for cause in seen}
    left = [told for told in before if told.cause.name not in names and told.is_told and now_s - told.seen_s < END_S]
    return (*after, *(told for told in left if not (is_believed and told.cause.stops)))


def news(before: Causes, after: Causes) -> list[str]:
    """Return the lines to print about a change of the causes told."""
    was = {told.cause.name: told.cause for told in before if told.is_told}
    now = {told.cause.name: told.cause for told in after if told.is_told}
    begun = [f"warning: {cause.words}: {cause.remedy}" for name, cause in now.items() if was.get(name) != cause]
    return [*begun, *(f"over: {cause.words}" for name, cause in was.items() if name not in now)]


def window_of(tallies: tuple[tuple[float, Tally], ...], newest: Tally) -> tuple[int, Counter[str]]:
    """Return how many frames were accepted, and refused by reason, since the first of some tallies."""
    first = tallies[0][1]
    return newest.accepted - first.accepted, Counter(newest.refused or {}) - Counter(first.refused or {})


def _again(told: Told | None, cause: Cause, now_s: float) -> Told:
    if told is None:
        return Told(cause, now_s, now_s, is_told=cause.begin_s <= 0.0)
    is_told = told.is_told or now_s - told.since_s >= cause.begin_s
    near = abs(cause.number - told.cause.number) <= NEWS_SHARE * abs(told.cause.number)
    near = near and cause.stops == told.cause.stops
    # While it is told the words stay, unless its number has become quite another one.
    return Told(told.cause if told.is_told and near else cause, told.since_s, now_s, is_told)


def _why_not_believed(facts: Facts) -> list[Cause | None]:
    refused = facts.refused
    off = sum(refused[reason] for reason in OFF_THE_CLOCK)
    if off and facts.refused_late_s is not None:
        return [_clocks(facts.refused_late_s)]
    counts = {reason: refused[reason] for reason in (*_WORDS, DAMAGED) if refused[reason]}
    counts |= {"clock": off} if off else {}
    if not counts:
        others = {reason: count for reason, count in refused.items() if count and reason != HEARTBEAT}
        if others:
            return [_refused_otherwise(max(others, key=lambda each: (others[each], each)), others)]
        only_heartbeats = refused[HEARTBEAT] > 0
        return [_heartbeats_only(refused[HEARTBEAT]) if only_heartbeats else _nothing(facts)]
    reason = max(counts, key=lambda each: (counts[each], each))
    if reason == "clock":
        return [_clocks_by_anybody(facts.other_late_s, off)]
    if reason in (DAMAGED, INCOMPLETE) and facts.dialect is not None:
        return [_dialect(facts.dialect, counts[reason])]
    words, remedy = _WORDS.get(reason, (_DAMAGED, _DAMAGED_REMEDY))
    count = counts[reason]
    text = words.format(count=count, within=f"{WINDOW_S:g} s", trust=facts.trust.words)
    return [Cause(reason, 1.0, text, remedy)]


def _why_less(facts: Facts) -> list[Cause | None]:
    late_s = facts.accepted_late_s
    differ = facts.trust.clock_checked and late_s is not None and not -EARLY_S < late_s < LATE_S
    return [
        _clocks(late_s, stops=False) if differ and late_s is not None else None,
        _two_stations(facts.refused[OLD_EPOCH]),
        _agent(facts),
        _seldom(facts),
        _needless_signature(facts),
    ]


def _clocks(late_s: float, *, stops: bool = True) -> Cause:
    """Return the cause that the clocks differ; a recording is late as well, but never early."""
    side = "ahead of" if late_s > 0 else "behind"
    most = abs(late_s)
    hours = round(most / HOUR_S)
    guess = ""
    if abs(most - GPS_AHEAD_S) <= GPS_NEAR_S:
        guess = " (GPS time is 18 s ahead of UTC: leap seconds)"
    elif most >= UNSET_S:
        guess = " (a clock that was never set)"
    elif 1 <= hours <= 14 and abs(most - hours * HOUR_S) <= HOUR_NEAR_S:
        guess = " (whole hours: local time taken for UTC)"
    recording = ", or a recording is played" if late_s > 0 and stops else ""
    return Cause(
        CLOCKS,
        late_s,
        f"clocks differ by {_seconds(most)}: this computer is {side} the ground station{guess}{recording}",
        "set the clocks of both from GNSS or NTP",
        stops,
    )


def _clocks_by_anybody(late_s: float | None, count: int) -> Cause:
    late = 0.0 if late_s is None else late_s
    by = "" if late_s is None else f" by {_seconds(abs(late))}: this computer is {'ahead' if late > 0 else 'behind'}"
    return Cause(
        "clocks by anybody",
        late,
        f"clocks may differ{by}, by {count} frames that nobody has signed for",
        "set the clocks of both from GNSS or NTP; if they are right the frames are an old recording",
    )


def _seconds(value: float) -> str:
    if value < 7200.0:
        return f"{value:.1f} s"
    return f"{value / HOUR_S:.1f} h" if value < 48 * HOUR_S else f"{value / 86_400.0:.1f} days"


def _dialect(other: OtherDialect, count: int) -> Cause:
    return Cause(
        "dialect",
        other.heard,
        f"{count} frames of another release's dialect: {other.name} with CRC_EXTRA {other.heard}, here {other.ours}",
        "old and new do not hear each other: install the same release on the ground and on the vehicle",
    )


def _heartbeats_only(count: int) -> Cause:
    return Cause(
        HEARTBEAT,
        1.0,
        f"only the ground station's heartbeats come, {count} in {WINDOW_S:g} s",
        "it has nothing to broadcast yet, or its frames are too long for this link",
        begin_s=10.0,
    )


def _refused_otherwise(reason: str, others: Mapping[str, int]) -> Cause:
    """Return the cause that all that comes is refused, for a reason that has no words of its own."""
    return Cause(
        "refused",
        1.0,
        f"all that comes is refused, most for '{reason}': {others[reason]} in {WINDOW_S:g} s",
        "an older run's frames, or a recording; a ground station of now is heard within 30 s of silence",
        begin_s=10.0,
    )


def _nothing(facts: Facts) -> Cause:
    return Cause("nothing", 0.0, *facts.silence, begin_s=10.0)


def _two_stations(count: int) -> Cause | None:
    if count < LEAST_FRAMES:
        return None
    return Cause(
        "two ground stations",
        1.0,
        f"two ground stations: {count} frames of an older run in {WINDOW_S:g} s beside the one believed",
        "stop one of them; each would command the vehicles whenever it is restarted",
        stops=False,
        begin_s=0.0,
    )


def _agent(facts: Facts) -> Cause | None:
    if facts.agents is None or facts.agents[0] in facts.agents[1]:
        return None
    own, told = facts.agents
    some = some_of(told, MOST_NAMED)
    return Cause(
        AGENT,
        own,
        f"agent {own} is not in the broadcast, which tells of {some or 'nobody'}",
        "set agent_id as the mission has it, or broadcast the mission with this vehicle",
        stops=False,
    )


def _seldom(facts: Facts) -> Cause | None:
    if facts.period_s is None or facts.period_s < facts.coasting_after_s:
        return None
    return Cause(
        "period",
        facts.period_s,
        f"the broadcast comes every {facts.period_s:.1f} s, staleness.coasting_after_s is {facts.coasting_after_s:g} s",
        "raise coasting_after_s above two periods, or broadcast more often",
        stops=False,
    )


def _needless_signature(facts: Facts) -> Cause | None:
    if facts.signed_by is None:
        return None
    return Cause(
        "needless signature",
        1.0,
        f"the broadcast is signed ({facts.signed_by}), broadcast.trust is {facts.trust.words}: anybody is believed",
        "give this vehicle the keys and set broadcast.trust",
        stops=False,
        begin_s=0.0,
    )


_DAMAGED = "{count} runs of damaged bytes in {within} and no whole frame"
_DAMAGED_REMEDY = "look at the radio, its rate and the cable"
_KEYS = "copy the keys of `groundstation keygen` that the ground station uses"
_WORDS: dict[str, tuple[str, str]] = {
    UNSIGNED: (
        "{count} frames without MAVLink signature in {within}, trust is {trust}",
        "start the ground station with its keys, or set broadcast.trust to what it signs",
    ),
    NO_ED25519: (
        "{count} frames without Ed25519 signature in {within}, trust is {trust}",
        "start the ground station with its private key, or set broadcast.trust to what it signs",
    ),
    WRONG_HASH: (
        "wrong key: {count} frames in {within} with another MAVLink key than broadcast.mavlink_key",
        f"{_KEYS}; or it is another fleet's broadcast",
    ),
    WRONG_ED25519: (
        "wrong key: {count} frames in {within} of another private key than broadcast.public_key's",
        f"{_KEYS}; or it is another fleet's broadcast",
    ),
    OLD_EPOCH: (
        "{count} frames of an older run than the one believed last in {within}",
        "restart the ground station with its --state, its clock right",
    ),
    BEFORE_START: (
        "{count} frames in {within} that were sent before this program's start",
        "wait for the next broadcast; if it goes on, the ground station's clock is behind",
    ),
    OTHER_SENDER: ("{count} frames in {within} of other senders than the ground station", "look at the link's port"),
    OTHER_MESSAGE: ("{count} frames in {within} that are no broadcast", "look at the link's port"),
    FOREIGN: (
        "{count} messages of other dialects in {within}, none of the broadcast",
        "this port has an autopilot's or another program's traffic: look at broadcast.link",
    ),
    MAVLINK_1: ("{count} frames of MAVLink 1 in {within}, none of the broadcast", "look at broadcast.link's port"),
    JUNK: ("{count} runs of bytes in {within} that are no MAVLink", "look at the link's port, or the baud rate"),
    INCOMPLETE: (_DAMAGED, _DAMAGED_REMEDY),
}
"""Words and remedy by the reason for which most frames are refused while none is accepted."""
