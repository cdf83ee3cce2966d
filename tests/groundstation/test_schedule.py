"""What goes out when: never more than the radio gives, and all of that when there is something to say."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.errors import InputError
from companion.mission.model import parse_mission
from companion.onboard.world_model import WorldModel
from companion.protocol.authenticator import Authenticator, Trust
from companion.protocol.codec import FrameWriter, WireError, decode_frame
from companion.protocol.dialect import oneway
from companion.protocol.ed25519 import FrameSigner
from companion.protocol.frame import raw_frame
from companion.protocol.mavlink_signing import MavlinkSigner
from companion.protocol.messages import BandsFrame, Directive, Kind, MissionFrame, Stamp, StateFrame, TargetEntry
from companion.protocol.v2_extension import unwrap
from groundstation.events import STATION, Direct
from groundstation.ground_station import GroundStation
from groundstation.pacer import LEAST_PACE, Pacer, burst_bytes
from groundstation.radio import parse_radio
from groundstation.schedule import (
    CAROUSEL_SHARE,
    LEAST_REVISION_S,
    LONGEST_REFRESH_S,
    MOST_SENDS,
    TICK_S,
    Broadcaster,
    BroadcastFrame,
    Sent,
)

START_S = 1_790_000_000.0
KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
EPOCH_S = int(START_S)
FRAME_BYTES = len(
    FrameWriter().encode(
        StateFrame(Stamp(EPOCH_S, 1, 1), 47.0, 8.0, Directive.NORMAL, 1, 0, 1, 100, (), (TargetEntry(1, 1.0, 1.0),), ())
    )
)


class Talker:
    """A ground station with a given number of frames to say; the carousel begins with the mission if there is one."""

    def __init__(self, states: int, bands: int = 0, with_mission: bool = False) -> None:
        self.directive = Directive.NORMAL
        self.is_outdated = False
        self.states, self.bands, self.with_mission = states, bands, with_mission
        self.epoch_s = EPOCH_S
        self.sequence = 0
        self.overheard: list[tuple[float, bytes]] = []

    @property
    def orders(self) -> object:
        return self.directive

    def stamp(self, now_s: float) -> Stamp:
        return Stamp(self.epoch_s, round((now_s - self.epoch_s) * 1000.0), self.sequence)

    def advance(self, now_s: float) -> None:
        pass

    def refresh(self, now_s: float, payload_bytes: int) -> list[BroadcastFrame]:
        self.sequence += 1
        target = (TargetEntry(1, 1.0, 1.0),)
        whole = StateFrame(self.stamp(now_s), 47.0, 8.0, self.directive, 1, 0, 1, 100, (), target, ())
        count = self.states
        return [replace(whole, stamp=replace(whole.stamp, frame_index=i, frame_count=count)) for i in range(count)]

    def carousel(self, now_s: float, payload_bytes: int) -> list[BroadcastFrame]:
        stamp, count = self.stamp(now_s), self.bands
        frames: list[BroadcastFrame] = []
        if self.with_mission:
            frames.append(
                MissionFrame(stamp, 1, 47.0, 8.0, 500.0, 100.0, 300.0, bytes(8), 500, 50, 50, "talk", bytes(8))
            )
        return frames + [BandsFrame(replace(stamp, frame_index=i, frame_count=count), ()) for i in range(count)]

    def overhear(self, datagram: bytes, now_s: float) -> None:
        self.overheard.append((now_s, datagram))

    def tick(self, now_s: float) -> list[bytes]:
        return [FrameWriter().encode(self.refresh(now_s, 255)[0])]


class Air:
    """A broadcaster ticking on a virtual clock, and what it sent: (seconds since the start, what)."""

    def __init__(self, station: Talker, radio: str, share: float = 1.0, heartbeat: bool = False) -> None:
        self.station = station
        self.broadcaster = Broadcaster(station, replace(parse_radio(radio, share), heartbeats=heartbeat))
        self.sent: list[tuple[float, Sent]] = []
        self._ticks = 0

    @property
    def now_s(self) -> float:
        return self._ticks * TICK_S

    def to(self, t_s: float, txbuf_percent: int | None = None) -> Air:
        while self.now_s < t_s - 1e-9:
            at_s = self.now_s
            self.sent += [(at_s, sent) for sent in self.broadcaster.step(START_S + at_s, txbuf_percent)]
            self._ticks += 1
        return self

    def count(self, after_s: float = 0.0, until_s: float = float("inf")) -> int:
        return sum(len(sent.data) for at_s, sent in self.sent if after_s <= at_s < until_s)

    def states(self) -> list[tuple[float, StateFrame, int]]:
        return [(at_s, sent.frame, sent.copy) for at_s, sent in self.sent if isinstance(sent.frame, StateFrame)]

    def begun(self) -> list[float]:
        """Return when each refresh began."""
        first: dict[int, float] = {}
        for at_s, frame, _ in self.states():
            first.setdefault(frame.stamp.sequence, at_s)
        return list(first.values())


@given(
    st.floats(20.0, 1e5),
    st.floats(0.0, 3_000.0),
    st.lists(st.tuples(st.floats(0.0, 2.0), st.integers(1, 280), st.none() | st.integers(0, 100)), max_size=60),
)
def test_over_any_time_a_pacer_lets_through_its_rate_and_one_burst_at_most(
    rate_bytes_per_s: float, more_bytes: float, asked: list[tuple[float, int, int | None]]
) -> None:
    most_bytes = 280.0 + more_bytes
    pacer = Pacer(rate_bytes_per_s, most_bytes)
    now_s, passed = START_S, []
    for wait_s, count, txbuf_percent in asked:
        now_s += wait_s
        pacer.hear_txbuf(txbuf_percent, now_s)
        if pacer.take(count, now_s):
            passed.append((now_s, count))
    for first, (begin_s, _) in enumerate(passed):
        total = 0
        for end_s, count in passed[first:]:
            total += count
            assert total <= rate_bytes_per_s * (end_s - begin_s) * (1 + 1e-9) + most_bytes + 1e-2


def test_a_clock_that_steps_back_gives_a_pacer_nothing() -> None:
    pacer = Pacer(100.0, 300.0)
    assert pacer.take(300, START_S)
    assert not pacer.take(100, START_S - 100.0)
    assert not pacer.take(100, START_S - 99.5)
    assert pacer.take(100, START_S - 99.0)


@pytest.mark.slow
@settings(max_examples=25)
@given(
    st.integers(1, 30),
    st.integers(0, 8),
    st.booleans(),
    st.floats(300.0, 20_000.0),
    st.floats(0.1, 1.0),
    st.lists(st.floats(0.01, 0.4), min_size=40, max_size=120),
)
def test_over_any_time_a_broadcast_keeps_to_its_share_whenever_it_is_asked(
    states: int, bands: int, with_mission: bool, rate_bytes_per_s: float, share: float, waits_s: list[float]
) -> None:
    radio = replace(parse_radio(f"{rate_bytes_per_s:.1f}", share), heartbeats=True)
    broadcaster = Broadcaster(Talker(states, bands, with_mission), radio)
    now_s, sent = START_S, []
    try:
        for wait_s in waits_s:
            now_s += wait_s
            sent += [(now_s, len(data)) for data in broadcaster.tick(now_s)]
    except InputError:
        return  # it said so: more than fits
    for first in range(0, len(sent), 7):
        total = 0
        for end_s, count in sent[first:]:
            total += count
            assert total <= radio.budget_bytes_per_s * (end_s - sent[first][0]) + burst_bytes(radio) + 1e-3


@pytest.mark.parametrize(
    ("states", "radio", "share"), [(20, "sik-57600", 0.5), (60, "sik-57600", 1.0), (8, "lora", 0.8)]
)
def test_a_radio_is_used_up_to_two_percent_while_there_is_something_to_say(
    states: int, radio: str, share: float
) -> None:
    air = Air(Talker(states, 3, True), radio, share).to(70.0)
    budget_bytes = parse_radio(radio, share).budget_bytes_per_s * 60.0
    assert 0.98 * budget_bytes <= air.count(10.0, 70.0) <= 1.005 * budget_bytes


def test_a_state_that_fits_is_refreshed_once_a_second() -> None:
    begun = Air(Talker(3), "sik-57600").to(30.0).begun()
    assert begun[0] <= 3 * TICK_S
    assert [round(at_s - begun[0], 2) for at_s in begun] == [float(second) for second in range(30)]


@pytest.mark.parametrize("sends", [1.3, 1.8, 2.2, 2.9])
def test_what_is_sent_beside_it_does_not_keep_the_state_from_its_second(sends: float) -> None:
    rate_bytes_per_s = sends * FRAME_BYTES
    begun = Air(Talker(1, 2), f"{rate_bytes_per_s:.1f}").to(60.0).begun()
    assert len(begun) == 60
    # A frame of the carousel's share, which is a right, may be under way.
    longest_s = 0.1 + 252.0 / rate_bytes_per_s
    assert all(at_s - second < longest_s for second, at_s in enumerate(begun))


def test_a_refresh_that_takes_longer_than_a_second_begins_when_the_last_is_told() -> None:
    air = Air(Talker(30, 1), "1000").to(60.0)
    begun = air.begun()
    takes_s = 30 * FRAME_BYTES / (1_000.0 * (1.0 - CAROUSEL_SHARE))
    assert (begun[-1] - begun[1]) / (len(begun) - 2) == pytest.approx(takes_s, rel=0.02)
    assert {copy for _, _, copy in air.states()} == {0}
    whole = Counter(frame.stamp.sequence for _, frame, _ in air.states())
    assert set(list(whole.values())[:-1]) == {30}


def test_copies_are_spread_over_the_second() -> None:
    air = Air(Talker(1), "sik-57600").to(10.0)
    assert {copy for _, _, copy in air.states()} == set(range(MOST_SENDS))
    begun = air.begun()
    for at_s, frame, copy in air.states():
        assert at_s - begun[frame.stamp.sequence - 1] == pytest.approx(copy / MOST_SENDS, abs=1.5 * TICK_S)


def test_where_only_some_frames_can_be_repeated_all_take_turns() -> None:
    air = Air(Talker(10), str(round(13 * FRAME_BYTES / (1.0 - CAROUSEL_SHARE)))).to(41.0)
    copies = Counter(frame.stamp.frame_index for _, frame, copy in air.states() if copy > 0)
    assert set(copies) == set(range(10))
    assert max(copies.values()) - min(copies.values()) <= 1


def test_nothing_is_repeated_more_often_than_helps() -> None:
    air = Air(Talker(1, 2, True), "1000000").to(10.0)
    whole = Counter(frame.stamp.sequence for _, frame, _ in air.states())
    assert set(whole.values()) == {MOST_SENDS}
    missions = [at_s for at_s, sent in air.sent if isinstance(sent.frame, MissionFrame)]
    assert len(missions) == 10


def test_the_carousel_gets_its_share_of_a_full_radio() -> None:
    air = Air(Talker(100, 5, True), "3000").to(100.0)
    slow = sum(len(s.data) for at_s, s in air.sent if at_s >= 10.0 and not isinstance(s.frame, StateFrame))
    assert slow / air.count(10.0) == pytest.approx(CAROUSEL_SHARE, rel=0.03)
    turns = Counter(s.frame.stamp.frame_index for _, s in air.sent if isinstance(s.frame, BandsFrame))
    assert max(turns.values()) - min(turns.values()) <= 1


def test_what_everything_else_needs_goes_out_first() -> None:
    air = Air(Talker(10, 3, True), "600").to(5.0)
    kinds = [type(sent.frame).__name__ for _, sent in air.sent[:5]]
    assert kinds == ["MissionFrame", "BandsFrame", "BandsFrame", "BandsFrame", "StateFrame"]


def test_where_each_state_frame_says_everything_it_goes_out_first() -> None:
    air = Air(Talker(1, 3), "600").to(5.0)
    assert isinstance(air.sent[0][1].frame, StateFrame)


def test_a_new_epoch_is_told_from_the_beginning() -> None:
    air = Air(Talker(10, 3, True), "2000").to(5.0)
    air.station.epoch_s += 3
    before = len(air.sent)
    air.to(7.0)
    fresh = [
        sent.frame for _, sent in air.sent[before:] if sent.frame is not None and sent.frame.stamp.epoch_s > EPOCH_S
    ]
    later = [type(frame).__name__ for frame in fresh]
    assert "MissionFrame" in later[:2]
    assert "StateFrame" not in later[: later.index("MissionFrame")]


@pytest.mark.slow
@settings(max_examples=30)
@given(st.integers(1, 40), st.floats(0.0, 10.0), st.sampled_from([400, 1_500, 5_760, 20_000]))
def test_a_changed_directive_reaches_everybody_within_two_refreshes(states: int, after_s: float, rate: int) -> None:
    air = Air(Talker(states, 3), str(rate)).to(5.0 + after_s)
    air.station.directive = Directive.HOLD
    changed_s = air.now_s
    interval_s = max(1.0, states * FRAME_BYTES / (rate * (1.0 - CAROUSEL_SHARE)))
    air.to(changed_s + 2.0 * interval_s)
    told = {f.stamp.frame_index for at_s, f, _ in air.states() if at_s >= changed_s and f.directive is Directive.HOLD}
    assert told == set(range(states))
    stale = [f for at_s, f, _ in air.states() if at_s >= changed_s and f.directive is not Directive.HOLD]
    assert stale == []


def test_a_changed_directive_does_not_wait_for_the_refresh_to_end() -> None:
    air = Air(Talker(40), "400").to(8.0)
    air.station.directive = Directive.RETURN
    before = len(air.sent)
    air.to(8.5)
    first = air.sent[before][1].frame
    assert isinstance(first, StateFrame)
    assert first.directive is Directive.RETURN


def test_changed_threats_do_not_wait_for_a_long_refresh_to_end() -> None:
    air = Air(Talker(40), "400").to(LEAST_REVISION_S - 1.0)
    air.station.is_outdated = True
    air.to(LEAST_REVISION_S + 0.5)
    assert len(air.begun()) == 2
    assert air.begun()[1] == pytest.approx(LEAST_REVISION_S, abs=0.5)


def test_threats_that_keep_changing_keep_no_frame_from_the_air() -> None:
    air = Air(Talker(40), "400")
    air.station.is_outdated = True
    told = Counter(frame.stamp.frame_index for _, frame, _ in air.to(60.0).states())
    assert set(told) == set(range(40))


def test_directives_that_keep_changing_keep_no_frame_from_the_air() -> None:
    air = Air(Talker(40), "1000").to(0.05)
    for second in range(60):
        air.station.directive = (Directive.HOLD, Directive.NORMAL)[second % 2]
        air.to(0.5 * second + 0.5)
    told = Counter(frame.stamp.frame_index for _, frame, _ in air.states())
    assert set(told) == set(range(40))
    assert max(told.values()) - min(told.values()) <= 1


@pytest.mark.parametrize(
    ("percent", "slower"), [(0, True), (19, True), (20, True), (49, True), (50, False), (90, False), (100, False)]
)
def test_a_radio_whose_buffer_fills_slows_the_broadcast(percent: int, slower: bool) -> None:
    pacer = Pacer(1_000.0, 300.0)
    pacer.hear_txbuf(percent, START_S)
    assert (pacer.pace < 1.0) == slower


def test_a_very_full_buffer_slows_it_more() -> None:
    low, very_low = Pacer(1_000.0, 300.0), Pacer(1_000.0, 300.0)
    low.hear_txbuf(40, START_S)
    very_low.hear_txbuf(10, START_S)
    assert very_low.pace < low.pace


def test_the_rate_recovers_to_the_budget_and_never_above() -> None:
    air = Air(Talker(60), "3000").to(20.0, 10)
    assert air.broadcaster.pace == LEAST_PACE
    slow = air.count(15.0, 20.0)
    assert slow <= 0.2 * 3_000.0 * 5.0
    air.to(60.0, 100)
    assert air.broadcaster.pace == 1.0
    assert 0.98 * 90_000.0 <= air.to(90.0, 100).count(60.0, 90.0) <= 90_000.0 * 1.01


def test_a_buffer_in_the_middle_leaves_the_rate_as_it_is() -> None:
    pacer = Pacer(1_000.0, 300.0)
    pacer.hear_txbuf(10, START_S)
    slowed = pacer.pace
    for second in range(1, 30):
        pacer.hear_txbuf(70, START_S + second)
    assert pacer.pace == slowed < 1.0


def test_a_radio_that_falls_silent_is_trusted_again_slowly() -> None:
    pacer = Pacer(1_000.0, 300.0)
    pacer.hear_txbuf(10, START_S)
    paces = []
    for second in range(1, 60):
        pacer.hear_txbuf(None, START_S + second)
        paces.append(pacer.pace)
    assert paces == sorted(paces)
    assert paces[0] < 0.7
    assert paces[-1] == 1.0


def test_one_report_counts_once_however_often_it_is_read() -> None:
    pacer = Pacer(1_000.0, 300.0)
    for tick in range(20):
        pacer.hear_txbuf(10, START_S + 0.05 * tick)
    assert pacer.pace == pytest.approx(0.6)


def test_a_refresh_slowed_beyond_what_receivers_accept_begins_anew() -> None:
    air = Air(Talker(40), "600").to(260.0, 5)
    ages_s = [START_S + at_s - frame.stamp.unix_s for at_s, frame, _ in air.states()]
    assert LONGEST_REFRESH_S / 2.0 < max(ages_s) <= LONGEST_REFRESH_S + TICK_S
    assert {frame.stamp.frame_index for _, frame, _ in air.states()} == set(range(40))


def test_a_state_that_a_radio_cannot_carry_is_refused_with_the_remedies() -> None:
    with pytest.raises(InputError) as caught:
        Air(Talker(100), "300", 0.9).to(1.0)
    for part in ("radio 300: ", f"{100 * FRAME_BYTES} bytes", "at most 20 s", "faster radio", "share", "fewer agents"):
        assert part in str(caught.value)
    assert "--auth" not in str(caught.value)


def test_where_ed25519_is_what_does_not_fit_that_is_a_remedy_too() -> None:
    broadcaster = Broadcaster(Talker(100), parse_radio("300", 1.0), FrameSigner(KEY, None))
    with pytest.raises(InputError, match="--auth mavlink instead of Ed25519"):
        [broadcaster.step(START_S + tick * TICK_S) for tick in range(3)]


def test_a_heartbeat_goes_out_every_second_and_keeps_its_own_numbers() -> None:
    air = Air(Talker(60), "2000", heartbeat=True).to(20.0)
    beats = [(at_s, sent.data) for at_s, sent in air.sent if sent.frame is None]
    assert len(beats) == 20
    messages = [oneway.MAVLink(None).parse_buffer(data)[0] for _, data in beats]
    assert {message.get_type() for message in messages} == {"HEARTBEAT"}
    assert {(message.get_srcSystem(), message.get_srcComponent()) for message in messages} == {(254, 190)}
    assert [message.get_seq() for message in messages] == list(range(20))


def test_a_radio_that_is_no_sik_gets_no_heartbeat() -> None:
    broadcaster = Broadcaster(Talker(1), parse_radio("2000", 1.0))
    sent = [one for tick in range(500) for one in broadcaster.step(START_S + tick * TICK_S)]
    assert sent
    assert all(one.frame is not None for one in sent)


def test_in_a_v2_extension_the_whole_outer_frame_counts() -> None:
    air = Air(Talker(60), "2000/v2ext").to(50.0)
    assert 0.98 * 2_000.0 * 40.0 <= air.count(10.0, 50.0) <= 2_000.0 * 40.0 * 1.01
    for _, sent in air.sent:
        inner = unwrap(raw_frame(sent.data))
        assert inner is not None
        assert decode_frame(raw_frame(inner)) == sent.frame
        # Less by the zeros that the inner frame happens to end with.
        assert 15 <= len(sent.data) - len(inner) <= 17


def test_a_signature_that_is_added_to_the_outer_frame_counts_too() -> None:
    air = Air(Talker(60), "2000/v2ext-signed").to(50.0)
    sent = [one for at_s, one in air.sent if at_s >= 10.0]
    assert all(one.on_air_bytes == len(one.data) + 13 for one in sent)
    assert 0.98 * 2_000.0 * 40.0 <= sum(one.on_air_bytes for one in sent) <= 2_000.0 * 40.0 * 1.01


class Failing(Talker):
    """A ground station that cannot make its state, or what goes with it, in some seconds."""

    def __init__(self, failing_s: tuple[float, float], what: str) -> None:
        super().__init__(3, 2)
        self.failing_s, self.what = failing_s, what
        self.asked = 0

    def _fails(self, now_s: float, what: str) -> bool:
        return what == self.what and self.failing_s[0] <= now_s - START_S < self.failing_s[1]

    def refresh(self, now_s: float, payload_bytes: int) -> list[BroadcastFrame]:
        self.asked += 1
        frames = super().refresh(now_s, payload_bytes)
        if self._fails(now_s, "state"):
            raise WireError("no state")
        if self._fails(now_s, "one frame"):
            frames[1] = replace(frames[1], stamp=replace(frames[1].stamp, time_ms=-1))
        return frames

    def carousel(self, now_s: float, payload_bytes: int) -> list[BroadcastFrame]:
        frames = super().carousel(now_s, payload_bytes)
        if self._fails(now_s, "carousel"):
            raise WireError("no carousel")
        if self._fails(now_s, "one band"):
            frames[0] = replace(frames[0], stamp=replace(frames[0].stamp, time_ms=-1))
        return frames


@pytest.mark.parametrize("directive", list(Directive))
def test_while_no_state_can_be_made_the_last_is_told_again(directive: Directive) -> None:
    station = Failing((5.0, 15.0), "state")
    air = Air(station, "sik-57600").to(5.0)
    station.directive = directive
    last = station.sequence
    air.to(15.0)
    told = {frame.stamp.sequence for at_s, frame, _ in air.states() if 5.5 <= at_s < 15.0}
    assert told == {last}
    assert len([one for at_s, one, _ in air.states() if 5.5 <= at_s < 15.0]) >= 3 * 9
    # Once a second, not with every tick.
    assert station.asked <= 20
    assert air.broadcaster.unsendable.first == "no state"
    assert air.broadcaster.unsendable.count >= 9
    air.to(17.0)
    assert air.states()[-1][1].stamp.sequence > last
    assert air.states()[-1][1].directive is directive


def test_a_state_frame_that_cannot_be_made_keeps_no_other_from_the_air() -> None:
    air = Air(Failing((5.0, 15.0), "one frame"), "sik-57600").to(15.0)
    late = [frame.stamp for at_s, frame, _ in air.states() if at_s >= 6.5]
    assert {stamp.frame_index for stamp in late} == {0, 2}
    assert len({stamp.sequence for stamp in late}) >= 8


@pytest.mark.parametrize("what", ["carousel", "one band"])
def test_a_carousel_that_cannot_be_made_keeps_no_state_from_the_air(what: str) -> None:
    air = Air(Failing((5.0, 15.0), what), "sik-57600").to(20.0)
    assert len(air.begun()) == 20
    assert air.broadcaster.unsendable.count >= 4
    assert any(isinstance(sent.frame, BandsFrame) for at_s, sent in air.sent if at_s >= 16.0)


def test_a_state_that_can_never_be_made_is_refused_at_the_beginning() -> None:
    broadcaster = Broadcaster(Failing((0.0, 1.0), "state"), parse_radio("sik-57600", 1.0))
    with pytest.raises(InputError, match="radio sik-57600: the mission cannot be broadcast: no state"):
        broadcaster.begin(START_S)


@pytest.mark.parametrize("share", [0.5, 1.0])
@pytest.mark.parametrize(
    ("frame_signer", "is_sealed"),
    [(None, False), (FrameSigner(None, MavlinkSigner(bytes(32), 0)), False), (FrameSigner(KEY, None), True)],
)
def test_what_does_not_fit_is_refused_before_the_first_frame_with_remedies_that_help(
    frame_signer: FrameSigner | None, is_sealed: bool, share: float
) -> None:
    broadcaster = Broadcaster(Talker(100), parse_radio("300", share), frame_signer)
    with pytest.raises(InputError, match="by a faster radio.* or fewer agents") as caught:
        broadcaster.begin(START_S)
    assert ("--auth mavlink" in str(caught.value)) == is_sealed
    assert ("a greater share" in str(caught.value)) == (share < 1.0)


def test_nothing_is_sent_in_a_tick_in_which_the_station_worked() -> None:
    # What it costs is not in the tick's time: bytes sent then would be followed too soon by the next tick's.
    worked: list[float] = []

    class Slow(Talker):
        def advance(self, now_s: float) -> None:
            worked.append(now_s)

        def refresh(self, now_s: float, payload_bytes: int) -> list[BroadcastFrame]:
            worked.append(now_s)
            return super().refresh(now_s, payload_bytes)

    air = Air(Slow(30, 2), "5760").to(20.0)
    assert len(worked) >= 30
    assert {START_S + at_s for at_s, _ in air.sent}.isdisjoint(worked)


def test_without_a_radio_the_stations_own_frames_are_sealed_as_they_come() -> None:
    signer = MavlinkSigner(bytes(32), 0)
    broadcaster = Broadcaster(Talker(1), None, FrameSigner(KEY, signer))
    (data,) = broadcaster.tick(START_S)
    assert data[2] == 1
    assert len(data) == 12 + 163 + 64 + 13
    assert broadcaster.pace == 1.0


def test_everything_is_sealed_when_it_is_first_wanted_and_a_copy_is_signed_anew() -> None:
    frame_signer = FrameSigner(KEY, MavlinkSigner(bytes(32), 0))
    broadcaster = Broadcaster(Talker(1, 1), parse_radio("sik-57600", 1.0), frame_signer)
    sent = [s for tick in range(200) for s in broadcaster.step(START_S + tick * TICK_S)]
    times = [int.from_bytes(s.data[-12:-6], "little") for s in sent]
    assert times == sorted(set(times))
    states = [s.data for s in sent if isinstance(s.frame, StateFrame)]
    assert len({data[:-15] for data in states}) == 2
    assert {len(s.data) for s in sent if s.frame is None} == {21 + 13}


def test_the_reckoner_hears_each_frame_once_when_it_first_goes_out() -> None:
    air = Air(Talker(30, 2), "1000").to(10.0)
    first = [(at_s, sent) for at_s, sent in air.sent if sent.copy == 0 and sent.frame is not None]
    assert len(air.station.overheard) == len(first)
    assert [round(heard_s - START_S, 2) for heard_s, _ in air.station.overheard] == [
        round(at_s, 2) for at_s, _ in first
    ]


MANY = """
agents: [{agents}]
targets: [{{id: 1, north_m: 20000, east_m: 0}}, {{id: 2, north_m: 20000, east_m: 9000}}]
threats: [{{id: 1, north_m: 10000, east_m: 0, detection_radius_m: 3000, attack_radius_m: 1000, floor_m: 100}}]
"""


class Flight:
    """A real ground station, its radio, and the pictures of all agents, heard through their authenticator."""

    def __init__(self, agents: int, radio: str, case: str = "I") -> None:
        listed = ", ".join(f"{{id: {one}, north_m: 0, east_m: {500 * one}}}" for one in range(1, agents + 1))
        mission = parse_mission(MANY.format(agents=listed) + f"case: {case}\n", "many")
        self.station = GroundStation(mission, START_S, sensed=False)
        frame_signer = FrameSigner(KEY, MavlinkSigner(bytes(32), 0))
        self.broadcaster = Broadcaster(self.station, parse_radio(radio, 1.0), frame_signer)
        self.authenticator = Authenticator(Trust(bytes(32), KEY.public_key()))
        self.pictures = {one: WorldModel(one) for one in range(1, agents + 1)}
        self.kinds: set[str] = set()
        self.now_s = START_S

    def for_s(self, lasting_s: float) -> Flight:
        end_s = self.now_s + lasting_s
        while self.now_s < end_s - 1e-9:
            for data in self.broadcaster.tick(self.now_s):
                for _, frame in self.authenticator.admit(unwrap(raw_frame(data)) or data, self.now_s):
                    self.kinds.add(type(frame).__name__)
                    for picture in self.pictures.values():
                        picture.take(frame, self.now_s)
            self.now_s += TICK_S
        return self


@pytest.mark.parametrize(
    ("agents", "radio", "kinds"),
    [
        (10, "sik-57600", {"StateFrame", "MotionFrame", "BandsFrame"}),
        (11, "sik-57600", {"FleetFrame", "RadiiFrame", "MissionFrame"}),
        (2, "sik-57600/v2ext-signed", {"FleetFrame", "RadiiFrame", "MissionFrame"}),
    ],
)
def test_what_one_state_frame_holds_travels_in_one_and_everything_else_packed(
    agents: int, radio: str, kinds: set[str]
) -> None:
    assert Flight(agents, radio).for_s(3.0).kinds == kinds


@pytest.mark.parametrize("agents", [10, 60])
def test_every_agent_knows_its_target_and_the_threat_and_is_told_of_a_directive(agents: int) -> None:
    flight = Flight(agents, "sik-57600").for_s(2.0)
    for identity, picture in flight.pictures.items():
        assert picture.target_id == flight.station.assignment.get(identity)
        assert picture.directives.in_force is Directive.NORMAL
        assert list(picture.view(flight.now_s).threat_ids) == [1]
    assert flight.station.assignment
    flight.station.command(Direct(do="direct", directive="return"), STATION, flight.now_s)
    flight.for_s(2.0)
    assert {picture.directives.in_force for picture in flight.pictures.values()} == {Directive.RETURN}
    assert flight.authenticator.rejected.keys() <= {"heartbeat", "repeated"}


def test_a_picture_of_heights_comes_with_the_radii() -> None:
    flight = Flight(11, "sik-57600").for_s(2.0)
    view = flight.pictures[1].view(flight.now_s, band_m=(0.0, 50.0))
    assert list(view.threat_ids) == []


def test_in_case_ii_reckoned_agents_hear_what_is_packed() -> None:
    flight = Flight(11, "sik-57600", "II").for_s(5.0)
    before = {one: flight.station.tracks.tracks[Kind.AGENT, one].position_ned_m for one in flight.station.assignment}
    flight.for_s(5.0)
    after = {one: flight.station.tracks.tracks[Kind.AGENT, one].position_ned_m for one in flight.station.assignment}
    targets = {1: (20_000.0, 0.0), 2: (20_000.0, 9_000.0)}
    assert flight.station.assignment
    for one, target in flight.station.assignment.items():
        assert math.dist(after[one], targets[target]) < math.dist(before[one], targets[target]) - 100.0
