"""Writes the arena's results: `arena.json`, `arena.md` with a table for each family, and the worst runs as missions."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.mission.model import dump_mission
from sim.arena.families import FAMILIES, draw
from sim.arena.run import OWN_LAWS, Run, flight_seed, law_order
from sim.arena.statistics import Estimate, Summary, behind, summarise

JSON_NAME = "arena.json"
MARKDOWN_NAME = "arena.md"
WORST_FOLDER = "worst"
WORST_PER_FAMILY = 3
"""Worst runs of `routed` that are saved for each family, beside every one of its failures."""


def summaries(runs: Sequence[Run]) -> list[Summary]:
    """Return one summary for each family and law, in the order of the families and of `law_order`."""
    found = []
    for family in FAMILIES:
        here = [run for run in runs if run.family == family]
        for law in sorted({run.law for run in here}, key=law_order):
            found.append(summarise([run for run in here if run.law == law]))
    return found


def broken_promise(run: Run) -> bool:
    """Return whether a run entered a disc from a certified start, or broke the separation."""
    return (run.certified and run.entries > 0) or run.breaches > 0


def failures(runs: Sequence[Run]) -> list[tuple[Run, str]]:
    """Return the runs of `routed` that broke a promise or did not arrive though they could, each with what is wrong."""
    found = []
    for run in runs:
        if run.law != "routed":
            continue
        wrong = []
        if run.certified and run.entries:
            wrong.append(f"{run.entries} entries from a certified start, {run.worst_depth_m:.1f} m deep")
        if run.breaches:
            wrong.append(f"{run.breaches} breaches, least {run.min_separation_m:.0f} m")
        if run.certified and run.feasibility.feasible and not run.complete:
            wrong.append(f"{run.reached} of {run.targets} targets reached")
        if wrong:
            found.append((run, "; ".join(wrong)))
    return found


def worst(runs: Sequence[Run]) -> list[tuple[Run, str]]:
    """Return the runs to save, each with the reason: every failure, and each family's longest paths of `routed`."""
    chosen = dict(((run.family, run.index), (run, why)) for run, why in failures(runs))
    for family in FAMILIES:
        flown = [run for run in runs if run.family == family and run.law == "routed" and run.path_ratios]
        flown.sort(key=lambda run: max(run.path_ratios), reverse=True)
        for run in flown[:WORST_PER_FAMILY]:
            chosen.setdefault((run.family, run.index), (run, f"path ratio {max(run.path_ratios):.3f}"))
    return list(chosen.values())


def write_worst(folder: Path, runs: Sequence[Run], seed: int) -> list[tuple[Run, str, str]]:
    """Save the worst runs as missions; return each with the reason and the call that replays it."""
    (folder / WORST_FOLDER).mkdir(exist_ok=True)
    saved = []
    for run, why in worst(runs):
        path = folder / WORST_FOLDER / f"{run.family}-{run.index}.yaml"
        path.write_text(dump_mission(draw(run.family, seed, run.index)), encoding="utf-8")
        call = f"sim fly {WORST_FOLDER}/{path.name} --law routed --seed {flight_seed(seed, run.index)}"
        saved.append((run, why, call))
    return saved


@dataclass(frozen=True)
class ArenaOutcome:
    """The runs of an arena that has been flown, with its seed and its duration."""

    runs: Sequence[Run]
    seed: int
    wall_s: float
    saved: Sequence[tuple[Run, str, str]]
    """The worst runs with reason and call, as `write_worst` returns them."""

    @property
    def missions(self) -> int:
        """Number of missions that were flown, each by several laws."""
        return len({(run.family, run.index) for run in self.runs})


def write_arena(folder: Path, outcome: ArenaOutcome, figures: Sequence[str]) -> None:
    """Write `arena.json` and `arena.md`; `figures` are the names of the plots in the folder."""
    found = summaries(outcome.runs)
    content: dict[str, Any] = {
        "seed": outcome.seed,
        "missions": outcome.missions,
        "wall_s": round(outcome.wall_s, 1),
        "summaries": [_plain(dataclasses.asdict(summary)) for summary in found],
        "worst": [
            {"family": run.family, "index": run.index, "why": why, "call": call} for run, why, call in outcome.saved
        ],
        "runs": [_plain(_run_figures(run)) for run in outcome.runs],
    }
    (folder / JSON_NAME).write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    (folder / MARKDOWN_NAME).write_text(markdown(outcome, found, figures), encoding="utf-8")


def markdown(outcome: ArenaOutcome, found: Sequence[Summary], figures: Sequence[str]) -> str:
    """Return the arena's page; `found` are the summaries of its runs."""
    runs = outcome.runs
    lines = [
        "# Arena",
        "",
        f"Seed {outcome.seed}, {outcome.missions} missions, {len(runs)} flights, {outcome.wall_s / 60.0:.1f} min of "
        "wall time. The simulator is kinematic: points that turn at a bounded rate. In brackets: 95 % intervals "
        "(Wilson for rates, order statistics for quantiles). Arrivals and path ratios are of feasible missions from "
        "starts certified for ever, and so are the entries; behind a plus stand those from starts certified until some "
        "time only (until t), and from starts without a certificate. docs/arena.md says what the words mean.",
    ]
    for family in dict.fromkeys(summary.family for summary in found):
        lines += ["", f"## {family}: {FAMILIES[family].title}", "", FAMILIES[family].description, ""]
        lines += [f"{_census(runs, family)}", "", *_table([s for s in found if s.family == family])]
        ours = next((s for s in found if s.family == family and s.law == "routed"), None)
        for other in found if ours is not None else ():
            if ours is not None and other.family == family and other.law != "routed" and behind(ours, other):
                lines += ["", f"`routed` is behind `{other.law}` in {', '.join(behind(ours, other))}."]
    lines += ["", "## The worst runs of `routed`", ""]
    lines += [f"- {run.family} {run.index}: {why}; `{call}`" for run, why, call in outcome.saved]
    lines += [""] + [f"![{name}]({name})" for name in figures]
    return "\n".join(lines) + "\n"


def _census(runs: Sequence[Run], family: str) -> str:
    """Return a sentence on how many missions of a family can be flown, and why the others cannot."""
    first = {run.index: run for run in runs if run.family == family}
    reasons: dict[str, int] = {}
    for run in first.values():
        why = run.feasibility.why_not or _why_not_certified(run)
        if why is not None:
            kind = "no way" if why.startswith("no way") else why.replace(str(run.index), "").strip()
            kind = "a target inside a disc by the end" if "inside a disc" in why else kind
            reasons[kind] = reasons.get(kind, 0) + 1
    able = len(first) - sum(reasons.values())
    not_able = "".join(f"; {count}: {why}" for why, count in sorted(reasons.items()))
    gaps = [run.feasibility.gap for run in first.values() if run.feasibility.gap is not None]
    gap = f" The planner's gap to its lower bound is at most {100.0 * max(gaps):.2f} %." if gaps else ""
    return f"{able} of {len(first)} missions are feasible from a start certified for ever{not_able}.{gap}"


def _why_not_certified(run: Run) -> str | None:
    """Return why a run's starts do not count as certified; None if they were certified for ever."""
    if run.certified:
        return None
    return "start not certified" if run.until_s is None else "start certified until some time only"


def _table(found: Sequence[Summary]) -> list[str]:
    lines = [
        "| law | feasible | arrivals | entries | worst depth m | breaches | least separation m | path ratio median "
        "| p95 | p99 | decision median us | p99 us |",
        "|---|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for s in found:
        entries = f"{s.entries}" + (f" + {s.entries_until} until t" if s.entries_until else "")
        entries += f" + {s.entries_uncertified}" if s.entries_uncertified else ""
        cells = (
            f"`{s.law}`" if s.law in OWN_LAWS else s.law,
            f"{s.feasible} of {s.flights}",
            _rate(s.arrivals),
            entries,
            f"{s.worst_depth_m:.1f}",
            str(s.breaches),
            "-" if math.isnan(s.min_separation_m) else f"{s.min_separation_m:.0f}",
            *(_ratio(estimate) for estimate in (s.ratio_median, s.ratio_p95, s.ratio_p99)),
            f"{s.decision_median_us:.0f}",
            f"{s.decision_p99_us:.0f}",
        )
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _rate(estimate: Estimate) -> str:
    if math.isnan(estimate.value):
        return "-"
    return f"{100 * estimate.value:.1f} % [{100 * estimate.low:.0f}, {100 * estimate.high:.0f}]"


def _ratio(estimate: Estimate) -> str:
    if math.isnan(estimate.value):
        return "-"
    return f"{estimate.value:.4f} [{estimate.low:.3f}, {estimate.high:.3f}]"


def _run_figures(run: Run) -> dict[str, Any]:
    figures = dataclasses.asdict(run)
    del figures["decision_counts"]
    return figures


def _plain(value: Any) -> Any:  # noqa: ANN401 JSON has no NaN; null says the same
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return round(value, 6) if math.isfinite(value) else None
    return value
