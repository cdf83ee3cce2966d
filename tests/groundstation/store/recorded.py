"""A small recorded run for the tests of exports and playback."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from companion.files.records import STAMP
from companion.mission.model import Mission, parse_mission
from companion.protocol.codec import AgentEntry, FrameWriter, Stamp, StateFrame, TargetEntry
from companion.protocol.messages import Directive
from groundstation.acceptance import event_of
from groundstation.events import STATION, Event, Started, Who, command_from, event_json
from groundstation.operations import Operations, applied
from groundstation.store.chapters import Chapter, json_of
from groundstation.store.database import Database
from groundstation.store.rows import Batch, EventRow, Recorded

NOW_S = 1_790_000_000.0
ANNA = Who(name="anna", role="operator")
MISSION = """
name: kept
agents: [{id: 1, north_m: 0, east_m: 0}, {id: 2, north_m: 0, east_m: 4000}]
targets: [{id: 7, north_m: 12000, east_m: 0}]
threats: [{id: 4, north_m: 6000, east_m: 9000, detection_radius_m: 900, attack_radius_m: 300}]
fence: [[-2000, -2000], [-2000, 12000], [15000, 12000], [15000, -2000]]
"""
COMMANDS: tuple[dict[str, Any], ...] = (
    {"do": "pin", "agent": 2, "target": 7},
    {"do": "add-threat", "north_m": 3000, "east_m": 0, "radius_m": 500, "name": 'fire, "north"'},
    {"do": "retire", "kind": "threat", "id": 4},
)
"""What is asked 10, 20 and 30 seconds after the start."""


def mission() -> Mission:
    return parse_mission(MISSION, "kept")


def row_of(event: Event) -> EventRow:
    return EventRow(event.number, event.unix_s, event.who.name, event.event, event_json(event).decode())


def events() -> list[Event]:
    operations = Operations.begun(mission())
    started = Started(number=1, unix_s=NOW_S, who=STATION, mission="kept", epoch_s=int(NOW_S))
    made: list[Event] = [started]
    operations = applied(operations, started)
    for index, command in enumerate(COMMANDS, 1):
        event = event_of(operations, command_from(command), ANNA, NOW_S + 10.0 * index)
        operations = applied(operations, event)
        made.append(event)
    return made


def picture(at_s: float) -> dict[str, Any]:
    north_m = 60.0 * (at_s - NOW_S)
    agents = [
        {"id": identity, "north_m": north_m, "east_m": east_m, "heading_deg": 0.0, "speed_m_s": 60.0, "age_s": 0.5}
        for identity, east_m in ((1, 0.0), (2, 4_000.0))
    ]
    target = {"id": 7, "name": None, "north_m": 12_000.0, "east_m": 0.0, "age_s": 1.0}
    threat = {
        "id": 4, "name": None, "north_m": 6_000.0, "east_m": 9_000.0, "age_s": 1.0, "growth_m": 10.0,
        "detection_radius_m": 900.0, "attack_radius_m": 300.0,
    }  # fmt: skip
    return {
        "type": "picture", "t_s": at_s, "mode": "live", "arrival_radius_m": 300.0, "exclusions": [],
        "origin": {"lat_deg": 47.0, "lon_deg": 8.0, "alt_m": 500.0}, "fence": [[0, 0], [0, 9], [9, 9]],
        "agents": agents, "targets": [target], "threats": [threat],
    }  # fmt: skip


def frame(at_s: float) -> bytes:
    stamp = Stamp(int(NOW_S), round(1e3 * (at_s - NOW_S)), 1)
    agents, targets = (AgentEntry(1, 0.0, 0.0, 7),), (TargetEntry(7, 12_000.0, 0.0),)
    return FrameWriter().encode(StateFrame(stamp, 47.0, 8.0, Directive.NORMAL, 1, 0, 1, 100, agents, targets, ()))


def recorded_store(path: Path, seconds: int = 40) -> None:
    """Write a store of a run with a picture and a frame each second."""
    chapter = Chapter(1, json_of(mission()))
    database = Database.create(path, Batch(tuple(map(row_of, events())), dict([chapter.kept])))
    for second in range(seconds):
        at_s = NOW_S + second
        record = STAMP.pack(round(1e6 * at_s)) + frame(at_s)
        things = [Recorded("picture", at_s, json.dumps(picture(at_s)).encode()), Recorded("frames", at_s, record)]
        database.record(things, 10_000_000)
    database.close()
