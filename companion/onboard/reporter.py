"""The vehicle's position reports for the uplink, with the distance flown."""

from __future__ import annotations

import math

from companion.autopilot.telemetry import COMPANION_COMPONENT, Telemetry
from companion.onboard.config import Config
from companion.protocol.codec import FrameWriter, ReportFrame


class Reporter:
    """Writes the position reports of one agent when they are due."""

    def __init__(self, config: Config) -> None:
        self._config = config
        self._next_s = -math.inf
        self._writer: FrameWriter | None = None

    def due(self, telemetry: Telemetry, flown_m: float, now_s: float) -> list[bytes]:
        """Return the report as a frame if one is due and the position is not too old; otherwise an empty list."""
        config = self._config
        known = telemetry.position_at_s is not None and now_s - telemetry.position_at_s <= config.telemetry_timeout_s
        if config.report_period_s == 0.0 or now_s < self._next_s or not known:
            return []
        self._next_s = now_s + config.report_period_s
        if self._writer is None:
            self._writer = FrameWriter(telemetry.system_id or 1, COMPANION_COMPONENT)
        position_at_s = telemetry.position_at_s or now_s
        epoch_s = int(position_at_s)
        frame = ReportFrame(
            epoch_s=epoch_s,
            time_ms=round((position_at_s - epoch_s) * 1000.0),
            agent_id=config.agent_id,
            lat_deg=telemetry.lat_deg,
            lon_deg=telemetry.lon_deg,
            velocity_north_m_s=telemetry.velocity_north_m_s,
            velocity_east_m_s=telemetry.velocity_east_m_s,
            flown_m=flown_m,
        )
        return [self._writer.encode(frame)]
