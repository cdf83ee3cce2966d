"""Messages between the ground station and its web process: JSON texts, each after its length, over a socket pair.

Neither side trusts the other to keep up: reading and writing never wait, and what cannot be read ends the connection.
"""

from __future__ import annotations

import base64
import struct
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import orjson

from companion.errors import InputError, one_line

Message = Mapping[str, Any]
"""A message: a JSON object whose `type` says what it is."""

_LENGTH = struct.Struct("!I")
MOST_BYTES = 32_000_000
"""Greatest length of a message: a picture of 500 agents, 50 targets and 50 threats has 200 kB."""
MOST_REQUEST_BYTES = 200_000
"""Greatest length of what the web process asks: a body of 64 KiB, and who sent it."""
READ_BYTES = 262_144
"""Greatest number of bytes read at once."""
CLOCK = "clock"
"""The command by which a simulator's page asks for another pace; a ground station on the air refuses it."""
ROLES = ("observer", "operator")
"""What somebody may do: look, or command as well."""


class Who(NamedTuple):
    """Somebody who asks: the name on the token or certificate, and what that name may do."""

    name: str
    role: str


class Request(NamedTuple):
    """Something that was asked of the ground station: a command, by whom, and the number under which it is answered."""

    id: int
    who: Who
    command: Message


def packed(message: Message) -> bytes:
    """Return a message as it is sent: its length as four bytes, most significant first, and its JSON text.

    Raises:
        InputError: it holds what the JSON of the pipe cannot, such as a number of more than 64 bits.

    """
    try:
        text = orjson.dumps(message, option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS)
    except orjson.JSONEncodeError as error:
        raise InputError(f"a {message.get('type')} that cannot be passed on: {one_line(str(error))}") from error
    return _LENGTH.pack(len(text)) + text


class Unpacker:
    """Puts together the messages in a stream of bytes."""

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        """Take messages of at most `most_bytes`."""
        self._most_bytes = most_bytes
        self._held = bytearray()

    def feed(self, data: bytes) -> list[Message]:
        """Return the messages that `data` completes.

        Raises:
            InputError: the bytes are no messages; nothing after them can be read either.

        """
        self._held += data
        messages: list[Message] = []
        while len(self._held) >= _LENGTH.size:
            (length,) = _LENGTH.unpack_from(self._held)
            if length > self._most_bytes:
                raise InputError(f"a message of {length} bytes; allowed: at most {self._most_bytes}")
            end = _LENGTH.size + length
            if len(self._held) < end:
                break
            text = bytes(self._held[_LENGTH.size : end])
            del self._held[:end]
            messages.append(_message(text))
        return messages


def _message(text: bytes) -> Message:
    try:
        message = orjson.loads(text)
    except orjson.JSONDecodeError as error:
        raise InputError(f"a message that is no JSON: {error}") from error
    if not isinstance(message, dict) or not isinstance(message.get("type"), str):
        raise InputError("a message without a type; allowed: a JSON object with one")
    return message


def frames_message(t_s: float, datagrams: Iterable[bytes]) -> Message:
    """Return the message that tells of unsigned frames, broadcast at a time in seconds."""
    return {"type": "frames", "t_s": t_s, "frames": [base64.b64encode(one).decode("ascii") for one in datagrams]}


def frames_of(message: Message) -> tuple[float, Sequence[bytes]]:
    """Return the time and the frames of such a message; raises ValueError, TypeError or KeyError if it is none."""
    return float(message["t_s"]), [base64.b64decode(one, validate=True) for one in message["frames"]]


def request_of(message: Message) -> Request | None:
    """Return what the web process asks with a message; None if it is no request."""
    identity, name, role, command = (message.get(key) for key in ("id", "name", "role", "command"))
    if message.get("type") != "request" or role not in ROLES or not isinstance(command, dict):
        return None
    if not isinstance(identity, int) or not isinstance(name, str):
        return None
    return Request(identity, Who(name, str(role)), command)
