"""Status messages of the companion on the autopilot link, in the form that ground-control programs show.

These are a text when the line changes, and a set of named values every few seconds. The autopilot forwards them by its
own radio, so their rate is limited, and none are sent where the vehicle must keep radio silence.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import common

from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.onboard.decision import Certificate, Decision, Purpose
from companion.onboard.failsafe import Stage
from companion.runtime.rate import Evenness

TEXT_PERIOD_S = 2.0
"""Shortest time between two texts; of several lines that come meanwhile the newest is sent."""
REPEAT_S = 10.0
"""Time after which a text that a person must act on is sent again: it may have been missed."""
MOST_CHUNKS = 4
"""Most STATUSTEXT messages of CHUNK_BYTES that one line takes; a longer line is cut."""
CHUNK_BYTES = 50
"""Length of the text field of STATUSTEXT."""
SEVERITIES = {
    Stage.FRESH: common.MAV_SEVERITY_INFO,
    Stage.COASTING: common.MAV_SEVERITY_NOTICE,
    Stage.LOITERING: common.MAV_SEVERITY_WARNING,
    Stage.RETURNING: common.MAV_SEVERITY_WARNING,
}
UNCERTIFIED_SEVERITY = common.MAV_SEVERITY_CRITICAL
"""Severity of a decision for which the guard had no certified back-up, whatever the stage."""
_UINT32 = 2**32
_ID_MAX = 65_535


class StatusReporter:
    """Decides which status messages are sent and when, and packs them; the caller gives the times."""

    def __init__(self, period_s: float, quiet: bool) -> None:
        """Send the named values every `period_s` seconds, and a text when it changes; nothing at all if `quiet`."""
        self._period_s = period_s
        self._quiet = quiet
        self._mav = common.MAVLink(None, srcComponent=COMPANION_COMPONENT)
        self._began_s: float | None = None
        self._line = self._said = ""
        self._severity = common.MAV_SEVERITY_INFO
        self._insists = False
        self._text_s = self._values_s = -math.inf
        self._text_id = 0

    def note(self, decision: Decision, line: str, *, insists: bool = False) -> None:
        """Note the severity of a decision and the line that describes it.

        `insists`: whether a person waits for the companion, and must act first: the line is repeated.
        """
        self._line, self._insists = line, insists
        self._severity = UNCERTIFIED_SEVERITY if decision.uncertified else SEVERITIES[decision.stage]
        if insists:
            self._severity = min(self._severity, common.MAV_SEVERITY_WARNING)

    def text(self, now_s: float, system_id: int | None) -> list[bytes]:
        """Return the newest line as STATUSTEXT frames if it is due; else none.

        It is due if it changed and the last text was TEXT_PERIOD_S ago, or if it insists and that was REPEAT_S ago.
        """
        since_s = now_s - self._text_s
        is_due = since_s >= TEXT_PERIOD_S if self._line != self._said else self._insists and since_s >= REPEAT_S
        if self._quiet or system_id is None or not is_due:
            return []
        self._text_s, self._said = now_s, self._line
        self._mav.srcSystem = system_id
        return [self._pack(message) for message in self._texts(self._line.encode(errors="replace"))]

    def values(self, now_s: float, system_id: int | None, decision: Decision, evenness: Evenness) -> list[bytes]:
        """Return the named values as frames if they are due (`values_due`), else an empty list.

        `evenness`: how even the setpoint loop was since the named values were last sent.
        """
        if system_id is None or not self.values_due(now_s):
            return []
        self._began_s = now_s if self._began_s is None else self._began_s
        self._values_s = now_s
        self._mav.srcSystem = system_id
        time_ms = round(1e3 * (now_s - self._began_s)) % _UINT32
        age_s = math.nan if decision.picture_age_s is None else decision.picture_age_s
        guard = 2 if decision.uncertified else 1 if decision.guard_changes else 0
        integers = {
            "OW_STAGE": list(Stage).index(decision.stage),
            "OW_PURPOSE": list(Purpose).index(decision.purpose),
            "OW_TARGET": decision.target_id or 0,
            "OW_GUARD": guard,
            "OW_CERT": list(Certificate).index(decision.certificate),
            "OW_GAP_MS": round(1e3 * evenness.gap_s),
            "OW_LATE_MS": round(1e3 * evenness.late_s),
        }
        messages = [
            common.MAVLink_named_value_int_message(time_ms, name.encode(), value) for name, value in integers.items()
        ]
        if math.isfinite(age_s):
            messages.append(common.MAVLink_named_value_float_message(time_ms, b"OW_AGE", age_s))
        if decision.certificate is Certificate.UNTIL:
            messages.append(common.MAVLink_named_value_float_message(time_ms, b"OW_CERT_S", decision.certified_s))
        return [self._pack(message) for message in messages]

    def values_due(self, now_s: float) -> bool:
        """Return whether it is time to send the named values."""
        return not self._quiet and now_s - self._values_s >= self._period_s

    def _texts(self, text: bytes) -> list[common.MAVLink_statustext_message]:
        if len(text) <= CHUNK_BYTES:
            return [common.MAVLink_statustext_message(self._severity, text)]
        self._text_id = self._text_id % _ID_MAX + 1
        # A chunk that is not full ends the line (STATUSTEXT), so the last chunk must be at least one byte short.
        text = text[: MOST_CHUNKS * CHUNK_BYTES - 1]
        chunks = [text[start : start + CHUNK_BYTES] for start in range(0, len(text), CHUNK_BYTES)]
        if len(chunks[-1]) == CHUNK_BYTES:
            chunks.append(b"")
        return [
            common.MAVLink_statustext_message(self._severity, chunk, self._text_id, number)
            for number, chunk in enumerate(chunks)
        ]

    def _pack(self, message: common.MAVLink_statustext_message) -> bytes:
        frame = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return frame
