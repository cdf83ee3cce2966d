"""Why an agent does what it does: the decision of the centre's own copy of its companion, in words.

The copy is the very code that flies. It hears the frames that were broadcast, stands where the ground station believes
the agent to be, and decides once. What it cannot know is what only the vehicle knows: frames that the vehicle missed,
neighbours that it sees, its battery and its wind. Pure: the caller gives pictures and frames.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from companion.autopilot.aircraft import Neighbour
from companion.autopilot.point import PointAdapter
from companion.geo.local_frame import LocalFrame
from companion.guidance.settings import DEFAULT_LAW
from companion.mission.model import Mission
from companion.onboard.companion import Companion
from companion.onboard.config import config_for_agent
from companion.onboard.decision import Decision
from companion.onboard.flight_log import summary_line

Heard = tuple[float, bytes]
"""An unsigned frame and the time, in Unix seconds, at which it was broadcast."""

AS_OF = "as the centre's own copy of the companion reckons it, where the ground station believes the agent to be"


def why(
    mission: Mission, picture: Mapping[str, Any], agent_id: int, heard: Iterable[Heard], *, can_stop: bool
) -> dict[str, Any]:
    """Return the decision of the copy of an agent's companion as JSON values.

    Raises:
        KeyError: the picture or the mission has no such agent.

    """
    agents = {agent["id"]: agent for agent in picture["agents"]}
    agent, now_s = agents[agent_id], float(picture["t_s"])
    if agent_id not in {spec.id for spec in mission.agents}:
        raise KeyError(agent_id)
    config = config_for_agent(mission, agent_id, DEFAULT_LAW)
    spec = next(spec for spec in mission.agents if spec.id == agent_id)
    frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
    adapter = PointAdapter(can_stop, frame.to_global(*spec.position_ned_m), config.height_m)
    companion = Companion(config, adapter)
    for heard_s, datagram in heard:
        companion.hear(datagram, heard_s)
    altitude_m = mission.origin.alt_m + config.height_m
    adapter.tell(_seen(agent, frame, altitude_m, now_s), None, now_s)
    adapter.neighbours = [
        _seen(other, frame, altitude_m, now_s)
        for other in picture["agents"]
        if other is not agent and _apart_m(agent, other) <= mission.detector_range_m and mission.detector == "adsb"
    ]
    flown_m = max(0.0, spec.range_m - float(agent["range_left_m"]))
    companion.relocate(flown_m)
    decision, _ = companion.tick(now_s)
    return in_words(agent_id, decision, agent)


def in_words(agent_id: int, decision: Decision, agent: Mapping[str, Any]) -> dict[str, Any]:
    """Return a decision as JSON values, with the sentences that a page shows; `agent` is the picture's."""
    setpoint = decision.setpoint
    return {
        "agent": agent_id,
        "t_s": round(decision.t_s, 3),
        "purpose": decision.purpose.value,
        "reason": decision.reason,
        "target": decision.target_id,
        "stage": decision.stage.value,
        "triggers": list(decision.triggers),
        "picture_age_s": _rounded(decision.picture_age_s),
        "wanted_heading_deg": _degrees(decision.wanted_heading_rad),
        "heading_deg": None if setpoint is None else _degrees(setpoint.heading_rad),
        "speed_m_s": None if setpoint is None else round(setpoint.speed_m_s, 2),
        "turn_limited": decision.turn_limited,
        "guard_changes": [str(change) for change in decision.guard_changes],
        "gave_way": decision.gave_way,
        "stay": decision.stay,
        "broken": [str(one) for one in decision.broken],
        "note": decision.note,
        "certificate": decision.certificate_words,
        "summary": summary_line(decision),
        "sentences": _sentences(decision, agent),
        "as_of": AS_OF,
    }


def _sentences(decision: Decision, agent: Mapping[str, Any]) -> list[str]:
    """Return the decision in sentences, the most important first."""
    goal = f"target {decision.target_id}" if decision.target_id is not None else "no target"
    said = [f"It is to {decision.purpose.value}: {decision.reason} ({goal})."]
    wanted = _degrees(decision.wanted_heading_rad)
    if wanted is not None:
        said.append(f"The law wants heading {wanted:.0f} deg.")
    if decision.setpoint is not None:
        heading = _degrees(decision.setpoint.heading_rad)
        said.append(f"It steers heading {heading:.0f} deg at {decision.setpoint.speed_m_s:.1f} m/s.")
    if decision.turn_limited:
        said.append("The turn is as tight as the vehicle can: the heading is reached later.")
    if decision.guard_changes:
        said.append(f"The guard changed it: {', '.join(map(str, decision.guard_changes))}.")
    said += [
        f"{name}: {text}." for name, text in (("Right of way", decision.gave_way), ("Stays", decision.stay)) if text
    ]
    if decision.picture_age_s is None:
        said.append("It has heard no whole picture yet.")
    else:
        said.append(f"Its picture is {decision.stage.value}, {decision.picture_age_s:.1f} s old.")
    said += [f"{trigger}." for trigger in decision.triggers]
    said.append(f"Certified to enter no threat: {decision.certificate_words}.")
    if decision.broken:
        said.append(f"Assumptions that do not hold: {', '.join(map(str, decision.broken))}.")
    if decision.note:
        said.append(f"Note: {decision.note}.")
    if agent["state"] in ("lost", "out"):
        said.append(f"The ground station counts it as {agent['state']}.")
    return said


def _seen(agent: Mapping[str, Any], frame: LocalFrame, altitude_m: float, now_s: float) -> Neighbour:
    """Return an agent of a picture as a detector would see it."""
    north_m, east_m = float(agent["north_m"]), float(agent["east_m"])
    lat_deg, lon_deg, convergence_rad = frame.to_global_with_convergence(north_m, east_m)
    speed_m_s = float(agent["speed_m_s"])
    course_rad = math.radians(float(agent["heading_deg"] or 0.0)) + convergence_rad
    velocity = (speed_m_s * math.cos(course_rad), speed_m_s * math.sin(course_rad))
    return Neighbour(int(agent["id"]), lat_deg, lon_deg, *velocity, now_s, altitude_m)


def _apart_m(one: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    return math.dist((one["north_m"], one["east_m"]), (other["north_m"], other["east_m"]))


def _degrees(angle_rad: float) -> float | None:
    return None if math.isnan(angle_rad) else round(math.degrees(angle_rad) % 360.0, 1)


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 2)
