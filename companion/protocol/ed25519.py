"""Ed25519 signature of a broadcast's content, so that only the holder of the private key can broadcast.

The signature is inside the message: after the fields of the typed messages, after the used bytes of the packed ones.
It covers sender and content only: a copy with another MAVLink sequence number or MAVLink signature stays genuine. The
parts that it does not cover (MAVLink's sequence number, the compatibility flags) mean nothing to the receiver.
"""

from __future__ import annotations

from collections import OrderedDict

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from companion.files.mavlink_layout import MAX_PAYLOAD_BYTES, SIGNATURE_BYTES
from companion.protocol.deframer import crc_of
from companion.protocol.frame import BROADCAST_IDS, ED25519_BYTES, RawFrame, raw_frame
from companion.protocol.mavlink_signing import MavlinkSigner

DOMAIN = b"oneway-guidance/1"
"""Prefix of the signed bytes, so that a signature is valid in no other protocol and in no later format of this one."""
REMEMBERED_SIGNATURES = 512
"""Number of signatures stored for repeated frames: more than a broadcast has frames, which are at most 255."""


def signed_part(frame: RawFrame) -> bytes:
    """Return the bytes that the Ed25519 signature of a broadcast message covers; equal for all copies of a frame."""
    return DOMAIN + frame.signed_content


def signature_of(frame: RawFrame) -> bytes | None:
    """Return the Ed25519 signature in a broadcast message, None if there is none."""
    length = frame.content_length
    if frame.payload_length <= length:
        return None
    return frame.payload[length : length + ED25519_BYTES].ljust(ED25519_BYTES, b"\0")


def sign(raw: bytes, private_key: Ed25519PrivateKey) -> bytes:
    """Return a broadcast message with its Ed25519 signature; it must not carry a MAVLink signature yet.

    Raises ValueError if there is no room for the signature, which the encoder must leave.
    """
    frame = raw_frame(raw)
    return _with_signature(frame, private_key.sign(signed_part(frame)))


def verify(frame: RawFrame, public_key: Ed25519PublicKey) -> bool:
    """Return whether a broadcast message carries a valid Ed25519 signature of its content by the key's owner."""
    signature = signature_of(frame)
    if signature is None:
        return False
    try:
        public_key.verify(signature, signed_part(frame))
    except InvalidSignature:
        return False
    return True


class FrameSigner:
    """Signs frames before they are sent: with Ed25519 first, then with MAVLink signing, each if there is a key for it.

    A repeated frame costs only a new MAVLink signature.
    """

    def __init__(self, private_key: Ed25519PrivateKey | None, signer: MavlinkSigner | None) -> None:
        self._private_key = private_key
        self.signer = signer
        self._signatures: OrderedDict[bytes, bytes] = OrderedDict()

    @property
    def overhead_bytes(self) -> int:
        """Greatest number of bytes that signing adds to a frame."""
        inside = ED25519_BYTES if self._private_key is not None else 0
        return inside + (SIGNATURE_BYTES if self.signer is not None else 0)

    def has_signed(self, frame: RawFrame) -> bool:
        """Return whether a frame of the broadcast carries the signatures that this signer adds, made at any time."""
        if self._private_key is not None:
            has_one = frame.payload_length > frame.content_length
            if not has_one or not verify(frame, self._private_key.public_key()):
                return False
        return self.signer is None or self.signer.holds(frame)

    def sign(self, raw: bytes, now_s: float) -> bytes:
        """Return an unsigned frame with the configured signatures added.

        A message that is no broadcast, such as a heartbeat, gets the MAVLink signature only.
        """
        if self._private_key is not None:
            frame = raw_frame(raw)
            if frame.message_id in BROADCAST_IDS:
                raw = _with_signature(frame, self._signature(signed_part(frame), self._private_key))
        return raw if self.signer is None else self.signer.sign(raw, now_s)

    def _signature(self, part: bytes, private_key: Ed25519PrivateKey) -> bytes:
        signature = self._signatures.get(part)
        if signature is None:
            signature = self._signatures[part] = private_key.sign(part)
            if len(self._signatures) > REMEMBERED_SIGNATURES:
                self._signatures.popitem(last=False)
        return signature


def _with_signature(frame: RawFrame, signature: bytes) -> bytes:
    if frame.is_signed:
        raise ValueError("a frame gets its Ed25519 signature before it is given a MAVLink signature, not after")
    length = frame.content_length
    if length + ED25519_BYTES > MAX_PAYLOAD_BYTES:
        raise ValueError(f"{length} bytes of content leave no room for a signature of {ED25519_BYTES}")
    # The signature's own trailing zeros are cut like those of any payload; the receiver puts them back.
    payload = (frame.payload[:length].ljust(length, b"\0") + signature).rstrip(b"\0")
    body = frame.head_for(len(payload)) + payload
    return body + crc_of(body, frame.message_id)
