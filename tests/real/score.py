"""The figures of a flight of real programs, from its simulators' truth and its companions' logs alone."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.files.tlog import read_tlog
from companion.mission.model import Mission, load_mission
from companion.onboard.decision import Purpose
from companion.protocol.frame import RawFrame, raw_frame
from sim.score import Score, score
from sim.trajectory import Trajectory, read_csv
from tests.real.kinds import KINDS

STANDING_M_S = 0.3
"""Speed over ground below which a vehicle stands."""
STANDS_FOR_S = 2.0
"""Time for which it must be that slow to count as standing."""
HELD_S = 15.0
"""Time at the end of a flight over which it is measured how well a place is held."""
HELD_SHARE = 95.0
SETTLED_S = 1.0
"""Time after the hand-over from which gaps between setpoints count."""
TRUTH_SPAN_S = 5.0
TRUTH_HZ = {"ArduPilot": 20.0, "PX4": 25.0}
"""Rate at which each firmware's simulator tells the truth, when it runs at its own speed."""
_DOES = re.compile(rf" companion: ({'|'.join(purpose.value for purpose in Purpose)})\b")
"""A line of a companion that says what it does."""
_CUSTOM_MODE = struct.Struct("<I")
"""The first field of HEARTBEAT's payload."""
_AUTOPILOT_AT = 5
"""Where HEARTBEAT's payload has its MAV_AUTOPILOT."""
SETPOINTS = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
        mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
        mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
    }
)


@dataclass(frozen=True)
class AgentFigures:
    """One agent's figures; times count from the hand-over, or from its arrival where the name says after."""

    id: int
    arrived_s: float | None
    path_m: float
    """Length of its path from the hand-over to its arrival, or to the end."""
    farthest_after_arrival_m: float | None
    """Greatest distance from its target once it had arrived."""
    farthest_at_the_end_m: float | None
    """Greatest distance from its target in the last HELD_S seconds: of a plane, its circle's far side."""
    stands_after_s: float | None
    held_within_m: float | None
    """Radius about its mean place in the last seconds that holds 95 % of them; None before it stood."""
    off_target_m: float | None
    """Distance of that mean place from its target."""
    gap_s: float | None
    """Longest time between two of its setpoints, until the scenario's first event."""
    height_m: tuple[float, float]
    """Least and greatest true height above where home was at the start."""
    height_off_m: float | None
    """Greatest difference of its true height from that at the scenario's first event; None without one."""
    delivered_gap_s: float | None
    """Longest time in which no setpoint reached the autopilot, until its arrival or a person's mode; None without a
    wire."""


@dataclass(frozen=True)
class EventFigures:
    """What followed an event, until the next one or the end."""

    what: str
    last_setpoint_s: float | None
    """Time from the event to the last setpoint; None if there was none."""
    last_after_told_s: float | None
    """Time from the HEARTBEAT that told the companion of another mode to the last setpoint; 0: none came after it."""
    delivered_after_told_s: float | None
    """The same where a wire is between them, by when it carried both: however late the companion took it in."""
    first_setpoint_s: float | None
    gap_s: float | None
    """Longest time between two setpoints."""
    height_m: tuple[float, float]
    """Least and greatest true height above where home was at the start."""
    stands_after_s: float | None
    """Time from the event to standing."""
    flown_m: float
    """Length of the path until it stood, or until the end."""
    mode: int
    """Its mode at the end."""
    said: str
    """What the companion said last of what it does."""


@dataclass(frozen=True)
class Figures:
    """All figures of a flight."""

    scenario: str
    kind: str
    entries: int
    deepest_m: float
    breaches: int
    least_separation_m: float | None
    open_targets: int
    agents: tuple[AgentFigures, ...]
    events: tuple[EventFigures, ...]
    load: float
    """Greatest load average of the computer while it was flown."""
    pause_s: float
    """Longest time for which this lane itself, which asks for 0.02 s, was not run: what the computer was late by."""
    truth_share: float
    """Least share of its simulator's samples that came within TRUTH_SPAN_S of agent 1's flight."""
    said: str
    """What agent 1's companion said last of what it does."""

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as JSON has them."""
        return asdict(self)


def figures_of(folder: Path) -> Figures:
    """Return the figures of the flight that was written into a folder."""
    record = json.loads((folder / "flight.json").read_text(encoding="utf-8"))
    mission, trajectory = load_mission(folder / "mission.yaml"), read_csv(folder / "trajectory.csv")
    scored = score(trajectory, mission)
    begin_s = record["begin_unix_s"]
    notes = [(t_s - begin_s, what) for t_s, what in record["notes"]]
    (hand_over_s,) = [t_s for t_s, what in notes if what == "handed over"]
    events = [(t_s, what) for t_s, what in notes if t_s > hand_over_s]
    setpoints = {agent.id: setpoint_times_s(folder / f"logs-{agent.id}") - begin_s for agent in mission.agents}
    span_s = (hand_over_s + SETTLED_S, events[0][0])
    heights = {agent.id: np.array(record["heights_m"][str(agent.id)]) - (begin_s, 0.0) for agent in mission.agents}
    taken_s = min((t_s for t_s, what in events if what.startswith("mode ")), default=events[-1][0])
    agents = []
    for index, agent in enumerate(mission.agents):
        flown = _flown(trajectory, mission, scored, (index, hand_over_s))
        arrived_s = hand_over_s + (flown["arrived_s"] or np.inf)
        delivered_s = _carried(record, "delivered_s", agent.id)
        agents.append(
            AgentFigures(
                gap_s=longest_gap_s(setpoints[agent.id], span_s),
                height_m=_extremes(heights[agent.id], (0.0, np.inf)),
                height_off_m=_height_off_m(heights[agent.id], events[0][0]) if len(events) > 1 else None,
                delivered_gap_s=longest_silence_s(delivered_s, (span_s[0], min(arrived_s, taken_s))),
                **flown,
            )
        )
    heard = _Heard(
        setpoints[1],
        mode_changes_s(folder / "logs-1") - begin_s,
        heights[mission.agents[0].id],
        _said_lines(folder / "companion-1.log", begin_s),
        (_carried(record, "delivered_s", 1), _carried(record, "told_s", 1)),
    )
    modes = [(t_s - begin_s, mode) for t_s, mode in record["modes"]["1"]]
    return Figures(
        scenario=record["scenario"],
        kind=record["kind"],
        entries=scored.threat_entries_detection,
        deepest_m=round(scored.worst_depth_m, 2),
        breaches=scored.separation_breaches,
        least_separation_m=None if scored.min_separation_m is None else round(scored.min_separation_m, 1),
        open_targets=scored.targets - scored.targets_reached,
        agents=tuple(agents),
        events=tuple(
            _followed(trajectory, heard, modes, (event, until[0]))
            for event, until in zip(events[:-1], events[1:], strict=True)
        ),
        load=record["load"],
        pause_s=record["pause_s"],
        truth_share=_truth_share(heard.heights[:, 0], KINDS[record["kind"]].firmware),
        said=heard.said_at(np.inf),
    )


def _frames(logs: Path) -> Iterator[tuple[float, RawFrame]]:
    """Yield the frames of a companion's flight logs with their Unix times, of all its starts in order."""
    for log in sorted(logs.glob("*/vehicle-*.tlog")):
        for t_s, data in read_tlog(log):
            yield t_s, raw_frame(data)


def setpoint_times_s(logs: Path) -> np.ndarray:  # (S,)
    """Return the Unix times of the setpoints in a companion's flight logs, of all its starts in order."""
    sent = (
        t_s for t_s, frame in _frames(logs) if frame.component == COMPANION_COMPONENT and frame.message_id in SETPOINTS
    )
    return np.array(list(sent))


def mode_changes_s(logs: Path) -> np.ndarray:  # (S,)
    """Return the Unix times at which a companion was told by HEARTBEAT of another mode than before."""
    times_s, last = [], None
    for t_s, frame in _frames(logs):
        if frame.component != mavlink.MAV_COMP_ID_AUTOPILOT1 or frame.message_id != mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            continue
        if frame.payload[_AUTOPILOT_AT] == mavlink.MAV_AUTOPILOT_INVALID:
            continue
        (mode,) = _CUSTOM_MODE.unpack_from(frame.payload)
        if mode != last:
            times_s.append(t_s)
        last = mode
    return np.array(times_s)


def longest_gap_s(times_s: np.ndarray, span_s: tuple[float, float]) -> float | None:
    """Return the longest time without a setpoint within a span; None if there was none in it at all."""
    inside = times_s[(times_s >= span_s[0]) & (times_s <= span_s[1])]
    return round(float(np.diff(inside).max()), 3) if len(inside) > 1 else None


def longest_silence_s(times_s: np.ndarray, span_s: tuple[float, float]) -> float | None:
    """Return the longest time within a span without a setpoint, to its begin and end too; None if there is none."""
    inside = times_s[(times_s >= span_s[0]) & (times_s <= span_s[1])]
    return round(float(np.diff([span_s[0], *inside, span_s[1]]).max()), 3) if len(times_s) else None


def standing_from_s(t_s: np.ndarray, speed_m_s: np.ndarray, since_s: float) -> float | None:
    """Return the first time from `since_s` on from which it stands for STANDS_FOR_S; None if it never does."""
    quick = t_s[(speed_m_s >= STANDING_M_S) & (t_s >= since_s)]
    starts = [since_s, *quick]
    ends = [*quick, t_s[-1]]
    for start, end in zip(starts, ends, strict=True):
        if end - start >= STANDS_FOR_S:
            return float(start)
    return None


def _flown(trajectory: Trajectory, mission: Mission, scored: Score, which: tuple[int, float]) -> dict[str, Any]:
    """Return an agent's figures that follow from its path; `which` is its index and the time of the hand-over."""
    index, hand_over_s = which
    agent = scored.per_agent[index]
    t_s, ned_m = trajectory.t_s, trajectory.agents_ned_m[:, index]
    arrived_s = agent.arrived_t_s
    figures: dict[str, Any] = {
        "id": agent.id,
        "arrived_s": None if arrived_s is None else round(arrived_s - hand_over_s, 1),
        "path_m": round(path_length_m(ned_m[(t_s >= hand_over_s) & (t_s <= (arrived_s or t_s[-1]))]), 1),
        "farthest_after_arrival_m": None,
        "farthest_at_the_end_m": None,
        "stands_after_s": None,
        "held_within_m": None,
        "off_target_m": None,
    }
    if arrived_s is None:
        return figures
    target = next(target for target in mission.targets if target.id == agent.target_id)
    off_m = np.hypot(*(ned_m - target.position_ned_m).T)
    figures["farthest_after_arrival_m"] = round(float(off_m[t_s >= arrived_s].max()), 1)
    figures["farthest_at_the_end_m"] = round(float(off_m[t_s >= t_s[-1] - HELD_S].max()), 1)
    standing_s = standing_from_s(t_s, trajectory.agents_speed_m_s[:, index], arrived_s)
    if standing_s is not None:
        last_m = ned_m[t_s >= max(standing_s, t_s[-1] - HELD_S)]
        middle_m = last_m.mean(axis=0)
        figures["stands_after_s"] = round(standing_s - arrived_s, 1)
        figures["held_within_m"] = round(float(np.percentile(np.hypot(*(last_m - middle_m).T), HELD_SHARE)), 2)
        figures["off_target_m"] = round(float(np.hypot(*(middle_m - target.position_ned_m))), 1)
    return figures


class _Heard(NamedTuple):
    """When agent 1's companion sent setpoints and was told of another mode, its heights, and what it said."""

    setpoints_s: np.ndarray
    modes_s: np.ndarray
    heights: np.ndarray  # (S, 2)
    said: list[tuple[float, str]]
    carried_s: tuple[np.ndarray, np.ndarray]
    """When a wire carried setpoints to the autopilot, and HEARTBEATs of another mode to the companion."""

    def said_at(self, t_s: float) -> str:
        """Return what was said last by a time."""
        return next((line for said_s, line in reversed(self.said) if said_s <= t_s), "")


def _followed(
    trajectory: Trajectory,
    heard: _Heard,
    modes: Sequence[tuple[float, int]],
    span: tuple[tuple[float, str], float],
) -> EventFigures:
    """Return what followed an event (its time and name) until a time, for agent 1."""
    (event_s, what), until_s = span
    t_s, speed_m_s = trajectory.t_s, trajectory.agents_speed_m_s[:, 0]
    sent_s = heard.setpoints_s[(heard.setpoints_s > event_s) & (heard.setpoints_s <= until_s)]
    told_s = heard.modes_s[(heard.modes_s > event_s) & (heard.modes_s <= until_s)]
    delivered_s, passed_s = (times_s[(times_s > event_s) & (times_s <= until_s)] for times_s in heard.carried_s)
    within = t_s <= until_s
    standing_s = standing_from_s(t_s[within], speed_m_s[within], event_s)
    flown = (t_s >= event_s) & (t_s <= (until_s if standing_s is None else standing_s))
    return EventFigures(
        what=what,
        last_setpoint_s=round(float(sent_s[-1] - event_s), 2) if len(sent_s) else None,
        last_after_told_s=_last_after_s(sent_s, told_s),
        delivered_after_told_s=_last_after_s(delivered_s, passed_s),
        first_setpoint_s=round(float(sent_s[0] - event_s), 2) if len(sent_s) else None,
        gap_s=longest_gap_s(heard.setpoints_s, (event_s, until_s)),
        height_m=_extremes(heard.heights, (event_s, until_s)),
        stands_after_s=None if standing_s is None else round(standing_s - event_s, 1),
        flown_m=round(path_length_m(trajectory.agents_ned_m[flown, 0]), 1),
        mode=[mode for at_s, mode in modes if at_s <= until_s][-1],
        said=heard.said_at(until_s),
    )


def _last_after_s(sent_s: np.ndarray, told_s: np.ndarray) -> float | None:
    """Return the time from the first telling to the last setpoint, 0 if that came before; None if nothing was told."""
    return round(float(max(0.0, *(sent_s - told_s[0]), 0.0)), 2) if len(told_s) else None


def _carried(record: dict[str, Any], what: str, agent_id: int) -> np.ndarray:  # (S,)
    """Return the times at which a wire carried something for an agent, from when targets set out; none without one."""
    times_s: np.ndarray = np.array(record.get(what, {}).get(str(agent_id), ())) - record["begin_unix_s"]
    return times_s


def path_length_m(ned_m: np.ndarray) -> float:
    """Return the length of a path of positions (S, 2)."""
    return float(np.hypot(*np.diff(ned_m, axis=0).T).sum())


def _extremes(heights: np.ndarray, span_s: tuple[float, float]) -> tuple[float, float]:
    """Return the least and the greatest of heights (S, 2) of times and metres within a span."""
    within_m = heights[(heights[:, 0] >= span_s[0]) & (heights[:, 0] <= span_s[1]), 1]
    return float(within_m.min()), float(within_m.max())


def _height_off_m(heights: np.ndarray, event_s: float) -> float:
    """Return the greatest difference of heights (S, 2) of times and metres from that at an event, after it."""
    at_m = float(np.interp(event_s, heights[:, 0], heights[:, 1]))
    return round(float(np.abs(heights[heights[:, 0] >= event_s, 1] - at_m).max()), 1)


def _truth_share(times_s: np.ndarray, firmware: str) -> float:
    """Return the least share of the samples that a simulator at its own speed gives, over spans of TRUTH_SPAN_S."""
    spans = np.arange(times_s[0], times_s[-1] - TRUTH_SPAN_S, 1.0)
    counts = np.searchsorted(times_s, spans + TRUTH_SPAN_S) - np.searchsorted(times_s, spans)
    return round(float(counts.min()) / (TRUTH_HZ[firmware] * TRUTH_SPAN_S), 2) if len(counts) else 1.0


def _said_lines(log: Path, begin_s: float) -> list[tuple[float, str]]:
    """Return the lines of what the companion does, with their times."""
    lines = [line.partition(" ") for line in log.read_text(encoding="utf-8").splitlines() if _DOES.search(line)]
    return [(float(at_s) - begin_s, text) for at_s, _, text in lines]
