"""The companion that flies the pattern: all of `companion run` up to who may steer, then the pattern and the guard."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from companion.guard.fence import Fence
from companion.guard.guard import Guard
from companion.guard.types import TURN, Discs, Hints, Limits, Setpoint, Verdict
from companion.onboard.authority import MODE_LEFT, State
from companion.onboard.companion import REFUSALS, Companion, band_m
from companion.onboard.config import Config, LimitsSection
from companion.onboard.decision import Decision, Purpose
from companion.onboard.engagement import Engagement, GridSetpoint
from companion.onboard.failsafe import SEVERITY, Stage
from companion.onboard.identification.pattern import (
    SLOW_AIRSPEED_SHARE,
    SLOW_SHARE,
    STANDING_M_S,
    Pattern,
    Progress,
    advanced,
    begun,
    pattern_of,
    wanted,
)
from companion.onboard.identification.room import COURSES, clearance_m, room_of, stopping_m
from companion.onboard.navigation import Located, navigate, outside_fence, plane_of
from companion.onboard.readiness import PICTURE_CAUSES
from companion.onboard.readiness import unheard as not_heard
from companion.onboard.steering import discs_of, guard_limits
from companion.protocol.authenticator import Authenticator

LONGEST_STOP_S = 8.0
"""Time for which a vehicle that can stop is told to stand, before the setpoints end, if it does not stand sooner."""
STRAY = 1.5
"""How many times as far as its pattern leads a vehicle may get before it counts as one that does not obey. PX4's
quadrotor with its own drag, which turned at a third of what it was asked, got 1.1 times as far."""
FLOWN = "the pattern is flown"
NO_ORIGIN = "fence and exclusions are about the broadcast's origin, and no broadcast is heard"


class End(NamedTuple):
    """Why the pattern ended, and whether it was flown to its end."""

    words: str
    complete: bool


class _Flight(NamedTuple):
    """The pattern in flight, the guard that its setpoints pass, the fence, and the height that is kept."""

    pattern: Pattern
    progress: Progress
    guard: Guard
    fence: Fence | None
    height_m: float
    start_ned_m: tuple[float, float]
    reach_m: float
    """Distance from the start that the vehicle must not exceed: it then does not fly what it is asked to."""
    stops_until_s: float | None = None
    """While it is told to stand before the setpoints end: until when; None while it flies the pattern."""


class Identifier(Companion):
    """Flies the pattern once, from the moment that the vehicle is handed over, and then sends no setpoint any more."""

    def __init__(self, config: Config, authenticator: Authenticator, was: State, over: Callable[[], None]) -> None:
        """Prepare to fly the pattern; `over` is called once when no setpoint will follow."""
        super().__init__(config, authenticator=authenticator, was=was)
        self.end: End | None = None
        """Why the pattern ended; None until it has."""
        self._flight: _Flight | None = None
        self._over = over

    def repeat(self, now_s: float) -> list[bytes]:
        """Return the frames that repeat the last setpoint; what ends the pattern ends it here, too."""
        requests = self.adapter.requests(now_s)
        if self._flight is not None and self.steers:
            reason = (
                "setpoints stopped: this companion was held up" if self._stream.ended(now_s) else self._why_not(now_s)
            )
            if reason is not None and (self._theirs or self._flight.stops_until_s is None):
                self._ended(reason, self._located(self.engagement or Engagement(), now_s), self._discs(now_s), now_s)
        return self._frames(requests, now_s)

    def _decide(self, now_s: float) -> Decision:
        age_s = self.world_model.age_s(now_s)
        status = self._assess(age_s, now_s)
        if self._flight is None:
            idle = self._waits_for(now_s)
            if idle is not None:
                return Decision(now_s, Purpose.IDLE, idle, status.stage, age_s, triggers=status.all_words)
        decision = self._pattern_step(now_s)
        return replace(decision, stage=status.stage, picture_age_s=age_s, triggers=status.all_words)

    def _frames(self, requests: list[bytes], now_s: float) -> list[bytes]:
        # A PX4 that had the pattern must not get setpoints to hold either: they would keep it in OFFBOARD.
        return super()._frames(requests, now_s) if self.end is None or self.steers else requests

    @property
    def _theirs(self) -> bool:
        """Whether a person, or the autopilot's failsafe, has the vehicle."""
        return not self.adapter.steerable or self.authority.locked

    def _why_not(self, now_s: float) -> str | None:
        """Return why the vehicle must not be steered; a mode that was changed is told as what it is."""
        reason = self._not_steerable(now_s)
        changed = reason is not None and not_heard(self.adapter, now_s) is None and not self.adapter.steerable
        return MODE_LEFT if changed else reason

    def _waits_for(self, now_s: float) -> str | None:
        """Return why the pattern does not begin; None if it does."""
        if self.end is not None:
            return self.end.words
        reason = self._not_steerable(now_s)
        if reason is not None:
            return reason
        self._begin_hand_over()
        if not self.adapter.parameters_known:
            return "reading the autopilot's parameters"
        if self.steering.unable is not None:
            return self.steering.unable
        limits = self.config.limits
        if (limits.fence is not None or limits.exclusions) and self.world_model.origin_deg is None:
            return NO_ORIGIN
        if self.world_model.age_s(now_s) is not None and self.world_model.missing is not None:
            return self.world_model.missing
        if outside_fence(self.adapter.telemetry, self.world_model.origin_deg, self.config):
            return "outside the fence"
        height_m = self.adapter.telemetry.height_m
        if not limits.height_min_m <= height_m <= limits.height_max_m:
            return f"at a height of {height_m:.0f} m; allowed: {limits.height_min_m:g} to {limits.height_max_m:g} m"
        return self._unfit()

    def _unfit(self) -> str | None:
        """Return what of the vehicle's own state ends the pattern; the picture's age does not."""
        for trigger in self.failsafe.status.triggers:
            if trigger.cause not in PICTURE_CAUSES and SEVERITY[trigger.stage] >= SEVERITY[Stage.LOITERING]:
                return trigger.words
        return None

    def _located(self, before: Engagement, now_s: float) -> Located:
        telemetry = self.telemetry
        plane = plane_of(self.world_model.origin_deg, self.navigation.plane, telemetry)
        if plane is not self.navigation.plane:
            before = before._replace(last_fix=None)
        self.navigation, located = navigate(
            self.navigation, plane, before.last_fix, telemetry, self.steering.config, now_s
        )
        return located

    def _pattern_step(self, now_s: float) -> Decision:
        """Fly one step of the pattern, or of standing still before the setpoints end."""
        before = self.engagement or Engagement()
        plane = self.navigation.plane
        located = self._located(before, now_s)
        discs = self._discs(now_s)
        flight = self._flight
        if flight is None:
            self._flight = flight = self._begin(located, discs, now_s)
            if flight is None:
                assert self.end is not None
                return Decision(now_s, Purpose.IDLE, self.end.words, Stage.FRESH, None)
        elif plane is not self.navigation.plane:
            return self._ended("the broadcast's origin has changed", located, discs, now_s)
        reason = self._must_end(flight, located, discs, now_s)
        if reason is not None and flight.stops_until_s is None:
            return self._ended(reason, located, discs, now_s)
        if flight.stops_until_s is not None:
            return self._stand(flight, located, discs, now_s)
        progress = advanced(flight.pattern, flight.progress, located.motion, now_s)
        if progress is None:
            return self._ended(None, located, discs, now_s)
        self._flight = flight = flight._replace(progress=progress)
        heading_rad, speed_m_s = wanted(flight.pattern, progress, located.motion)
        leg = flight.pattern.legs[progress.leg]
        verdict = self._guarded(flight, (heading_rad, speed_m_s), located, discs, now_s)
        if verdict.setpoint is None or not REFUSALS.isdisjoint(verdict.changes):
            return self._ended(f"the guard refuses it: {', '.join(verdict.changes)}", located, discs, now_s)
        self.engagement = Engagement(
            abilities_changed=before.abilities_changed,
            last_fix=located.fix,
            setpoint=GridSetpoint(verdict.setpoint, located.convergence_rad),
        )
        words = f"identify {progress.leg + 1} of {len(flight.pattern.legs)}: {leg.words}"
        return _decision(words, heading_rad, verdict, now_s)

    def _begin(self, located: Located, discs: Discs, now_s: float) -> _Flight | None:
        """Return the pattern on the first course on which there is room; None, with the end, if there is none."""
        config, can_stop = self.steering.config, self.adapter.can_stop
        limits, motion = config.limits, located.motion
        slow_m_s = _slow_m_s(limits, can_stop, self.adapter.abilities.speed_min_m_s)
        fence = None
        if limits.fence is not None or limits.exclusions:
            fence = Fence(limits.fence, limits.exclusions)
        margin_m = stopping_m(limits, can_stop, limits.speed_m_s + limits.wind_m_s)
        best = None
        for turn in range(COURSES):
            first_rad = (motion.heading_rad + turn * math.tau / COURSES) % math.tau
            pattern = pattern_of(limits, can_stop, slow_m_s, config.guidance_step_s, first_rad)
            room = room_of(pattern, motion, limits, config.guidance_step_s, fence, discs)
            if room.clear_m >= margin_m:
                return _Flight(
                    pattern,
                    begun(pattern, motion, now_s),
                    Guard(_pattern_limits(limits, can_stop, slow_m_s)),
                    fence,
                    self.adapter.telemetry.height_m,
                    motion.position_ned_m,
                    STRAY * room.reach_m + margin_m,
                )
            best = room if best is None or room.clear_m > best.clear_m else best
        assert best is not None
        words = (
            f"not enough room: the pattern is up to {best.across_m:.0f} m across and must stay {margin_m:.0f} m from "
            f"fence and discs; from here {best.clear_m:.0f} m are left at best"
        )
        self._finish(End(words, complete=False))
        return None

    def _must_end(self, flight: _Flight, located: Located, discs: Discs, now_s: float) -> str | None:
        """Return why the pattern must end now, other than that it is flown; None if it need not."""
        reason = self._why_not(now_s) or self._unfit()
        if reason is not None:
            return reason
        limits, motion = self.steering.config.limits, located.motion
        margin_m = stopping_m(limits, self.adapter.can_stop, motion.speed_m_s)
        clear_m = clearance_m(motion.position_ned_m, flight.fence, discs)
        if clear_m < margin_m:
            return f"{clear_m:.0f} m to fence or disc, {margin_m:.0f} m needed"
        away_m = math.dist(motion.position_ned_m, flight.start_ned_m)
        if away_m > flight.reach_m:
            return f"it does not fly what it is asked to: {away_m:.0f} m away, where no turn of the pattern leads"
        return None

    def _ended(self, reason: str | None, located: Located, discs: Discs, now_s: float) -> Decision:
        """End the pattern, for a reason or as it is flown: stand still where the vehicle can, or send nothing more."""
        self.end = self.end or End(FLOWN if reason is None else reason, complete=reason is None)
        # A PX4 that is not heard may have been taken over; an ArduPilot then ignores what it is sent.
        unsure = self.adapter.resumes_on_stream and not_heard(self.adapter, now_s) is not None
        if self._flight is None or self._theirs or unsure or not self.adapter.can_stop:
            return self._silent(now_s)
        self._flight = self._flight._replace(stops_until_s=now_s + LONGEST_STOP_S)
        return self._stand(self._flight, located, discs, now_s)

    def _stand(self, flight: _Flight, located: Located, discs: Discs, now_s: float) -> Decision:
        """Tell the vehicle to stand; send nothing more once it does, somebody else has it or the time is up."""
        assert flight.stops_until_s is not None and self.end is not None
        stands = located.motion.speed_m_s < STANDING_M_S and now_s > flight.stops_until_s - LONGEST_STOP_S
        if self._theirs or stands or now_s >= flight.stops_until_s:
            return self._silent(now_s)
        heading_rad = located.motion.heading_rad
        verdict = self._guarded(flight, (heading_rad, 0.0), located, discs, now_s)
        setpoint = None if verdict.setpoint is None else GridSetpoint(verdict.setpoint, located.convergence_rad)
        self.engagement = Engagement(last_fix=located.fix, setpoint=setpoint)
        return _decision(f"identify ends: {self.end.words}", heading_rad, verdict, now_s)

    def _silent(self, now_s: float) -> Decision:
        assert self.end is not None
        self._finish(self.end)
        return Decision(now_s, Purpose.IDLE, self.end.words, Stage.FRESH, None)

    def _finish(self, end: End) -> None:
        """Send no setpoint from now on."""
        self.end = self.end or end
        self._flight = None
        self._disengage()
        self._over()

    def _discs(self, now_s: float) -> Discs:
        view = self.world_model.view(now_s, band_m(self.telemetry, self.telemetry.height_m))
        return discs_of(view, self.config.keep_out)

    def _guarded(
        self, flight: _Flight, asked: tuple[float, float], located: Located, discs: Discs, now_s: float
    ) -> Verdict:
        setpoint = Setpoint(*asked, flight.height_m)
        hints = Hints(towards_rad=setpoint.heading_rad)
        return flight.guard.check(setpoint, located.motion, discs, now_s, self.config.guidance_step_s, hints)


def _slow_m_s(limits: LimitsSection, can_stop: bool, speed_min_m_s: float) -> float | None:
    """Return the lesser speed of the pattern; None for a vehicle that has one speed only."""
    if can_stop:
        return SLOW_SHARE * limits.speed_m_s
    slow_m_s = max(SLOW_AIRSPEED_SHARE * limits.speed_m_s, speed_min_m_s, limits.wind_m_s + 1.0)
    return slow_m_s if slow_m_s <= 0.97 * limits.speed_m_s else None


def _pattern_limits(limits: LimitsSection, can_stop: bool, slow_m_s: float | None) -> Limits:
    """Return the guard's limits for the pattern: those configured, but for what the pattern is to find out.

    It may turn at the greatest rate, whatever share of it is assumed, and a plane may fly its lesser speed.
    """
    given = guard_limits(limits, can_stop)
    slowest_m_s = given.speed_min_m_s if slow_m_s is None or can_stop else slow_m_s
    return replace(given, rate_share=1.0, speed_min_m_s=slowest_m_s)


def _decision(words: str, wanted_rad: float, verdict: Verdict, now_s: float) -> Decision:
    """Return a step of the pattern as a decision, without the guard's broken assumptions: they are what is measured."""
    return Decision(
        t_s=now_s,
        purpose=Purpose.LOITER,
        reason=words,
        stage=Stage.FRESH,
        picture_age_s=None,
        wanted_heading_rad=wanted_rad,
        turn_limited=TURN in verdict.changes,
        setpoint=verdict.setpoint,
        guard_changes=tuple(change for change in verdict.changes if change != TURN),
        certified_s=verdict.certified_s,
    )
