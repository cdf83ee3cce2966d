"""The ground station without sockets: detections, reports and time in, broadcast frames out.

Where nothing limits the broadcast, `tick` gives what is due: state and motion frames alternate, each kind once per
broadcast period, half a period apart. Where a radio does, groundstation/schedule.py asks for what it has room for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from companion.errors import InputError
from companion.geo.kinematics import turn_rate_rad_s
from companion.geo.local_frame import LocalFrame, to_grid
from companion.guidance.laws import SteeringOf
from companion.guidance.settings import LawName
from companion.mission.model import RANGE_RESERVE, AgentSpec, Mission, agent_height_m
from companion.protocol.codec import (
    BandsFrame,
    DetectionsFrame,
    Directive,
    FleetFrame,
    Frame,
    FrameReader,
    FrameWriter,
    Kind,
    MissionFrame,
    MotionFrame,
    RadiiFrame,
    ReportFrame,
    Stamp,
    StateFrame,
    WireError,
)
from companion.protocol.dialect import oneway
from companion.protocol.fleet_codec import FLEET_HEAD_BYTES, MISSION_HEAD_BYTES, RADII_HEAD_BYTES
from companion.protocol.frame import ED25519_BYTES
from groundstation.agents import DeadReckoner
from groundstation.assignment import SWITCHING_SHARE, assign, within_range
from groundstation.broadcast import (
    MOVING_M_S,
    Unsendable,
    band_frames,
    fleet_frames,
    grown,
    mission_frame,
    motion_frames,
    radii_frames,
    state_frames,
    surrogate_digest,
    untold_growth_m,
)
from groundstation.route_cost import RouteCosts, Scene, assign_by_route_cost
from groundstation.tracks import Track, TrackTable

_DUE_TOLERANCE_S = 1e-6
MAX_EPOCH_S = 4.0e6
"""After so long (46 days) a new epoch begins: the time within one travels as 32 bits of milliseconds."""

RADII_HOLD_S = 120.0
"""So long the radii in a carousel must hold, until they have been told again."""

_STATE_BYTES, _MOTION_BYTES, _BANDS_BYTES = (
    message.unpacker.size - ED25519_BYTES
    for message in (
        oneway.MAVLink_oneway_state_message,
        oneway.MAVLink_oneway_motion_message,
        oneway.MAVLink_oneway_bands_message,
    )
)
"""Payloads without the Ed25519 signature, which always stands behind all of it."""


def check_runnable(mission: Mission, source: str) -> None:
    """Raise InputError if the mission asks for what the ground station cannot do; `source` names the file."""
    wind_m_s = mission.wind.speed_m_s + mission.wind.gust_m_s
    slowest_m_s = min(agent.speed_m_s for agent in mission.agents)
    if wind_m_s >= slowest_m_s:
        raise InputError(
            f"{source}: wind: speed_m_s and gust_m_s together {wind_m_s:g}; allowed: less than the slowest agent's "
            f"speed_m_s {slowest_m_s:g}, which could not hold a course"
        )


class GroundStation:
    """Runs one resolved mission from `start_s`; times are Unix seconds given by the caller."""

    def __init__(
        self,
        mission: Mission,
        start_s: float,
        sensed: bool = True,
        law: LawName = "seed",
        can_stop: bool = False,
        steering: SteeringOf | None = None,
        epoch_s: int | None = None,
        began_s: float | None = None,
    ) -> None:
        """Begin a run, and with it an epoch.

        The epoch is the second of `start_s` unless `epoch_s` says otherwise: one after the last run's. While it is
        ahead of the clock, frames are stamped with its beginning. `began_s` is when the threats were where the mission
        says, if that is not now: before a restart.

        Without a sensor (`sensed` false) nobody is detected. `law` and `can_stop` say what the vehicles fly by and
        whether they can stand still: in Case II they are reckoned by it, or by the law that `steering` makes.

        Raises:
            InputError: the mission asks for something the ground station cannot do.

        """
        check_runnable(mission, mission.name)
        self.mission = mission
        self.directive = Directive.NORMAL
        self._reckoner = DeadReckoner(mission, start_s, law, can_stop, steering) if mission.case == "II" else None
        self._frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
        self.tracks = TrackTable(mission, start_s, _silent_after_s(mission, sensed), began_s)
        self.unsendable = Unsendable()
        """What `tick` could not send."""
        self._specs = {agent.id: agent for agent in mission.agents}
        self.assignment: dict[int, int] = {}
        self.uncovered: tuple[int, ...] = ()
        """Targets that no agent is left for, or none that can arrive there."""
        self.reader = FrameReader()
        self._writer = FrameWriter()
        self._epoch_s = int(start_s) if epoch_s is None else epoch_s
        self._sequence = 0
        self._next_assignment_s = start_s
        self._next_state_s = start_s
        self._next_motion_s = start_s + mission.broadcast_period_s / 2.0
        self._surrogate_digest: bytes | None = None
        self._assign(start_s)
        try:
            for frame in self._state_and_bands(start_s):
                self._writer.encode(frame)
        except WireError as error:
            raise InputError(f"{mission.name}: cannot be broadcast: {error}") from error
        self._one_frame = len(self._states(start_s)) == 1
        """Whether a state frame holds everything; what there is only becomes less."""

    @property
    def epoch_s(self) -> int:
        """Unix time at which the epoch of what is broadcast began."""
        return self._epoch_s

    def sense(self, datagram: bytes, now_s: float) -> None:
        """Take in bytes from the sensor's channel; never raises, whatever the bytes."""
        for frame in self.reader.read(datagram):
            if isinstance(frame, DetectionsFrame):
                self.tracks.take(frame, now_s)

    def hear_report(self, datagram: bytes, now_s: float) -> None:
        """Take in bytes from the uplink; never raises, whatever the bytes. Case I has no use for reports."""
        for frame in self.reader.read(datagram):
            if isinstance(frame, ReportFrame) and self._reckoner is not None:
                self._take_report(frame, self._reckoner, now_s)

    def _take_report(self, report: ReportFrame, dead_reckoner: DeadReckoner, now_s: float) -> None:
        heard_at_s = self.tracks.heard_at_s.get(report.agent_id)
        true_at_s = min(now_s, report.unix_s)
        if heard_at_s is None or true_at_s < heard_at_s:
            return  # nobody of ours, or older than what is known
        north_m, east_m, convergence_rad = self._frame.to_local_with_convergence(report.lat_deg, report.lon_deg)
        velocity_m_s = to_grid(report.velocity_north_m_s, report.velocity_east_m_s, convergence_rad)
        dead_reckoner.fix(report.agent_id, (north_m, east_m), velocity_m_s, true_at_s, report.flown_m)
        self.tracks.heard_at_s[report.agent_id] = true_at_s

    def advance(self, now_s: float) -> None:
        """Bring the reckoning, the picture and the assignment up to now; `tick` does so itself."""
        if now_s - self._epoch_s > MAX_EPOCH_S:
            self._epoch_s, self._sequence = int(now_s), 0
        if self._reckoner is not None:
            self._reckoner.advance(now_s, self.tracks.present_agents)
            for identity in self.tracks.present_agents:
                self.tracks.place(identity, self._reckoner.estimate(identity, now_s), now_s)
        changed = self.tracks.update(now_s, self.assignment)
        if changed or now_s >= self._next_assignment_s - _DUE_TOLERANCE_S:
            self._assign(now_s)
            self._next_assignment_s = _after(self._next_assignment_s, self.mission.assignment_period_s, now_s)

    def tick(self, now_s: float) -> list[bytes]:
        """Return the frames to broadcast now: none unless something is due.

        A frame that cannot be made is counted in `unsendable` and left out.
        """
        self.advance(now_s)
        datagrams: list[bytes] = []
        if now_s >= self._next_state_s - _DUE_TOLERANCE_S:
            self._sequence += 1
            datagrams += self._encoded(self._state_and_bands(now_s))
            self._next_state_s = _after(self._next_state_s, self.mission.broadcast_period_s, now_s)
        if now_s >= self._next_motion_s - _DUE_TOLERANCE_S:
            datagrams += self._encoded(motion_frames(self.tracks, self.mission, self._stamp(now_s)))
            self._next_motion_s = _after(self._next_motion_s, self.mission.broadcast_period_s, now_s)
        for datagram in datagrams:
            self.overhear(datagram, now_s)
        return datagrams

    def overhear(self, datagram: bytes, now_s: float) -> None:
        """Let the agents that are reckoned (Case II) hear an unsigned frame that is broadcast now."""
        if self._reckoner is not None:
            self._reckoner.hear(datagram, now_s)

    def refresh(self, now_s: float, payload_bytes: int) -> list[StateFrame] | list[FleetFrame]:
        """Begin a broadcast of the state and return its frames, whose payloads hold at most `payload_bytes`.

        One state frame if that holds everything, else fleet frames, which take the carousel to be read.

        Raises:
            WireError: so few bytes hold nothing.

        """
        self._sequence += 1
        if self._tells_all(payload_bytes):
            return self._states(now_s)
        data_bytes = payload_bytes - FLEET_HEAD_BYTES
        stamp = self._stamp(now_s)
        return fleet_frames(self.tracks, self.mission, self.assignment, self.directive, stamp, data_bytes)

    def carousel(
        self, now_s: float, payload_bytes: int
    ) -> list[MissionFrame | RadiiFrame] | list[MotionFrame | BandsFrame]:
        """Return what goes with the state and is worth telling less often, in frames stamped now.

        With state frames that is how things move and the heights that threats reach, as far as a frame of so few bytes
        holds them; with fleet frames the mission and the radii of the threats, with their heights.
        """
        mission, stamp = self.mission, self._stamp(now_s)
        if self._tells_all(payload_bytes):
            frames: list[MotionFrame | BandsFrame] = []
            if payload_bytes >= _MOTION_BYTES:
                frames += motion_frames(self.tracks, mission, stamp)
            if payload_bytes >= _BANDS_BYTES:
                frames += band_frames(mission, stamp)
            return frames
        if self._surrogate_digest is None:
            self._surrogate_digest = surrogate_digest(mission)
        slow: list[MissionFrame | RadiiFrame] = []
        slow.append(mission_frame(mission, self._surrogate_digest, stamp, payload_bytes - MISSION_HEAD_BYTES))
        growth_m = untold_growth_m(self.tracks, mission, stamp.unix_s + RADII_HOLD_S)
        slow += radii_frames(mission, stamp, payload_bytes - RADII_HEAD_BYTES, growth_m)
        return slow

    def _tells_all(self, payload_bytes: int) -> bool:
        return self._one_frame and payload_bytes >= _STATE_BYTES

    def _states(self, now_s: float) -> list[StateFrame]:
        return state_frames(self.tracks, self.mission, self.assignment, self.directive, self._stamp(now_s))

    def _state_and_bands(self, now_s: float) -> list[StateFrame | BandsFrame]:
        return [*self._states(now_s), *band_frames(self.mission, self._stamp(now_s))]

    def _encoded(self, frames: Sequence[Frame]) -> list[bytes]:
        datagrams = []
        for frame in frames:
            try:
                datagrams.append(self._writer.encode(frame))
            except WireError as error:
                self.unsendable.add(error)
        return datagrams

    def _assign(self, now_s: float) -> None:
        mission, picture = self.mission, self.tracks
        agents, targets = picture.active_agents, picture.open_targets
        agents_ned_m, targets_ned_m = self._positions(Kind.AGENT, agents), self._positions(Kind.TARGET, targets)
        left_m = np.array([self._specs[identity].range_m - picture.flown_m[identity] for identity in agents])
        homes_ned_m = np.array([self._specs[identity].position_ned_m for identity in agents]).reshape(-1, 2)

        kept_for = [self._specs[agent].only_target for agent in agents]
        allowed = np.array([[only in (None, target) for target in targets] for only in kept_for], dtype=bool)
        allowed = allowed.reshape(len(agents), len(targets))

        def in_range(there_m: np.ndarray | None = None) -> np.ndarray:  # (N, K) m -> (N, K) bool
            homes = homes_ned_m if mission.range_policy == "return" else None
            within: np.ndarray = allowed & within_range(
                agents_ned_m, targets_ned_m, left_m, homes, RANGE_RESERVE, there_m
            )
            return within

        places = {target: index for index, target in enumerate(targets)}
        present = np.array([places.get(self.assignment.get(agent, 0), -1) for agent in agents], dtype=int)
        share = mission.switching_share
        if mission.objective == "distance" or mission.objective == "inverse-distance":
            chosen = assign(agents_ned_m, targets_ned_m, mission.objective, in_range(), present, share or 0.0)
        else:
            chosen = assign_by_route_cost(
                RouteCosts(self._scene(agents, agents_ned_m, targets_ned_m, now_s)),
                np.array([self._specs[agent].speed_m_s for agent in agents]),
                mission.objective,
                in_range,
                present,
                SWITCHING_SHARE if share is None else share,
            )
        self.assignment = {agent: targets[index] for agent, index in zip(agents, chosen, strict=True) if index >= 0}
        covered = set(self.assignment.values())
        self.uncovered = tuple(target for target in targets if target not in covered)

    def _scene(
        self,
        agents: list[int],
        agents_ned_m: np.ndarray,  # (N, 2) m
        targets_ned_m: np.ndarray,  # (K, 2) m
        now_s: float,
    ) -> Scene:
        """Return what lies between agents and targets: the discs as the vehicles are told of them."""
        mission = self.mission
        discs = [grown(threat, self.tracks.tracks[Kind.THREAT, threat.id], now_s) for threat in mission.threats]
        floors_m = np.array([-np.inf if threat.floor_m is None else threat.floor_m for threat in mission.threats])
        ceilings_m = np.array([np.inf if threat.ceiling_m is None else threat.ceiling_m for threat in mission.threats])
        levels_m = np.array([mission.origin.alt_m + agent_height_m(mission, agent) for agent in agents])[:, np.newaxis]
        return Scene(
            agents_ned_m=agents_ned_m,
            headings_rad=np.array([_heading_rad(self.tracks.tracks[Kind.AGENT, agent]) for agent in agents]),
            turn_radii_m=np.array([_turn_radius_m(self._specs[agent]) for agent in agents]),
            targets_ned_m=targets_ned_m,
            centres_ned_m=np.array([(disc.north_m, disc.east_m) for disc in discs]).reshape(-1, 2),
            radii_m=np.array([disc.detection_radius_m for disc in discs]),
            in_the_way=(floors_m <= levels_m) & (levels_m <= ceilings_m),
        )

    def _positions(self, kind: Kind, ids: list[int]) -> np.ndarray:  # (len(ids), 2) m
        return np.array([self.tracks.tracks[kind, identity].position_ned_m for identity in ids]).reshape(-1, 2)

    def _stamp(self, now_s: float) -> Stamp:
        return Stamp(self._epoch_s, max(0, round((now_s - self._epoch_s) * 1000.0)), self._sequence)


def _heading_rad(track: Track) -> float:
    """Return where an agent flies, nan if it hardly does or nobody has seen it move yet."""
    speed_m_s = math.hypot(track.velocity_north_m_s, track.velocity_east_m_s)
    return math.atan2(track.velocity_east_m_s, track.velocity_north_m_s) if speed_m_s >= MOVING_M_S else math.nan


def _turn_radius_m(agent: AgentSpec) -> float:
    return agent.speed_m_s / turn_rate_rad_s(agent.speed_m_s, agent.n_max)


def _silent_after_s(mission: Mission, sensed: bool) -> float | None:
    """Return after how long without a word an agent counts as lost (docs/method.md section 1, point 7)."""
    if mission.case == "I":
        return mission.lost_after_s if sensed else None
    return mission.report_period_s + mission.lost_after_s if mission.report_period_s > 0.0 else None


def _after(due_s: float, period_s: float, now_s: float) -> float:
    """Return the next due time after now, on the same grid."""
    while due_s <= now_s + _DUE_TOLERANCE_S:
        due_s += period_s
    return due_s
