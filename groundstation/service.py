"""Shell of `groundstation run`: the links, the clock, the keys and the files around the core.

What a restart must not forget is kept in a file: the last epoch and signing time, so that vehicles that demand ever
newer frames hear the next run; when the threats were where the mission says, so that they are not told as if they had
not moved since; and the directive.
"""

from __future__ import annotations

import asyncio
import hashlib
import json
import math
import os
import signal
import stat
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import click

from companion.errors import InputError, nearest_hint
from companion.files.state import read_state_file, write_state_file
from companion.files.tlog import TlogWriter
from companion.guidance.settings import DEFAULT_LAW
from companion.mission.model import Mission
from companion.onboard.flight_log import FlightLog, unused
from companion.protocol.deframer import StreamFramer
from companion.protocol.ed25519 import FrameSigner
from companion.protocol.keys import MAVLINK_NAME, PRIVATE_NAME, load_mavlink_key, load_private
from companion.protocol.mavlink_signing import UNITS_PER_S, MavlinkSigner, timestamp_of
from companion.protocol.messages import Directive
from companion.protocol.v2_extension import unwrap
from companion.runtime.clock import SteadyClock, wait
from companion.transport.endpoints import Link, open_receiver, open_sender
from groundstation.adsb_mirror import AdsbMirror
from groundstation.agents import VehicleModel
from groundstation.broadcast import Unsendable
from groundstation.ground_station import GroundStation
from groundstation.plan import Authentication
from groundstation.radio import Radio
from groundstation.schedule import TICK_S as RADIO_TICK_S
from groundstation.schedule import Broadcaster

TICK_S = 0.05
"""How often the core is asked what is due without a radio: fine against any broadcast period in use."""
STATE_PERIOD_S = 1.0
"""How often the signing time used last is written to disk: a crash loses less of it than receivers allow clocks to
differ by."""
STATUS_PERIOD_S = 60.0
"""How often what was sent is told."""
MOST_AHEAD_S = 1.5
"""So far ahead of the clock an epoch or a signing time may be: receivers refuse what is more than 2 s ahead of theirs
(companion/protocol/authenticator.py), and theirs may be behind. A restart within the second needs 1 s."""
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
class SavedState:
    """What of a run must be known to the next one."""

    epoch_s: int
    signing_timestamp: int
    """MAVLink's, of a frame sent STATE_PERIOD_S before the last one or later; 0 without MAVLink signing."""
    threats: str
    """The digest of the threats as the mission places them."""
    began_s: float
    """When the first run with these threats began: they were there then."""
    directive: Directive


def saved_state_from(text: str, source: Path) -> SavedState:
    """Return what a state file keeps.

    Raises:
        InputError: the text is nothing of ours; `source` names it.

    """
    try:
        values = json.loads(text)
        kept = SavedState(
            int(values["epoch_s"]),
            int(values["signing_timestamp"]),
            str(values["threats"]),
            float(values["began_s"]),
            directive_from(str(values["directive"])),
        )
        if not math.isfinite(kept.began_s):
            raise ValueError("no time")
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError, InputError) as error:
        raise InputError(
            f"{source}: no state of a ground station; allowed: the file that the last run wrote, or one that is not "
            "there yet"
        ) from error
    return kept


def text_of(kept: SavedState) -> str:
    """Return what a state file holds."""
    return json.dumps(
        {
            "epoch_s": kept.epoch_s,
            "signing_timestamp": kept.signing_timestamp,
            "threats": kept.threats,
            "began_s": kept.began_s,
            "directive": kept.directive.name.lower(),
        }
    )


def epoch_after(kept: SavedState | None, now_s: float, source: Path | None) -> int:
    """Return the epoch of a run that begins now: this second, but later than the last run's.

    Raises:
        InputError: that is farther ahead of the clock than receivers accept; `source` names the file.

    """
    epoch_s = int(now_s) if kept is None else max(int(now_s), kept.epoch_s + 1)
    if epoch_s - now_s > MOST_AHEAD_S:
        raise _behind(source, epoch_s - now_s)
    return epoch_s


def signing_after(kept: SavedState | None, now_s: float, only_mavlink: bool, source: Path | None) -> int:
    """Return the MAVLink signing time above which a run that begins now signs.

    Raises:
        InputError: `only_mavlink`, that is without Ed25519, and the time is farther ahead of the clock than receivers
            accept. Under both they do not look at it.

    """
    if kept is None:
        return 0
    ahead_s = (kept.signing_timestamp - timestamp_of(now_s)) / UNITS_PER_S
    if only_mavlink and ahead_s > MOST_AHEAD_S:
        raise _behind(source, ahead_s)
    return kept.signing_timestamp


def _behind(source: Path | None, by_s: float) -> InputError:
    return InputError(
        f"{source}: the clock is {by_s:.1f} s behind the last run, so that vehicles would refuse every frame; allowed: "
        f"at most {MOST_AHEAD_S:g} s: wait, set the clock or, if the last run's clock was wrong, remove this file and "
        "the vehicles' state files and make new keys"
    )


def began_at_s(kept: SavedState | None, threats: str, now_s: float) -> float:
    """Return when the threats of a run that begins now were where the mission says; `threats` is their digest."""
    return now_s if kept is None or kept.threats != threats else min(kept.began_s, now_s)


def threats_digest(mission: Mission) -> str:
    """Return what tells whether two resolved missions place the same threats.

    Of nothing else in them: a restart with another target or period must not tell the threats as if they were new.
    """
    text = mission.model_dump_json(include={"origin", "threats"})
    return hashlib.sha256(text.encode()).hexdigest()


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


def load_frame_signer(authentication: Authentication, folder: Path | None) -> FrameSigner:
    """Return what signs the frames, with the keys in a folder.

    Raises:
        InputError: the folder or a key in it is missing, open to others, or no key.

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
        signer = MavlinkSigner(load_mavlink_key(folder / MAVLINK_NAME), LINK_ID)
    return FrameSigner(private_key, signer)


async def run_groundstation(mission: Mission, options: Options, stop: asyncio.Event) -> None:
    """Broadcast a resolved mission until `stop` is set.

    Without a sensor the ground station knows no more than the mission file: threats that may move grow with age, and in
    Case I nobody can be known to be lost or to have arrived.

    Raises:
        InputError: a link cannot be opened, a file not used, or the mission asks for something that cannot be done.

    """
    frame_signer = load_frame_signer(options.authentication, options.keys)
    clock = SteadyClock()
    start_s = clock.now_s()
    keeper = _Keeper(options, mission, frame_signer, start_s)
    station = GroundStation(
        mission,
        start_s,
        sensed=options.sensor is not None,
        model=VehicleModel(DEFAULT_LAW, options.can_stop),
        epoch_s=keeper.epoch_s,
        began_s=keeper.began_s,
    )
    station.directive = keeper.directive
    broadcaster = Broadcaster(station, options.radio, frame_signer)
    broadcaster.begin(start_s)
    mirror = AdsbMirror(mission)
    added_bytes = 0 if options.radio is None else options.radio.added_bytes
    with ExitStack() as stack:
        log = FlightLog(None if options.log is None else TlogWriter(unused(options.log)), "groundstation")
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
        keeper.keep(station, start_s)
        stack.callback(lambda: keeper.keep_if_possible(station, clock.now_s()))
        stack.callback(_take_orders(station))
        status = _Status(station, broadcaster, options)
        for line in [status.opening(), *keeper.news(start_s)]:
            click.echo(f"groundstation: {line}")
        for warning in keeper.warnings():
            click.echo(f"groundstation: warning: {warning}", err=True)
        while not stop.is_set():
            now_s = clock.now_s()
            # A new directive is on disk before it is on the air: no restart may take back what vehicles have heard.
            keeper.keep_if_due(station, now_s)
            for data in broadcaster.tick(now_s, sender.txbuf_percent):
                sender.send(data)
                status.sent_bytes += len(data) + added_bytes
                log.record(now_s, unwrap(data) or data)
            if display is not None:
                for data in mirror.tick(station.tracks, now_s):
                    display.send(data)
            for line in status.news(now_s, sender.counts.sent):
                click.echo(f"groundstation: {line}")
            for warning in status.warnings():
                click.echo(f"groundstation: warning: {warning}", err=True)
            await wait(stop, TICK_S if options.radio is None else RADIO_TICK_S)


class _Keeper:
    """What the last run left, and the file in which this one leaves it."""

    def __init__(self, options: Options, mission: Mission, frame_signer: FrameSigner, now_s: float) -> None:
        """Read the file, if there is one to be read; raises InputError if this run cannot follow on it."""
        self._path = self._read_from = options.state
        self._signer = frame_signer.signer
        text = None if self._path is None else read_state_file(self._path)
        kept = None if self._path is None or text is None else saved_state_from(text, self._path)
        self._threats = threats_digest(mission)
        self._can_move = any(threat.speed_bound_m_s > 0.0 for threat in mission.threats)
        self.epoch_s = epoch_after(kept, now_s, self._path)
        self.began_s = began_at_s(kept, self._threats, now_s)
        self.directive = Directive.NORMAL if kept is None else kept.directive
        self._kept = kept
        self._kept_at_s = -math.inf
        self._signing = 0 if kept is None else kept.signing_timestamp
        if self._signer is not None:
            self._signer.last_timestamp = signing_after(kept, now_s, options.authentication == "mavlink", self._path)

    def news(self, now_s: float) -> list[str]:
        """Return what this run has taken over."""
        lines = []
        if self.directive is not Directive.NORMAL:
            lines.append(f"directive: {self.directive.name.lower()}, kept from the last run")
        if self._can_move and self.began_s < now_s:
            lines.append(
                f"threats: where the mission says {now_s - self.began_s:.0f} s ago, when its first run began; before a "
                f"new flight remove {self._read_from}"
            )
        return lines

    def warnings(self) -> list[str]:
        """Return what a restart will not know."""
        if self._path is not None or not self._can_move:
            return []
        return ["without --state a restart would tell the threats smaller than they may be by then, and no directive"]

    def keep(self, station: GroundStation, now_s: float) -> None:
        """Write what the next run must know; raises InputError if that fails."""
        if self._path is None:
            return
        if self._signer is not None:
            self._signing = self._signer.last_timestamp
        kept = SavedState(station.epoch_s, self._signing, self._threats, self.began_s, station.directive)
        write_state_file(self._path, text_of(kept))
        self._kept, self._kept_at_s = kept, now_s

    def keep_if_due(self, station: GroundStation, now_s: float) -> None:
        """Write it if the directive or the epoch is another, or a signing time was kept long enough ago."""
        kept = self._kept
        changed = kept is None or (kept.directive, kept.epoch_s) != (station.directive, station.epoch_s)
        if changed or (self._signer is not None and now_s - self._kept_at_s >= STATE_PERIOD_S):
            self.keep_if_possible(station, now_s)

    def keep_if_possible(self, station: GroundStation, now_s: float) -> None:
        """Write it; a disk that fails is warned of once, and given up: the broadcast goes on."""
        try:
            self.keep(station, now_s)
        except InputError as error:
            self._path = None
            click.echo(f"groundstation: warning: {error}; no longer keeping it", err=True)


class _Status:
    """What is said of a run."""

    def __init__(self, station: GroundStation, broadcaster: Broadcaster, options: Options) -> None:
        self._station = station
        self._broadcaster = broadcaster
        self._warned = False
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

    def news(self, now_s: float, frames: int) -> list[str]:
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
            pace = self._broadcaster.pace
            slowed = f", slowed to {pace:.0%} by the radio's buffer" if pace < 1.0 else ""
            too_far, unsendable = self._station.tracks.too_far, sum(one.count for one in self._unsendable())
            refused = f", {too_far} detections refused as too far" if too_far else ""
            unsent = f", {unsendable} frames not sent" if unsendable else ""
            lines.append(
                f"{frames} frames sent, {rate_bytes_per_s:.0f} B/s{slowed}{refused}{unsent} "
                f"({_WORDS[self._options.authentication]})"
            )
            self._told_at_s, self._told_bytes = now_s, self.sent_bytes
        return lines

    def warnings(self) -> list[str]:
        """Return what is wrong, once."""
        wrong = [one.first for one in self._unsendable() if one.count]
        if self._warned or not wrong:
            return []
        self._warned = True
        return [f"a frame could not be sent: {wrong[0]}; going on with the others"]

    def _unsendable(self) -> tuple[Unsendable, Unsendable]:
        return self._station.unsendable, self._broadcaster.unsendable

    def _mission_line(self) -> str:
        station = self._station
        picture = station.tracks
        pairs = ", ".join(f"{agent} to {target}" for agent, target in sorted(station.assignment.items()))
        if len(station.assignment) > _MOST_PAIRS:
            pairs = f"{len(station.assignment)} of {len(picture.present_agents)} sent"
        directive = "" if station.directive is Directive.NORMAL else f"directive {station.directive.name.lower()}; "
        progress = picture.progress
        return (
            f"{directive}agents to targets: {pairs or 'none'}; reached {sorted(progress.completed)}, "
            f"arrived {sorted(progress.arrived)}, lost {sorted(progress.lost)}, uncovered {list(station.uncovered)}"
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
