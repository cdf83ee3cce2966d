"""Who may steer: when the companion may begin, when it must let go, and when the safety pilot alone decides.

ArduPilot obeys setpoints in its guided mode and in no other, so the mode alone decides. PX4 wants a stream of setpoints
before the safety pilot can choose OFFBOARD, and goes back to OFFBOARD by itself when a stream that ended begins again,
even out of a failsafe (docs/autopilots.md). So whatever ends an engagement of a PX4 locks the companion: it sends
nothing until the vehicle is disarmed or the safety pilot clears the lock. One heartbeat is enough to let go of a
vehicle, and never enough to unlock.
"""

from __future__ import annotations

from enum import Enum

from pymavlink.dialects.v20 import common

from companion.autopilot.telemetry import Telemetry

FAILSAFE_STATES = {
    common.MAV_STATE_CRITICAL: "CRITICAL",
    common.MAV_STATE_EMERGENCY: "EMERGENCY",
    common.MAV_STATE_FLIGHT_TERMINATION: "FLIGHT_TERMINATION",
}
"""The MAV_STATEs by which an autopilot says that one of its failsafes acts, ArduPilot also that it warns, and their
words."""

UNLOCK_AFTER_S = 0.5
"""Time between two heartbeats, with none between that says otherwise, that unlock: a single one may be a stray."""
MODE_LEFT = "taken over: the mode was changed"
DISARMED = "disarmed"
FAILSAFE = "autopilot's failsafe"
RESTARTED = "autopilot restarted in flight"
NOT_OURS = "OFFBOARD was on before this companion began"
DIED_BEFORE = "OFFBOARD ended while no companion ran"
LOCKED_BEFORE = "locked before the restart"


class State(Enum):
    """Who controls the vehicle."""

    WAITING = "waiting"
    """The safety pilot controls the vehicle and may hand it over."""
    ENGAGED = "engaged"
    """The companion controls the vehicle."""
    LOCKED = "locked"
    """The safety pilot controls the vehicle; nothing is sent until it is disarmed or the take-over is cleared, or
    where the mode alone decides, until it is handed over anew."""


class Authority:
    """Decides from the autopilot's telemetry who controls the vehicle."""

    def __init__(self, resumes_on_stream: bool, was: State = State.WAITING) -> None:
        """Start in the state WAITING, or LOCKED if that is how an earlier companion left an autopilot that resumes.

        `resumes_on_stream`: the autopilot obeys again by itself when a stream of setpoints comes back.
        `was`: the state (`kept`) that the companion before this one saved.
        """
        self.state = State.WAITING
        self.reason = ""
        """Why the state is LOCKED; empty in any other state."""
        self._resumes_on_stream = resumes_on_stream
        self._was = was
        self._heard = False
        self._let_go_since_s: float | None = None
        """Time of the first of the heartbeats that say one after the other what unlocks."""
        self._restarts = 0
        if resumes_on_stream and was is State.LOCKED:
            self._lock(LOCKED_BEFORE)

    @property
    def kept(self) -> State:
        """The state to save for a restart; until an autopilot is heard that is still the one saved before the start."""
        return self.state if self._heard else self._was

    @property
    def locked(self) -> bool:
        """Whether nothing may be sent."""
        return self.state is State.LOCKED

    def note(self, telemetry: Telemetry, steerable: bool) -> None:
        """Update the state by the newest telemetry; `steerable`: the vehicle is armed and in the guided mode."""
        if telemetry.heartbeat_at_s is None:
            return
        restarted = self._heard and telemetry.restarts != self._restarts
        self._restarts = telemetry.restarts
        if self.state is State.LOCKED:
            # Neither mode nor state leads a vehicle that resumes out.
            self._note_locked(telemetry.heartbeat_at_s, telemetry.armed if self._resumes_on_stream else steerable)
        elif not self._resumes_on_stream:
            self._set(State.ENGAGED if steerable else State.WAITING)
        elif not telemetry.armed:
            if self.state is State.ENGAGED:
                self._lock(DISARMED)
                self._note_locked(telemetry.heartbeat_at_s, False)
            else:
                self._set(State.WAITING)
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
        """Lock an engaged vehicle that resumes by itself, as its stream of setpoints had a gap; `why` is the cause."""
        if self._resumes_on_stream and self.state is State.ENGAGED:
            self._lock(f"setpoints stopped: {why}")

    def leave(self, why: str) -> None:
        """Leave an engaged vehicle that does not obey to its autopilot and the safety pilot; `why`: what it did."""
        if self.state is State.ENGAGED:
            self._lock(why)

    def clear(self) -> None:
        """Unlock at the safety pilot's order: the vehicle may be handed over again."""
        if self.state is State.LOCKED:
            self._was = State.WAITING
            self._set(State.WAITING)

    def _note_locked(self, heartbeat_at_s: float, holds: bool) -> None:
        """Unlock once heartbeats have said for a time what unlocks; `holds`: the newest one does not say it."""
        if holds:
            self._let_go_since_s = None
        elif self._let_go_since_s is None:
            self._let_go_since_s = heartbeat_at_s
        elif heartbeat_at_s - self._let_go_since_s >= UNLOCK_AFTER_S:
            self._set(State.WAITING)

    def _begin(self, steerable: bool) -> None:
        """Set the state for an armed vehicle that this companion finds when it starts."""
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
        self.state, self.reason, self._let_go_since_s = State.LOCKED, reason, None
