"""The scenes in which guidance laws are compared: families of missions, each drawn from a seed.

A mission depends on its family, seed and index alone; it is resolved, and `sim fly` can fly it. Places are chosen by
geometry only, so that most missions are feasible; no route is planned and no law is flown for it. Whether a mission is
feasible is decided by the planner (`sim.arena.planner`).

Lengths are modest so that one flight takes a few hundred guidance steps: vehicles of 25 m/s, discs of 200 to 1000 m.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.errors import InputError
from companion.geo.kinematics import GRAVITY_M_S2, turn_rate_rad_s
from companion.geo.right_of_way import Rules, interaction_radius_m
from companion.mission.model import (
    AgentSpec,
    Burst,
    CostWeights,
    LinkSpec,
    Loss,
    Mission,
    PathMotion,
    SteadyMotion,
    TargetSpec,
    ThreatMotion,
    ThreatSpec,
    Wind,
    load_mission,
)
from companion.mission.random_streams import random_stream
from companion.mission.resolve import check_start, resolve
from sim.arena.planner import ground_turn_radius_m, target_stays_clear

ARENA_STREAM = 11
"""Number of the random stream, among those of the seed, that arena scenes are drawn from."""
SPEED_M_S = 25.0
GUIDANCE_STEP_S = 0.5
GREATEST_TURN_RAD = 0.25
"""Greatest turn in one guidance step: a law that decides once a step must be able to follow an arc."""
N_MAX = (0.5, 1.25)
"""Least and greatest load factor: turn radii of 127 to 51 m at 25 m/s, which steps of 0.5 s can follow."""
RANGE_M = 500_000.0
"""Range of every agent, so great that no flight ends because it is used up."""
TIME_SHARE = 2.5
"""Time limit of a flight, as a multiple of the time that the straight line to the target takes."""
LEAST_TIME_SHARE = 1.3
"""Least time limit, as a multiple of the straight line's time, of a flight whose limit is lowered so that fast threats
do not come to the target before the end; an agent that loses time there arrives too late."""
GROWTH_SHARE = 0.55
"""Greatest distance that a threat may cover in a flight, as a share of the straight line; the time limit is lowered for
it, but not below LEAST_TIME_SHARE. All threats begin farther from the target than they can come, so that with a greater
share none could be in the agent's way."""
SWARM_TIME_SHARE = 5.0
"""Time limit of a swarm, as a multiple of the straight line's time: in a roundabout some agents go round several times
(docs/separation.md)."""
TRAP_TIME_SHARE = 5.0
"""Time limit among traps, as a multiple of the straight line's time: the way out of a spiral alone takes more than
twice that time."""
ATTACK_SHARE = 0.5
"""R_a / R_d, as in the paper."""
CLEARANCE_SHARE = 0.1
"""Distance, as a share of R_d, that starts, targets and the turning circles beside them keep from every disc."""
PAPER_RADIUS_M = 10_000.0
"""The paper's R_d. The paper's weights are areas and are scaled by the square of the scene's radius over this one."""
SEPARATION_M = 40.0
"""Separation of the scenes, for 25 m/s; the paper has 100 m for 60 m/s."""
TARGET_GAP_M = 300.0
"""Least distance between two targets of a swarm: an agent that has arrived loiters there, and nearer loiter circles
would close the way to the next target (1.2 times the sum of a separation and three turn radii at the swarm's load
factor is 230 m)."""
START_GAP = 1.05
"""Least distance between two agents' starts, as a multiple of the interaction radius of the right-of-way rule."""
GREATEST_CROSSING_M = 4_950.0
"""Greatest distance that an agent of a swarm has to cross: about 400 guidance steps."""
PAPER_TIME_S = 2_400.0
"""Time limit of the paper's scenes: in it an agent flies 144 km at 60 m/s, and a threat of 10 m/s at most 24 km. Within
the default of 20 000 s every disc would grow over the whole square."""
PAPER_THREAT_M_S = 10.0
PAPER_WALK_M = 2_000.0
"""Distance around a walking target's start that is kept clear of every disc: 480 steps of 50 m in random directions
lead 1.1 km (rms) away from the start."""
PAPER_STEP_S = 1.0
TRIES = 2_000
"""Draws of one place, or of one scene, before giving up."""
DECIMALS = 1
"""Positions are rounded to 0.1 m and headings to 0.1 degrees, so that a mission file reads well."""


@dataclass(frozen=True)
class Family:
    """A family of scenes: how its missions are drawn, and what they test."""

    title: str
    description: str
    knowledge: str
    """What a law must know or do to succeed in this family, and what simpler laws leave out."""
    share: float
    """Share of a full arena's missions that belong to the family; the shares of all families sum to 1."""
    static: bool
    """Whether no threat moves in any mission of the family."""
    single: bool
    """Whether every mission of the family has a single agent."""
    draw: Callable[[np.random.Generator, str, float | None], Mission]
    """Function that draws a mission from a generator, the mission's name and the least distance between starts in m
    (None: the interaction radius of the right-of-way rule)."""


@dataclass(frozen=True)
class _Disc:
    """A threat before it becomes part of a mission: where it starts, its radius R_d and how it moves."""

    north_m: float
    east_m: float
    radius_m: float
    motion: ThreatMotion = "static"
    speed_bound_m_s: float = 0.0


@dataclass(frozen=True)
class _Pose:
    north_m: float
    east_m: float
    heading_deg: float


def draw(family: str, seed: int, index: int, interaction_radius_m: float | None = None) -> Mission:
    """Return mission `index` of a family: resolved, its start legal, the same for the same arguments.

    Where a family has several agents they start at least the interaction radius apart: that of the right-of-way rule at
    their own load factor, or the given one. Where the scene would grow too wide for a short flight, there are fewer
    agents.

    Raises KeyError for an unknown family, RuntimeError if no scene was found within TRIES draws.
    """
    generator = random_stream(seed, ARENA_STREAM, zlib.crc32(family.encode()), index)
    for _ in range(TRIES):
        try:
            mission = FAMILIES[family].draw(generator, f"{family}-{seed}-{index}", interaction_radius_m)
            check_start(mission, mission.name)
        except (_NoRoomError, InputError):
            continue
        return mission
    raise RuntimeError(f"{family}: no scene in {TRIES} draws")


class _NoRoomError(Exception):
    """Raised where a scene has no room for another place; another draw of the scene may have it."""


def _paper(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    kind = str(generator.choice(["static", "dynamic"]))
    packaged = load_mission(f"paper-{kind}")
    reach_s = PAPER_TIME_S + PAPER_WALK_M / PAPER_THREAT_M_S
    agent = AgentSpec(id=1, **packaged.defaults.agent.model_dump(exclude_none=True))
    gap_m = radius_m or _interaction_m(packaged.separation_m, agent.n_max, agent.speed_m_s, PAPER_STEP_S)
    for _ in range(TRIES):
        mission = resolve(packaged, int(generator.integers(2**31)))
        apart_m = _least_gap_m(np.array([agent.position_ned_m for agent in mission.agents]))
        clear = all(target_stays_clear(mission, target.position_ned_m, reach_s) for target in mission.targets)
        if clear and apart_m >= gap_m:
            changes = {
                "name": f"{name}-{kind}",
                "guidance_step_s": PAPER_STEP_S,
                "integration_step_s": PAPER_STEP_S,
                "range_policy": "arrive",
                "max_time_s": PAPER_TIME_S,
            }
            return mission.model_copy(update=changes)
    raise _NoRoomError


def _dense(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    discs = _scattered(generator, int(generator.integers(10, 61)), generator.uniform(0.15, 0.6), (200.0, 1000.0))
    return _single(generator, f"{name}-{len(discs)}", discs, _radius_m(generator.uniform(*N_MAX)))


def _tight(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    share = math.exp(generator.uniform(math.log(0.05), math.log(1.0)))
    # A turn radius below this cannot be followed at the guidance step.
    least_m = SPEED_M_S * GUIDANCE_STEP_S / GREATEST_TURN_RAD
    disc_m = generator.uniform(max(200.0, least_m / share), 1000.0 + 1e-6)
    count = int(generator.integers(8, 26))
    side_m = max(5000.0, disc_m * math.sqrt(count * math.pi / 0.45))
    centres_m = generator.uniform(0.0, side_m, (count, 2))
    discs = [_Disc(_rounded(n), _rounded(e), _rounded(disc_m)) for n, e in centres_m]
    return _single(generator, f"{name}-{share:.2f}R", discs, share * disc_m)


def _traps(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    n_max = generator.uniform(0.8, N_MAX[1])
    kind = str(generator.choice(["u", "spiral", "corridor"]))
    trap = {"u": _u_trap, "spiral": _spiral_trap, "corridor": _corridor_trap}[kind]
    discs_m, start_m, target_m, heading_rad = trap(generator, _radius_m(n_max))
    # Turned to a random side, and mirrored in half of the draws.
    turn_rad, mirror = generator.uniform(0.0, math.tau), generator.choice([-1.0, 1.0])

    def placed(point_m: np.ndarray) -> tuple[float, float]:
        north_m, east_m = float(point_m[0]), mirror * float(point_m[1])
        cosine, sine = math.cos(turn_rad), math.sin(turn_rad)
        return _rounded(cosine * north_m - sine * east_m), _rounded(sine * north_m + cosine * east_m)

    discs = [_Disc(*placed(row[:2]), _rounded(row[2])) for row in discs_m]
    heading_deg = _degrees(turn_rad + mirror * heading_rad)
    pose = _Pose(*placed(start_m), heading_deg)
    mission = _mission(f"{name}-{kind}", [pose], [placed(target_m)], discs, n_max)
    return mission.model_copy(update={"max_time_s": _rounded(TRAP_TIME_SHARE / TIME_SHARE * mission.max_time_s)})


def _u_trap(
    generator: np.random.Generator, turn_radius_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:  # (M, 3) m, (2,) m, (2,) m
    """Return discs on an arc open to the south, with a start, a target and a heading in rad.

    The start lies within the arc or south of it, the target north of it.
    """
    radius_m = generator.uniform(200.0, 300.0)
    bow_m = radius_m * generator.uniform(2.6, 3.4)
    half_rad = generator.uniform(math.radians(100), math.radians(140))
    count = math.ceil(2 * half_rad * bow_m / (1.5 * radius_m)) + 1
    angles_rad = np.linspace(-half_rad, half_rad, count)
    centres_m = bow_m * np.column_stack([np.cos(angles_rad), np.sin(angles_rad)])
    start_m = np.array([generator.choice([0.0, -2.0, -4.0]) * bow_m, 0.0])
    target_m = np.array([bow_m + radius_m + generator.uniform(600.0, 1500.0), generator.uniform(-400.0, 400.0)])
    return _with_radius(centres_m, radius_m), start_m, target_m, generator.uniform(-0.5, 0.5)


def _spiral_trap(
    generator: np.random.Generator, turn_radius_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:  # (M, 3) m, (2,) m, (2,) m
    """Return discs along a spiral of more than one turn, with a start, a target and a heading in rad.

    The start is the spiral's centre; the target lies outside, on another side than the spiral's mouth.
    """
    radius_m = 200.0
    lane_m = 5.0 * turn_radius_m + generator.uniform(0.0, 100.0)
    pitch_m = lane_m + 2 * radius_m
    turns = generator.uniform(1.15, 1.4)
    inner_m = lane_m / 2 + radius_m + 100.0
    angles_rad = [0.0]
    while angles_rad[-1] < turns * math.tau:
        bow_m = inner_m + pitch_m * angles_rad[-1] / math.tau
        angles_rad.append(angles_rad[-1] + 1.4 * radius_m / bow_m)
    angle_rad = np.array(angles_rad)
    bows_m = inner_m + pitch_m * angle_rad / math.tau
    centres_m = bows_m[:, None] * np.column_stack([np.cos(angle_rad), np.sin(angle_rad)])
    bearing_rad = angle_rad[-1] + generator.uniform(0.6, 1.4) * math.pi
    distance_m = bows_m[-1] + radius_m + generator.uniform(300.0, 800.0)
    target_m = distance_m * np.array([math.cos(bearing_rad), math.sin(bearing_rad)])
    return _with_radius(centres_m, radius_m), np.zeros(2), target_m, generator.uniform(0.0, math.tau)


def _corridor_trap(
    generator: np.random.Generator, turn_radius_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:  # (M, 3) m, (2,) m, (2,) m
    """Return discs along two walls and the end that closes them, with a start, a target and a heading in rad.

    In half of the draws one wall has a door. The start lies between or before the walls, the target behind the end.
    """
    radius_m = generator.uniform(200.0, 260.0)
    half_m = 2.6 * turn_radius_m + radius_m + generator.uniform(0.0, 150.0)
    depth_m = generator.uniform(1000.0, 1700.0)
    along_m = np.linspace(0.0, depth_m, math.ceil(depth_m / (1.4 * radius_m)) + 1)
    across_m = np.linspace(-half_m, half_m, math.ceil(2 * half_m / (1.4 * radius_m)) + 1)[1:-1]
    left_m = np.column_stack([along_m, np.full(along_m.size, -half_m)])
    right_m = np.column_stack([along_m, np.full(along_m.size, half_m)])
    if generator.random() < 0.5:
        # A door: without its discs the gap is wider than two turn circles.
        door = len(along_m) // 2
        right_m = np.delete(right_m, [door - 1, door, door + 1], axis=0)
    end_m = np.column_stack([np.full(across_m.size, depth_m), across_m])
    start_m = np.array([generator.choice([-600.0, 0.2 * depth_m, 0.5 * depth_m]), 0.0])
    target_m = np.array([depth_m + radius_m + generator.uniform(600.0, 1200.0), generator.uniform(-400.0, 400.0)])
    return _with_radius(np.vstack([left_m, right_m, end_m]), radius_m), start_m, target_m, generator.uniform(-0.4, 0.4)


def _moving(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    share = round(generator.uniform(0.1, 0.7), 2)
    kind = str(generator.choice(["straight", "circling", "random", "chasing"]))
    count = int(generator.integers(3, 9))
    return _among_movers(generator, f"{name}-{kind}-{share:.2f}v", [kind] * count, [share * SPEED_M_S] * count)


def _stale(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    period_s = round(generator.uniform(5.0, 30.0), 1)
    count = int(generator.integers(4, 11))
    kinds = [str(kind) for kind in generator.choice(["static", "straight", "circling", "random"], count)]
    speeds_m_s = [0.0 if kind == "static" else generator.uniform(0.02, 0.2) * SPEED_M_S for kind in kinds]
    burst = Burst(
        enter=_rounded(generator.uniform(0.02, 0.2), 3),
        leave=_rounded(generator.uniform(0.2, 0.6), 3),
        loss=_rounded(generator.uniform(0.7, 1.0), 3),
    )
    mission = _among_movers(generator, f"{name}-{period_s:g}s", kinds, speeds_m_s)
    return mission.model_copy(update={"broadcast_period_s": period_s, "link": LinkSpec(burst=burst)})


def _wind(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    total_m_s = generator.uniform(0.1, 1.0 / 3.0) * SPEED_M_S
    gust_m_s = _rounded(generator.uniform(0.1, 0.5) * total_m_s)
    wind = Wind(
        from_deg=_degrees(generator.uniform(0.0, math.tau)), speed_m_s=_rounded(total_m_s - gust_m_s), gust_m_s=gust_m_s
    )
    discs = _scattered(generator, int(generator.integers(8, 21)), generator.uniform(0.1, 0.4), (200.0, 800.0))
    n_max = generator.uniform(*N_MAX)
    # The circle over the ground, at the speed with the wind behind.
    widest_m = ground_turn_radius_m(SPEED_M_S, n_max, wind.speed_m_s + wind.gust_m_s)
    mission = _single(generator, f"{name}-{total_m_s / SPEED_M_S:.2f}v", discs, widest_m)
    agent = mission.agents[0].model_copy(update={"n_max": _rounded(n_max, 4)})
    # Against the wind the straight line takes longer.
    slowest_share = 1.0 - total_m_s / SPEED_M_S
    return mission.model_copy(
        update={"agents": (agent,), "wind": wind, "max_time_s": _rounded(mission.max_time_s / slowest_share)}
    )


def _swarm(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    kind = str(generator.choice(["circle", "streams", "random"]))
    pattern = {"circle": _circle_swarm, "streams": _stream_swarm, "random": _random_swarm}[kind]
    count, number_of_discs = int(generator.integers(10, 51)), int(generator.choice([0, 0, 2, 3]))
    n_max = N_MAX[1]
    spacing_m = START_GAP * (radius_m or _interaction_m(SEPARATION_M, n_max, SPEED_M_S, GUIDANCE_STEP_S))
    for _ in range(TRIES):
        try:
            starts_m, targets_m = pattern(generator, count, spacing_m)
            discs = _few_discs(generator, number_of_discs, starts_m, targets_m, 2 * _radius_m(n_max))
        except _NoRoomError:
            continue
        headings_rad = np.arctan2(*(targets_m - starts_m).T[::-1])
        poses = [
            _Pose(_rounded(n), _rounded(e), _degrees(rad)) for (n, e), rad in zip(starts_m, headings_rad, strict=True)
        ]
        targets = [(_rounded(n), _rounded(e)) for n, e in targets_m]
        mission = _mission(f"{name}-{kind}-{len(poses)}", poses, targets, discs, n_max, crossing=True)
        return mission.model_copy(update={"max_time_s": _rounded(SWARM_TIME_SHARE / TIME_SHARE * mission.max_time_s)})
    raise _NoRoomError


def _few_discs(
    generator: np.random.Generator, number: int, starts_m: np.ndarray, targets_m: np.ndarray, clear_m: float
) -> list[_Disc]:
    """Return `number` discs near the middle of the starts and targets, (N, 2) each, all of which they leave clear."""
    ends_m = np.vstack([starts_m, targets_m])
    discs: list[_Disc] = []
    for _ in range(TRIES):
        if len(discs) == number:
            return discs
        north_m, east_m = ends_m.mean(axis=0) + generator.uniform(-700.0, 700.0, 2)
        disc = _Disc(_rounded(north_m), _rounded(east_m), _rounded(generator.uniform(150.0, 300.0)))
        if not _covers(disc, ends_m, clear_m):
            discs.append(disc)
    raise _NoRoomError


def _circle_swarm(
    generator: np.random.Generator, count: int, spacing_m: float
) -> tuple[np.ndarray, np.ndarray]:  # (N, 2) m, (N, 2) m
    """Return starts on a circle and targets near their antipodes; fewer than `count` if the circle gets too wide."""
    count = max(10, min(count, int(math.pi * GREATEST_CROSSING_M / spacing_m)))
    bow_m = max(800.0, count * spacing_m / math.tau)
    # Turned a little off the antipode, so that no target is another's start when the count is even.
    angles_rad = math.tau * np.arange(count) / count
    off_rad = generator.uniform(0.2, 0.8) * math.tau / count
    starts_m = bow_m * np.column_stack([np.cos(angles_rad), np.sin(angles_rad)])
    angles_rad = angles_rad + math.pi + off_rad
    return starts_m, bow_m * np.column_stack([np.cos(angles_rad), np.sin(angles_rad)])


def _stream_swarm(
    generator: np.random.Generator, count: int, spacing_m: float
) -> tuple[np.ndarray, np.ndarray]:  # (N, 2) m, (N, 2) m
    """Return starts and targets of two blocks of agents that fly through each other head-on or at an angle."""
    # The blocks are small enough to have passed through each other in time.
    half = min(math.ceil(count / 2), max(5, int((0.5 * GREATEST_CROSSING_M / spacing_m) ** 2)))
    count = min(count, 2 * half)
    rows = math.ceil(math.sqrt(half))
    places = np.array([(index // rows, index % rows) for index in range(half)], dtype=float)
    block_m = spacing_m * (places - places.mean(axis=0))
    block_m += generator.uniform(-0.04, 0.04, block_m.shape) * spacing_m
    length_m = rows * spacing_m / 2 + generator.uniform(0.3, 0.6) * rows * spacing_m
    angle_rad = generator.uniform(math.radians(60), math.pi)
    turn = np.array([[math.cos(angle_rad), -math.sin(angle_rad)], [math.sin(angle_rad), math.cos(angle_rad)]])
    first_m = block_m - (length_m, 0.0)
    second_m = (block_m[: count - half] - (length_m, 0.0)) @ turn.T
    starts_m = np.vstack([first_m, second_m])
    targets_m = np.vstack([first_m + (2 * length_m, 0.0), second_m + turn @ (2 * length_m, 0.0)])
    if _least_gap_m(starts_m) < spacing_m / START_GAP or _least_gap_m(targets_m) < TARGET_GAP_M:
        raise _NoRoomError
    return starts_m, targets_m


def _random_swarm(
    generator: np.random.Generator, count: int, spacing_m: float
) -> tuple[np.ndarray, np.ndarray]:  # (N, 2) m, (N, 2) m
    side_m = min(max(1500.0, 1.5 * spacing_m * math.sqrt(count)), GREATEST_CROSSING_M / math.sqrt(2.0))
    count = max(10, min(count, int((side_m / (1.5 * spacing_m)) ** 2)))
    starts_m = _apart(generator, count, side_m, spacing_m)
    targets_m = _apart(generator, count, side_m, TARGET_GAP_M)
    return starts_m, targets_m


def _losses(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    mission = _team(generator, name, radius_m, agents=(6, 13), targets=(3, 5), discs=(2, 7))
    count = len(mission.agents)
    lost = generator.permutation(count)[: int(generator.integers(2, count - len(mission.targets) + 1))]
    times_s = generator.uniform(5.0, 0.4 * mission.max_time_s, len(lost))
    losses = tuple(
        Loss(agent=mission.agents[index].id, t_s=_rounded(t_s)) for index, t_s in zip(lost, times_s, strict=True)
    )
    return mission.model_copy(update={"name": f"{name}-{len(losses)}of{count}", "losses": losses, "lost_after_s": 10.0})


def _case_two(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    mission = _team(generator, name, radius_m, agents=(4, 9), targets=(3, 5), discs=(3, 9))
    report_s = float(generator.choice([0.0, 10.0, 20.0]))
    return mission.model_copy(
        update={
            "name": f"{name}-{'silent' if report_s == 0.0 else f'{report_s:g}s'}",
            "case": "II",
            "report_period_s": report_s,
            "lost_after_s": 2.5 * report_s or 30.0,
        }
    )


def _team(
    generator: np.random.Generator,
    name: str,
    radius_m: float | None,
    agents: tuple[int, int],
    targets: tuple[int, int],
    discs: tuple[int, int],
) -> Mission:
    """Return a mission of several agents from one side to targets on the other, among static discs.

    `agents`, `targets` and `discs` each give the least number and the greatest plus one.
    """
    n_max = generator.uniform(0.8, N_MAX[1])
    spacing_m = START_GAP * (radius_m or _interaction_m(SEPARATION_M, n_max, SPEED_M_S, GUIDANCE_STEP_S))
    n_agents, n_targets = int(generator.integers(*agents)), int(generator.integers(*targets))
    side_m = max(3000.0, 3 * n_agents * spacing_m**2 / (1000.0 + spacing_m) - spacing_m)
    starts_m = _apart(generator, n_agents, (1000.0, side_m), spacing_m)
    targets_m = _apart(generator, n_targets, (800.0, side_m), 500.0) + (3400.0, 0.0)
    scattered = []
    for _ in range(int(generator.integers(*discs))):
        north_m, east_m = generator.uniform((1000.0, 0.0), (3400.0, side_m))
        scattered.append(_Disc(_rounded(north_m), _rounded(east_m), _rounded(generator.uniform(200.0, 500.0))))
    if any(_covers(disc, np.vstack([starts_m, targets_m]), 2 * _radius_m(n_max)) for disc in scattered):
        raise _NoRoomError
    poses = [_Pose(_rounded(n), _rounded(e), _degrees(generator.uniform(0.0, math.tau))) for n, e in starts_m]
    return _mission(name, poses, [(_rounded(n), _rounded(e)) for n, e in targets_m], scattered, n_max)


def _among_movers(
    generator: np.random.Generator, name: str, kinds: Sequence[str], speeds_m_s: Sequence[float]
) -> Mission:
    """Return a single agent's mission among threats of the given kinds, none of which can reach the target in time."""
    n_max = generator.uniform(0.8, N_MAX[1])
    length_m = generator.uniform(3000.0, 4500.0)
    bearing_rad = generator.uniform(0.0, math.tau)
    line_m = length_m * np.array([math.cos(bearing_rad), math.sin(bearing_rad)])
    fastest_share = max(speeds_m_s) / SPEED_M_S
    time_share = max(LEAST_TIME_SHARE, min(TIME_SHARE, GROWTH_SHARE / max(fastest_share, 1e-9)))
    max_time_s = _rounded(time_share * length_m / SPEED_M_S)
    discs = []
    for kind, speed_m_s in zip(kinds, speeds_m_s, strict=True):
        radius_m = _rounded(generator.uniform(200.0, 450.0))
        clear_of_start_m = radius_m * (1 + CLEARANCE_SHARE) + 2 * _radius_m(n_max) + 5.0 * speed_m_s
        clear_of_target_m = radius_m * (1 + CLEARANCE_SHARE) + 100.0 + speed_m_s * max_time_s
        for attempt in range(TRIES):
            # Where a threat cannot begin in the way, as among the fastest, it begins anywhere.
            spread = 0.8 if attempt < TRIES // 4 else 10.0
            place_m, course_rad = _in_the_way(generator, kind, speed_m_s, radius_m, spread, line_m)
            if np.hypot(*place_m) >= clear_of_start_m and np.hypot(*(place_m - line_m)) >= clear_of_target_m:
                break
        else:
            raise _NoRoomError
        place = _rounded(place_m[0]), _rounded(place_m[1])
        motion = _motion(generator, kind, place, course_rad, speed_m_s, max_time_s)
        discs.append(_Disc(*place, radius_m, motion, _rounded(speed_m_s, 3)))
    pose = _Pose(0.0, 0.0, _degrees(bearing_rad + generator.uniform(-1.0, 1.0)))
    mission = _mission(name, [pose], [(_rounded(line_m[0]), _rounded(line_m[1]))], discs, n_max)
    return mission.model_copy(update={"max_time_s": max_time_s})


def _in_the_way(
    generator: np.random.Generator, kind: str, speed_m_s: float, radius_m: float, spread: float, line_m: np.ndarray
) -> tuple[np.ndarray, float]:  # (2,) m, rad
    """Return where a threat begins and its course, such that it is in the way of an agent on a line from the origin.

    One that flies straight is at a point of the line when the agent comes there; one of another kind begins at that
    point. The point lies up to `spread` radii aside of the line; a chasing threat begins up to 3 radii farther aside.
    """
    share, aside = generator.uniform((0.1, -spread), (0.9, spread))
    across = np.array([-line_m[1], line_m[0]]) / np.hypot(*line_m)
    point_m = share * line_m + aside * radius_m * across
    course_rad = generator.uniform(0.0, math.tau)
    if kind == "straight":
        way_m = speed_m_s * share * np.hypot(*line_m) / SPEED_M_S
        point_m = point_m - way_m * np.array([math.cos(course_rad), math.sin(course_rad)])
    elif kind == "chasing":
        point_m = point_m + generator.uniform(-3.0, 3.0) * radius_m * across
    return point_m, course_rad


def _motion(
    generator: np.random.Generator,
    kind: str,
    place_m: tuple[float, float],
    course_rad: float,
    speed_m_s: float,
    until_s: float,
) -> ThreatMotion:
    if kind == "straight":
        return SteadyMotion(heading_deg=_degrees(course_rad), speed_m_s=math.floor(1000 * speed_m_s) / 1000)
    if kind == "circling":
        return _circling(generator, place_m, speed_m_s, until_s)
    return "random" if kind == "random" else "chase" if kind == "chasing" else "static"


def _circling(
    generator: np.random.Generator, place_m: tuple[float, float], speed_m_s: float, until_s: float
) -> PathMotion:
    """Return a circle as a polygon of 24 chords a turn, flown just below the speed bound to the end of the run."""
    bow_m = generator.uniform(200.0, 700.0)
    chord_rad = math.copysign(math.tau / 24, generator.uniform(-1.0, 1.0))
    first_rad = generator.uniform(0.0, math.tau)
    chord_s = 2 * bow_m * abs(math.sin(chord_rad / 2)) / (0.99 * speed_m_s)
    points = [(0.0, *place_m)]
    for index in range(1, math.ceil(until_s / chord_s) + 1):
        angle_rad = first_rad + index * chord_rad
        points.append(
            (
                _rounded(index * chord_s, 3),
                _rounded(place_m[0] + bow_m * (math.cos(angle_rad) - math.cos(first_rad)), 3),
                _rounded(place_m[1] + bow_m * (math.sin(angle_rad) - math.sin(first_rad)), 3),
            )
        )
    return PathMotion(path=tuple(points))


def _scattered(
    generator: np.random.Generator, count: int, coverage: float, limits_m: tuple[float, float]
) -> list[_Disc]:
    """Return static discs that cover about the share `coverage` of a box of 5 km, overlaps counted twice."""
    side_m = 5000.0
    mean_m = math.sqrt(coverage * side_m**2 / (count * math.pi))
    radii_m = np.clip(mean_m * generator.uniform(0.6, 1.4, count), *limits_m)
    centres_m = generator.uniform(0.0, side_m, (count, 2))
    return [_Disc(_rounded(n), _rounded(e), _rounded(r)) for (n, e), r in zip(centres_m, radii_m, strict=True)]


def _single(generator: np.random.Generator, name: str, discs: Sequence[_Disc], turn_radius_m: float) -> Mission:
    """Return one agent's mission among static discs, start and target 2800 to 4500 m apart in the box of the discs.

    Beside the start, on one side, and somewhere beside the target there is a turning circle clear of all discs.
    """
    centres_m = np.array([(disc.north_m, disc.east_m) for disc in discs])
    radii_m = np.array([disc.radius_m for disc in discs])
    clear_m = CLEARANCE_SHARE * radii_m
    low_m, high_m = centres_m.min(axis=0), centres_m.max(axis=0)

    def clear(points_m: np.ndarray, reach_m: float) -> np.ndarray:  # (P, 2) m -> (P,)
        gap_m = np.linalg.norm(points_m[:, None] - centres_m, axis=-1) - radii_m - clear_m
        free: np.ndarray = (gap_m >= reach_m).all(axis=-1)
        return free

    bearings_rad = np.arange(16) * math.tau / 16
    around = np.column_stack([np.cos(bearings_rad), np.sin(bearings_rad)])
    for _ in range(TRIES):
        start_m, target_m = generator.uniform(low_m, high_m, (2, 2))
        heading_rad = generator.uniform(0.0, math.tau)
        to_right = np.array([-math.sin(heading_rad), math.cos(heading_rad)])
        beside_m = start_m + turn_radius_m * np.outer([1.0, -1.0], to_right)
        if not 2800.0 <= np.hypot(*(target_m - start_m)) <= 4500.0:
            continue
        if not (clear(np.vstack([start_m, target_m]), 50.0).all() and clear(beside_m, turn_radius_m).any()):
            continue
        if clear(target_m + turn_radius_m * around, turn_radius_m).any():
            pose = _Pose(_rounded(start_m[0]), _rounded(start_m[1]), _degrees(heading_rad))
            target = (_rounded(target_m[0]), _rounded(target_m[1]))
            return _mission(name, [pose], [target], discs, SPEED_M_S**2 / (turn_radius_m * GRAVITY_M_S2))
    raise _NoRoomError


def _mission(
    name: str,
    poses: Sequence[_Pose],
    targets_m: Sequence[tuple[float, float]],
    discs: Sequence[_Disc],
    n_max: float,
    crossing: bool = False,
) -> Mission:
    """Return a mission; if `crossing`, agent i must fly to target i, which no assignment of least sum would choose."""
    radius_m = float(np.median([disc.radius_m for disc in discs])) if discs else 300.0
    scale = (radius_m / PAPER_RADIUS_M) ** 2
    paper = CostWeights()
    straight_m = max(
        math.hypot(target[0] - pose.north_m, target[1] - pose.east_m)
        for index, pose in enumerate(poses)
        for target in (targets_m if len(targets_m) < len(poses) else [targets_m[index]])
    )
    if turn_rate_rad_s(SPEED_M_S, n_max) * GUIDANCE_STEP_S > GREATEST_TURN_RAD + 1e-3:
        raise ValueError(f"{name}: n_max {n_max:g} turns too much in a guidance step")
    return Mission(
        name=name,
        agents=tuple(
            AgentSpec(
                id=index + 1,
                north_m=pose.north_m,
                east_m=pose.east_m,
                heading_deg=pose.heading_deg,
                speed_m_s=SPEED_M_S,
                n_max=_rounded(n_max, 4),
                range_m=RANGE_M,
                only_target=index + 1 if crossing else None,
            )
            for index, pose in enumerate(poses)
        ),
        targets=tuple(
            TargetSpec(id=index + 1, north_m=north_m, east_m=east_m, speed_bound_m_s=0.0)
            for index, (north_m, east_m) in enumerate(targets_m)
        ),
        threats=tuple(
            ThreatSpec(
                id=index + 1,
                north_m=disc.north_m,
                east_m=disc.east_m,
                detection_radius_m=disc.radius_m,
                attack_radius_m=ATTACK_SHARE * disc.radius_m,
                speed_bound_m_s=disc.speed_bound_m_s,
                motion=disc.motion,
            )
            for index, disc in enumerate(discs)
        ),
        weights=CostWeights(k_d=scale * paper.k_d, k_a=scale * paper.k_a, k_c=scale * paper.k_c, k_l=scale * paper.k_l),
        guidance_step_s=GUIDANCE_STEP_S,
        integration_step_s=GUIDANCE_STEP_S,
        arrival_radius_m=3.0 * SPEED_M_S * GUIDANCE_STEP_S,
        separation_m=SEPARATION_M,
        detector_range_m=800.0,
        range_policy="arrive",
        max_time_s=_rounded(TIME_SHARE * straight_m / SPEED_M_S),
    )


def _covers(disc: _Disc, points_m: np.ndarray, clear_m: float) -> bool:
    """Return whether any point (P, 2) is within a disc widened by CLEARANCE_SHARE of its radius and by `clear_m`."""
    gap_m = np.hypot(points_m[:, 0] - disc.north_m, points_m[:, 1] - disc.east_m)
    return bool((gap_m < (1.0 + CLEARANCE_SHARE) * disc.radius_m + clear_m).any())


def _apart(
    generator: np.random.Generator, count: int, box_m: float | tuple[float, float], gap_m: float
) -> np.ndarray:  # (N, 2) m
    """Return `count` places in a box with a corner at the origin, at least `gap_m` from each other."""
    size_m = np.broadcast_to(np.asarray(box_m, dtype=float), 2)
    places_m = np.empty((0, 2))
    for _ in range(TRIES):
        place_m = generator.uniform(0.0, size_m)
        if (np.linalg.norm(places_m - place_m, axis=-1) >= gap_m).all():
            places_m = np.vstack([places_m, place_m])
        if len(places_m) == count:
            return places_m
    raise _NoRoomError


def _least_gap_m(places_m: np.ndarray) -> float:
    first, second = np.triu_indices(len(places_m), k=1)
    return float(np.linalg.norm(places_m[first] - places_m[second], axis=-1).min(initial=math.inf))


def _with_radius(centres_m: np.ndarray, radius_m: float) -> np.ndarray:  # (M, 3) m
    return np.column_stack([centres_m, np.full(len(centres_m), radius_m)])


def _interaction_m(separation_m: float, n_max: float, speed_m_s: float, step_s: float) -> float:
    return interaction_radius_m(Rules(separation_m=separation_m, n_max=n_max, speed_m_s=speed_m_s), step_s)


def _radius_m(n_max: float) -> float:
    return ground_turn_radius_m(SPEED_M_S, n_max, 0.0)


def _rounded(value: float, decimals: int = DECIMALS) -> float:
    return round(float(value), decimals)


def _degrees(angle_rad: float) -> float:
    return _rounded(math.degrees(angle_rad) % 360.0)


FAMILIES: dict[str, Family] = {
    "paper": Family(
        "The paper's scenes",
        "200 km square, 10 agents, 5 targets, 4 threats of 10 km, as packaged, static or walking; targets clear of "
        "every disc grown to the end.",
        "the published setting: assignment, few obstacles, no turn limit that matters",
        0.016,
        False,
        False,
        _paper,
    ),
    "dense": Family(
        "Dense",
        "One agent among 10 to 60 static discs that may overlap and cover 15 to 60 % of a 5 km box.",
        "the whole map at once: where gaps close, local repulsion traps",
        0.2,
        True,
        True,
        _dense,
    ),
    "traps": Family(
        "Traps",
        "A U, a spiral or a corridor with a dead end of overlapping static discs between one agent and its target.",
        "that the way out leads away from the target",
        0.15,
        True,
        True,
        _traps,
    ),
    "moving": Family(
        "Moving threats",
        "One agent and 3 to 8 threats of 0.1 to 0.7 of its speed: straight, circling, random or chasing.",
        "the threats' speed bounds and ages, not only where they were",
        0.2,
        False,
        True,
        _moving,
    ),
    "tight": Family(
        "Tight turns",
        "One agent whose turn radius is 0.05 to 1 of R_d, among 8 to 25 equal static discs.",
        "the turn limit before the obstacle is near",
        0.15,
        True,
        True,
        _tight,
    ),
    "stale": Family(
        "Stale picture",
        "Broadcasts every 5 to 30 s over a link that loses in bursts; one agent, 4 to 10 threats of up to 0.2 of its "
        "speed.",
        "how old each position is",
        0.13,
        False,
        True,
        _stale,
    ),
    "wind": Family(
        "Wind",
        "One agent in wind and gusts of 0.1 to a third of its speed, among 8 to 20 static discs.",
        "the wind's bound in the turn radius over the ground",
        0.082,
        True,
        True,
        _wind,
    ),
    "swarm": Family(
        "Swarm",
        "10 to 50 agents crossing: around a circle, as two streams, at random; with no or a few discs.",
        "the other agents: who gives way to whom",
        0.024,
        True,
        False,
        _swarm,
    ),
    "losses": Family(
        "Losses",
        "6 to 12 agents for 3 or 4 targets among 2 to 6 static discs; 2 and more of them are lost at random times.",
        "that nobody else will cover the target of a lost agent",
        0.024,
        True,
        False,
        _losses,
    ),
    "caseII": Family(
        "Case II",
        "4 to 8 agents for 3 or 4 targets among static discs; the centre does not detect them, they may report.",
        "peers from the own detector alone",
        0.024,
        True,
        False,
        _case_two,
    ),
}
"""The families by name, in the order in which tables list them."""
