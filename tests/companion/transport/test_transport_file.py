"""A telemetry log as a link: what one end writes the other plays back, at the same pace."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from companion.errors import InputError
from companion.files.tlog import TlogWriter, read_tlog
from companion.protocol.dialect import oneway
from companion.transport.endpoints import Link, open_receiver, open_sender
from companion.transport.file import FileSender
from tests.companion.transport.end_points import run, until

_MAV = oneway.MAVLink(None, srcSystem=7, srcComponent=1)
FRAMES = [
    bytes(oneway.MAVLink_heartbeat_message(2, 3, custom_mode, 1, 4, 3).pack(_MAV)) for custom_mode in (5, 6, 7, 8)
]


def log_of(folder: Path, stamps_s: list[float]) -> Link:
    with TlogWriter(folder / "given.tlog") as writer:
        for stamp_s, frame in zip(stamps_s, FRAMES, strict=True):
            writer.write(stamp_s, frame)
    return Link("file", path=str(folder / "given.tlog"))


def test_what_is_sent_to_a_file_is_played_back_from_it(tmp_path: Path) -> None:
    async def body() -> None:
        link = Link("file", path=str(tmp_path / "sent.tlog"))
        sender = await open_sender(link)
        for frame in FRAMES:
            sender.send(frame)
        assert [frame for _, frame in read_tlog(link.path)] == FRAMES
        assert sender.counts.sent == len(FRAMES)
        heard: list[bytes] = []
        receiver = await open_receiver(link, heard.append)
        await until(lambda: heard == FRAMES)
        assert receiver.counts.chunks == len(FRAMES)
        receiver.close()
        sender.close()

    run(body)


def test_a_log_is_played_at_the_pace_at_which_it_was_recorded(tmp_path: Path) -> None:
    async def body() -> None:
        loop = asyncio.get_running_loop()
        times_s: list[float] = []
        link = log_of(tmp_path, [1e9, 1e9 + 0.1, 1e9 + 0.1, 1e9 + 0.3])
        began_s = loop.time()
        receiver = await open_receiver(link, lambda _: times_s.append(loop.time() - began_s))
        await until(lambda: len(times_s) == 4)
        # Never early; how late is the computer's affair.
        assert all(time_s >= due_s - 0.01 for time_s, due_s in zip(times_s, (0.0, 0.1, 0.1, 0.3), strict=True))
        assert times_s[0] < 0.09
        receiver.close()

    run(body)


def test_a_record_older_than_the_one_before_is_played_at_once(tmp_path: Path) -> None:
    async def body() -> None:
        heard: list[bytes] = []
        receiver = await open_receiver(log_of(tmp_path, [1e9, 1e9 - 3600.0, 0.0, 1e9]), heard.append)
        await until(lambda: heard == FRAMES)
        receiver.close()

    run(body)


def test_a_closed_playback_hands_on_nothing_more(tmp_path: Path) -> None:
    async def body() -> None:
        heard: list[bytes] = []
        receiver = await open_receiver(log_of(tmp_path, [1e9, 1e9 + 0.02, 1e9 + 0.02, 1e9 + 0.02]), heard.append)
        await until(lambda: bool(heard))
        receiver.close()
        await asyncio.sleep(0.05)
        assert heard == FRAMES[:1]

    run(body)


def test_a_damaged_log_is_played_on_and_its_places_are_counted(tmp_path: Path) -> None:
    async def body() -> None:
        link = log_of(tmp_path, [1e9] * 4)
        path = Path(link.path)
        path.write_bytes(bytes(100) + path.read_bytes() + b"this is no record")
        heard: list[bytes] = []
        receiver = await open_receiver(link, heard.append)
        await until(lambda: heard == FRAMES)
        assert receiver.counts.failed == 2
        receiver.close()

    run(body)


def test_a_log_whose_clock_was_set_is_played_without_a_pause(tmp_path: Path) -> None:
    async def body() -> None:
        heard: list[bytes] = []
        receiver = await open_receiver(log_of(tmp_path, [10.0, 10.01, 1e9, 1e9 + 0.01]), heard.append)
        await until(lambda: heard == FRAMES)
        receiver.close()

    run(body)


def test_a_log_that_is_missing_or_cannot_be_written_is_an_error_in_one_line(tmp_path: Path) -> None:
    async def body() -> None:
        link = Link("file", path=str(tmp_path / "nowhere" / "x.tlog"))
        with pytest.raises(InputError, match="cannot read the log: No such file"):
            await open_receiver(link, lambda _: None)
        with pytest.raises(InputError, match="cannot write the log: No such file"):
            await open_sender(link)

    run(body)


def test_what_is_no_frame_is_counted_and_not_written(tmp_path: Path) -> None:
    async def body() -> None:
        link = Link("file", path=str(tmp_path / "sent.tlog"))
        sender = await open_sender(link)
        sender.send(b"noise")
        sender.send(FRAMES[0] + b"noise")
        sender.send(FRAMES[1])
        assert [frame for _, frame in read_tlog(link.path)] == [FRAMES[1]]
        assert (sender.counts.sent, sender.counts.failed) == (1, 2)
        sender.close()
        sender.send(FRAMES[2])
        assert sender.counts.failed == 3

    run(body)


class FullDisk:
    def write(self, _data: bytes) -> int:
        raise OSError(28, "No space left on device")

    def flush(self) -> None:
        raise OSError(28, "No space left on device")


def test_a_full_disk_is_counted_and_not_raised() -> None:
    sender = FileSender(TlogWriter(FullDisk()))  # type: ignore[arg-type]
    sender.send(FRAMES[0])
    sender.close()
    assert (sender.counts.sent, sender.counts.failed) == (0, 2)
