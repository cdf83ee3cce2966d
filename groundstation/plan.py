"""Plan of a mission's broadcast over a given radio, made by running the real broadcaster on a virtual clock.

No agent, target or threat moves in that run. The frames sent determine when agents that are switched on at any moment
know all that they need: exactly for independent losses, by drawn receivers for losses in bursts.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TypeVar

import numpy as np
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from companion.mission.model import Mission, agent_height_m
from companion.mission.random_streams import random_stream
from companion.protocol.ed25519 import FrameSigner
from companion.protocol.mavlink_signing import KEY_BYTES, MavlinkSigner
from companion.protocol.messages import (
    BandsFrame,
    Directive,
    FleetFrame,
    MissionFrame,
    MotionFrame,
    RadiiFrame,
    StateFrame,
)
from groundstation.choices import Authentication
from groundstation.ground_station import GroundStation
from groundstation.radio import Radio
from groundstation.schedule import SHORTEST_REFRESH_S, TICK_S, Broadcaster, BroadcastFrame, Sent

LOSSES = (0.0, 0.1, 0.3, 0.5)
"""Shares of frames lost independently for which the plan is computed."""
CURRENT_SHARE = 0.999
"""Share of the agents that must know all that they need."""
RECEIVERS = 20_000
"""Number of receivers drawn for losses in bursts."""

_START_S = 1_790_000_000.0
_MOMENTS = 1_000
"""Number of moments at which agents are switched on: evenly over _INTERVALS intervals of the rarest needed frame, or
over _LEAST_SPAN_S if that is longer."""
_INTERVALS = 5.0
_LEAST_SPAN_S = 40.0
_RESOLUTION_S = 0.01
_FIRST_HORIZON_S = 120.0
_LONGEST_SPELL_S = 20.0
"""Length that a bad spell of BURSTS exceeds with a probability of 1 in 22 000."""
_LONGEST_S = 4_000.0
"""Greatest time over which the broadcaster is run."""
_SEED, _STREAM = 1, 50
"""Seed and random stream from which the receivers are drawn."""


@dataclass(frozen=True)
class Bursts:
    """Gilbert-Elliott loss model in time: good and bad spells, both of exponentially distributed length."""

    good_s: float
    """Mean length of a good spell."""
    bad_s: float
    """Mean length of a bad spell."""
    good_loss: float
    """Share of frames lost in a good spell."""
    bad_loss: float
    """Share of frames lost in a bad spell."""


BURSTS = Bursts(good_s=10.0, bad_s=2.0, good_loss=0.05, bad_loss=1.0)
"""Losses as from banking or a ridge in between: 2 s in every 12 s on average, and one frame in twenty otherwise."""

Part = tuple[str, int]
"""Name of an item and index of one of its frames; to receive any sending of that frame is enough."""
Progress = Callable[[float], None]
"""Callback that takes the share of the work done."""


@dataclass(frozen=True)
class Item:
    """One kind of frame in the plan."""

    name: str
    frames: int
    """Number of frames in one refresh of the state or turn of the carousel."""
    bytes_per_s: float
    interval_s: float | None
    """Mean time between two refreshes or turns; None: longer than the plan looks ahead."""
    copies: float
    """Mean number of times that a frame is repeated within the interval."""


@dataclass(frozen=True)
class Outage:
    """Longest loss of the broadcast without an entry into any R_d (docs/method.md section 3)."""

    limit_s: float | None
    """Length of that loss; None: no limit, as the threats stand still."""
    clearance_m: float | None
    """Clearance from the threat that sets the limit."""
    why: str


@dataclass(frozen=True)
class Plan:
    """Figures of a mission's broadcast over a radio."""

    mission: str
    radio: str
    share: float
    budget_bytes_per_s: float
    authentication: Authentication
    items: tuple[Item, ...]
    refresh_s: float
    """Mean time between two broadcasts of the whole state."""
    bytes_per_s: float
    utilisation: float
    """Share of the budget that is used."""
    largest_frame_bytes: int
    """Length of the longest frame on the air."""
    current_after_s: dict[str, float | None]
    """Time until 99.9 % of agents, switched on at any moment, know all that they need, by the share of frames lost;
    None: longer than the plan looks ahead."""
    outage: Outage
    left_out: tuple[str, ...]
    """Descriptions of what does not fit, or is sent less often than without a limit."""

    def to_dict(self) -> dict[str, object]:
        """Return the plan as plain values, for JSON."""
        return asdict(self)


def plan(
    mission: Mission, radio: Radio, authentication: Authentication, progress: Progress = lambda share: None
) -> Plan:
    """Return the plan for a resolved mission.

    Raises:
        InputError: the mission does not fit the radio, or cannot be broadcast.

    """
    broadcaster = Broadcaster(_Standing(mission, _START_S), radio, _frame_signer(authentication))
    sent: list[tuple[float, Sent]] = []
    ticks, horizon_s = 0, _FIRST_HORIZON_S
    while True:
        while ticks * TICK_S < horizon_s:
            sent += [(ticks * TICK_S, one) for one in broadcaster.step(_START_S + ticks * TICK_S)]
            ticks += 1
        air = Air.of(sent, horizon_s)
        slowest_s = air.current_after_s(max(LOSSES))
        progress(0.5 * horizon_s / (horizon_s + _FIRST_HORIZON_S))
        # At the greatest independent loss it takes longer than in bursts, in which half as much is lost.
        far = slowest_s is not None and horizon_s >= air.switched_on_s[-1] + slowest_s + _LONGEST_SPELL_S
        if far or horizon_s >= _LONGEST_S:
            break
        horizon_s *= 2.0
    current_after_s = {f"{loss:.0%}": air.current_after_s(loss) for loss in LOSSES}
    current_after_s["bursts"] = air.current_after_bursts_s(BURSTS, lambda share: progress(0.5 + 0.5 * share))
    items = _items([(at_s, one) for at_s, one in sent if at_s >= air.switched_on_s[0]])
    state = next(item for item in items if item.name in _STATES)
    # Otherwise the broadcaster would have refused: the state is sent at least every LONGEST_REFRESH_S.
    assert state.interval_s is not None
    bytes_per_s = sum(item.bytes_per_s for item in items)
    return Plan(
        mission=mission.name,
        radio=radio.name,
        share=radio.share,
        budget_bytes_per_s=radio.budget_bytes_per_s,
        authentication=authentication,
        items=items,
        refresh_s=state.interval_s,
        bytes_per_s=bytes_per_s,
        utilisation=bytes_per_s / radio.budget_bytes_per_s,
        largest_frame_bytes=max(one.on_air_bytes for _, one in sent),
        current_after_s=current_after_s,
        outage=outage_limit(mission),
        left_out=_left_out(items, state, radio),
    )


def outage_limit(mission: Mission) -> Outage:
    """Return the longest loss of a resolved mission's broadcast without an entry: clearance over speed bound.

    It is the least over all threats that may move; the clearance is that of the nearest start or target from the
    detection disc. Threats that reach no agent's altitude do not count.
    """
    least: Outage | None = None
    points = [(f"the start of agent {agent.id}", agent.position_ned_m) for agent in mission.agents]
    points += [(f"target {target.id}", target.position_ned_m) for target in mission.targets]
    levels_m = {mission.origin.alt_m + agent_height_m(mission, agent.id) for agent in mission.agents}
    for threat in mission.threats:
        floor_m = -math.inf if threat.floor_m is None else threat.floor_m
        ceiling_m = math.inf if threat.ceiling_m is None else threat.ceiling_m
        if threat.speed_bound_m_s == 0.0 or not any(floor_m <= level_m <= ceiling_m for level_m in levels_m):
            continue
        where, point = min(points, key=lambda named: math.dist(named[1], threat.position_ned_m))
        clearance_m = max(0.0, math.dist(point, threat.position_ned_m) - threat.detection_radius_m)
        limit_s = clearance_m / threat.speed_bound_m_s
        if least is None or least.limit_s is None or limit_s < least.limit_s:
            why = f"{where} is {clearance_m:.0f} m clear of threat {threat.id}, at most {threat.speed_bound_m_s:g} m/s"
            least = Outage(limit_s, clearance_m, why)
    return least or Outage(None, None, "threats stand still")


_STATES = ("ONEWAY_STATE", "ONEWAY_FLEET")
_NAMES: dict[type[BroadcastFrame], str] = {
    StateFrame: "ONEWAY_STATE",
    FleetFrame: "ONEWAY_FLEET",
    RadiiFrame: "ONEWAY_RADII",
    MissionFrame: "ONEWAY_MISSION",
    MotionFrame: "ONEWAY_MOTION",
    BandsFrame: "ONEWAY_BANDS",
}
_HEARTBEAT = "HEARTBEAT"
_HEARTBEAT_PART: Part = (_HEARTBEAT, 0)
_AS_GOOD_AS = 1.05


FrameT = TypeVar("FrameT", bound=BroadcastFrame)


class _Standing:
    """A ground station in whose world nothing moves: its frames are made once, and stamped anew each time."""

    def __init__(self, mission: Mission, start_s: float) -> None:
        self.orders = Directive.NORMAL
        self.is_outdated = False
        self._station = GroundStation(mission, start_s, sensed=False)
        self._start_s = start_s
        self._sequence = 0
        self._state: Sequence[BroadcastFrame] = ()
        self._slow: Sequence[BroadcastFrame] = ()

    def advance(self, now_s: float) -> None:
        """Do nothing: no track changes in a world that stands still."""

    def refresh(self, now_s: float, payload_bytes: int) -> list[BroadcastFrame]:
        self._sequence += 1
        self._state = self._state or self._station.refresh(self._start_s, payload_bytes)
        return [self._stamped(frame, now_s) for frame in self._state]

    def carousel(self, now_s: float, payload_bytes: int) -> list[BroadcastFrame]:
        self._slow = self._slow or self._station.carousel(self._start_s, payload_bytes)
        return [self._stamped(frame, now_s) for frame in self._slow]

    def overhear(self, datagram: bytes, now_s: float) -> None:
        """Do nothing: no agent is dead-reckoned."""

    def tick(self, now_s: float) -> list[bytes]:
        """Return nothing: a plan always has a radio, for which `refresh` and `carousel` are called instead."""
        return []

    def _stamped(self, frame: FrameT, now_s: float) -> FrameT:
        time_ms = round((now_s - frame.stamp.epoch_s) * 1000.0)
        return replace(frame, stamp=replace(frame.stamp, time_ms=time_ms, sequence=self._sequence))


@dataclass(frozen=True)
class Air:
    """The sent frames that agents need, and the shares of agents that need them."""

    sendings: tuple[tuple[float, Part], ...]
    """Time and part of each sending, in order of time."""
    needs: dict[frozenset[Part], float]
    """Share of the agents that need all of a set of parts, by that set."""
    switched_on_s: np.ndarray  # (_MOMENTS,) s, rising
    end_s: float

    @classmethod
    def of(cls, sent: Sequence[tuple[float, Sent]], end_s: float) -> Air:
        """Return the needed frames of a broadcaster's run; agents are switched on after each was sent twice."""
        needs = _needs(one.frame for _, one in sent if one.frame is not None)
        wanted = frozenset[Part]().union(*needs)
        sendings = tuple((at_s, _part(one.frame)) for at_s, one in sent if one.frame and _part(one.frame) in wanted)
        times_s = _times_s(sendings)
        begin_s = max(times[min(1, len(times) - 1)] for times in times_s.values())
        gap_s = max(float(np.diff(times).mean()) if len(times) > 1 else end_s for times in times_s.values())
        until_s = begin_s + max(_LEAST_SPAN_S, _INTERVALS * gap_s)
        return cls(sendings, needs, np.linspace(begin_s, until_s, _MOMENTS, endpoint=False), end_s)

    def current_after_s(self, loss: float) -> float | None:
        """Return the time until 99.9 % of agents are current at independent losses; None: not before the end."""
        times_s = _times_s(self.sendings)
        before = {part: np.searchsorted(times, self.switched_on_s, "right") for part, times in times_s.items()}

        def share_after(wait_s: float) -> float:
            heard = {
                part: 1.0 - loss ** (np.searchsorted(times, self.switched_on_s + wait_s, "right") - before[part])
                for part, times in times_s.items()
            }  # each (_MOMENTS,)
            return math.fsum(
                share * float(np.prod([heard[part] for part in parts], axis=0).mean())
                for parts, share in self.needs.items()
            )

        low_s, high_s = 0.0, self.end_s - float(self.switched_on_s[-1])
        if high_s <= 0.0 or share_after(high_s) < CURRENT_SHARE:
            return None
        while high_s - low_s > _RESOLUTION_S:
            middle_s = (low_s + high_s) / 2.0
            low_s, high_s = (low_s, middle_s) if share_after(middle_s) >= CURRENT_SHARE else (middle_s, high_s)
        return round(high_s, 2)

    def current_after_bursts_s(self, bursts: Bursts, progress: Progress = lambda share: None) -> float | None:
        """Return the time until 99.9 % of RECEIVERS drawn agents are current; None: not before the end."""
        draw = random_stream(_SEED, _STREAM)
        sets, shares = list(self.needs), np.array([*self.needs.values()])
        places = {part: place for place, part in enumerate(sorted(frozenset[Part]().union(*sets)))}
        wanted = np.array([[part in parts for part in places] for parts in sets])  # (sets, parts)
        # Each receiver's row marks the parts that it still lacks.
        misses = wanted[draw.choice(len(sets), RECEIVERS, p=shares / shares.sum())]  # (RECEIVERS, parts)
        missing = misses.sum(axis=1)  # (RECEIVERS,)
        on_s = draw.choice(self.switched_on_s, RECEIVERS)
        bad_share = bursts.bad_s / (bursts.good_s + bursts.bad_s)
        bad = draw.random(RECEIVERS) < bad_share
        current_at_s = np.full(RECEIVERS, np.inf)
        last_s = 0.0
        for count, (at_s, part) in enumerate(self.sendings):
            if at_s < self.switched_on_s[0]:
                continue
            # The Markov chain between two frames: its memory decays at the sum of both rates.
            kept = math.exp(-(at_s - last_s) * (1.0 / bursts.good_s + 1.0 / bursts.bad_s))
            bad = draw.random(RECEIVERS) < bad_share + (bad - bad_share) * kept
            got = (draw.random(RECEIVERS) >= np.where(bad, bursts.bad_loss, bursts.good_loss)) & (on_s < at_s)
            got &= misses[:, places[part]]
            misses[got, places[part]] = False
            missing -= got
            current_at_s[got & (missing == 0)] = at_s
            last_s = at_s
            if count % 100 == 0:
                still = int(np.count_nonzero(missing))
                progress(1.0 - still / RECEIVERS)
                if still == 0:
                    break
        after_s = float(np.quantile(current_at_s - on_s, CURRENT_SHARE, method="higher"))
        return round(after_s, 2) if math.isfinite(after_s) else None


def _part(frame: BroadcastFrame) -> Part:
    return _NAMES[type(frame)], frame.stamp.frame_index


def _times_s(sendings: Sequence[tuple[float, Part]]) -> dict[Part, np.ndarray]:  # each (sendings,) s
    times_s: dict[Part, list[float]] = defaultdict(list)
    for at_s, part in sendings:
        times_s[part].append(at_s)
    return {part: np.array(times) for part, times in times_s.items()}


def _needs(frames: Iterable[BroadcastFrame]) -> dict[frozenset[Part], float]:
    """Return the sets of frames that agents need, each with the share of the agents that need it.

    Every agent needs the mission, all radii, all threats' positions, its own entry and that of its target.
    """
    everybody: set[Part] = set()
    own: dict[int, tuple[Part, int | None]] = {}
    targets: dict[int, Part] = {}
    for frame in frames:
        part = _part(frame)
        if isinstance(frame, MissionFrame | RadiiFrame):
            everybody.add(part)
        elif isinstance(frame, StateFrame | FleetFrame):
            if frame.threats:
                everybody.add(part)
            own.update((agent.id, (part, agent.target_id)) for agent in frame.agents)
            targets.update((target.id, part) for target in frame.targets)
    sets = Counter(
        frozenset(everybody | {part} | (set() if target is None else {targets[target]}))
        for part, target in own.values()
    )
    return {parts: count / len(own) for parts, count in sets.items()}


def _items(sent: Sequence[tuple[float, Sent]]) -> tuple[Item, ...]:
    items = []
    first_s, last_s = sent[0][0], sent[-1][0]
    by_name: dict[str, list[tuple[float, Sent]]] = defaultdict(list)
    for at_s, one in sent:
        by_name[_HEARTBEAT if one.frame is None else _NAMES[type(one.frame)]].append((at_s, one))
    for name, ones in by_name.items():
        first = _times_s(
            [(at_s, _HEARTBEAT_PART if o.frame is None else _part(o.frame)) for at_s, o in ones if not o.copy]
        )
        gaps_s = np.concatenate([np.diff(times) for times in first.values()])
        told = sum(len(times) for times in first.values())
        items.append(
            Item(
                name=name,
                frames=len(first),
                # The bytes of the first sending belong to the time before it.
                bytes_per_s=sum(one.on_air_bytes for at_s, one in ones if at_s > first_s) / (last_s - first_s),
                interval_s=float(gaps_s.mean()) if gaps_s.size else None,
                copies=len(ones) / told - 1.0,
            )
        )
    return tuple(sorted(items, key=lambda item: -item.bytes_per_s))


def _left_out(items: Sequence[Item], state: Item, radio: Radio) -> tuple[str, ...]:
    names = {item.name for item in items}
    lines = []
    if state.interval_s is not None and state.interval_s > _AS_GOOD_AS * SHORTEST_REFRESH_S:
        lines.append(f"the state once a second: it fits every {state.interval_s:.1f} s")
    if state.copies < 1.0:
        lines.append(f"copies of each state frame: there is room for {state.copies:.1f}")
    if state.name == "ONEWAY_FLEET":
        lines.append("ONEWAY_MOTION: goes with ONEWAY_STATE only")
    elif "ONEWAY_MOTION" not in names:
        lines.append(f"ONEWAY_MOTION: no room for one of its frames in {radio.max_frame_bytes} bytes")
    return tuple(lines)


def _frame_signer(authentication: Authentication) -> FrameSigner:
    """Return a frame signer with fixed keys: their values change a frame's length only by chance, by cut zeros."""
    has_mavlink, has_ed25519 = authentication in ("mavlink", "both"), authentication in ("ed25519", "both")
    private_key = Ed25519PrivateKey.from_private_bytes(bytes(32)) if has_ed25519 else None
    return FrameSigner(private_key, MavlinkSigner(bytes(KEY_BYTES), 0) if has_mavlink else None)
