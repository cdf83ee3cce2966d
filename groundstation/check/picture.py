"""A picture of a mission: fence, exclusions, discs with both radii, targets with their arrival circles, agents.

It is drawn without pyplot, which has global state and may need a display.
"""

from __future__ import annotations

import io
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Polygon

from companion.mission.model import Mission, PathMotion
from groundstation.check.overview import ahead_m, bounds_m

DETECTION_COLOUR, ATTACK_COLOUR = "#1f5fd0", "#d01c1c"
TARGET_COLOUR, AGENT_COLOUR, WALL_COLOUR = "#111111", "#1b7f5e", "#7a5200"
KILOMETRES_FROM_M = 5_000.0
"""Width of the map from which its axes are in kilometres."""
MARGIN = 0.06
"""Space around everything, as a share of the map's width."""
HEADING_SHARE = 0.05
"""Length of an agent's heading, as a share of the map's width."""
DPI = 110
_LABEL: dict[str, Any] = {
    "textcoords": "offset points",
    "fontsize": 8.5,
    "fontweight": "bold",
    "zorder": 8,
    "bbox": {"boxstyle": "round,pad=0.1", "fc": "white", "ec": "none", "alpha": 0.75},
}


def mission_picture(mission: Mission, form: str) -> bytes:
    """Return a picture of a resolved mission, north up, as the bytes of a PNG or SVG file."""
    figure = Figure(figsize=(10.0, 8.2), dpi=DPI)
    axes = figure.add_axes((0.085, 0.08, 0.69, 0.85))
    unit_m, width_m = _frame(axes, mission)
    legend = _walls(axes, mission, unit_m)
    legend += _threats(axes, mission, unit_m)
    legend += _targets(axes, mission, unit_m)
    legend += _agents(axes, mission, unit_m, HEADING_SHARE * width_m)
    figure.suptitle(mission.name, x=0.43, y=0.975, fontsize=12, parse_math=False)
    axes.legend(handles=legend, loc="upper left", bbox_to_anchor=(1.02, 1.0), fontsize=8.5, frameon=False)
    buffer = io.BytesIO()
    # Without software and date, and with names that are not drawn by chance, the same mission gives the same bytes.
    with rc_context({"svg.hashsalt": mission.name}):
        figure.savefig(buffer, format=form, metadata={"Software": None} if form == "png" else {"Date": None})
    return buffer.getvalue()


def _frame(axes: Axes, mission: Mission) -> tuple[float, float]:
    """Set the map's limits, with equal scales; return the axes' unit and the map's width in metres."""
    low_m, high_m = bounds_m(mission)
    width_m = max(high_m[0] - low_m[0], high_m[1] - low_m[1], 1.0)
    unit_m, unit = (1_000.0, "km") if width_m >= KILOMETRES_FROM_M else (1.0, "m")
    half_m = width_m * (0.5 + MARGIN)
    north_m, east_m = ((low + high) / 2.0 for low, high in zip(low_m, high_m, strict=True))
    axes.set_xlim((east_m - half_m) / unit_m, (east_m + half_m) / unit_m)
    axes.set_ylim((north_m - half_m) / unit_m, (north_m + half_m) / unit_m)
    axes.set_aspect("equal")
    axes.grid(True, color="#e6e6e6", lw=0.6)
    axes.set_axisbelow(True)
    axes.set_xlabel(f"east ({unit})")
    axes.set_ylabel(f"north ({unit})")
    return unit_m, width_m


def _walls(axes: Axes, mission: Mission, unit_m: float) -> list[Line2D]:
    legend = []
    if mission.fence is not None:
        axes.add_patch(Polygon(_corners(mission.fence, unit_m), fill=False, ec=WALL_COLOUR, lw=1.4, zorder=2))
        legend.append(Line2D([], [], color=WALL_COLOUR, lw=1.4, label="fence"))
    for exclusion in mission.exclusions:
        axes.add_patch(Polygon(_corners(exclusion, unit_m), fc="none", ec=WALL_COLOUR, lw=0.8, hatch="////", zorder=2))
    if mission.exclusions:
        legend.append(Line2D([], [], color=WALL_COLOUR, lw=0.8, ls=(0, (1, 1)), label="exclusion (hatched)"))
    return legend


def _threats(axes: Axes, mission: Mission, unit_m: float) -> list[Line2D]:
    for threat in mission.threats:
        north, east = (along / unit_m for along in threat.position_ned_m)
        radii_m = {DETECTION_COLOUR: threat.detection_radius_m, ATTACK_COLOUR: threat.attack_radius_m}
        for colour, radius_m in radii_m.items():
            axes.add_patch(Circle((east, north), radius_m / unit_m, fc=colour, alpha=0.06, lw=0, zorder=1))
            axes.add_patch(Circle((east, north), radius_m / unit_m, fill=False, ec=colour, lw=1.5, zorder=2))
        _path(axes, threat.motion, unit_m, ATTACK_COLOUR)
        number: dict[str, Any] = {"xytext": (0, 0), "ha": "center", "va": "center", "color": ATTACK_COLOUR}
        axes.annotate(f"{threat.id}", (east, north), **number, **_LABEL)
    circle: dict[str, Any] = {"ls": "", "marker": "o", "mfc": "none", "mew": 1.5}
    return [
        Line2D([], [], ms=11, mec=DETECTION_COLOUR, label="threat: detection radius R_d", **circle),
        Line2D([], [], ms=7, mec=ATTACK_COLOUR, label="threat: attack radius R_a", **circle),
    ][: 2 * bool(mission.threats)]


def _targets(axes: Axes, mission: Mission, unit_m: float) -> list[Line2D]:
    for target in mission.targets:
        north, east = (along / unit_m for along in target.position_ned_m)
        axes.plot(east, north, ls="", marker="+", ms=11, mew=2.0, color=TARGET_COLOUR, zorder=6)
        arrival = Circle((east, north), mission.arrival_radius_m / unit_m, fill=False, ec=TARGET_COLOUR, lw=0.8, ls=":")
        axes.add_patch(arrival)
        _path(axes, target.motion, unit_m, TARGET_COLOUR)
        axes.annotate(f"{target.id}", (east, north), xytext=(9, 9), ha="center", color=TARGET_COLOUR, **_LABEL)
    return [
        Line2D([], [], ls="", marker="+", ms=11, mew=2.0, color=TARGET_COLOUR, label="target and number"),
        Line2D([], [], color=TARGET_COLOUR, lw=0.8, ls=":", label="arrival radius"),
    ]


def _agents(axes: Axes, mission: Mission, unit_m: float, length_m: float) -> list[Line2D]:
    for agent in mission.agents:
        north, east = (along / unit_m for along in agent.position_ned_m)
        tip = ahead_m(agent.position_ned_m, agent.heading_deg or 0.0, length_m)
        arrow = {"arrowstyle": "-|>", "color": AGENT_COLOUR, "lw": 1.3, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", (tip[1] / unit_m, tip[0] / unit_m), xytext=(east, north), arrowprops=arrow, zorder=6)
        axes.plot(east, north, ls="", marker="o", ms=6, mfc=AGENT_COLOUR, mec="white", mew=0.6, zorder=7)
        axes.annotate(f"{agent.id}", (east, north), xytext=(-9, -11), ha="center", color=AGENT_COLOUR, **_LABEL)
    return [Line2D([], [], marker="o", ms=6, color=AGENT_COLOUR, label="agent, number and heading")]


def _path(axes: Axes, motion: object, unit_m: float, colour: str) -> None:
    if isinstance(motion, PathMotion):
        north, east = ([point[axis] / unit_m for point in motion.path] for axis in (1, 2))
        axes.plot(east, north, color=colour, lw=0.7, alpha=0.7, zorder=2)


def _corners(polygon: tuple[tuple[float, float], ...], unit_m: float) -> list[tuple[float, float]]:
    return [(east_m / unit_m, north_m / unit_m) for north_m, east_m in polygon]
