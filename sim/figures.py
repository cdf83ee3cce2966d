"""Pictures of a flight: the paths that were flown, and the distances to threats and between agents over time.

The paths are drawn like the paper's figures (fig. compare and paths): a blue circle for the detection radius, a red one
for the attack radius, '*' where an agent starts, '+' for a target. Figures are drawn without pyplot, which has global
state and may need a display, so every flight gives the same pixels everywhere.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import FixedLocator, FuncFormatter

from companion.mission.model import Mission
from sim.flown import FlownMission
from sim.score import Score
from sim.trajectory import Trajectory

DETECTION_COLOUR = "#1f5fd0"
ATTACK_COLOUR = "#d01c1c"
TARGET_COLOUR = "#111111"
WALL_COLOUR = "#7a5200"
AGENT_COLOURS = (
    "#1b9e77",
    "#d95f02",
    "#7b3fa0",
    "#e7298a",
    "#66a61e",
    "#c79a00",
    "#8c5a2b",
    "#17a7c4",
    "#4d4d4d",
    "#f08080",
)
"""Colours of the agents' paths, distinct from each other and from the circles; they repeat with the next line style."""
LINE_STYLES = ("-", "--", ":", "-.")
KILOMETRE_SCALE_FROM_M = 5_000.0
"""Width of the map from which its axes are in kilometres."""
MOVED_FRACTION = 0.002
"""Share of the map's width; a target or threat that moved less is drawn as if it stood still."""
POINTS_PER_PATH = 1_500
"""Number of points to which a path is thinned; they are closer together than the picture's pixels."""
MARGIN = 0.05
"""Space around everything that is drawn, as a share of the map's width."""
DPI = 110
"""Resolution of the pictures in pixels per inch."""
_LABEL_PT = 8.0
"""Font size of the agents' numbers in points."""
_LABEL_STRIDE = 8
"""Texts keep clear of every eighth point of a thinned path."""
_LABEL_OFFSETS_PT = tuple(
    (reach * math.cos(angle), reach * math.sin(angle))
    for reach in (10.0, 16.0, 24.0)
    for angle in np.arange(8) * math.tau / 8
)
"""Candidate offsets in points of an agent's number from its star; the first one with the most room is taken."""


def plot_paths(flown: FlownMission, path_png: Path, title: str) -> bytes:
    """Draw the paths of a flight into a PNG file, north up, with equal scales, and return the file's bytes.

    Threats are drawn dashed where they started and solid where they were at the end, with their track. The title may
    contain any text; it is not read as mathematics.

    Raises:
        OSError: the file cannot be written.

    """
    figure = Figure(figsize=(10.0, 8.2), dpi=DPI)
    axes = figure.add_axes((0.075, 0.1, 0.69, 0.83))
    legend, unit = draw_flight(axes, flown)
    score = flown.score
    figure.suptitle(title, x=0.42, y=0.975, fontsize=12, parse_math=False)
    figure.text(
        0.42,
        0.015,
        f"{flown.stand_in}, seed {flown.seed}, law {flown.law}, {_duration(score.flight_time_s)} flown, "
        f"{score.arrived} of {len(flown.trajectory.agent_ids)} agents arrived, "
        f"{score.targets_reached} of {score.targets} targets reached",
        ha="center",
        fontsize=8.5,
        color="#444444",
        parse_math=False,
    )
    _draw_scale_bar(axes, unit)
    axes.legend(
        handles=legend, loc="upper left", bbox_to_anchor=(1.02, 1.0), borderaxespad=0.0, fontsize=8.5, frameon=False
    )
    png = figure_png(figure)
    path_png.write_bytes(png)
    return png


def draw_flight(axes: Axes, flown: FlownMission, framed: Trajectory | None = None) -> tuple[list[Line2D], str]:
    """Draw threats, targets and agents of a flight, or of its beginning, onto a map; return its legend and length unit.

    The map's limits hold all of the trajectory `framed`, by default the flight's. Pictures of one flight at several
    times thus show the same ground.
    """
    trajectory, mission = flown.trajectory, flown.mission
    unit_m, unit = _frame(axes, trajectory if framed is None else framed, mission)
    axes.set_xlabel(f"east ({unit})")
    axes.set_ylabel(f"north ({unit})")
    legend = _draw_walls(axes, mission, unit_m)
    legend += _draw_threats(axes, trajectory, mission, unit_m)
    legend += _draw_targets(axes, trajectory, unit_m)
    legend += _draw_agents(axes, trajectory, flown.score, unit_m)
    return legend, unit


def clearance_png(score: Score, mission: Mission) -> bytes:
    """Return the bytes of a PNG: least clearance to any detection radius and least separation of agents over time."""
    figure = Figure(figsize=(10.0, 5.6), dpi=DPI)
    upper, lower = figure.subplots(2, 1, sharex=True)
    figure.subplots_adjust(left=0.1, right=0.97, top=0.94, bottom=0.1, hspace=0.28)
    history = score.history
    upper.set_title("Clearance: nearest agent to the edge of any detection radius", fontsize=10, loc="left")
    if np.isnan(history.clearance_m).all():
        _note(upper, "no threats, or no agents")
    else:
        least_radius_m = min(threat.detection_radius_m for threat in mission.threats)
        linear_m = 10.0 ** math.floor(math.log10(least_radius_m / 5))  # logarithmic beyond, linear through zero
        upper.set_yscale("symlog", linthresh=linear_m, linscale=0.8)
        upper.axhspan(-1e12, 0.0, color=ATTACK_COLOUR, alpha=0.10, lw=0)
        upper.axhline(0.0, color=ATTACK_COLOUR, lw=1.0)
        _line(upper, history.t_s, history.clearance_m, DETECTION_COLOUR)
        lowest_m, highest_m = float(np.nanmin(history.clearance_m)), float(np.nanmax(history.clearance_m))
        upper.set_ylim(min(lowest_m * 1.3, -linear_m), max(highest_m * 1.3, linear_m))
        powers_m = linear_m * 10.0 ** np.arange(8)
        upper.yaxis.set_major_locator(FixedLocator([*-powers_m, 0.0, *powers_m]))
        upper.annotate(
            "inside a detection radius",
            (0.995, 0.03),
            xycoords="axes fraction",
            ha="right",
            fontsize=8,
            color=ATTACK_COLOUR,
        )
    lower.set_title("Separation: nearest two agents, closest approach between samples", fontsize=10, loc="left")
    if np.isnan(history.separation_m).all():
        _note(lower, "fewer than two agents")
    else:
        lower.set_yscale("log")
        lower.axhline(mission.separation_m, color=ATTACK_COLOUR, lw=1.0, ls="--")
        lower.annotate(
            f"required {mission.separation_m:g} m",
            (0.995, mission.separation_m),
            xycoords=("axes fraction", "data"),
            xytext=(0, 3),
            textcoords="offset points",
            ha="right",
            fontsize=8,
            color=ATTACK_COLOUR,
        )
        # The logarithm of 0 would be outside the picture, so the least distance shown is a centimetre.
        _line(lower, history.t_s, np.maximum(history.separation_m, 0.01), "#1b7a5a")
    for axes in (upper, lower):
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: _metres(value)))
        axes.grid(True, color="#dddddd", lw=0.6)
        axes.margins(x=0.01)
    lower.set_xlabel("time (s)")
    return figure_png(figure)


def figure_png(figure: Figure) -> bytes:
    """Return a figure as the bytes of a PNG; without software name or date, the same data give the same bytes."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    return buffer.getvalue()


def _frame(axes: Axes, trajectory: Trajectory, mission: Mission) -> tuple[float, str]:
    """Set the map's limits to hold everything drawn, with equal scales; return the axes' unit (m) and its name."""
    shown_m = [trajectory.agents_ned_m.reshape(-1, 2), trajectory.targets_ned_m.reshape(-1, 2)]
    for index, threat in enumerate(mission.threats):
        track_m = _there(trajectory.threats_ned_m[:, index])
        for centre_m in (track_m[0], track_m[-1]):
            shown_m.append(np.stack((centre_m - threat.detection_radius_m, centre_m + threat.detection_radius_m)))
    shown_m += [np.array(polygon) for polygon in (mission.fence or (), *mission.exclusions) if polygon]
    every_m = np.concatenate(shown_m)
    low_m, high_m = np.nanmin(every_m, axis=0), np.nanmax(every_m, axis=0)
    width_m = max(float((high_m - low_m).max()), 1.0)
    unit_m, unit = (1_000.0, "km") if width_m >= KILOMETRE_SCALE_FROM_M else (1.0, "m")
    half_m = width_m * (0.5 + MARGIN)
    middle_m = (low_m + high_m) / 2
    axes.set_xlim((middle_m[1] - half_m) / unit_m, (middle_m[1] + half_m) / unit_m)
    axes.set_ylim((middle_m[0] - half_m) / unit_m, (middle_m[0] + half_m) / unit_m)
    axes.set_aspect("equal")
    axes.grid(True, color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)
    return unit_m, unit


def _there(ned_m: np.ndarray) -> np.ndarray:  # (S, 2) -> (T, 2)
    """Return the positions of a thing while it was there, without its NaNs."""
    there: np.ndarray = ned_m[~np.isnan(ned_m[:, 0])]
    return there


def _draw_walls(axes: Axes, mission: Mission, unit_m: float) -> list[Line2D]:
    """Draw the fence and the exclusions, where there are any; return the legend's entries."""
    legend = []
    if mission.fence is not None:
        corners = np.array(mission.fence)[:, ::-1] / unit_m
        axes.add_patch(Polygon(corners, fill=False, ec=WALL_COLOUR, lw=1.2, ls="-", zorder=2))
        legend.append(Line2D([], [], color=WALL_COLOUR, lw=1.2, label="fence"))
    for exclusion in mission.exclusions:
        corners = np.array(exclusion)[:, ::-1] / unit_m
        axes.add_patch(Polygon(corners, fc="none", ec=WALL_COLOUR, lw=0.8, hatch="////", zorder=2))
    if mission.exclusions:
        legend.append(Line2D([], [], color=WALL_COLOUR, lw=0.8, ls=(0, (1, 1)), label="exclusion (hatched)"))
    return legend


def _draw_threats(axes: Axes, trajectory: Trajectory, mission: Mission, unit_m: float) -> list[Line2D]:
    """Draw the threats' circles and tracks; return the legend's entries."""
    any_moved = False
    for index, threat in enumerate(mission.threats):
        track = _there(trajectory.threats_ned_m[:, index]) / unit_m
        moved = _moved(axes, track)
        any_moved |= moved
        for radius_m, colour in (
            (threat.detection_radius_m, DETECTION_COLOUR),
            (threat.attack_radius_m, ATTACK_COLOUR),
        ):
            radius = radius_m / unit_m
            axes.add_patch(Circle((track[-1, 1], track[-1, 0]), radius, fc=colour, alpha=0.06, lw=0, zorder=1))
            axes.add_patch(Circle((track[-1, 1], track[-1, 0]), radius, fill=False, ec=colour, lw=1.5, zorder=2))
            if moved:
                start = Circle((track[0, 1], track[0, 0]), radius, fill=False, ec=colour, lw=0.6, ls=(0, (4, 3)))
                axes.add_patch(start)
        if moved:
            thin = _thinned(track)
            axes.plot(thin[:, 1], thin[:, 0], color=ATTACK_COLOUR, lw=0.7, alpha=0.7, zorder=2)
    if not mission.threats:
        return []
    legend = [
        Line2D([], [], ls="", marker="o", ms=11, mfc="none", mec=DETECTION_COLOUR, mew=1.5, label="detection radius"),
        Line2D([], [], ls="", marker="o", ms=7, mfc="none", mec=ATTACK_COLOUR, mew=1.5, label="attack radius"),
    ]
    if any_moved:
        legend.append(Line2D([], [], color=DETECTION_COLOUR, lw=0.6, ls=(0, (4, 3)), label="threat at the start"))
        legend.append(Line2D([], [], color=ATTACK_COLOUR, lw=0.7, alpha=0.7, label="track of a threat"))
    return legend


def _draw_targets(axes: Axes, trajectory: Trajectory, unit_m: float) -> list[Line2D]:
    """Draw a bold '+' at every target's end and, if it moved, its track and a thin '+' at the start.

    Return the legend's entries.
    """
    style: dict[str, Any] = {"ls": "", "marker": "+", "color": TARGET_COLOUR}
    any_moved = False
    for index in range(len(trajectory.target_ids)):
        track = _there(trajectory.targets_ned_m[:, index]) / unit_m
        axes.plot(track[-1:, 1], track[-1:, 0], ms=12, mew=2.2, zorder=6, **style)
        if _moved(axes, track):
            any_moved = True
            thin = _thinned(track)
            axes.plot(thin[:, 1], thin[:, 0], color=TARGET_COLOUR, lw=0.6, alpha=0.6, zorder=3)
            axes.plot(track[:1, 1], track[:1, 0], ms=9, mew=0.8, zorder=5, **style)
    legend = []
    if trajectory.target_ids:
        legend.append(Line2D([], [], ms=12, mew=2.2, label="target" + (" at the end" if any_moved else ""), **style))
    if any_moved:
        legend.append(Line2D([], [], ms=9, mew=0.8, label="target at the start", **style))
    return legend


def _draw_agents(axes: Axes, trajectory: Trajectory, score: Score, unit_m: float) -> list[Line2D]:
    """Draw every agent's path up to its loss, its star and number, and its arrival; return the legend's entries."""
    starts = trajectory.agents_ned_m[0, :, ::-1] / unit_m  # (N, 2) east, north
    colours = []
    paths = []
    for index, agent in enumerate(score.per_agent):
        colour = AGENT_COLOURS[index % len(AGENT_COLOURS)]
        style = LINE_STYLES[index // len(AGENT_COLOURS) % len(LINE_STYLES)]
        colours.append(colour)
        flown = trajectory.agents_ned_m[:, index] / unit_m  # (S, 2)
        if agent.lost_t_s is not None:
            flown = flown[trajectory.t_s < agent.lost_t_s]
        if len(flown):
            thin = _thinned(flown)
            axes.plot(thin[:, 1], thin[:, 0], color=colour, ls=style, lw=1.3, zorder=4)
            paths.append(thin[::_LABEL_STRIDE, ::-1])
        axes.plot(*starts[index], ls="", marker="*", ms=9, mfc=colour, mec="white", mew=0.5, zorder=7)
        for reached in agent.reached:
            at = (reached.ned_m[1] / unit_m, reached.ned_m[0] / unit_m)
            axes.plot(*at, ls="", marker="o", ms=5.5, mfc="white", mec=colour, mew=1.6, zorder=7)
        if agent.lost_t_s is not None and len(flown):
            axes.plot(flown[-1, 1], flown[-1, 0], ls="", marker="x", ms=7, mew=2.0, color=colour, zorder=7)
    marks = (starts, _there(trajectory.targets_ned_m[(0, -1), :, ::-1].reshape(-1, 2)) / unit_m)
    _label(
        axes, starts, [str(identity) for identity in trajectory.agent_ids], colours, np.concatenate((*marks, *paths))
    )

    legend = [
        Line2D([], [], ls="", marker="*", ms=10, color="#444444", label="agent's start and number"),
        Line2D([], [], lw=1.3, color="#444444", label="agent's path"),
    ]
    if score.arrived:
        legend.append(Line2D([], [], ls="", marker="o", mfc="white", mec="#444444", mew=1.6, label="arrival"))
    if any(agent.lost_t_s is not None for agent in score.per_agent):
        legend.append(Line2D([], [], ls="", marker="x", ms=7, mew=2.0, color="#444444", label="agent lost"))
    return legend


def _label(
    axes: Axes, anchors: np.ndarray, texts: Sequence[str], colours: Sequence[str], obstacles: np.ndarray
) -> None:
    """Write a text beside each anchor (N, 2), at the offset with the most room to all other marks and texts.

    `obstacles` (P, 2) are the marks to keep clear of, like the anchors in the axes' units.
    """
    to_points = 72.0 / DPI
    marks = axes.transData.transform(obstacles) * to_points  # (P, 2) pt
    frame = np.array(axes.get_window_extent().extents) * to_points  # left, bottom, right, top pt
    places = axes.transData.transform(anchors) * to_points
    for place, text, colour, anchor in zip(places, texts, colours, anchors, strict=True):
        best_offset, best_room = _LABEL_OFFSETS_PT[0], -math.inf
        for offset in _LABEL_OFFSETS_PT:
            spot = place + offset
            inside = (spot > frame[:2] + _LABEL_PT).all() and (spot < frame[2:] - _LABEL_PT).all()
            room = float(np.hypot(*(marks - spot).T).min())
            room = min(room, _LABEL_PT * 1.2) if inside else -1.0
            if room > best_room + 1e-6:
                best_offset, best_room = offset, room
        marks = np.vstack((marks, place + best_offset))
        axes.annotate(
            text,
            (float(anchor[0]), float(anchor[1])),
            xytext=best_offset,
            textcoords="offset points",
            ha="center",
            va="center",
            fontsize=_LABEL_PT,
            fontweight="bold",
            color=colour,
            zorder=8,
            bbox={"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.75},
        )


def _draw_scale_bar(axes: Axes, unit: str) -> None:
    """Draw a scale bar of a round length, at most a fifth of the map's width, and a north arrow, below the legend."""
    width = axes.get_xlim()[1] - axes.get_xlim()[0]
    power = 10.0 ** math.floor(math.log10(width / 5))
    length = max(power * step for step in (1, 2, 5) if power * step <= width / 5)
    fraction = length / width
    left, low = 1.03, 0.04
    style: dict[str, Any] = {"transform": axes.transAxes, "color": "#222222", "clip_on": False}
    axes.add_line(Line2D([left, left + fraction], [low, low], lw=2.0, **style))
    for end in (left, left + fraction):
        axes.add_line(Line2D([end, end], [low - 0.008, low + 0.008], lw=2.0, **style))
    axes.text(left + fraction / 2, low + 0.015, f"{length:g} {unit}", ha="center", va="bottom", fontsize=8.5, **style)
    axes.annotate(
        "N",
        (left + 0.02, low + 0.20),
        xytext=(left + 0.02, low + 0.09),
        xycoords="axes fraction",
        textcoords="axes fraction",
        ha="center",
        va="center",
        fontsize=10,
        arrowprops={"arrowstyle": "-|>", "color": "#222222", "lw": 1.5},
        annotation_clip=False,
    )


def _moved(axes: Axes, track: np.ndarray) -> bool:
    """Return whether a track (S, 2) leaves its start by more than MOVED_FRACTION of the map's width."""
    width = axes.get_xlim()[1] - axes.get_xlim()[0]
    return bool(np.abs(track - track[0]).max() > MOVED_FRACTION * width)


def _thinned(track: np.ndarray) -> np.ndarray:
    """Return a track (S, 2) thinned to about POINTS_PER_PATH points, with its last point."""
    stride = max(1, len(track) // POINTS_PER_PATH)
    return np.concatenate((track[:-1:stride], track[-1:]))


def _line(axes: Axes, t_s: np.ndarray, values: np.ndarray, colour: str) -> None:
    """Draw values over time, thinned to the least of each stretch of samples, so that no near approach is hidden."""
    stride = max(1, len(t_s) // POINTS_PER_PATH)
    starts = np.arange(0, len(t_s), stride)
    axes.plot(t_s[starts], np.fmin.reduceat(values, starts), color=colour, lw=1.3)


def _note(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, transform=axes.transAxes, ha="center", va="center", color="#666666")


def _metres(value_m: float) -> str:
    """Return a length in metres as a tick label, in km from 1000 m on."""
    return f"{value_m / 1_000:g} km" if abs(value_m) >= 1_000 else f"{value_m:g} m"


def _duration(time_s: float) -> str:
    """Return a duration in seconds as text for a caption, in s, min, or h and min."""
    if time_s < 120:
        return f"{time_s:g} s"
    minutes = round(time_s / 60)
    return f"{minutes} min" if minutes < 120 else f"{minutes // 60} h {minutes % 60:02d} min"
