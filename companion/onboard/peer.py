"""Which address on a UDP link is the autopilot's: what is sent goes there, and strangers cannot draw it elsewhere.

The address is that of frames which continue what the autopilot said (`autopilot/identity.py`). It changes only when the
old one is silent and another one goes on, as after a restart of a router. In flight, frames in the autopilot's name
from any other address are left out until then, those of a second way as well: whoever hears frames can copy them.
"""

from __future__ import annotations

from collections.abc import Callable

from companion.autopilot.identity import AUTOPILOT_COMPONENT
from companion.protocol.frame import RawFrame
from companion.transport.endpoints import Address

SILENT_S = 0.5
"""Time without a frame that continues the autopilot after which another address may take the place of the bound one."""
FRAMES = 3
"""Number of such frames from the other address, while the bound one is silent, for that."""
MAX_ADDRESSES = 64
"""Greatest number of other addresses that are counted; beyond it all counts begin anew."""


class Peer:
    """Binds the link to the autopilot's address. Times are the caller's, in seconds of one clock."""

    def __init__(self) -> None:
        self.bind: Callable[[Address], None] = lambda _: None
        """Makes the link send to an address."""
        self._bound: Address | None = None
        self._heard_s = 0.0
        self._frames: dict[Address, int] = {}

    def note_speaker(self, address: Address) -> None:
        """Send to an address that speaks as an autopilot, as long as the autopilot is not known."""
        if self._bound is None:
            self.bind(address)

    def note_believed(self, address: Address, frames: int, now_s: float) -> None:
        """Take in how many frames from an address continued what the autopilot said, at least one."""
        if self._bound is not None and address != self._bound:
            if len(self._frames) >= MAX_ADDRESSES:
                self._frames.clear()
            self._frames[address] = self._frames.get(address, 0) + frames
            if not self._is_silent(now_s) or self._frames[address] < FRAMES:
                return
        if address != self._bound:
            self._bound = address
            self.bind(address)
        self._heard_s = now_s
        self._frames.clear()

    def knows(self, address: Address) -> bool:
        """Return whether an address is the autopilot's, or may be as none is known yet."""
        return self._bound in (None, address)

    def is_stranger(self, address: Address, frame: RawFrame, system_id: int | None, now_s: float) -> bool:
        """Return whether a frame in the autopilot's name is from an address that is not its own."""
        if self._bound is None or frame.sender != (system_id, AUTOPILOT_COMPONENT):
            return False
        return address != self._bound and not self._is_silent(now_s)

    def _is_silent(self, now_s: float) -> bool:
        return now_s - self._heard_s >= SILENT_S
