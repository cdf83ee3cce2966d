"""Families of the field: what vehicles really meet, over every size, speed, step and link that a mission may have.

A recipe says between which bounds a mission's parts are drawn: its scene (`sim.arena.families.scenes`), the vehicle,
the steps, the threats that move, the link, the area in which the scene lies. Unlike the scenes of the other families
these are not drawn to be feasible: gaps go down to the resolution of the broadcast's grid, and starts may lie beside a
disc. Whether a mission is feasible is for the planner to say (`sim.arena.planner`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from companion.geo.kinematics import GRAVITY_M_S2
from companion.mission.model import (
    AgentSpec,
    Burst,
    CostWeights,
    LinkSpec,
    Mission,
    SteadyMotion,
    TargetSpec,
    ThreatMotion,
    ThreatSpec,
)
from companion.mission.values import MAX_COORDINATE_M
from sim.arena.families.drawing import (
    ATTACK_SHARE,
    PAPER_RADIUS_M,
    START_GAP,
    Family,
    NoRoomError,
    degrees,
    interaction_m,
    rounded,
)
from sim.arena.families.scenes import LEAST_DISC_M, SCENES, Scene, Size

GRID_UNITS = 32_767
"""Positions travel as 16-bit numbers (docs/wire.md): the area over this number is about the grid's resolution."""
LOAD_FACTORS = (0.1, 10.0)
RANGE_M = 1.0e8
"""Range of every agent, so great that no flight ends because it is used up."""
LEAST_LENGTH_M = 300.0
TURNS_AHEAD = 12.0
"""Least length of the way, in turn radii: with less no scene has room for a turn."""
CIRCLES = 8.0
"""Turning circles that the time limit allows for beside the way."""
HEARD = 1e-3
"""Chance, at most, that a frame of the first picture is not heard within the time that the limit allows for it."""
LOSSES = {"clear": 0.0, "loss30": 0.3, "loss60": 0.6, "loss90": 0.9, "burst": 0.0}
"""Share of frames lost, by the name of a link; `burst` loses in bursts."""
FIELD_COUNT = 15
"""Missions of each family of the field in a full arena."""

LONG_SCENES = ("crowd", "rooms")
"""Scenes of hundreds of discs, whose flights and plans take seconds."""
SMALL_LENGTH_STEPS = (20.0, 60.0)
SMALL_STEPS = 250
SMALL_FLEET = 3
"""Bounds of small missions: length in guidance steps, steps at the most, agents at the most."""
DRAWS = 40
"""Draws of one scene, or of a fleet's places in it, before another vehicle is drawn."""


@dataclass(frozen=True)
class Recipe:
    """Bounds between which a mission is drawn; pairs are the least and the greatest value."""

    scenes: tuple[str, ...] = tuple(SCENES)
    speeds_m_s: tuple[float, float] = (3.0, 250.0)
    steps_s: tuple[float, ...] = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
    length_steps: tuple[float, float] = (60.0, 250.0)
    """Length of the straight line in guidance steps, if it is that of TURNS_AHEAD turns at least."""
    greatest_steps: int = 1_500
    """Guidance steps after which a flight ends at the latest."""
    areas_m: tuple[float, float] = (500.0, 2 * MAX_COORDINATE_M)
    """Side of the square in which the scene lies; at least the scene's own."""
    movers: tuple[int, int] = (0, 0)
    """Number of threats that move."""
    motions: tuple[str, ...] = ("straight", "random", "chase")
    shares: tuple[float, float] = (0.05, 0.9)
    """Speed of the threats that move, as a share of the agent's."""
    links: tuple[str, ...] = ("clear",)
    agents: tuple[int, int] = (1, 1)

    def small(self) -> Recipe:
        """Return the recipe for missions that are flown in a fraction of a second."""
        return replace(
            self,
            scenes=tuple(scene for scene in self.scenes if scene not in LONG_SCENES),
            length_steps=SMALL_LENGTH_STEPS,
            greatest_steps=SMALL_STEPS,
            agents=(self.agents[0], min(self.agents[1], SMALL_FLEET)),
        )


class _Vehicle(NamedTuple):
    speed_m_s: float
    n_max: float
    step_s: float
    integration_s: float

    @property
    def turn_m(self) -> float:
        return self.speed_m_s**2 / (self.n_max * GRAVITY_M_S2)


class _Team(NamedTuple):
    starts_m: np.ndarray  # (N, 2)
    targets_m: np.ndarray  # (N, 2)
    separation_m: float
    detector_m: float


class _Air(NamedTuple):
    link: LinkSpec
    period_s: float
    wait_s: float
    """Time within which the whole of the first picture is heard, but for a chance of HEARD."""


class _Parts(NamedTuple):
    vehicle: _Vehicle
    team: _Team
    air: _Air
    scene: Scene
    threats: tuple[ThreatSpec, ...]
    limit_s: float


def drawn(generator: np.random.Generator, name: str, recipe: Recipe) -> Mission:
    """Return a mission drawn by a recipe; its name says the scene. Raise NoRoomError where the scene has no room."""
    vehicle = _vehicle(generator, recipe)
    kind = str(generator.choice(recipe.scenes))
    straight_m = _log_uniform(generator, recipe.length_steps) * vehicle.speed_m_s * vehicle.step_s
    length_m = float(np.clip(straight_m, max(LEAST_LENGTH_M, TURNS_AHEAD * vehicle.turn_m), 0.4 * MAX_COORDINATE_M))
    area_m = max(3.0 * length_m, _log_uniform(generator, recipe.areas_m))
    if generator.random() < 0.5:
        area_m = 3.0 * length_m
    area_m = min(area_m, 2 * MAX_COORDINATE_M)
    grid_m = max(area_m / GRID_UNITS, 0.1)
    gap_m = _log_uniform(generator, (grid_m, max(min(8.0 * vehicle.turn_m, 0.3 * length_m), 20.0 * grid_m)))
    scene = _laid(generator, SCENES[kind](generator, Size(length_m, vehicle.turn_m, gap_m)), area_m)
    team = _team(generator, scene, vehicle, int(generator.integers(recipe.agents[0], recipe.agents[1] + 1)))
    threats = _threats(generator, scene, vehicle, recipe)
    way_s = scene.way_m / vehicle.speed_m_s
    air = _air(generator, str(generator.choice(recipe.links)), math.ceil(max(1, len(threats)) / 4), way_s)
    limit_s = way_s + CIRCLES * math.tau * vehicle.turn_m / vehicle.speed_m_s + air.wait_s
    parts = _Parts(vehicle, team, air, scene, threats, min(limit_s, recipe.greatest_steps * vehicle.step_s))
    return _mission(generator, f"{name}-{kind}", parts)


def _log_uniform(generator: np.random.Generator, bounds: tuple[float, float]) -> float:
    return math.exp(generator.uniform(math.log(bounds[0]), math.log(max(bounds))))


def _vehicle(generator: np.random.Generator, recipe: Recipe) -> _Vehicle:
    step_s = float(generator.choice(recipe.steps_s))
    parts = int(generator.choice([1, 1, 2, 5]))
    speed_m_s = _log_uniform(generator, recipe.speeds_m_s)
    # A vehicle that turns wider than this does not fly TURNS_AHEAD turns in the length's steps.
    least = TURNS_AHEAD * speed_m_s / (GRAVITY_M_S2 * recipe.length_steps[1] * step_s)
    n_max = _log_uniform(generator, (min(max(LOAD_FACTORS[0], least), LOAD_FACTORS[1]), LOAD_FACTORS[1]))
    return _Vehicle(rounded(speed_m_s, 2), rounded(n_max, 4), step_s, step_s / parts)


def _laid(generator: np.random.Generator, scene: Scene, area_m: float) -> Scene:
    """Return a scene turned to a random side and laid somewhere into a square about the origin."""
    turn_rad = generator.uniform(0.0, math.tau)
    rotate = np.array([[math.cos(turn_rad), math.sin(turn_rad)], [-math.sin(turn_rad), math.cos(turn_rad)]])
    outlines = [scene.start_m[None], scene.target_m[None], scene.discs_m[:, :2], *scene.exclusions_m]
    outlines += [] if scene.fence_m is None else [scene.fence_m]
    turned = [outline @ rotate for outline in outlines]
    low_m, high_m = np.vstack(turned).min(axis=0), np.vstack(turned).max(axis=0)
    room_m = 0.5 * np.maximum(area_m - (high_m - low_m), 0.0)
    shift_m = -0.5 * (low_m + high_m) + generator.uniform(-1.0, 1.0, 2) * room_m
    placed = [np.round(outline + shift_m, 2) for outline in turned]
    if max(float(np.abs(outline).max(initial=0.0)) for outline in placed) > MAX_COORDINATE_M:
        raise NoRoomError
    exclusions_m = tuple(placed[3 : 3 + len(scene.exclusions_m)])
    return Scene(
        np.column_stack([placed[2], scene.discs_m[:, 2]]),
        placed[0][0],
        placed[1][0],
        scene.heading_rad + turn_rad,
        scene.way_m,
        None if scene.fence_m is None else placed[-1],
        exclusions_m,
    )


def _team(generator: np.random.Generator, scene: Scene, vehicle: _Vehicle, count: int) -> _Team:
    """Return the places of the agents and of their targets, far enough apart for the right of way."""
    separation_m = rounded(max(5.0, _log_uniform(generator, (0.3, 3.0)) * vehicle.speed_m_s))
    apart_m = interaction_m(separation_m, vehicle.n_max, vehicle.speed_m_s, vehicle.step_s)
    detector_m = rounded(max(2_000.0, 3.0 * apart_m))
    starts_m = _spread(generator, scene, scene.start_m, count, START_GAP * apart_m)
    targets_m = _spread(generator, scene, scene.target_m, count, START_GAP * apart_m + 3.0 * vehicle.turn_m)
    return _Team(starts_m, targets_m, separation_m, detector_m)


def _spread(generator: np.random.Generator, scene: Scene, middle_m: np.ndarray, count: int, gap_m: float) -> np.ndarray:
    """Return `count` places (N, 2) in m, the first the middle, a gap apart and outside all discs by a tenth of it."""
    places_m = middle_m[None]
    for _ in range(DRAWS * count):
        if len(places_m) == count:
            return places_m
        place_m = middle_m + generator.normal(0.0, gap_m * math.sqrt(count), 2)
        clear_m = np.linalg.norm(scene.discs_m[:, :2] - place_m, axis=-1) - scene.discs_m[:, 2]
        if (clear_m > 0.1 * gap_m).all() and (np.linalg.norm(places_m - place_m, axis=-1) >= gap_m).all():
            places_m = np.vstack([places_m, np.round(place_m, 2)])
    raise NoRoomError


def _threats(generator: np.random.Generator, scene: Scene, vehicle: _Vehicle, recipe: Recipe) -> tuple[ThreatSpec, ...]:
    """Return the scene's discs as threats, of which the first move, so many as the recipe says."""
    movers = int(generator.integers(recipe.movers[0], recipe.movers[1] + 1))
    discs_m = scene.discs_m
    if len(discs_m) < movers:
        between_m = scene.start_m + generator.uniform(0.15, 0.85, (movers, 1)) * (scene.target_m - scene.start_m)
        aside_m = generator.uniform(-0.2, 0.2, (movers, 2)) * np.linalg.norm(scene.target_m - scene.start_m)
        radius_m = max(LEAST_DISC_M, 0.02 * scene.way_m)
        discs_m = np.vstack([discs_m, np.column_stack([between_m + aside_m, np.full(movers, radius_m)])])
    order = generator.permutation(len(discs_m)) if movers else np.arange(len(discs_m))
    threats = []
    for index, (north_m, east_m, radius_m) in enumerate(discs_m[order]):
        speed_m_s, motion = 0.0, "static"
        if index < movers:
            speed_m_s = min(rounded(generator.uniform(*recipe.shares) * vehicle.speed_m_s, 2), 250.0)
            motion = str(generator.choice(recipe.motions))
        radius_m = rounded(radius_m, 2)
        threats.append(
            ThreatSpec(
                id=index + 1,
                north_m=rounded(north_m, 2),
                east_m=rounded(east_m, 2),
                detection_radius_m=radius_m,
                attack_radius_m=ATTACK_SHARE * radius_m,
                speed_bound_m_s=speed_m_s,
                motion=_motion(generator, motion, speed_m_s),
            )
        )
    return tuple(threats)


def _motion(generator: np.random.Generator, motion: str, speed_m_s: float) -> ThreatMotion:
    if motion == "straight":
        return SteadyMotion(heading_deg=degrees(generator.uniform(0.0, math.tau)), speed_m_s=speed_m_s)
    return "random" if motion == "random" else "chase" if motion == "chase" else "static"


def _air(generator: np.random.Generator, link: str, frames: int, way_s: float) -> _Air:
    """Return a link and how often is broadcast, so that a picture of so many frames is heard within the way's time."""
    burst = Burst(enter=0.1, leave=0.2, loss=1.0) if link == "burst" else None
    # In a burst a third of the frames is lost, five in a row.
    lost = 0.5 if link == "burst" else LOSSES[link]
    broadcasts = 1.0 if lost == 0.0 else math.log(HEARD / frames) / math.log(lost)
    period_s = _log_uniform(generator, (way_s / 100.0, way_s / 8.0)) if lost == 0.0 else way_s / broadcasts
    period_s = rounded(float(np.clip(period_s, 0.2, 60.0)), 1)
    return _Air(LinkSpec(loss=LOSSES[link], burst=burst), period_s, (broadcasts + 1.0) * period_s)


def _mission(generator: np.random.Generator, name: str, parts: _Parts) -> Mission:
    vehicle, team, air, scene = parts.vehicle, parts.team, parts.air, parts.scene
    step_m = vehicle.speed_m_s * vehicle.step_s
    arrival_m = _log_uniform(generator, (0.3, 4.0)) * max(step_m, 0.5 * vehicle.turn_m)
    radius_m = float(np.median(scene.discs_m[:, 2])) if len(scene.discs_m) else 300.0
    scale, paper = (radius_m / PAPER_RADIUS_M) ** 2, CostWeights()
    single = len(team.starts_m) == 1
    return Mission(
        name=name,
        fence=None if scene.fence_m is None else _polygon(scene.fence_m),
        exclusions=tuple(_polygon(outline_m) for outline_m in scene.exclusions_m),
        agents=tuple(
            AgentSpec(
                id=index + 1,
                north_m=float(north_m),
                east_m=float(east_m),
                heading_deg=degrees(scene.heading_rad),
                speed_m_s=vehicle.speed_m_s,
                n_max=vehicle.n_max,
                range_m=RANGE_M,
                only_target=None if single else index + 1,
            )
            for index, (north_m, east_m) in enumerate(team.starts_m)
        ),
        targets=tuple(
            TargetSpec(id=index + 1, north_m=float(north_m), east_m=float(east_m), speed_bound_m_s=0.0)
            for index, (north_m, east_m) in enumerate(team.targets_m)
        ),
        threats=parts.threats,
        weights=CostWeights(k_d=scale * paper.k_d, k_a=scale * paper.k_a, k_c=scale * paper.k_c, k_l=scale * paper.k_l),
        guidance_step_s=vehicle.step_s,
        integration_step_s=vehicle.integration_s,
        broadcast_period_s=air.period_s,
        assignment_period_s=max(25.0, air.period_s),
        link=air.link,
        arrival_radius_m=rounded(max(arrival_m, 1.0)),
        separation_m=team.separation_m,
        detector_range_m=team.detector_m,
        range_policy="arrive",
        max_time_s=rounded(parts.limit_s),
    )


def _polygon(outline_m: np.ndarray) -> tuple[tuple[float, float], ...]:  # (V, 2) m
    return tuple((float(north_m), float(east_m)) for north_m, east_m in outline_m)


def _family(title: str, description: str, knowledge: str, recipe: Recipe) -> Family:
    def draw(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
        return drawn(generator, name, recipe)

    return Family(
        title, description, knowledge, FIELD_COUNT, recipe.movers == (0, 0), recipe.agents == (1, 1), draw, True
    )


FIELD: dict[str, Family] = {
    "lattice": _family(
        "Lattices",
        "Equal discs on a square or honeycomb lattice, gaps from the grid's resolution up; the start before or in it.",
        "that gaps which the broadcast's grid cannot tell stay closed, and that others stay open",
        Recipe(scenes=("lattice",)),
    ),
    "rooms": _family(
        "Rooms",
        "One to three rooms of discs, joined by corridors of any length; start or target inside.",
        "that a corridor longer than any look-ahead leads somewhere",
        Recipe(scenes=("rooms",)),
    ),
    "gaps": _family(
        "Rings and walls",
        "A ring about start, target or both, or a wall, with one gap.",
        "the one way in",
        Recipe(scenes=("ring", "wall")),
    ),
    "crowd": _family(
        "Crowds",
        "100 to 400 small discs.",
        "to decide in time",
        Recipe(scenes=("crowd",)),
    ),
    "scales": _family(
        "Mixed radii",
        "8 to 60 discs whose radii differ by up to a thousand times, from 20 m to 20 km.",
        "that a small disc in the shadow of a great one counts",
        Recipe(scenes=("mixed",), length_steps=(100.0, 400.0)),
    ),
    "fences": _family(
        "Fences",
        "A fence, concave in most missions, with discs, with a wall that leaves a gap to it, or with exclusions.",
        "that a fence is a wall with corners to go round",
        Recipe(scenes=("fence",)),
    ),
    "frames": _family(
        "Frames lost",
        "Pictures of one or several frames over links that lose 30, 60 or 90 % of them, or in bursts.",
        "what has not been heard",
        Recipe(scenes=("scattered", "lattice", "rooms", "wall", "fence"), links=tuple(LOSSES)),
    ),
    "steps": _family(
        "Long steps",
        "Guidance steps of 2 and 5 s, integrated in one or several parts, among scattered discs.",
        "what happens between two decisions",
        Recipe(scenes=("open", "scattered", "wall", "fence"), steps_s=(2.0, 5.0)),
    ),
    "chasers": _family(
        "Chasers",
        "Four threats that chase the agent at 0.1 to 0.9 of its speed.",
        "for how long a way is clear of what may surround it",
        Recipe(scenes=("open", "scattered"), movers=(4, 4), motions=("chase",), shares=(0.1, 0.9)),
    ),
    "edges": _family(
        "At the edge",
        "A start near a disc, a target near another, a fence near one of them.",
        "how near is too near",
        Recipe(scenes=("edges",)),
    ),
}
"""The families of the field by name, in the order in which tables list them."""
