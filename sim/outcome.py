"""What became of each agent of a flight, and why: the `agents` of `result.json` (docs/outputs.md)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from companion.mission.model import AgentSpec
from companion.onboard.decision import Decision, Purpose
from companion.onboard.failsafe import OUT_OF_RANGE, UNCERTIFIED
from sim.agent_log import AgentLog
from sim.approaches import Nearest
from sim.flown import FlownMission
from sim.score import FIGURE_DECIMALS, AgentScore

Outcome = Literal["arrived", "loitering", "blocked", "out of time", "out of range", "lost"]
_GUARDED_SHARE = 0.2
"""Share of its decisions from which on it is told that the guard changed them."""
_CHANGES_TOLD = 2
"""Number of the guard's changes that are told, the most frequent first."""


@dataclass(frozen=True)
class AgentResult:
    """What became of one agent, and why."""

    score: AgentScore
    log: AgentLog
    outcome: Outcome
    reason: str

    @property
    def target_id(self) -> int | None:
        """Id of the target at which it arrived last, else that it last flew to."""
        return self.score.target_id if self.outcome == "arrived" else self.log.target_id or self.score.target_id

    @property
    def certificate_at_start(self) -> str:
        """The certificate of the first decision by which it was steered, in words."""
        return "none" if self.log.start is None else self.log.start.certificate_words

    def line(self) -> str:
        """Return outcome and reason as one line."""
        return f"agent {self.score.id}: {self.outcome}: {self.reason}"

    def to_dict(self) -> dict[str, Any]:
        """Return the agent's entry in `result.json`."""
        scored, log = self.score, self.log
        return {
            "id": scored.id,
            "outcome": self.outcome,
            "reason": self.reason,
            "target": self.target_id,
            "arrived_t_s": scored.arrived_t_s,
            "reached": [{"target": one.target_id, "t_s": one.t_s} for one in scored.reached],
            "certificate_at_start": self.certificate_at_start,
            "certificate_lost": None if log.loss is None else {**log.loss._asdict(), "t_s": _rounded(log.loss.t_s)},
            "broken": [
                {"assumption": name, "count": broken.times, "first_t_s": _rounded(broken.first_t_s)}
                for name, broken in log.broken.items()
            ],
            "least_clearance_detection": _approach(scored.nearest_detection, "threat"),
            "least_clearance_attack": _approach(scored.nearest_attack, "threat"),
            "least_separation": _approach(scored.nearest_agent, "agent"),
            "entries_detection": scored.threat_entries_detection,
            "entries_attack": scored.threat_entries_attack,
            "last_decision": None if log.last is None else _told(log.last, log.last_t_s),
        }


def agent_results(flown: FlownMission, logs: Mapping[int, AgentLog]) -> tuple[AgentResult, ...]:
    """Return what became of every agent, in file order; `logs` are those of their companions by id."""
    results = []
    for spec, scored in zip(flown.mission.agents, flown.score.per_agent, strict=True):
        log = logs.get(spec.id) or AgentLog()
        results.append(AgentResult(scored, log, *_outcome(flown, spec, scored, log)))
    return tuple(results)


def first_reason(flown: FlownMission, results: Sequence[AgentResult]) -> str:
    """Return the line that says why not every target was reached: of the first agent whose target is still open."""
    still_open = {target.id for target in flown.score.per_target if target.is_open}
    missing = [result for result in results if result.outcome != "arrived"]
    concerned = [result for result in missing if result.target_id in still_open] or missing
    if concerned:
        return concerned[0].line()
    ids = ", ".join(map(str, sorted(still_open)))
    return f"target {ids}: not reached: every agent arrived elsewhere"


def _outcome(flown: FlownMission, spec: AgentSpec, scored: AgentScore, log: AgentLog) -> tuple[Outcome, str]:
    last = log.last
    if scored.reached and not _was_sent_on(flown, log):
        ids = [str(one.target_id) for one in scored.reached]
        there = f"target {ids[0]}" if len(ids) == 1 else f"targets {', '.join(ids)}"
        return "arrived", f"within {flown.mission.arrival_radius_m:g} m of {there}"
    if scored.lost_t_s is not None:
        return "lost", f"at {scored.lost_t_s:g} s, as the mission says"
    if last is None:
        return "out of time", f"the flight ended before its first decision{_how_ended(flown)}"
    why = _words(last)
    if OUT_OF_RANGE in last.triggers:
        used = f"{scored.path_length_m:.0f} m flown of {spec.range_m:g} m"
        return "out of range", f"{why}; {used}{_cut_short(flown)}"
    if last.purpose is not Purpose.TARGET and _too_far(flown, spec, scored):
        return "out of range", f"{why}; no open target is within its range of {spec.range_m:g} m{_cut_short(flown)}"
    if last.stay is not None or UNCERTIFIED in last.triggers:
        return "blocked", f"{why}{_progress(flown, scored, log, '; ')}{_cut_short(flown)}"
    if last.purpose is Purpose.TARGET:
        return (
            "out of time",
            f"on the way{_progress(flown, scored, log, ' to ')}{_how_ended(flown)}; {why}{_guard(log)}",
        )
    doing = {Purpose.IDLE: "not steered: ", Purpose.RETURN: "returning: ", Purpose.LOITER: ""}[last.purpose]
    return "loitering", f"{doing}{why}{_cut_short(flown)}"


def _was_sent_on(flown: FlownMission, log: AgentLog) -> bool:
    """Return whether an agent that has arrived was sent to a target after that which was not reached (`queue`)."""
    still_open = {target.id for target in flown.score.per_target if target.is_open}
    return flown.mission.queue and log.target_id in still_open


def _words(decision: Decision) -> str:
    """Return what a decision says of its reason: the reason itself, remarks, and the failsafe's triggers."""
    told = (decision.reason, decision.note, decision.reckons, decision.gave_way, *decision.triggers)
    return "; ".join(dict.fromkeys(word for word in told if word)) or decision.purpose.value


def _progress(flown: FlownMission, scored: AgentScore, log: AgentLog, before: str) -> str:
    """Return, after a text `before`, how far it was from its target at the end, and how near it had been."""
    trajectory = flown.trajectory
    if log.target_id not in trajectory.target_ids or not _is_there(flown, log.target_id):
        return ""
    agent, target = trajectory.agent_ids.index(scored.id), trajectory.target_ids.index(log.target_id)
    apart_m = np.hypot(*(trajectory.agents_ned_m[:, agent] - trajectory.targets_ned_m[:, target]).T)
    nearest = int(np.nanargmin(apart_m))
    text = f"{before}target {log.target_id}, {apart_m[-1]:.0f} m away"
    if apart_m[-1] > apart_m[nearest] + flown.mission.arrival_radius_m:
        text += f" (the nearest was {apart_m[nearest]:.0f} m, at {trajectory.t_s[nearest]:g} s)"
    return text


def _is_there(flown: FlownMission, target_id: int) -> bool:
    """Return whether a target was there to the end."""
    return any(target.id == target_id and target.retired_t_s is None for target in flown.score.per_target)


def _cut_short(flown: FlownMission) -> str:
    return "" if flown.ended_early is None else f" when the flight was ended early: {flown.ended_early}"


def _how_ended(flown: FlownMission) -> str:
    if flown.ended_early is not None:
        return _cut_short(flown)
    if flown.score.targets_reached == flown.score.targets:
        return " when every target had been reached"
    return f" when the time was up, after {flown.score.flight_time_s:g} s"


def _guard(log: AgentLog) -> str:
    share = log.guarded / max(1, log.decisions)
    if share < _GUARDED_SHARE:
        return ""
    changes = ", ".join(change for change, _ in log.guard_changes.most_common(_CHANGES_TOLD))
    return f"; the guard changed {100.0 * share:.0f} % of its decisions: {changes}"


def _too_far(flown: FlownMission, spec: AgentSpec, scored: AgentScore) -> bool:
    """Return whether an agent that flies to no target could reach no open one on what is left of its range."""
    still_open = [index for index, target in enumerate(flown.score.per_target) if target.is_open]
    if not still_open:
        return False
    trajectory = flown.trajectory
    path_m = trajectory.agents_ned_m[:, trajectory.agent_ids.index(scored.id)]
    targets_m = trajectory.targets_ned_m[-1, still_open]
    need_m = scored.path_length_m + np.hypot(*(targets_m - path_m[-1]).T) - flown.mission.arrival_radius_m
    if flown.mission.range_policy == "return":
        need_m += np.hypot(*(targets_m - path_m[0]).T)
    return bool(need_m.min() > spec.range_m)


def _told(decision: Decision, t_s: float) -> dict[str, Any]:
    return {
        "t_s": _rounded(t_s),
        "purpose": decision.purpose.value,
        "reason": decision.reason,
        "note": decision.note,
        "reckons": decision.reckons,
        "stage": decision.stage.value,
        "triggers": list(decision.triggers),
        "certificate": decision.certificate_words,
        "guard_changes": [str(change) for change in decision.guard_changes],
        "broken": [str(assumption) for assumption in decision.broken],
    }


def _approach(nearest: Nearest | None, other: str) -> dict[str, float | int | None] | None:
    if nearest is None:
        return None
    return {"m": _rounded(nearest.distance_m), other: nearest.id, "t_s": _rounded(nearest.t_s)}


def _rounded(value: float) -> float | None:
    return round(value, FIGURE_DECIMALS) if math.isfinite(value) else None
