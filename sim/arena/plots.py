"""The arena's plots: arrivals and entries of every law in every family, and how much longer than planned they flew."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sim.arena.families import FAMILIES
from sim.arena.run import Run, law_order
from sim.arena.statistics import Estimate, Summary
from sim.figures import AGENT_COLOURS, DPI, figure_png

RATES_NAME = "arena-rates.png"
RATIOS_NAME = "arena-ratios.png"
PLOT_NAMES = (RATES_NAME, RATIOS_NAME)
RATIO_AXIS = (0.98, 1.5)
"""Path ratios shown on the axis; greater ones are counted at its right edge."""
COLUMNS = 5


def draw_plots(folder: Path, found: Sequence[Summary], runs: Sequence[Run]) -> None:
    """Write the plots, named PLOT_NAMES, into a folder."""
    (folder / RATES_NAME).write_bytes(_rates_png(found))
    (folder / RATIOS_NAME).write_bytes(_ratios_png(runs))


def _rates_png(found: Sequence[Summary]) -> bytes:
    families = list(dict.fromkeys(summary.family for summary in found))
    laws = sorted({summary.law for summary in found}, key=law_order)
    figure = Figure(figsize=(11.0, 1.6 + 0.75 * len(families)), dpi=DPI)
    left, right = figure.subplots(1, 2, sharey=True)
    _rate_panel(left, found, families, laws, lambda summary: summary.arrivals)
    left.set_xlabel("feasible missions with every target reached")
    _rate_panel(right, found, families, laws, lambda summary: summary.entered)
    right.set_xlabel("flights from certified starts with an entry")
    left.set_yticks(range(len(families)), families)
    left.invert_yaxis()
    right.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=8.5, frameon=False)
    figure.suptitle("Arena, kinematic simulator; bars are 95 % intervals", fontsize=11)
    figure.subplots_adjust(left=0.09, right=0.86, top=0.92, bottom=0.1, wspace=0.06)
    return figure_png(figure)


def _rate_panel(
    axes: Axes,
    found: Sequence[Summary],
    families: Sequence[str],
    laws: Sequence[str],
    figure_of: Callable[[Summary], Estimate],
) -> None:
    for place, law in enumerate(laws):
        shown = [summary for summary in found if summary.law == law and not math.isnan(figure_of(summary).value)]
        offset = (place - (len(laws) - 1) / 2.0) * 0.8 / len(laws)
        estimates = [figure_of(summary) for summary in shown]
        axes.errorbar(
            [estimate.value for estimate in estimates],
            [families.index(summary.family) + offset for summary in shown],
            xerr=[
                [estimate.value - estimate.low for estimate in estimates],
                [estimate.high - estimate.value for estimate in estimates],
            ],
            fmt="o",
            markersize=4.0,
            elinewidth=1.0,
            color=AGENT_COLOURS[place % len(AGENT_COLOURS)],
            label=law,
        )
    axes.set_xlim(-0.03, 1.03)
    axes.grid(axis="x", linewidth=0.4)


def _ratios_png(runs: Sequence[Run]) -> bytes:
    families = [family for family in FAMILIES if any(run.family == family and run.path_ratios for run in runs)]
    laws = sorted({run.law for run in runs}, key=law_order)
    rows = max(1, math.ceil(len(families) / COLUMNS))
    figure = Figure(figsize=(13.0, 0.8 + 2.6 * rows), dpi=DPI)
    panels = figure.subplots(rows, COLUMNS, squeeze=False, sharex=True, sharey=True).ravel()
    for axes, family in zip(panels, families, strict=False):
        for place, law in enumerate(laws):
            ratios = np.sort(
                [
                    ratio
                    for run in runs
                    if run.family == family and run.law == law and run.feasibility.feasible and run.certified
                    for ratio in run.path_ratios
                ]
            )
            share = np.arange(1, len(ratios) + 1) / max(1, len(ratios))
            axes.step(
                np.minimum(ratios, RATIO_AXIS[1]),
                share,
                where="post",
                linewidth=1.2,
                color=AGENT_COLOURS[place % len(AGENT_COLOURS)],
                label=law,
            )
        axes.set_title(family, fontsize=9)
        axes.set_xlim(*RATIO_AXIS)
        axes.grid(linewidth=0.4)
    for axes in panels[len(families) :]:
        axes.set_axis_off()
    panels[0].legend(fontsize=7, loc="lower right")
    figure.supxlabel("flown over planned length", fontsize=9)
    figure.supylabel("share of arrivals", fontsize=9)
    figure.subplots_adjust(left=0.06, right=0.99, top=0.92, bottom=0.13, wspace=0.08, hspace=0.3)
    return figure_png(figure)
