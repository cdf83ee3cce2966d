"""Serial links over pairs of pseudo-terminals: a paced 57600-baud radio, its reports, unplugging and plugging in."""

from __future__ import annotations

import asyncio
import errno
import itertools
import os
import tty
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega

from companion.errors import InputError
from companion.protocol.radio_status import RadioStatusReader, read_radio_status
from companion.transport import serial as serial_module
from companion.transport.endpoints import Link, Sender, open_receiver, open_sender
from groundstation.pacer import Pacer, burst_bytes
from groundstation.radio import parse_radio
from groundstation.schedule import TICK_S

BAUD = 57600
DRAIN_BYTES_PER_S = 5760.0
"""A start and a stop bit with each byte."""
RADIO_BUFFER_BYTES = 1024
_MAV = ardupilotmega.MAVLink(None, srcSystem=51, srcComponent=68)


def status(txbuf_percent: int, *, version: int = 2, older: bool = False) -> bytes:
    """Return a report as a radio sends it; 200 stands for unknown strengths."""
    kind = ardupilotmega.MAVLink_radio_message if older else ardupilotmega.MAVLink_radio_status_message
    return bytes(kind(200, 200, txbuf_percent, 30, 30, 0, 0).pack(_MAV, force_mavlink1=version == 1))


def run(body: Callable[[], Awaitable[None]]) -> None:
    async def within_time() -> None:
        await asyncio.wait_for(body(), 20.0)

    asyncio.run(within_time())


async def until(condition: Callable[[], bool]) -> None:
    for _ in range(2500):
        if condition():
            return
        await asyncio.sleep(0.002)
    raise AssertionError("it never came")


@dataclass
class Cable:
    """One pseudo-terminal: the far end is held by the test, the near end has a path like a plugged-in device."""

    path: Path
    far: int = field(init=False)

    def __post_init__(self) -> None:
        self.far, near = os.openpty()
        tty.setraw(near)
        os.set_blocking(self.far, False)
        self.path.unlink(missing_ok=True)
        self.path.symlink_to(os.ttyname(near))
        os.close(near)

    @property
    def link(self) -> Link:
        return Link("serial", path=str(self.path), baud=BAUD)

    def read(self) -> bytes:
        try:
            return os.read(self.far, 65_536)
        except BlockingIOError:
            return b""
        except OSError as error:
            # Nobody has the near end open.
            assert error.errno == errno.EIO
            return b""

    def unplug(self) -> None:
        os.close(self.far)
        self.far = -1
        self.path.unlink()


@pytest.fixture
def cable(tmp_path: Path) -> Iterator[Cable]:
    plugged = Cable(tmp_path / "radio")
    yield plugged
    if plugged.far >= 0:
        os.close(plugged.far)


def test_a_senders_bytes_come_out_unchanged_at_the_far_end(cable: Cable) -> None:
    async def body() -> None:
        sender = await open_sender(cable.link, read_radio_status)
        every_byte = bytes(range(256))
        sender.send(every_byte)
        got = bytearray()

        def all_read() -> bool:
            got.extend(cable.read())
            return len(got) >= 256

        await until(all_read)
        assert bytes(got) == every_byte
        assert sender.counts.sent == 1
        sender.close()
        sender.send(b"late")
        assert sender.counts.failed == 1

    run(body)


def test_a_receiver_hands_on_every_byte_as_a_stream(cable: Cable) -> None:
    async def body() -> None:
        heard: list[bytes] = []
        receiver = await open_receiver(cable.link, heard.append)
        assert receiver.is_stream
        every_byte = bytes(range(256))
        for at in range(0, 256, 7):
            os.write(cable.far, every_byte[at : at + 7])
        await until(lambda: len(b"".join(heard)) == 256)
        assert b"".join(heard) == every_byte
        assert receiver.counts.chunks == len(heard)
        receiver.close()

    run(body)


def test_a_receivers_device_is_open_for_reading_only_and_echoes_nothing(
    cable: Cable, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[int] = []
    opening = os.open

    def remembered(path: str, flags: int) -> int:
        opened.append(opening(path, flags))
        return opened[-1]

    monkeypatch.setattr(os, "open", remembered)

    async def body() -> None:
        heard: list[bytes] = []
        receiver = await open_receiver(cable.link, heard.append)
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.write(opened[-1], b"must not leave")
        os.write(cable.far, b"heard\n\x03\x11")
        await until(lambda: b"".join(heard) == b"heard\n\x03\x11")
        assert cable.read() == b""
        receiver.close()

    run(body)


@dataclass
class Radio:
    """The far end of the cable: a modem that takes in at once what comes, and sends it on over the air at its rate."""

    cable: Cable
    bytes_per_s: float = DRAIN_BYTES_PER_S
    buffer_bytes: int = RADIO_BUFFER_BYTES
    taken: bytearray = field(default_factory=bytearray)
    backlog_bytes: float = 0.0
    deepest_bytes: float = 0.0
    overruns_at_s: list[float] = field(default_factory=list)
    _counted_bytes: int = 0

    def listen(self) -> int:
        """Take in what has come, and return how many bytes that is in all."""
        self.taken += self.cable.read()
        return len(self.taken)

    def pass_on(self, now_s: float, step_s: float) -> None:
        """Put what came since the last step into the buffer, then send on what the air carries in a step."""
        self.backlog_bytes += len(self.taken) - self._counted_bytes
        self._counted_bytes = len(self.taken)
        self.deepest_bytes = max(self.deepest_bytes, self.backlog_bytes)
        if self.backlog_bytes > self.buffer_bytes:
            self.overruns_at_s.append(now_s)
            self.backlog_bytes = self.buffer_bytes
        self.backlog_bytes = max(self.backlog_bytes - self.bytes_per_s * step_s, 0.0)

    def report(self) -> None:
        free_percent = round(100.0 * (1.0 - self.backlog_bytes / self.buffer_bytes))
        os.write(self.cable.far, status(free_percent))


@dataclass
class Talk:
    """A sender that always has something to say, its pacer, and the radio; on a virtual clock."""

    sender: Sender
    pacer: Pacer
    radio: Radio
    offered: Iterator[bytes]
    sent: bytearray = field(default_factory=bytearray)
    now_s: float = 0.0
    _next: bytes = b""

    async def go_on(self, duration_s: float, report_period_s: float | None = None) -> None:
        ends_s = self.now_s + duration_s
        report_due_s = self.now_s
        while self.now_s < ends_s - 1e-9:
            self.pacer.hear_txbuf(self.sender.txbuf_percent, self.now_s)
            while self.pacer.take(len(self._next), self.now_s):
                self.sender.send(self._next)
                self.sent += self._next
                self._next = next(self.offered)
            await until(lambda: self.radio.listen() >= len(self.sent))
            self.radio.pass_on(self.now_s, TICK_S)
            self.now_s += TICK_S
            if report_period_s is not None and self.now_s >= report_due_s - 1e-9:
                report_due_s += report_period_s
                self.radio.report()
                # The report is heard before the clock goes on.
                await asyncio.sleep(0.005)


def paced(share: float) -> Pacer:
    """Return what paces the ground station on this radio."""
    radio = parse_radio("sik-57600", share)
    return Pacer(radio.budget_bytes_per_s, burst_bytes(radio))


def frames_of_any_length() -> Iterator[bytes]:
    return (bytes([index % 256]) * (20 + 37 * index % 233) for index in itertools.count())


@pytest.mark.parametrize("share", [0.25, 1.0])
def test_what_is_sent_keeps_to_the_budget_and_overruns_no_radio(cable: Cable, share: float) -> None:
    async def body() -> None:
        budget_bytes_per_s = share * DRAIN_BYTES_PER_S
        radio = Radio(cable)
        sender = await open_sender(cable.link, read_radio_status)
        talk = Talk(sender, paced(share), radio, frames_of_any_length())
        await talk.go_on(TICK_S)
        began_bytes = len(talk.sent)
        await talk.go_on(60.0)
        assert radio.taken == talk.sent
        assert len(talk.sent) - began_bytes == pytest.approx(60.0 * budget_bytes_per_s, rel=0.02)
        assert radio.overruns_at_s == []
        assert (sender.counts.full, sender.counts.failed) == (0, 0)
        sender.close()

    run(body)


def test_a_radio_that_reports_a_full_buffer_is_overrun_no_more(cable: Cable) -> None:
    async def body() -> None:
        air_bytes_per_s = 2000.0
        radio = Radio(cable, air_bytes_per_s, 2048)
        sender = await open_sender(cable.link, read_radio_status)
        talk = Talk(sender, paced(1.0), radio, frames_of_any_length())
        await talk.go_on(10.0, report_period_s=1.0)
        assert radio.overruns_at_s != []
        radio.overruns_at_s.clear()
        began_bytes = len(talk.sent)
        await talk.go_on(60.0, report_period_s=1.0)
        assert radio.overruns_at_s == []
        assert len(talk.sent) - began_bytes == pytest.approx(60.0 * air_bytes_per_s, rel=0.1)
        sender.close()

    run(body)


def test_a_radio_that_stalls_costs_frames_but_no_torn_one(cable: Cable) -> None:
    async def body() -> None:
        sender = await open_sender(cable.link, read_radio_status)
        radio = Radio(cable)
        frames = (bytes([number % 256]) * 200 for number in itertools.count())
        sent = b""

        def send_next() -> None:
            nonlocal sent
            before, frame = sender.counts.sent, next(frames)
            sender.send(frame)
            sent += frame * (sender.counts.sent - before)

        while sender.counts.full < 3:
            send_next()
        # There is room again, but the rest of the last frame has not gone out yet.
        radio.listen()
        send_next()
        assert sender.counts.full == 4
        await until(lambda: radio.listen() == len(sent))
        send_next()
        await until(lambda: radio.listen() == len(sent))
        assert radio.taken == sent
        assert sender.counts.full == 4
        sender.close()

    run(body)


def test_a_sender_knows_what_its_radio_last_reported(cable: Cable) -> None:
    async def body() -> None:
        sender = await open_sender(cable.link, read_radio_status)
        assert sender.txbuf_percent is None
        for percent in (73, 0, 100):
            os.write(cable.far, b"\xfe\xfdnoise" + status(percent))
            await until(lambda percent=percent: sender.txbuf_percent == percent)  # type: ignore[misc]
        sender.close()

    run(body)


def test_an_old_report_says_nothing_about_now(cable: Cable, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_module, "TXBUF_VALID_S", 0.05)

    async def body() -> None:
        sender = await open_sender(cable.link, read_radio_status)
        os.write(cable.far, status(40))
        await until(lambda: sender.txbuf_percent == 40)
        await until(lambda: sender.txbuf_percent is None)
        sender.close()

    run(body)


def test_nothing_else_that_comes_back_changes_what_a_sender_does(cable: Cable) -> None:
    async def body() -> None:
        sender = await open_sender(cable.link, read_radio_status)
        radio = Radio(cable)
        os.write(cable.far, bytes(ardupilotmega.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(_MAV)) * 50)
        os.write(cable.far, os.urandom(2000))
        await asyncio.sleep(0.02)
        sender.send(b"as before")
        await until(lambda: radio.listen() >= 9)
        assert radio.taken == b"as before"
        assert sender.counts.sent == 1
        sender.close()

    run(body)


@pytest.mark.parametrize("older", [False, True])
@pytest.mark.parametrize("version", [1, 2])
def test_a_report_is_read_in_both_versions_and_both_kinds(version: int, older: bool) -> None:
    assert RadioStatusReader().feed(status(57, version=version, older=older)) == 57


def test_a_report_whose_last_fields_are_zero_is_read_though_they_are_not_sent() -> None:
    empty = bytes(ardupilotmega.MAVLink_radio_status_message(0, 0, 0, 0, 0, 1, 0).pack(_MAV))
    assert len(empty) < len(status(1))
    assert RadioStatusReader().feed(empty) == 0


def test_more_than_all_of_a_buffer_counts_as_all() -> None:
    assert RadioStatusReader().feed(status(255)) == 100


@given(st.binary(max_size=60), st.binary(max_size=20), st.integers(1, 9), st.sampled_from([1, 2]))
def test_a_report_is_found_behind_noise_however_it_is_cut(noise: bytes, tail: bytes, cut: int, version: int) -> None:
    stream = noise + status(64, version=version) + tail + bytes(30)
    reader = RadioStatusReader()
    found = [reader.feed(stream[at : at + cut]) for at in range(0, len(stream), cut)]
    assert 64 in found


@given(st.integers(0, 16), st.integers(1, 255))
def test_a_report_with_one_changed_byte_is_none(at: int, change: int) -> None:
    report = bytearray(status(64, version=1))
    report[at] ^= change
    assert RadioStatusReader().feed(bytes(report) + bytes(30)) is None


@given(st.lists(st.binary(max_size=300), max_size=30))
def test_whatever_comes_back_no_more_than_one_report_is_kept_waiting(chunks: list[bytes]) -> None:
    reader = RadioStatusReader()
    for chunk in chunks:
        reader.feed(chunk)
    assert len(reader._pending) < len(status(1))


def test_a_sender_goes_on_when_its_radio_is_plugged_in_again(cable: Cable, quick_reopening: None) -> None:
    async def body() -> None:
        sender = await open_sender(cable.link, read_radio_status)
        os.write(cable.far, status(40))
        await until(lambda: sender.txbuf_percent == 40)
        cable.unplug()
        await until(lambda: sender.counts.failed == 1)
        assert sender.txbuf_percent is None
        sender.send(b"to nobody")
        assert (sender.counts.sent, sender.counts.failed) == (0, 2)
        plugged_in = Radio(Cable(cable.path))
        await until(lambda: sender.counts.reopened == 1)
        sender.send(b"back")
        await until(lambda: plugged_in.listen() >= 4)
        assert plugged_in.taken == b"back"
        sender.close()

    run(body)


def test_a_receiver_goes_on_when_its_radio_is_plugged_in_again(cable: Cable, quick_reopening: None) -> None:
    async def body() -> None:
        heard: list[bytes] = []
        receiver = await open_receiver(cable.link, heard.append)
        for unplugged in (1, 2, 3):
            cable.unplug()
            await until(lambda unplugged=unplugged: receiver.counts.failed == unplugged)  # type: ignore[misc]
            cable.__post_init__()
            await until(lambda unplugged=unplugged: receiver.counts.reopened == unplugged)  # type: ignore[misc]
            os.write(cable.far, b"%d" % unplugged)
            await until(lambda unplugged=unplugged: b"".join(heard)[-1:] == b"%d" % unplugged)  # type: ignore[misc]
        receiver.close()

    run(body)


def test_an_end_closed_while_its_radio_is_unplugged_stays_closed(cable: Cable, quick_reopening: None) -> None:
    async def body() -> None:
        receiver = await open_receiver(cable.link, lambda _: None)
        cable.unplug()
        await until(lambda: receiver.counts.failed == 1)
        receiver.close()
        cable.__post_init__()
        await asyncio.sleep(0.1)
        assert receiver.counts.reopened == 0

    run(body)


@pytest.fixture
def quick_reopening(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_module, "REOPEN_FIRST_S", 0.01)
    monkeypatch.setattr(serial_module, "REOPEN_MAX_S", 0.02)


def test_a_device_that_is_missing_or_none_is_an_error_in_one_line(tmp_path: Path) -> None:
    async def body() -> None:
        absent = Link("serial", path=str(tmp_path / "absent"), baud=BAUD)
        plain = tmp_path / "plain"
        plain.write_bytes(b"")
        for opening in (open_sender, lambda link: open_receiver(link, lambda _: None)):
            with pytest.raises(InputError, match="absent:57600': no such device"):
                await opening(absent)
            with pytest.raises(InputError, match="plain:57600': not a serial device"):
                await opening(Link("serial", path=str(plain), baud=BAUD))

    run(body)
