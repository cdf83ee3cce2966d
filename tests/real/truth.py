"""The truth of a flight: what each simulator itself says of its vehicle, and the trajectory that it makes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from companion.geo.local_frame import LocalFrame
from companion.mission.model import Mission
from sim.trajectory import Trajectory, TrajectoryBuilder
from sim.world import World

STEP_S = 0.1
"""Time between two samples of the trajectory."""
_SLOW_M_S = 0.3
"""Speed over ground below which a vehicle's heading of motion means nothing, and the last one counts."""
_DEGREES_E7 = 1e7


class Sample(NamedTuple):
    """One word of a simulator on its vehicle, in the mission's plane."""

    t_unix_s: float
    north_m: float
    east_m: float
    altitude_m: float
    """Above sea level."""
    v_north_m_s: float
    v_east_m_s: float

    @property
    def speed_m_s(self) -> float:
        """Speed over ground."""
        return math.hypot(self.v_north_m_s, self.v_east_m_s)

    @property
    def row(self) -> tuple[float, float, float, float]:
        """North m, east m, heading of motion in degrees, speed m/s."""
        heading_deg = math.degrees(math.atan2(self.v_east_m_s, self.v_north_m_s)) % 360.0
        return self.north_m, self.east_m, heading_deg, self.speed_m_s


def sample_of(message: Any, t_unix_s: float, frame: LocalFrame) -> Sample | None:  # noqa: ANN401 - of pymavlink
    """Return what SIM_STATE (ArduPilot) or HIL_STATE_QUATERNION (PX4) says; None for another message."""
    if message.get_type() == "SIM_STATE":
        lat_deg, lon_deg = message.lat_int / _DEGREES_E7, message.lon_int / _DEGREES_E7
        altitude_m, velocity_m_s = message.alt, (message.vn, message.ve)
    elif message.get_type() == "HIL_STATE_QUATERNION":
        lat_deg, lon_deg = message.lat / _DEGREES_E7, message.lon / _DEGREES_E7
        altitude_m, velocity_m_s = message.alt / 1000.0, (message.vx / 100.0, message.vy / 100.0)
    else:
        return None
    return Sample(t_unix_s, *frame.to_local(lat_deg, lon_deg), altitude_m, *velocity_m_s)


def trajectory_of(
    samples: Mapping[int, Sequence[Sample]], mission: Mission, seed: int, begin_unix_s: float
) -> Trajectory:
    """Return the trajectory of agents by id from a time on, at which the mission's targets and threats set out."""
    end_unix_s = min(seen[-1].t_unix_s for seen in samples.values())
    t_s = np.arange(0.0, end_unix_s - begin_unix_s, STEP_S)
    rows = np.stack([_rows(samples[agent.id], t_s + begin_unix_s) for agent in mission.agents], axis=1)
    world = World(mission, seed)
    builder = TrajectoryBuilder(
        [agent.id for agent in mission.agents],
        [target.id for target in mission.targets],
        [threat.id for threat in mission.threats],
    )
    for now_s, agents in zip(t_s, rows, strict=True):
        world.advance(float(now_s))
        builder.append(float(now_s), agents, *world.rows())
    return builder.build()


def _rows(seen: Sequence[Sample], t_unix_s: np.ndarray) -> np.ndarray:  # (S, 4)
    """Return north m, east m, heading deg and speed m/s at the times (S,), between what was said."""
    said = np.array(seen)
    north_m, east_m, _, v_north_m_s, v_east_m_s = (np.interp(t_unix_s, said[:, 0], said[:, i]) for i in range(1, 6))
    speed_m_s = np.hypot(v_north_m_s, v_east_m_s)
    heading_deg = np.degrees(np.arctan2(v_east_m_s, v_north_m_s)) % 360.0
    moves = np.where(speed_m_s > _SLOW_M_S, np.arange(len(t_unix_s)), 0)
    return np.column_stack([north_m, east_m, heading_deg[np.maximum.accumulate(moves)], speed_m_s])
