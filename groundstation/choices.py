"""Choices of the command line's options; nothing heavy is imported, so that `--help` prints at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, TypeVar

from companion.errors import InputError, nearest_hint

WordT = TypeVar("WordT", bound=str)

Authentication = Literal["unsigned", "mavlink", "ed25519", "both"]
"""How frames are signed: by MAVLink's own signature with a shared key, by Ed25519 with the ground's key, or both."""
AUTHENTICATIONS: tuple[Authentication, ...] = ("unsigned", "mavlink", "ed25519", "both")
SIGNED: tuple[Authentication, ...] = ("both", "ed25519", "mavlink")
"""Authentications that need keys, the default first."""

RADIOS_BYTES_PER_S = {
    "sik-57600": 5760.0,
    "sik-64k-ecc": 3600.0,
    "lora": 638.0,
}
"""Bytes of frames per second that each radio carries one way:

- `sik-57600`: its serial port at 57600 baud, ten bits a byte, which the air at 64 kbit/s keeps up with.
- `sik-64k-ecc`: 64 kbit/s on the air, halved by the Golay code, less a tenth for preambles and the turns of its TDM.
- `lora`: spreading factor 7, 125 kHz, coding rate 4/5: 252 bytes take 394.5 ms by the formula for the time on air in
  the SX1276's data sheet (preamble of 8 symbols, explicit header, CRC). A legal duty cycle is given as the share.
"""
STATE_NAME = "groundstation.state"
"""Name of the state file for a restart, in the folder of the keys, unless `--state` names another file."""


def one_of(option: str, word: str, allowed: Sequence[WordT]) -> WordT:
    """Return a word that is among those allowed; raises InputError, with the nearest, for any other."""
    for known in allowed:
        if word == known:
            return known
    raise InputError(f"{option}: '{word}'{nearest_hint(word, allowed)}; allowed: {', '.join(allowed)}")


def without_null(given: Mapping[str, str | None]) -> None:
    """Raise InputError for an argument with a null character, which no file name can have."""
    for name, text in given.items():
        if text is not None and "\0" in text:
            raise InputError(f"{name}: {text!r} holds a null character; allowed: names without one")
