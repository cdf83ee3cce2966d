"""Shell of `groundstation run`: the links, the clock, the keys and the files around the core.

The sender's time never falls behind: the epoch and the time of what was broadcast last are kept in a file, and a run
that begins with the system clock set back goes on from there, so that vehicles that demand ever newer frames hear it.
"""

from __future__ import annotations

import asyncio
import json
import os
import signal
import stat
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

import click

from companion.config import DEFAULT_LAW
from companion.encapsulation import unwrap
from companion.errors import InputError, nearest_hint
from companion.flightlog import FlightLog
from companion.frames import Directive
from companion.framing import StreamFramer
from companion.keys import MAVLINK_NAME, PRIVATE_NAME, load_mavlink_key, load_private
from companion.mission import Mission
from companion.process import SteadyClock, wait
from companion.sealing import Sealer
from companion.signing import MavlinkSigner
from companion.statefile import read_state_file, write_state_file
from companion.tlog import TlogWriter
from companion.transport import Link, open_receiver, open_sender
from groundstation.core import GroundStation
from groundstation.mirror import Mirror
from groundstation.plan import Authentication
from groundstation.radio import Radio
from groundstation.schedule import TICK_S as RADIO_TICK_S
from groundstation.schedule import Broadcaster

TICK_S = 0.05
"""How often the core is asked what is due without a radio: fine against any broadcast period in use."""
STATE_PERIOD_S = 5.0
"""How often the time of what was broadcast last is written to disk."""
STATUS_PERIOD_S = 60.0
"""How often what was sent is told."""
BEHIND_S = 2.0
"""A clock farther behind the last run is worth a warning: a restart within the second is not."""
LINK_ID = 0
"""Of our stream of MAVLink signatures."""
STATE_NAME = "groundstation.state"
"""In the folder of the keys, unless another file is named."""
_MOST_PAIRS = 20
"""Agents up to which the status names each with its target."""
_OTHERS = 0o077
_LINE_BYTES = 4096

_WORDS: dict[Authentication, str] = {
    "unsigned": "unsigned",
    "mavlink": "MAVLink signed",
    "ed25519": "Ed25519 signed",
    "both": "Ed25519 and MAVLink signed",
}


@dataclass(frozen=True)
class Options:
    """How a mission is broadcast."""

    link: Link
    authentication: Authentication
    keys: Path | None = None
    radio: Radio | None = None
    sensor: Link | None = None
    uplink: Link | None = None
    mirror: Link | None = None
    log: Path | None = None
    state: Path | None = None
    can_stop: bool = False
    """Case II: whether the agents that are reckoned can stand still."""


@dataclass(frozen=True)
class Kept:
    """What of a run must be known to the next one."""

    epoch_s: int
    time_s: float
    """Of the last frame that may have been sent."""
    signing_timestamp: int
    """MAVLink's, of the last frame."""


def kept_from(text: str, source: Path) -> Kept:
    """Return what a state file keeps.

    Raises:
        InputError: the text is nothing of ours; `source` names it.

    """
    try:
        values = json.loads(text)
        kept = Kept(int(values["epoch_s"]), float(values["time_s"]), int(values["signing_timestamp"]))
    except (ValueError, TypeError, KeyError, OverflowError) as error:
        raise InputError(
            f"{source}: no state of a ground station; allowed: the file that the last run wrote, or one that is not "
            "there yet"
        ) from error
    return kept


def start_after(kept: Kept | None, now_s: float) -> float:
    """Return when a run begins, in Unix seconds: now, but later than anything that the last run can have sent."""
    if kept is None:
        return now_s
    if now_s < kept.time_s:
        # The file may be older than the last frame by as much as the time between two writings.
        now_s = kept.time_s + 2.0 * STATE_PERIOD_S
    return max(now_s, kept.epoch_s + 1.0)


def directive_from(line: str) -> Directive:
    """Return the directive that a line names.

    Raises:
        InputError: it names none.

    """
    words = {directive.name.lower(): directive for directive in Directive}
    word = line.strip().lower()
    if word not in words:
        raise InputError(f"directive: '{word[:40]}'{nearest_hint(word, words)}; allowed: {', '.join(words)}")
    return words[word]


def load_sealer(authentication: Authentication, folder: Path | None) -> Sealer:
    """Return what signs the frames, with the keys in a folder.

    Raises:
        InputError: the folder or a key in it is missing, open to others, or no key.

    """
    if folder is None:
        return Sealer(None, None)
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
        signer = MavlinkSigner(load_mavlink_key(folder / MAVLINK_NAME), LINK_ID)
    return Sealer(private_key, signer)


async def run_groundstation(mission: Mission, options: Options, stop: asyncio.Event) -> None:
    """Broadcast a resolved mission until `stop` is set.

    Without a sensor the ground station knows no more than the mission file: threats that may move grow with age, and in
    Case I nobody can be known to be lost or to have arrived.

    Raises:
        InputError: a link cannot be opened, a file not used, or the mission asks for something that cannot be done.

    """
    sealer = load_sealer(options.authentication, options.keys)
    clock = _Clock(options.state, sealer)
    station = GroundStation(
        mission, clock.now_s(), sensed=options.sensor is not None, law=DEFAULT_LAW, can_stop=options.can_stop
    )
    broadcaster = Broadcaster(station, options.radio, sealer)
    mirror = Mirror(mission)
    with ExitStack() as stack:
        log = FlightLog(None if options.log is None else TlogWriter(options.log), "groundstation")
        stack.callback(log.close)

        async def listen(link: Link | None, take: Callable[[bytes, float], None]) -> None:
            framer = StreamFramer() if link is not None and link.scheme == "serial" else None

            def on_datagram(datagram: bytes) -> None:
                now_s = clock.now_s()
                for frames in [datagram] if framer is None else framer.feed(datagram):
                    take(frames, now_s)
                    log.record(now_s, frames)

            if link is not None:
                receiver = await open_receiver(link, on_datagram)
                stack.callback(receiver.close)

        sender = await open_sender(options.link)
        stack.callback(sender.close)
        await listen(options.sensor, station.sense)
        await listen(options.uplink, station.hear_report)
        display = None
        if options.mirror is not None:
            display = await open_sender(options.mirror)
            stack.callback(display.close)
        # On disk before the first frame is on the air.
        clock.keep(station.epoch_s)
        stack.callback(lambda: clock.keep_if_possible(station.epoch_s))
        stack.callback(_take_orders(station))
        status = _Status(station, options)
        click.echo(f"groundstation: {status.opening()}")
        while not stop.is_set():
            now_s = clock.now_s()
            for data in broadcaster.tick(now_s, sender.txbuf_percent):
                sender.send(data)
                status.sent_bytes += len(data)
                log.record(now_s, unwrap(data) or data)
            if display is not None:
                for data in mirror.tick(station.picture, now_s):
                    display.send(data)
            clock.keep_now_and_then(station.epoch_s)
            for line in status.news(now_s, broadcaster.pace, sender.counts.sent):
                click.echo(f"groundstation: {line}")
            await wait(stop, TICK_S if options.radio is None else RADIO_TICK_S)


class _Clock:
    """Time that never steps and never falls behind what was broadcast before, and the file that sees to that."""

    def __init__(self, path: Path | None, sealer: Sealer) -> None:
        """Begin after the last run; raises InputError if the file cannot be used."""
        self._path = path
        self._signer = sealer.signer
        self._clock = SteadyClock()
        text = None if path is None else read_state_file(path)
        kept = None if path is None or text is None else kept_from(text, path)
        now_s = self._clock.now_s()
        self._ahead_s = start_after(kept, now_s) - now_s
        self._kept_at_s = -STATE_PERIOD_S
        if kept is not None and self._signer is not None:
            self._signer.last_timestamp = kept.signing_timestamp
        if self._ahead_s > BEHIND_S:
            click.echo(
                f"groundstation: warning: the system clock is {self._ahead_s:.0f} s behind the last run; going on from "
                "there, but vehicles with the right time will refuse what is old: set the clock",
                err=True,
            )

    def now_s(self) -> float:
        """Return Unix seconds."""
        return self._clock.now_s() + self._ahead_s

    def keep(self, epoch_s: int) -> None:
        """Write what the next run must know; raises InputError if that fails."""
        if self._path is not None:
            now_s = self.now_s()
            timestamp = 0 if self._signer is None else self._signer.last_timestamp
            write_state_file(self._path, json.dumps(asdict(Kept(epoch_s, now_s, timestamp))))
            self._kept_at_s = now_s

    def keep_now_and_then(self, epoch_s: int) -> None:
        """Write it if the last time is long enough ago."""
        if self.now_s() - self._kept_at_s >= STATE_PERIOD_S:
            self.keep_if_possible(epoch_s)

    def keep_if_possible(self, epoch_s: int) -> None:
        """Write it; a disk that fails is warned of once, and given up: the broadcast goes on."""
        try:
            self.keep(epoch_s)
        except InputError as error:
            self._path = None
            click.echo(f"groundstation: warning: {error}; no longer keeping it", err=True)


class _Status:
    """What is said of a run."""

    def __init__(self, station: GroundStation, options: Options) -> None:
        self._station = station
        self._options = options
        self.sent_bytes = 0
        self._said = ""
        self._told_at_s: float | None = None
        self._told_bytes = 0

    def opening(self) -> str:
        """Return the first line."""
        options, mission = self._options, self._station.mission
        radio = options.radio
        over = f", radio {radio.name} at {radio.share:.0%}" if radio is not None else ""
        mirror = f", mirror {options.mirror}" if options.mirror is not None else ""
        return (
            f"{mission.name} on {options.link} ({_WORDS[options.authentication]}){over}, case {mission.case}, "
            f"sensor {options.sensor or 'none'}, uplink {options.uplink or 'none'}{mirror}"
        )

    def news(self, now_s: float, pace: float, frames: int) -> list[str]:
        """Return the lines that are due: of the mission when they change, of the link every minute."""
        lines = []
        line = f"{self._mission_line()} ({_WORDS[self._options.authentication]})"
        if line != self._said:
            lines.append(line)
            self._said = line
        if self._told_at_s is None:
            self._told_at_s = now_s
        elif now_s - self._told_at_s >= STATUS_PERIOD_S:
            rate_bytes_per_s = (self.sent_bytes - self._told_bytes) / (now_s - self._told_at_s)
            slowed = f", slowed to {pace:.0%} by the radio's buffer" if pace < 1.0 else ""
            lines.append(
                f"{frames} frames sent, {rate_bytes_per_s:.0f} B/s{slowed} ({_WORDS[self._options.authentication]})"
            )
            self._told_at_s, self._told_bytes = now_s, self.sent_bytes
        return lines

    def _mission_line(self) -> str:
        station = self._station
        picture = station.picture
        pairs = ", ".join(f"{agent} to {target}" for agent, target in sorted(station.assignment.items()))
        if len(station.assignment) > _MOST_PAIRS:
            pairs = f"{len(station.assignment)} of {len(picture.present_agents)} sent"
        directive = "" if station.directive is Directive.NORMAL else f"directive {station.directive.name.lower()}; "
        return (
            f"{directive}agents to targets: {pairs or 'none'}; reached {sorted(picture.completed)}, "
            f"arrived {sorted(picture.arrived)}, lost {sorted(picture.lost)}, uncovered {list(station.uncovered)}"
        )


def _take_orders(station: GroundStation) -> Callable[[], None]:
    """Let lines on standard input set the directive; return what ends that.

    Where nothing can be waited for, as with no input at all or in the background of a terminal, nothing is read.
    """
    loop = asyncio.get_running_loop()
    descriptor = _standard_input()
    rest = b""

    def end() -> None:
        loop.remove_reader(descriptor)

    def read() -> None:
        nonlocal rest
        try:
            chunk = os.read(descriptor, _LINE_BYTES)
        except OSError:
            chunk = b""
        if not chunk:
            end()
            return
        *lines, rest = (rest + chunk).split(b"\n")
        rest = rest[-_LINE_BYTES:]
        for line in lines:
            _obey(station, line.decode(errors="replace"))

    try:
        loop.add_reader(descriptor, read)
    except (OSError, ValueError):
        return lambda: None
    # In the background a terminal would stop a program that reads from it; so reading fails instead.
    signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    return end


def _standard_input() -> int:
    try:
        return sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):
        return -1


def _obey(station: GroundStation, line: str) -> None:
    if not line.strip():
        return
    try:
        station.directive = directive_from(line)
    except InputError as error:
        click.echo(f"groundstation: {error}", err=True)
