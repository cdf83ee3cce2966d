"""The table of flights, as docs/real-autopilots.md shows it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.real.beside import ratios
from tests.real.kinds import KINDS
from tests.real.lane import Job, job_of, jobs

MOST_AGENTS = 3
"""Most agents that a row shows one by one."""
_COLUMNS = (
    "scenario",
    "vehicle",
    "entries",
    "breaches (least, m)",
    "targets",
    "arrived after (s), path (m)",
    "time, path: of the stand-in's",
    "then at most, and at the end at most (m) from the target",
    "stands after (s)",
    "holds within (m)",
    "longest gap (s), pause of the computer",
    "not as wanted",
)
_EVENT_COLUMNS = (
    "scenario",
    "vehicle",
    "event",
    "last setpoint after (s)",
    "after it was told of the mode (s)",
    "first setpoint after (s)",
    "stands after (s)",
    "flown (m)",
    "longest gap (s)",
    "heights (m)",
    "mode at the end",
)


def table(out: Path) -> str:
    """Return the flights below a folder as a markdown table, and what followed their events as another."""
    flights = [
        json.loads(path.read_text(encoding="utf-8")) | {"beside": ratios(path.parent)}
        for path in sorted(out.glob("*/figures.json"), key=_in_order)
    ]
    rows = [_row(flight) for flight in flights if _is_a_mission(flight)]
    events = [_event_row(flight, event) for flight in flights for event in flight["events"]]
    text = _head(_COLUMNS) + "".join(rows)
    if events:
        text += "\n" + _head(_EVENT_COLUMNS) + "".join(events)
    return text


def _is_a_mission(flight: dict[str, Any]) -> bool:
    """Return whether a flight has more to show than what followed its events."""
    scenario = Job.named(f"{flight['scenario']}:{flight['kind']}").scenario
    return scenario.refused or "open_targets" in scenario.at_most or bool(flight["broken"])


def _in_order(path: Path) -> int:
    """Return where a flight stands in the table of scenarios."""
    job = job_of(path.parent)
    return [other.name for other in jobs()].index(job.name)


def _head(columns: Sequence[str]) -> str:
    return f"| {' | '.join(columns)} |\n|{'---|' * len(columns)}\n"


def _row(flight: dict[str, Any]) -> str:
    agents = flight["agents"]
    reached = len([agent for agent in agents if agent["arrived_s"] is not None])
    least = flight["least_separation_m"]
    cells = [
        flight["scenario"],
        KINDS[flight["kind"]].title,
        f"{flight['entries']}" + (f" ({flight['deepest_m']:g} m)" if flight["entries"] else ""),
        f"{flight['breaches']} ({least:g})" if least is not None else "",
        f"{reached} of {len(agents)}",
        _each(agents, "arrived_s", "path_m"),
        "; ".join(f"{ratio.time:.2f}, {ratio.path:.2f}" for ratio in flight["beside"]),
        _each(agents, "farthest_after_arrival_m", "farthest_at_the_end_m"),
        _each(agents, "stands_after_s"),
        _each(agents, "held_within_m"),
        _each(agents, "gap_s") + f" ({flight['pause_s']:.2f})",
        "; ".join(flight["broken"]),
    ]
    return f"| {' | '.join(cells)} |\n"


def _event_row(flight: dict[str, Any], event: dict[str, Any]) -> str:
    cells = [
        flight["scenario"],
        KINDS[flight["kind"]].title,
        event["what"],
        _number(event["last_setpoint_s"]),
        "" if event["what"] == "mode guided" else _number(_told(event)),
        _number(event["first_setpoint_s"]),
        _number(event["stands_after_s"]),
        _number(event["flown_m"]),
        _number(event["gap_s"]),
        "{:.1f} to {:.1f}".format(*event["height_m"]),
        KINDS[flight["kind"]].modes.name_of(event["mode"]),
    ]
    return f"| {' | '.join(cells)} |\n"


def _told(event: dict[str, Any]) -> float | None:
    """Return the time from a HEARTBEAT of another mode to the last setpoint, as a wire carried them if there is one."""
    carried: float | None = event["delivered_after_told_s"]
    told: float | None = event["last_after_told_s"]
    return told if carried is None else carried


def _each(agents: list[dict[str, Any]], *keys: str) -> str:
    """Return these figures of each agent, or the least and greatest of many agents."""
    if len(agents) <= MOST_AGENTS:
        return "; ".join(", ".join(_number(agent[key]) for key in keys) for agent in agents)
    known = {key: [agent[key] for agent in agents if agent[key] is not None] for key in keys}
    return ", ".join(
        f"{_number(min(values))} to {_number(max(values))}" if values else "-" for values in known.values()
    )


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:g}"
