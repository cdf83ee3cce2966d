"""Case II: where each agent must be by now, found by flying its own companion on what was broadcast to it.

The centre does not see its agents (docs/method.md section 1, point 7; paper: update2). It knows where they began,
what each
was told and what steers them, so it lets a companion of its own, the very code that flies, decide for each of them, and
moves the agent as that says. How far off it may be is an uncertainty that grows with time, by the bound of the wind
too, and shrinks when the agent is heard of. It is no bound where frames are lost or an autopilot lags: a vehicle that
missed a broadcast flies on for a broadcast period as it did before.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

from companion.autopilot.point import PointAdapter
from companion.autopilot.telemetry import Neighbour
from companion.geo.kinematics import advance, turn_rate_rad_s, turn_towards
from companion.geo.local_frame import LocalFrame
from companion.guidance.laws import SteeringOf
from companion.guidance.settings import LawName
from companion.mission.model import AgentSpec, Mission
from companion.onboard.companion import Companion
from companion.onboard.config import config_for_agent
from companion.onboard.law_settings import law_settings

DRIFT_SHARE = 0.01
"""Of the distance that an agent may have flown: how much of it the reckoning may be wrong by in still air."""
FIX_ERROR_M = 10.0
"""What a report, or a place in the mission file, is wrong by: a satellite fix, and the step that it was made in."""
_TOLERANCE_S = 1e-6


@dataclass(frozen=True)
class Estimate:
    """Where an agent must be, and how far off that may be."""

    north_m: float
    east_m: float
    heading_rad: float
    speed_m_s: float
    flown_m: float
    uncertainty_m: float


class DeadReckoner:
    """Reckons all agents of one mission; times are Unix seconds given by the caller."""

    def __init__(
        self, mission: Mission, now_s: float, law: LawName, can_stop: bool, steering: SteeringOf | None = None
    ) -> None:
        """Begin with the agents where the mission says; `can_stop` is the kind of vehicle that they are.

        `steering` makes the law that they fly by, where it is not one of the companion's own.
        """
        self._delay_s = mission.link.delay_s
        self._step_s = mission.guidance_step_s
        self._detector_range_m = mission.detector_range_m
        self._wind_bound_m_s = mission.wind.speed_m_s + mission.wind.gust_m_s
        self._start_s = self._at_s = now_s
        self._steps = 0
        self._decided = False
        self._frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
        self._agents = {
            spec.id: _Reckoned(mission, spec, self._frame, now_s, law, can_stop, steering) for spec in mission.agents
        }
        self._under_way: list[tuple[float, int, bytes]] = []
        self._heard = 0

    def hear(self, datagram: bytes, now_s: float) -> None:
        """Take in a frame that was broadcast at `now_s`: the agents hear it when the link has carried it."""
        self._heard += 1
        heapq.heappush(self._under_way, (now_s + self._delay_s, self._heard, datagram))

    def advance(self, now_s: float, flying: Collection[int]) -> None:
        """Let the agents `flying`, by id, decide and move until `now_s`; the others stay where they are."""
        moving = [self._agents[identity] for identity in self._agents if identity in flying]
        while self._at_s < now_s - _TOLERANCE_S:
            if not self._decided:
                self._decide(moving)
            if self._at_s + self._step_s > now_s + _TOLERANCE_S:
                break  # within a step the agents fly on as decided at its beginning
            for agent in moving:
                agent.move(self._step_s)
            self._decided = False
            # Counted, not summed: rounding must not creep over thousands of steps.
            self._steps += 1
            self._at_s = self._start_s + self._steps * self._step_s

    def _decide(self, moving: Sequence[_Reckoned]) -> None:
        """Let the agents hear what has arrived by now, see each other, and decide."""
        while self._under_way and self._under_way[0][0] <= self._at_s + _TOLERANCE_S:
            arrival_s, _, datagram = heapq.heappop(self._under_way)
            for agent in self._agents.values():
                agent.companion.hear(datagram, arrival_s)
        for agent in moving:
            agent.look(moving, self._detector_range_m, self._at_s)
        for agent in moving:
            agent.decide(self._at_s)
        self._decided = True

    def fix(
        self,
        agent_id: int,
        position_ned_m: tuple[float, float],
        velocity_m_s: tuple[float, float],
        fixed_at_s: float,
        flown_m: float | None = None,
    ) -> None:
        """Put an agent where it was heard or seen to be at `fixed_at_s`; velocity (north, east) from grid north.

        Without `flown_m` the reckoned distance flown stands.
        """
        self._agents[agent_id].fix(position_ned_m, velocity_m_s, fixed_at_s, self._at_s, flown_m)

    def estimate(self, agent_id: int, now_s: float) -> Estimate:
        """Return where an agent must be by `now_s`, which is not before the last step."""
        agent = self._agents[agent_id]
        north_m, east_m, heading_rad = agent.ahead(now_s - self._at_s)
        rate_m_s = DRIFT_SHARE * agent.spec.speed_m_s + self._wind_bound_m_s
        return Estimate(
            north_m,
            east_m,
            heading_rad,
            agent.speed_m_s,
            agent.companion.flown_m,
            agent.fix_error_m + rate_m_s * max(0.0, now_s - agent.fixed_at_s),
        )


class _Reckoned:
    """One agent as it must be by now."""

    def __init__(
        self,
        mission: Mission,
        spec: AgentSpec,
        frame: LocalFrame,
        now_s: float,
        law: LawName,
        can_stop: bool,
        steering: SteeringOf | None,
    ) -> None:
        config = config_for_agent(mission, spec.id, law)
        self.spec = spec
        self.north_m, self.east_m = spec.position_ned_m
        self._adapter = PointAdapter(can_stop, frame.to_global(self.north_m, self.east_m), config.height_m)
        self.companion = Companion(config, self._adapter, None if steering is None else steering(law_settings(config)))
        self.heading_rad = math.radians(spec.heading_deg or 0.0)
        self.speed_m_s = 0.0 if can_stop else spec.speed_m_s
        self.fixed_at_s = now_s
        self.fix_error_m = FIX_ERROR_M
        self._frame = frame
        self._altitude_m = mission.origin.alt_m + config.height_m
        self._wanted_rad = self.heading_rad
        self._circles = False

    def look(self, others: Iterable[_Reckoned], range_m: float, now_s: float) -> None:
        """See who is near, as the vehicle's own detector would."""
        self._adapter.neighbours = [
            other.as_neighbour(now_s)
            for other in others
            if other is not self and math.hypot(other.north_m - self.north_m, other.east_m - self.east_m) <= range_m
        ]

    def as_neighbour(self, now_s: float) -> Neighbour:
        lat_deg, lon_deg, convergence_rad = self._frame.to_global_with_convergence(self.north_m, self.east_m)
        course_rad = self.heading_rad + convergence_rad
        velocity_m_s = (self.speed_m_s * math.cos(course_rad), self.speed_m_s * math.sin(course_rad))
        return Neighbour(self.spec.id, lat_deg, lon_deg, *velocity_m_s, now_s, self._altitude_m)

    def decide(self, now_s: float) -> None:
        self._adapter.tell(self.as_neighbour(now_s), None, now_s)
        self._adapter.setpoint = None
        decision, _ = self.companion.tick(now_s)
        if self._adapter.setpoint is not None:
            self._wanted_rad, self.speed_m_s = self._adapter.setpoint.heading_rad, self._adapter.setpoint.speed_m_s
        # Until its companion has a picture, what cannot stop circles where it is.
        self._circles = decision.setpoint is None and not self._adapter.can_stop

    def move(self, dt_s: float) -> None:
        self.north_m, self.east_m, self.heading_rad = self.ahead(dt_s)

    def ahead(self, dt_s: float) -> tuple[float, float, float]:
        """Return (north_m, east_m, heading_rad) after flying on as last decided."""
        rate_rad_s = turn_rate_rad_s(self.speed_m_s, self.spec.n_max)
        if self._circles:
            return advance(self.north_m, self.east_m, self.heading_rad, self.speed_m_s, rate_rad_s, dt_s)
        return turn_towards(
            self.north_m, self.east_m, self.heading_rad, self.speed_m_s, self._wanted_rad, rate_rad_s, dt_s
        )

    def fix(
        self,
        position_ned_m: tuple[float, float],
        velocity_m_s: tuple[float, float],
        fixed_at_s: float,
        reckoned_at_s: float,
        flown_m: float | None,
    ) -> None:
        since_s = reckoned_at_s - fixed_at_s
        self.north_m = position_ned_m[0] + velocity_m_s[0] * since_s
        self.east_m = position_ned_m[1] + velocity_m_s[1] * since_s
        speed_m_s = math.hypot(*velocity_m_s)
        if speed_m_s > 0.0:
            self.heading_rad = math.atan2(velocity_m_s[1], velocity_m_s[0])
            self._wanted_rad = self.heading_rad
        self.companion.relocate(self.companion.flown_m if flown_m is None else flown_m + max(0.0, since_s) * speed_m_s)
        self.fixed_at_s = fixed_at_s
        self.fix_error_m = FIX_ERROR_M
