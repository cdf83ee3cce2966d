"""Scales a mission that was written for the paper's 60 m/s, on request, to the cruise speed of an autopilot's vehicle.

Every horizontal length and every speed is multiplied by the cruise speed divided by 60 m/s, so that all times stay the
same and the scene looks the same from the vehicle. Times, heights, ids and the link are not changed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from companion.autopilot.adapter import Abilities
from companion.autopilot.kinds import CRUISE_M_S, KINDS
from companion.autopilot.registry import ADAPTERS
from companion.errors import InputError
from companion.mission.model import Mission, Scale
from companion.onboard.lint.fleet import speeds_instead

PAPER_SPEED_M_S = 60.0
"""Speed of the paper's vehicle, for which missions are written."""
# Keys of a mission and its sections whose values are multiplied by the factor.
_MISSION_LENGTHS = ("arrival_radius_m", "separation_m", "detector_range_m")
_THREAT_LENGTHS = ("north_m", "east_m", "detection_radius_m", "attack_radius_m", "speed_bound_m_s")
_TARGET_LENGTHS = ("north_m", "east_m", "speed_bound_m_s")
_AGENT_LENGTHS = ("north_m", "east_m", "range_m", "speed_m_s")
_WIND_SPEEDS = ("speed_m_s", "gust_m_s")


def check_speeds(mission: Mission, kind: str, abilities: Abilities, source: str) -> None:
    """Check that vehicles of a kind can fly a resolved mission as it is written; `source` names it in errors.

    Raises:
        InputError: an agent is faster or slower than they fly, or the mission was scaled for another kind.

    """
    if mission.scale is not None and kind in CRUISE_M_S and mission.scale.autopilot != kind:
        raise _scaled_for_another(mission.scale, kind, source)
    for index, agent in enumerate(mission.agents):
        flown = speeds_instead(agent.speed_m_s, abilities)
        if flown is None:
            continue
        factor = f"{CRUISE_M_S[kind]:g}/{PAPER_SPEED_M_S:g}"
        raise InputError(
            f"{source}: agents[{index}].speed_m_s: {agent.speed_m_s:g} m/s with --autopilot {kind}, which flies "
            f"{flown}; allowed: a speed that it flies, or --scale, which multiplies every length and speed by {factor}"
        )


def scaled(mission: Mission, kind: str, source: str | None = None) -> Mission:
    """Return a resolved mission scaled to an autopilot kind's cruise speed, with the factor in `scale`.

    A mission that has a `scale` already is returned as it is. Agents keep their turn rate and their share of the cruise
    speed within the kind's limits. `source` names the mission in errors.

    Raises:
        InputError: the mission was scaled for another kind, or its numbers are not valid once they are scaled.

    """
    name = source or mission.name
    if kind not in CRUISE_M_S:
        return mission
    if mission.scale is not None:
        if mission.scale.autopilot != kind:
            raise _scaled_for_another(mission.scale, kind, name)
        return mission
    factor = CRUISE_M_S[kind] / PAPER_SPEED_M_S
    data = mission.model_dump()
    _multiply(data, _MISSION_LENGTHS, factor)
    _multiply(data["area_m"], ("north", "east"), factor)
    _multiply(data["wind"], _WIND_SPEEDS, factor)
    _multiply(data["weights"], tuple(data["weights"]), factor**2)
    if data["fence"] is not None:
        data["fence"] = _scaled_polygon(data["fence"], factor)
    data["exclusions"] = [_scaled_polygon(exclusion, factor) for exclusion in data["exclusions"]]
    for threat in data["threats"]:
        _multiply(threat, _THREAT_LENGTHS, factor)
        threat["motion"] = _scaled_motion(threat["motion"], factor)
    for target in data["targets"]:
        _multiply(target, _TARGET_LENGTHS, factor)
        target["motion"] = _scaled_motion(target["motion"], factor)
    abilities = ADAPTERS[kind]().abilities
    for agent in data["agents"]:
        _multiply(agent, (*_AGENT_LENGTHS, "n_max"), factor)
        _fit(agent, abilities)
        if KINDS[kind].can_stop:
            _fit_wind(agent, data["wind"]["speed_m_s"] + data["wind"]["gust_m_s"], abilities)
    data["scale"] = {"autopilot": kind, "factor": factor}
    return Mission.model_validate(data)


def _scaled_for_another(scale: Scale, kind: str, source: str) -> InputError:
    return InputError(
        f"{source}: scale.autopilot: '{scale.autopilot}' with --autopilot {kind}; allowed: the kind that it was scaled "
        "for, or the mission as it was before"
    )


def _fit(agent: dict[str, Any], abilities: Abilities) -> None:
    agent["n_max"] = min(agent["n_max"], abilities.n_max)
    agent["speed_m_s"] = min(max(agent["speed_m_s"], abilities.speed_min_m_s), abilities.speed_max_m_s)


def _fit_wind(agent: dict[str, Any], wind_m_s: float, abilities: Abilities) -> None:
    """Slow an agent to what its vehicle can fly over ground against the wind; in a stronger wind nothing would help."""
    left_m_s = abilities.airspeed_max_m_s - wind_m_s
    if left_m_s > wind_m_s:
        agent["speed_m_s"] = min(agent["speed_m_s"], left_m_s)


def _multiply(section: dict[str, Any], keys: tuple[str, ...], factor: float) -> None:
    for key in keys:
        section[key] = factor * section[key]


def _scaled_polygon(corners: Sequence[tuple[float, float]], factor: float) -> list[list[float]]:
    return [[factor * north_m, factor * east_m] for north_m, east_m in corners]


def _scaled_motion(motion: Any, factor: float) -> Any:  # noqa: ANN401 - a word, or a mapping of either form
    if not isinstance(motion, dict):
        return motion
    if "path" in motion:
        return {"path": [[t_s, factor * north_m, factor * east_m] for t_s, north_m, east_m in motion["path"]]}
    return {**motion, "speed_m_s": factor * motion["speed_m_s"]}
