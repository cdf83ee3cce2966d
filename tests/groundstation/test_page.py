"""What a run shows on its page, and when: moves, and who may ask for something."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import pytest

from companion.mission.model import parse_mission
from companion.transport.endpoints import parse_link
from groundstation.desk import Desk
from groundstation.ground_station import GroundStation
from groundstation.meter import BroadcastMeter
from groundstation.options import Options
from groundstation.page import Page
from groundstation.web.pipe import Request, Who
from tests.groundstation.test_desk import Disk

START_S = 1_790_000_000.0
MISSION = """
name: shown
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}]
targets: [{id: 1, north_m: 9000, east_m: 0}]
"""


class Screen:
    """Keeps what was shown and refused, and asks once."""

    def __init__(self, *asked: Request) -> None:
        self.shown: list[str] = []
        self.refused: dict[int, str] = {}
        self._asked = asked

    def publish(self, message: Mapping[str, Any]) -> None:
        self.shown.append(str(message["type"]))

    def frames(self, t_s: float, datagrams: Iterable[bytes]) -> None:
        pass

    def refuse(self, identity: int, why: str) -> None:
        self.refused[identity] = why

    def pump(self) -> Sequence[Request]:
        asked, self._asked = self._asked, ()
        return asked


def day(screen: Screen) -> tuple[Page, Desk, Disk]:
    """Return a page on a screen, the desk behind it and the disk of the desk."""
    station, disk = GroundStation(parse_mission(MISSION, "shown"), START_S), Disk()
    meter = BroadcastMeter(Options(parse_link("udpout:127.0.0.1:9"), "unsigned"))
    desk = Desk(station, disk)
    return Page(station, desk, screen, meter.surroundings), desk, disk


def shown_at(times_s: Iterable[float]) -> list[str]:
    """Return the kinds of the messages that a page shows in ticks at times since its start."""
    screen = Screen()
    page, _, _ = day(screen)
    for at_s in times_s:
        page.tick((), START_S + at_s)
    return screen.shown


@pytest.mark.parametrize("tick_s", [0.05, 0.06, 0.07, 0.13])
def test_moves_are_shown_five_times_a_second_whatever_the_ticks_between_which_they_are_due(tick_s: float) -> None:
    shown = shown_at(tick * tick_s for tick in range(round(60.0 / tick_s)))
    assert 299 <= shown.count("moves") <= 301


def test_moves_that_were_late_are_not_made_up_for() -> None:
    assert shown_at((0.0, 30.0, 30.05, 30.1)).count("moves") == 2


@pytest.mark.parametrize(
    ("role", "kept", "refused"),
    [("operator", ["taken-out"], {}), ("observer", [], {7: "anna is observer; allowed: for an operator only"})],
)
def test_only_what_an_operator_asks_comes_to_the_desk(role: str, kept: list[str], refused: dict[int, str]) -> None:
    screen = Screen(Request(7, Who("anna", role), {"do": "take-out", "agent": 1}))
    page, desk, disk = day(screen)
    page.tick((), START_S)
    desk.tick(START_S)
    assert [row.event for row in disk.rows] == kept
    assert screen.refused == refused
