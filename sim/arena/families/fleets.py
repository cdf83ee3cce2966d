"""Families of several agents: swarm, losses and caseII."""

from __future__ import annotations

import math

import numpy as np

from companion.mission.model import (
    Loss,
    Mission,
)
from sim.arena.families.drawing import (
    GUIDANCE_STEP_S,
    N_MAX,
    SEPARATION_M,
    SPEED_M_S,
    START_GAP,
    TIME_SHARE,
    TRIES,
    Disc,
    NoRoomError,
    Pose,
    apart,
    covers,
    degrees,
    interaction_m,
    least_gap_m,
    mission_of,
    rounded,
    turn_radius_at_m,
)

SWARM_TIME_SHARE = 5.0
"""Time limit of a swarm, as a multiple of the straight line's time: in a roundabout some agents go round several times
(docs/separation.md)."""
TARGET_GAP_M = 300.0
"""Least distance between two targets of a swarm: an agent that has arrived loiters there, and nearer loiter circles
would close the way to the next target (1.2 times the sum of a separation and three turn radii at the swarm's load
factor is 230 m)."""
GREATEST_CROSSING_M = 4_950.0
"""Greatest distance that an agent of a swarm has to cross: about 400 guidance steps."""


def swarm(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    """Draw a mission of the family `swarm`; raise NoRoomError if it has no room."""
    kind = str(generator.choice(["circle", "streams", "random"]))
    pattern = {"circle": _circle_swarm, "streams": _stream_swarm, "random": _random_swarm}[kind]
    count, number_of_discs = int(generator.integers(10, 51)), int(generator.choice([0, 0, 2, 3]))
    n_max = N_MAX[1]
    spacing_m = START_GAP * (radius_m or interaction_m(SEPARATION_M, n_max, SPEED_M_S, GUIDANCE_STEP_S))
    for _ in range(TRIES):
        try:
            starts_m, targets_m = pattern(generator, count, spacing_m)
            discs = _few_discs(generator, number_of_discs, starts_m, targets_m, 2 * turn_radius_at_m(n_max))
        except NoRoomError:
            continue
        headings_rad = np.arctan2(*(targets_m - starts_m).T[::-1])
        poses = [Pose(rounded(n), rounded(e), degrees(rad)) for (n, e), rad in zip(starts_m, headings_rad, strict=True)]
        targets = [(rounded(n), rounded(e)) for n, e in targets_m]
        mission = mission_of(f"{name}-{kind}-{len(poses)}", poses, targets, discs, n_max, crossing=True)
        return mission.model_copy(update={"max_time_s": rounded(SWARM_TIME_SHARE / TIME_SHARE * mission.max_time_s)})
    raise NoRoomError


def _few_discs(
    generator: np.random.Generator, number: int, starts_m: np.ndarray, targets_m: np.ndarray, clear_m: float
) -> list[Disc]:
    """Return `number` discs near the middle of the starts and targets, (N, 2) each, all of which they leave clear."""
    ends_m = np.vstack([starts_m, targets_m])
    discs: list[Disc] = []
    for _ in range(TRIES):
        if len(discs) == number:
            return discs
        north_m, east_m = ends_m.mean(axis=0) + generator.uniform(-700.0, 700.0, 2)
        disc = Disc(rounded(north_m), rounded(east_m), rounded(generator.uniform(150.0, 300.0)))
        if not covers(disc, ends_m, clear_m):
            discs.append(disc)
    raise NoRoomError


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
    if least_gap_m(starts_m) < spacing_m / START_GAP or least_gap_m(targets_m) < TARGET_GAP_M:
        raise NoRoomError
    return starts_m, targets_m


def _random_swarm(
    generator: np.random.Generator, count: int, spacing_m: float
) -> tuple[np.ndarray, np.ndarray]:  # (N, 2) m, (N, 2) m
    side_m = min(max(1500.0, 1.5 * spacing_m * math.sqrt(count)), GREATEST_CROSSING_M / math.sqrt(2.0))
    count = max(10, min(count, int((side_m / (1.5 * spacing_m)) ** 2)))
    starts_m = apart(generator, count, side_m, spacing_m)
    targets_m = apart(generator, count, side_m, TARGET_GAP_M)
    return starts_m, targets_m


def losses(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    """Draw a mission of the family `losses`; raise NoRoomError if it has no room."""
    mission = _team(generator, name, radius_m, agents=(6, 13), targets=(3, 5), discs=(2, 7))
    count = len(mission.agents)
    lost = generator.permutation(count)[: int(generator.integers(2, count - len(mission.targets) + 1))]
    times_s = generator.uniform(5.0, 0.4 * mission.max_time_s, len(lost))
    losses = tuple(
        Loss(agent=mission.agents[index].id, t_s=rounded(t_s)) for index, t_s in zip(lost, times_s, strict=True)
    )
    return mission.model_copy(update={"name": f"{name}-{len(losses)}of{count}", "losses": losses, "lost_after_s": 10.0})


def case_two(generator: np.random.Generator, name: str, radius_m: float | None) -> Mission:
    """Draw a mission of the family `caseII`; raise NoRoomError if it has no room."""
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
    spacing_m = START_GAP * (radius_m or interaction_m(SEPARATION_M, n_max, SPEED_M_S, GUIDANCE_STEP_S))
    n_agents, n_targets = int(generator.integers(*agents)), int(generator.integers(*targets))
    side_m = max(3000.0, 3 * n_agents * spacing_m**2 / (1000.0 + spacing_m) - spacing_m)
    starts_m = apart(generator, n_agents, (1000.0, side_m), spacing_m)
    targets_m = apart(generator, n_targets, (800.0, side_m), 500.0) + (3400.0, 0.0)
    scattered = []
    for _ in range(int(generator.integers(*discs))):
        north_m, east_m = generator.uniform((1000.0, 0.0), (3400.0, side_m))
        scattered.append(Disc(rounded(north_m), rounded(east_m), rounded(generator.uniform(200.0, 500.0))))
    if any(covers(disc, np.vstack([starts_m, targets_m]), 2 * turn_radius_at_m(n_max)) for disc in scattered):
        raise NoRoomError
    poses = [Pose(rounded(n), rounded(e), degrees(generator.uniform(0.0, math.tau))) for n, e in starts_m]
    return mission_of(name, poses, [(rounded(n), rounded(e)) for n, e in targets_m], scattered, n_max)
