"""Draws the figures of the reproduction, like the paper's where the paper has such a figure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from companion.surrogate.profiles import HALF_WIDTH, PolygonProfile, RadialProfile, StepProfile, load_pairwise
from sim.figures import ATTACK_COLOUR, DETECTION_COLOUR, DPI, draw_flight, figure_png, plot_paths
from sim.flown import FlownMission
from sim.reproduction.claims import PAPER_MAX_MS, PAPER_MEAN_MS, PAPER_TRAINING_MSE
from sim.reproduction.experiments import PAPER_STEP_S, Flown, Results, Training
from sim.score import score
from sim.trajectory import Trajectory

SNAPSHOT_STEPS = 100
"""Guidance steps between two pictures of the dynamic run (paper, figure paths)."""
_COLUMNS = 3
_KINEMATIC = "kinematic simulator: points that turn at a bounded rate, not aircraft"
_NETWORK_COLOUR = "#1b7a5a"
_POLYGON_COLOUR = "#d98200"
_STEP_COLOUR = "#444444"

APPROXIMATION = "approximation.png"
LEARNING = "learning.png"
STATIC_SEED_PATHS = "static-paths-seed.png"
STATIC_STEP_PATHS = "static-paths-step.png"
SNAPSHOTS = "dynamic-snapshots.png"
STEP_TIMES = "step-times.png"


def draw_all(results: Results, folder: Path) -> dict[str, str]:
    """Write every figure into the folder; return their file names with what each shows, in the report's order.

    Raises OSError where a file cannot be written.
    """
    under_surrogate, under_step = results.static_pair
    drawn: dict[str, tuple[Callable[[Path], object], str]] = {
        APPROXIMATION: (
            lambda path: path.write_bytes(_approximation_png(results.dynamic)),
            "The step F, its polygon F~ and the pairwise network F* that flies, about one threat.",
        ),
        LEARNING: (
            lambda path: path.write_bytes(_learning_png(results)),
            "Learning curves of both networks, each beside the variance of its own target.",
        ),
        STATIC_SEED_PATHS: (
            lambda path: _static_paths(under_surrogate, path, "seed", "Static contrast (a): the gradient of F*"),
            f"Static scene, seed {under_surrogate.seed}, with the gradient of F*. Kinematic simulator.",
        ),
        STATIC_STEP_PATHS: (
            lambda path: _static_paths(under_step, path, "step", "Static contrast (b): the gradient of F"),
            "The same scene with the gradient of F, which is zero wherever it exists. Kinematic simulator.",
        ),
        SNAPSHOTS: (
            lambda path: path.write_bytes(_snapshots_png(results.dynamic)),
            f"Dynamic scene, seed {results.dynamic.seed}, every {SNAPSHOT_STEPS} steps and at the end. Kinematic "
            "simulator.",
        ),
        STEP_TIMES: (
            lambda path: path.write_bytes(_step_times_png(results)),
            "Wall-clock time of one step for all agents: the decisions, without the kinematic simulator's flying.",
        ),
    }
    for name, (draw, _) in drawn.items():
        draw(folder / name)
    return {name: caption for name, (_, caption) in drawn.items()}


def _approximation_png(flown: Flown) -> bytes:
    """Draw the three profiles over the distance from a threat, whole and about the edge."""
    threat = flown.mission.threats[0]
    radius_m = threat.detection_radius_m
    figure = Figure(figsize=(10.0, 4.4), dpi=DPI)
    whole, edge = figure.subplots(1, 2)
    figure.subplots_adjust(left=0.07, right=0.98, top=0.84, bottom=0.14, wspace=0.18)
    figure.suptitle("F, F~ and F*: the penalty of one detection disc", fontsize=12)
    profiles: tuple[tuple[RadialProfile, str, str, float], ...] = (
        (StepProfile(), "F, the step", _STEP_COLOUR, 1.2),
        (PolygonProfile(HALF_WIDTH), f"F~, polygon of half-width {HALF_WIDTH:g} R_d", _POLYGON_COLOUR, 2.6),
        (load_pairwise(), "F*, pairwise network", _NETWORK_COLOUR, 1.4),
    )
    spans = ((whole, 0.0, 2.0, "whole"), (edge, 1.0 - 4.0 * HALF_WIDTH, 1.0 + 4.0 * HALF_WIDTH, "about the edge"))
    for axes, low, high, title in spans:
        ratio = np.linspace(low, high, 2_001)
        for profile, label, colour, width in profiles:
            axes.plot(ratio * radius_m / 1e3, profile.value(ratio), color=colour, lw=width, label=label)
        axes.set_title(title, fontsize=10, loc="left")
        axes.set_xlabel(f"distance from the threat (km), R_d = {radius_m / 1e3:g} km")
        axes.grid(True, color="#e6e6e6", lw=0.6)
        axes.margins(x=0.0)
    whole.set_ylabel("penalty (in units of k_d)")
    whole.legend(loc="lower left", fontsize=8.5)
    return figure_png(figure)


def _learning_png(results: Results) -> bytes:
    figure = Figure(figsize=(10.0, 4.8), dpi=DPI)
    left, right = figure.subplots(1, 2)
    figure.subplots_adjust(left=0.08, right=0.98, top=0.84, bottom=0.13, wspace=0.2)
    figure.suptitle("Learning curves", fontsize=12)
    _learning(left, results.monolithic, "monolithic, the paper's: all positions to one number")
    _learning(right, results.pairwise, "pairwise, which flies: one distance to one number")
    left.axhline(PAPER_TRAINING_MSE, color=ATTACK_COLOUR, ls=":", lw=1.2, label="the paper's MSE, of unknown scaling")
    for axes in (left, right):
        axes.legend(loc="best", fontsize=8)
    return figure_png(figure)


def _learning(axes: Axes, training: Training, title: str) -> None:
    epochs, train_mse, validation_mse = zip(*training.learning_curve, strict=True)
    axes.set_yscale("log")
    axes.plot(epochs, train_mse, color=DETECTION_COLOUR, lw=1.3, label="training", marker=".", ms=3)
    axes.plot(epochs, validation_mse, color=_POLYGON_COLOUR, lw=1.3, label="validation", marker=".", ms=3)
    axes.axhline(training.test_target_variance, color=_STEP_COLOUR, ls="--", lw=1.2, label="variance of the target")
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel("epoch")
    axes.set_ylabel("mean square error (of the scaled target)")
    axes.grid(True, which="both", color="#e6e6e6", lw=0.6)


def _static_paths(flown: Flown, path: Path, law: str, title: str) -> None:
    plot_paths(FlownMission(flown.mission, flown.trajectory, flown.score, flown.seed, law), path, title)


def _snapshots_png(flown: Flown) -> bytes:
    """Draw the run up to each multiple of SNAPSHOT_STEPS and up to its end, each in a panel of its own."""
    every = round(PAPER_STEP_S / flown.mission.integration_step_s)
    steps = [*range(SNAPSHOT_STEPS, flown.steps, SNAPSHOT_STEPS), flown.steps]
    rows = -(-len(steps) // _COLUMNS)
    figure = Figure(figsize=(4.6 * _COLUMNS, 4.7 * rows + 0.9), dpi=DPI)
    height = 4.7 * rows + 0.9
    panels = figure.subplots(rows, _COLUMNS, squeeze=False)
    figure.subplots_adjust(
        left=0.055, right=0.985, top=1.0 - 0.85 / height, bottom=0.95 / height, wspace=0.2, hspace=0.28
    )
    figure.suptitle("Dynamic run", fontsize=12, y=1.0 - 0.2 / height)
    legend: list[Line2D] = []
    for index, axes in enumerate(panels.flat):
        if index >= len(steps):
            axes.set_axis_off()
            continue
        until = _until(flown.trajectory, steps[index] * every)
        # A run that is over at a sample between two steps is drawn to that sample.
        scored = score(until, flown.mission)
        beginning = FlownMission(flown.mission, until, scored, flown.seed, "seed")
        legend, _ = draw_flight(axes, beginning, flown.trajectory)
        axes.set_title(
            f"step {steps[index]}, {until.t_s[-1]:g} s: {scored.targets_reached} of {scored.targets} targets reached",
            fontsize=9.5,
        )
    figure.legend(handles=legend, loc="lower center", ncols=len(legend), fontsize=8.5, frameon=False)
    figure.text(0.055, 1.0 - 0.42 / height, f"{_KINEMATIC}; seed {flown.seed}", fontsize=8.5, color="#444444")
    return figure_png(figure)


def _until(trajectory: Trajectory, sample: int) -> Trajectory:
    """Return a trajectory's samples up to and including one, or all if there are fewer."""
    names = ("agents", "targets", "threats")
    parts = ("ned_m", "heading_deg", "speed_m_s")
    cut = {f"{name}_{part}": getattr(trajectory, f"{name}_{part}")[: sample + 1] for name in names for part in parts}
    return replace(trajectory, t_s=trajectory.t_s[: sample + 1], **cut)


def _step_times_png(results: Results) -> bytes:
    figure = Figure(figsize=(10.0, 4.6), dpi=DPI)
    axes = figure.add_axes((0.08, 0.13, 0.9, 0.72))
    figure.suptitle("Time of one step for all agents, on this machine", fontsize=12)
    measured = (
        (results.core_step_us, "pure core", DETECTION_COLOUR),
        (results.wire_step_us, "over the wire, all companions, frames included", _NETWORK_COLOUR),
    )
    least_ms = min(float(times_us.min()) for times_us, _, _ in measured) / 1e3
    greatest_ms = max(PAPER_MAX_MS, *(float(times_us.max()) / 1e3 for times_us, _, _ in measured))
    bins = np.geomspace(least_ms * 0.9, greatest_ms * 1.1, 80)
    axes.set_xscale("log")
    for times_us, label, colour in measured:
        label = f"{label}: mean {times_us.mean() / 1e3:.2f} ms, maximum {times_us.max() / 1e3:.2f} ms"
        axes.hist(times_us / 1e3, bins=bins.tolist(), color=colour, alpha=0.6, label=label)
    for time_ms, label, style in (
        (PAPER_MEAN_MS, "the paper's mean", "--"),
        (PAPER_MAX_MS, "the paper's maximum", ":"),
    ):
        axes.axvline(time_ms, color=ATTACK_COLOUR, ls=style, lw=1.4, label=f"{label}, {time_ms:g} ms (another machine)")
    axes.set_xlabel("wall-clock time of one step (ms)")
    axes.set_ylabel("steps")
    axes.grid(True, color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)
    axes.set_ylim(top=1.5 * axes.get_ylim()[1])  # room for the legend
    axes.legend(loc="upper left", fontsize=8.5)
    return figure_png(figure)
