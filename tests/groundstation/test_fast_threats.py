"""Fast aircraft from a live source: a steady one begins one revision and breaks no bound on board, one that jumps does.

What a vehicle is told is heard there by the code on board, with the rounding of the wire, and judged by its guard.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, field
from typing import NamedTuple

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from companion.guard.threats import ThreatMonitor
from companion.guard.types import THREAT_CHANGED
from companion.onboard.steering import discs_of
from companion.onboard.world_model import WorldModel
from companion.protocol.codec import FrameReader, FrameWriter
from groundstation.ground_station import GroundStation
from groundstation.sources.sources import Sources
from tests.groundstation.sources.given import START_S, ObeyingDesk, mission, sighting

SOURCE = "{name: s, kind: csv, file: x, radius_m: 500, within_m: 200000, error_m: 200}"
TIGHT = SOURCE.replace("}", ", speed_bound_m_s: 401}")
SLOW = SOURCE.replace("}", ", speed_bound_m_s: 30}")
"""With bounds that leave the fastest, and slower ones, hardly any room."""
LASTS_S = 60.0
STATE_BYTES, FLEET_BYTES = 255, 120
"""Payloads that hold a whole state, and only packed parts of it."""


@dataclass
class Vehicle:
    """What a vehicle makes of a broadcast of which it hears everything."""

    world: WorldModel = field(default_factory=lambda: WorldModel(1))
    monitor: ThreatMonitor = field(default_factory=ThreatMonitor)
    said: list[str] = field(default_factory=list)
    judged_s: float = START_S

    def hear(self, datagrams: list[bytes], now_s: float) -> None:
        for datagram in datagrams:
            for frame in FrameReader().read(datagram):
                self.world.take(frame, now_s)
        self.monitor.elapse(now_s - self.judged_s)
        self.judged_s = now_s
        self.said += self.monitor.contradicted_by(discs_of(self.world.view(now_s), "detection"))


class Day:
    """An aircraft that comes from the north, a source that sees it, the ground station and a vehicle."""

    def __init__(self, payload_bytes: int, source: str) -> None:
        made = mission(source)
        self.station = GroundStation(made, START_S)
        self.sources = Sources(made, made.sources)
        self.sources.feeds["s"].link.fault = None
        self.desk = ObeyingDesk(self.station)
        self.vehicle = Vehicle()
        self.revisions: list[int] = []
        self._payload_bytes = payload_bytes
        self._writer = FrameWriter()

    def see(self, north_m: float, east_m: float, speed_m_s: float, t_s: float) -> None:
        seen = sighting("A", north_m, east_m, START_S + t_s, velocity=complex(-speed_m_s, 0.0))
        self.sources.feeds["s"].offer([seen], START_S + t_s)
        self.desk.now_s = START_S + t_s
        self.sources.tick(self.station, self.desk, START_S + t_s)

    def broadcast(self, t_s: float) -> None:
        now_s = START_S + t_s
        self.station.advance(now_s)
        frames = [*self.station.refresh(now_s, self._payload_bytes), *self.station.carousel(now_s, self._payload_bytes)]
        self.vehicle.hear([self._writer.encode(frame) for frame in frames], now_s)
        self.revisions.append(self.station.revision)


class Flight(NamedTuple):
    """How an aircraft flies, and how it is seen and told."""

    speed_m_s: float
    period_s: float = 1.0
    error_m: float = 0.0
    payload_bytes: int = STATE_BYTES
    seen_every_s: float = 1.0
    jump_m: float = 0.0
    """How far it jumps in the middle."""
    source: str = SOURCE


def flown(flight: Flight) -> Day:
    """Fly past for LASTS_S."""
    day, noise = Day(flight.payload_bytes, flight.source), random.Random(7)
    due_s, seen_s = 0.5, 0.0
    for tick in range(round(4 * LASTS_S)):
        t_s = 0.25 * tick
        if t_s >= seen_s:
            seen_s += flight.seen_every_s
            # Both axes together are off by less than the error.
            off = [0.7 * flight.error_m * noise.uniform(-1.0, 1.0) for _ in range(2)]
            east_m = 6_000.0 + off[1] + (flight.jump_m if t_s >= LASTS_S / 2.0 else 0.0)
            day.see(20_000.0 - flight.speed_m_s * t_s + off[0], east_m, flight.speed_m_s, t_s)
        if t_s >= due_s:
            due_s += flight.period_s
            day.broadcast(t_s)
    return day


@settings(max_examples=20, deadline=None)
@given(
    speed_m_s=st.floats(0.0, 400.0),
    period_s=st.floats(0.5, 10.0),
    error_m=st.floats(0.0, 200.0),
    payload_bytes=st.sampled_from([STATE_BYTES, FLEET_BYTES]),
    seen_every_s=st.sampled_from([0.5, 1.0, 3.0]),
    source=st.sampled_from([SOURCE, TIGHT]),
)
@example(400.0, 0.5, 200.0, STATE_BYTES, 0.5, TIGHT)
@example(29.0, 0.5, 200.0, STATE_BYTES, 1.0, SLOW)
@example(400.0, 0.75, 0.0, FLEET_BYTES, 3.0, TIGHT)
def test_a_steady_aircraft_begins_one_revision_and_breaks_no_bound_on_board(
    speed_m_s: float, period_s: float, error_m: float, payload_bytes: int, seen_every_s: float, source: str
) -> None:
    day = flown(Flight(speed_m_s, period_s, error_m, payload_bytes, seen_every_s, source=source))
    assert day.station.revision <= 2
    assert day.vehicle.said == []
    assert len(day.station.mission.threats) == 1


@pytest.mark.parametrize("payload_bytes", [STATE_BYTES, FLEET_BYTES])
@pytest.mark.parametrize("speed_m_s", [100.0, 290.0])
def test_one_that_really_jumps_begins_another_and_is_said_to_have_changed(speed_m_s: float, payload_bytes: int) -> None:
    day = flown(Flight(speed_m_s, payload_bytes=payload_bytes, jump_m=3_000.0))
    assert day.revisions[-1] == 3
    assert day.vehicle.said == [THREAT_CHANGED]


def test_a_fast_one_is_told_with_the_radius_that_was_given_and_a_bound_above_its_speed() -> None:
    day = flown(Flight(290.0, 5.0))
    (threat,) = day.station.mission.threats
    assert threat.detection_radius_m == 500.0
    assert 290.0 <= threat.speed_bound_m_s <= 1.25 * 290.0
