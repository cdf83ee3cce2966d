"""The companion without sockets: frames and time in, a setpoint frame and the reasons for it out.

The shell (`companion run`) and the lockstep simulator run this same object. Each tick walks one line: telemetry ->
may it steer (authority) -> picture -> how far all of it can be trusted (ladder) -> what to do (target, loiter, return)
-> direction -> turn limit -> guard -> adapter.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

import numpy as np

from companion.autopilot.adapter import Adapter
from companion.autopilot.registry import ADAPTERS
from companion.autopilot.telemetry import (
    COMPANION_COMPONENT,
    HEARTBEAT_PERIOD_S,
    HEARTBEAT_TIMEOUT_S,
    NEIGHBOUR_MEMORY_S,
    Telemetry,
)
from companion.files.tlog import whole_frames
from companion.geo.kinematics import limit_turn
from companion.geo.local_frame import LocalFrame, to_grid
from companion.geo.polygon import inside_polygon
from companion.guard.guard import NO_BACKUP, Discs, Guard, Limits, Motion, Setpoint, Verdict
from companion.guidance.laws import Pose, SteeringDemand, SteeringLaw, Task, law_of
from companion.guidance.separation import Rules, give_way, interaction_radius_m
from companion.guidance.steering import (
    APPROACH_GAIN_1_S,
    RANGE_RESERVE,
    SteeringVector,
    attraction,
    loiter_attraction,
    loiter_place,
    loiter_radius_m,
    loiter_spacing_m,
)
from companion.guidance.view import Traffic, View
from companion.onboard.authority import FAILSAFE, FAILSAFE_STATES, STREAM_GAP_S, Authority, State
from companion.onboard.config import Config, LimitsSection
from companion.onboard.failsafe import (
    SEVERITY,
    Cause,
    FailsafeInputs,
    FailsafeStatus,
    FailsafeThresholds,
    Stage,
    assess,
)
from companion.onboard.limits import within
from companion.onboard.world_model import WorldModel
from companion.protocol.authenticator import Authenticated, Authenticator, Trust
from companion.protocol.codec import Directive, FrameWriter, ReportFrame
from companion.protocol.frame import RawFrame
from companion.protocol.link_quality import LinkMonitor

ARRIVAL_SHARE = 0.8
"""A target may have moved since it was heard of: arriving means being within this share of the arrival radius of where
it was, and stays true until outside the whole of it."""
WAITING_SPACINGS = 2.0
"""Who goes second waits so many loiter spacings outside the arrival radius..."""
WAITING_LEAVE = 1.5
"""...and until it is this many times as far, so that a loiter circle does not leave it."""
STANDING_WITHIN_M = 1.0
"""A vehicle that can stop stands still within this distance of its loiter place."""
BAND_MARGIN_M = 5.0
"""Above and below its height a vehicle minds the threats there: it does not hold a height to the metre."""
COURSE_SPEED_M_S = 1.0
"""Below this ground speed the course over ground says nothing and the yaw is used."""
STEP_SHARE = 1.5
"""No step between two positions is believed to be longer than this share of what speed limit and wind allow."""
ECHO_S = 3.0
"""The fleet's own callsign nearer to us than so much flight is the echo of our own transponder."""
CLOCK_DIGITS = 3
"""Offsets of the clock are kept to the millisecond: a log, which is exact to the microsecond, then tells the same."""
NOT_HANDED_OVER = "not armed and in the guided mode"
HOME_TOO_FAR = "the autopilot's home is farther away than limits.range_m: where it began to steer counts"


class Purpose(Enum):
    """What the companion is doing."""

    IDLE = "idle"
    """Not steering: no telemetry, or a person has the vehicle."""
    TARGET = "target"
    LOITER = "loiter"
    RETURN = "return"


@dataclass(frozen=True)
class Decision:
    """One tick's decision and why (docs/design.md, rule 6). Headings are from grid north."""

    t_s: float
    purpose: Purpose
    reason: str
    stage: Stage
    picture_age_s: float | None
    target_id: int | None = None
    wanted_heading_rad: float = math.nan
    """Before the turn limit."""
    turn_limited: bool = False
    setpoint: Setpoint | None = None
    guard_changes: tuple[str, ...] = ()
    broken: tuple[str, ...] = ()
    """Assumptions of the guard's that do not hold (docs/guard.md)."""
    gave_way: str | None = None
    """What the right of way changed."""
    note: str | None = None
    """What else the law says of it."""
    stay: str | None = None
    """Why the law could do no better than to loiter."""
    opposed: bool = False
    """The surrogate's component against the route was dropped."""
    triggers: tuple[str, ...] = ()
    """All that speaks for the stage or a milder one, the most severe first."""

    @property
    def uncertified(self) -> bool:
        """Whether the guard had no certified back-up for this decision."""
        return NO_BACKUP in self.guard_changes


class Companion:
    """Steers one vehicle by what it last heard. Times are Unix seconds by this vehicle's clock, given by the caller."""

    def __init__(
        self,
        config: Config,
        adapter: Adapter | None = None,
        law: SteeringLaw | None = None,
        authenticator: Authenticator | None = None,
        was: State = State.WAITING,
    ) -> None:
        """Take charge of a vehicle; without a `law` of the caller's the configured one steers.

        `authenticator` decides what is believed of the broadcast; without one, whatever is newer and makes sense.
        `was`: who had the vehicle when the companion before this one ended (`authority.kept`).
        """
        self.config = config
        self.adapter = adapter_of(config) if adapter is None else adapter
        self.authority = Authority(self.adapter.resumes_on_stream, was)
        self.standing = FailsafeStatus()
        """How far picture and vehicle can be trusted, as of the last tick."""
        self.limits = config.limits
        """What guidance and guard reckon with: the configured limits, within what the vehicle can do."""
        self.authenticator = authenticator or Authenticator(Trust())
        clocks_agree = self.authenticator.trust.clock_checked
        self.link_monitor = LinkMonitor(clocks_agree=clocks_agree)
        self.world_model = WorldModel(config.agent_id, config.peer_memory_s, clocks_agree=clocks_agree)
        self._thresholds = _thresholds(config)
        self._given_law = law
        self._adopt(self.limits)
        self._frame: LocalFrame | None = None
        self._frame_origin_deg: tuple[float, float] | None = None
        self._start_deg: tuple[float, float] | None = None
        self._place_ned_m: tuple[float, float] | None = None
        self._arrived = False
        self._yielding = False
        self._home = False
        self._engaged = False
        self._unable: str | None = None
        """Why what the vehicle can do is not enough to be steered."""
        self._abilities_changed = False
        self._namesake = False
        self._clock_offset_s = 0.0
        self._uncertified_from_s: float | None = None
        self._streamed_s: float | None = None
        """When a stream of setpoints last had one."""
        self.flown_m = 0.0
        """Distance flown under guidance."""
        self._out_of_range = False
        self._last_position_ned_m: tuple[float, float] | None = None
        self._last_position_at_s = -math.inf
        self._home_too_far = False
        self._last_heading_rad = 0.0
        self._next_heartbeat_s = -math.inf
        self._next_report_s = -math.inf
        self._report_writer: FrameWriter | None = None
        self._steered: tuple[Setpoint, float] | None = None
        """The setpoint that stands, and the convergence at the place that it was made for."""

    @property
    def steers(self) -> bool:
        """Whether a setpoint stands."""
        return self._steered is not None

    def hear(self, datagram: bytes, now_s: float) -> list[RawFrame]:
        """Take in bytes from the broadcast link; return the frames that are believed. Never raises, whatever the bytes.

        In a flood a frame may be believed only at a later call.
        """
        return self._believe(self.authenticator.admit(datagram, now_s), now_s)

    def hear_frames(self, frames: Iterable[RawFrame], now_s: float) -> list[RawFrame]:
        """Take in what the authenticator has deframed; return the frames that are believed; see `hear`."""
        return self._believe(self.authenticator.admit_frames(frames, now_s), now_s)

    def hear_waiting(self, now_s: float) -> list[RawFrame]:
        """Take in what waited for its check; return the frames that are believed."""
        return self._believe(self.authenticator.due(now_s), now_s)

    def receive(self, datagram: bytes, now_s: float) -> None:
        """Take in bytes from the autopilot link; never raises, whatever the bytes.

        What does not begin with whole frames is not heard: a log could not keep it.
        """
        for frame in whole_frames(datagram):
            self.adapter.receive(frame, now_s)
            # After each: what one datagram says first counts too, however soon it is taken back.
            self.authority.note(self.adapter.telemetry, self.adapter.steerable)

    def clear(self, now_s: float) -> None:
        """Let a vehicle that was taken over be handed over again: a person on the spot says so."""
        self.authority.clear()

    def note_clock(self, offset_s: float) -> bool:
        """Note how far this computer's clock is from the one that times are told by; return whether that is news.

        Only news matters to what is decided, so that only news need be logged.
        """
        offset_s = round(offset_s, CLOCK_DIGITS)
        change_s = round(abs(offset_s - self._clock_offset_s), CLOCK_DIGITS)
        news = change_s >= 0.5 * self._thresholds.clock_step_s
        if news:
            self._clock_offset_s = offset_s
        return news

    def tick(self, now_s: float) -> tuple[Decision, list[bytes]]:
        """Decide for the next guidance step; return the decision and the frames for the autopilot."""
        requests = self.adapter.requests(now_s)
        self._follow(now_s)
        decision, convergence_rad = self._decide(now_s)
        self._steered = None if decision.setpoint is None else (decision.setpoint, convergence_rad)
        return decision, self._frames(requests, now_s)

    def repeat(self, now_s: float) -> list[bytes]:
        """Return the frames that keep the last decision standing between guidance steps; none if it must not stand.

        An autopilot gives a silent companion up after a second or a few (docs/autopilots.md: COM_OF_LOSS_T,
        GUID_TIMEOUT), which a guidance step may be longer than.
        """
        requests = self.adapter.requests(now_s)
        if self._stream_ended(now_s) or self._why_idle(self.adapter.telemetry, now_s) is not None:
            self._steered = None
        return self._frames(requests, now_s)

    def report(self, now_s: float) -> list[bytes]:
        """Return the report for the uplink if one is due and the vehicle knows where it is."""
        telemetry = self.adapter.telemetry
        known = (
            telemetry.position_at_s is not None and now_s - telemetry.position_at_s <= self.config.telemetry_timeout_s
        )
        if self.config.report_period_s == 0.0 or now_s < self._next_report_s or not known:
            return []
        self._next_report_s = now_s + self.config.report_period_s
        if self._report_writer is None:
            self._report_writer = FrameWriter(telemetry.system_id or 1, COMPANION_COMPONENT)
        position_at_s = telemetry.position_at_s or now_s
        epoch_s = int(position_at_s)
        frame = ReportFrame(
            epoch_s=epoch_s,
            time_ms=round((position_at_s - epoch_s) * 1000.0),
            agent_id=self.config.agent_id,
            lat_deg=telemetry.lat_deg,
            lon_deg=telemetry.lon_deg,
            velocity_north_m_s=telemetry.velocity_north_m_s,
            velocity_east_m_s=telemetry.velocity_east_m_s,
            flown_m=self.flown_m,
        )
        return [self._report_writer.encode(frame)]

    def relocate(self, flown_m: float) -> None:
        """Begin anew to measure the way flown, from a known length: the vehicle is not where the last step left it."""
        self.flown_m = flown_m
        self._last_position_ned_m = None

    def _believe(self, admitted: list[Authenticated], now_s: float) -> list[RawFrame]:
        for _, frame in admitted:
            self.link_monitor.note(frame, now_s)
            self.world_model.take(frame, now_s)
        return [raw for raw, _ in admitted]

    def _adopt(self, limits: LimitsSection) -> None:
        """Reckon with these limits from now on; raises ValueError for some that nothing can hold."""
        config, can_stop = self.config, self.adapter.can_stop
        guard = Guard(_limits(limits, can_stop))
        rules = _rules(config, limits, can_stop) if config.law == "routed" else None
        law = self._given_law or law_of(config.model_copy(update={"limits": limits}))
        self.guard, self.limits, self._rules, self._law = guard, limits, rules, law
        self._interaction_m = 0.0
        if self._rules is not None:
            self._interaction_m = interaction_radius_m(self._rules, config.guidance_step_s)
        self._loiter_radius_m = loiter_radius_m(limits.speed_m_s, limits.n_max, config.guidance_step_s)

    def _follow(self, now_s: float) -> None:
        """Follow who has the vehicle, and while nobody is steered what it can do."""
        adapter = self.adapter
        self.authority.note(adapter.telemetry, adapter.steerable)
        if self._stream_ended(now_s):
            self.authority.note_gap(self._silence(adapter.telemetry, now_s) or "this companion was held up")
        if not adapter.parameters_known:
            return
        limits = within(self.config.limits, adapter.abilities)
        if not self._engaged:
            self._unable = self._reckon_with(limits)
        # Guard and guidance keep to what they began with: a certified path stays one only by the same limits.
        self._abilities_changed = self._engaged and limits != self.limits

    def _reckon_with(self, limits: LimitsSection) -> str | None:
        """Adopt what is new in these limits; return why they cannot be flown by, if so."""
        if limits.wind_m_s >= limits.speed_m_s:
            return f"limits.wind_m_s {limits.wind_m_s:g} is not below the {limits.speed_m_s:.3g} m/s that it can fly"
        try:
            if limits != self.limits:
                self._adopt(limits)
        except ValueError:
            return f"its parameters leave {limits.speed_m_s:.3g} m/s and n_max {limits.n_max:.3g}: nothing to fly by"
        return None

    def _stream_ended(self, now_s: float) -> bool:
        """Return whether the autopilot has missed setpoints for so long that it may have stopped obeying."""
        return (
            self.adapter.resumes_on_stream and self._streamed_s is not None and now_s - self._streamed_s > STREAM_GAP_S
        )

    def _frames(self, requests: list[bytes], now_s: float) -> list[bytes]:
        datagrams = []
        if now_s >= self._next_heartbeat_s:
            datagrams.append(self.adapter.heartbeat())
            self._next_heartbeat_s = now_s + HEARTBEAT_PERIOD_S
        datagrams += requests
        stream = self._stream(now_s)
        if stream and self.adapter.resumes_on_stream:
            self._streamed_s = now_s
        return datagrams + stream

    def _stream(self, now_s: float) -> list[bytes]:
        """Return the setpoint that stands, or "stay as you are" where a stream must flow before a person hands over."""
        if self._steered is not None:
            return self.adapter.encode(*self._steered, now_s)
        if not self.adapter.resumes_on_stream or self.authority.locked or not self.adapter.telemetry.in_air:
            # Not known to be in the air yet: on the ground nothing is streamed.
            return []
        # An engagement whose stream has ended is over, which the next tick says.
        over = self.authority.state is State.ENGAGED and self._stream_ended(now_s)
        if over or self._silence(self.adapter.telemetry, now_s) is not None:
            return []
        return self.adapter.hold(now_s)

    def _decide(self, now_s: float) -> tuple[Decision, float]:
        """Return the decision, and the convergence at the place that it was made for."""
        age_s = self.world_model.age_s(now_s)
        telemetry = self.adapter.telemetry
        if not self._engaged:
            self._assess(age_s, telemetry, now_s)
        idle = self._why_idle(telemetry, now_s)
        if idle is not None:
            if self._engaged:
                self._assess(age_s, telemetry, now_s)
            self._disengage()
            stage, triggers = self.standing.stage, self._triggers()
            return Decision(now_s, Purpose.IDLE, idle, stage, age_s, triggers=triggers), 0.0
        self._engaged = True
        motion, convergence_rad, home_ned_m = self._motion(telemetry, now_s)
        view = self.world_model.view(now_s, self._band_m(telemetry))
        view = self.world_model.with_traffic(view, self._seen(motion, now_s))
        self._mind_range(math.dist((motion.north_m, motion.east_m), home_ned_m))
        self._assess(age_s, telemetry, now_s)
        purpose, reason = self._purpose(motion, home_ned_m, view)
        pose = Pose(motion.north_m, motion.east_m, motion.heading_rad, motion.speed_m_s)
        goal_ned_m = view.target_ned_m if purpose is Purpose.TARGET else home_ned_m
        wish, speed_m_s = self._wish(None if purpose is Purpose.LOITER else goal_ned_m, purpose, pose, view, now_s)
        stay, note = wish.stay, wish.note
        if stay is not None:
            purpose, reason = Purpose.LOITER, stay
            wish, speed_m_s = self._wish(None, purpose, pose, view, now_s)
        if purpose is not Purpose.LOITER:
            self._place_ned_m = None
        wanted = wish.pull
        settled = self.adapter.can_stop and speed_m_s == 0.0 and wanted.strength_m <= STANDING_WITHIN_M
        wanted_rad = motion.heading_rad if settled or wanted.strength_m == 0.0 else wanted.heading_rad
        if self.adapter.can_stop and purpose is not Purpose.TARGET and not settled:
            speed_m_s = min(self.limits.speed_m_s, APPROACH_GAIN_1_S * wanted.strength_m)
        gave_way = None
        steered_rad = wanted_rad
        if self._rules is not None:
            given = give_way(
                wanted_rad,
                motion,
                view.traffic_ned_m,
                view.traffic_velocity_m_s,
                self._rules,
                self.config.guidance_step_s,
                heading_at_effect_rad=self._heading_at_effect_rad(),
            )
            steered_rad, gave_way = given.heading_rad, given.reason
            if self.adapter.can_stop and gave_way is not None:
                speed_m_s = min(speed_m_s, given.speed_m_s)
        # The turn is limited at the greater of the speeds during the step, as the guard does.
        faster_m_s = max(motion.speed_m_s, speed_m_s)
        heading_rad, limited = limit_turn(
            self._turned_by_effect_rad(motion, faster_m_s),
            steered_rad,
            faster_m_s,
            self.limits.n_max,
            self.config.guidance_step_s,
        )
        verdict = self._guarded(Setpoint(heading_rad, speed_m_s, self.config.height_m), motion, view, wish, now_s)
        self._note_certainty(NO_BACKUP not in verdict.changes, now_s)
        said = (
            note,
            f"another vehicle uses agent id {self.config.agent_id}" if self._namesake else None,
            HOME_TOO_FAR if self._home_too_far else None,
        )
        decision = Decision(
            t_s=now_s,
            purpose=purpose,
            reason=reason,
            stage=self.standing.stage,
            picture_age_s=age_s,
            triggers=self._triggers(),
            target_id=self.world_model.target_id if purpose is Purpose.TARGET else None,
            wanted_heading_rad=wanted_rad,
            turn_limited=limited,
            setpoint=verdict.setpoint,
            guard_changes=verdict.changes,
            broken=verdict.broken,
            gave_way=gave_way,
            note="; ".join(word for word in said if word is not None) or None,
            stay=stay,
            opposed=wish.opposed,
        )
        return decision, convergence_rad

    def _assess(self, age_s: float | None, telemetry: Telemetry, now_s: float) -> None:
        """Find how far picture and vehicle can be trusted now."""
        unsure_s = 0.0 if self._uncertified_from_s is None else now_s - self._uncertified_from_s
        inputs = FailsafeInputs(
            picture_age_s=age_s,
            position_accuracy_m=telemetry.position_accuracy_m,
            battery_percent=telemetry.battery_percent,
            out_of_range=self._out_of_range,
            outside_fence=self._engaged and self._is_outside(telemetry),
            uncertified_s=unsure_s,
            abilities_changed=self._abilities_changed,
            clock_offset_s=self._clock_offset_s,
        )
        self.standing = assess(inputs, self._thresholds, self.standing, now_s)

    def _triggers(self) -> tuple[str, ...]:
        return tuple(trigger.words for trigger in self.standing.triggers)

    def _note_certainty(self, certain: bool, now_s: float) -> None:
        """Keep since when the guard has had no certified back-up.

        The paper's laws are flown to see what they do, wherever that leads.
        """
        if certain or self.config.law != "routed":
            self._uncertified_from_s = None
        elif self._uncertified_from_s is None:
            self._uncertified_from_s = now_s

    def _why_idle(self, telemetry: Telemetry, now_s: float) -> str | None:
        """Return why the vehicle is not steered now, if it is not."""
        reason = self._unheard(telemetry, now_s)
        if reason is not None:
            return reason
        if self.authority.locked:
            cleared = "disarmed or cleared by a signal" if self._signal_clears else "disarmed"
            return f"{self.authority.reason}; nothing is sent until it is {cleared}"
        if not self.adapter.steerable:
            return NOT_HANDED_OVER
        return self._unfit(telemetry, now_s) or (None if self._engaged else self._not_yet(telemetry))

    @property
    def _signal_clears(self) -> bool:
        return self.config.autopilot is not None and self.config.autopilot.clear == "signal"

    def _silence(self, telemetry: Telemetry, now_s: float) -> str | None:
        """Return why nothing at all may be asked of the autopilot, whoever has it."""
        return self._unheard(telemetry, now_s) or self._unfit(telemetry, now_s)

    def _unheard(self, telemetry: Telemetry, now_s: float) -> str | None:
        """Return why it is not known who has the vehicle, or which it is."""
        if self.adapter.refusal is not None:
            return self.adapter.refusal
        if telemetry.system_id is None:
            return "no autopilot heard"
        if telemetry.heartbeat_at_s is None or now_s - telemetry.heartbeat_at_s > HEARTBEAT_TIMEOUT_S:
            # What it said of arming and mode may no longer be so.
            return "autopilot's heartbeat lost"
        return None

    def _unfit(self, telemetry: Telemetry, now_s: float) -> str | None:
        """Return why the vehicle cannot be steered even by who has it."""
        if telemetry.system_status in FAILSAFE_STATES:
            return FAILSAFE
        if telemetry.position_at_s is None:
            return "no position yet"
        if now_s - telemetry.position_at_s > self.config.telemetry_timeout_s:
            return "position too old"
        if telemetry.gps_fix is not None and telemetry.gps_fix < self.config.health.gps_fix_min:
            return "no GPS fix"
        if self.adapter.missing_telemetry is not None:
            return self.adapter.missing_telemetry
        # A setpoint would end a take-off under way; the person who took off finishes it.
        if telemetry.in_air is False:
            return "not in the air yet, or landing"
        return None

    def _not_yet(self, telemetry: Telemetry) -> str | None:
        """Return what must come before the vehicle is steered for the first time since it was handed over."""
        if not self.adapter.parameters_known:
            return "reading the autopilot's parameters"
        if self._unable is not None:
            return self._unable
        picture = next((one for one in self.standing.triggers if one.cause is Cause.BROADCAST), None)
        if picture is not None and SEVERITY[picture.stage] >= SEVERITY[Stage.LOITERING]:
            return picture.words
        if self._is_outside(telemetry):
            return "outside the fence"
        if telemetry.height_m < self.limits.height_min_m:
            return "below height_min_m"
        return None

    def _is_outside(self, telemetry: Telemetry) -> bool:
        """Return whether the vehicle is outside the fence; without a picture nobody knows where that is."""
        if self.limits.fence is None or self.world_model.origin_deg is None:
            return False
        north_m, east_m, _ = self._place(telemetry)
        return not inside_polygon((north_m, east_m), self.limits.fence)

    def _disengage(self) -> None:
        """Forget what was latched: it belongs to the last engagement, and a person has the vehicle."""
        if self._engaged:
            self.adapter.release()
        self._engaged = self._abilities_changed = False
        self._uncertified_from_s = None
        self._place_ned_m = None
        self._arrived = False
        self._yielding = False
        self._home = False
        self._last_position_ned_m = None
        self.guard.reset()

    def _motion(self, telemetry: Telemetry, now_s: float) -> tuple[Motion, float, tuple[float, float]]:
        """Return the vehicle's motion now, the convergence there, and home, on the plane of the picture."""
        north_m, east_m, convergence_rad = self._place(telemetry)
        speed_m_s = math.hypot(telemetry.velocity_north_m_s, telemetry.velocity_east_m_s)
        if speed_m_s >= COURSE_SPEED_M_S:
            self._last_heading_rad = math.atan2(telemetry.velocity_east_m_s, telemetry.velocity_north_m_s)
        elif telemetry.yaw_rad is not None:
            self._last_heading_rad = telemetry.yaw_rad
        if self._start_deg is None:
            self._start_deg = (telemetry.lat_deg, telemetry.lon_deg)
        position_at_s = now_s if telemetry.position_at_s is None else telemetry.position_at_s
        if self._last_position_ned_m is not None:
            step_m = math.dist(self._last_position_ned_m, (north_m, east_m))
            self.flown_m += min(step_m, self._longest_step_m(position_at_s - self._last_position_at_s))
        self._last_position_ned_m, self._last_position_at_s = (north_m, east_m), position_at_s
        heading_rad = (self._last_heading_rad - convergence_rad) % math.tau
        # Telemetry is a little old: the vehicle has gone on since.
        since_m = speed_m_s * (now_s - position_at_s)
        north_m += since_m * math.cos(heading_rad)
        east_m += since_m * math.sin(heading_rad)
        home_ned_m = self._home_ned_m(self._frame_here(telemetry), telemetry.home_deg, self._start_deg)
        return Motion(north_m, east_m, heading_rad, speed_m_s), convergence_rad, home_ned_m

    def _longest_step_m(self, elapsed_s: float) -> float:
        """Return how far the vehicle can have flown meanwhile: one wrong position is not to use up its range."""
        limits = self.limits
        return STEP_SHARE * (limits.speed_m_s + limits.wind_m_s) * max(0.0, elapsed_s) + limits.position_error_m

    def _home_ned_m(
        self, frame: LocalFrame, home_deg: tuple[float, float] | None, start_deg: tuple[float, float]
    ) -> tuple[float, float]:
        """Return home: the autopilot's, or where it began to steer if that is unknown or out of the vehicle's range."""
        start_ned_m = frame.to_local(*start_deg)
        self._home_too_far = False
        if home_deg is None:
            return start_ned_m
        home_ned_m = frame.to_local(*home_deg)
        self._home_too_far = not math.dist(home_ned_m, start_ned_m) <= self.limits.range_m
        return start_ned_m if self._home_too_far else home_ned_m

    def _place(self, telemetry: Telemetry) -> tuple[float, float, float]:
        """Return north and east m on the plane of the picture, and the convergence there."""
        return self._frame_here(telemetry).to_local_with_convergence(telemetry.lat_deg, telemetry.lon_deg)

    def _frame_here(self, telemetry: Telemetry) -> LocalFrame:
        """Return the plane of the picture; without one, a plane about the place where the vehicle is."""
        origin_deg = self.world_model.origin_deg or self._frame_origin_deg or (telemetry.lat_deg, telemetry.lon_deg)
        if self._frame is None or self._frame_origin_deg != origin_deg:
            self._frame, self._frame_origin_deg = LocalFrame(*origin_deg), origin_deg
            self._place_ned_m = self._last_position_ned_m = None
            self.guard.reset()
        return self._frame

    def _heading_at_effect_rad(self) -> float | None:
        """Return where the vehicle will head when this decision begins to act; None for now."""
        if self.limits.reaction_s == 0.0 or self._steered is None:
            return None
        return self._steered[0].heading_rad

    def _turned_by_effect_rad(self, motion: Motion, speed_m_s: float) -> float:
        """Return the heading from which this decision will turn: by then the last one has had its reaction time."""
        last_rad = self._heading_at_effect_rad()
        if last_rad is None:
            return motion.heading_rad
        return limit_turn(motion.heading_rad, last_rad, speed_m_s, self.limits.n_max, self.limits.reaction_s)[0]

    def _band_m(self, telemetry: Telemetry) -> tuple[float, float]:
        """Return the altitudes above sea level that this vehicle is at or on its way to; NaN if it does not say."""
        to_go_m = self.config.height_m - telemetry.height_m
        return (
            telemetry.altitude_m + min(0.0, to_go_m) - BAND_MARGIN_M,
            telemetry.altitude_m + max(0.0, to_go_m) + BAND_MARGIN_M,
        )

    def _purpose(self, motion: Motion, home_ned_m: tuple[float, float], view: View) -> tuple[Purpose, str]:
        position = (motion.north_m, motion.east_m)
        homing = self._why_home()
        if homing is not None:
            # A loiter circle begun just inside reaches out by its width: that is still being home.
            leaving_m = self.config.arrival_radius_m + 2.0 * self._loiter_radius_m
            home_m = math.dist(position, home_ned_m)
            self._home = home_m <= (leaving_m if self._home else ARRIVAL_SHARE * self.config.arrival_radius_m)
            return (Purpose.LOITER, f"{homing}: home") if self._home else (Purpose.RETURN, homing)
        self._home = False
        if self.standing.stage is Stage.LOITERING:
            return Purpose.LOITER, self.standing.words
        if self.world_model.directive is Directive.HOLD:
            return Purpose.LOITER, "directive hold"
        if view.target_ned_m is None:
            return Purpose.LOITER, "no target"
        within_m = self.config.arrival_radius_m * (1.0 if self._arrived else ARRIVAL_SHARE)
        self._arrived = math.dist(position, view.target_ned_m) <= within_m
        if self._arrived:
            return Purpose.LOITER, "arrived"
        # Two cannot both keep their separation within one arrival radius, and one arrival is enough.
        waiting_m = self.config.arrival_radius_m + WAITING_SPACINGS * self._loiter_spacing_m()
        waiting_m *= 1.0 if not self._yielding else WAITING_LEAVE
        near = math.dist(position, view.target_ned_m) <= waiting_m
        first = self._who_goes_first(position, view.target_ned_m, view) if near else None
        self._yielding = first is not None
        if first is not None:
            return Purpose.LOITER, f"agent {first} arrives first"
        return Purpose.TARGET, "assigned"

    def _who_goes_first(
        self, position: tuple[float, float], target_ned_m: tuple[float, float], view: View
    ) -> int | None:
        """Return whom we let go first: who is nearer to our target, or of two about as near the lower id."""
        to_target_m = math.dist(position, target_ned_m)
        for identity, place in view.rivals:
            behind_m = to_target_m - math.dist(place, target_ned_m)
            abreast = abs(behind_m) <= self._loiter_spacing_m()
            if (abreast and identity < self.config.agent_id) or (not abreast and behind_m > 0.0):
                return identity
        return None

    def _why_home(self) -> str | None:
        if self.standing.stage is Stage.RETURNING:
            return self.standing.words
        return "directive return" if self.world_model.directive is Directive.RETURN else None

    def _mind_range(self, home_m: float) -> None:
        """Note whether it is time to turn home so as to get there."""
        if self.config.range_policy == "return" and not self._out_of_range:
            # Beyond the budget there is no way home any more: then the target is as good as anywhere. A step of margin,
            # so that the moment cannot fall between two decisions, however near home is.
            range_m = self.limits.range_m
            step_m = self.limits.speed_m_s * self.config.guidance_step_s
            short = range_m < self.flown_m + RANGE_RESERVE * home_m + step_m
            self._out_of_range = short and self.flown_m + home_m <= range_m + step_m

    def _wish(
        self,
        goal_ned_m: tuple[float, float] | None,
        purpose: Purpose,
        pose: Pose,
        view: View,
        now_s: float,
    ) -> tuple[SteeringDemand, float]:
        """Return what the law wants, and the speed the vehicle shall have; without a goal it loiters."""
        pull, speed_m_s = self._pull(goal_ned_m, pose, view)
        task = Task(
            place_ned_m=goal_ned_m or self._place_ned_m or pose.position_ned_m,
            pull=pull,
            loitering=goal_ned_m is None,
            to_target=purpose is Purpose.TARGET,
            flown_m=self.flown_m,
            arrival_m=ARRIVAL_SHARE * self.config.arrival_radius_m,
            crowded=self._crowded(pose, view),
        )
        return self._law.steer(task, pose, view, now_s), speed_m_s

    def _pull(self, goal_ned_m: tuple[float, float] | None, pose: Pose, view: View) -> tuple[SteeringVector, float]:
        """Return what attracts the vehicle now, and the speed it shall have; without a goal it loiters."""
        position, cruise_m_s = pose.position_ned_m, self.limits.speed_m_s
        if goal_ned_m is not None:
            return attraction(position, goal_ned_m), cruise_m_s
        if self._place_ned_m is None:
            self._place_ned_m = loiter_place(position, view.loitering_ned_m, self._loiter_spacing_m())
        if not self.adapter.can_stop:
            return loiter_attraction(position, self._place_ned_m, self._loiter_radius_m), cruise_m_s
        pull = attraction(position, self._place_ned_m)
        return pull, 0.0 if pull.strength_m <= STANDING_WITHIN_M else cruise_m_s

    def _seen(self, motion: Motion, now_s: float) -> list[Traffic]:
        """Return who is near by the vehicle's own detector, and where by now on the plane of the picture."""
        seen: list[Traffic] = []
        self._namesake = False
        echo_m = max(self.config.separation_m, ECHO_S * self.limits.speed_m_s)
        for neighbour in self.adapter.neighbours:
            age_s = max(0.0, now_s - neighbour.seen_at_s)
            if age_s > NEIGHBOUR_MEMORY_S or self._frame is None:
                continue
            north_m, east_m, convergence_rad = self._frame.to_local_with_convergence(
                neighbour.lat_deg, neighbour.lon_deg
            )
            north_m_s, east_m_s = to_grid(neighbour.velocity_north_m_s, neighbour.velocity_east_m_s, convergence_rad)
            north_m, east_m = north_m + age_s * north_m_s, east_m + age_s * east_m_s
            apart_m = math.dist((north_m, east_m), (motion.north_m, motion.east_m))
            identity = neighbour.agent_id
            if identity == self.config.agent_id:
                if apart_m <= echo_m:
                    continue
                self._namesake, identity = True, None
            above_m = abs(neighbour.altitude_m - self.adapter.telemetry.altitude_m)
            elsewhere = 0.0 < self.config.vertical_separation_m <= above_m
            if not elsewhere and apart_m <= self.config.detector_range_m:
                seen.append(Traffic(identity, (north_m, east_m), (north_m_s, east_m_s)))
        return seen

    def _loiter_spacing_m(self) -> float:
        """Return how far from a settled peer we loiter; one that cannot stop is somewhere on its circle."""
        radius_m = 0.0 if self.adapter.can_stop else self._loiter_radius_m
        return loiter_spacing_m(self.config.separation_m, radius_m) + radius_m

    def _guarded(self, wanted: Setpoint, motion: Motion, view: View, wish: SteeringDemand, now_s: float) -> Verdict:
        by_attack = self.config.keep_out == "attack"
        discs = Discs(
            centres_ned_m=view.threats_ned_m,
            radii_m=view.attack_radius_m if by_attack else view.detection_radius_m,
            speeds_m_s=view.threat_speed_m_s,
            attack_m=view.attack_radius_m,
            ids=view.threat_ids,
        )
        route = () if wish.route is None else wish.route.pieces + wish.onward
        keep_right = self._crowded(motion, view)
        return self.guard.check(wanted, motion, discs, now_s, self.config.guidance_step_s, route, keep_right)

    def _crowded(self, here: Motion | Pose, view: View) -> bool:
        """Return whether another is within the interaction radius."""
        if len(view.traffic_ned_m) == 0:
            return False
        apart_m = np.hypot(view.traffic_ned_m[:, 0] - here.north_m, view.traffic_ned_m[:, 1] - here.east_m)
        return bool(np.any(apart_m <= self._interaction_m))


def adapter_of(config: Config) -> Adapter:
    """Return the adapter of the autopilot that a configuration names; without one, of the simulator's point."""
    if config.autopilot is None:
        return ADAPTERS["kinematic"]()
    return ADAPTERS[config.autopilot.kind](config.autopilot.system_id)


def _thresholds(config: Config) -> FailsafeThresholds:
    return FailsafeThresholds(
        coasting_after_s=config.staleness.coasting_after_s,
        loitering_after_s=config.staleness.loitering_after_s,
        returning_after_s=config.staleness.blind_after_s,
        recover_after_s=config.staleness.recover_after_s,
        battery_return_percent=config.health.battery_return_percent,
        position_accuracy_m=config.health.position_accuracy_m,
        infeasible_after_s=config.health.infeasible_after_s,
        clock_step_s=config.health.clock_step_s,
    )


def _rules(config: Config, limits: LimitsSection, can_stop: bool) -> Rules:
    return Rules(
        separation_m=config.separation_m,
        n_max=limits.n_max,
        speed_m_s=limits.speed_m_s,
        reaction_s=limits.reaction_s,
        can_stop=can_stop,
        braking_m_s2=limits.braking_m_s2 if can_stop else None,
        position_error_m=limits.position_error_m,
    )


def _limits(limits: LimitsSection, can_stop: bool) -> Limits:
    return Limits(
        speed_min_m_s=0.0 if can_stop else limits.speed_m_s,
        speed_max_m_s=limits.speed_m_s,
        n_max=limits.n_max,
        altitude_min_m=limits.height_min_m,
        altitude_max_m=limits.height_max_m,
        braking_m_s2=limits.braking_m_s2 if can_stop else None,
        fence_ned_m=limits.fence,
        reaction_s=limits.reaction_s,
        rate_share=limits.rate_share,
        wind_m_s=limits.wind_m_s,
        position_error_m=limits.position_error_m,
    )
