"""Floods a port: `python -m tests.real.flood PORT RATE` sends so many junk frames a second until it is ended.

The junk is the costliest that somebody without a key can make: whole frames with the right CRC and a wrong signature.
"""

from __future__ import annotations

import random
import socket
import sys
import time

from companion.protocol.frame import ED25519_BYTES
from companion.protocol.mavlink_signing import MavlinkSigner
from tests.companion.protocol.hostile import Ground, forged_seal

SLICE_S = 0.002
"""Time between two bursts."""
TEMPLATES = 4096
"""Number of frames made beforehand, so that making them costs no time later."""


def main(port: int, rate_hz: float) -> None:
    """Send until the process is ended."""
    frames = forged_frames(TEMPLATES)
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sender.connect(("127.0.0.1", port))
    began_s, sent = time.monotonic(), 0
    while True:
        # What a pause of the computer left undone is not made up for.
        due = min(int((time.monotonic() - began_s) * rate_hz), sent + int(rate_hz))
        for number in range(sent, due):
            try:
                sender.send(frames[number % len(frames)])
            except ConnectionRefusedError:
                continue
        sent = due
        time.sleep(SLICE_S)


def forged_frames(count: int) -> list[bytes]:
    """Return frames of our dialect, newer than any genuine one, with wrong signatures."""
    rng, now_s = random.Random(2), time.time()
    ground = Ground("both", rng, epoch_s=int(now_s))
    signer = MavlinkSigner(rng.randbytes(32), 0)
    return [
        signer.sign(forged_seal(ground.unsealed(now_s, 1 << 31 | number), rng.randbytes(ED25519_BYTES)), now_s)
        for number in range(count)
    ]


if __name__ == "__main__":
    main(int(sys.argv[1]), float(sys.argv[2]))
