"""Writes the report of one flight: a single HTML file that is complete in itself.

It can be opened years later without a network: pictures are data URIs, style sheet and player are inside, nothing is
loaded, and a policy in the page lets nothing be. Every value is escaped, because a mission's name may contain anything.
The page's template is `templates/report.html`; its content is computed here, the player's in sim/player.py.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from companion.mission.model import LinkSpec, Mission, Wind
from sim.flown import KINEMATIC, FlownMission
from sim.player import script_json
from sim.score import Score, TargetScore
from sim.trajectory import Trajectory

RESULT_ROWS: tuple[tuple[str, str, str], ...] = (
    (
        "arrived",
        "agents arrived",
        "Agents that came within the arrival radius of a target nobody had reached before, on their path.",
    ),
    ("targets_reached", "targets reached", "Each counts once, for the first to arrive."),
    ("targets", "targets", "In the mission."),
    ("flight_time_s", "flight time (s)", "From the first sample to the last, on the simulator's clock."),
    ("steps", "steps", "Guidance steps: times every companion decided."),
    (
        "threat_entries_detection",
        "entries into a detection radius",
        "Times any agent crossed from outside to inside. Zero is the aim.",
    ),
    ("threat_entries_attack", "entries into an attack radius", "The same for the smaller circle."),
    ("worst_depth_m", "worst depth (m)", "The deepest any agent was inside a detection radius; 0 if none was."),
    (
        "min_separation_m",
        "least separation (m)",
        "The closest two agents came, on their paths.",
    ),
    (
        "separation_breaches",
        "separation breaches",
        "Times a pair of agents came closer than the mission's separation.",
    ),
    ("guard_interventions", "guard interventions", "Setpoints that the guard, the last check on board, changed."),
    ("turn_limited_steps", "turn-limited steps", "Decisions that wanted a sharper turn than the vehicle can fly."),
    (
        "decision_us",
        "time per decision on board (µs)",
        "Measured on the machine that ran this; it differs from run to run.",
    ),
    ("broadcast_frames", "broadcast frames", "Frames that the ground station sent."),
    ("broadcast_bytes", "broadcast bytes", "What those frames weigh on the link."),
    ("frames_lost", "frames lost", "Frames that the lossy link swallowed, summed over vehicles."),
    ("speedup", "speed-up", "Simulated seconds per second of computing, on the machine that ran this."),
)
"""Keys of `result.json` with their names and explanations, in reading order. Per-agent lengths have their own table."""
ELSEWHERE = ("seed", "law", "path_length_m", "shortest_path_m", "ended_early", "agents")
"""Keys of `result.json` that the report shows outside the table of results."""

_NOTHING = "–"
"""Text in the place of a value that there is not."""


@dataclass(frozen=True)
class Pictures:
    """The pictures of a report, still as the bytes of PNG files, and moving."""

    paths_png: bytes
    clearance_png: bytes
    player: Mapping[str, Any]
    """What the player is given (sim/player.py)."""


@dataclass(frozen=True)
class Table:
    """A table of the report, whose first column names the row."""

    caption: str
    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numbers: tuple[int, ...] = ()
    """Indices of the columns that are aligned to the right."""


def write_report(path: Path, flown: FlownMission, result: Mapping[str, Any], pictures: Pictures, command: str) -> None:
    """Write `report.html`.

    `result` is the content of `result.json`; rows of keys that it does not have are left out. `command` is the command
    line that repeats the flight.

    Raises:
        OSError: the file cannot be written.

    """
    page = (
        _environment()
        .get_template("report.html")
        .render(
            name=flown.mission.name,
            seed=result["seed"],
            law=result["law"],
            stand_in=flown.stand_in,
            kinematic=flown.stand_in == KINEMATIC,
            verdict=_verdict(flown.score, flown.trajectory),
            ended_early=flown.ended_early,
            fates=_fate_table(result.get("agents", ())),
            pictures=pictures,
            results=_result_table(result),
            agents=_agent_table(flown.score),
            targets=_target_table(flown.score),
            settings=_mission_table(flown.mission, flown.trajectory),
            command=command,
        )
    )
    path.write_text(page, encoding="utf-8", newline="\n")


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("sim"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["script_json"] = script_json
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode("ascii")
    return environment


def _verdict(score: Score, trajectory: Trajectory) -> str:
    """Return the outcome of the flight in two to four sentences."""
    agents = len(trajectory.agent_ids)
    reached = f"{score.targets_reached} of {_count(score.targets, 'target')}"
    if score.targets_reached == score.targets:
        reached = "All targets" if score.targets != 1 else "The target"
    verb = "was" if score.targets_reached == 1 else "were"
    sentences = [f"{reached} {verb} reached; {score.arrived} of {_count(agents, 'agent')} arrived."]
    if not trajectory.threat_ids:
        sentences.append("There were no threats.")
    elif score.worst_depth_m == 0:
        sentences.append("No agent was ever inside a detection radius.")
    elif score.threat_entries_detection == 0:
        sentences.append(f"An agent started inside a detection radius, at most {score.worst_depth_m:,.0f} m deep.")
    else:
        entries = _count(score.threat_entries_detection, "entry", "entries")
        attack = _count(score.threat_entries_attack, "entry", "entries")
        sentences.append(
            f"There were {entries} into a detection radius, at most {score.worst_depth_m:,.1f} m deep, "
            f"and {attack} into an attack radius."
        )
    if score.min_separation_m is not None:
        kept = "kept their separation throughout"
        if score.separation_breaches:
            kept = f"came too near each other {_count(score.separation_breaches, 'time')}"
        sentences.append(f"Agents {kept}; the nearest two were {score.min_separation_m:,.1f} m apart.")
    lost = sum(agent.lost_t_s is not None for agent in score.per_agent)
    if lost:
        sentences.append(
            f"{_count(lost, 'agent')} {'was' if lost == 1 else 'were'} lost on the way, as the mission says."
        )
    return " ".join(sentences)


def _result_table(result: Mapping[str, Any]) -> Table:
    known = [(name, _value(result[key]), why) for key, name, why in RESULT_ROWS if key in result]
    explained = {key for key, _, _ in RESULT_ROWS}
    others = [
        (key, _value(value), "") for key, value in result.items() if key not in explained and key not in ELSEWHERE
    ]
    return Table(
        "The figures of result.json, and what each means.",
        ("figure", "value", "meaning"),
        (*known, *others),
        numbers=(1,),
    )


def _fate_table(agents: Sequence[Mapping[str, Any]]) -> Table:
    """Return the table of what became of every agent; `agents` are those of `result.json`."""
    rows = []
    for agent in agents:
        lost = agent["certificate_lost"]
        broken = (
            f"{one['assumption']}: {one['count']} times from {one['first_t_s']:,.1f} s on" for one in agent["broken"]
        )
        rows.append(
            (
                str(agent["id"]),
                agent["outcome"],
                agent["reason"],
                agent["certificate_at_start"],
                _NOTHING if lost is None else f"{lost['certificate']} from {lost['t_s']:,.1f} s on: {lost['why']}",
                "\n".join(broken) or _NOTHING,
                _approach(agent["least_clearance_detection"], "threat"),
                _approach(agent["least_clearance_attack"], "threat"),
                _approach(agent["least_separation"], "agent"),
                f"{agent['entries_detection']} / {agent['entries_attack']}",
            )
        )
    return Table(
        "Why each agent ended as it did, by its last decision; how long the guard certified its start for: for ever, "
        "until some time, or not at all; when it first had less, and which assumptions broke; how near it came to a "
        "detection radius, to an attack radius and to another agent (negative: inside).",
        (
            "agent",
            "outcome",
            "reason",
            "certified at the start",
            "certificate lost",
            "assumptions broken",
            "nearest to R_d",
            "nearest to R_a",
            "nearest agent",
            "entries R_d / R_a",
        ),
        tuple(rows),
        numbers=(9,),
    )


def _approach(nearest: Mapping[str, Any] | None, other: str) -> str:
    if nearest is None:
        return _NOTHING
    return f"{_fixed(nearest['m'], 1)} m at {nearest['t_s']:,.1f} s ({other} {nearest[other]})"


def _agent_table(score: Score) -> Table:
    rows = []
    for agent in score.per_agent:
        ending = _NOTHING
        if agent.reached:
            ending = f"target {', '.join(str(one.target_id) for one in agent.reached)}"
        elif agent.lost_t_s is not None:
            ending = f"lost at {agent.lost_t_s:,.1f} s"
        ratio = agent.path_to_end_m / agent.shortest_path_m if agent.shortest_path_m > 0 else math.nan
        rows.append(
            (
                str(agent.id),
                ending,
                _fixed(agent.arrived_t_s, 1),
                _fixed(agent.path_length_m / 1_000, 2),
                _fixed(agent.path_to_end_m / 1_000, 2),
                _fixed(agent.shortest_path_m / 1_000, 2),
                _fixed(ratio if agent.shortest_path_m < math.inf else None, 3),
                str(agent.threat_entries_detection),
            )
        )
    return Table(
        "The shortest path goes around the detection radii of static threats to where the agent arrived last, by its "
        "other arrivals (else to its last position); moving threats are left out, so it is a lower bound. The ratio "
        "compares it with the path up to there, without the loiter afterwards.",
        (
            "agent",
            "arrived at",
            "time (s)",
            "whole path (km)",
            "path to there (km)",
            "shortest (km)",
            "ratio",
            "entries",
        ),
        tuple(rows),
        numbers=tuple(range(2, 8)),
    )


def _ending(target: TargetScore) -> str:
    if target.reached_t_s is not None:
        return _fixed(target.reached_t_s, 1)
    return "not reached" if target.retired_t_s is None else f"retired at {target.retired_t_s:,.1f} s"


def _target_table(score: Score) -> Table:
    rows = [
        (
            str(target.id),
            _ending(target),
            _NOTHING if target.agent_id is None else str(target.agent_id),
        )
        for target in score.per_target
    ]
    return Table(
        "When each target was first reached, and by which agent (the nearest, if several arrived at once).",
        ("target", "reached (s)", "by agent"),
        tuple(rows),
        numbers=(1, 2),
    )


def _mission_table(mission: Mission, trajectory: Trajectory) -> Table:
    moving = sum(threat.motion != "static" for threat in mission.threats)
    rows = [
        ("agents", str(len(trajectory.agent_ids))),
        ("targets", str(len(trajectory.target_ids))),
        ("threats", f"{len(trajectory.threat_ids)}, of which {moving} moving"),
        ("arrival radius", f"{mission.arrival_radius_m:g} m"),
        ("separation required", f"{mission.separation_m:g} m"),
        ("broadcast", f"every {mission.broadcast_period_s:g} s, case {mission.case}"),
        ("assignment", f"every {mission.assignment_period_s:g} s"),
        ("decisions on board", f"every {mission.guidance_step_s:g} s"),
        ("link", _link(mission.link)),
        ("wind", _wind(mission.wind)),
        ("time limit", f"{mission.max_time_s:g} s"),
    ]
    return Table("The whole of it is in mission.yaml.", ("setting", "value"), tuple(rows))


def _link(link: LinkSpec) -> str:
    parts = [f"{link.loss * 100:g} % of frames lost", f"{link.delay_s:g} s delay"]
    if link.jitter_s:
        parts.append(f"{link.jitter_s:g} s jitter")
    if link.burst is not None:
        parts.append("losses in bursts")
    if link.duplicate:
        parts.append(f"{link.duplicate * 100:g} % repeated")
    if link.reorder:
        parts.append(f"{link.reorder * 100:g} % out of order")
    return ", ".join(parts)


def _wind(wind: Wind) -> str:
    if wind.speed_m_s == 0 and wind.gust_m_s == 0:
        return "none"
    return f"{wind.speed_m_s:g} m/s from {wind.from_deg:g}°, gusts {wind.gust_m_s:g} m/s"


def _value(value: object) -> str:
    """Return a value of `result.json` as text: numbers with thousands separators, a mapping as a line per entry."""
    if value is None:
        return _NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return _fixed(value, 2)
    if isinstance(value, Mapping):
        # One line per entry, so that it does not widen the column of single numbers.
        return "\n".join(f"{key} {_value(part)}" for key, part in value.items())
    return str(value)


def _fixed(value: float | None, decimals: int) -> str:
    if value is None or math.isnan(value):
        return _NOTHING
    return "no way" if math.isinf(value) else f"{value:,.{decimals}f}"


def _count(number: int, word: str, words: str | None = None) -> str:
    """Return a number and its noun in the singular or plural, such as "1 agent" or "2 agents"."""
    return f"{number} {word if number == 1 else words or word + 's'}"
