"""Whether the autopilot answers, in which version of MAVLink it is spoken to, and what stands in the way.

An autopilot that sends MAVLink 1 mostly understands version 2, and goes over to it once it hears it (ArduPilot). So it
is asked in version 2 first, and in version 1 when it neither answers nor goes over. One that signs its frames takes
none without a signature, and says nothing of it: all that shows is that it answers nothing.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import common

from companion.autopilot.intake import Message
from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.files.mavlink_layout import CRC_BYTES, HEADER_V1_BYTES, LENGTH_AT
from companion.protocol.frame import crc_bytes

OLD_AFTER_S = 2.5
"""Time of asking an autopilot that sends MAVLink 1 in version 2 without an answer, after which version 1 is sent."""
SILENT_AFTER_S = 5.0
"""Time of asking without any answer after which the autopilot is said to answer nothing."""
SILENT_AFTER_QUESTIONS = 8
"""Number of questions without any answer after which the autopilot is said to answer nothing."""
SPEAKS_OLD = "the autopilot speaks MAVLink 1 only"
SIGNS = "the autopilot signs its frames"
_OLD_PAYLOAD_BYTES = {common.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET: 39}
"""Length of the payload in MAVLink 1, which has no extension fields, of those sent messages that have any."""


class Dialogue:
    """Watches questions and answers. Times are the caller's, in seconds of one clock."""

    def __init__(self) -> None:
        self.signed = False
        """Whether the autopilot was seen to sign its frames."""
        self.in_old_version = False
        """Whether to send in MAVLink 1."""
        self._asked_since_s = math.inf
        self._asked = 0
        self._answered = False
        self._speaks_new = False
        self._speaks_old = False
        self._mav: common.MAVLink | None = None

    def restart(self) -> None:
        """Begin anew after a restart of the autopilot, which may take what it did not, and the other way round."""
        self._asked_since_s, self._asked, self._answered = math.inf, 0, False
        self._speaks_new = self._speaks_old = self.in_old_version = False

    def heard(self, version: int) -> None:
        """Note the version of MAVLink of one of the autopilot's frames."""
        self._speaks_new |= version != 1
        self._speaks_old |= version == 1

    def asked(self, questions: int, now_s: float) -> bool:
        """Note that so many questions are due; return whether all must be asked anew, in the old version."""
        if questions:
            self._asked_since_s = min(self._asked_since_s, now_s)
            self._asked += questions
        before, only_old = self.in_old_version, self._speaks_old and not self._speaks_new
        in_vain = not self._answered and now_s - self._asked_since_s >= OLD_AFTER_S
        self.in_old_version = only_old and (before or in_vain)
        return self.in_old_version and not before

    def packed(self, message: Message, system_id: int) -> bytes:
        """Return the frame of a message of the companion, in the version that the autopilot understands."""
        if self._mav is None or self._mav.srcSystem != system_id:
            self._mav = common.MAVLink(None, srcSystem=system_id, srcComponent=COMPANION_COMPONENT)
        data = packed(message, self._mav, self.in_old_version)
        self._mav.seq = (self._mav.seq + 1) % 256
        return data

    def answered(self) -> None:
        """Note an answer to a question."""
        self._answered = True

    def silence(self, now_s: float) -> str | None:
        """Return in words that the autopilot answers nothing, the likely cause and the remedy; None if it answers."""
        too_soon = self._asked < SILENT_AFTER_QUESTIONS or now_s - self._asked_since_s < SILENT_AFTER_S
        if self._answered or too_soon:
            return None
        if self.signed:
            return (
                f"{SIGNS} and answers nothing: it takes only signed ones; remove its signing key, or put a router that "
                "signs between"
            )
        return (
            "the autopilot answers nothing: check the way to it (the transmit wire, the router's way back), and that "
            "it takes unsigned frames"
        )

    def note(self) -> str | None:
        """Return in words what is unusual of what the autopilot sends; None if nothing is."""
        if self.signed:
            return SIGNS
        return SPEAKS_OLD if self._speaks_old and not self._speaks_new else None


def packed(message: Message, mav: common.MAVLink, in_old_version: bool) -> bytes:
    """Return the frame of a message, in MAVLink 1 where that is asked for; the caller counts on."""
    data = bytes(message.pack(mav, force_mavlink1=in_old_version))
    most_bytes = _OLD_PAYLOAD_BYTES.get(message.get_msgId())
    if not in_old_version or most_bytes is None:
        return data
    body = bytearray(data[: HEADER_V1_BYTES + most_bytes])
    body[LENGTH_AT] = len(body) - HEADER_V1_BYTES
    whole = bytes(body) + crc_bytes(bytes(body), bytes((message.crc_extra,)))
    assert len(whole) == HEADER_V1_BYTES + most_bytes + CRC_BYTES
    return whole
