"""Pictures of missions that were never flown, as a ground station shows them: for looks, bad names and many agents."""

from __future__ import annotations

import math
import random
from typing import Any

View = dict[str, Any]
BEGAN_S = 1_790_000_000
"""Unix time of the beginning of all that is shown."""
ORIGIN = {"lat_deg": 47.0, "lon_deg": 8.0, "alt_m": 500.0}


def agent(identity: int, north_m: float, east_m: float, **changes: object) -> View:
    """Return an agent that a sensor sees, under way to target 1."""
    return {
        "id": identity,
        "north_m": north_m,
        "east_m": east_m,
        "heading_deg": 40.0,
        "speed_m_s": 20.0,
        "age_s": 0.4,
        "source": "sensor",
        "ellipse": None,
        "state": "under way",
        "target": 1,
        "pinned": None,
        "directive": "normal",
        "range_left_m": 42_000.0,
        "eta_s": 310.0,
        "link": None,
        "certificate": None,
        **changes,
    }


def target(identity: int, north_m: float, east_m: float, **changes: object) -> View:
    """Return a target that stands."""
    return _standing(identity, north_m, east_m, age_s=1.0, reached_by=[], agents=[]) | changes


def threat(identity: int, north_m: float, east_m: float, **changes: object) -> View:
    """Return a threat that stands."""
    disc = {"detection_radius_m": 1_200.0, "attack_radius_m": 600.0, "growth_m": 0.0}
    return _standing(identity, north_m, east_m, age_s=3.0, floor_m=None, ceiling_m=None, **disc) | changes


def _standing(identity: int, north_m: float, east_m: float, **more: object) -> View:
    """Return what a picture has of a target as of a threat that stands, as the mission's file says."""
    return {
        "id": identity,
        "name": None,
        "north_m": north_m,
        "east_m": east_m,
        "velocity_north_m_s": 0.0,
        "velocity_east_m_s": 0.0,
        "speed_bound_m_s": 0.0,
        "source": "mission",
        **more,
    }


def broadcast(**changes: object) -> View:
    """Return the state of an unsigned broadcast over a slow radio."""
    items = (("assignment", 1.0, 0.4), ("threats", 1.0, 0.4), ("targets", 2.0, 1.3), ("agents", 5.0, 3.9))
    return {
        "bytes_per_s": 412.0,
        "budget_bytes_per_s": 1_200.0,
        "frames": 1_934,
        "bytes": 301_777,
        "last_frame_age_s": 0.4,
        "items": [{"name": name, "period_s": period, "age_s": age} for name, period, age in items],
        "authentication": "unsigned",
        "link": "udpout:127.0.0.1:14600",
        **changes,
    }


def picture(**changes: object) -> View:
    """Return a picture with one agent, one target and one threat."""
    return {
        "type": "picture",
        "t_s": BEGAN_S + 120.0,
        "mode": "live",
        "mission": "valley",
        "case": "I",
        "paused": False,
        "directive": "normal",
        "epoch_s": BEGAN_S,
        "revision": 1,
        "event": 0,
        "undoable": [],
        "origin": ORIGIN,
        "fence": None,
        "exclusions": [],
        "arrival_radius_m": 150.0,
        "separation_m": 100.0,
        "agents": [agent(1, 0.0, 0.0)],
        "targets": [target(1, 9_000.0, 7_000.0, agents=[1])],
        "threats": [threat(1, 4_500.0, 3_000.0)],
        "unknown": [],
        "broadcast": broadcast(),
        "sources": [],
        "warnings": [],
        **changes,
    }


def moves(shown: View, t_s: float) -> View:
    """Return the moves of a picture's things at a time, each as far as its speed takes it since the picture."""
    since_s = t_s - shown["t_s"]

    def flown(one: View) -> list[float]:
        heading = math.radians(one["heading_deg"])
        north_m = one["north_m"] + one["speed_m_s"] * since_s * math.cos(heading)
        east_m = one["east_m"] + one["speed_m_s"] * since_s * math.sin(heading)
        return [one["id"], round(north_m, 2), round(east_m, 2), one["heading_deg"], one["speed_m_s"], one["age_s"]]

    def stands(one: View) -> list[float]:
        velocity = [one["velocity_north_m_s"], one["velocity_east_m_s"]]
        return [one["id"], one["north_m"], one["east_m"], *velocity, one["age_s"] + since_s]

    return {
        "type": "moves",
        "t_s": t_s,
        "agents": [flown(one) for one in shown["agents"]],
        "targets": [stands(one) for one in shown["targets"]],
        "threats": [[*stands(one), one["growth_m"] + one["speed_bound_m_s"] * since_s] for one in shown["threats"]],
    }


def valley() -> View:
    """Return a picture with everything that the page can show, for the screenshots."""
    ghost = {"semi_major_m": 1_150.0, "semi_minor_m": 640.0, "heading_deg": 62.0}
    return picture(
        event=10,
        undoable=[3, 6, 8, 9],
        fence=[[-3_000, -3_500], [13_500, -3_500], [13_500, 12_000], [-3_000, 12_000]],
        exclusions=[[[9_500, -2_500], [12_000, -2_000], [11_500, 500], [9_800, 300]]],
        agents=[
            agent(1, 1_000, 700, source="telemetry", age_s=0.1, certificate="safe for all time"),
            agent(2, 2_600, 4_400, source="reckoned", ellipse=ghost, age_s=74.0, heading_deg=62.0, target=2),
            agent(3, 300, 5_200, heading_deg=15.0, link={"heard": 0.8, "by": "mission"}, target=3, pinned=3),
            agent(4, 8_850, 6_950, state="arrived", target=None, eta_s=None, source="telemetry", heading_deg=180.0),
            agent(5, -1_200, 2_400, state="lost", source="reckoned", age_s=412.0, target=None, eta_s=None),
            agent(6, -500, -1_500, state="out", target=None, eta_s=None, heading_deg=300.0),
            agent(7, 5_300, -600, heading_deg=100.0, directive="hold", target=3, source="telemetry"),
        ],
        targets=[
            target(1, 9_000, 7_000, name="Bridge", agents=[1], reached_by=[4]),
            target(2, 5_200, 10_300, name="North ridge", agents=[2]),
            target(3, 7_600, 1_500, agents=[3, 7], velocity_north_m_s=1.5, velocity_east_m_s=2.0, speed_bound_m_s=4.0),
        ],
        threats=[
            threat(1, 4_700, 3_300, name="Mast"),
            threat(2, 1_700, 8_200, growth_m=450.0, age_s=45.0, speed_bound_m_s=10.0, velocity_east_m_s=-4.0),
        ],
        unknown=[
            {
                "source": "adsb",
                "kind": "threat",
                "id": 77,
                "north_m": 10_800,
                "east_m": 9_300,
                "age_s": 2.0,
                "count": 14,
            }
        ],
        sources=[
            {"name": "mission", "kind": "mission", "state": "good", "rate_hz": 1.0, "age_s": 0.5, "things": 5}
            | {"refused": 0, "unknown": 0, "detail": ""},
            {"name": "vehicles", "kind": "mavlink", "state": "good", "rate_hz": 12.0, "age_s": 0.1, "things": 3}
            | {"refused": 2, "unknown": 0, "detail": "udpin:127.0.0.1:14550"},
            {"name": "adsb", "kind": "basestation", "state": "late", "rate_hz": 0.4, "age_s": 6.1, "things": 0}
            | {"refused": 0, "unknown": 1, "detail": "127.0.0.1:30003"},
        ],
        warnings=["target 3: nobody is near enough to reach it within its range", "adsb: nothing for 6 s"],
    )


def valley_routes() -> View:
    """Return the routes of the agents in `valley`, around its threats."""
    routes = {
        "1": [[1_000, 700], [3_600, 3_960], [4_050, 4_330], [9_000, 7_000]],
        "2": [[2_600, 4_400], [5_200, 10_300]],
        "3": [[300, 5_200], [3_500, 3_400], [3_750, 2_620], [7_600, 1_500]],
    }
    return {"type": "routes", "routes": routes}


def valley_events() -> list[View]:
    """Return what has happened in `valley`, as messages."""
    anna = {"name": "anna", "role": "operator"}
    station = {"name": "ground station", "role": "station"}
    facts: list[View] = [
        {"event": "started", "who": station, "mission": "valley", "epoch_s": BEGAN_S},
        {"event": "assigned", "who": station, "changes": [{"agent": 3, "target": 2, "reason": "first assignment"}]},
        {"event": "threat-added", "who": anna, "threat": {"id": 2}, "name": None},
        {"event": "revision-began", "who": station, "revision": 1, "threats": 2},
        {
            "event": "unknown-seen",
            "who": {"name": "adsb", "role": "source"},
            "source": "adsb",
            "kind": "threat",
            "id": 77,
        },
        {"event": "pinned", "who": anna, "agent": 3, "target": 3},
        {"event": "assigned", "who": station, "changes": [{"agent": 3, "target": 3, "reason": "pinned by anna"}]},
        {"event": "taken-out", "who": anna, "agent": 6},
        {"event": "directed", "who": anna, "directive": "hold", "agent": 7},
        {"event": "arrived", "who": station, "agent": 4, "target": 1},
    ]
    return [
        {"type": "event", "event": {"number": 1 + index, "unix_s": BEGAN_S + 11 * index, **fact}}
        for index, fact in enumerate(facts)
    ]


def swarm(agents: int = 500, things: int = 50) -> View:
    """Return a picture with many agents, targets and threats, always the same."""
    chance = random.Random(5)

    def spread() -> float:
        return chance.uniform(-40_000, 40_000)

    ellipse = {"semi_major_m": 900.0, "semi_minor_m": 500.0, "heading_deg": 30.0}
    flying = [
        agent(
            1 + index,
            spread(),
            spread(),
            heading_deg=chance.uniform(0, 360),
            target=1 + index % things,
            source="reckoned" if index % 2 else "telemetry",
            ellipse=ellipse if index % 2 else None,
        )
        for index in range(agents)
    ]
    return picture(
        mission="swarm",
        agents=flying,
        targets=[target(1 + index, spread(), spread()) for index in range(things)],
        threats=[threat(1 + index, spread(), spread(), growth_m=200.0) for index in range(things)],
    )
