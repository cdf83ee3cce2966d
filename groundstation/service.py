"""Shell of `groundstation run`: the links, the clock, the keys and the files around the core."""

from __future__ import annotations

import asyncio
import importlib
import json
import stat
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from companion.errors import InputError
from companion.files.log_series import LogSeries, file_bytes
from companion.files.tlog import TlogWriter
from companion.guidance.settings import DEFAULT_LAW
from companion.mission.model import Mission
from companion.onboard.flight_log import FlightLog
from companion.protocol.deframer import StreamFramer
from companion.protocol.ed25519 import FrameSigner
from companion.protocol.frame import raw_frame
from companion.protocol.keys import MAVLINK_NAME, PRIVATE_NAME, load_mavlink_key, load_private
from companion.protocol.messages import Directive
from companion.protocol.radio_status import read_radio_status
from companion.protocol.v2_extension import unwrap
from companion.runtime.clock import wait
from companion.runtime.console import program_logger
from companion.runtime.io_thread import IoThreadFile, open_io_thread
from companion.runtime.systemd import Notifier
from companion.transport.endpoints import Link, Sender, open_receiver, open_sender
from groundstation.adsb_mirror import AdsbMirror
from groundstation.agents import VehicleModel
from groundstation.choices import Authentication
from groundstation.clock import GroundClock, WallSigner
from groundstation.desk import Desk, begin_day, end_day
from groundstation.directives import DirectiveInput
from groundstation.events import Direct, Who
from groundstation.ground_station import GroundStation, Resumed
from groundstation.input_keys import input_trusts
from groundstation.log_files import log_place
from groundstation.meter import BroadcastMeter
from groundstation.operations import DIRECTIVE_NAMES
from groundstation.options import Options
from groundstation.page import Overheard, Page
from groundstation.resumption import Resumption, resumption
from groundstation.rivals import LOCK_NAME, Rivals, RunLock
from groundstation.saved_state import RunState
from groundstation.schedule import TICK_S as RADIO_TICK_S
from groundstation.schedule import Broadcaster
from groundstation.sources.sources import Sources
from groundstation.status import Status
from groundstation.store.event_store import EventStore
from groundstation.store.recorder import Recorder
from groundstation.view import Surroundings

if TYPE_CHECKING:
    from groundstation.web.bridge import Bridge

LOGGER = program_logger("groundstation")
TICK_S = 0.05
"""Period at which the core is asked for due frames without a radio: short against any broadcast period in use."""
WEB_LIBRARIES = ("fastapi", "orjson", "prometheus_client", "uvicorn", "websockets", "xstatic")
"""What the web process needs beside the base libraries."""
LAST_TIMES = 2
"""Number of last broadcasts: one that is lost costs nothing but the word that nothing is broken."""
LAST_S = 5.0
"""Longest time for them over a slow radio."""
LOAD_AFTER_S = 0.2
"""Time after which the solver is loaded in the background: the first frames are on the air by then."""
SOLVER = "scipy.optimize"
"""The library of the assignment, which is loaded when it is first needed."""
LINK_ID = 0
"""Link id in the MAVLink signatures of the ground station."""
STANDARD_INPUT = Who(name="standard input", role="operator")
_OTHERS = 0o077
"""Permission bits of the group and of all others."""


def load_frame_signer(authentication: Authentication, folder: Path | None) -> FrameSigner:
    """Return the signer of frames with the keys in a folder; it signs nothing if the folder is None.

    Raises:
        InputError: the folder or a key in it is missing, open to others, or unusable.

    """
    if folder is None:
        return FrameSigner(None, None)
    try:
        mode = folder.stat().st_mode
    except OSError as error:
        raise InputError(
            f"--keys: '{folder}': {error.strerror}; allowed: the folder that `groundstation keygen {folder}` makes"
        ) from error
    if not stat.S_ISDIR(mode):
        raise InputError(f"--keys: '{folder}' is no folder; allowed: the one that `groundstation keygen` made")
    if mode & _OTHERS:
        raise InputError(
            f"--keys: '{folder}' is open to others (mode {stat.S_IMODE(mode):03o}); allowed: its owner only; "
            f"chmod 700 {folder}"
        )
    private_key = load_private(folder / PRIVATE_NAME) if authentication in ("ed25519", "both") else None
    signer = None
    if authentication in ("mavlink", "both"):
        signer = WallSigner(load_mavlink_key(folder / MAVLINK_NAME), LINK_ID)
    return FrameSigner(private_key, signer)


async def run_groundstation(mission: Mission, options: Options, stop: asyncio.Event) -> None:
    """Broadcast a resolved mission until `stop` is set.

    Without a sensor the ground station knows only the mission file: the radii of threats that may move grow with age,
    and in Case I no agent ever counts as lost or arrived.

    Raises:
        InputError: a link cannot be opened, a file cannot be used, or the ground station cannot run the mission.

    """
    frame_signer = load_frame_signer(options.authentication, options.keys)
    clock = GroundClock()
    start_s = clock.now_s()
    with ExitStack() as stack:
        # Opened first and so closed last, after everything that still has bytes to write.
        files = open_io_thread("files", stack)
        unlocked = _lock(options, stack)
        found = resumption(options.state, mission, options.new_flight)
        store = EventStore(options.state, found.database, files, int(options.store_mb * 1e6))
        stack.callback(store.close)
        saved = RunState(options, mission, frame_signer.signer, start_s, store, found.last)
        resumed = saved.resumed._replace(operations=found.begun.operations, places=found.places)
        station = _station(mission, options, resumed, start_s)
        overheard = Overheard(station)
        broadcaster = Broadcaster(overheard, options.radio, frame_signer)
        broadcaster.begin(start_s)
        log = _opened_log(options, stack)
        rivals = Rivals(frame_signer)
        hearing = _Hearing(clock, log, stack)
        sources = Sources(mission, options.sources)
        sources.restore(station, start_s)
        links = await _open_links(options, station, hearing, sources)
        await _listen(options, station, rivals, hearing)
        shown = _shown(options, overheard, store, sources, found, stack)
        # On disk before the first frame is on the air.
        store.keep(*found.begun.chapter.kept)
        begin_day(shown.desk, station, found.orders, start_s)
        saved.write(station, start_s)
        stack.callback(lambda: saved.write(station, clock.now_s()))
        status = Status(station, broadcaster, options)
        for line in [status.opening(), *saved.news(start_s, station.directive)]:
            LOGGER.info("%s", line)
        for warning in [*unlocked, *saved.warnings(), *found.begun.warnings]:
            LOGGER.warning("%s", warning)
        run = _Run(station, broadcaster, AdsbMirror(mission), status, saved, frame_signer, rivals)
        loop = BroadcastLoop(run, links, log, shown)
        # Heard only now that what they ask for can be obeyed.
        sources.listen(clock.now_s, stack)
        asyncio.get_running_loop().call_later(LOAD_AFTER_S, _load_ahead)
        await loop.run(clock, stop)


def _load_ahead() -> None:
    """Load what the next assignment needs in the background: after a restart the first one may come much later.

    Loaded in the loop it would hold up the broadcast, by half a second of processor time.
    """
    threading.Thread(target=importlib.import_module, args=(SOLVER,), name="loading", daemon=True).start()


def _shown(
    options: Options,
    overheard: Overheard,
    store: EventStore,
    sources: Sources,
    found: Resumption,
    stack: ExitStack,
) -> Shown:
    """Return what takes commands from standard input and the page, and shows the run there; raises InputError.

    `found` is what the run goes on with: its events begin the page's time line, and the page has its warnings too.
    """
    station, meter = overheard.station, BroadcastMeter(options)
    screen = _screen(options, stack)
    if screen is not None:
        for row in found.told:
            screen.publish({"type": "event", "event": json.loads(row.body)})
    desk = Desk(station, store, screen)
    # Without a file there is nobody who could look at it later, and memory is short.
    recorder = None if options.state is None else Recorder(store, screen)
    if recorder is not None:
        stack.callback(recorder.close)

    def direct(directive: Directive) -> None:
        desk.ask(Direct(do="direct", directive=DIRECTIVE_NAMES[directive]), STANDARD_INPUT)

    stack.callback(DirectiveInput(direct).close)

    def around(now_s: float) -> Surroundings:
        rows, strangers = sources.view(station, now_s), sources.unknown_view(now_s)
        return replace(meter.surroundings(now_s), sources=rows, unknown=strangers, warnings=found.begun.warnings)

    page, shows = None, recorder or screen
    if shows is not None:
        is_seen = screen is not None
        page = Page(station, desk, shows, around, can_stop=options.can_stop, is_seen=is_seen)
    return Shown(desk, overheard, meter, page, sources)


def _opened_log(options: Options, stack: ExitStack) -> FlightLog:
    """Return the log of a run, which writes nothing without --log; `stack` closes it."""
    if options.log is None:
        return FlightLog(None)
    most_bytes = int(options.log_mb * 1e6)
    series = LogSeries(log_place(options.log, most_bytes), file_bytes(most_bytes))
    # A thread of its own: a disk for logs that hangs must not keep the state from being written.
    file = IoThreadFile(series, open_io_thread("logs", stack))
    stack.callback(file.close)
    return FlightLog(TlogWriter(file), "groundstation")


def _screen(options: Options, stack: ExitStack) -> Bridge | None:
    """Return the bridge to the page, which `stack` closes; None without one. Raises InputError if it cannot be served.

    The libraries that the page needs are loaded only here: a run without one starts without them.
    """
    if options.site is None:
        return None
    for library in WEB_LIBRARIES:
        if find_spec(library) is None:
            # Said here, as the web process would end again and again.
            raise ModuleNotFoundError(f"No module named '{library}'", name=library)
    from groundstation.web.address import bound, listen
    from groundstation.web.bridge import Bridge

    listener = listen(options.site.address)
    site = replace(options.site, address=options.site.address._replace(port=bound(listener).port))
    bridge = Bridge(site, listener)
    stack.callback(bridge.close)
    LOGGER.info("page: %s", site.url)
    return bridge


def _station(mission: Mission, options: Options, resumed: Resumed, start_s: float) -> GroundStation:
    """Return the ground station of a run that takes over from the last one; raises InputError."""
    station = GroundStation(
        mission,
        start_s,
        sensed=options.sensor is not None or any(spec.things == "agents" for spec in options.sources),
        model=VehicleModel(DEFAULT_LAW, options.can_stop),
        resumed=resumed,
        sensor_error_m=options.sensor_error_m,
    )
    station.inputs.sensor, station.inputs.uplink = input_trusts(options, mission)
    return station


def _lock(options: Options, stack: ExitStack) -> list[str]:
    """Take the locks of keys and store, which `stack` frees; return warnings about those that cannot be taken.

    Raises:
        InputError: another run has one of them.

    """
    warnings: list[str] = []
    paths: list[Path] = []
    if options.keys is not None:
        paths.append(options.keys / LOCK_NAME)
    if options.state is not None:
        paths.append(options.state.with_name(f"{options.state.name}.lock"))
    for path in paths:
        try:
            stack.callback(RunLock(path).close)
        except OSError as error:
            warnings.append(f"{path}: no lock: {error.strerror}; a second ground station would not be noticed here")
    return warnings


async def _listen(options: Options, station: GroundStation, rivals: Rivals, hearing: _Hearing) -> None:
    """Hear the broadcast's own link where that is possible; raises InputError for one that was asked for."""
    link = options.listened
    if link is None:
        return

    def hear(datagram: bytes, now_s: float) -> None:
        rivals.hear(datagram, station.epoch_s, now_s)

    try:
        await hearing.open(link, hear, is_logged=False)
    except InputError as error:
        if options.listen is not None:
            raise
        LOGGER.warning("%s: another ground station would not be noticed", error)


@dataclass(frozen=True)
class _Run:
    """The objects that decide in one run of the ground station."""

    station: GroundStation
    broadcaster: Broadcaster
    mirror: AdsbMirror
    status: Status
    saved: RunState
    signer: FrameSigner
    rivals: Rivals


@dataclass(frozen=True)
class _Links:
    """The links on which the ground station sends."""

    broadcast: Sender
    display: Sender | None
    """Link of the ADS-B mirror; None without one."""


@dataclass(frozen=True)
class _Hearing:
    """Opens receiving links; `log` records the frames received, and `stack` closes the links."""

    clock: GroundClock
    log: FlightLog
    stack: ExitStack

    async def open(self, link: Link, take: Callable[[bytes, float], None], is_logged: bool = True) -> None:
        """Open a link whose datagrams, or frames of a stream, go to `take` with the time; raises InputError."""
        framer = StreamFramer() if link.scheme == "serial" else None

        def on_datagram(datagram: bytes) -> None:
            now_s = self.clock.now_s()
            if framer is None:
                take(datagram, now_s)
                if is_logged:
                    self.log.record(now_s, datagram)
                return
            for frame in framer.feed(datagram):
                take(frame.data, now_s)
                if is_logged:
                    self.log.record_frame(now_s, frame)

        receiver = await open_receiver(link, on_datagram)
        self.stack.callback(receiver.close)


async def _open_links(options: Options, station: GroundStation, hearing: _Hearing, sources: Sources) -> _Links:
    """Open all links, which the stack of `hearing` closes; raises InputError."""
    stack = hearing.stack
    broadcast = await open_sender(options.link, read_radio_status)
    stack.callback(broadcast.close)
    if options.sensor is not None:
        await hearing.open(options.sensor, sources.sensed(station.sense, str(options.sensor)))
    if options.uplink is not None:
        await hearing.open(options.uplink, station.hear_report)
    if options.mirror is None:
        return _Links(broadcast, None)
    display = await open_sender(options.mirror)
    stack.callback(display.close)
    return _Links(broadcast, display)


@dataclass
class Shown:
    """What takes commands, and what is shown of a run."""

    desk: Desk
    overheard: Overheard
    meter: BroadcastMeter
    page: Page | None
    sources: Sources
    fault: str = ""
    """Why the page could not be shown in the last tick; empty if it could."""

    def tick(self, now_s: float) -> None:
        """Show what is due."""
        frames = self.overheard.taken()
        if self.page is None:
            return
        try:
            self.page.tick(frames, now_s)
        except Exception as error:
            # A fault in what is only shown must not end the broadcast.
            fault = f"{type(error).__name__}: {error}"
            if fault != self.fault:
                LOGGER.error("page: cannot be shown: %s; the broadcast goes on", fault, exc_info=True)
            self.fault = fault
        else:
            self.fault = ""


class BroadcastLoop:
    """Sends the frames that are due, logs messages and saves the state, until it is stopped."""

    def __init__(self, run: _Run, links: _Links, log: FlightLog, shown: Shown) -> None:
        self._run = run
        self._links = links
        self._log = log
        self._shown = shown
        radio = shown.meter.options.radio
        self._period_s = TICK_S if radio is None else RADIO_TICK_S
        self._added_bytes = 0 if radio is None else radio.added_bytes
        """Number of bytes added to each frame on its way (Radio.added_bytes)."""
        self._notifier = Notifier()

    async def run(self, clock: GroundClock, stop: asyncio.Event) -> None:
        """Broadcast until `stop` is set."""
        self._notifier.ready()
        while not stop.is_set():
            now_s = clock.now_s()
            self._notifier.alive()
            self._follow(clock, now_s)
            self._shown.desk.tick(now_s)
            self._notice(now_s)
            # A new directive or target is on disk before it is on the air: no restart may take back what was heard.
            self._run.saved.write_if_due(self._run.station, now_s)
            if not self._run.saved.holds(now_s):
                self._send(now_s)
            # After the frames, which no source delays.
            self._shown.sources.tick(self._run.station, self._shown.desk, now_s)
            self._tell(now_s)
            # Last, so that what is shown never delays what is sent.
            self._shown.tick(now_s)
            await wait(stop, self._period_s)
        self._notifier.close()
        await self._end(clock)

    async def _end(self, clock: GroundClock) -> None:
        """Say in a last broadcast, and on the page, that the ground station stops."""
        began_s = now_s = clock.now_s()
        end_day(self._shown.desk, self._run.station, now_s)
        for _ in range(LAST_TIMES):
            self._put(self._run.broadcaster.last(self._run.station.last(now_s), now_s), now_s)
            while not self._run.broadcaster.has_told and now_s - began_s < LAST_S:
                await asyncio.sleep(self._period_s)
                now_s = clock.now_s()
                self._send(now_s)
            await asyncio.sleep(self._period_s)
            now_s = clock.now_s()
            self._shown.tick(now_s)

    def _follow(self, clock: GroundClock, now_s: float) -> None:
        """Let stamps follow the computer's clock, and say so, if that was set or the computer slept."""
        change = clock.watch()
        if not change:
            return
        self._run.station.follow_clock(clock.ahead_s, change.slept_s, now_s)
        if isinstance(self._run.signer.signer, WallSigner):
            self._run.signer.signer.follow(clock.ahead_s, now_s)
        for line in change.words():
            LOGGER.warning("%s", line)

    def _notice(self, now_s: float) -> None:
        """Keep what the ground station has noticed, before it is broadcast."""
        if self._shown.meter.options.radio is None:
            # Over a radio all that is told was found out a while before (schedule.py).
            self._shown.overheard.advance(now_s)
        if self._shown.desk.notice(now_s):
            self._run.saved.hold(now_s)

    def _send(self, now_s: float) -> None:
        display = self._links.display
        self._put(self._run.broadcaster.tick(now_s, self._links.broadcast.txbuf_percent), now_s)
        if display is not None:
            for data in self._run.mirror.tick(self._run.station.tracks, now_s):
                display.send(data)

    def _put(self, frames: Sequence[bytes], now_s: float) -> None:
        """Send signed frames, count them and log them."""
        for data in frames:
            self._links.broadcast.send(data)
            self._run.status.sent_bytes += len(data) + self._added_bytes
            frame = unwrap(raw_frame(data)) or data
            self._shown.meter.sent(frame, len(data) + self._added_bytes, now_s)
            self._run.rivals.sent(frame)
            self._log.record(now_s, frame)

    def _tell(self, now_s: float) -> None:
        status = self._run.status
        good, doubtful = self._shown.sources.news(now_s)
        for line in [*status.news(now_s, self._links.broadcast.counts.sent), *good]:
            LOGGER.info("%s", line)
        for warning in [*status.warnings(), *self._run.rivals.news(now_s), *doubtful]:
            LOGGER.warning("%s", warning)
