"""Reasons not to steer the vehicle now: the autopilot is not heard, or the vehicle not handed over, fit or ready."""

from __future__ import annotations

import math

from companion.autopilot.adapter import Adapter
from companion.autopilot.estimate import fresh
from companion.autopilot.linked import COURSE_SPEED_M_S
from companion.autopilot.telemetry import HEARTBEAT_TIMEOUT_S, Telemetry
from companion.guard.types import Motion, Verdict
from companion.onboard.authority import FAILSAFE, FAILSAFE_STATES, Authority, State
from companion.onboard.config import Config
from companion.onboard.failsafe import SEVERITY, Cause, FailsafeStatus, Stage

PICTURE_CAUSES = (Cause.BROADCAST, Cause.PICTURE)
"""Causes of triggers that say that the picture is not good enough to begin an engagement with."""
NOT_READY_CAUSES = (*PICTURE_CAUSES, Cause.TELEMETRY, Cause.ESTIMATE)
"""Causes of triggers that say that picture, telemetry or the vehicle's place are not good enough to begin with."""
NO_FIX = "no GPS fix"
NOT_HANDED_OVER = "not armed and in the guided mode"
HAND_OVER_AGAIN = "in another mode, then hand over again"
SPEED_SLACK = 1.2
"""How many times its speed limit and the wind together a vehicle may fly before it is said: it sways in turns."""


def not_steerable(adapter: Adapter, authority: Authority, config: Config, now_s: float) -> str | None:
    """Return why the vehicle must not be steered, whether or not it was steered so far; None if it may be."""
    reason = unheard(adapter, now_s)
    if reason is not None:
        return reason
    if authority.locked:
        if not adapter.resumes_on_stream:
            return f"{authority.reason}; nothing is sent until it is handed over anew"
        signal_clears = config.autopilot is not None and config.autopilot.clear == "signal"
        cleared = "disarmed or cleared by a signal" if signal_clears else "disarmed"
        return f"{authority.reason}; nothing is sent until it is {cleared}"
    if not adapter.steerable:
        return NOT_HANDED_OVER
    return unfit(adapter, config, now_s)


def not_reachable(adapter: Adapter, config: Config, now_s: float) -> str | None:
    """Return why no setpoint, not even to hold, may go to the autopilot, whoever controls it; None if one may."""
    return unheard(adapter, now_s) or unfit(adapter, config, now_s)


def unheard(adapter: Adapter, now_s: float) -> str | None:
    """Return why the autopilot is not heard, or is one that cannot be steered at all; None if it is heard and right."""
    if adapter.refusal is not None:
        return adapter.refusal
    telemetry = adapter.telemetry
    if telemetry.system_id is None:
        return "no autopilot heard"
    if telemetry.heartbeat_at_s is None or now_s - telemetry.heartbeat_at_s > HEARTBEAT_TIMEOUT_S:
        # Arming and mode may have changed since.
        return "autopilot's heartbeat lost"
    return None


def unfit(adapter: Adapter, config: Config, now_s: float) -> str | None:
    """Return why the vehicle's state does not allow steering, even if it was handed over; None if it does."""
    telemetry = adapter.telemetry
    # ArduPilot says so for mere warnings, too, and obeys as long as its mode stays: there the mode alone decides.
    if adapter.resumes_on_stream and telemetry.system_status in FAILSAFE_STATES:
        return FAILSAFE
    if telemetry.position_at_s is None:
        return "no position yet"
    if now_s - telemetry.position_at_s > config.telemetry_timeout_s:
        return "position too old"
    estimate = fresh(telemetry.estimate, now_s)
    if estimate is not None and not estimate.absolute:
        return "the autopilot's estimate has no position"
    if estimate is None and not _has_fix(telemetry, config):
        return NO_FIX
    if adapter.missing_telemetry is not None:
        return adapter.missing_telemetry
    # A setpoint would end a take-off under way, which the safety pilot or the autopilot must finish.
    if telemetry.in_air is False:
        return "not in the air yet, or landing"
    return None


def misplaced(telemetry: Telemetry, config: Config, now_s: float) -> str | None:
    """Return why the autopilot's own estimate is not to be flown by to a target; None if nothing speaks against it.

    With two receivers the autopilot flies on when one dies; without any its estimate holds for some seconds.
    """
    estimate = fresh(telemetry.estimate, now_s)
    if estimate is None:
        return None
    if not _has_fix(telemetry, config):
        return f"{NO_FIX}: only the autopilot's estimate holds"
    return estimate.doubt


def _has_fix(telemetry: Telemetry, config: Config) -> bool:
    return telemetry.gps_fix is None or telemetry.gps_fix >= config.health.gps_fix_min


def not_ready(
    adapter: Adapter,
    telemetry: Telemetry,
    unable: str | None,
    status: FailsafeStatus,
    outside_fence: bool,
    config: Config,
) -> str | None:
    """Return why an engagement must not begin yet; None if it may. During an engagement these reasons do not count.

    Args:
        adapter: Adapter of the autopilot.
        telemetry: The telemetry as it is believed; it has a position.
        unable: Why the vehicle's abilities are not enough to be steered, if they are not.
        status: The failsafe's stage and triggers.
        outside_fence: Whether the vehicle is outside the fence.
        config: The configuration, with limits that the vehicle can keep.

    """
    if not adapter.parameters_known:
        return "reading the autopilot's parameters"
    if unable is not None:
        return unable
    for trigger in status.triggers:
        if trigger.cause in NOT_READY_CAUSES and SEVERITY[trigger.stage] >= SEVERITY[Stage.LOITERING]:
            return trigger.words
    if outside_fence:
        return f"outside the fence: fly inside {HAND_OVER_AGAIN}"
    if is_below(telemetry, config) and not may_climb(adapter, config):
        return f"{below_words(telemetry, config)}: climb {HAND_OVER_AGAIN}"
    return None


def is_below(telemetry: Telemetry, config: Config) -> bool:
    """Return whether the vehicle is below the height where steering begins."""
    return telemetry.height_m < config.limits.height_min_m


def below_words(telemetry: Telemetry, config: Config) -> str:
    """Return in words how far the vehicle is below the height where steering begins."""
    return f"below limits.height_min_m {config.limits.height_min_m:g} m at {telemetry.height_m:.1f} m"


def may_climb(adapter: Adapter, config: Config) -> bool:
    """Return whether the companion itself may climb to the height where steering begins, straight up.

    That is what `autopilot.below_height: climb` asks of a vehicle that can stop, once it stands.
    """
    telemetry, section = adapter.telemetry, config.autopilot
    if section is None or section.below_height != "climb" or not adapter.can_stop:
        return False
    return math.hypot(telemetry.velocity_north_m_s, telemetry.velocity_east_m_s) < COURSE_SPEED_M_S


def is_straight_up(verdict: Verdict) -> bool:
    """Return whether a setpoint leaves a vehicle that climbs where it is: nothing else moves it at that height."""
    setpoint = verdict.setpoint
    return not verdict.changes and setpoint is not None and setpoint.speed_m_s < COURSE_SPEED_M_S


def told_by_autopilot(adapter: Adapter) -> str | None:
    """Return what the autopilot says of its own state that calls for the person's attention; None if nothing."""
    state = FAILSAFE_STATES.get(adapter.telemetry.system_status or 0)
    return None if state is None else f"the autopilot says {state}"


def beyond_limits(motion: Motion, telemetry: Telemetry, config: Config) -> str | None:
    """Return by which limits of height and speed the vehicle was given back outside, and what it does; None if none."""
    limits, said = config.limits, []
    if telemetry.height_m > limits.height_max_m:
        said.append(
            f"above limits.height_max_m {limits.height_max_m:g} m at {telemetry.height_m:.1f} m: descends to "
            f"{config.height_m:g} m"
        )
    fastest_m_s = limits.speed_m_s + limits.wind_m_s
    if motion.speed_m_s > SPEED_SLACK * fastest_m_s:
        said.append(f"faster than limits.speed_m_s {limits.speed_m_s:.3g} m/s at {motion.speed_m_s:.3g}: slows down")
    return ", ".join(said) or None


def may_hold(adapter: Adapter, authority: Authority, config: Config, stream_ended: bool, now_s: float) -> bool:
    """Return whether to stream setpoints that hold the vehicle, as a PX4 needs before it can be put into OFFBOARD."""
    if not adapter.resumes_on_stream or authority.locked or not adapter.telemetry.in_air:
        # On the ground, or before the vehicle is known to be in the air, nothing is streamed.
        return False
    # An engagement whose stream has ended is over; the next tick locks it.
    over = authority.state is State.ENGAGED and stream_ended
    return not over and not_reachable(adapter, config, now_s) is None
