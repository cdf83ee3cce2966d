"""The companion without sockets: frames and time in, a setpoint frame and the reasons for it out.

The shell (`companion run`) and the lockstep simulator run this same object. Each tick passes these stages, a module or
two each: telemetry -> may the companion steer (authority, readiness) -> where is the vehicle (navigation) -> what is
known of the others (world_model, traffic) -> how far can that be trusted (failsafe) -> what to do (goal) -> law, right
of way, turn limit, guard (steering) -> adapter (setpoint_stream).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from companion.autopilot.adapter import Adapter
from companion.autopilot.registry import ADAPTERS
from companion.autopilot.streams import in_words as seldom_in_words
from companion.autopilot.telemetry import Telemetry
from companion.files.tlog import whole_frames
from companion.geo.kinematics import GRAVITY_M_S2
from companion.guard.types import BACKUP, FENCE, KEEP_OUT, NO_BACKUP
from companion.guidance.laws import SteeringLaw
from companion.onboard.answer import Rung
from companion.onboard.authority import Authority, State
from companion.onboard.config import Config
from companion.onboard.decision import Decision, Purpose
from companion.onboard.engagement import Engagement, GridSetpoint
from companion.onboard.failsafe import Failsafe, FailsafeInputs, FailsafeStatus
from companion.onboard.goal import Goal, Situation, choose_goal
from companion.onboard.hand_over import believed, believed_before, flight_after, followed, handed_over
from companion.onboard.navigation import Located, Navigation, navigate, outside_fence, plane_of
from companion.onboard.obedience import NOTHING, Obedience, in_words, watch
from companion.onboard.position_gate import doubted, jumped
from companion.onboard.readiness import (
    HAND_OVER_AGAIN,
    below_words,
    beyond_limits,
    is_below,
    is_straight_up,
    may_hold,
    misplaced,
    not_reachable,
    not_ready,
    not_steerable,
    told_by_autopilot,
)
from companion.onboard.references import counted_from, height_to_ask_m, moved
from companion.onboard.reporter import Reporter
from companion.onboard.senses import without_a_sense
from companion.onboard.setpoint_stream import AutopilotStream
from companion.onboard.sighting import seen_of
from companion.onboard.steering import Moment, Steered, adapted, outgrown, reckoning, steer, steering_of
from companion.onboard.traffic import detected
from companion.onboard.world_model import WorldModel
from companion.protocol.authenticator import Authenticated, Authenticator, Trust
from companion.protocol.frame import RawFrame
from companion.protocol.link_quality import LinkMonitor

BAND_MARGIN_M = 5.0
"""Margin above and below a vehicle's height within which it avoids threats: it does not hold a height to the metre."""
REFUSALS = frozenset({BACKUP, FENCE, KEEP_OUT, NO_BACKUP})
"""Changes of the guard by which the law learns that its way is refused."""
JUMPS = "position jumps again and again: not believed"
HOME_TOO_FAR = "the autopilot's home is farther away than limits.range_m: where it began to steer counts"


class Companion:
    """Steers one vehicle by what it last heard; the caller gives the times, Unix seconds by this vehicle's clock."""

    def __init__(
        self,
        config: Config,
        adapter: Adapter | None = None,
        law: SteeringLaw | None = None,
        authenticator: Authenticator | None = None,
        was: State = State.WAITING,
    ) -> None:
        """Prepare to steer a vehicle, by the configured law unless the caller gives a `law`.

        `authenticator` decides which frames of the broadcast are accepted; without one, all that are newer and valid.
        `was`: the state (`authority.kept`) that the companion before this one saved.
        """
        self.config = config
        self.adapter = adapter_of(config) if adapter is None else adapter
        self.authority = Authority(self.adapter.resumes_on_stream, was)
        self.authenticator = authenticator or Authenticator(Trust())
        clocks_agree = self.authenticator.trust.clock_checked
        self.link_monitor = LinkMonitor(clocks_agree=clocks_agree)
        self.world_model = WorldModel(config.agent_id, config.peer_memory_s, clocks_agree=clocks_agree)
        self.failsafe = Failsafe(config)
        self.steering = steering_of(config, self.adapter.can_stop, law)
        """Law, right of way and guard, by the configured limits or, where those are narrower, the vehicle's own."""
        self.navigation = Navigation()
        self.engagement: Engagement | None = None
        """State of the present engagement; None while the vehicle is not steered."""
        self._stream = AutopilotStream(self.adapter)
        self._reporter = Reporter(config)

    @property
    def steers(self) -> bool:
        """Whether a setpoint is in force."""
        return self.engagement is not None and self.engagement.setpoint is not None

    @property
    def flown_m(self) -> float:
        """Distance flown under guidance."""
        return self.navigation.flown_m

    @property
    def telemetry(self) -> Telemetry:
        """The newest telemetry as it is believed: by the references of the hand-over, without positions that jump."""
        told, kept = self.adapter.telemetry, self.navigation.hand_over
        return believed_before(self.navigation.flight, told) if kept is None else believed(kept, told)

    def hear(self, datagram: bytes, now_s: float) -> list[RawFrame]:
        """Take in bytes from the broadcast link; return the accepted frames. Never raises, whatever the bytes.

        In a flood the signature of a frame may be checked, and the frame accepted, only at a later call.
        """
        return self._believe(self.authenticator.admit(datagram, now_s), now_s)

    def hear_frames(self, frames: Iterable[RawFrame], now_s: float) -> list[RawFrame]:
        """Take in frames that the authenticator has deframed; return the accepted ones; see `hear`."""
        return self._believe(self.authenticator.admit_frames(frames, now_s), now_s)

    def hear_waiting(self, now_s: float) -> list[RawFrame]:
        """Take in frames that waited for the check of their signature; return the accepted ones."""
        return self._believe(self.authenticator.due(now_s), now_s)

    def receive(self, datagram: bytes, now_s: float) -> int:
        """Take in bytes from the autopilot link; never raises, whatever the bytes.

        Only the whole frames at the beginning of the datagram are used: a log could not hold the rest. Returns how many
        of them were the autopilot's own, and newer than what it said before.
        """
        believed = 0
        for frame in whole_frames(datagram):
            believed += self.adapter.receive(frame, now_s)
            # After each frame: a change that a later frame of the same datagram takes back counts, too.
            self.authority.note(self.adapter.telemetry, self.adapter.steerable)
            self._compare(now_s)
        return believed

    def clear(self, now_s: float) -> None:
        """Clear a take-over at the safety pilot's order: the vehicle may be handed over again."""
        self.authority.clear()
        kept = self.navigation.hand_over
        if kept is not None:
            self.navigation = self.navigation._replace(hand_over=None, flight=kept.references)

    def note_clock(self, offset_s: float) -> bool:
        """Note the offset of the computer's system clock from the clock given to `tick`; return whether it changed.

        A change of less than half `health.clock_step_s` is ignored: it affects no decision and need not be logged.
        """
        return self.failsafe.note_clock(offset_s)

    def tick(self, now_s: float) -> tuple[Decision, list[bytes]]:
        """Decide for the next guidance step; return the decision and the frames for the autopilot."""
        requests = self.adapter.requests(now_s)
        self._follow(now_s)
        decision = self._decide(now_s)
        return decision, self._frames(requests, now_s)

    def repeat(self, now_s: float) -> list[bytes]:
        """Return the frames that repeat the last setpoint between guidance steps; none if it is not valid any more.

        An autopilot gives up a companion that has been silent for a second or a few (docs/autopilots.md: COM_OF_LOSS_T,
        GUID_TIMEOUT), and a guidance step may be longer than that.
        """
        requests = self.adapter.requests(now_s)
        if self.engagement is not None and (self._stream.ended(now_s) or self._not_steerable(now_s) is not None):
            self.engagement = self.engagement._replace(setpoint=None)
        return self._frames(requests, now_s)

    def is_waited_for(self, decision: Decision) -> bool:
        """Return whether a person has handed over a vehicle in the air that the companion does not steer."""
        adapter = self.adapter
        return decision.purpose is Purpose.IDLE and adapter.steerable and adapter.telemetry.in_air is not False

    def report(self, now_s: float) -> list[bytes]:
        """Return the report for the uplink if one is due and the vehicle knows where it is."""
        return self._reporter.due(self.telemetry, self.flown_m, now_s)

    def relocate(self, flown_m: float) -> None:
        """Set the distance flown, and do not count the way to the next position: a report has moved the vehicle."""
        self.navigation = self.navigation._replace(flown_m=flown_m)
        if self.engagement is not None:
            self.engagement = self.engagement._replace(last_fix=None)

    def _believe(self, admitted: list[Authenticated], now_s: float) -> list[RawFrame]:
        for _, frame in admitted:
            self.link_monitor.note(frame, now_s)
            self.world_model.take(frame, now_s)
        return [raw for raw, _ in admitted]

    def _follow(self, now_s: float) -> None:
        """Update who controls the vehicle, and while it is not steered adapt the limits to the vehicle's abilities."""
        adapter = self.adapter
        self.authority.note(adapter.telemetry, adapter.steerable)
        if self._stream.ended(now_s):
            silence = not_reachable(adapter, self.config, now_s)
            self.authority.note_gap(silence or "this companion was held up")
        if not adapter.parameters_known:
            return
        if self.engagement is None:
            self.steering = adapted(self.steering, self.config.limits, adapter.abilities)
            return
        # Guard and guidance keep the limits that they began with: a certified path is certified for those only.
        changed = outgrown(self.steering, self.config.limits, adapter.abilities)
        if changed != self.engagement.abilities_changed:
            self.engagement = self.engagement._replace(abilities_changed=changed)

    def _compare(self, now_s: float) -> None:
        """Compare what the autopilot tells with what is kept from the hand-over or, in a person's hands, the flight."""
        told, kept, flight = self.adapter.telemetry, self.navigation.hand_over, self.navigation.flight
        if kept is None:
            after, flight = None, flight_after(flight, told)
        elif self.adapter.steerable:
            after = followed(kept, told, now_s)
        else:
            after, flight = None, flight_after(kept.references, told)
        if after is not kept or flight is not self.navigation.flight:
            self.navigation = self.navigation._replace(hand_over=after, flight=flight)

    def _begin_hand_over(self) -> None:
        """Keep the references of a vehicle that was handed over in the air, unless they are kept already."""
        if self.navigation.hand_over is None:
            turning_m_s2 = self.config.limits.n_max * GRAVITY_M_S2
            kept = handed_over(self.navigation.flight, self.adapter.telemetry, turning_m_s2)
            self.navigation = self.navigation._replace(hand_over=kept, flight=None)

    def _not_steerable(self, now_s: float) -> str | None:
        reason, kept = not_steerable(self.adapter, self.authority, self.config, now_s), self.navigation.hand_over
        return JUMPS if reason is None and kept is not None and kept.track.is_lost else reason

    def _outside_fence(self) -> bool:
        return outside_fence(self.telemetry, self.world_model.origin_deg, self.steering.config)

    def _frames(self, requests: list[bytes], now_s: float) -> list[bytes]:
        setpoint = None if self.engagement is None else self._as_asked(self.engagement.setpoint)
        ended = self._stream.ended(now_s)
        hold = setpoint is None and may_hold(self.adapter, self.authority, self.config, ended, now_s)
        return self._stream.frames(requests, setpoint, hold, now_s)

    def _as_asked(self, decided: GridSetpoint | None) -> GridSetpoint | None:
        """Return a setpoint with its height in the autopilot's present reference, as its newest telemetry tells it."""
        kept = self.navigation.hand_over
        if decided is None or kept is None:
            return decided
        height_m = height_to_ask_m(kept.references, self.adapter.telemetry, decided.setpoint.altitude_m)
        if height_m == decided.setpoint.altitude_m:
            return decided
        return decided._replace(setpoint=replace(decided.setpoint, altitude_m=height_m))

    def _decide(self, now_s: float) -> Decision:
        age_s = self.world_model.age_s(now_s)
        if self.engagement is None:
            self._assess(age_s, now_s)
        idle = self._not_steerable(now_s)
        if idle is None:
            self._begin_hand_over()
        if idle is None and self.engagement is None:
            unable, status = self.steering.unable, self.failsafe.status
            outside = self._outside_fence()
            idle = self.adapter.silence(now_s) or not_ready(
                self.adapter, self.telemetry, unable, status, outside, self.steering.config
            )
        if idle is None:
            return self._steer(age_s, now_s)
        return self._idle(idle, age_s, now_s)

    def _idle(self, idle: str, age_s: float | None, now_s: float) -> Decision:
        """Send no setpoint; `idle` is why."""
        if self.engagement is not None:
            self._assess(age_s, now_s)
            self._disengage()
        status, said = self.failsafe.status, told_by_autopilot(self.adapter)
        notes = (said, self._told_seldom(now_s), self.adapter.unusual, self.world_model.directives.ended)
        note = "; ".join(one for one in notes if one is not None) or None
        return Decision(now_s, Purpose.IDLE, idle, status.stage, age_s, triggers=status.all_words, note=note)

    def _told_seldom(self, now_s: float) -> str | None:
        """Return what safety rests on and comes too seldom, in words; None if nothing does that no trigger tells."""
        return seldom_in_words(self.adapter.shortfalls(now_s), self.failsafe.status.all_words)

    def _disengage(self) -> None:
        """End the engagement and forget its state: the safety pilot controls the vehicle."""
        self.adapter.release()
        self.engagement = None
        # The next engagement begins with what is configured, and measures anew.
        self.steering = reckoning(self.steering, self.config.limits, NOTHING)
        self.steering.guard.reset()

    def _assess(self, age_s: float | None, now_s: float) -> FailsafeStatus:
        """Update the failsafe by the age of the picture (None: there is none) and the state of the vehicle."""
        telemetry, engagement, kept = self.adapter.telemetry, self.engagement, self.navigation.hand_over
        displaced = None if kept is None else jumped(kept.track)
        uncertified_from_s = None if engagement is None else engagement.uncertified_from_s
        inputs = FailsafeInputs(
            picture_age_s=age_s,
            missing=self.world_model.missing,
            position_accuracy_m=telemetry.position_accuracy_m,
            too_seldom=self.adapter.too_seldom(self.config.telemetry_timeout_s, now_s),
            battery_percent=telemetry.battery_percent,
            out_of_range=self.navigation.out_of_range,
            # Where a position that jumped and stayed there is, nobody knows: on neither side of a fence.
            outside_fence=engagement is not None and displaced is None and self._outside_fence(),
            moved=None if kept is None else moved(kept.references, telemetry, self.adapter.steers_in_local_frame),
            misplaced=displaced or misplaced(telemetry, self.config, now_s),
            doubted=None if kept is None else doubted(kept.track),
            uncertified_s=0.0 if uncertified_from_s is None else now_s - uncertified_from_s,
            abilities_changed=engagement is not None and engagement.abilities_changed,
            answer=Obedience().answer if engagement is None else engagement.obedience.answer,
            clock_offset_s=self.failsafe.clock_offset_s,
        )
        return self.failsafe.update(inputs, now_s)

    def _steer(self, age_s: float | None, now_s: float) -> Decision:
        """Pass the stages from the vehicle's position to the setpoint, and keep what the next tick needs."""
        telemetry, config, world_model = self.telemetry, self.steering.config, self.world_model
        jumps = 0 if self.navigation.hand_over is None else self.navigation.hand_over.track.jumps
        before = self.engagement or Engagement(climbs=is_below(telemetry, config))
        plane = plane_of(world_model.origin_deg, self.navigation.plane, telemetry)
        if plane is not self.navigation.plane or jumps != before.jumps:
            # Loiter place, last position and certified path are coordinates on another plane, or from before a jump.
            before = before._replace(loiter_place_ned_m=None, loiter_about_ned_m=None, target_ned_m=None, last_fix=None)
            before = before._replace(jumps=jumps)
            self.steering.guard.reset()
        self.navigation, located = navigate(self.navigation, plane, before.last_fix, telemetry, config, now_s)
        motion = located.motion
        self.engagement = before = self._watched(before, located, now_s)
        if self.authority.locked:
            return self._idle(self._not_steerable(now_s) or "", age_s, now_s)
        config = self.steering.config
        neighbours = self.adapter.neighbours if config.detector == "adsb" else ()
        seen = detected(neighbours, plane, motion, telemetry.altitude_m, config, now_s)
        view = world_model.view(now_s, band_m(telemetry, config.height_m))
        view = world_model.with_traffic(view, seen.traffic, seen.elsewhere, config.limits.fastest_m_s)
        status = self._assess(age_s, now_s)
        situation = Situation(
            motion.position_ned_m,
            located.home.position_ned_m,
            view,
            status,
            world_model.directives,
            None if before.last_fix is None else before.last_fix.position_ned_m,
            below_words(telemetry, config) if before.climbs and is_below(telemetry, config) else None,
        )
        goal = choose_goal(situation, before, config, self.steering.loiter)
        moment = Moment(motion, view, self.flown_m, now_s, before.refused, before.obedience.answer.speed_share)
        steered = steer(self.steering, goal, moment, before)
        if situation.below is not None and not is_straight_up(steered.verdict):
            return self._idle(f"{situation.below}, and no room to climb here: climb {HAND_OVER_AGAIN}", age_s, now_s)
        self.engagement = self._engaged_after(before, located, goal, steered, now_s)
        duplicate = f"another vehicle uses agent id {config.agent_id}" if seen.duplicate_agent_id else None
        notes = (steered.note, duplicate, steered.unseparated, *self._notes(located, now_s))
        return Decision(
            t_s=now_s,
            purpose=steered.purpose,
            reason=steered.reason,
            stage=status.stage,
            picture_age_s=age_s,
            triggers=status.all_words,
            target_id=world_model.target_id if steered.purpose is Purpose.TARGET else None,
            wanted_heading_rad=steered.wanted_heading_rad,
            turn_limited=steered.turn_limited,
            setpoint=steered.verdict.setpoint,
            guard_changes=steered.verdict.changes,
            broken=steered.verdict.broken,
            gave_way=steered.gave_way,
            note="; ".join(note for note in notes if note is not None) or None,
            reckons=in_words(before.obedience),
            stay=steered.stay,
            opposed=steered.demand.opposed,
            certified_s=steered.verdict.certified_s,
        )

    def _notes(self, located: Located, now_s: float) -> tuple[str | None, ...]:
        """Return what is to be said beside the decision of a vehicle that is steered."""
        config, kept = self.steering.config, self.navigation.hand_over
        return (
            self.world_model.directives.ended,
            without_a_sense(config, self.world_model.others_told, self.adapter.sees_others),
            HOME_TOO_FAR if located.home.too_far else None,
            told_by_autopilot(self.adapter),
            self._told_seldom(now_s),
            beyond_limits(located.motion, self.telemetry, config),
            None if kept is None else counted_from(kept.references),
        )

    def _watched(self, before: Engagement, located: Located, now_s: float) -> Engagement:
        """Return the engagement after a look at how the vehicle obeys; reckon with what that shows, or let it go."""
        seen = seen_of(located, self.telemetry, before, now_s)
        obedience = watch(before.obedience, seen, self.steering.expected)
        if obedience.answer.rung is Rung.LEFT:
            self.authority.leave(obedience.answer.words)
        if obedience.worse != before.obedience.worse:
            self.steering = reckoning(self.steering, self.config.limits, obedience.worse)
        return before._replace(obedience=obedience)

    def _engaged_after(
        self, before: Engagement, located: Located, goal: Goal, steered: Steered, now_s: float
    ) -> Engagement:
        """Return the engagement as this tick leaves it to the next."""
        setpoint = steered.verdict.setpoint
        uncertified_from_s = None
        # The paper's laws are flown to see what they do, wherever that leads.
        if NO_BACKUP in steered.verdict.changes and self.config.law == "routed":
            uncertified_from_s = now_s if before.uncertified_from_s is None else before.uncertified_from_s
        return Engagement(
            arrived_ned_m=goal.arrived_ned_m,
            giving_way=goal.giving_way,
            at_home=goal.at_home,
            loiter_place_ned_m=steered.loiter_place_ned_m,
            loiter_about_ned_m=steered.loiter_about_ned_m,
            target_ned_m=goal.place_ned_m if goal.purpose is Purpose.TARGET else before.target_ned_m,
            refused=not REFUSALS.isdisjoint(steered.verdict.changes),
            uncertified_from_s=uncertified_from_s,
            abilities_changed=before.abilities_changed,
            climbs=goal.climbs,
            last_fix=located.fix,
            setpoint=None if setpoint is None else GridSetpoint(setpoint, located.convergence_rad),
            jumps=before.jumps,
            obedience=before.obedience,
        )


def adapter_of(config: Config) -> Adapter:
    """Return the adapter of the autopilot that a configuration names; if it names none, the simulator's point mass."""
    if config.autopilot is None:
        return ADAPTERS["kinematic"]()
    return ADAPTERS[config.autopilot.kind](config.autopilot.system_id)


def band_m(telemetry: Telemetry, height_m: float) -> tuple[float, float]:
    """Return least and greatest altitude above sea level on the way to a height above home, with BAND_MARGIN_M.

    NaN where the vehicle's altitude or height is not known.
    """
    to_go_m = height_m - telemetry.height_m
    return (
        telemetry.altitude_m + min(0.0, to_go_m) - BAND_MARGIN_M,
        telemetry.altitude_m + max(0.0, to_go_m) + BAND_MARGIN_M,
    )
