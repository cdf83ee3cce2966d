"""Who may steer: when the companion may begin, when it must let go, and when the safety pilot alone decides.

ArduPilot obeys setpoints in its guided mode and in no other, so the mode alone decides. PX4 wants a stream of setpoints
before the safety pilot can choose OFFBOARD, and goes back to OFFBOARD by itself when a stream that ended begins again,
even out of a failsafe (docs/autopilots.md): so after whatever ended an engagement nothing is sent until the safety
pilot has cleared it.
"""

from __future__ import annotations

from enum import Enum

from pymavlink.dialects.v20 import common

from companion.autopilot.telemetry import Telemetry

FAILSAFE_STATES = frozenset({common.MAV_STATE_CRITICAL, common.MAV_STATE_EMERGENCY})

MODE_LEFT = "taken over: the mode was changed"
FAILSAFE = "autopilot's failsafe"
RESTARTED = "autopilot restarted in flight"
NOT_OURS = "OFFBOARD was on before this companion began"
DIED_BEFORE = "OFFBOARD ended while no companion ran"
LOCKED_BEFORE = "locked before the restart"


class State(Enum):
    """Who has the vehicle."""

    WAITING = "waiting"
    """The safety pilot, who may hand it over."""
    ENGAGED = "engaged"
    """The companion."""
    LOCKED = "locked"
    """The safety pilot, and nothing is sent until the vehicle is disarmed or the take-over cleared."""


class Authority:
    """Follows the autopilot's telemetry. Times are given by the caller."""

    def __init__(self, resumes_on_stream: bool, was: State = State.WAITING) -> None:
        """Begin anew, or after a companion that left the vehicle as it `was` (`kept`).

        `resumes_on_stream`: the autopilot obeys again by itself when a stream comes back.
        """
        self.state = State.WAITING
        self.reason = ""
        """Why it is locked."""
        self._resumes_on_stream = resumes_on_stream
        self._was = was
        self._heard = False
        self._restarts = 0
        if resumes_on_stream and was is State.LOCKED:
            self._lock(LOCKED_BEFORE)

    @property
    def kept(self) -> State:
        """What a restart must know: until an autopilot is heard, that is still how it was before this one began."""
        return self.state if self._heard else self._was

    @property
    def locked(self) -> bool:
        """Whether nothing may be sent."""
        return self.state is State.LOCKED

    def note(self, telemetry: Telemetry, steerable: bool) -> None:
        """Take in what the autopilot says of itself now."""
        if telemetry.heartbeat_at_s is None:
            return
        restarted = self._heard and telemetry.restarts != self._restarts
        self._restarts = telemetry.restarts
        if not self._resumes_on_stream:
            self._set(State.ENGAGED if steerable else State.WAITING)
        elif not telemetry.armed:
            self._set(State.WAITING)
        elif self.state is State.LOCKED:
            pass  # Neither mode nor state leads out.
        elif telemetry.system_status in FAILSAFE_STATES:
            self._lock(FAILSAFE)
        elif restarted:
            self._lock(RESTARTED)
        elif not self._heard:
            self._begin(steerable)
        elif self.state is State.ENGAGED and not steerable:
            self._lock(MODE_LEFT)
        elif steerable and telemetry.in_air is not False:
            self._set(State.ENGAGED)
        self._heard = True

    def note_gap(self, why: str) -> None:
        """Take in that the stream of setpoints had a gap, and why."""
        if self._resumes_on_stream and self.state is State.ENGAGED:
            self._lock(f"setpoints stopped: {why}")

    def clear(self) -> None:
        """Let the vehicle be handed over again: the safety pilot says so."""
        if self.state is State.LOCKED:
            self._was = State.WAITING
            self._set(State.WAITING)

    def _begin(self, steerable: bool) -> None:
        """Decide on an armed vehicle that this companion finds when it starts."""
        had_it = self._was is State.ENGAGED
        if had_it and not steerable:
            self._lock(DIED_BEFORE)
        elif steerable and not had_it:
            self._lock(NOT_OURS)
        else:
            self._set(State.ENGAGED if steerable else State.WAITING)

    def _set(self, state: State) -> None:
        self.state, self.reason = state, ""

    def _lock(self, reason: str) -> None:
        self.state, self.reason = State.LOCKED, reason
