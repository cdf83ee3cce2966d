"""Missions of kinds that once ended badly (docs/method.md section 5), flown in the kinematic simulator.

Each stands for a kind: a gap at the end of a ring, a lattice with narrow gaps, a corridor longer than any look-ahead, a
way inside a fence, a target beside a disc, one that is passed between two samples, steps as long as the paper's, four
pursuers, a start at the fence.
"""

from __future__ import annotations

import math
from typing import Any

import pytest

from companion.mission.model import Mission
from companion.mission.resolve import resolve
from sim.arena.flight import fly_arena
from sim.score import score

Disc = tuple[float, float, float]


def mission(
    target: tuple[float, float],
    discs: list[Disc],
    agent: dict[str, float] | None = None,
    **others: Any,  # noqa: ANN401
) -> Mission:
    """Return a resolved mission of one agent at 60 m/s and standing discs (north, east, radius in m)."""
    data = {
        "agents": [{"id": 1, "north_m": 0.0, "east_m": 0.0, "heading_deg": 0.0, "n_max": 10.0, **(agent or {})}],
        "targets": [{"id": 1, "north_m": target[0], "east_m": target[1]}],
        "threats": [
            {
                "id": k,
                "north_m": disc[0],
                "east_m": disc[1],
                "detection_radius_m": disc[2],
                "attack_radius_m": disc[2] / 2,
            }
            for k, disc in enumerate(discs, 1)
        ],
        "arrival_radius_m": 100.0,
        "max_time_s": 600.0,
        **others,
    }
    return resolve(Mission.model_validate(data), 1)


def ring(radius_m: float, disc_m: float, gap_m: float, opens_rad: float) -> list[Disc]:
    """Return discs that touch, on a ring about the origin, with one gap between two of them."""
    half_rad = math.asin((disc_m + 0.5 * gap_m) / radius_m)
    step_rad = 2.0 * math.asin(0.98 * disc_m / radius_m)
    count = math.floor((math.tau - 2.0 * half_rad) / step_rad)
    angles = [opens_rad + half_rad + k * (math.tau - 2.0 * half_rad) / (count + 1) for k in range(count + 2)]
    return [(radius_m * math.cos(angle), radius_m * math.sin(angle), disc_m) for angle in angles]


def lattice(rows: int, columns: int, disc_m: float, gap_m: float) -> list[Disc]:
    """Return discs in staggered rows, north of the origin."""
    apart_m = 2.0 * disc_m + gap_m
    return [
        (1_500.0 + row * apart_m * math.sqrt(0.75), (column - columns / 2 + 0.5 * (row % 2)) * apart_m, disc_m)
        for row in range(rows)
        for column in range(columns)
    ]


def corridor(length_m: float, width_m: float, disc_m: float) -> list[Disc]:
    """Return two rows of overlapping discs north of the origin, and walls beside their ends."""
    norths_m = [500.0 + 1.4 * disc_m * k for k in range(math.ceil(length_m / (1.4 * disc_m)) + 1)]
    aside_m = 0.5 * width_m + disc_m
    rows = [(north_m, side * aside_m, disc_m) for north_m in norths_m for side in (1.0, -1.0)]
    wings = [(norths_m[0], side * (aside_m + 1.4 * disc_m * k), disc_m) for k in range(1, 12) for side in (1.0, -1.0)]
    return rows + wings


BOX = [[-3_000.0, -3_000.0], [13_000.0, -3_000.0], [13_000.0, 3_000.0], [-3_000.0, 3_000.0]]
SCATTERED = [(3_000.0 + 2_700.0 * k, 1_400.0 * math.sin(2.4 * k), 1_200.0) for k in range(8)]
KINDS: dict[str, Mission] = {
    "out of a ring by its only gap": mission((-5_000.0, 0.0), ring(2_000.0, 300.0, 25.0, 0.0)),
    "through a lattice with gaps of 12 m": mission((4_000.0, 40.0), lattice(6, 16, 150.0, 12.0), {"east_m": 20.0}),
    "through a corridor 4 km long": mission((5_500.0, 0.0), corridor(4_000.0, 220.0, 200.0), {"n_max": 2.0}),
    "inside the fence, not along it": mission(
        (10_000.0, 2_000.0),
        [(5_000.0, 2_700.0, 800.0), (5_000.0, 1_300.0, 800.0), (5_000.0, 0.0, 800.0)],
        {"east_m": 2_000.0},
        fence=BOX,
    ),
    "to a target 1 m before a disc": mission((2_999.0, 0.0), [(4_000.0, 0.0, 1_000.0)], {"n_max": 1.0}),
    "to a target 1 m inside a disc": mission((3_001.0, 0.0), [(4_000.0, 0.0, 1_000.0)], {"n_max": 1.0}),
    "to a target abeam, passed between two samples": mission((0.0, 60.0), [], {"n_max": 1.0}, arrival_radius_m=5.0),
    "with guidance steps of 5 s": mission(
        (26_000.0, 0.0), SCATTERED, {"n_max": 1.0}, guidance_step_s=5.0, integration_step_s=5.0, arrival_radius_m=300.0
    ),
    "from the edge of the fence, along it": mission((9_000.0, 0.0), [], {"east_m": 2_999.0, "n_max": 1.0}, fence=BOX),
    "around an exclusion": mission(
        (6_000.0, 0.0), [], exclusions=[[[2_000.0, -900.0], [4_000.0, -900.0], [4_000.0, 700.0], [2_000.0, 700.0]]]
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_it_arrives_and_enters_nothing(kind: str) -> None:
    given = KINDS[kind]
    flight = fly_arena(given, 1)
    judged = score(flight.trajectory, given)
    assert (judged.arrived, judged.threat_entries_detection) == (1, 0)
    assert flight.agents[0].certified_s == math.inf


@pytest.mark.slow
def test_a_ring_without_a_gap_is_not_entered_and_the_reason_is_said() -> None:
    given = mission((0.0, 0.0), ring(2_000.0, 300.0, -30.0, 0.0), {"north_m": -5_000.0}, max_time_s=200.0)
    flight = fly_arena(given, 1)
    assert score(flight.trajectory, given).threat_entries_detection == 0
    last = flight.agents[0].last
    assert last is not None and last.note == "target out of reach: to the nearest safe point"


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.3, 0.6])
def test_four_pursuers_are_no_certificate_for_ever(share: float) -> None:
    speed_m_s = 60.0 * share
    around = [(4_000.0 * math.cos(0.1 + k), 4_000.0 * math.sin(0.1 + k)) for k in (0.0, 1.57, 3.14, 4.71)]
    given = mission((12_000.0, 0.0), [(*place, 800.0) for place in around])
    chased = [threat.model_copy(update={"motion": "chase", "speed_bound_m_s": speed_m_s}) for threat in given.threats]
    given = given.model_copy(update={"threats": tuple(chased)})
    flight = fly_arena(given, 1)
    entries = score(flight.trajectory, given).threat_entries_detection
    certified_s = flight.agents[0].certified_s
    assert certified_s == math.inf if share < 0.5 else certified_s < math.inf
    assert entries == 0 or certified_s < math.inf
