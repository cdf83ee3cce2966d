"""A folder of `sim fly --out` as a playback sees it: the truth, and what every vehicle knew of it and when."""

from __future__ import annotations

import json
import math
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from companion.errors import InputError
from companion.files.tlog import read_tlog
from companion.mission.model import Mission, load_mission
from companion.protocol.codec import FleetFrame, StateFrame, decode_frame
from companion.protocol.frame import raw_frame
from companion.protocol.messages import Directive, WireError
from groundstation.events import (
    STATION,
    Arrived,
    Assigned,
    Event,
    Lost,
    NewTarget,
    RevisionBegan,
    Started,
    event_from_json,
)
from groundstation.operations import DIRECTIVE_NAMES, Operations, applied
from groundstation.store.recordings import MOST_EVENTS, Json, Span
from groundstation.view import mission_picture
from sim.flight_files import (
    BROADCAST_NAME,
    EVENTS_NAME,
    MISSION_NAME,
    RESULT_NAME,
    TRAJECTORY_NAME,
    vehicle_log_name,
)
from sim.loop import START_S
from sim.trajectory import Trajectory, read_csv
from sim.vehicle_words import Knowledge, read_words

PICTURE_S = 0.5
"""Time from one picture to the next."""
_COURSE_S = 1.0
"""Time over which the velocity of a target or threat is taken from its places."""


@dataclass(frozen=True)
class Arrival:
    """When an agent arrived where, by the flight's result."""

    at_s: float
    """Unix time."""
    target_id: int


class FlownFolder:
    """A recording in a folder; everything but the vehicles' logs is read when it is opened."""

    def __init__(self, folder: Path) -> None:
        """Read a folder; raises InputError if it is none that `sim fly --out` wrote."""
        for name in (MISSION_NAME, TRAJECTORY_NAME, BROADCAST_NAME):
            if not (folder / name).is_file():
                raise InputError(f"{folder}: no {name}; allowed: a folder that `sim fly --out` wrote")
        self._mission = load_mission(str(folder / MISSION_NAME))
        kept = kept_events(folder / EVENTS_NAME)
        self._operations = operations_by(self._mission, kept)
        self._trajectory = read_csv(folder / TRAJECTORY_NAME, things_change=bool(kept))
        self._frames = [(at_s, frame) for at_s, frame in read_tlog(folder / BROADCAST_NAME)]
        self._sent_s = [at_s for at_s, _ in self._frames]
        self._words = {
            agent.id: read_words(log, agent.id)
            for agent in self._mission.agents
            if (log := folder / vehicle_log_name(agent.id)).is_file()
        }
        self._arrivals = arrivals_in(folder / RESULT_NAME)
        self._events = kept or list(events_of(self._mission, self._frames, self._arrivals))
        self._event_times_s = [event.unix_s for event in self._events]
        times_s = self._trajectory.t_s
        self.span = Span(START_S + float(times_s[0]), START_S + float(times_s[-1]))

    def mission_at(self, at_s: float) -> Json | None:
        """Return the mission with what it had at a time."""
        mission: Json = self._operations_at(at_s).mission.model_dump(mode="json")
        return mission

    def events(self, after_s: float, to_s: float) -> list[Json]:
        """Return the events after one time, up to another, at most the last MOST_EVENTS of them."""
        first, last = (bisect_right(self._event_times_s, at_s) for at_s in (after_s, to_s))
        return [event.model_dump(mode="json") for event in self._events[max(first, last - MOST_EVENTS) : last]]

    def frames(self, after_s: float, to_s: float) -> Iterator[tuple[float, list[bytes]]]:
        """Yield the frames that were broadcast after one time, up to another."""
        first, last = (bisect_right(self._sent_s, at_s) for at_s in (after_s, to_s))
        for at_s, frame in self._frames[first:last]:
            yield at_s, [frame]

    def picture_at(self, at_s: float) -> Json | None:
        """Return where everything truly was in the PICTURE_S of a time, and what the vehicles knew then."""
        at_s = self.span.from_s + PICTURE_S * math.floor((at_s - self.span.from_s) / PICTURE_S)
        scene = Scene(self._trajectory, at_s - START_S)
        known = {agent_id: words.at(at_s) for agent_id, words in self._words.items()}
        number = bisect_right(self._event_times_s, at_s)
        heard_s = [one.picture_s for one in known.values() if one is not None and one.picture_s is not None]
        age_s = round(at_s - max(heard_s), 2) if heard_s else None
        return picture_of(self._operations_at(at_s), scene, Known(known, self._arrivals, age_s, at_s), number)

    def _operations_at(self, at_s: float) -> Operations:
        return self._operations[max(0, bisect_right(self._operations, at_s, key=lambda one: one[0]) - 1)][1]


@dataclass(frozen=True)
class Known:
    """What is known at a time."""

    vehicles: Mapping[int, Knowledge | None]
    """What each vehicle knows, by agent id."""
    arrivals: Mapping[int, Sequence[Arrival]]
    """The arrivals of each agent in order, by its id."""
    age_s: float | None
    """Age of the newest picture that any vehicle has; None: none has any."""
    at_s: float


class Scene:
    """Where everything is at a time of a trajectory; things that are not there then are left out."""

    def __init__(self, trajectory: Trajectory, t_s: float) -> None:
        self._trajectory = trajectory
        self._index = max(0, int(np.searchsorted(trajectory.t_s, t_s + 1e-6, side="right")) - 1)
        self._before = max(0, int(np.searchsorted(trajectory.t_s, t_s - _COURSE_S, side="left")))

    def agents(self) -> Iterator[tuple[int, tuple[float, float], float, float]]:
        """Yield id, place (m), heading (deg) and speed (m/s) of every agent."""
        one, at = self._trajectory, self._index
        for column, identity in enumerate(one.agent_ids):
            north_m, east_m = one.agents_ned_m[at, column].tolist()
            heading_deg, speed_m_s = one.agents_heading_deg[at, column], one.agents_speed_m_s[at, column]
            yield identity, (north_m, east_m), float(heading_deg), float(speed_m_s)

    def targets(self) -> dict[int, Json]:
        """Return place and velocity of every target that is there, by id."""
        return self._moving(self._trajectory.target_ids, self._trajectory.targets_ned_m)

    def threats(self) -> dict[int, Json]:
        """Return place and velocity of every threat that is there, by id."""
        return self._moving(self._trajectory.threat_ids, self._trajectory.threats_ned_m)

    def _moving(self, ids: Sequence[int], ned_m: np.ndarray) -> dict[int, Json]:
        lasts_s = float(self._trajectory.t_s[self._index] - self._trajectory.t_s[self._before])
        found: dict[int, Json] = {}
        for column, identity in enumerate(ids):
            place_ned_m = ned_m[self._index, column]
            if not np.isfinite(place_ned_m).all():
                continue
            way_m = np.nan_to_num(place_ned_m - ned_m[self._before, column])
            velocity_m_s = way_m / lasts_s if lasts_s > 0.0 else np.zeros(2)
            found[identity] = {
                "id": identity,
                "name": None,
                "north_m": round(float(place_ned_m[0]), 2),
                "east_m": round(float(place_ned_m[1]), 2),
                "velocity_north_m_s": round(float(velocity_m_s[0]), 2),
                "velocity_east_m_s": round(float(velocity_m_s[1]), 2),
            }
        return found


def picture_of(operations: Operations, scene: Scene, known: Known, number: int) -> Json:
    """Return a picture as groundstation/view.py makes one, of the truth and of what the vehicles knew."""
    mission, orders = operations.mission, operations.orders
    return {
        "type": "picture",
        "t_s": known.at_s,
        "mode": "playback",
        **mission_picture(mission),
        "paused": orders.paused,
        "directive": DIRECTIVE_NAMES[orders.told],
        "epoch_s": int(START_S),
        "revision": 0,
        "event": number,
        "undoable": [],
        "agents": list(_agents(operations, scene, known)),
        "targets": list(_targets(mission, scene, known)),
        "threats": list(_threats(mission, scene, known)),
        "unknown": [],
        "broadcast": {},
        "sources": [],
        "warnings": [],
    }


def _agents(operations: Operations, scene: Scene, known: Known) -> Iterator[Json]:
    mission, orders = operations.mission, operations.orders
    lost_s = {loss.agent: START_S + loss.t_s for loss in mission.losses}
    for identity, (north_m, east_m), heading_deg, speed_m_s in scene.agents():
        one = known.vehicles.get(identity)
        reached = {arrival.target_id for arrival in known.arrivals.get(identity, ()) if arrival.at_s <= known.at_s}
        target_id = None if one is None else one.target_id
        state = "no target" if target_id is None else "under way"
        if reached and (target_id is None or target_id in reached):
            state = "arrived"
        if orders.of(identity) is Directive.RETURN:
            state = "recalled"
        if identity in orders.out:
            state = "out"
        if known.at_s >= lost_s.get(identity, math.inf):
            state = "lost"
        yield {
            "id": identity,
            "north_m": north_m,
            "east_m": east_m,
            "heading_deg": heading_deg,
            "speed_m_s": speed_m_s,
            "age_s": 0.0,
            "source": "truth",
            "ellipse": None,
            "state": state,
            "target": target_id,
            "pinned": orders.pins.get(identity),
            "directive": DIRECTIVE_NAMES[orders.of(identity)],
            "range_left_m": None,
            "eta_s": None,
            "link": heard_words(one, known.at_s),
            "certificate": None if one is None else one.certificate,
            "reason": None,
            "said": None if one is None else one.words,
        }


def heard_words(one: Knowledge | None, at_s: float) -> str:
    """Return what a vehicle had heard, in words."""
    if one is None or one.picture_s is None:
        return "nothing heard yet"
    return f"picture {max(0.0, at_s - one.picture_s):.1f} s old, {one.missing or 'held whole'}, {one.stage}"


def _targets(mission: Mission, scene: Scene, known: Known) -> Iterator[Json]:
    bounds = {target.id: target.speed_bound_m_s for target in mission.targets}
    for identity, place in scene.targets().items():
        by = [
            agent_id
            for agent_id, arrivals in known.arrivals.items()
            for arrival in arrivals
            if arrival.target_id == identity and arrival.at_s <= known.at_s
        ]
        sent = [agent_id for agent_id, one in known.vehicles.items() if one is not None and one.target_id == identity]
        yield place | {
            "age_s": known.age_s,
            "speed_bound_m_s": bounds.get(identity, 0.0),
            "reached_by": by,
            "agents": [agent_id for agent_id in sent if agent_id not in by],
            "source": "mission",
        }


def _threats(mission: Mission, scene: Scene, known: Known) -> Iterator[Json]:
    specs = {threat.id: threat for threat in mission.threats}
    for identity, place in scene.threats().items():
        spec = specs.get(identity)
        if spec is None:
            continue
        yield place | {
            "age_s": known.age_s,
            "detection_radius_m": spec.detection_radius_m,
            "attack_radius_m": spec.attack_radius_m,
            "growth_m": round(spec.speed_bound_m_s * (known.age_s or 0.0), 2),
            "speed_bound_m_s": spec.speed_bound_m_s,
            "floor_m": spec.floor_m,
            "ceiling_m": spec.ceiling_m,
            "source": "mission",
        }


def kept_events(path: Path) -> list[Event]:
    """Return the events that a flight with a page, or with tracks, has kept; none if there is no such file."""
    try:
        return [event_from_json(line) for line in path.read_bytes().splitlines()]
    except FileNotFoundError:
        return []
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: no events of a flight; allowed: the file that `sim fly` wrote") from error


def operations_by(mission: Mission, events: Sequence[Event]) -> list[tuple[float, Operations]]:
    """Return from which Unix time on events have made what of a mission, which is there from the start, and orders."""
    operations = Operations.begun(mission)
    found = [(-math.inf, operations)]
    for event in events:
        operations = applied(operations, event)
        last = found[-1][1]
        if operations.mission is not last.mission or operations.orders is not last.orders:
            found.append((event.unix_s, operations))
    return found


def arrivals_in(path: Path) -> dict[int, list[Arrival]]:
    """Return the arrivals of a `result.json` by agent id; none if a flight that was killed has left no such file."""
    try:
        agents = json.loads(path.read_text(encoding="utf-8"))["agents"]
        return {
            one["id"]: [Arrival(START_S + reached["t_s"], reached["target"]) for reached in one["reached"]]
            for one in agents
        }
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: no result of a flight; allowed: the file that `sim fly` wrote") from error


def events_of(
    mission: Mission, frames: Sequence[tuple[float, bytes]], arrivals: Mapping[int, Sequence[Arrival]]
) -> Iterator[Event]:
    """Yield what happened in a flight, in its order: who was sent where by the broadcast, arrived or was lost."""
    found: list[tuple[float, Callable[..., Event]]] = [
        (START_S, partial(Started, mission=mission.name, epoch_s=int(START_S))),
        *((START_S + loss.t_s, partial(Lost, agent=loss.agent)) for loss in mission.losses),
        *_told(frames, len(mission.threats)),
    ]
    for agent_id, reached in arrivals.items():
        found += [(one.at_s, partial(Arrived, agent=agent_id, target=one.target_id)) for one in reached]
    for number, (at_s, event) in enumerate(sorted(found, key=lambda one: one[0]), 1):
        yield event(number=number, unix_s=at_s, who=STATION)


def _told(frames: Sequence[tuple[float, bytes]], threats: int) -> Iterator[tuple[float, Callable[..., Event]]]:
    """Yield when the broadcast first told another target of an agent, or another revision of the picture."""
    assignment: dict[int, int | None] = {}
    revision: int | None = None
    for at_s, data in frames:
        try:
            frame = decode_frame(raw_frame(data))
        except WireError:
            continue
        if not isinstance(frame, StateFrame | FleetFrame):
            continue
        if frame.revision != revision:
            revision = frame.revision
            yield at_s, partial(RevisionBegan, revision=revision, threats=threats)
        now = {agent.id: agent.target_id for agent in frame.agents}
        changed = {agent: target for agent, target in now.items() if assignment.get(agent) != target}
        if changed:
            assignment |= changed
            told = tuple(NewTarget(agent=one, target=there, reason="as broadcast") for one, there in changed.items())
            yield at_s, partial(Assigned, changes=told)
