"""The centre's sensor: what it sees arrives in the ground station's picture through frames."""

from __future__ import annotations

import math

import numpy as np
import pytest

from companion.protocol.codec import DETECTIONS_PER_FRAME, DetectionsFrame, FrameReader, Kind
from sim.sensor import Sensor, detection_of_row


def test_a_look_is_cut_into_frames_that_hold_everything_to_a_centimetre() -> None:
    rows = np.random.default_rng(1).uniform(-2e5, 2e5, (19, 4)) * [1.0, 1.0, 1e-3, 1e-4]
    sensor = Sensor(47.0, 8.0, 1_000)
    datagrams = sensor.look([detection_of_row(Kind.TARGET, index, row) for index, row in enumerate(rows)], 1_002.5)
    assert len(datagrams) == math.ceil(19 / DETECTIONS_PER_FRAME)
    reader = FrameReader()
    frames = [frame for datagram in datagrams for frame in reader.read(datagram)]
    assert all(isinstance(frame, DetectionsFrame) and frame.unix_s == 1_002.5 for frame in frames)
    detections = [item for frame in frames if isinstance(frame, DetectionsFrame) for item in frame.detections]
    assert [item.id for item in detections] == list(range(19))
    for item, row in zip(detections, rows, strict=True):
        assert (item.north_m, item.east_m) == pytest.approx((row[0], row[1]), abs=0.0051)


def test_nothing_to_see_is_nothing_to_send() -> None:
    assert Sensor(47.0, 8.0, 1_000).look([], 1_001.0) == []


def test_a_detection_carries_the_velocity_along_the_heading() -> None:
    detection = detection_of_row(Kind.AGENT, 1, np.array([0.0, 0.0, 90.0, 60.0]))
    assert detection.velocity_north_m_s == pytest.approx(0.0, abs=1e-9)
    assert detection.velocity_east_m_s == pytest.approx(60.0)
