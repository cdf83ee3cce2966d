"""The report of one run, as a person wants to read it: one HTML file that needs nothing else.

It opens from a disk years later, without a network: pictures are data URIs, the style is inside, nothing is loaded and
no script runs. Every value is escaped, for a mission's name is anybody's text.
"""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sim.score import Score
from sim.trajectory import Trajectory

if TYPE_CHECKING:
    from companion.mission.model import LinkSpec, Mission, Wind

RESULT_ROWS: tuple[tuple[str, str, str], ...] = (
    ("arrived", "agents arrived", "Agents that came within the arrival radius of a target nobody had reached before."),
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
        "The closest two agents came, interpolated between samples.",
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
ELSEWHERE = ("seed", "law", "path_length_m", "shortest_path_m")
"""Keys of `result.json` that the report shows outside the table of results."""

_NOTHING = "–"

_STYLE = """
:root { color-scheme: light dark; --text: #1c1e21; --quiet: #5a6068; --page: #ffffff; --panel: #f3f4f6;
  --line: #d5d8dd; }
@media (prefers-color-scheme: dark) {
  :root { --text: #e7e9ec; --quiet: #a5acb5; --page: #17191c; --panel: #22262b; --line: #3a4048; }
}
body { margin: 0 auto; padding: 1.5rem 1rem 4rem; max-width: 62rem; color: var(--text); background: var(--page);
  font: 16px/1.55 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.7rem; line-height: 1.25; margin: 0 0 .25rem; overflow-wrap: anywhere; }
h2 { font-size: 1.2rem; margin: 2.2rem 0 .6rem; }
p { max-width: 46rem; }
.quiet { color: var(--quiet); }
.summary { font-size: 1.1rem; }
.note { border-left: .25rem solid var(--quiet); background: var(--panel); padding: .7rem 1rem; max-width: 44rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-variant-numeric: tabular-nums; }
caption { text-align: left; color: var(--quiet); padding-bottom: .4rem; }
th, td { text-align: left; vertical-align: top; padding: .35rem .8rem .35rem 0; border-bottom: 1px solid var(--line); }
thead th { border-bottom-width: 2px; }
tbody th { font-weight: 600; }
td.number, th.number { text-align: right; white-space: nowrap; }
figure { margin: 0; }
td { white-space: pre-line; }
img { display: block; max-width: 100%; height: auto; background: #ffffff; border: 1px solid var(--line);
  border-radius: .3rem; }
figcaption { color: var(--quiet); padding-top: .4rem; max-width: 46rem; }
pre { background: var(--panel); padding: .8rem 1rem; overflow-x: auto; border-radius: .3rem; }
code { font-family: ui-monospace, "Cascadia Mono", Menlo, Consolas, monospace; font-size: .92em; }
"""


KINEMATIC = "kinematic simulator"
"""What flew, as reports and figures say it, unless the caller says that it was something else."""
_KINEMATIC_NOTE = (
    "The simulator is <strong>kinematic</strong>: vehicles move along exact arcs at their commanded speed, with a "
    "limited rate of turn. It has no aerodynamics, no attitude and no engine, so it shows what the guidance decides "
    "and what the link does to it, not how an airframe follows."
)
_STAND_IN_NOTE = (
    "The vehicles are <strong>stand-ins</strong> that answer and move as the autopilot was measured to in its own "
    "simulator: modes, time-outs, lags and limits, but no aerodynamics beyond them and no sensor's faults."
)


def write_report(
    path: Path,
    mission: Mission,
    result: Mapping[str, Any],
    score: Score,
    trajectory: Trajectory,
    paths_png: bytes,
    clearance_png: bytes,
    command: str,
    stand_in: str = KINEMATIC,
) -> None:
    """Write `report.html`.

    `result` is what goes into `result.json`, at least `seed` and `law`; keys it lacks are left out of the table. The
    two pictures are PNG files' bytes, `command` is what repeats the run, and `stand_in` says what flew. Raises OSError
    where the file cannot be written.
    """
    title = f"{mission.name}: seed {result['seed']}, law {result['law']}"
    body = [
        f"<h1>{_text(mission.name)}</h1>",
        f'<p class="quiet">Seed {_text(result["seed"])}, law {_text(result["law"])}. '
        f"{_text(stand_in[:1].upper() + stand_in[1:])}.</p>",
        f'<p class="summary">{_text(_verdict(score, trajectory))}</p>',
        "<h2>The paths</h2>",
        _picture(
            paths_png,
            "Map of the run, north up: the agents' paths from their starts to the targets, and the threats' circles.",
            "North is up. Blue circles are detection radii, red circles attack radii; a star is an agent's start, a "
            "plus a target.",
        ),
        "<h2>Results</h2>",
        _result_table(result),
        "<h2>How close it came</h2>",
        _picture(
            clearance_png,
            "Two curves over time: the least distance of any agent to the edge of any detection radius, and the least "
            "distance between two agents.",
            "Both are the least over all agents that were not lost, whether or not they had arrived. Below zero, an "
            "agent was inside a detection radius; below the dashed line, two were nearer than the mission allows.",
        ),
        "<h2>Agents</h2>",
        _agent_table(score),
        "<h2>Targets</h2>",
        _target_table(score),
        "<h2>What was flown</h2>",
        _mission_table(mission, trajectory),
        "<h2>What this run can and cannot show</h2>",
        f'<p class="note">{_KINEMATIC_NOTE if stand_in == KINEMATIC else _STAND_IN_NOTE} '
        "Threats and targets move as the mission says. Nothing here was flown outside the simulator.</p>",
        "<h2>To repeat this run</h2>",
        f"<pre><code>{_text(command)}</code></pre>",
        "<p>The same mission and seed give the same <code>trajectory.csv</code> byte for byte, and every figure above "
        "but the two times of computing. Figures about paths, entries, separation and arrival follow from "
        "<code>trajectory.csv</code> and <code>mission.yaml</code> alone.</p>",
    ]
    page = (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{_text(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n<main>\n"
        + "\n".join(body)
        + "\n</main>\n</body>\n</html>\n"
    )
    path.write_text(page, encoding="utf-8", newline="\n")


def _verdict(score: Score, trajectory: Trajectory) -> str:
    """Return the run in two or three sentences."""
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


def _result_table(result: Mapping[str, Any]) -> str:
    known = [(name, _value(result[key]), why) for key, name, why in RESULT_ROWS if key in result]
    explained = {key for key, _, _ in RESULT_ROWS}
    others = [
        (key, _value(value), "") for key, value in result.items() if key not in explained and key not in ELSEWHERE
    ]
    return _table(
        "The figures of result.json, and what each means.",
        ("figure", "value", "meaning"),
        [*known, *others],
        numbers=(1,),
    )


def _agent_table(score: Score) -> str:
    rows = []
    for agent in score.per_agent:
        ending = _NOTHING
        if agent.arrived_t_s is not None:
            ending = f"target {agent.target_id}"
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
    return _table(
        "The shortest path goes around the detection radii of static threats to where the agent arrived (else to its "
        "last position); moving threats are left out, so it is a lower bound. The ratio compares it with the path up "
        "to there, without the loiter afterwards.",
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
        rows,
        numbers=range(2, 8),
    )


def _target_table(score: Score) -> str:
    rows = [
        (
            str(target.id),
            _fixed(target.reached_t_s, 1) if target.reached_t_s is not None else "not reached",
            _NOTHING if target.agent_id is None else str(target.agent_id),
        )
        for target in score.per_target
    ]
    return _table(
        "When each target was first reached, and by which agent (the nearest, if several arrived at once).",
        ("target", "reached (s)", "by agent"),
        rows,
        numbers=(1, 2),
    )


def _mission_table(mission: Mission, trajectory: Trajectory) -> str:
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
    return _table("The whole of it is in mission.yaml.", ("setting", "value"), rows)


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


def _table(caption: str, heads: Sequence[str], rows: Iterable[Sequence[str]], numbers: Iterable[int] = ()) -> str:
    """Return a table whose first column names the row; `numbers` are the columns to align right. Escapes everything."""
    right = frozenset(numbers)
    css = ['class="number"' if column in right else "" for column in range(len(heads))]
    head = "".join(_cell("th", f'scope="col" {css[column]}', text) for column, text in enumerate(heads))
    lines = [
        "<tr>"
        + _cell("th", 'scope="row"', row[0])
        + "".join(_cell("td", css[column], text) for column, text in enumerate(row[1:], start=1))
        + "</tr>"
        for row in rows
    ]
    return (
        f'<div class="scroll"><table>\n<caption>{_text(caption)}</caption>\n<thead><tr>{head}</tr></thead>\n<tbody>\n'
        + "\n".join(lines)
        + "\n</tbody></table></div>"
    )


def _cell(tag: str, attributes: str, text: str) -> str:
    opening = f"{tag} {attributes}".strip()
    return f"<{opening}>{_text(text)}</{tag}>"


def _picture(png: bytes, alternative: str, caption: str) -> str:
    data = base64.b64encode(png).decode("ascii")
    return (
        f'<figure><img alt="{_text(alternative)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{_text(caption)}</figcaption></figure>"
    )


def _value(value: object) -> str:
    """Return a figure of the result as text: numbers with thousands apart, a mapping as name and value."""
    if value is None:
        return _NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return _fixed(value, 2)
    if isinstance(value, Mapping):
        # Broken between the parts, so that it does not widen the column of single numbers.
        return "\n".join(f"{key} {_value(part)}" for key, part in value.items())
    return str(value)


def _fixed(value: float | None, decimals: int) -> str:
    if value is None or math.isnan(value):
        return _NOTHING
    return "no way" if math.isinf(value) else f"{value:,.{decimals}f}"


def _count(number: int, word: str, words: str | None = None) -> str:
    """Return "1 agent" or "2 agents"."""
    return f"{number} {word if number == 1 else words or word + 's'}"


def _text(value: object) -> str:
    return html.escape(str(value), quote=True)
