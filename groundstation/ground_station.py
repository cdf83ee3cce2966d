"""The ground station without sockets: detections, reports and time in, broadcast frames out.

Without a radio that limits the broadcast, `tick` returns the frames that are due: state and motion frames alternate,
each kind once per broadcast period, half a period apart. With one, groundstation/schedule.py asks for the frames that
it has room for.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

from companion.errors import InputError
from companion.mission.model import Mission
from companion.protocol.codec import (
    BandsFrame,
    Directive,
    FleetFrame,
    Frame,
    FrameWriter,
    Kind,
    MissionFrame,
    MotionFrame,
    RadiiFrame,
    Stamp,
    StateFrame,
    WireError,
)
from companion.protocol.dialect import oneway
from companion.protocol.fleet_codec import FLEET_HEAD_BYTES, MISSION_HEAD_BYTES, RADII_HEAD_BYTES
from companion.protocol.frame import ED25519_BYTES
from groundstation.acceptance import event_of
from groundstation.agents import DeadReckoner, VehicleModel, restamped
from groundstation.broadcast import (
    MOST_FRAMES,
    Broadcast,
    Unsendable,
    band_frames,
    fits_one_frame,
    fleet_frames,
    grown,
    mission_frame,
    motion_frames,
    radii_frames,
    state_frames,
    surrogate_digest,
    untold_growth_m,
)
from groundstation.clock import next_epoch_s
from groundstation.events import Command, Event, Who
from groundstation.inputs import Inputs
from groundstation.notices import Facts
from groundstation.operations import Operations, Orders, applied
from groundstation.origins import Observation
from groundstation.places import Places
from groundstation.plausibility import SENSOR_ERROR_M
from groundstation.revision import first_revision, next_revision
from groundstation.sightings import places_in
from groundstation.target_assignment import TargetAssignment, assign_targets
from groundstation.tracks import TrackTable

_DUE_TOLERANCE_S = 1e-6
MAX_EPOCH_S = 4.0e6
"""Length of an epoch, 46 days, after which a new one begins: the time in it is sent as 32 bits of milliseconds."""

KEEP_S = 30.0
"""Longest time after a restart for which agents keep their targets until all were seen or heard: before that nobody
knows where they are. Chosen: the `lost_after_s` of a mission that gives none."""
RADII_HOLD_S = 120.0
"""Time for which the radii in a carousel must hold, until they have been sent again."""

PartT = TypeVar("PartT", StateFrame, MotionFrame, BandsFrame, FleetFrame, RadiiFrame)
_STATE_BYTES, _MOTION_BYTES, _BANDS_BYTES = (
    message.unpacker.size - ED25519_BYTES
    for message in (
        oneway.MAVLink_oneway_state_message,
        oneway.MAVLink_oneway_motion_message,
        oneway.MAVLink_oneway_bands_message,
    )
)
"""Lengths of the payloads without the Ed25519 signature, which always follows the whole content."""


def check_runnable(mission: Mission, source: str) -> None:
    """Raise InputError if the ground station cannot run the mission; `source` names the file."""
    wind_m_s = mission.wind.speed_m_s + mission.wind.gust_m_s
    slowest_m_s = min(agent.speed_m_s for agent in mission.agents)
    if wind_m_s >= slowest_m_s:
        raise InputError(
            f"{source}: wind: speed_m_s and gust_m_s together {wind_m_s:g} m/s; allowed: less than the slowest agent's "
            f"speed_m_s {slowest_m_s:g} m/s, which could not hold a course"
        )


class Resumed(NamedTuple):
    """What a run takes over from the last one, so that its broadcast is accepted and no threat is told too small."""

    epoch_s: int | None = None
    """Unix time at which the epoch of the broadcast begins, such as one after the last run's; None: the whole second of
    the start."""
    began_s: float | None = None
    """Time at which the threats were at the mission's positions, if that was before the start."""
    revision: int = 1
    """Number of the revision with which the run begins."""
    operations: Operations | None = None
    """What the events of the runs before have made of the mission; None: this is the first."""
    places: Places | None = None
    """Where everything was when the run before ended; None: where the mission, and commands, have it."""


_NOTHING_RESUMED = Resumed()


@dataclass
class _DueTimes:
    """Next due times of the periodic tasks, Unix seconds."""

    assignment_s: float
    state_s: float
    motion_s: float


class _Epoch:
    """The epoch of the broadcast, and the sequence number of its last state broadcast.

    The epoch and stamps are by the computer's clock, `ahead_s` ahead of the times that are given (clock.py).
    """

    def __init__(self, began_s: int) -> None:
        self.began_s = began_s
        self.is_ending = False
        """Whether the broadcast that is begun next is the last, and says so."""
        self._sequence = 0
        self._ahead_s = 0.0

    def follow(self, now_s: float, ahead_s: float) -> None:
        """Begin a new epoch if this one is longer than MAX_EPOCH_S, or the computer's clock has stepped."""
        wall_s = now_s + ahead_s
        if ahead_s != self._ahead_s:
            self.began_s, self._sequence, self._ahead_s = next_epoch_s(self.began_s, wall_s), 0, ahead_s
        elif wall_s - self.began_s > MAX_EPOCH_S:
            self.began_s, self._sequence = int(wall_s), 0

    def begin_state(self) -> None:
        """Begin a broadcast of the state: later stamps have its sequence number."""
        self._sequence += 1

    def stamp(self, now_s: float) -> Stamp:
        """Return the stamp of a frame that is made at `now_s`."""
        return Stamp(self.began_s, max(0, round((now_s + self._ahead_s - self.began_s) * 1000.0)), self._sequence)


class GroundStation:
    """Runs one resolved mission from `start_s`; times are Unix seconds given by the caller."""

    def __init__(
        self,
        mission: Mission,
        start_s: float,
        sensed: bool = True,
        model: VehicleModel | None = None,
        resumed: Resumed = _NOTHING_RESUMED,
        sensor_error_m: float = SENSOR_ERROR_M,
    ) -> None:
        """Begin a run, and with it an epoch; while that is ahead of the clock, frames are stamped with its beginning.

        Without a sensor (`sensed` false) nothing is detected. In Case II the vehicles are dead-reckoned by `model`, by
        default `VehicleModel()`. A detection is at most `sensor_error_m` off.

        Raises:
            InputError: the ground station cannot run the mission.

        """
        check_runnable(mission, mission.name)
        self._listed = frozenset(key for key, _ in places_in(mission))
        """What the mission's file has."""
        self.operations = resumed.operations or Operations.begun(mission)
        """What commands and events have made of the mission."""
        mission = self.operations.mission
        self.reckoner = DeadReckoner(mission, start_s, model or VehicleModel()) if mission.case == "II" else None
        """Dead reckoning of the agents that nobody sees; None in Case I, where what is not seen flies straight on."""
        silent_after_s = _silent_after_s(mission, sensed)
        self.tracks = TrackTable(mission, start_s, silent_after_s, resumed.began_s, sensor_error_m)
        self.unsendable = Unsendable()
        """Frames that `tick` could not send."""
        self.inputs = Inputs(self.tracks.refusals)
        self._writer = FrameWriter()
        self._epoch = _Epoch(int(start_s) if resumed.epoch_s is None else resumed.epoch_s)
        self._due = _DueTimes(start_s, start_s, start_s + mission.broadcast_period_s / 2.0)
        if resumed.operations is not None:
            self._resume(resumed.operations, resumed.places, start_s)
        self._keep_until_s = start_s + KEEP_S if self.operations.assignment else -math.inf
        self._assigned = TargetAssignment(self.operations.assignment)
        self._assign(start_s)
        try:
            self._revision = first_revision(mission, self.tracks, resumed.revision, self._grown_radii_m(start_s))
            for frame in self._state_and_bands(start_s):
                self._writer.encode(frame)
        except WireError as error:
            raise InputError(f"{mission.name}: cannot be broadcast: {error}") from error

    @property
    def mission(self) -> Mission:
        """The mission with what was added, changed and retired."""
        return self.operations.mission

    @property
    def directive(self) -> Directive:
        """What all vehicles are told."""
        return self.operations.orders.told

    @property
    def orders(self) -> tuple[Directive, Mapping[int, Directive]]:
        """What all vehicles are told, and what single ones are, by id."""
        return self.operations.orders.told, self.operations.orders.own

    @property
    def is_outdated(self) -> bool:
        """Whether threats were added, retired or changed since the last broadcast of the state was begun."""
        return self.mission.threats != self._revision.mission.threats

    @property
    def epoch_s(self) -> int:
        """Unix time at which the epoch of the broadcast began."""
        return self._epoch.began_s

    @property
    def revision(self) -> int:
        """Number of the revision of the picture that is broadcast."""
        return self._revision.number

    @property
    def assignment(self) -> Mapping[int, int]:
        """Id of the assigned target by agent id."""
        return self._assigned.targets

    @property
    def sent(self) -> Mapping[int, int]:
        """Id of the target by agent id, of the agents that are to fly there: none while all are told to return."""
        return {} if self.directive is Directive.RETURN else self.assignment

    @property
    def uncovered(self) -> tuple[int, ...]:
        """Ids of the targets that no agent is to fly to, because none is left, none can arrive or all are recalled."""
        return tuple(self.tracks.open_targets) if self.directive is Directive.RETURN else self._assigned.uncovered

    def command(self, command: Command, who: Who, now_s: float) -> Event:
        """Do what a command asks and return the event that it makes.

        Raises:
            InputError: the command cannot be accepted.

        """
        event = event_of(self.operations, command, who, now_s + self.tracks.clock_ahead_s)
        self.adopt(event, now_s)
        return event

    def adopt(self, event: Event, now_s: float) -> None:
        """Take in an event: what it changes is told from the next broadcast of the state on."""
        before, self.operations = self.operations, applied(self.operations, event)
        orders = self.operations.orders
        if self.mission is not before.mission:
            ahead_s = self.tracks.clock_ahead_s
            placed_s = {key: at_s - ahead_s for key, at_s in self.operations.placed_s.items()}
            anew = {key for key, at_s in self.operations.placed_s.items() if before.placed_s.get(key) != at_s}
            self.tracks.follow(self.mission, placed_s, anew, now_s)
            back = self.operations.reached.by.keys() - before.reached.by.keys()
            self.tracks.progress = self.tracks.progress.with_reached(
                {one: self.operations.reached.by[one] for one in back}
            )
        self.tracks.progress = replace(self.tracks.progress, out=orders.away)
        was = before.orders
        is_other = (orders.pins, orders.away, _is_frozen(orders)) != (was.pins, was.away, _is_frozen(was))
        if is_other or self.mission.targets is not before.mission.targets:
            # An order is a reason for other targets.
            self._keep_until_s = -math.inf
            self._assign(now_s)
        elif self.mission is not before.mission:
            self._due.assignment_s = min(self._due.assignment_s, now_s)

    def _resume(self, operations: Operations, places: Places | None, now_s: float) -> None:
        """Go on where the run before ended."""
        self.tracks.resume(operations, places, now_s)
        if self.reckoner is None or places is None:
            return
        for agent in self.mission.agents:
            track = places.tracks.get((Kind.AGENT, agent.id))
            if track is not None:
                fix = self.tracks.fix_of(agent.id)
                self.reckoner.resume(agent.id, fix, places.known_at_s[agent.id])

    def _keeps_targets(self, now_s: float) -> bool:
        """Return whether nobody is to get another target: as ordered, and after a restart until all were seen."""
        if _is_frozen(self.operations.orders):
            return True
        if now_s >= self._keep_until_s:
            return False
        began_s = self._keep_until_s - KEEP_S
        return any(self.tracks.heard_at_s.get(agent, math.inf) <= began_s for agent in self.assignment)

    def facts(self) -> Facts:
        """Return what is known now; what of it events have not told yet is news (notices.py)."""
        progress = self.tracks.progress
        return Facts(progress.been_at, progress.lost, self.assignment, self.revision, self.tracks.origins.unknown)

    def _assign(self, now_s: float) -> None:
        """Solve the assignment anew, or take out of it only what is not there any more."""
        if not self._keeps_targets(now_s):
            pins = self.operations.orders.pins
            self._assigned = assign_targets(self.mission, self.tracks, self.assignment, now_s, pins)
        else:
            agents, targets = self.tracks.active_agents, self.tracks.open_targets
            kept = {one: there for one, there in self.assignment.items() if one in agents and there in targets}
            self._assigned = TargetAssignment(kept, tuple(one for one in targets if one not in kept.values()))
        again = self.tracks.progress.arrived.intersection(self.assignment)
        if again:
            self.tracks.progress = self.tracks.progress.sent_on(again)

    def sense(self, datagram: bytes, now_s: float) -> None:
        """Take in bytes from the sensor's channel; never raises, whatever the bytes."""
        frames = self.inputs.detections(datagram, now_s + self.tracks.clock_ahead_s)
        # The ids of what live sources have added were given here: a sensor's own count of things means none of them.
        added = {key for key in self.operations.tracks.values() if key not in self._listed} if frames else ()
        for frame in frames:
            self.tracks.take(frame, now_s, added)

    def hear_report(self, datagram: bytes, now_s: float) -> None:
        """Take in bytes from the uplink; never raises, whatever the bytes."""
        for frame in self.inputs.reports(datagram, now_s + self.tracks.clock_ahead_s):
            fix = self.tracks.take_report(frame, now_s)
            if fix is not None and self.reckoner is not None:
                self.reckoner.fix(frame.agent_id, fix)
            elif fix is not None:
                self.tracks.move_to(frame.agent_id, fix)

    def observe(self, seen: Observation) -> bool:
        """Take in where a live source has a thing; return whether that is news of a thing that is there."""
        return self.tracks.observe(seen)

    def follow_clock(self, ahead_s: float, slept_s: float, now_s: float) -> None:
        """Stamp by a computer's clock that is `ahead_s` ahead from now on, after it slept for `slept_s`.

        Nobody counts as lost for having been silent while the computer slept.
        """
        self.tracks.clock_ahead_s = ahead_s
        self.tracks.excuse(slept_s)
        self._epoch.follow(now_s, ahead_s)

    def advance(self, now_s: float) -> None:
        """Update dead reckoning, tracks and assignment to `now_s`; `tick` calls this itself."""
        self._epoch.follow(now_s, self.tracks.clock_ahead_s)
        if self.reckoner is not None:
            self.reckoner.advance(now_s, self.tracks.present_agents)
            for identity in self.tracks.present_agents:
                if self.tracks.origins.is_seen(identity, now_s):
                    self.reckoner.follow(identity, self.tracks.fix_of(identity))
                else:
                    self.tracks.place(identity, self.reckoner.estimate(identity, now_s), now_s)
        changed = self.tracks.update(now_s, self.assignment)
        if changed or now_s >= self._due.assignment_s - _DUE_TOLERANCE_S:
            self._assign(now_s)
            self._due.assignment_s = _after(self._due.assignment_s, self.mission.assignment_period_s, now_s)

    def tick(self, now_s: float) -> list[bytes]:
        """Update everything to `now_s`, and return the frames to broadcast now; none if nothing is due."""
        self.advance(now_s)
        return self.due(now_s)

    def due(self, now_s: float) -> list[bytes]:
        """Return the frames to broadcast now, by what `advance` has found; none if nothing is due.

        A frame that cannot be encoded is counted in `unsendable` and left out.
        """
        datagrams: list[bytes] = []
        if now_s >= self._due.state_s - _DUE_TOLERANCE_S:
            self._begin_state(now_s)
            datagrams += self._encoded(self._sendable(self._states(now_s)))
            datagrams += self._encoded(self._sendable(band_frames(self.mission, self._epoch.stamp(now_s))))
            self._due.state_s = _after(self._due.state_s, self.mission.broadcast_period_s, now_s)
        if now_s >= self._due.motion_s - _DUE_TOLERANCE_S:
            motion = motion_frames(self.tracks, self.mission, self._epoch.stamp(now_s))
            datagrams += self._encoded(self._sendable(motion))
            self._due.motion_s = _after(self._due.motion_s, self.mission.broadcast_period_s, now_s)
        for datagram in datagrams:
            self.overhear(datagram, now_s)
        return datagrams

    def last(self, now_s: float) -> list[bytes]:
        """Return the frames of a last broadcast of the state; from now on every broadcast says that it is the last."""
        self._epoch.is_ending = True
        self._begin_state(now_s)
        return self._encoded(self._states(now_s))

    def overhear(self, datagram: bytes, now_s: float) -> None:
        """Let the dead-reckoned agents (Case II) hear an unsigned frame that is broadcast now."""
        if self.reckoner is not None:
            self.reckoner.hear(restamped(datagram, self.tracks.clock_ahead_s), now_s)

    def refresh(self, now_s: float, payload_bytes: int) -> list[StateFrame] | list[FleetFrame]:
        """Begin a broadcast of the state and return its frames, whose payloads hold at most `payload_bytes`.

        It is one state frame if that holds everything, else fleet frames, which receivers can only read with the frames
        of the carousel.

        Raises:
            WireError: a payload of `payload_bytes` cannot hold one entry.

        """
        if self._tells_all(payload_bytes):
            self._begin_state(now_s)
            return self._states(now_s)
        self._epoch.begin_state()
        growth_m = untold_growth_m(self.tracks, self.mission.threats, now_s + RADII_HOLD_S)
        self._revise(threat.detection_radius_m + growth_m.get(threat.id, 0.0) for threat in self.mission.threats)
        data_bytes = payload_bytes - FLEET_HEAD_BYTES
        frames = fleet_frames(self.tracks, self.mission, self.assignment, self._broadcast(now_s), data_bytes)
        return self._sendable(frames)

    def carousel(
        self, now_s: float, payload_bytes: int
    ) -> list[MissionFrame | RadiiFrame] | list[MotionFrame | BandsFrame]:
        """Return the frames, stamped now, that go with the state but are sent less often.

        With state frames these are motion and bands frames, each kind if it fits `payload_bytes`; with fleet frames
        they are the mission frame and the radii frames, which have the altitude limits too.
        """
        stamp = self._epoch.stamp(now_s)
        if self._tells_all(payload_bytes):
            frames: list[MotionFrame | BandsFrame] = []
            if payload_bytes >= _MOTION_BYTES:
                frames += motion_frames(self.tracks, self.mission, stamp)
            if payload_bytes >= _BANDS_BYTES:
                frames += band_frames(self.mission, stamp)
            return frames
        # Until the next broadcast of the state begins another revision, these belong to what this one has.
        mission = self._revision.mission
        slow: list[MissionFrame | RadiiFrame] = []
        name_bytes = payload_bytes - MISSION_HEAD_BYTES
        slow.append(mission_frame(mission, self._revision, surrogate_digest(mission), stamp, name_bytes))
        told = [threat for threat in mission.threats if (Kind.THREAT, threat.id) in self.tracks.tracks]
        growth_m = untold_growth_m(self.tracks, told, now_s + RADII_HOLD_S)
        data_bytes = payload_bytes - RADII_HEAD_BYTES
        slow += self._sendable(radii_frames(mission, self._revision, stamp, data_bytes, growth_m))
        return slow

    def _tells_all(self, payload_bytes: int) -> bool:
        return payload_bytes >= _STATE_BYTES and fits_one_frame(self.mission)

    def _begin_state(self, now_s: float) -> None:
        """Begin a broadcast of state frames, whose radii are grown by the ages of the threats' positions."""
        self._epoch.begin_state()
        self._revise(self._grown_radii_m(now_s))

    def _grown_radii_m(self, now_s: float) -> list[float]:
        tracks = self.tracks.tracks
        return [grown(one, tracks[Kind.THREAT, one.id], now_s).detection_radius_m for one in self.mission.threats]

    def _revise(self, radii_m: Iterable[float]) -> None:
        """Begin the next revision if the picture needs one; `radii_m` are the threats' radii as they are to be told."""
        self._revision = next_revision(self._revision, self.mission, self.tracks, radii_m)

    def _broadcast(self, now_s: float) -> Broadcast:
        stamp, own = self._epoch.stamp(now_s), self.operations.orders.own
        return Broadcast(stamp, self.directive, self._revision, own, self._epoch.is_ending)

    def _states(self, now_s: float) -> list[StateFrame]:
        return state_frames(self.tracks, self.mission, self.assignment, self._broadcast(now_s))

    def _state_and_bands(self, now_s: float) -> list[StateFrame | BandsFrame]:
        return [*self._states(now_s), *band_frames(self.mission, self._epoch.stamp(now_s))]

    def _sendable(self, frames: list[PartT]) -> list[PartT]:
        """Return the frames of one broadcast, as many as can be numbered.

        What is left out is counted. Whoever hears the others knows that the picture is not whole, and what all are told
        to do.
        """
        if len(frames) <= MOST_FRAMES:
            return frames
        self.unsendable.add(WireError(f"{len(frames)} frames in a broadcast; allowed: at most {MOST_FRAMES}"))
        first = frames[:MOST_FRAMES]
        return [replace(frame, stamp=replace(frame.stamp, frame_count=MOST_FRAMES)) for frame in first]

    def _encoded(self, frames: Sequence[Frame]) -> list[bytes]:
        datagrams = []
        for frame in frames:
            try:
                datagrams.append(self._writer.encode(frame))
            except WireError as error:
                self.unsendable.add(error)
        return datagrams


def _silent_after_s(mission: Mission, sensed: bool) -> float | None:
    """Return the time without detection or report after which an agent is lost (docs/method.md section 1, point 7).

    None: no agent is ever detected or reports, so that none counts as lost.
    """
    if mission.case == "I":
        return mission.lost_after_s if sensed else None
    return mission.report_period_s + mission.lost_after_s if mission.report_period_s > 0.0 else None


def _is_frozen(orders: Orders) -> bool:
    """Return whether everybody keeps the target for later: in a pause, and while all are told to return."""
    return orders.paused or orders.told is Directive.RETURN


def _after(due_s: float, period_s: float, now_s: float) -> float:
    """Return the next due time after `now_s` on the grid of a period."""
    while due_s <= now_s + _DUE_TOLERANCE_S:
        due_s += period_s
    return due_s
