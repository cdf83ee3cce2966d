"""The decisions of a flight as a table that any program opens: `decisions-<id>.csv`, beside the `.tlog`.

A replay needs the `.tlog`; this table is for people to read. docs/deploy.md lists the columns.
"""

from __future__ import annotations

import csv
import io
import math
from contextlib import suppress

from companion.autopilot.telemetry import Telemetry
from companion.files.tlog import Sink
from companion.onboard.decision import Decision
from companion.runtime.rate import Evenness

COLUMNS = (
    "time_unix_s",
    "purpose",
    "reason",
    "target",
    "stage",
    "triggers",
    "picture_age_s",
    "lat_deg",
    "lon_deg",
    "height_m",
    "ground_speed_m_s",
    "wanted_heading_deg",
    "heading_deg",
    "speed_m_s",
    "altitude_m",
    "turn_limited",
    "guard_changes",
    "certificate",
    "broken",
    "gave_way",
    "note",
    "reckons",
    "battery_percent",
    "gap_max_ms",
    "late_max_ms",
)


class DecisionTable:
    """Writes one row per decision; a row that the file does not take is missing."""

    def __init__(self, file: Sink) -> None:
        """Write to a file that begins with HEAD."""
        self._file = file

    def add(self, decision: Decision, telemetry: Telemetry, evenness: Evenness) -> None:
        """Write a decision, the telemetry that it was made on, and how even the loop was since the last decision."""
        setpoint = decision.setpoint
        speed_m_s = math.hypot(telemetry.velocity_north_m_s, telemetry.velocity_east_m_s)
        self._write(
            (
                f"{decision.t_s:.6f}",
                decision.purpose.value,
                decision.reason,
                "" if decision.target_id is None else str(decision.target_id),
                decision.stage.value,
                "; ".join(decision.triggers),
                _figure(decision.picture_age_s, 2),
                _figure(telemetry.lat_deg, 7),
                _figure(telemetry.lon_deg, 7),
                _figure(telemetry.height_m, 2),
                _figure(speed_m_s, 2),
                _degrees(decision.wanted_heading_rad),
                _degrees(None if setpoint is None else setpoint.heading_rad),
                _figure(None if setpoint is None else setpoint.speed_m_s, 2),
                _figure(None if setpoint is None else setpoint.altitude_m, 2),
                str(int(decision.turn_limited)),
                "; ".join(map(str, decision.guard_changes)),
                decision.certificate_words,
                "; ".join(map(str, decision.broken)),
                decision.gave_way or "",
                decision.note or "",
                decision.reckons or "",
                _figure(telemetry.battery_percent, 0),
                _figure(1e3 * evenness.gap_s, 0),
                _figure(1e3 * evenness.late_s, 0),
            )
        )

    def _write(self, row: tuple[str, ...]) -> None:
        with suppress(OSError):
            self._file.write(_line(row))
            self._file.flush()


def _line(row: tuple[str, ...]) -> bytes:
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(row)
    return line.getvalue().encode()


HEAD = _line(COLUMNS)
"""The first line of a table: the names of its columns."""


def _figure(value: float | None, digits: int) -> str:
    return "" if value is None or not math.isfinite(value) else f"{value:.{digits}f}"


def _degrees(angle_rad: float | None) -> str:
    if angle_rad is None or not math.isfinite(angle_rad):
        return ""
    return f"{math.degrees(angle_rad) % 360.0:.1f}"
