"""Inputs to fuzz parsers with: random ones, valid ones that were damaged, and whole frames with random content."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Sequence

from companion.files.mavlink_layout import HEADER_V1_BYTES, HEADER_V2_BYTES, MARKER_V1, MARKER_V2, frame_length
from companion.protocol.frame import crc_bytes, raw_frame

MOST_RANDOM_BYTES = 300
MOST_PARTS = 4
"""Most inputs that one concatenation has."""
WORDS = (
    b"&a ", b"*a", b"[", b"]", b"{", b"}", b": ", b"- ", b"? ", b"<<: ", b"!!int ", b"!!binary ", b"!!set ",
    b"!!python/object:os.system ", b"---\n", b"...\n", b"%YAML 9.9\n", b"1e999", b"-1e999", b".nan", b".inf", b"-.inf",
    b"9" * 400, b"0x", b"null", b"~", b"true", b'"', b"'", b"\\", b"\\x00", b"\0", b"\xff", b"\xc3\x28",
    b"\xef\xbb\xbf",
    b"\t", b"\n", b"\r", b"|\n", b">\n", b"#", b"@", b"`", b",", b"-1", b"4294967296", b"-----BEGIN PUBLIC KEY-----\n",
    b"-----END PUBLIC KEY-----\n", b"====", b"NaN", b"Infinity", b"[" * 60, b"{a: " * 30,
)  # fmt: skip
"""Pieces that mean something to a parser of text."""
_FLOATS = tuple(struct.pack("<f", value) for value in (float("nan"), float("inf"), -float("inf"), 1e38, -0.0, 1e-45))


class Frames:
    """Makes MAVLink datagrams from valid frames; `kinds` has CRC_EXTRA and greatest payload of the messages known."""

    def __init__(self, rng: random.Random, valid: Sequence[bytes], kinds: dict[int, tuple[int, int]]) -> None:
        self._rng = rng
        self._valid = list(valid)
        self._kinds = kinds
        self._ids = tuple(kinds)
        self._makers: tuple[Callable[[], bytes], ...] = (
            self._noise,
            self._whole,
            self._flipped,
            self._cut,
            self._repaired,
            self._repaired,
            self._filled,
            self._filled,
        )

    def __call__(self) -> bytes:
        """Return the next input."""
        if self._rng.random() < 0.15:
            parts = [self._one() for _ in range(self._rng.randrange(2, MOST_PARTS + 1))]
            joined = b"".join(parts)
            return joined[self._rng.randrange(20) :]
        return self._one()

    def _one(self) -> bytes:
        return self._rng.choice(self._makers)()

    def _noise(self) -> bytes:
        return self._rng.randbytes(self._rng.randrange(MOST_RANDOM_BYTES))

    def _whole(self) -> bytes:
        return self._rng.choice(self._valid)

    def _flipped(self) -> bytes:
        raw = bytearray(self._whole())
        for _ in range(self._rng.randrange(1, 9)):
            raw[self._rng.randrange(len(raw))] ^= 1 << self._rng.randrange(8)
        return bytes(raw)

    def _cut(self) -> bytes:
        raw = self._whole()
        return raw[: self._rng.randrange(len(raw))]

    def _repaired(self) -> bytes:
        """Return a valid frame with other content, and perhaps other ids or length, and a right CRC."""
        raw = bytearray(self._whole())
        if frame_length(bytes(raw)) != len(raw):
            return bytes(raw)
        frame = raw_frame(bytes(raw))
        payload = bytearray(frame.payload)
        for _ in range(self._rng.randrange(1, 6)):
            if payload:
                payload[self._rng.randrange(len(payload))] = self._rng.choice(
                    (0, 1, 127, 128, 255, self._rng.randrange(256))
                )
        if self._rng.random() < 0.2:
            payload = payload[: self._rng.randrange(len(payload) + 1)]
        sender = frame.sender if self._rng.random() < 0.8 else (self._rng.randrange(256), self._rng.randrange(256))
        return self._frame(frame.version, frame.message_id, bytes(payload), sender)

    def _filled(self) -> bytes:
        """Return a frame of any known message, filled with one kind of content, from a usual sender."""
        number = self._rng.choice(self._ids)
        _, most = self._kinds[number]
        length = self._rng.randrange(most + 1) if self._rng.random() < 0.5 else most
        fill = self._rng.randrange(4)
        if fill == 0:
            payload = self._rng.randbytes(length)
        elif fill == 1:
            payload = bytes((self._rng.choice((0x00, 0x7F, 0x80, 0xFF)),)) * length
        elif fill == 2:
            payload = (self._rng.choice(_FLOATS) * (length // 4 + 1))[:length]
        else:
            payload = b"".join(self._rng.choice(_FLOATS) for _ in range(length // 4 + 1))[:length]
        sender = self._rng.choice(((1, 1), (254, 190), (254, 191), (1, 191), (255, 190), (2, 1)))
        version = 1 if number < 256 and self._rng.random() < 0.2 else 2
        return self._frame(version, number, payload, sender)

    def _frame(self, version: int, number: int, payload: bytes, sender: tuple[int, int]) -> bytes:
        extra = bytes((self._kinds.get(number, (0, 0))[0],))
        sequence = self._rng.randrange(256)
        if version == 1:
            head = bytes((MARKER_V1, len(payload), sequence, *sender, number & 0xFF))
            assert len(head) == HEADER_V1_BYTES
        else:
            head = bytes((MARKER_V2, len(payload), 0, 0, sequence, *sender)) + number.to_bytes(3, "little")
            assert len(head) == HEADER_V2_BYTES
        return head + payload + crc_bytes(head + payload, extra)


class Texts:
    """Makes texts, and what is hardly one any more, from valid ones."""

    def __init__(self, rng: random.Random, valid: Sequence[bytes]) -> None:
        self._rng = rng
        self._valid = list(valid)

    def __call__(self) -> bytes:
        """Return the next input."""
        rng = self._rng
        if rng.random() < 0.1:
            return rng.randbytes(rng.randrange(MOST_RANDOM_BYTES))
        text = bytearray(rng.choice(self._valid))
        for _ in range(rng.randrange(1, 5)):
            at = rng.randrange(len(text) + 1)
            to = min(len(text), at + rng.randrange(1, 20))
            kind = rng.randrange(6)
            if kind == 0:
                text[at:at] = rng.choice(WORDS)
            elif kind == 1:
                text[at:to] = rng.choice(WORDS)
            elif kind == 2:
                del text[at:to]
            elif kind == 3:
                text[at:at] = text[at:to] * rng.randrange(1, 4)
            elif kind == 4 and at < len(text):
                text[at] = rng.randrange(256)
            else:
                other = rng.choice(self._valid)
                text[at:at] = other[rng.randrange(len(other)) :][: rng.randrange(60)]
        return bytes(text)


class Sentences:
    """Makes AIS sentences from valid ones: with other content and a right checksum, or damaged."""

    def __init__(self, rng: random.Random, valid: Sequence[bytes]) -> None:
        self._rng = rng
        self._valid = list(valid)
        self._texts = Texts(rng, valid)

    def __call__(self) -> bytes:
        """Return the next input."""
        if self._rng.random() < 0.3:
            return self._texts()
        body = bytearray(self._rng.choice(self._valid).strip()[1:].partition(b"*")[0])
        for _ in range(self._rng.randrange(1, 6)):
            place = self._rng.randrange(len(body))
            if self._rng.random() < 0.2:
                del body[place:]
                body += b","
            else:
                body[place] = self._rng.randrange(48, 120)
        checksum = 0
        for one in body:
            checksum ^= one
        return b"!%s*%02X\r\n" % (bytes(body), checksum)


class Bytes:
    """Makes byte strings of a format without frames of its own, such as a log, from valid ones."""

    def __init__(self, rng: random.Random, valid: Sequence[bytes]) -> None:
        self._rng = rng
        self._valid = list(valid)

    def __call__(self) -> bytes:
        """Return the next input."""
        rng = self._rng
        if rng.random() < 0.1:
            return rng.randbytes(rng.randrange(MOST_RANDOM_BYTES))
        content = bytearray(rng.choice(self._valid))
        for _ in range(rng.randrange(1, 6)):
            at = rng.randrange(len(content) + 1)
            to = min(len(content), at + rng.randrange(1, 80))
            kind = rng.randrange(4)
            if kind == 0:
                content[at:at] = rng.randbytes(rng.randrange(40))
            elif kind == 1:
                del content[at:to]
            elif kind == 2:
                content[at:to] = bytes(to - at)
            elif at < len(content):
                content[at] ^= 1 << rng.randrange(8)
        return bytes(content)
