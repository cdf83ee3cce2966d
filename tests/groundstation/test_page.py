"""What a run shows on its page, and when: pictures, moves and who may ask for what."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future
from typing import Any

import pytest

from companion.mission.model import parse_mission
from companion.transport.endpoints import parse_link
from groundstation.desk import Desk
from groundstation.ground_station import GroundStation
from groundstation.meter import BroadcastMeter
from groundstation.options import Options
from groundstation.page import Page
from groundstation.store.rows import EventRow
from groundstation.web.pipe import Request

START_S = 1_790_000_000.0
MISSION = """
name: shown
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}]
targets: [{id: 1, north_m: 9000, east_m: 0}]
"""


class Screen:
    def __init__(self) -> None:
        self.shown: list[str] = []

    def publish(self, message: Mapping[str, Any]) -> None:
        self.shown.append(str(message["type"]))

    def frames(self, t_s: float, datagrams: Iterable[bytes]) -> None:
        pass

    def refuse(self, identity: int, why: str) -> None:
        pass

    def reply(self, identity: int, event: Mapping[str, Any]) -> None:
        pass

    def pump(self) -> Sequence[Request]:
        return ()


class Store:
    def append(self, events: Iterable[EventRow]) -> Future[None]:
        done: Future[None] = Future()
        done.set_result(None)
        return done

    def note(self, events: Iterable[EventRow]) -> None:
        pass


@pytest.mark.parametrize("tick_s", [0.05, 0.06, 0.07, 0.13])
def test_moves_are_shown_five_times_a_second_whatever_the_ticks_between_which_they_are_due(tick_s: float) -> None:
    station, screen = GroundStation(parse_mission(MISSION, "shown"), START_S), Screen()
    meter = BroadcastMeter(Options(parse_link("udpout:127.0.0.1:9"), "unsigned"))
    page = Page(station, Desk(station, Store(), screen), screen, meter.surroundings)
    for tick in range(round(60.0 / tick_s)):
        page.tick((), START_S + tick * tick_s)
    assert 299 <= screen.shown.count("moves") <= 301


def test_moves_that_were_late_are_not_made_up_for() -> None:
    station, screen = GroundStation(parse_mission(MISSION, "shown"), START_S), Screen()
    meter = BroadcastMeter(Options(parse_link("udpout:127.0.0.1:9"), "unsigned"))
    page = Page(station, Desk(station, Store(), screen), screen, meter.surroundings)
    for at_s in (0.0, 30.0, 30.05, 30.1):
        page.tick((), START_S + at_s)
    assert screen.shown.count("moves") == 2
