"""Dead reckoning of agents in Case II: each is simulated with its own companion, fed with the frames broadcast to it.

The ground station does not see its agents (docs/method.md section 1, point 7; paper: update2). It knows their starts,
the frames sent to them and the law that steers them, so it runs one companion for each agent, the very code that flies,
and moves the agent as that decides. The uncertainty of a position grows with time, also by the bound of the wind, and
shrinks when the agent reports. It is no bound if frames are lost or an autopilot lags: a vehicle that missed a
broadcast flies on for a broadcast period as it did before.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from companion.autopilot.aircraft import Neighbour
from companion.autopilot.point import PointAdapter
from companion.errors import InputError
from companion.geo.kinematics import advance, turn_rate_rad_s, turn_towards
from companion.geo.local_frame import LocalFrame
from companion.guidance.laws import SteeringOf
from companion.guidance.settings import LawName
from companion.mission.model import AgentSpec, Mission
from companion.onboard.companion import Companion
from companion.onboard.config import config_for_agent, fast_enough
from companion.onboard.law_settings import law_settings
from companion.protocol.codec import DecisionFrame, DetectionsFrame, FrameWriter, ReportFrame, decode_frame
from companion.protocol.frame import raw_frame

DRIFT_SHARE = 0.01
"""Error of dead reckoning in still air, as a share of the distance that an agent may have flown."""
FIX_ERROR_M = 10.0
"""Error of a position in a report or the mission file: that of a satellite fix and of the step in which it was made."""
LONGEST_RECKONED_S = 60.0
"""Time that is reckoned at once at most: more would keep the broadcast waiting for seconds."""
_TOLERANCE_S = 1e-6


@dataclass(frozen=True)
class Estimate:
    """Dead-reckoned state of an agent, and the uncertainty of its position."""

    north_m: float
    east_m: float
    heading_rad: float
    speed_m_s: float
    flown_m: float
    uncertainty_m: float
    across_m: float = 0.0
    """Uncertainty across the heading, where only wind and fix count; the drift is along it."""


@dataclass(frozen=True)
class Fix:
    """Position and velocity that an agent reported."""

    position_ned_m: tuple[float, float]
    velocity_m_s: tuple[float, float]
    """Velocity (north, east) in the axes of the grid."""
    fixed_at_s: float
    flown_m: float | None = None
    """Distance flown; None keeps the dead-reckoned distance."""


@dataclass(frozen=True)
class VehicleModel:
    """Vehicle and guidance law that dead reckoning assumes for all agents."""

    law: LawName = "seed"
    can_stop: bool = False
    steering: SteeringOf | None = None
    """Makes the steering law; None: the companion's own law named by `law`."""


def restamped(datagram: bytes, ahead_s: float) -> bytes:
    """Return an unsigned frame of the broadcast with the stamp that it has by the clock of the dead reckoning.

    The frame's own stamp is by a clock that is `ahead_s` ahead of that.
    """
    if ahead_s == 0.0:
        return datagram
    frame = decode_frame(raw_frame(datagram))
    assert not isinstance(frame, DetectionsFrame | ReportFrame | DecisionFrame)
    stamp = frame.stamp
    epoch_s = math.floor(stamp.epoch_s - ahead_s)
    time_ms = max(0, round((stamp.unix_s - ahead_s - epoch_s) * 1000.0))
    return FrameWriter().encode(replace(frame, stamp=replace(stamp, epoch_s=epoch_s, time_ms=time_ms)))


def check_reckonable(mission: Mission, model: VehicleModel, source: str) -> None:
    """Raise InputError if the guard could hold no vehicle at the speed of an agent; `source` names the file."""
    for index, spec in enumerate(mission.agents):
        allowed = fast_enough(spec.speed_m_s, model.can_stop)
        if allowed is not None:
            raise InputError(f"{source}: agents[{index}].speed_m_s: {spec.speed_m_s:g}; allowed: {allowed}")


class DeadReckoner:
    """Dead-reckons all agents of one mission; times are Unix seconds given by the caller."""

    def __init__(self, mission: Mission, now_s: float, model: VehicleModel) -> None:
        """Begin with the agents at the mission's positions.

        Raises:
            InputError: the guard could hold no vehicle at the speed of an agent.

        """
        check_reckonable(mission, model, mission.name)
        self._delay_s = mission.link.delay_s
        self._step_s = mission.guidance_step_s
        self._detector_range_m = mission.detector_range_m if mission.detector == "adsb" else -1.0
        self._wind_bound_m_s = mission.wind.speed_m_s + mission.wind.gust_m_s
        self._start_s = self._at_s = now_s
        self._steps = 0
        self._decided = False
        frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
        self._agents = {spec.id: _ReckonedAgent(mission, spec, frame, now_s, model) for spec in mission.agents}
        self._under_way: list[tuple[float, int, bytes]] = []
        self._heard = 0

    def hear(self, datagram: bytes, now_s: float) -> None:
        """Queue a frame that was broadcast at `now_s`; the agents hear it after the link's delay."""
        self._heard += 1
        heapq.heappush(self._under_way, (now_s + self._delay_s, self._heard, datagram))

    def advance(self, now_s: float, flying: Collection[int]) -> None:
        """Let the agents whose ids are in `flying` decide and move until `now_s`; the others do not move."""
        moving = [self._agents[identity] for identity in self._agents if identity in flying]
        skipped = math.floor((now_s - self._at_s - LONGEST_RECKONED_S) / self._step_s)
        if skipped > 0:
            # As after the computer slept: what so long a time did to an agent no reckoning tells, only how far it flew.
            self._steps += skipped
            self._at_s = self._start_s + self._steps * self._step_s
            for agent in self._agents.values():
                agent.skipped_s += skipped * self._step_s
        while self._at_s < now_s - _TOLERANCE_S:
            if not self._decided:
                self._decide(moving)
            if self._at_s + self._step_s > now_s + _TOLERANCE_S:
                break  # within a step the agents fly on as decided at its beginning
            for agent in moving:
                agent.move(self._step_s)
            self._decided = False
            # Steps are counted, not summed, so that rounding does not creep over thousands of them.
            self._steps += 1
            self._at_s = self._start_s + self._steps * self._step_s

    def _decide(self, moving: Sequence[_ReckonedAgent]) -> None:
        """Let the agents hear the frames that have arrived by now, see each other, and decide."""
        while self._under_way and self._under_way[0][0] <= self._at_s + _TOLERANCE_S:
            arrival_s, _, datagram = heapq.heappop(self._under_way)
            for agent in self._agents.values():
                agent.companion.hear(datagram, arrival_s)
        for agent in moving:
            agent.look(moving, self._detector_range_m, self._at_s)
        for agent in moving:
            agent.decide(self._at_s)
        self._decided = True

    def fix(self, agent_id: int, fix: Fix) -> None:
        """Move an agent to its reported position."""
        self._agents[agent_id].fix(fix, self._at_s)

    def follow(self, agent_id: int, fix: Fix) -> None:
        """Move an agent to where it was seen, if that is news."""
        if fix.fixed_at_s > self._agents[agent_id].fixed_at_s:
            self.fix(agent_id, fix)

    def resume(self, agent_id: int, fix: Fix, known_at_s: float) -> None:
        """Go on with an agent where a run before had it, whose place was last known at `known_at_s`."""
        agent, silent_s = self._agents[agent_id], self._at_s - fix.fixed_at_s
        is_long = silent_s > LONGEST_RECKONED_S
        agent.fix(replace(fix, fixed_at_s=self._at_s) if is_long else fix, self._at_s)
        agent.skipped_s = silent_s if is_long else 0.0
        agent.fixed_at_s = min(fix.fixed_at_s, known_at_s)

    def fixed_at_s(self, agent_id: int) -> float:
        """Return the time at which an agent's place was last known."""
        return self._agents[agent_id].fixed_at_s

    def estimate(self, agent_id: int, now_s: float) -> Estimate:
        """Return an agent's dead-reckoned state at `now_s`, which is not before the last step."""
        agent = self._agents[agent_id]
        motion = agent.motion.ahead(agent.spec.n_max, now_s - self._at_s)
        since_s = max(0.0, now_s - agent.fixed_at_s)
        across_m = FIX_ERROR_M + self._wind_bound_m_s * since_s + agent.spec.speed_m_s * agent.skipped_s
        return Estimate(
            motion.north_m,
            motion.east_m,
            motion.heading_rad,
            motion.speed_m_s,
            agent.companion.flown_m,
            across_m + DRIFT_SHARE * agent.spec.speed_m_s * since_s,
            across_m,
        )


@dataclass(frozen=True)
class _Motion:
    """Position and motion of a dead-reckoned agent, as last decided."""

    north_m: float
    east_m: float
    heading_rad: float
    speed_m_s: float
    commanded_rad: float
    """Heading to which the agent turns."""
    circles: bool = False
    """Whether the agent circles instead of turning to that heading."""

    def ahead(self, n_max: float, dt_s: float) -> _Motion:
        """Return the motion after `dt_s`, continued as last decided."""
        rate_rad_s = turn_rate_rad_s(self.speed_m_s, n_max)
        pose = (self.north_m, self.east_m, self.heading_rad, self.speed_m_s)
        if self.circles:
            north_m, east_m, heading_rad = advance(*pose, rate_rad_s, dt_s)
        else:
            north_m, east_m, heading_rad = turn_towards(*pose, self.commanded_rad, rate_rad_s, dt_s)
        return replace(self, north_m=north_m, east_m=east_m, heading_rad=heading_rad)


class _ReckonedAgent:
    """One dead-reckoned agent, with the companion that decides for it."""

    def __init__(self, mission: Mission, spec: AgentSpec, frame: LocalFrame, now_s: float, model: VehicleModel) -> None:
        config = config_for_agent(mission, spec.id, model.law)
        law = None if model.steering is None else model.steering(law_settings(config))
        self.spec = spec
        heading_rad = math.radians(spec.heading_deg or 0.0)
        speed_m_s = 0.0 if model.can_stop else spec.speed_m_s
        self.motion = _Motion(*spec.position_ned_m, heading_rad, speed_m_s, heading_rad)
        self._adapter = PointAdapter(model.can_stop, frame.to_global(*spec.position_ned_m), config.height_m)
        self.companion = Companion(config, self._adapter, law)
        self.fixed_at_s = now_s
        self.skipped_s = 0.0
        """Time since the last fix that was not reckoned."""
        self._frame = frame
        self._altitude_m = mission.origin.alt_m + config.height_m

    def look(self, others: Iterable[_ReckonedAgent], range_m: float, now_s: float) -> None:
        """Give the companion the agents within range as neighbours, as the vehicle's own detector would."""
        here = self.motion
        self._adapter.neighbours = [
            other.as_neighbour(now_s)
            for other in others
            if other is not self
            and math.hypot(other.motion.north_m - here.north_m, other.motion.east_m - here.east_m) <= range_m
        ]

    def as_neighbour(self, now_s: float) -> Neighbour:
        """Return the agent as a neighbour's detector would see it."""
        motion = self.motion
        lat_deg, lon_deg, convergence_rad = self._frame.to_global_with_convergence(motion.north_m, motion.east_m)
        course_rad = motion.heading_rad + convergence_rad
        velocity_m_s = (motion.speed_m_s * math.cos(course_rad), motion.speed_m_s * math.sin(course_rad))
        return Neighbour(self.spec.id, lat_deg, lon_deg, *velocity_m_s, now_s, self._altitude_m)

    def decide(self, now_s: float) -> None:
        """Let the companion decide, and set the motion by its setpoint."""
        self._adapter.tell(self.as_neighbour(now_s), None, now_s)
        self._adapter.setpoint = None
        decision, _ = self.companion.tick(now_s)
        setpoint = self._adapter.setpoint
        motion = self.motion
        if setpoint is not None:
            motion = replace(motion, commanded_rad=setpoint.heading_rad, speed_m_s=setpoint.speed_m_s)
        # Until its companion has a picture, a vehicle that cannot stop circles.
        self.motion = replace(motion, circles=decision.setpoint is None and not self._adapter.can_stop)

    def move(self, dt_s: float) -> None:
        """Continue the motion for `dt_s`."""
        self.motion = self.motion.ahead(self.spec.n_max, dt_s)

    def fix(self, fix: Fix, reckoned_at_s: float) -> None:
        """Move the agent to a reported position, extrapolated by its velocity to the time of the dead reckoning."""
        since_s = reckoned_at_s - fix.fixed_at_s
        (north_m, east_m), (north_m_s, east_m_s) = fix.position_ned_m, fix.velocity_m_s
        self.motion = replace(self.motion, north_m=north_m + north_m_s * since_s, east_m=east_m + east_m_s * since_s)
        speed_m_s = math.hypot(north_m_s, east_m_s)
        if speed_m_s > 0.0:
            heading_rad = math.atan2(east_m_s, north_m_s)
            self.motion = replace(self.motion, heading_rad=heading_rad, commanded_rad=heading_rad)
        flown_m = self.companion.flown_m if fix.flown_m is None else fix.flown_m + max(0.0, since_s) * speed_m_s
        self.companion.relocate(flown_m)
        self.fixed_at_s, self.skipped_s = fix.fixed_at_s, 0.0
