"""What was commanded and what the vehicle did, as arrays, from the records of a flight log."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np

from companion.autopilot.adapter import Abilities, Adapter
from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.geo.local_frame import LocalFrame
from companion.onboard.companion import adapter_of
from companion.onboard.config import Config
from companion.onboard.flight_log import Mark, mark_of
from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM, decode_frame
from companion.protocol.dialect import oneway
from companion.protocol.frame import RawFrame, raw_frame
from companion.protocol.messages import DecisionFrame

LONGEST_GAP_S = 3.0
"""Time without a decision or a position after which a new stretch begins."""
STEADY_CLOCK_S = 0.5
"""Greatest spread of the telemetry's delay with which the autopilot's own clock is used instead of when it came."""


class Track(NamedTuple):
    """A flight's commands and motion. Headings of commands are from grid north, which is true north within a degree."""

    commands: np.ndarray  # (K, 3): time s, heading rad, speed m/s; NaN where no setpoint was in force
    motions: np.ndarray  # (N, 6): time s, autopilot's clock s, north m, east m, velocity north m/s, east m/s
    winds: np.ndarray  # (W, 3): time s, wind's velocity north m/s and east m/s, as the autopilot told it
    abilities: Abilities
    """The vehicle's abilities by the parameters that the log holds."""
    refusal: str | None = None
    """Why the log is not one of the configuration's autopilot; None if it is, or holds no autopilot's heartbeat."""


class Stretch(NamedTuple):
    """A part of a flight over which the vehicle was steered without a gap."""

    command_s: np.ndarray  # (K,) s
    heading_rad: np.ndarray  # (K,) rad, unwrapped
    speed_m_s: np.ndarray  # (K,) m/s
    reply_s: np.ndarray  # (N,) s
    place_ned_m: np.ndarray  # (N, 2) m
    velocity_m_s: np.ndarray  # (N, 2) m/s


def track_of(records: Iterable[tuple[float, bytes]], config: Config) -> Track:
    """Return the track in a log's records (t_unix_s, frame), read by the adapter of the configuration's autopilot."""
    reader = _Reader(adapter_of(config))
    for t_s, data in records:
        reader.take(t_s, data)
    return reader.track()


def stretches(track: Track) -> Iterator[Stretch]:
    """Yield the stretches of a track that have commands and motion."""
    times_s, headings_rad = track.commands[:, 0], track.commands[:, 1]
    given = np.isfinite(headings_rad)
    follows = np.zeros(len(times_s), dtype=bool)
    follows[1:] = given[1:] & given[:-1] & (np.diff(times_s) <= LONGEST_GAP_S)
    starts = np.nonzero(given & ~follows)[0]
    for start in starts.tolist():
        end = start + 1
        while end < len(times_s) and follows[end]:
            end += 1
        # What ended the stretch is the next command, or the time after which one is missed.
        ends_s = times_s[end - 1] + LONGEST_GAP_S
        if end < len(times_s):
            ends_s = min(ends_s, times_s[end])
        motions = track.motions[(track.motions[:, 0] >= times_s[start]) & (track.motions[:, 0] <= ends_s)]
        if end - start < 2 or len(motions) < 2:
            continue
        yield Stretch(
            times_s[start:end],
            np.unwrap(headings_rad[start:end]),
            track.commands[start:end, 2],
            _steady_s(motions),
            motions[:, 2:4],
            motions[:, 4:6],
        )


def _steady_s(motions: np.ndarray) -> np.ndarray:
    """Return the times of motions by the autopilot's clock, delayed as on average, so that a link's jitter is gone."""
    delays_s = motions[:, 0] - motions[:, 1]
    typical_s = float(np.median(delays_s))
    steady = np.isfinite(typical_s) and float(np.percentile(np.abs(delays_s - typical_s), 95)) <= STEADY_CLOCK_S
    times_s: np.ndarray = motions[:, 1] + typical_s if steady else motions[:, 0]
    return times_s


class _Reader:
    """Collects commands and motion from the frames of a log, one after the other."""

    def __init__(self, adapter: Adapter) -> None:
        self._adapter = adapter
        self._frame: LocalFrame | None = None
        self._commands: list[tuple[float, float, float]] = []
        self._motions: list[tuple[float, ...]] = []
        self._winds: list[tuple[float, float, float]] = []

    def take(self, t_s: float, data: bytes) -> None:
        """Take in one frame of the log, as a replay sorts them."""
        frame = raw_frame(data)
        if frame.version == 2:
            if frame.message_id == oneway.MAVLINK_MSG_ID_ONEWAY_DECISION:
                self._decided(t_s, frame)
                return
            if frame.sender == (GROUND_SYSTEM, GROUND_COMPONENT):
                return
            if frame.component == COMPANION_COMPONENT:
                if mark_of(frame) is Mark.WITHDRAWN:
                    self._commands.append((t_s, math.nan, math.nan))
                return
        before = self._adapter.telemetry
        self._adapter.receive(data, t_s)
        telemetry = self._adapter.telemetry
        if telemetry.position_at_s != before.position_at_s:
            self._moved(t_s)
        if telemetry.wind_ned_m_s is not None and telemetry.wind_ned_m_s != before.wind_ned_m_s:
            self._winds.append((t_s, *telemetry.wind_ned_m_s))

    def track(self) -> Track:
        """Return what was collected."""
        return Track(
            np.array(self._commands, dtype=float).reshape(-1, 3),
            np.array(self._motions, dtype=float).reshape(-1, 6),
            np.array(self._winds, dtype=float).reshape(-1, 3),
            self._adapter.abilities,
            self._adapter.refusal,
        )

    def _decided(self, t_s: float, frame: RawFrame) -> None:
        decision = decode_frame(frame)
        if isinstance(decision, DecisionFrame):
            self._commands.append((t_s, decision.heading_rad, decision.speed_m_s))

    def _moved(self, t_s: float) -> None:
        telemetry = self._adapter.telemetry
        if self._frame is None:
            self._frame = LocalFrame(telemetry.lat_deg, telemetry.lon_deg)
        boot_s = math.nan if telemetry.boot_ms is None else telemetry.boot_ms / 1000.0
        self._motions.append(
            (
                t_s,
                boot_s,
                *self._frame.to_local(telemetry.lat_deg, telemetry.lon_deg),
                telemetry.velocity_north_m_s,
                telemetry.velocity_east_m_s,
            )
        )
