"""The ground station without sockets: detections and time in, broadcast frames out.

State and motion frames alternate: each kind goes out once per broadcast period, half a period apart.
"""

from __future__ import annotations

import numpy as np

from companion.errors import InputError
from companion.mission import Mission
from companion.wire import DetectionsFrame, Directive, FrameReader, FrameWriter, Kind, Stamp, WireError
from groundstation.assignment import OBJECTIVES, assign
from groundstation.broadcast import motion_frames, state_frames
from groundstation.picture import GroundPicture

_DUE_TOLERANCE_S = 1e-6
MAX_EPOCH_S = 4.0e6
"""After so long (46 days) a new epoch begins: the time within one travels as 32 bits of milliseconds."""


def check_runnable(mission: Mission, source: str) -> None:
    """Raise InputError if the mission asks for what the ground station cannot do; `source` names the file."""
    if mission.objective not in OBJECTIVES:
        raise InputError(
            f"{source}: objective: '{mission.objective}' cannot be assigned; allowed: {', '.join(OBJECTIVES)}"
        )
    if mission.case != "I":
        raise InputError(f"{source}: case: '{mission.case}' cannot be run; allowed: I")


class GroundStation:
    """Runs one resolved mission from `start_s`; times are Unix seconds given by the caller."""

    def __init__(self, mission: Mission, start_s: float, sensed: bool = True) -> None:
        """Begin a run, and with it an epoch.

        Raises:
            InputError: the mission asks for something the ground station cannot do.

        """
        check_runnable(mission, mission.name)
        self.mission = mission
        self.directive = Directive.NORMAL
        self.picture = GroundPicture(mission, start_s, sensed)
        self.assignment: dict[int, int] = {}
        self.uncovered: tuple[int, ...] = ()
        """Targets no agent is left for."""
        self.reader = FrameReader()
        self._writer = FrameWriter()
        self._epoch_s = int(start_s)
        self._sequence = 0
        self._next_assignment_s = start_s
        self._next_state_s = start_s
        self._next_motion_s = start_s + mission.broadcast_period_s / 2.0
        self._assign()
        try:
            self._state_datagrams(start_s)
        except WireError as error:
            raise InputError(f"{mission.name}: cannot be broadcast: {error}") from error

    def sense(self, datagram: bytes, now_s: float) -> None:
        """Take in bytes from the sensor's channel; never raises, whatever the bytes."""
        for frame in self.reader.read(datagram):
            if isinstance(frame, DetectionsFrame):
                self.picture.take(frame, now_s)

    def tick(self, now_s: float) -> list[bytes]:
        """Return the frames to broadcast now: none unless something is due."""
        if now_s - self._epoch_s > MAX_EPOCH_S:
            self._epoch_s, self._sequence = int(now_s), 0
        changed = self.picture.update(now_s)
        if changed or now_s >= self._next_assignment_s - _DUE_TOLERANCE_S:
            self._assign()
            self._next_assignment_s = _after(self._next_assignment_s, self.mission.assignment_period_s, now_s)
        datagrams: list[bytes] = []
        if now_s >= self._next_state_s - _DUE_TOLERANCE_S:
            self._sequence += 1
            datagrams += self._state_datagrams(now_s)
            self._next_state_s = _after(self._next_state_s, self.mission.broadcast_period_s, now_s)
        if now_s >= self._next_motion_s - _DUE_TOLERANCE_S:
            for motion in motion_frames(self.picture, self.mission, self._stamp(now_s)):
                datagrams.append(self._writer.encode(motion))
            self._next_motion_s = _after(self._next_motion_s, self.mission.broadcast_period_s, now_s)
        return datagrams

    def _state_datagrams(self, now_s: float) -> list[bytes]:
        frames = state_frames(self.picture, self.mission, self.assignment, self.directive, self._stamp(now_s))
        return [self._writer.encode(frame) for frame in frames]

    def _assign(self) -> None:
        agents, targets = self.picture.active_agents, self.picture.open_targets
        chosen = assign(
            self._positions(Kind.AGENT, agents),
            self._positions(Kind.TARGET, targets),
            "inverse-distance" if self.mission.objective == "inverse-distance" else "distance",
        )
        self.assignment = {agent: targets[index] for agent, index in zip(agents, chosen, strict=True) if index >= 0}
        covered = set(self.assignment.values())
        self.uncovered = tuple(target for target in targets if target not in covered)

    def _positions(self, kind: Kind, ids: list[int]) -> np.ndarray:  # (len(ids), 2) m
        return np.array([self.picture.tracks[kind, identity].position_ned_m for identity in ids]).reshape(-1, 2)

    def _stamp(self, now_s: float) -> Stamp:
        return Stamp(self._epoch_s, round((now_s - self._epoch_s) * 1000.0), self._sequence)


def _after(due_s: float, period_s: float, now_s: float) -> float:
    """Return the next due time after now, on the same grid."""
    while due_s <= now_s + _DUE_TOLERANCE_S:
        due_s += period_s
    return due_s
