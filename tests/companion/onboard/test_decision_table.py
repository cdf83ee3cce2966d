"""The table of decisions: one row each, columns as documented."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

from companion.autopilot.telemetry import Telemetry
from companion.guard.types import NO_BACKUP, Setpoint
from companion.onboard.decision import Decision, Purpose
from companion.onboard.decision_table import COLUMNS, HEAD, DecisionTable
from companion.onboard.failsafe import Stage
from companion.runtime.rate import Evenness

IDLE = Decision(1_000.0, Purpose.IDLE, "no autopilot heard", Stage.FRESH, None)
STEERING = Decision(
    1_000.5,
    Purpose.TARGET,
    'assigned, "really"',
    Stage.COASTING,
    16.5,
    triggers=("picture 16 s old", "battery 20 %"),
    target_id=4,
    wanted_heading_rad=-math.pi / 2,
    turn_limited=True,
    setpoint=Setpoint(math.pi, 8.0, 30.0),
    guard_changes=(NO_BACKUP, "speed"),
    certified_s=12.34,
)
TELEMETRY = Telemetry(
    lat_deg=47.0,
    lon_deg=8.0,
    height_m=29.5,
    velocity_north_m_s=3.0,
    velocity_east_m_s=4.0,
    battery_percent=80.0,
)


def rows_of(*decisions: Decision) -> list[dict[str, str]]:
    file = io.BytesIO()
    file.write(HEAD)
    table = DecisionTable(file)
    for decision in decisions:
        table.add(decision, TELEMETRY, Evenness(0.1234, 0.0123))
    return list(csv.DictReader(io.StringIO(file.getvalue().decode())))


def test_a_row_tells_what_was_decided_on_what() -> None:
    (row,) = rows_of(STEERING)
    assert row == {
        "time_unix_s": "1000.500000",
        "purpose": "target",
        "reason": 'assigned, "really"',
        "target": "4",
        "stage": "coasting",
        "triggers": "picture 16 s old; battery 20 %",
        "picture_age_s": "16.50",
        "lat_deg": "47.0000000",
        "lon_deg": "8.0000000",
        "height_m": "29.50",
        "ground_speed_m_s": "5.00",
        "wanted_heading_deg": "270.0",
        "heading_deg": "180.0",
        "speed_m_s": "8.00",
        "altitude_m": "30.00",
        "turn_limited": "1",
        "guard_changes": f"{NO_BACKUP}; speed",
        "certificate": "until 12.3 s",
        "broken": "",
        "gave_way": "",
        "note": "",
        "reckons": "",
        "battery_percent": "80",
        "gap_max_ms": "123",
        "late_max_ms": "12",
    }


def test_what_is_not_known_is_left_empty() -> None:
    (row,) = rows_of(IDLE)
    assert [row[name] for name in ("target", "picture_age_s", "wanted_heading_deg", "heading_deg")] == [""] * 4


def test_every_decision_has_a_row_under_one_head() -> None:
    assert [row["purpose"] for row in rows_of(IDLE, STEERING, IDLE)] == ["idle", "target", "idle"]


def test_a_table_that_can_no_longer_be_written_is_given_up() -> None:
    class Full(io.BytesIO):
        def write(self, _: object) -> int:
            raise OSError(28, "No space left on device")

    table = DecisionTable(Full())
    table.add(IDLE, TELEMETRY, Evenness())


def test_every_column_is_documented() -> None:
    text = (Path(__file__).parents[3] / "docs" / "deploy.md").read_text()
    assert [name for name in COLUMNS if f"`{name}`" not in text] == []
