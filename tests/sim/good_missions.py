"""Draws missions that nobody should be warned about: over sizes, speeds, turn limits, vehicles, fences and crowds."""

from __future__ import annotations

import math
import random
from typing import Any, NamedTuple

import yaml

from companion.geo.kinematics import GRAVITY_M_S2
from companion.mission.model import Mission, parse_mission
from companion.mission.resolve import resolve

STAND_INS = {
    "arducopter": (8.0, 0.178),
    "px4-copter": (10.0, 0.178),
    "arduplane": (22.0, 0.9),
    "px4-plane": (15.0, 0.5),
}
"""Speed in m/s and n_max that the stand-ins of real autopilots are flown with, as in the packaged configurations."""


class GoodMission(NamedTuple):
    """A mission, and the kind of vehicle that flies it."""

    mission: Mission
    kind: str


class _Scene:
    """The lengths that a drawn mission is made of."""

    def __init__(self, drawn: random.Random) -> None:
        self.drawn = drawn
        self.kind = drawn.choice(["kinematic", "kinematic", "kinematic", *STAND_INS])
        self.speed_m_s, self.n_max = STAND_INS.get(
            self.kind,
            drawn.choice([(2.0, 0.3), (8.0, 1.0), (25.0, 0.3), (60.0, 1.0), (60.0, 10.0), (120.0, 3.0), (250.0, 10.0)]),
        )
        self.step_s = drawn.choice([0.2, 0.5, 1.0, 2.0]) if self.kind == "kinematic" else 0.5
        # A stand-in of a real autopilot turns a little less tightly than its n_max says.
        self.radius_m = 1.5 * self.speed_m_s**2 / (self.n_max * GRAVITY_M_S2)
        self.separation_m = max(2.0 * self.speed_m_s * self.step_s, drawn.choice([5.0, 20.0, 100.0]))
        self.spacing_m = 1.5 * (2.0 * self.separation_m + 3.0 * self.radius_m)
        self.length_m = max(25.0 * self.radius_m, 80.0 * self.speed_m_s, 10.0 * self.separation_m)
        self.clear_m = 3.0 * self.radius_m + 6.0 * self.speed_m_s * self.step_s + 0.02 * self.length_m

    def agents(self) -> list[dict[str, float]]:
        """Return one vehicle, or up to eight in a row or on a circle that they leave outwards."""
        count = self.drawn.choice([1, 1, 2, 3, 5, 8])
        common = {"speed_m_s": self.speed_m_s, "n_max": self.n_max, "range_m": 1.0e9}
        shape = self.drawn.choice(["row", "column", "circle"])
        found = []
        for number in range(count):
            turn_rad = math.tau * number / count
            away_m = self.spacing_m * (0.0 if count == 1 else 0.5 / math.sin(math.pi / count))
            north_m, east_m, heading_deg = {
                "row": (0.0, self.spacing_m * number, 0.0),
                "column": (-self.spacing_m * number, 0.0, 0.0),
                "circle": (away_m * math.cos(turn_rad), away_m * math.sin(turn_rad), math.degrees(turn_rad)),
            }[shape]
            place = {"id": number + 1, "north_m": north_m, "east_m": east_m, "heading_deg": heading_deg}
            found.append({**place, **common})
        return found

    def things(self, agents: list[dict[str, float]]) -> tuple[list[dict[str, Any]], list[tuple[float, float, float]]]:
        """Return targets beyond the discs, and north, east and radius of discs between, all clear of each other."""
        wide_m = self.spacing_m * len(agents)
        targets = [
            {"id": number + 1, "north_m": self.length_m + wide_m, "east_m": 1.5 * self.spacing_m * number}
            for number in range(self.drawn.randint(1, len(agents)))
        ]
        taken = [(item["north_m"], item["east_m"], 0.0) for item in (*agents, *targets)]
        discs: list[tuple[float, float, float]] = []
        for _ in range(self.drawn.choice([0, 2, 6, 12])):
            radius_m = self.drawn.uniform(0.02, 0.15) * self.length_m
            north_m = self.drawn.uniform(0.0, self.length_m + wide_m)
            east_m = self.drawn.uniform(-0.3 * self.length_m, 0.3 * self.length_m + wide_m)
            apart_m = [
                math.hypot(north_m - north, east_m - east) - radius_m - other for north, east, other in taken + discs
            ]
            if min(apart_m) > self.clear_m:
                discs.append((north_m, east_m, radius_m))
        return targets, discs

    def around(self, places: list[tuple[float, float, float]]) -> list[list[float]]:
        """Return a fence that leaves room to circle about every place."""
        room_m = 2.0 * self.clear_m
        south_m, north_m = min(p[0] - p[2] for p in places) - room_m, max(p[0] + p[2] for p in places) + room_m
        west_m, east_m = min(p[1] - p[2] for p in places) - room_m, max(p[1] + p[2] for p in places) + room_m
        return [[south_m, west_m], [north_m, west_m], [north_m, east_m], [south_m, east_m]]


def good_mission(seed: int) -> GoodMission:
    """Return the good mission of a seed."""
    scene = _Scene(random.Random(seed))
    drawn, agents = scene.drawn, scene.agents()
    targets, discs = scene.things(agents)
    can_stop = "copter" in scene.kind
    fenced = drawn.random() < 0.4
    moving = not fenced and not can_stop and drawn.random() < 0.3
    threats: list[dict[str, Any]] = []
    exclusions = []
    for number, (north_m, east_m, radius_m) in enumerate(discs):
        if drawn.random() < 0.2:
            exclusions.append(
                [[north_m - radius_m, east_m], [north_m, east_m + radius_m], [north_m + radius_m, east_m]]
            )
            continue
        radii = {"detection_radius_m": radius_m, "attack_radius_m": 0.5 * radius_m}
        threats.append({"id": number + 1, "north_m": north_m, "east_m": east_m, **radii})
    if moving and not exclusions:
        for threat in threats:
            threat.update({"motion": "random", "speed_bound_m_s": round(drawn.uniform(0.02, 0.1) * scene.speed_m_s, 2)})
    places = [(item["north_m"], item["east_m"], 0.0) for item in (*agents, *targets)] + discs
    data = {
        "name": f"good-{seed}",
        "agents": agents,
        "targets": targets,
        "threats": threats,
        "exclusions": exclusions,
        "guidance_step_s": scene.step_s,
        "integration_step_s": scene.step_s,
        "broadcast_period_s": drawn.choice([1.0, 5.0]),
        "separation_m": scene.separation_m,
        "arrival_radius_m": max(2.0 * scene.speed_m_s * scene.step_s, 0.3 * scene.radius_m, 5.0),
        "detector_range_m": 20.0 * (scene.radius_m + scene.speed_m_s * (scene.step_s + 2.0)) + 4.0 * scene.separation_m,
        "link": {"loss": drawn.choice([0.0, 0.2])},
        "max_time_s": 12.0 * (scene.length_m + scene.spacing_m * len(agents)) / scene.speed_m_s,
    }
    if fenced:
        data["fence"] = scene.around(places)
    return GoodMission(resolve(parse_mission(yaml.safe_dump(data), "good"), seed), scene.kind)
