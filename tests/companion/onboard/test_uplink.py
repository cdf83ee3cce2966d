"""The uplink: reports leave as they are, or signed with the vehicle's own key."""

from __future__ import annotations

import asyncio
import socket
from contextlib import ExitStack
from pathlib import Path

import pytest

from companion.errors import InputError
from companion.onboard.config import UplinkSection
from companion.onboard.uplink import open_uplink
from companion.protocol.codec import FrameWriter, ReportFrame
from companion.protocol.frame import raw_frame
from companion.protocol.keys import add_mavlink_keys
from companion.protocol.mavlink_signing import MavlinkVerifier

NOW_S = 1_790_000_000.0
KEY = bytes(range(32))
REPORT = FrameWriter(1, 191).encode(ReportFrame(int(NOW_S), 0, 1, 47.0, 8.0, 1.0, 0.0, 5.0))


def sent(key: Path | None) -> bytes:
    """Return what leaves on an uplink for a report."""
    ear = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ear.bind(("127.0.0.1", 0))
    ear.settimeout(5.0)
    link = f"udpout:127.0.0.1:{ear.getsockname()[1]}"

    async def send() -> None:
        with ExitStack() as stack:
            uplink = await open_uplink(UplinkSection(link=link, key=None if key is None else str(key)), stack)
            assert uplink is not None
            uplink.send([REPORT], NOW_S)

    asyncio.run(send())
    with ear:
        return ear.recv(2048)


def test_without_a_key_a_report_is_sent_as_it_is() -> None:
    assert sent(None) == REPORT


def test_with_a_key_a_report_is_signed_at_its_time(tmp_path: Path) -> None:
    tmp_path.chmod(0o700)
    (path,) = add_mavlink_keys(tmp_path, {"uplink-1.mavlink": KEY})
    frame = raw_frame(sent(path))
    assert MavlinkVerifier(KEY, ahead_s=0.0, behind_s=0.0).check(frame, NOW_S) is None
    assert frame.payload == raw_frame(REPORT).payload


def test_a_key_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"uplink-1\.mavlink: cannot read the key"):
        sent(tmp_path / "uplink-1.mavlink")
