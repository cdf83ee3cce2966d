"""What the command line offers to choose from. Nothing heavy is imported, so that `--help` is there at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, TypeVar

from companion.errors import InputError, nearest_hint

WordT = TypeVar("WordT", bound=str)

Authentication = Literal["unsigned", "mavlink", "ed25519", "both"]
"""How frames are signed: by MAVLink's own signature with a shared key, by Ed25519 with the ground's key, or both."""
AUTHENTICATIONS: tuple[Authentication, ...] = ("unsigned", "mavlink", "ed25519", "both")
SIGNED: tuple[Authentication, ...] = ("both", "ed25519", "mavlink")
"""Those that need keys, the one to choose first."""

RADIOS_BYTES_PER_S = {
    "sik-57600": 5760.0,
    "sik-64k-ecc": 3600.0,
    "lora": 638.0,
}
"""What each carries of frames, one way:

- `sik-57600`: its serial port at 57600 baud, ten bits a byte, which the air at 64 kbit/s keeps up with.
- `sik-64k-ecc`: 64 kbit/s on the air, halved by the Golay code, less a tenth for preambles and the turns of its TDM.
- `lora`: spreading factor 7, 125 kHz, coding rate 4/5: 252 bytes take 394.5 ms by the formula for the time on air in
  the SX1276's data sheet (preamble of 8 symbols, explicit header, CRC). A law's duty cycle is the share to give.
"""
STATE_NAME = "groundstation.state"
"""Of the file of what a restart needs, in the folder of the keys, unless another file is named."""


def one_of(option: str, word: str, allowed: Sequence[WordT]) -> WordT:
    """Return a word that is among those allowed; raises InputError, with the nearest, for any other."""
    for known in allowed:
        if word == known:
            return known
    raise InputError(f"{option}: '{word}'{nearest_hint(word, allowed)}; allowed: {', '.join(allowed)}")


def without_null(given: Mapping[str, str | None]) -> None:
    """Refuse arguments that hold a null character, which no name of a file can; raises InputError."""
    for name, text in given.items():
        if text is not None and "\0" in text:
            raise InputError(f"{name}: {text!r} holds a null character; allowed: names without one")
