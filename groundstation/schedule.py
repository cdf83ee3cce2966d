"""Schedule of the broadcast: which frame is sent next, and when, within a radio's budget.

The state is refreshed once a second, or as often as it fits. If there is room left its frames are repeated, spread over
the interval, so that a lost frame costs only a fraction of it. Frames that rarely change are sent in a carousel on a
small share of the budget. A radio that reports that its buffer fills slows everything down. Changed orders begin a
new refresh at once, changed threats soon.

Times are arguments; there is no clock and no socket here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from companion.errors import InputError
from companion.files.mavlink_layout import OVERHEAD_BYTES, SIGNATURE_BYTES
from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM, FrameWriter, WireError
from companion.protocol.dialect import oneway
from companion.protocol.ed25519 import FrameSigner
from companion.protocol.messages import (
    BandsFrame,
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
"""Least time between two refreshes of the state: nothing in the broadcast is known or acted on faster."""
LONGEST_REFRESH_S = 20.0
"""Greatest age of a refresh when its last frame is sent; receivers refuse frames older than 30 s (authenticator.py)."""
LEAST_REVISION_S = 5.0
"""Age of a refresh from which on changed threats begin the next one at once. Not sooner: each revision must be heard
whole, and whoever adds threats one by one would keep the picture from ever being so."""
MOST_SENDS = 4
"""Greatest number of sends of a state frame in a refresh: two seconds of them give 99.6 % at a loss of one half."""
CAROUSEL_SHARE = 0.1
"""Share of the budget for the carousel. At a loss of one half, a vehicle that joins then waits about equally long for
the radii of 50 threats and for the state of 500 agents."""
LEAST_CAROUSEL_SHARE = 0.02
"""Share of the budget down to which the carousel yields to a state that is refreshed every second."""
SHORTEST_TURN_S = 1.0
"""Least time between the beginnings of two turns of the carousel."""
ADVANCE_PERIOD_S = 1.0
"""Period of the station's `advance`, half a period apart from refreshes, so that not all work falls into one tick."""
HEARTBEAT_PERIOD_S = 1.0
_HEARTBEAT_BYTES = 21 + 13
"""Length of a heartbeat with a MAVLink signature."""
TICK_S = 0.01
"""Period at which the shell calls the broadcaster if there is a radio."""
_DUE_TOLERANCE_S = 1e-6
_ON_THE_GRID_S = 0.1
"""Delay from which a new grid of due times begins, so that missed frames are not made up; also the greatest delay of a
refresh that other frames may cause."""


class Station(Protocol):
    """Ground station as the broadcaster uses it; `payload_bytes` is the greatest payload of an unsigned frame."""

    @property
    def orders(self) -> object:
        """What vehicles are told to do; other orders begin a new refresh at once."""

    @property
    def is_outdated(self) -> bool:
        """Whether threats were added, retired or changed since the last refresh was begun."""

    def advance(self, now_s: float) -> None:
        """Update all tracks and the assignment to `now_s`."""

    def refresh(self, now_s: float, payload_bytes: int) -> Sequence[BroadcastFrame]:
        """Return the frames of a new broadcast of the state; at least one."""

    def carousel(self, now_s: float, payload_bytes: int) -> Sequence[BroadcastFrame]:
        """Return the frames of one turn of the carousel, stamped now, in order of their places in the turn."""

    def overhear(self, datagram: bytes, now_s: float) -> None:
        """Take note of an unsigned frame that is being broadcast."""

    def tick(self, now_s: float) -> list[bytes]:
        """Return the unsigned frames that are due if no radio limits the broadcast."""


@dataclass(frozen=True)
class Sent:
    """One frame as it is sent."""

    data: bytes
    frame: BroadcastFrame | None
    """Content of the frame; None for a heartbeat."""
    copy: int
    """Number of times that the same frame was sent before."""
    added_bytes: int = 0
    """Number of bytes added to the frame on its way (Radio.added_bytes)."""

    @property
    def on_air_bytes(self) -> int:
        """Length of the frame on the air."""
        return len(self.data) + self.added_bytes


class Broadcaster:
    """Chooses the frames that a ground station's radio sends; without a radio, all frames as soon as they are due."""

    def __init__(self, station: Station, radio: Radio | None, frame_signer: FrameSigner | None = None) -> None:
        self._station = station
        self._signer = frame_signer or FrameSigner(None, None)
        self.unsendable = Unsendable()
        """Frames that could not be sent over the radio."""
        self._schedule = None if radio is None else _Schedule(station, radio, self._signer, self.unsendable)

    def begin(self, now_s: float) -> None:
        """Prepare the first broadcast of the state, so that a mission that cannot be sent is refused at the start.

        Raises:
            InputError: the state does not fit the radio, or one of its frames cannot be encoded.

        """
        if self._schedule is not None:
            self._schedule.begin_refresh(now_s)

    @property
    def pace(self) -> float:
        """Share of the budget that the radio's buffer allows; 1 without a radio."""
        return 1.0 if self._schedule is None else self._schedule.pacer.pace

    def tick(self, now_s: float, txbuf_percent: int | None = None) -> list[bytes]:
        """Return the signed frames to send now; call it every TICK_S, as a frame may be sent late but never early.

        Raises:
            InputError: the state does not fit the radio.

        """
        if self._schedule is None:
            return [self._signer.sign(datagram, now_s) for datagram in self._station.tick(now_s)]
        return [sent.data for sent in self._schedule.step(now_s, txbuf_percent)]

    def last(self, datagrams: Sequence[bytes], now_s: float) -> list[bytes]:
        """Return the signed frames of a last broadcast, whose unsigned ones are given.

        Over a radio none are returned: a refresh, which says the same, begins, and follows from `tick` until
        `has_told`.
        """
        if self._schedule is None:
            return [self._signer.sign(datagram, now_s) for datagram in datagrams]
        self._schedule.begin_refresh(now_s)
        return []

    @property
    def has_told(self) -> bool:
        """Whether every frame of the newest broadcast of the state was sent."""
        return self._schedule is None or self._schedule.has_told

    def step(self, now_s: float, txbuf_percent: int | None = None) -> list[Sent]:
        """Return the frames of `tick` with their contents, for planning; only with a radio."""
        assert self._schedule is not None
        return self._schedule.step(now_s, txbuf_percent)


@dataclass(frozen=True)
class _Offer:
    """A frame to send as soon as the budget allows, and the function to call with the time when it is sent."""

    sent: Sent
    note: Callable[[float], None]


class _Packer:
    """Makes frames ready for one radio: encoded, signed and, if an autopilot forwards them, wrapped."""

    def __init__(self, radio: Radio, frame_signer: FrameSigner) -> None:
        self.payload_bytes = radio.max_frame_bytes - OVERHEAD_BYTES - frame_signer.overhead_bytes
        """Greatest payload of an unsigned frame."""
        self.has_ed25519 = frame_signer.overhead_bytes > SIGNATURE_BYTES
        """Whether frames carry an Ed25519 signature."""
        self._radio = radio
        self._signer = frame_signer
        self._writer = FrameWriter()
        self._wrapped = 0

    def encode(self, frame: BroadcastFrame) -> bytes:
        """Return an unsigned frame; raises WireError if it cannot be encoded."""
        return self._writer.encode(frame)

    def on_air_bytes(self, raw: bytes, now_s: float) -> int:
        """Return the length that an unsigned frame will have on the air."""
        return len(self._signer.sign(raw, now_s)) + self._radio.outer_bytes

    def pack(self, raw: bytes, frame: BroadcastFrame, copy: int, now_s: float) -> Sent:
        """Return an unsigned frame made ready to send: signed and, if the radio needs it, wrapped."""
        signed = self._signer.sign(raw, now_s)
        if not self._radio.wrapped:
            return Sent(signed, frame, copy)
        self._wrapped += 1
        return Sent(wrap(signed, self._wrapped), frame, copy, self._radio.added_bytes)


class _Heartbeat:
    """MAVLink's heartbeat of a ground station, once a second if the radio needs one."""

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
    """One broadcast of the state in progress: its frames in order of sending, and the number of sends so far."""

    begun_at_s: float
    orders: object
    frames: list[tuple[BroadcastFrame, bytes]]
    longest_bytes: int
    """Length on the air of the longest of the frames."""
    sends: int = 0

    @property
    def told(self) -> bool:
        """Whether every frame was sent once."""
        return self.sends >= len(self.frames)

    @property
    def rounds(self) -> int:
        """Number of times that every frame was sent."""
        return self.sends // len(self.frames)


@dataclass
class _RefreshPlace:
    """Times and indices with which a refresh continues from the one before."""

    due_s: float = float("-inf")
    """Time at which the next refresh is due."""
    not_before_s: float = float("-inf")
    """Earliest time of the next refresh after one that could not be encoded."""
    first_frame: int = 0
    """Index of the state frame with which a refresh begins."""
    next_copy: int = 0
    """Index in the refresh of the frame that is repeated next."""


@dataclass
class _Carousel:
    """The carousel's place in its turn, and the bytes that it may send."""

    place: int = 0
    """Index in the turn of the next frame."""
    due_s: float = float("-inf")
    """Earliest time at which the next turn may begin."""
    credit_bytes: float = 0.0
    """Number of bytes that the carousel has earned and not yet sent."""
    share: float = CAROUSEL_SHARE
    """Share of all bytes sent that the carousel earns."""
    is_needed: bool = False
    """Whether receivers cannot read the state without the carousel's frames."""
    is_urgent: bool = False
    """Whether these frames are needed and no receiver can have them yet, so that they are sent first."""

    def rewind(self) -> None:
        """Let a new turn begin at once."""
        self.place, self.due_s = 0, float("-inf")

    def earn(self, on_air_bytes: int, most_bytes: float) -> None:
        """Add the carousel's share of the bytes sent to its credit, which is at most `most_bytes`."""
        self.credit_bytes = min(self.credit_bytes + self.share * on_air_bytes, most_bytes)

    def is_due(self, now_s: float) -> bool:
        """Return whether a turn is in progress or may begin."""
        return self.place != 0 or now_s >= self.due_s - _DUE_TOLERANCE_S

    def pause(self, now_s: float) -> None:
        """Postpone the next turn, because there were no frames."""
        self.due_s = now_s + SHORTEST_TURN_S

    def pass_over(self, place: int, frames: int, now_s: float) -> None:
        """Skip a frame that could not be encoded."""
        self.place, self.due_s = (place + 1) % frames, now_s + SHORTEST_TURN_S
        self.is_urgent = self.is_urgent and self.place > 0

    def told(self, place: int, frames: int, on_air_bytes: int, sent_at_s: float) -> None:
        """Take note that the frame at a place of the turn was sent."""
        self.credit_bytes -= on_air_bytes
        if self.place == 0:
            self.due_s = _after(self.due_s, SHORTEST_TURN_S, sent_at_s)
        self.place = place + 1
        if self.place >= frames:
            self.place, self.is_urgent = 0, False


class _Schedule:
    """Chooses the frames that are sent over one radio, and when."""

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
        self._picture: tuple[int, int, type[BroadcastFrame]] | None = None
        """Epoch and revision of the picture that is told, and the kind of frame that tells it."""

    def step(self, now_s: float, txbuf_percent: int | None) -> list[Sent]:
        self.pacer.hear_txbuf(txbuf_percent, now_s)
        if self._worked(now_s):
            # The work took time that `now_s` does not include: frames sent now would crowd those of the next call.
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

    @property
    def has_told(self) -> bool:
        """Whether every frame of the refresh was sent."""
        return self._refresh is not None and self._refresh.told

    def _worked(self, now_s: float) -> bool:
        """Do the work that takes longer than choosing a frame, if any is due; return whether it was."""
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
        """Return whether the rest of a refresh is not worth sending: orders or threats changed, or it is too old."""
        age_s = now_s - refresh.begun_at_s
        if refresh.orders != self._station.orders or age_s > LONGEST_REFRESH_S:
            return True
        return age_s >= LEAST_REVISION_S and self._station.is_outdated

    def _is_due(self, refresh: _Refresh, now_s: float) -> bool:
        """Return whether a refresh is complete and the next one is due."""
        return refresh.told and now_s >= self._refreshes.due_s - _DUE_TOLERANCE_S

    def _next(self, now_s: float) -> _Offer | None:
        """Return the frame that is to be sent first now, None if there is none."""
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
            return None  # any other frame would delay the next refresh
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
            # Begin with the frames not sent yet: fast changes of the directive must not keep the last ones off the air.
            assert self._refresh is not None
            place.first_frame += self._refresh.sends
        place.first_frame %= len(frames)
        frames = frames[place.first_frame :] + frames[: place.first_frame]
        self._refresh = _Refresh(now_s, self._station.orders, frames, max(lengths))
        place.due_s = _after(place.due_s, SHORTEST_REFRESH_S, now_s)
        self._waiting = None
        picture = frames[0][0].stamp.epoch_s, _revision_of(frames[0][0]), type(frames[0][0])
        if picture != self._picture:
            self._picture = picture
            self._carousel.rewind()
            slow = self._slow_frames(now_s)
            self._carousel.is_needed = self._carousel.is_urgent = len(slow) > 0 and isinstance(slow[0], MissionFrame)

    def _made(self, now_s: float) -> list[tuple[BroadcastFrame, bytes]]:
        """Return the frames of a new broadcast of the state; those that cannot be encoded are counted and left out.

        Raises:
            InputError: a frame cannot be encoded before anything was sent, so that the mission itself is the reason.

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
        """Send the last state again; receivers know its age from its stamp."""
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
        """Return the next frame of the carousel, None if none is due."""
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


def _revision_of(frame: BroadcastFrame) -> int:
    return frame.revision if isinstance(frame, StateFrame | FleetFrame) else 0


def _after(due_s: float, period_s: float, now_s: float) -> float:
    """Return the next due time of a periodic frame that was due at `due_s` and is sent now."""
    return (due_s if now_s - due_s < _ON_THE_GRID_S else now_s) + period_s
