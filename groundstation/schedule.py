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
from groundstation.pacer import Pacer, burst_bytes
from groundstation.radio import Radio

BroadcastFrame = StateFrame | MotionFrame | BandsFrame | FleetFrame | RadiiFrame | MissionFrame

SHORTEST_REFRESH_S = 1.0
"""Nothing that the broadcast tells of is known or acted on faster."""
LONGEST_REFRESH_S = 20.0
"""How old its last frame may be when it leaves; receivers refuse what is older than 30 s (authenticator.py)."""
MOST_SENDS = 4
"""Of one state frame in a refresh: two seconds of them are enough for 99.6 % at a loss of one half."""
CAROUSEL_SHARE = 0.1
"""Of the budget. At a loss of one half whoever joins then waits about as long for the radii of 50 threats as for the
state of 500 agents."""
LEAST_CAROUSEL_SHARE = 0.02
"""Of the budget, where a greater share would keep the state from being refreshed every second."""
SHORTEST_TURN_S = 1.0
"""The carousel begins a turn no sooner after the one before."""
ADVANCE_PERIOD_S = 1.0
"""How often the station thinks; half of that before a refresh, so that not all the work falls in one tick."""
HEARTBEAT_PERIOD_S = 1.0
_HEARTBEAT_BYTES = 21 + 13
"""With a MAVLink signature."""
TICK_S = 0.01
"""How often the shell asks where there is a radio."""
_MAVLINK_BYTES = 12
_DUE_TOLERANCE_S = 1e-6
_ON_THE_GRID_S = 0.1
"""What is later than this begins a new grid of due times: what was missed is not made good. A refresh may be this late
for what is sent beside it."""


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
        self._signer = frame_signer or FrameSigner(None, None)
        self.unsendable = Unsendable()
        """What could not be sent, where there is a radio."""
        self._schedule = None if radio is None else _Schedule(station, radio, self._signer, self.unsendable)

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
            return [self._signer.sign(datagram, now_s) for datagram in self._station.tick(now_s)]
        return [sent.data for sent in self._schedule.step(now_s, txbuf_percent)]

    def step(self, now_s: float, txbuf_percent: int | None = None) -> list[Sent]:
        """Return what `tick` returns, and what it is; for planning. Needs a radio."""
        assert self._schedule is not None
        return self._schedule.step(now_s, txbuf_percent)


@dataclass(frozen=True)
class _Offer:
    """A frame that goes out as soon as the budget lets it, and what is to be noted then, with the time."""

    sent: Sent
    note: Callable[[float], None]


class _Packer:
    """Makes frames as they go on the air of one radio: encoded, signed, wrapped where an autopilot stands before it."""

    def __init__(self, radio: Radio, frame_signer: FrameSigner) -> None:
        self.payload_bytes = radio.max_frame_bytes - _MAVLINK_BYTES - frame_signer.overhead_bytes
        """What the payload of an unsigned frame may hold."""
        self.has_ed25519 = frame_signer.overhead_bytes > SIGNATURE_BYTES
        """Whether frames carry an Ed25519 signature."""
        self._radio = radio
        self._signer = frame_signer
        self._writer = FrameWriter()
        self._wrapped = 0

    def encode(self, frame: BroadcastFrame) -> bytes:
        """Return an unsigned frame; raises WireError if it cannot be made."""
        return self._writer.encode(frame)

    def on_air_bytes(self, raw: bytes, now_s: float) -> int:
        """Return how long an unsigned frame will be on the air."""
        return len(self._signer.sign(raw, now_s)) + self._radio.outer_bytes

    def pack(self, raw: bytes, frame: BroadcastFrame, copy: int, now_s: float) -> Sent:
        """Return an unsigned frame as it goes on the air."""
        signed = self._signer.sign(raw, now_s)
        if not self._radio.wrapped:
            return Sent(signed, frame, copy)
        self._wrapped += 1
        return Sent(wrap(signed, self._wrapped), frame, copy, self._radio.added_bytes)


class _Heartbeat:
    """MAVLink's heartbeat of a ground station, once a second where the radio wants one."""

    def __init__(self, wanted: bool, frame_signer: FrameSigner) -> None:
        self._due_s = float("-inf") if wanted else float("inf")
        self._signer = frame_signer
        self._mav = oneway.MAVLink(None, srcSystem=GROUND_SYSTEM, srcComponent=GROUND_COMPONENT)

    def is_due(self, now_s: float) -> bool:
        return now_s >= self._due_s - _DUE_TOLERANCE_S

    def offer(self, now_s: float) -> _Offer:
        message = oneway.MAVLink_heartbeat_message(
            oneway.MAV_TYPE_GCS, oneway.MAV_AUTOPILOT_INVALID, 0, 0, oneway.MAV_STATE_ACTIVE, 3
        )
        return _Offer(Sent(self._signer.sign(bytes(message.pack(self._mav)), now_s), None, 0), self._note)

    def _note(self, sent_at_s: float) -> None:
        self._mav.seq = (self._mav.seq + 1) % 256
        self._due_s = _after(self._due_s, HEARTBEAT_PERIOD_S, sent_at_s)


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

    @property
    def rounds(self) -> int:
        """How often every frame has gone out."""
        return self.sends // len(self.frames)


@dataclass
class _RefreshPlace:
    """Where one refresh leaves off and the next begins."""

    due_s: float = float("-inf")
    not_before_s: float = float("-inf")
    """No refresh begins before, because the last one could not be made."""
    first_frame: int = 0
    """Of the state, with which the refresh begins."""
    next_copy: int = 0


@dataclass
class _Carousel:
    """Where the carousel is in its turn, and what it may spend."""

    place: int = 0
    due_s: float = float("-inf")
    """When a turn may begin."""
    credit_bytes: float = 0.0
    share: float = CAROUSEL_SHARE
    """Of what goes out, that it earns."""
    is_needed: bool = False
    """Nothing can be read without what the carousel says."""
    is_urgent: bool = False
    """And nobody can have heard it yet: it goes first."""

    def rewind(self) -> None:
        """Begin a turn, now."""
        self.place, self.due_s = 0, float("-inf")

    def earn(self, on_air_bytes: int, most_bytes: float) -> None:
        """Take its share of what went out; no more than `most_bytes` is kept."""
        self.credit_bytes = min(self.credit_bytes + self.share * on_air_bytes, most_bytes)

    def is_due(self, now_s: float) -> bool:
        """Return whether it is under way or may begin a turn."""
        return self.place != 0 or now_s >= self.due_s - _DUE_TOLERANCE_S

    def pause(self, now_s: float) -> None:
        """Begin the next turn later: there was nothing to say."""
        self.due_s = now_s + SHORTEST_TURN_S

    def pass_over(self, place: int, frames: int, now_s: float) -> None:
        """Go on behind a frame that could not be made."""
        self.place, self.due_s = (place + 1) % frames, now_s + SHORTEST_TURN_S
        self.is_urgent = self.is_urgent and self.place > 0

    def told(self, place: int, frames: int, on_air_bytes: int, sent_at_s: float) -> None:
        """Take note that the frame at a place of the turn went out."""
        self.credit_bytes -= on_air_bytes
        if self.place == 0:
            self.due_s = _after(self.due_s, SHORTEST_TURN_S, sent_at_s)
        self.place = place + 1
        if self.place >= frames:
            self.place, self.is_urgent = 0, False


class _Schedule:
    """What goes out over one radio, and when."""

    def __init__(self, station: Station, radio: Radio, frame_signer: FrameSigner, unsendable: Unsendable) -> None:
        self._station = station
        self._unsendable = unsendable
        self._radio = radio
        self._packer = _Packer(radio, frame_signer)
        self.pacer = Pacer(radio.budget_bytes_per_s, burst_bytes(radio))
        self._waiting: _Offer | None = None
        self._advance_due_s = float("-inf")
        self._refresh: _Refresh | None = None
        self._refreshes = _RefreshPlace()
        self._carousel = _Carousel()
        self._heartbeat = _Heartbeat(radio.heartbeats, frame_signer)
        self._epoch_s: int | None = None

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
            sent = self._waiting.sent
            if not self.pacer.take(sent.on_air_bytes, now_s):
                return out
            self._waiting.note(now_s)
            self._carousel.earn(sent.on_air_bytes, float(self._radio.max_frame_bytes))
            self._waiting = None
            out.append(sent)

    def _worked(self, now_s: float) -> bool:
        """Do what takes longer than choosing a frame, if it is due; return whether it was."""
        if now_s >= self._advance_due_s - _DUE_TOLERANCE_S:
            self._station.advance(now_s)
            self._advance_due_s = max(self._advance_due_s, now_s - ADVANCE_PERIOD_S / 2.0) + ADVANCE_PERIOD_S
            return True
        if now_s < self._refreshes.not_before_s:
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
        return refresh.told and now_s >= self._refreshes.due_s - _DUE_TOLERANCE_S

    def _next(self, now_s: float) -> _Offer | None:
        """Return what is most wanted now, None if nothing is."""
        refresh = self._refresh
        assert refresh is not None
        if self._heartbeat.is_due(now_s):
            return self._heartbeat.offer(now_s)
        if self._is_due(refresh, now_s):
            return None
        carousel = self._carousel
        if (carousel.is_urgent or carousel.credit_bytes > 0.0) and (slow := self._slow_offer(now_s)) is not None:
            return slow
        if not refresh.told:
            return self._state_offer(refresh, refresh.sends, now_s)
        if self.pacer.wait_s(2 * refresh.longest_bytes, now_s) > self._refreshes.due_s + _ON_THE_GRID_S - now_s:
            return None  # the next refresh would have to wait for what else went out
        if (carousel.is_needed or refresh.rounds > 1) and (slow := self._slow_offer(now_s)) is not None:
            return slow
        spread_s = SHORTEST_REFRESH_S / MOST_SENDS
        if refresh.rounds < MOST_SENDS and now_s >= refresh.begun_at_s + refresh.rounds * spread_s - _DUE_TOLERANCE_S:
            # Copies go on where those of the last refresh ended, so that none is always left out.
            return self._state_offer(refresh, self._refreshes.next_copy, now_s)
        return None

    def begin_refresh(self, now_s: float) -> None:
        aborted = self._refresh is not None and not self._refresh.told
        frames = self._made(now_s)
        if not frames:
            self._repeat_the_last(now_s)
            return
        lengths = [self._packer.on_air_bytes(raw, now_s) for _, raw in frames]
        if self._refresh is None:
            self._refuse_what_cannot_fit(sum(lengths))
        self._carousel.share = self._share_beside(sum(lengths))
        place = self._refreshes
        if aborted:
            # Go on with what was not told: directives that change fast must not keep the last frames from the air.
            assert self._refresh is not None
            place.first_frame += self._refresh.sends
        place.first_frame %= len(frames)
        frames = frames[place.first_frame :] + frames[: place.first_frame]
        self._refresh = _Refresh(now_s, self._station.directive, frames, max(lengths))
        place.due_s = _after(place.due_s, SHORTEST_REFRESH_S, now_s)
        self._waiting = None
        epoch_s = frames[0][0].stamp.epoch_s
        if epoch_s != self._epoch_s:
            self._epoch_s = epoch_s
            self._carousel.rewind()
            slow = self._slow_frames(now_s)
            self._carousel.is_needed = self._carousel.is_urgent = len(slow) > 0 and isinstance(slow[0], MissionFrame)

    def _made(self, now_s: float) -> list[tuple[BroadcastFrame, bytes]]:
        """Return the frames of a new broadcast of the state; those that cannot be made are counted and left out.

        Raises:
            InputError: nothing was sent yet, so that the mission itself asks for what no frame holds.

        """
        made = []
        try:
            for frame in self._station.refresh(now_s, self._packer.payload_bytes):
                try:
                    made.append((frame, self._packer.encode(frame)))
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
        self._refreshes.due_s = self._refreshes.not_before_s = now_s + SHORTEST_REFRESH_S
        self._waiting = None

    def _slow_frames(self, now_s: float) -> Sequence[BroadcastFrame]:
        try:
            return self._station.carousel(now_s, self._packer.payload_bytes)
        except WireError as error:
            self._cannot_send(error)
            return ()

    def _share_beside(self, state_bytes: int) -> float:
        """Return the carousel's share of the budget beside a state of `state_bytes` on the air."""
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
            if self._packer.has_ed25519:
                remedies.append("--auth mavlink instead of Ed25519")
            raise InputError(
                f"radio {self._radio.name}: the state of this mission is {on_air_bytes} bytes, {takes_s:.0f} s at "
                f"{self._radio.budget_bytes_per_s:.0f} B/s; allowed: at most {LONGEST_REFRESH_S:g} s: by "
                f"{', '.join(remedies)} or fewer agents"
            )

    def _state_offer(self, refresh: _Refresh, place: int, now_s: float) -> _Offer:
        frame, raw = refresh.frames[place % len(refresh.frames)]
        is_copy = refresh.told

        def note(sent_at_s: float) -> None:
            refresh.sends += 1
            if is_copy:
                self._refreshes.next_copy = (place + 1) % len(refresh.frames)
            else:
                self._station.overhear(raw, sent_at_s)

        return _Offer(self._packer.pack(raw, frame, refresh.rounds, now_s), note)

    def _slow_offer(self, now_s: float) -> _Offer | None:
        """Return the next frame of the carousel, None if there is none now."""
        carousel = self._carousel
        if not carousel.is_due(now_s):
            return None
        frames = self._slow_frames(now_s)
        if not frames:
            carousel.pause(now_s)
            return None
        place = min(carousel.place, len(frames) - 1)
        try:
            raw = self._packer.encode(frames[place])
        except WireError as error:
            self._cannot_send(error)
            carousel.pass_over(place, len(frames), now_s)
            return None
        sent = self._packer.pack(raw, frames[place], 0, now_s)

        def note(sent_at_s: float) -> None:
            self._station.overhear(raw, sent_at_s)
            carousel.told(place, len(frames), sent.on_air_bytes, sent_at_s)
            carousel.credit_bytes = max(carousel.credit_bytes, -float(self._radio.max_frame_bytes))

        return _Offer(sent, note)


def _after(due_s: float, period_s: float, now_s: float) -> float:
    """Return when a thing is due again that was due at `due_s` and goes out now."""
    return (due_s if now_s - due_s < _ON_THE_GRID_S else now_s) + period_s
