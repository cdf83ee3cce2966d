"""What goes out next, and when: the broadcast fitted into what a radio gives it.

The state is refreshed once a second, or as often as it fits. Where there is room left its frames are repeated, spread
over the interval, so that a loss costs a fraction of it; what rarely changes goes round in a carousel on a small share.
A radio that says that its buffer fills slows everything down. A changed directive begins a new refresh at once.

Time is the caller's; nothing here knows a clock or a socket.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from companion.errors import InputError
from companion.files.mavlink_layout import SIGNATURE_BYTES
from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM, FrameWriter, WireError
from companion.protocol.dialect import oneway
from companion.protocol.ed25519 import FrameSigner
from companion.protocol.messages import (
    BandsFrame,
    Directive,
    FleetFrame,
    MissionFrame,
    MotionFrame,
    RadiiFrame,
    StateFrame,
)
from companion.protocol.v2_extension import wrap
from groundstation.broadcast import Unsendable
from groundstation.radio import Radio

BroadcastFrame = StateFrame | MotionFrame | BandsFrame | FleetFrame | RadiiFrame | MissionFrame

SHORTEST_REFRESH_S = 1.0
"""Nothing that the broadcast tells of is known or acted on faster."""
LONGEST_REFRESH_S = 20.0
"""Its last frame is so old when it leaves; receivers refuse what is older than 30 s (authenticator.py)."""
MOST_SENDS = 4
"""Of one state frame in a refresh: two seconds of them are enough for 99.6 % at a loss of one half."""
CAROUSEL_SHARE = 0.1
"""Of the budget. At a loss of one half whoever joins then waits about as long for the radii of 50 threats as for the
state of 500 agents."""
LEAST_CAROUSEL_SHARE = 0.02
"""So little where a greater share would keep the state from being refreshed every second."""
SHORTEST_TURN_S = 1.0
"""The carousel begins a turn no sooner after the one before."""
ADVANCE_PERIOD_S = 1.0
"""How often the station thinks; half of that before a refresh, so that not all the work falls in one tick."""
HEARTBEAT_PERIOD_S = 1.0
_HEARTBEAT_BYTES = 21 + 13
"""With a MAVLink signature."""
TICK_S = 0.01
"""How often the shell asks where there is a radio."""
BURST_BYTES, BURST_S = 170.0, 0.03
"""What a pacer lets through at once, beside one frame, whichever is more: so late may the shell be and lose nothing. At
57600 baud more than half of a buffer of 1 KiB stays free, so that no radio has cause to slow the broadcast down."""

TXBUF_VERY_LOW, TXBUF_LOW, TXBUF_HIGH, TXBUF_VERY_HIGH = 20, 50, 90, 95
"""Free percent of the radio's buffer, below or above which the rate changes: those of ArduPilot's own flow control."""
TXBUF_PERIOD_S = 1.0
"""The rate changes once in so long at most: radios report about once a second."""
_SLOWED_A_LOT, _SLOWED, _FASTER, _FASTER_A_LOT = 0.6, 0.85, 1.05, 1.25
LEAST_PACE = 0.05
"""Of the budget: a radio that says for ever that it is full is still sent something."""

_MAVLINK_BYTES = 12
_DUE_TOLERANCE_S = 1e-6
_ON_THE_GRID_S = 0.1
"""What is later than this begins a new grid of due times: what was missed is not made good. For what is sent beside it
a refresh may be so late."""


class Pacer:
    """A token bucket: over any time, no more bytes than rate times time plus one burst."""

    def __init__(self, bytes_per_s: float, burst_bytes: float) -> None:
        """Begin full; nothing longer than `burst_bytes` can ever pass."""
        self._budget_bytes_per_s = bytes_per_s
        self._burst_bytes = burst_bytes
        self._tokens_bytes = burst_bytes
        self._filled_at_s: float | None = None
        self._heard_at_s: float | None = None
        self.pace = 1.0
        """Which part of the budget is used, in [LEAST_PACE, 1], as the radio's buffer allows."""

    def take(self, count: int, now_s: float) -> bool:
        """Return whether so many bytes may go out now; if so, they count as gone."""
        self._fill(now_s)
        if count > self._tokens_bytes + _DUE_TOLERANCE_S:
            return False
        self._tokens_bytes -= count
        return True

    def wait_s(self, count: int, now_s: float) -> float:
        """Return after how long, from now, so many bytes will have been let through at the present pace."""
        self._fill(now_s)
        return max(0.0, count - self._tokens_bytes) / (self._budget_bytes_per_s * self.pace)

    def _fill(self, now_s: float) -> None:
        if self._filled_at_s is not None:
            gained = max(0.0, now_s - self._filled_at_s) * self._budget_bytes_per_s * self.pace
            self._tokens_bytes = min(self._burst_bytes, self._tokens_bytes + gained)
        self._filled_at_s = now_s

    def hear_txbuf(self, percent: int | None, now_s: float) -> None:
        """Take in how much of the radio's buffer is free; None, nothing reported, lets the rate recover slowly."""
        if self._heard_at_s is not None and now_s - self._heard_at_s < TXBUF_PERIOD_S - _DUE_TOLERANCE_S:
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
    """Return how many bytes more than rate times time a broadcast may send over any time."""
    lateness_bytes = max(BURST_BYTES, BURST_S * radio.budget_bytes_per_s)
    return radio.max_frame_bytes + radio.outer_bytes + lateness_bytes


class Station(Protocol):
    """What the broadcaster asks of a ground station; `payload_bytes` is what a frame's payload may hold unsigned."""

    directive: Directive

    def advance(self, now_s: float) -> None:
        """Bring everything that is known up to now."""

    def refresh(self, now_s: float, payload_bytes: int) -> Sequence[BroadcastFrame]:
        """Return the frames of a new broadcast of the state; at least one."""

    def carousel(self, now_s: float, payload_bytes: int) -> Sequence[BroadcastFrame]:
        """Return the frames of a turn of what changes rarely, stamped now; one for each place in the turn."""

    def overhear(self, datagram: bytes, now_s: float) -> None:
        """Take note of an unsigned frame that is being broadcast."""

    def tick(self, now_s: float) -> list[bytes]:
        """Return the unsigned frames that are due where nothing limits them."""


@dataclass(frozen=True)
class Sent:
    """One frame as it goes on the air."""

    data: bytes
    frame: BroadcastFrame | None
    """None: a heartbeat."""
    copy: int
    """How often the same frame went out before."""
    added_bytes: int = 0
    """What is added to it on its way (Radio.added_bytes)."""

    @property
    def on_air_bytes(self) -> int:
        """How long it is on the air."""
        return len(self.data) + self.added_bytes


class Broadcaster:
    """Decides what a ground station's radio sends; without a radio, everything as soon as it is due."""

    def __init__(self, station: Station, radio: Radio | None, frame_signer: FrameSigner | None = None) -> None:
        self._station = station
        self._radio = radio
        self._frame_signer = frame_signer or FrameSigner(None, None)
        self.unsendable = Unsendable()
        """What could not be sent, where there is a radio."""
        self._schedule = None if radio is None else _Schedule(station, radio, self._frame_signer, self.unsendable)

    def begin(self, now_s: float) -> None:
        """Make the first broadcast of the state, so that what can never be sent is known before anything is.

        Raises:
            InputError: the state does not fit the radio, or a frame of it cannot be made.

        """
        if self._schedule is not None:
            self._schedule.begin_refresh(now_s)

    @property
    def pace(self) -> float:
        """Which part of the budget the radio's buffer allows; 1 without a radio."""
        return 1.0 if self._schedule is None else self._schedule.pacer.pace

    def tick(self, now_s: float, txbuf_percent: int | None = None) -> list[bytes]:
        """Return the signed frames to send now. Call often: what is let through is let through late, never early.

        Raises:
            InputError: the state does not fit the radio.

        """
        if self._schedule is None:
            return [self._frame_signer.sign(datagram, now_s) for datagram in self._station.tick(now_s)]
        return [sent.data for sent in self._schedule.step(now_s, txbuf_percent)]

    def step(self, now_s: float, txbuf_percent: int | None = None) -> list[Sent]:
        """Return what `tick` returns, and what it is; for planning. Needs a radio."""
        assert self._schedule is not None
        return self._schedule.step(now_s, txbuf_percent)


@dataclass
class _Refresh:
    """One broadcast of the state under way: its frames in the order in which they go out, and how many have."""

    begun_at_s: float
    directive: Directive
    frames: list[tuple[BroadcastFrame, bytes]]
    longest_bytes: int
    """Of a frame on the air."""
    sends: int = 0

    @property
    def told(self) -> bool:
        """Whether every frame has gone out once."""
        return self.sends >= len(self.frames)


class _Schedule:
    def __init__(self, station: Station, radio: Radio, frame_signer: FrameSigner, unsendable: Unsendable) -> None:
        self._station = station
        self._unsendable = unsendable
        self._begin_again_s = float("-inf")
        """No refresh begins before, because the last one could not be made."""
        self._radio = radio
        self._frame_signer = frame_signer
        self._payload_bytes = radio.max_frame_bytes - _MAVLINK_BYTES - frame_signer.overhead_bytes
        self.pacer = Pacer(radio.budget_bytes_per_s, burst_bytes(radio))
        self._writer = FrameWriter()
        self._waiting: tuple[Sent, Callable[[float], None]] | None = None
        """What goes out as soon as the budget lets it, and what is to be noted then."""
        self._refresh: _Refresh | None = None
        self._refresh_due_s = float("-inf")
        self._advance_due_s = float("-inf")
        self._first_frame = 0
        self._copies = 0
        self._turn_place = 0
        self._turn_due_s = float("-inf")
        self._credit_bytes = 0.0
        self._carousel_share = CAROUSEL_SHARE
        self._epoch_s: int | None = None
        self._is_needed = False
        """Nothing can be read without what the carousel says."""
        self._urgent = False
        """And nobody can have heard it yet: it goes first."""
        self._heartbeat_due_s = float("-inf") if radio.heartbeats else float("inf")
        self._heartbeats = oneway.MAVLink(None, srcSystem=GROUND_SYSTEM, srcComponent=GROUND_COMPONENT)
        self._wrapped = 0

    def step(self, now_s: float, txbuf_percent: int | None) -> list[Sent]:
        self.pacer.hear_txbuf(txbuf_percent, now_s)
        if self._worked(now_s):
            # That took time which `now_s` knows nothing of: to send now would be to send at once what is due later.
            return []
        out: list[Sent] = []
        while True:
            if self._waiting is None:
                self._waiting = self._next(now_s)
            if self._waiting is None:
                return out
            sent, note = self._waiting
            if not self.pacer.take(sent.on_air_bytes, now_s):
                return out
            note(now_s)
            self._credit_bytes = min(
                self._credit_bytes + self._carousel_share * sent.on_air_bytes, float(self._radio.max_frame_bytes)
            )
            self._waiting = None
            out.append(sent)

    def _worked(self, now_s: float) -> bool:
        """Do what takes longer than choosing a frame, if it is due; return whether it was."""
        if now_s >= self._advance_due_s - _DUE_TOLERANCE_S:
            self._station.advance(now_s)
            self._advance_due_s = max(self._advance_due_s, now_s - ADVANCE_PERIOD_S / 2.0) + ADVANCE_PERIOD_S
            return True
        if now_s < self._begin_again_s:
            return False
        if self._refresh is None or self._must_restart(self._refresh, now_s) or self._is_due(self._refresh, now_s):
            self.begin_refresh(now_s)
            return True
        return False

    def _must_restart(self, refresh: _Refresh, now_s: float) -> bool:
        """Return whether the rest of a refresh is not worth sending: another directive holds, or it is too old."""
        return refresh.directive is not self._station.directive or now_s - refresh.begun_at_s > LONGEST_REFRESH_S

    def _is_due(self, refresh: _Refresh, now_s: float) -> bool:
        """Return whether it is time for the refresh that follows."""
        return refresh.told and now_s >= self._refresh_due_s - _DUE_TOLERANCE_S

    def _next(self, now_s: float) -> tuple[Sent, Callable[[float], None]] | None:
        """Return what is most wanted now, None if nothing is."""
        refresh = self._refresh
        assert refresh is not None
        if now_s >= self._heartbeat_due_s - _DUE_TOLERANCE_S:
            return self._heartbeat(now_s)
        if self._is_due(refresh, now_s):
            return None
        if (self._urgent or self._credit_bytes > 0.0) and (slow := self._carousel(now_s)) is not None:
            return slow
        if not refresh.told:
            return self._state(refresh, refresh.sends, now_s)
        if self.pacer.wait_s(2 * refresh.longest_bytes, now_s) > self._refresh_due_s + _ON_THE_GRID_S - now_s:
            return None  # the next refresh would have to wait for what else went out
        round_of_copies = refresh.sends // len(refresh.frames)
        if (self._is_needed or round_of_copies > 1) and (slow := self._carousel(now_s)) is not None:
            return slow
        spread_s = SHORTEST_REFRESH_S / MOST_SENDS
        if round_of_copies < MOST_SENDS and now_s >= refresh.begun_at_s + round_of_copies * spread_s - _DUE_TOLERANCE_S:
            # Copies go on where those of the last refresh ended, so that none is always left out.
            return self._state(refresh, self._copies, now_s)
        return None

    def begin_refresh(self, now_s: float) -> None:
        aborted = self._refresh is not None and not self._refresh.told
        frames = self._made(now_s)
        if not frames:
            self._repeat_the_last(now_s)
            return
        lengths = [len(self._frame_signer.sign(raw, now_s)) + self._radio.outer_bytes for _, raw in frames]
        if self._refresh is None:
            self._refuse_what_cannot_fit(sum(lengths))
        self._carousel_share = self._share_beside(sum(lengths))
        if aborted:
            # Go on with what was not told: directives that change fast must not keep the last frames from the air.
            assert self._refresh is not None
            self._first_frame += self._refresh.sends
        self._first_frame %= len(frames)
        frames = frames[self._first_frame :] + frames[: self._first_frame]
        self._refresh = _Refresh(now_s, self._station.directive, frames, max(lengths))
        self._refresh_due_s = _after(self._refresh_due_s, SHORTEST_REFRESH_S, now_s)
        self._waiting = None
        epoch_s = frames[0][0].stamp.epoch_s
        if epoch_s != self._epoch_s:
            self._epoch_s = epoch_s
            self._turn_place, self._turn_due_s = 0, float("-inf")
            slow = self._slow(now_s)
            self._is_needed = self._urgent = len(slow) > 0 and isinstance(slow[0], MissionFrame)

    def _made(self, now_s: float) -> list[tuple[BroadcastFrame, bytes]]:
        """Return the frames of a new broadcast of the state; those that cannot be made are counted and left out.

        Raises:
            InputError: nothing was sent yet, so that the mission itself asks for what no frame holds.

        """
        made = []
        try:
            for frame in self._station.refresh(now_s, self._payload_bytes):
                try:
                    made.append((frame, self._writer.encode(frame)))
                except WireError as error:
                    self._cannot_send(error)
        except WireError as error:
            self._cannot_send(error)
        return made

    def _cannot_send(self, error: WireError) -> None:
        if self._refresh is None:
            raise InputError(f"radio {self._radio.name}: the mission cannot be broadcast: {error}") from error
        self._unsendable.add(error)

    def _repeat_the_last(self, now_s: float) -> None:
        """Tell the last state again: receivers know from its stamp how old it is."""
        assert self._refresh is not None
        self._refresh.sends, self._refresh.begun_at_s = 0, now_s
        self._refresh_due_s = self._begin_again_s = now_s + SHORTEST_REFRESH_S
        self._waiting = None

    def _slow(self, now_s: float) -> Sequence[BroadcastFrame]:
        try:
            return self._station.carousel(now_s, self._payload_bytes)
        except WireError as error:
            self._cannot_send(error)
            return ()

    def _share_beside(self, state_bytes: int) -> float:
        """Return the carousel's share of the budget beside a state of so many bytes."""
        heartbeat_bytes = _HEARTBEAT_BYTES / HEARTBEAT_PERIOD_S if self._radio.heartbeats else 0.0
        bytes_per_s = self._radio.budget_bytes_per_s * self.pacer.pace
        left = 1.0 - (state_bytes / SHORTEST_REFRESH_S + heartbeat_bytes) / bytes_per_s
        return min(left, CAROUSEL_SHARE) if left >= LEAST_CAROUSEL_SHARE else CAROUSEL_SHARE

    def _refuse_what_cannot_fit(self, on_air_bytes: int) -> None:
        takes_s = on_air_bytes / (self._radio.budget_bytes_per_s * (1.0 - CAROUSEL_SHARE))
        if takes_s > LONGEST_REFRESH_S:
            remedies = ["a faster radio"]
            if self._radio.share < 1.0:
                remedies.append("a greater share")
            if self._frame_signer.overhead_bytes > SIGNATURE_BYTES:
                remedies.append("--auth mavlink instead of Ed25519")
            raise InputError(
                f"radio {self._radio.name}: the state of this mission is {on_air_bytes} bytes, {takes_s:.0f} s at "
                f"{self._radio.budget_bytes_per_s:.0f} B/s; allowed: at most {LONGEST_REFRESH_S:g} s: by "
                f"{', '.join(remedies)} or fewer agents"
            )

    def _state(self, refresh: _Refresh, place: int, now_s: float) -> tuple[Sent, Callable[[float], None]]:
        frame, raw = refresh.frames[place % len(refresh.frames)]
        is_copy = refresh.told

        def note(sent_at_s: float) -> None:
            refresh.sends += 1
            if is_copy:
                self._copies = (place + 1) % len(refresh.frames)
            else:
                self._station.overhear(raw, sent_at_s)

        return self._on_air(raw, frame, refresh.sends // len(refresh.frames), now_s), note

    def _carousel(self, now_s: float) -> tuple[Sent, Callable[[float], None]] | None:
        if self._turn_place == 0 and now_s < self._turn_due_s - _DUE_TOLERANCE_S:
            return None
        frames = self._slow(now_s)
        if not frames:
            self._turn_due_s = now_s + SHORTEST_TURN_S
            return None
        place = min(self._turn_place, len(frames) - 1)
        try:
            raw = self._writer.encode(frames[place])
        except WireError as error:
            self._cannot_send(error)
            self._turn_place, self._turn_due_s = (place + 1) % len(frames), now_s + SHORTEST_TURN_S
            self._urgent = self._urgent and self._turn_place > 0
            return None
        sent = self._on_air(raw, frames[place], 0, now_s)

        def note(sent_at_s: float) -> None:
            self._station.overhear(raw, sent_at_s)
            self._credit_bytes = max(self._credit_bytes - sent.on_air_bytes, -float(self._radio.max_frame_bytes))
            if self._turn_place == 0:
                self._turn_due_s = _after(self._turn_due_s, SHORTEST_TURN_S, sent_at_s)
            self._turn_place = place + 1
            if self._turn_place >= len(frames):
                self._turn_place, self._urgent = 0, False

        return sent, note

    def _heartbeat(self, now_s: float) -> tuple[Sent, Callable[[float], None]]:
        message = oneway.MAVLink_heartbeat_message(
            oneway.MAV_TYPE_GCS, oneway.MAV_AUTOPILOT_INVALID, 0, 0, oneway.MAV_STATE_ACTIVE, 3
        )
        raw = bytes(message.pack(self._heartbeats))

        def note(sent_at_s: float) -> None:
            self._heartbeats.seq = (self._heartbeats.seq + 1) % 256
            self._heartbeat_due_s = _after(self._heartbeat_due_s, HEARTBEAT_PERIOD_S, sent_at_s)

        return Sent(self._frame_signer.sign(raw, now_s), None, 0), note

    def _on_air(self, raw: bytes, frame: BroadcastFrame, copy: int, now_s: float) -> Sent:
        signed = self._frame_signer.sign(raw, now_s)
        if not self._radio.wrapped:
            return Sent(signed, frame, copy)
        self._wrapped += 1
        return Sent(wrap(signed, self._wrapped), frame, copy, self._radio.added_bytes)


def _after(due_s: float, period_s: float, now_s: float) -> float:
    """Return when a thing is due again that was due at `due_s` and goes out now."""
    return (due_s if now_s - due_s < _ON_THE_GRID_S else now_s) + period_s
