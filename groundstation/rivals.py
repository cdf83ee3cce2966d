"""Notices another ground station that broadcasts to the same vehicles: they hear only the newer epoch of the two.

On one computer a lock beside the keys keeps a second one from starting. On the air it is noticed where the ground
station can hear the broadcast itself: on a multicast group, a subnet's broadcast, or a link given for that.
"""

from __future__ import annotations

import fcntl
import os
from collections import Counter, OrderedDict
from pathlib import Path

from companion.errors import InputError
from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM
from companion.protocol.deframer import MAX_DATAGRAM_BYTES, frames_in
from companion.protocol.ed25519 import FrameSigner
from companion.protocol.frame import BROADCAST_IDS, RawFrame
from groundstation.refusals import Refusals

LOCK_NAME = "groundstation.lock"
"""Name of the lock, in the folder of the keys."""
REMEMBERED = 1024
"""Number of this station's newest frames that are recognised when they come back."""
CHECK_PERIOD_S = 0.5
"""Least time between two frames that are examined: a flood must not keep the broadcast waiting."""


class RunLock:
    """The lock that one ground station holds; the system frees it when the program ends, however it ends."""

    def __init__(self, path: Path) -> None:
        """Take the lock.

        Raises:
            InputError: another ground station holds it.
            OSError: the file cannot be opened or locked.

        """
        # Neither a link is followed, nor a pipe waited for.
        self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            holder = os.read(self._descriptor, 16).decode(errors="replace").strip()
            self.close()
            raise InputError(
                f"{path}: another ground station runs with these keys or this state (process {holder}), and vehicles "
                "would hear only the newer one; allowed: one at a time"
            ) from error
        os.ftruncate(self._descriptor, 0)
        os.write(self._descriptor, f"{os.getpid()}\n".encode())

    def close(self) -> None:
        """Free the lock."""
        os.close(self._descriptor)


class Rivals:
    """Compares the frames that are heard on the broadcast's link with those that this ground station sent."""

    def __init__(self, signer: FrameSigner) -> None:
        """Take as this ground station's key what `signer` signs with."""
        self._signer = signer
        self._sent: OrderedDict[bytes, None] = OrderedDict()
        self._found = Refusals()
        self._next_s = float("-inf")

    def sent(self, frame: bytes) -> None:
        """Remember a frame that is sent."""
        self._sent[frame] = None
        if len(self._sent) > REMEMBERED:
            self._sent.popitem(last=False)

    def hear(self, datagram: bytes, epoch_s: int, now_s: float) -> None:
        """Take in bytes from the broadcast's link, while this ground station's epoch is `epoch_s`; never raises."""
        if datagram in self._sent or now_s < self._next_s:
            return
        for raw in frames_in(datagram[:MAX_DATAGRAM_BYTES], Counter()):
            is_ours = raw.data in self._sent
            if is_ours or (raw.system, raw.component) != (GROUND_SYSTEM, GROUND_COMPONENT):
                continue
            if raw.message_id in BROADCAST_IDS:
                self._next_s = now_s + CHECK_PERIOD_S
                self._find(raw, epoch_s)
                return

    def news(self, now_s: float) -> list[str]:
        """Return the lines that are due."""
        return self._found.news(now_s)

    def _find(self, raw: RawFrame, epoch_s: int) -> None:
        if not self._signer.has_signed(raw):
            self._found.add(
                "other", "another ground station broadcasts on this link, not with this key: heard {} times"
            )
            return
        since_s = raw.stamp.epoch_s - epoch_s
        which = f"{abs(since_s)} s {'after' if since_s > 0 else 'before'}" if since_s else "in the same second as"
        self._found.add(
            "same",
            f"another ground station broadcasts with this key: its epoch began {which} this one's, and vehicles hear "
            "only the newer; end one of them: heard {} times",
        )
