"""Reader of a telemetry radio's own reports: RADIO_STATUS of MAVLink's common set, and RADIO of older radios."""

from __future__ import annotations

from collections.abc import Callable

from companion.files.mavlink_layout import (
    CRC_BYTES,
    HEADER_V1_BYTES,
    HEADER_V2_BYTES,
    LENGTH_AT,
    MARKER_V1,
    MARKER_V2,
    MESSAGE_ID_V1_AT,
    frame_parts,
)
from companion.protocol.frame import crc_holds

_CRC_EXTRA = {109: 185, 166: 21}
"""CRC_EXTRA by message id: RADIO_STATUS (common.xml) and RADIO (ardupilotmega.xml), whose fields are the same."""
_STATUS_BYTES = 9
"""Length of the payload of both messages."""
_TXBUF_AT = 6
"""Offset of `txbuf` in the payload, after rxerrors and fixed (uint16), rssi and remrssi (uint8)."""


class RadioStatusReader:
    """Finds a radio's own reports among all the bytes that are received from it."""

    def __init__(self) -> None:
        self._pending = b""

    def feed(self, chunk: bytes) -> int | None:
        """Return the free share of the transmit buffer, in percent, from the newest report; None without a new one."""
        self._pending += chunk
        newest = None
        at = 0
        while at < len(self._pending):
            length = _status_length(self._pending[at : at + HEADER_V2_BYTES])
            if length is None:
                at += 1
                continue
            if at + length > len(self._pending):
                break
            txbuf_percent = _txbuf_percent(self._pending[at : at + length])
            if txbuf_percent is None:
                at += 1
            else:
                newest = txbuf_percent
                at += length
        self._pending = self._pending[at:]
        return newest


def read_radio_status() -> Callable[[bytes], int | None]:
    """Return the `feed` of a new RadioStatusReader; `open_sender` takes this function as its argument `radio`."""
    return RadioStatusReader().feed


def _status_length(head: bytes) -> int | None:
    """Return the length of the report that begins with these bytes; None if none can begin with them.

    While too few bytes are known to tell, it is the greatest length possible.
    """
    payload = head[LENGTH_AT : LENGTH_AT + 1]
    if head[0] == MARKER_V1:
        has_id = len(head) > MESSAGE_ID_V1_AT
        is_status = payload in (b"", bytes([_STATUS_BYTES])) and (not has_id or head[MESSAGE_ID_V1_AT] in _CRC_EXTRA)
        return HEADER_V1_BYTES + _STATUS_BYTES + CRC_BYTES if is_status else None
    # Trailing zeros of a payload are not sent. A signature, if any, is skipped as noise: radios sign nothing.
    if head[0] != MARKER_V2 or (payload and not 1 <= payload[0] <= _STATUS_BYTES):
        return None
    if len(head) < HEADER_V2_BYTES:
        return HEADER_V2_BYTES + _STATUS_BYTES + CRC_BYTES
    message_id, _, crc_at, _ = frame_parts(head)
    return crc_at + CRC_BYTES if message_id in _CRC_EXTRA else None


def _txbuf_percent(report: bytes) -> int | None:
    """Return the free share of the transmit buffer, in percent, that a report gives; None if its CRC is wrong."""
    message_id, payload_at, crc_at, _ = frame_parts(report)
    if not crc_holds(report, 0, crc_at, bytes((_CRC_EXTRA[message_id],))):
        return None
    return min(report[payload_at:crc_at].ljust(_STATUS_BYTES, b"\0")[_TXBUF_AT], 100)
