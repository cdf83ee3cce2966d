"""The uplink: the link on which the vehicle's position reports go to the ground station, signed if there is a key."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

from companion.onboard.config import UplinkSection
from companion.protocol.keys import load_mavlink_key
from companion.protocol.mavlink_signing import MavlinkSigner
from companion.transport.endpoints import Sender, open_sender, parse_link

LINK_ID = 0
"""Link id in the MAVLink signatures of a vehicle."""


class Uplink:
    """Signs reports and sends them."""

    def __init__(self, sender: Sender, signer: MavlinkSigner | None) -> None:
        """Send on `sender`; without a signer reports are unsigned, which only ground stations told so believe."""
        self._sender = sender
        self._signer = signer

    def send(self, reports: Iterable[bytes], now_s: float) -> None:
        """Send reports at `now_s`, Unix seconds; a failure is counted by the sender, never raised."""
        for report in reports:
            self._sender.send(report if self._signer is None else self._signer.sign(report, now_s))


async def open_uplink(section: UplinkSection | None, stack: ExitStack) -> Uplink | None:
    """Open the uplink of a configuration, which `stack` closes; None without one.

    Raises:
        InputError: the link cannot be opened, or the key is missing, is no key, or others can get at it.

    """
    if section is None:
        return None
    signer = None if section.key is None else MavlinkSigner(load_mavlink_key(Path(section.key)), LINK_ID)
    sender = await open_sender(parse_link(section.link))
    stack.callback(sender.close)
    return Uplink(sender, signer)
