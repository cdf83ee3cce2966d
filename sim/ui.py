"""A flight that is changed while it flies: by its page, and by recorded tracks; between two ticks.

The ground station of the flight takes commands as the real one does (groundstation/desk.py), and the simulated world
follows: what is added is there for sensor and score. Every event is kept in the flight's folder.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any, NamedTuple

from companion.errors import InputError
from companion.mission.model import Mission
from companion.onboard.decision import Decision
from groundstation.desk import Desk, begin_day
from groundstation.ground_station import GroundStation
from groundstation.meter import Meter, name_of
from groundstation.page import Overheard, Page
from groundstation.store.rows import EventRow
from groundstation.view import Surroundings
from groundstation.web.address import DEFAULT_ADDRESS, bound, listen, parse_address
from groundstation.web.bridge import Bridge
from groundstation.web.pipe import CLOCK, Request
from groundstation.web.site import Site
from sim.agent_log import AgentLog
from sim.flight_files import EVENTS_NAME
from sim.flight_record import FlightRecord
from sim.loop import START_S
from sim.pace import FASTEST, SLOWEST, Pace
from sim.stop import Stop
from sim.tracks import Tracks
from sim.world import World

OVER = "the flight is over; allowed: to look at it"
SHOW_PERIOD_S = 0.1
"""Wall-clock time between two looks at the page: what is asked waits no longer than that."""


class Stage(NamedTuple):
    """The parts of a flight that a page shows and changes."""

    station: GroundStation
    record: FlightRecord
    world: World
    budget_bytes_per_s: float | None
    can_stop: bool


class EventFile:
    """The events of a flight, a JSON line each, in its folder; without one they are kept nowhere."""

    def __init__(self, folder: Path | None) -> None:
        """Begin the file.

        Raises:
            OSError: it cannot be written.

        """
        self._file = None if folder is None else (folder / EVENTS_NAME).open("w", encoding="utf-8", buffering=1)

    def append(self, events: Iterable[EventRow]) -> Future[None]:
        """Keep events that were asked for."""
        done: Future[None] = Future()
        try:
            self.note(events)
        except OSError as error:
            done.set_exception(error)
        else:
            done.set_result(None)
        return done

    def note(self, events: Iterable[EventRow]) -> None:
        """Keep events that have happened."""
        if self._file is not None:
            self._file.writelines(f"{event.body}\n" for event in events)

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()


class SimScreen:
    """The bridge to the web process, with what only a simulator knows: pace, certificates and reasons on board."""

    def __init__(self, bridge: Bridge, pace: Pace) -> None:
        self.pace = pace
        self._bridge = bridge
        self._logs: Mapping[int, AgentLog] = {}
        self._t_s = 0.0
        self._is_over = False

    def board(self, logs: Mapping[int, AgentLog]) -> None:
        """Show what companions decide, by agent id."""
        self._logs = logs

    def publish(self, message: Mapping[str, Any]) -> None:
        """Show a message, pictures with what each companion has decided last."""
        if message["type"] == "picture":
            told = {identity: _told(log.last) for identity, log in self._logs.items()}
            agents = [{**agent, **told.get(agent["id"], {})} for agent in message["agents"]]
            message = {**message, "agents": agents}
        self._bridge.publish(message)

    def frames(self, t_s: float, datagrams: Iterable[bytes]) -> None:
        """Show unsigned frames that were broadcast."""
        self._bridge.frames(t_s, datagrams)

    def reply(self, identity: int, event: Mapping[str, Any]) -> None:
        """Answer a request with its event."""
        self._bridge.reply(identity, event)

    def refuse(self, identity: int, why: str) -> None:
        """Answer a request that is not obeyed."""
        self._bridge.refuse(identity, why)

    def pump(self) -> Sequence[Request]:
        """Send and receive without waiting; return what was asked of the ground station."""
        asked = self._bridge.pump()
        for request in asked:
            if request.command.get("do") == CLOCK:
                self._set_pace(request)
        return [request for request in asked if request.command.get("do") != CLOCK]

    def show_pace(self, t_s: float) -> None:
        """Show where the flight is and how fast it goes."""
        self._t_s = t_s
        self._bridge.publish(
            {
                "type": "playback",
                "from_s": START_S,
                "to_s": START_S + t_s,
                "at_s": START_S + t_s,
                "speed": self.pace.speed,
                "playing": self.pace.playing,
                "over": self._is_over,
            }
        )

    def end(self) -> None:
        """Show that the flight is over; its clock stands from now on."""
        self._is_over = True
        self.pace = self.pace.changed(self._t_s, time.monotonic(), playing=False)
        self.show_pace(self._t_s)

    def close(self) -> None:
        """End the page, after an answer to whoever has asked in the meantime."""
        self.end()
        for request in self.pump():
            self.refuse(request.id, OVER)
        self._bridge.close()

    def _set_pace(self, request: Request) -> None:
        try:
            if self._is_over:
                raise InputError(OVER)
            if request.who.role != "operator":
                raise InputError(f"{request.who.name} is {request.who.role}; allowed: for an operator only")
            speed, playing = _asked(request.command)
        except InputError as error:
            self.refuse(request.id, str(error))
            return
        self.pace = self.pace.changed(self._t_s, time.monotonic(), speed=speed, playing=playing)
        self.show_pace(self._t_s)
        self.reply(request.id, {"at_s": START_S + self._t_s, "speed": self.pace.speed, "playing": self.pace.playing})


def open_screen(address: str, pace: Pace) -> tuple[SimScreen, str]:
    """Serve the page at an address; return its screen, and the address as a browser is given it.

    Raises:
        InputError: it is no address of this computer only, or nothing can be served there.

    """
    wanted = parse_address(address)
    if not wanted.is_loopback:
        raise InputError(
            f"--ui: '{address}' can be reached from other computers; allowed: an address of this computer only, such "
            f"as {DEFAULT_ADDRESS}"
        )
    listener = listen(wanted)
    site = Site(bound(listener), "sim")
    return SimScreen(Bridge(site, listener), pace), site.url


class LiveFlight:
    """Has what is asked on a page, and what recorded tracks tell, happen in a flight between its ticks."""

    def __init__(self, screen: SimScreen | None, tracks: Tracks | None, stage: Stage, events: EventFile) -> None:
        """Begin before the first tick."""
        self._screen = screen
        self._tracks = tracks
        self._stage = stage
        self._station = stage.station
        self.overheard = Overheard(stage.station)
        """The ground station as its broadcaster is to use it, so that the page shows every frame."""
        self._desk = Desk(self._station, events, screen)
        self._meter = Meter()
        self._page = None if screen is None else self._shown_on(screen)
        self._followed: tuple[Mission, int] = (self._station.mission, _things(self._station.mission))
        """What world and record follow: the ground station's mission, and how much of it has ended in truth."""
        self._look_due_s = float("-inf")
        begin_day(self._desk, self._station, (), START_S)

    def rest(self, t_s: float, pace: Pace, stop: Callable[[], Stop | None]) -> Pace:
        """Obey what was asked, and return when the tick at a time of the flight is due, with the pace from then on.

        A screen has its own pace.
        """
        self._hear(t_s)
        while stop() is None:
            wall_s = time.monotonic()
            if wall_s >= self._look_due_s:
                self._look_due_s = wall_s + SHOW_PERIOD_S
                self.look(t_s)
            pace = pace if self._screen is None else self._screen.pace
            pace = pace.kept(t_s, time.monotonic())
            if self._screen is not None:
                self._screen.pace = pace
            wait_s = pace.wait_s(t_s, time.monotonic())
            if wait_s == 0.0:
                return pace
            time.sleep(SHOW_PERIOD_S if wait_s is None else min(wait_s, SHOW_PERIOD_S))
        return pace

    def look(self, t_s: float) -> None:
        """Show everything at a time of the flight, and obey what was asked."""
        now_s = START_S + t_s
        frames = self.overheard.taken()
        if self._screen is not None and self._page is not None:
            for frame in frames:
                self._meter.sent(name_of(frame), len(frame), now_s)
            self._screen.show_pace(t_s)
            self._page.tick(frames, now_s)
        self._obey(t_s)

    def _hear(self, t_s: float) -> None:
        """Take in what recorded tracks tell, and note what the ground station has noticed."""
        now_s = START_S + t_s
        if self._tracks is not None:
            self._tracks.tick(self._station, self._desk, now_s)
            self._obey(t_s)
            self._tracks.place(self._station, self._stage.world)
        self._desk.notice(now_s)

    def _obey(self, t_s: float) -> None:
        self._desk.tick(START_S + t_s)
        mission = self._station.mission
        truth = mission if self._tracks is None else self._tracks.truth(self._station)
        things = _things(truth)
        if self._followed[0] is not mission or self._followed[1] != things:
            self._followed = mission, things
            self._stage.world.follow(truth)
            self._stage.record.follow(truth, t_s)

    def _shown_on(self, screen: SimScreen) -> Page:
        screen.board(self._stage.record.logs)
        return Page(self._station, self._desk, screen, self._around, can_stop=self._stage.can_stop)

    def _around(self, now_s: float) -> Surroundings:
        budget = {"budget_bytes_per_s": self._stage.budget_bytes_per_s}
        radio = {"authentication": "unsigned", "link": "simulated"}
        broadcast = self._meter.reading(now_s) | budget | radio
        if self._tracks is None:
            return Surroundings("sim", broadcast)
        sources = self._tracks.sources
        return Surroundings("sim", broadcast, sources.view(self._station, now_s), sources.unknown_view(now_s))


def linger(screen: SimScreen, stop: Callable[[], Stop | None]) -> None:
    """Keep the page of a flight that is over until a signal comes."""
    screen.end()
    while stop() is None:
        for request in screen.pump():
            screen.refuse(request.id, OVER)
        time.sleep(SHOW_PERIOD_S)


def _things(mission: Mission) -> int:
    """Return the number of targets and threats."""
    return len(mission.targets) + len(mission.threats)


def _told(decision: Decision | None) -> dict[str, str]:
    """Return what a picture has of a companion's last decision."""
    if decision is None:
        return {}
    return {"certificate": decision.certificate_words, "reason": f"{decision.purpose.value}: {decision.reason}"}


def _asked(command: Mapping[str, Any]) -> tuple[float | None, bool | None]:
    """Return the speed and the state of the clock that a command asks for; raises InputError."""
    if "at_s" in command:
        raise InputError("at_s: a flight under way cannot be wound; allowed: speed, playing")
    speed, playing = command.get("speed"), command.get("playing")
    if speed is not None and not SLOWEST <= float(speed) <= FASTEST:
        raise InputError(f"speed: {speed:g}; allowed: {SLOWEST:g} to {FASTEST:g}")
    return None if speed is None else float(speed), None if playing is None else bool(playing)
