"""The ground station's sensor: it sends the true positions as detection frames, on a channel of its own."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from companion.mission.model import Mission
from companion.protocol.codec import (
    DETECTIONS_PER_FRAME,
    GROUND_SYSTEM,
    SENSOR_COMPONENT,
    Detection,
    DetectionsFrame,
    FrameWriter,
    Kind,
)
from groundstation.ground_station import GroundStation

LOOK_PERIOD_S = 1.0
"""Time between two looks of the sensor."""


class Sensor:
    """Encodes detections as frames. Noise and misses are not modelled."""

    def __init__(self, origin_lat_deg: float, origin_lon_deg: float, epoch_s: int) -> None:
        self._origin_deg = (origin_lat_deg, origin_lon_deg)
        self._epoch_s = epoch_s
        self._writer = FrameWriter(GROUND_SYSTEM, SENSOR_COMPONENT)

    def look(self, detections: Iterable[Detection], now_s: float) -> list[bytes]:
        """Return the frames with the detections of one look at `now_s`, Unix seconds."""
        found = list(detections)
        time_ms = round((now_s - self._epoch_s) * 1000.0)
        return [
            self._writer.encode(
                DetectionsFrame(
                    self._epoch_s, time_ms, *self._origin_deg, tuple(found[start : start + DETECTIONS_PER_FRAME])
                )
            )
            for start in range(0, len(found), DETECTIONS_PER_FRAME)
        ]


class SensorChannel:
    """A mission's sensor and the channel to its ground station, in a simulated flight."""

    def __init__(self, mission: Mission, epoch_s: float, ground: GroundStation) -> None:
        """Connect the sensor, whose epoch is `epoch_s` in Unix seconds, to the ground station."""
        self._sensor = mission_sensor(mission, int(epoch_s))
        self._ground = ground

    def look(self, detections: Iterable[Detection], now_s: float) -> None:
        """Send the detections of one look at `now_s`, Unix seconds, to the ground station."""
        for datagram in self._sensor.look(detections, now_s):
            self._ground.sense(datagram, now_s)


def detection_of_row(kind: Kind, identity: int, row: np.ndarray) -> Detection:
    """Return the detection of an object with a row (4,): north m, east m, heading deg, speed m/s."""
    north_m, east_m, heading_deg, speed_m_s = map(float, row)
    heading_rad = math.radians(heading_deg)
    return Detection(
        kind, identity, north_m, east_m, speed_m_s * math.cos(heading_rad), speed_m_s * math.sin(heading_rad)
    )


def world_detections(mission: Mission, targets: np.ndarray, threats: np.ndarray) -> list[Detection]:
    """Return the detections of a mission's targets and threats from their rows, (K, 4) and (M, 4)."""
    return [
        detection_of_row(kind, spec.id, row)
        for kind, specs, rows in ((Kind.TARGET, mission.targets, targets), (Kind.THREAT, mission.threats, threats))
        for spec, row in zip(specs, rows, strict=True)
    ]


def mission_sensor(mission: Mission, epoch_s: int) -> Sensor:
    """Return the sensor of a mission's ground station; its times count from `epoch_s`, Unix seconds."""
    return Sensor(mission.origin.lat_deg, mission.origin.lon_deg, epoch_s)
