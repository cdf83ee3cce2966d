"""The rules of `companion check`: whether a vehicle is fit to be steered, and safe if the companion dies in flight.

The rules are pure functions of what was heard; each finding says what is wrong and what to do about it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from companion.autopilot.adapter import Abilities
from companion.autopilot.estimate import Estimate, fresh
from companion.autopilot.firmware import known
from companion.autopilot.linked import LinkedAdapter
from companion.autopilot.parameter_checks import ParameterCheck
from companion.autopilot.parameters import Told
from companion.autopilot.telemetry import HEARTBEAT_TIMEOUT_S
from companion.onboard.causes import CLOCKS, Cause
from companion.onboard.config import Config, LimitsSection
from companion.onboard.endings import endings
from companion.onboard.finding import Finding, warning
from companion.onboard.limits import beyond_airspeed
from companion.onboard.senses import sense_of_others
from companion.onboard.world_model import WorldModel

SLOWED_REMEDY = (
    "let no other program set the rates of this link (MAVProxy: set streamrate -1; a ground station's stream rates), "
    "and give the link a higher baud rate"
)
"""What to do about messages that come more seldom than they were asked for."""
RATES_S = 5.0
"""The rates of the messages for which that takes no longer are measured before the findings."""
ONE_SPEED_SLACK = 0.1
"""How far the configured speed may be, as a share, from the only speed of a vehicle that cannot change it."""


def findings(
    config: Config, adapter: LinkedAdapter, *, link_heard: bool, broadcast_heard: bool, now_s: float
) -> list[Finding]:
    """Return the findings about a vehicle, the most fundamental first.

    `link_heard`: whether anything at all came over the autopilot link. `broadcast_heard`: whether a frame of the
    broadcast was accepted. Checks of the autopilot are left out if it is not heard or is not the right one.
    """
    found = list(_identity(config, adapter, link_heard, now_s))
    if all(finding.passed for finding in found):
        found += [*_demands(config, adapter), *endings(config, adapter.kind, adapter.parameters.values)]
        found += [*_abilities(config, adapter), *_health(config, adapter, now_s)]
        found += _streams(adapter, now_s)
        found += [Finding(False, trouble, "see the autopilot's own messages") for trouble in adapter.failures]
    found.append(
        Finding(True, "broadcast heard")
        if broadcast_heard
        else Finding(False, "no genuine broadcast heard", "check broadcast.link, its keys, and this computer's clock")
    )
    return found


def finding_on_others(config: Config, adapter: LinkedAdapter, told: tuple[int, int]) -> Finding:
    """Return which sense of the others the vehicle has; see `senses.sense_of_others` for `told`."""
    sense = sense_of_others(config, told, adapter.sees_others, adapter.asks_for_others)
    remedy = "set ADSB_TYPE and reboot, fly in Case I, which tells the places, or set separation by height or time"
    return Finding(sense.exists or config.detector == "none", sense.words, remedy)


def finding_on_agent(config: Config, world_model: WorldModel, whole: bool) -> Finding | None:
    """Return whether the broadcast has this vehicle's agent, and its target; None before any agent was heard.

    `whole`: whether every frame of a broadcast was heard, so that it has no other agents.
    """
    own, ids = config.agent_id, world_model.agent_ids
    if own in ids:
        place, target_id = world_model.target_ned_m, world_model.target_id
        if target_id is None:
            return warning(f"agent {own} is in the broadcast, without a target", "see the ground station's assignment")
        where = "" if place is None else f", {place[0]:.0f} m north and {place[1]:.0f} m east of the origin"
        return Finding(True, f"agent {own} is in the broadcast: target {target_id}{where}")
    if not whole:
        return None
    has = f"it has {', '.join(map(str, ids))}" if ids else "it has none"
    return Finding(False, f"agent {own} is not in the broadcast: {has}", "correct agent_id, or the mission")


def finding_on_cause(cause: Cause) -> Finding:
    """Return the finding on a cause for which the broadcast is not believed, or less than it should be."""
    if cause.stops or cause.name == CLOCKS:
        return Finding(False, f"broadcast: {cause.words}", cause.remedy)
    return warning(f"broadcast: {cause.words}", cause.remedy)


def _identity(config: Config, adapter: LinkedAdapter, link_heard: bool, now_s: float) -> Iterator[Finding]:
    telemetry = adapter.telemetry
    link = config.autopilot.link if config.autopilot else "none"
    if adapter.refusal is not None:
        refusal, _, remedy = adapter.refusal.rpartition(": ")
        yield Finding(False, refusal, remedy)
    elif telemetry.heartbeat_at_s is None:
        heard = "messages, but no autopilot's heartbeat" if link_heard else "nothing"
        yield Finding(False, f"{heard} heard on autopilot.link {link}", "check the link, its rate and the cable")
    elif now_s - telemetry.heartbeat_at_s > HEARTBEAT_TIMEOUT_S:
        age_s = now_s - telemetry.heartbeat_at_s
        yield Finding(False, f"last heartbeat {age_s:.0f} s ago", "check the link and that the autopilot runs")
    else:
        unusual = "" if adapter.unusual is None else f"; {adapter.unusual}"
        yield Finding(True, f"{adapter.kind}, system {telemetry.system_id}, heard on {link}{unusual}")
        silence = adapter.silence(now_s)
        if silence is not None:
            words, _, remedy = silence.partition(": ")
            yield Finding(False, words, remedy)
        if adapter.beside is not None:
            yield warning(
                f"other autopilots on the same link: {adapter.beside}",
                "keep them off it: what a router or a shared radio mixes up, they obey",
            )


def _demands(config: Config, adapter: LinkedAdapter) -> Iterator[Finding]:
    parameters = adapter.parameters
    told = parameters.values
    for demand in adapter.parameter_checks:
        if demand.when_fenced and config.limits.fence is None and not config.limits.exclusions:
            continue
        if demand.name in told:
            named = parameters.told_as(demand.name)
            words = f"{named.name}: {named.value:g}; allowed: {demand.words(named)}; {demand.why}"
            met = demand.met_by(told[demand.name])
            sets = ((named.name, named.value if met else demand.best_for(named)),)
            yield Finding(met, words, demand.remedy(named), sets=sets)
        elif not demand.when_told:
            yield _not_told(demand, adapter)


def _not_told(demand: ParameterCheck, adapter: LinkedAdapter) -> Finding:
    """Return that a parameter was not told, with the remedy in the words of the firmware heard, or of each."""
    names = adapter.parameters.names_of(demand.name)
    if adapter.firmware is not None:
        has = [one for one in names if _has(adapter, one)]
        names = tuple(has) or names
    nor = "".join(f", nor {other.name}" for other in names[1:])
    ways = " or ".join(_way(demand, one, adapter) if len(names) > 1 else demand.remedy(one) for one in names)
    words = f"{names[0].name}: not told{nor}; {demand.why}"
    sets = ((names[0].name, demand.best_for(names[0])),) if len(names) == 1 else ()
    return Finding(False, words, f"{ways}, or check the link", sets=sets)


def _has(adapter: LinkedAdapter, named: Told) -> bool:
    """Return whether the firmware heard has a parameter of this name."""
    row = known(adapter.kind, named.name)
    return row is not None and adapter.firmware is not None and row.is_in(adapter.firmware)


def _way(demand: ParameterCheck, named: Told, adapter: LinkedAdapter) -> str:
    """Return a remedy by one of a parameter's names, with the versions that call it so."""
    row = known(adapter.kind, named.name)
    return demand.remedy(named) + (f" ({row.span})" if row is not None and row.span else "")


def _abilities(config: Config, adapter: LinkedAdapter) -> Iterator[Finding]:
    abilities, limits = adapter.abilities, config.limits
    for words in abilities.insane:
        yield Finding(False, words, "correct it on the autopilot")
    if abilities.assumed:
        names = ", ".join(abilities.assumed)
        yield Finding(False, f"not told, so assumed: {names}", "check the link; these are the autopilot's defaults")
    low_m_s, high_m_s = abilities.speed_min_m_s, abilities.speed_max_m_s
    # Rounded inwards, so that the advised speed is one that the vehicle can fly, unless nothing is left between.
    has_one = math.isfinite(high_m_s) and math.ceil(low_m_s * 1000.0) > math.floor(high_m_s * 1000.0)
    has_one = has_one or low_m_s == high_m_s
    span = f"{_rounded(low_m_s, math.ceil)} to {_rounded(high_m_s, math.floor)}"
    span, way = (_rounded(low_m_s, round), "to") if has_one else (span, "within")
    # A vehicle that flies at one speed alone does so whatever is configured: near it is good enough.
    slack_m_s = ONE_SPEED_SLACK * low_m_s if has_one else 0.0
    yield Finding(
        low_m_s - slack_m_s <= limits.speed_m_s <= high_m_s + slack_m_s,
        f"limits.speed_m_s: {limits.speed_m_s:g}; this vehicle flies {span} m/s",
        f"set limits.speed_m_s {way} {span}",
    )
    yield _at_most("limits.n_max", limits.n_max, abilities.n_max, "turns at most with")
    if adapter.can_stop:
        yield _at_most("limits.braking_m_s2", limits.braking_m_s2, abilities.braking_m_s2, "brakes at most with")
    yield Finding(
        limits.wind_m_s < min(limits.speed_m_s, high_m_s),
        f"limits.wind_m_s: {limits.wind_m_s:g}, below the speed it must fly in",
        "lower limits.wind_m_s, or fly on another day",
    )
    if adapter.can_stop:
        yield from _airspeed(limits, abilities)


def _airspeed(limits: LimitsSection, abilities: Abilities) -> Iterator[Finding]:
    """Yield whether a vehicle that is steered over the ground can fly its speed against its wind."""
    shortage = beyond_airspeed(limits, abilities)
    if shortage is not None:
        yield Finding(False, shortage.words, shortage.remedy)
    elif limits.airspeed_max_m_s is not None or math.isfinite(abilities.airspeed_max_m_s):
        yield Finding(True, f"limits.speed_m_s + wind_m_s: {limits.speed_m_s + limits.wind_m_s:g} m/s through the air")
    elif abilities.airspeed_by and limits.wind_m_s > 0.0:
        needed_m_s = limits.speed_m_s + limits.wind_m_s
        yield Finding(
            True,
            f"limits.speed_m_s + wind_m_s: {needed_m_s:g} m/s through the air; whether this vehicle reaches it is "
            f"{abilities.airspeed_by}: measure it and set limits.airspeed_max_m_s",
        )


def _streams(adapter: LinkedAdapter, now_s: float) -> Iterator[Finding]:
    """Yield which of what safety rests on comes too seldom, or that nothing does as far as it was measured."""
    shortfalls = adapter.shortfalls(now_s)
    for short in shortfalls:
        yield Finding(False, f"{short}; {short.rests_on} rests on it", SLOWED_REMEDY)
    if not shortfalls and adapter.rates_hz and adapter.streams_measured(now_s, RATES_S):
        yield Finding(True, "the messages that safety rests on come as often as they were asked for")


def _at_most(key: str, configured: float, able: float, words: str) -> Finding:
    most = _rounded(able, math.floor)
    return Finding(configured <= able, f"{key}: {configured:g}; this vehicle {words} {most}", f"set {key} to {most}")


def _rounded(value: float, to: Callable[[float], int]) -> str:
    return f"{to(value * 1000.0) / 1000.0:g}" if math.isfinite(value) else "any"


def _estimate(estimate: Estimate) -> Finding:
    """Return what the autopilot says of its own estimate, by which it flies."""
    if not estimate.absolute:
        return Finding(False, "the autopilot's estimate has no position", "wait for a fix, and for its estimator")
    return Finding(estimate.doubt is None, estimate.doubt or "the autopilot's estimate has a position", "wait")


def _health(config: Config, adapter: LinkedAdapter, now_s: float) -> Iterator[Finding]:
    telemetry = adapter.telemetry
    timeout_s = config.telemetry_timeout_s
    if telemetry.position_at_s is None or now_s - telemetry.position_at_s > timeout_s:
        yield Finding(False, f"no position within {timeout_s:g} s", "wait for a fix; check the rates of the link")
    else:
        yield Finding(True, f"position {telemetry.lat_deg:.5f} {telemetry.lon_deg:.5f}")
    known = telemetry.gps_fix is not None and telemetry.gps_fix >= config.health.gps_fix_min
    text = "not told" if telemetry.gps_fix is None else f"fix type {telemetry.gps_fix}"
    yield Finding(known, f"GPS: {text}; allowed: at least {config.health.gps_fix_min}", "wait for a fix under open sky")
    estimate = fresh(telemetry.estimate, now_s)
    if estimate is not None:
        yield _estimate(estimate)
    accuracy_m = telemetry.position_accuracy_m
    if math.isfinite(accuracy_m):
        allowed_m = config.health.position_accuracy_m
        words = f"position good to {accuracy_m:.1f} m; allowed: {allowed_m:g}"
        yield Finding(accuracy_m <= allowed_m, words, "wait, or set health.position_accuracy_m to what is acceptable")
    home = telemetry.home_deg is not None
    yield Finding(home, f"home {'known' if home else 'not told'}", "wait for a fix, or arm once: home is set then")
    battery = telemetry.battery_percent
    least = config.health.battery_return_percent
    text = "not told" if battery is None else f"{battery:.0f} %"
    remedy = "set up the autopilot's battery monitor" if battery is None else "charge it"
    if least == 0.0:
        found = f"battery: {text}; it never returns for it (health.battery_return_percent 0)"
        yield warning(found, remedy) if battery is None else Finding(True, found)
    else:
        yield Finding(battery is not None and battery > least, f"battery: {text}; returns at {least:g} %", remedy)
