"""The data of the player in `report.html`: the flight sampled, what each agent had heard when, and why it did what.

It is bounded whatever the mission: few enough numbers that the report stays small enough to be sent around.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from sim.agent_log import AgentLog
from sim.flown import FlownMission

MOST_NUMBERS = 150_000
"""Greatest number of coordinates: as text they take about 3 bytes each."""
LEAST_SAMPLES, MOST_SAMPLES = 50, 2_000
"""Number of times at which the flight is sampled, as far as MOST_NUMBERS allows."""
MOST_HEARD, MOST_WORDS = 20_000, 5_000
"""Greatest number of pictures heard, and of reasons, of all agents together."""
WIDE_M = 20_000.0
"""Width of a map from which whole metres are drawn, and decimetres below it."""
_MARGIN = 0.04
"""Free share of the map on each side."""
EntryT = TypeVar("EntryT")


def player_data(flown: FlownMission, logs: Mapping[int, AgentLog]) -> dict[str, Any]:
    """Return what the player is given: places in units of `unit_m`, so small that they are not told apart on a map."""
    mission, trajectory = flown.mission, flown.trajectory
    objects = len(trajectory.agent_ids) + len(trajectory.target_ids) + len(trajectory.threat_ids)
    wanted = int(np.clip(MOST_NUMBERS // (2 * max(objects, 1)), LEAST_SAMPLES, MOST_SAMPLES))
    count = len(trajectory.t_s)
    chosen = np.unique(np.linspace(0, count - 1, min(wanted, count)).round().astype(int))
    agents = max(len(trajectory.agent_ids), 1)
    lost_s = {one.id: one.lost_t_s for one in flown.score.per_agent}
    reached_s = {one.id: one.reached_t_s for one in flown.score.per_target}
    threats = {threat.id: threat for threat in mission.threats}
    box = _box(flown)
    unit_m = 1.0 if max(box[2] - box[0], box[3] - box[1]) > WIDE_M else 0.1
    return {
        "unit_m": unit_m,
        "t_ds": _steps(trajectory.t_s[chosen] * 10.0),
        "box": box,
        "arrival": mission.arrival_radius_m,
        "fence": mission.fence,
        "exclusions": mission.exclusions,
        "agents": [
            {
                "id": identity,
                **_track(trajectory.agents_ned_m[chosen, index] / unit_m),
                "lost": lost_s.get(identity),
                "heard": _thinned(_log(logs, identity).pictures, MOST_HEARD // agents),
                "words": _thinned(_log(logs, identity).reasons, MOST_WORDS // agents),
            }
            for index, identity in enumerate(trajectory.agent_ids)
        ],
        "targets": [
            {
                "id": identity,
                **_track(trajectory.targets_ned_m[chosen, index] / unit_m),
                "reached": reached_s.get(identity),
            }
            for index, identity in enumerate(trajectory.target_ids)
        ],
        "threats": [
            {
                "id": identity,
                **_track(trajectory.threats_ned_m[chosen, index] / unit_m),
                "detection": threats[identity].detection_radius_m,
                "attack": threats[identity].attack_radius_m,
                "bound": threats[identity].speed_bound_m_s,
            }
            for index, identity in enumerate(trajectory.threat_ids)
            if identity in threats
        ],
    }


def script_json(data: object) -> str:
    """Return data as JSON that may stand inside a script element, whatever texts it holds."""
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def _log(logs: Mapping[int, AgentLog], identity: int) -> AgentLog:
    return logs.get(identity) or AgentLog()


def _track(places: np.ndarray) -> dict[str, list[int]]:
    """Return places (S, 2), north and east, as the steps between them, and the samples at which something was there.

    These are the first and the one after the last of each time that it was there, or nothing if it always was.
    """
    there = ~np.isnan(places[:, 0])
    edges = np.flatnonzero(np.diff(there, prepend=False, append=False)).tolist()
    # What is not drawn is where it was last, or will be.
    shown = np.maximum.accumulate(np.where(there, np.arange(len(there)), -1))
    shown = np.where(shown < 0, int(there.argmax()), shown)
    drawn = np.nan_to_num(places[shown])
    return {"n": _steps(drawn[:, 0]), "e": _steps(drawn[:, 1]), "there": [] if there.all() else edges}


def _steps(values: np.ndarray) -> list[int]:
    """Return whole values (S,) as the first and the differences, which are shorter texts."""
    steps: list[int] = np.diff(values.round().astype(np.int64), prepend=0).tolist()
    return steps


def _thinned(entries: Sequence[EntryT], most: int) -> list[EntryT]:
    """Return at most so many of the entries, evenly; the last is among them."""
    every = -(-len(entries) // max(most, 1))
    return list(entries[::-1][:: max(every, 1)][::-1])


def _box(flown: FlownMission) -> list[float]:
    """Return south, west, north and east end of the map, m: all that flies, is to be reached or kept out of."""
    mission, trajectory = flown.mission, flown.trajectory
    places = [trajectory.agents_ned_m.reshape(-1, 2), trajectory.targets_ned_m.reshape(-1, 2)]
    radii = {threat.id: threat.detection_radius_m for threat in mission.threats}
    for index, identity in enumerate(trajectory.threat_ids):
        path = trajectory.threats_ned_m[:, index]
        places += [path - radii.get(identity, 0.0), path + radii.get(identity, 0.0)]
    if mission.fence is not None:
        places.append(np.array(mission.fence))
    everything = np.concatenate(places)
    low, high = np.nanmin(everything, axis=0), np.nanmax(everything, axis=0)
    margin_m = _MARGIN * max(*(high - low), mission.arrival_radius_m)
    return [*(low - margin_m).round().tolist(), *(high + margin_m).round().tolist()]
