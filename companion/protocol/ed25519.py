"""Ed25519 over a broadcast's content, so that only the holder of the private key can speak for the centre.

The signature travels inside the message: behind the fields of the typed messages, behind the bytes in use of the packed
ones. It covers who sent what, not how it travelled: a copy with another MAVLink sequence number or MAVLink signature
stays genuine. What it does not cover (the sequence number, the compatibility flags) means nothing to the receiver.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import NamedTuple

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from companion.protocol import deframer as framing
from companion.protocol.deframer import HEADER_BYTES, crc_of, header_of, is_signed, payload_of
from companion.protocol.dialect import oneway
from companion.protocol.mavlink_signing import MavlinkSigner

ED25519_BYTES = 64
DOMAIN = b"oneway-guidance/1"
"""Begins what is signed, so that a signature of ours means nothing anywhere else, nor of a later format here."""
REMEMBERED_SEALS = 512
"""Signatures kept for copies: more than the frames of one broadcast, of which there are at most 255."""

_PAYLOAD_MAX_BYTES = 255
_LENGTH_AT = 1


class _Layout(NamedTuple):
    """Where the content of a message ends: at `head_bytes`, or at as many bytes behind it as its last byte says."""

    head_bytes: int
    is_packed: bool


def _layout(kind: type[oneway.MAVLink_message]) -> _Layout | None:
    """Return the layout of a broadcast message, None for any other."""
    fields = kind.ordered_fieldnames
    if fields[-1] == "ed25519_signature":
        return _Layout(kind.unpacker.size - ED25519_BYTES, False)
    if fields[-2:] == ["size", "data"]:
        return _Layout(kind.unpacker.size - kind.array_lengths[-1], True)
    return None


_LAYOUTS: dict[int, _Layout] = {
    number: layout for number, kind in oneway.mavlink_map.items() if (layout := _layout(kind)) is not None
}
BROADCAST_IDS = frozenset(_LAYOUTS)
"""The messages that the ground station broadcasts; each begins with epoch, time and sequence and can be sealed."""


def content_bytes(raw: bytes) -> int:
    """Return how many payload bytes of a broadcast message are content: what is signed, padded with zeros if cut."""
    layout = _LAYOUTS[int.from_bytes(raw[7:HEADER_BYTES], "little")]
    if not layout.is_packed or raw[_LENGTH_AT] < layout.head_bytes:
        return layout.head_bytes
    return layout.head_bytes + raw[HEADER_BYTES + layout.head_bytes - 1]


def signed_part(raw: bytes) -> bytes:
    """Return the bytes that the Ed25519 signature of a broadcast message covers; equal for all copies of a frame."""
    length = content_bytes(raw)
    content = raw[HEADER_BYTES : HEADER_BYTES + min(length, raw[_LENGTH_AT])]
    return DOMAIN + raw[5:HEADER_BYTES] + content.ljust(length, b"\0")


def signature_of(raw: bytes) -> bytes | None:
    """Return the Ed25519 signature in a broadcast message, None if there is none."""
    length = content_bytes(raw)
    if raw[_LENGTH_AT] <= length:
        return None
    return payload_of(raw)[length : length + ED25519_BYTES].ljust(ED25519_BYTES, b"\0")


def seal(raw: bytes, private_key: Ed25519PrivateKey) -> bytes:
    """Return a broadcast message with its Ed25519 signature; it must not carry a MAVLink signature yet.

    Raises ValueError if there is no room for the signature: the encoder is to leave it.
    """
    return _with_signature(raw, private_key.sign(signed_part(raw)))


def verify(raw: bytes, public_key: Ed25519PublicKey) -> bool:
    """Return whether a broadcast message carries a signature of its content by the key's owner."""
    signature = signature_of(raw)
    if signature is None:
        return False
    try:
        public_key.verify(signature, signed_part(raw))
    except InvalidSignature:
        return False
    return True


class FrameSigner:
    """Makes frames ready for the air: Ed25519 first, then MAVLink signing, each where there is a key for it.

    A copy of a frame sent before costs a new MAVLink signature only.
    """

    def __init__(self, private_key: Ed25519PrivateKey | None, signer: MavlinkSigner | None) -> None:
        self._private_key = private_key
        self.signer = signer
        self._signatures: OrderedDict[bytes, bytes] = OrderedDict()

    @property
    def overhead_bytes(self) -> int:
        """What sealing adds to a frame at most."""
        sealed = ED25519_BYTES if self._private_key is not None else 0
        return sealed + (framing.SIGNATURE_BYTES if self.signer is not None else 0)

    def seal(self, raw: bytes, now_s: float) -> bytes:
        """Return an unsigned frame, signed as configured.

        A message that is no broadcast, such as a heartbeat, gets the MAVLink signature only.
        """
        if self._private_key is not None and header_of(raw).message_id in BROADCAST_IDS:
            raw = _with_signature(raw, self._signature(raw, self._private_key))
        return raw if self.signer is None else self.signer.sign(raw, now_s)

    def _signature(self, raw: bytes, private_key: Ed25519PrivateKey) -> bytes:
        part = signed_part(raw)
        signature = self._signatures.get(part)
        if signature is None:
            signature = self._signatures[part] = private_key.sign(part)
            if len(self._signatures) > REMEMBERED_SEALS:
                self._signatures.popitem(last=False)
        return signature


def _with_signature(raw: bytes, signature: bytes) -> bytes:
    if is_signed(raw):
        raise ValueError("a frame is sealed before it is given a MAVLink signature, not after")
    length = content_bytes(raw)
    if length + ED25519_BYTES > _PAYLOAD_MAX_BYTES:
        raise ValueError(f"{length} bytes of content leave no room for a signature of {ED25519_BYTES}")
    # The signature's own trailing zeros are cut like those of any payload; the receiver puts them back.
    payload = (payload_of(raw)[:length].ljust(length, b"\0") + signature).rstrip(b"\0")
    head = bytes((raw[0], len(payload))) + raw[2:HEADER_BYTES]
    return head + payload + crc_of(head + payload, header_of(raw).message_id)
