"""Missions, sources and sightings that the tests of live sources share."""

from __future__ import annotations

import gzip
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from companion.errors import InputError
from companion.geo.local_frame import LocalFrame
from companion.mission.model import Mission, parse_mission
from companion.mission.sources import SourceSpec
from groundstation.desk import Answer, Fact
from groundstation.events import Command, Event, Who
from groundstation.ground_station import GroundStation
from groundstation.sources.sighting import Category, Sighting

START_S = 1_790_000_000.0
DATA = Path(__file__).parent / "data"
FRAME = LocalFrame(48.7, 2.35)

COT = (
    '<?xml version="1.0" encoding="UTF-8"?><event version="2.0" uid="ICAO-4B1C22" type="a-n-A-C-F" how="m-g" '
    'time="2026-09-21T14:13:20.123456Z" start="2026-09-21T14:13:20Z" stale="2026-09-21T14:15:20.000Z">'
    '<point lat="48.70" lon="2.35" hae="620.0" ce="35.0" le="9999999.0"/><detail><contact callsign="SWR12"/>'
    '<track course="90.0" speed="51.4"/><status battery="85"/></detail></event>'
)
"""An event of Cursor on Target, at START_S."""


def mission(*sources: str, agents: str = "", more: str = "") -> Mission:
    listed = agents or "{id: 1, north_m: 0, east_m: 0, heading_deg: 0, speed_m_s: 10, n_max: 1}"
    text = f"""
name: sources
origin: {{lat_deg: 48.7, lon_deg: 2.35, alt_m: 100}}
agents: [{listed}]
targets: [{{id: 1, north_m: 3000, east_m: 0}}]
broadcast_period_s: 5
sources: [{", ".join(sources)}]
{more}
"""
    return parse_mission(text, "test")


def spec(**given: Any) -> SourceSpec:  # noqa: ANN401 - any of a source's keys
    if given.get("kind", "adsb") != "telemetry" and given.get("as", "threats") == "threats":
        given.setdefault("radius_m", 500.0)
    return SourceSpec.model_validate({"name": "s", "kind": "adsb", "url": "udpin:127.0.0.1:1", **given})


def sighting(key: str, north_m: float, east_m: float, at_s: float, **more: Any) -> Sighting:  # noqa: ANN401 - see above
    lat_deg, lon_deg = FRAME.to_global(north_m, east_m)
    given = {"category": Category.AIRCRAFT, "velocity": 0j, **more}
    return Sighting(key, lat_deg, lon_deg, at_s, **given)


@cache
def basestation_bytes() -> bytes:
    return gzip.decompress((DATA / "basestation.txt.gz").read_bytes())


class ObeyingDesk:
    """Obeys every command at once, and remembers the events."""

    def __init__(self, station: GroundStation) -> None:
        self.station = station
        self.now_s = START_S
        self.events: list[Event] = []

    def ask_with(self, command: Command, who: Who, facts: Callable[[Event], Sequence[Fact]], answer: Answer) -> None:
        try:
            event = self.station.command(command, who, self.now_s)
        except InputError as error:
            answer(error)
            return
        self.events.append(event)
        self.note_facts(facts(event))
        answer(event)

    def note_facts(self, facts: Iterable[Fact]) -> None:
        for fact in facts:
            event = fact(self.station.operations.next_number, self.now_s)
            self.station.adopt(event, self.now_s)
            self.events.append(event)

    def kinds(self) -> list[str]:
        return [event.event for event in self.events]
