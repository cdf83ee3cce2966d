"""Writes what was measured: `reproduce.json` with every number, and `reproduce.md`, made from its content alone."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from companion.geo.kinematics import turn_rate_rad_s
from companion.mission.model import Mission
from sim.reproduction.claims import PAPER_MAX_MS, PAPER_MEAN_MS, PAPER_STEPS, Claim, complete_steps
from sim.reproduction.experiments import (
    DYNAMIC,
    PAPER_STEP_S,
    STATIC_SEED,
    STATIC_STEP,
    FlightFigures,
    Results,
    Series,
    Settings,
    Training,
    WireComparison,
    paper_mission,
)
from sim.reproduction.figures import (
    APPROXIMATION,
    LEARNING,
    SNAPSHOTS,
    STATIC_SEED_PATHS,
    STATIC_STEP_PATHS,
    STEP_TIMES,
)

JSON_NAME, MARKDOWN_NAME = "reproduce.json", "reproduce.md"
Content = Mapping[str, Any]
"""The content of `reproduce.json`."""


def write_report(
    folder: Path, results: Results, claims: Sequence[Claim], figures: Mapping[str, str], wall_s: float
) -> None:
    """Write both files; `figures` are the names of the files beside them, with captions.

    Raises OSError where a file cannot be written.
    """
    content = content_of(results, claims, figures, wall_s)
    (folder / JSON_NAME).write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    (folder / MARKDOWN_NAME).write_text(markdown(content), encoding="utf-8")


def content_of(results: Results, claims: Sequence[Claim], figures: Mapping[str, str], wall_s: float) -> dict[str, Any]:
    """Return the content of `reproduce.json`."""
    static, _ = results.static_pair
    return {
        "simulator": "kinematic",
        "settings": asdict(results.settings),
        "paper_sized": is_paper_sized(results.settings),
        "versions": {
            "python": platform.python_version(),
            "numpy": np.__version__,
            "torch": results.torch_version,
        },
        "wall_s": round(wall_s, 1),
        "claims": [{**asdict(claim), "verdict": claim.verdict.value} for claim in claims],
        "training": {"monolithic": _training(results.monolithic), "pairwise": _training(results.pairwise)},
        "mission": _mission(results.dynamic.mission),
        "series": {series.key: _series(series, results) for series in results.series},
        "step_times": {
            "paper_mean_ms": PAPER_MEAN_MS,
            "paper_max_ms": PAPER_MAX_MS,
            "core": _times(results.core_step_us),
            "wire": _times(results.wire_step_us),
        },
        "wire": [_comparison(comparison) for comparison in results.wire],
        "illustrated": {
            "static_seed": static.seed,
            "dynamic_seed": results.dynamic.seed,
            "dynamic_steps": results.dynamic.steps,
        },
        "figures": dict(figures),
    }


def markdown(content: Content) -> str:
    """Return the report as Markdown text."""
    parts = [
        _introduction(content),
        _claims(content),
        _training_part(content),
        _static_part(content),
        _dynamic_part(content),
        _sweep_part(content),
        _times_part(content),
        _wire_part(content),
    ]
    # Markdown would read a pair of either as emphasis or as struck out.
    return "\n\n".join(parts).replace("F*", "F\\*").replace("F~", "F\\~") + "\n"


def is_paper_sized(settings: Settings) -> bool:
    """Return whether training and flights are as large as the paper's; smaller ones only try the program out."""
    paper = Settings()
    return (settings.samples, settings.epochs, settings.time_limit_s) == (paper.samples, paper.epochs, None)


def _training(training: Training) -> dict[str, Any]:
    return {**asdict(training), "test_mse_over_variance": training.test_mse / training.test_target_variance}


def _mission(mission: Mission) -> dict[str, Any]:
    return {
        "agents": len(mission.agents),
        "targets": len(mission.targets),
        "threats": len(mission.threats),
        "area_north_m": mission.area_m.north,
        "area_east_m": mission.area_m.east,
        "broadcast_period_s": mission.broadcast_period_s,
        "assignment_period_s": mission.assignment_period_s,
        "arrival_radius_m": mission.arrival_radius_m,
        "separation_m": mission.separation_m,
        "max_time_s": mission.max_time_s,
    }


def _series(series: Series, results: Results) -> dict[str, Any]:
    """Return a series' settings, the totals of its figures, and the figures of each flight as columns."""
    flights = results.of(series.key)
    agent = paper_mission(series, series.seeds[0]).agents[0]
    rate_rad_s = turn_rate_rad_s(agent.speed_m_s, agent.n_max)
    complete_s = [flight.time_s for flight in flights if flight.targets_reached == flight.targets]
    columns = [field.name for field in fields(FlightFigures)]
    return {
        "mission": series.mission,
        "law": series.law,
        "n_max": series.n_max,
        "guidance_step_s": series.guidance_step_s,
        "integration_step_s": series.integration_step_s,
        "turn_radius_m": agent.speed_m_s / rate_rad_s,
        "turn_per_step_rad": rate_rad_s * series.guidance_step_s,
        "flights": len(flights),
        "flights_complete": len(complete_s),
        **{
            f"{key}_in_all": sum(getattr(flight, key) for flight in flights)
            for key in (
                *("targets_reached", "targets", "arrived", "entries_detection", "entries_attack"),
                *("breaches", "breaches_at_steps", "turn_limited", "decisions"),
            )
        },
        "flights_with_entries": sum(flight.entries_detection > 0 for flight in flights),
        "agents_entered": sum(len(flight.entered) for flight in flights),
        "agents_entered_most": max(len(flight.entered) for flight in flights),
        "worst_depth_m": max(flight.worst_depth_m for flight in flights),
        "least_separation_m": min(
            (flight.min_separation_m for flight in flights if flight.min_separation_m is not None), default=None
        ),
        "steps_to_last_target": _spread(complete_steps(flights)),
        "time_to_last_target_s": _spread(complete_s),
        "each": {column: [getattr(flight, column) for flight in flights] for column in columns},
    }


def _spread(values: Sequence[float] | np.ndarray) -> dict[str, float] | None:
    if len(values) == 0:
        return None
    return {"median": float(np.median(values)), "min": float(np.min(values)), "max": float(np.max(values))}


def _times(step_us: np.ndarray) -> dict[str, float]:
    quantiles_us = np.percentile(step_us, [50, 99, 99.9])
    return {
        "steps": len(step_us),
        "mean_ms": float(step_us.mean()) / 1e3,
        **{f"{name}_ms": float(us) / 1e3 for name, us in zip(("median", "p99", "p999"), quantiles_us, strict=True)},
        "max_ms": float(step_us.max()) / 1e3,
    }


def _comparison(comparison: WireComparison) -> dict[str, Any]:
    names = [field.name for field in fields(WireComparison) if not field.name.endswith("_us")]
    return {**{name: getattr(comparison, name) for name in names}, "agrees": comparison.agrees}


def _introduction(content: Content) -> str:
    settings, versions, mission = content["settings"], content["versions"], content["mission"]
    static = content["series"][STATIC_SEED]
    rows = [
        ("flights per experiment", f"{settings['seeds']} (seeds 1 to {settings['seeds']}), on the pure core"),
        ("of these over the wire too", f"{settings['wire_seeds']}"),
        (
            "paper's step",
            f"guidance every {static['guidance_step_s']:g} s, integration and sampling every "
            f"{static['integration_step_s']:g} s along exact arcs",
        ),
        ("broadcast, assignment", f"every {mission['broadcast_period_s']:g} s, {mission['assignment_period_s']:g} s"),
        (
            "scene",
            f"{mission['agents']} agents, {mission['targets']} targets, {mission['threats']} threats in "
            f"{mission['area_north_m'] / 1e3:g} km x {mission['area_east_m'] / 1e3:g} km, drawn from the seed",
        ),
        ("longest flight", f"{mission['max_time_s']:g} s, when the agents' range is flown"),
        ("training", f"{settings['samples']} samples, at most {settings['epochs']} epochs"),
        ("Python, numpy, torch", f"{versions['python']}, {versions['numpy']}, {versions['torch']}"),
        ("took", f"{content['wall_s']:.0f} s"),
    ]
    text = (
        "# The paper's experiments, run again\n\n"
        "Written by `sim reproduce`. Every number in the column *here*, and all below, was measured in that run; "
        "`reproduce.json` holds them all, flight by flight. **The simulator is kinematic**: agents are points that "
        "turn at a bounded rate, not aircraft. The paper does not publish its starting positions; here they are drawn "
        "from the seed."
    )
    if not content["paper_sized"]:
        text += "\n\n**This run is smaller than the paper's**: its verdicts are no more than a trial of the program."
    return f"{text}\n\n{_table(('setting', 'value'), rows)}"


def _claims(content: Content) -> str:
    heads = ("claim", "paper", "here", "verdict")
    groups = [
        [
            (claim["claim"], claim["paper"], claim["here"], f"**{claim['verdict']}**. {claim['reason']}")
            for claim in content["claims"]
            if claim["ours"] is ours
        ]
        for ours in (False, True)
    ]
    return (
        f"## The paper's claims\n\n{_table(heads, groups[0])}\n\n"
        f"## What this project says of the paper\n\n{_table(heads, groups[1])}"
    )


def _training_part(content: Content) -> str:
    records = content["training"]
    rows = [
        (
            name,
            record["neurons"],
            f"{record['epochs_run']} of {record['epochs_allowed']}",
            *(f"{record[key]:.3e}" for key in ("train_mse", "validation_mse", "test_mse", "test_target_variance")),
            f"{record['test_mse_over_variance']:.3g}",
        )
        for name, record in records.items()
    ]
    heads = (
        *("network", "neurons", "epochs", "training MSE", "validation MSE", "test MSE"),
        *("variance of its target (test)", "test MSE / variance"),
    )
    return (
        "## Training\n\n"
        "`monolithic` is the paper's network, all positions in and one number out, on uniform samples of F~, the "
        "output scaled to [-1, 1]. `pairwise` is the network that flies: one scaled distance in, the penalty of one "
        "disc out. Each MSE is to be read beside the variance of its own target, which is what predicting the mean "
        f"would score.\n\n{_table(heads, rows)}\n\n{_figures(content, LEARNING, APPROXIMATION)}"
    )


def _static_part(content: Content) -> str:
    rows = [
        (
            name,
            series["flights"],
            series["flights_with_entries"],
            series["agents_entered"],
            series["agents_entered_most"],
            f"{series['entries_detection_in_all']} / {series['entries_attack_in_all']}",
            f"{series['worst_depth_m']:.0f}",
            f"{series['targets_reached_in_all']} of {series['targets_in_all']}",
        )
        for name, series in (
            ("F* (`seed`)", content["series"][STATIC_SEED]),
            ("F (`step`)", content["series"][STATIC_STEP]),
        )
    ]
    heads = (
        *("gradient of", "flights", "flights with entries", "agents that entered", "most in one flight"),
        *("entries into R_d / R_a", "deepest in R_d (m)", "targets reached"),
    )
    return (
        "## Static contrast\n\n"
        "Nothing but the agents moves. The same scenes are flown with the gradient of the surrogate F* and with that "
        f"of F, which is zero wherever it exists, so that the agents fly straight. The figures show seed "
        f"{content['illustrated']['static_seed']}: the first in which three agents or more enter under F, as in the "
        f"paper's figure, or else that with the most.\n\n{_table(heads, rows)}\n\n"
        f"{_figures(content, STATIC_SEED_PATHS, STATIC_STEP_PATHS)}"
    )


def _dynamic_part(content: Content) -> str:
    series = content["series"][DYNAMIC]
    steps = series["steps_to_last_target"]
    rows = [
        ("flights", series["flights"]),
        ("flights that reached every target", series["flights_complete"]),
        ("targets reached", f"{series['targets_reached_in_all']} of {series['targets_in_all']}"),
        ("entries into R_d / R_a", f"{series['entries_detection_in_all']} / {series['entries_attack_in_all']}"),
        ("steps to the last target: median, least, most", _spread_text(steps)),
        ("the paper's steps", PAPER_STEPS),
        ("breaches of the separation, interpolated", series["breaches_in_all"]),
        ("of these seen at the guidance steps alone", series["breaches_at_steps_in_all"]),
        ("decisions with the turn limit active", f"{series['turn_limited_in_all']} of {series['decisions_in_all']}"),
    ]
    illustrated = content["illustrated"]
    return (
        "## Dynamic run\n\n"
        "Targets and threats walk at 10 m/s, each in a new random direction every 5 s. A step is "
        f"{PAPER_STEP_S:g} s and 300 m long, so that a separation of {content['mission']['separation_m']:g} m cannot "
        "be seen at the steps: it is measured on the samples in between, linearly interpolated. The figure shows the "
        f"flight of median length, seed {illustrated['dynamic_seed']} with {illustrated['dynamic_steps']} steps.\n\n"
        f"{_table(('figure', 'value'), rows)}\n\n{_figures(content, SNAPSHOTS)}"
    )


def _sweep_part(content: Content) -> str:
    rows = [
        (
            f"{series['n_max']:g}",
            f"{series['guidance_step_s']:g} / {series['integration_step_s']:g}",
            f"{series['turn_radius_m']:.0f}",
            f"{series['turn_per_step_rad']:.2f}",
            series["flights"],
            f"{series['targets_reached_in_all']} of {series['targets_in_all']}",
            series["arrived_in_all"],
            f"{series['entries_detection_in_all']} / {series['entries_attack_in_all']}",
            f"{series['worst_depth_m']:.0f}",
            series["breaches_in_all"],
            _spread_text(series["time_to_last_target_s"]),
            f"{100.0 * series['turn_limited_in_all'] / series['decisions_in_all']:.1f}",
        )
        for series in content["series"].values()
        if series["mission"] == "paper-dynamic"
    ]
    heads = (
        *("n_max", "guidance / integration (s)", "turn radius (m)", "turn per step (rad)", "flights"),
        *("targets reached", "agents arrived", "entries into R_d / R_a", "deepest in R_d (m)", "separation breaches"),
        *("time to the last target (s): median, least, most", "decisions limited (%)"),
    )
    return (
        "## Less agile vehicles\n\n"
        "The dynamic mission with smaller load factors: n = 10 is the paper's, real fixed wings have 0.5 to 2. At the "
        "paper's step, and at guidance and integration steps ten times as fine, where the broadcast still comes every "
        f"{content['mission']['broadcast_period_s']:g} s.\n\n{_table(heads, rows)}"
    )


def _times_part(content: Content) -> str:
    times = content["step_times"]
    rows = [
        (
            name,
            measured["steps"],
            *(f"{measured[f'{key}_ms']:.2f}" for key in ("mean", "median", "p99", "p999", "max")),
        )
        for name, measured in (
            ("pure core: assignment and the decisions of all agents", times["core"]),
            ("over the wire: the decisions of all companions, frames included", times["wire"]),
        )
    ]
    return (
        "## Step times\n\n"
        "Wall-clock time of one 5 s step for all agents together, measured in the flights of the last section with no "
        "other job of this run beside them. In the system that flies each agent decides on a computer of its own. The "
        f"paper has {times['paper_mean_ms']:g} ms in the mean and {times['paper_max_ms']:g} ms at most, on another "
        "machine.\n\n"
        f"{_table(('measured', 'steps', 'mean (ms)', 'median', '99 %', '99.9 %', 'maximum'), rows)}\n\n"
        f"{_figures(content, STEP_TIMES)}"
    )


def _wire_part(content: Content) -> str:
    rows = [
        (
            each["seed"],
            "yes" if each["agrees"] else "**no**",
            f"{_ids(each['targets_core'])} / {_ids(each['targets_wire'])}",
            " / ".join(f"{detection}, {attack}" for detection, attack in (each["entries_core"], each["entries_wire"])),
            f"{each['steps_core']} / {each['steps_wire']}",
            f"{each['typical_apart_m']:.1f}",
            f"{each['apart_m']:.1f} (agent {each['apart_agent']} at {each['apart_t_s']:g} s)",
            each["guard_interventions"],
        )
        for each in content["wire"]
    ]
    heads = (
        *("seed", "agrees", "targets reached, core / wire", "entries R_d, R_a, core / wire", "steps, core / wire"),
        *("apart, median agent (m)", "apart, farthest agent (m)", "changes by the guard"),
    )
    return (
        "## The wire beside the pure core\n\n"
        "The same dynamic flights with ground station, companions, sensor and vehicles that exchange nothing but "
        "encoded frames. They agree where the same targets are reached with the same entries in as many steps within "
        "one. *Apart* is the greatest distance of an agent from itself in the other flight, until it arrived. What "
        "separates them: on the wire positions are rounded to a few metres and radii upwards, and a guard cuts turns "
        "of more than 3 rad in one step, which shifts such an agent at the start. Where an agent meets a threat head "
        "on, at the distance at which repulsion and attraction balance, it hovers to and fro by a step until something "
        "tips it to a side: there a metre decides when, and the two flights come apart for a while.\n\n"
        f"{_table(heads, rows)}"
    )


def _ids(ids: Iterable[int]) -> str:
    return " ".join(map(str, ids)) or "none"


def _spread_text(spread: Mapping[str, float] | None) -> str:
    if spread is None:
        return "never"
    return ", ".join(f"{spread[key]:.1f}".removesuffix(".0") for key in ("median", "min", "max"))


def _figures(content: Content, *names: str) -> str:
    return "\n\n".join(f"![{name}]({name})\n\n{content['figures'][name]}" for name in names)


def _table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a Markdown table; bars within cells are escaped, because they would end the cell."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in line) + " |" for line in lines)
