"""Shell of `companion run`: sockets, the clock and the log files around the core.

One autopilot link, which goes both ways, and the broadcast link, which is only ever heard; an uplink for reports where
there is one. Setpoints leave on a fixed
grid of the monotonic clock; the time given to the core is Unix time as it was at the start, carried on by the monotonic
clock, so that a step of the system clock in flight changes no age.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import click

from companion.admission import EXPECTED, OLD_EPOCH, Admission, AdmissionState, Trust
from companion.config import BroadcastSection, Config, dump_config
from companion.core import REPEAT_PERIOD_S, Companion
from companion.errors import InputError
from companion.flightlog import FlightLog, decision_frame, line_of, unused
from companion.framing import StreamFramer
from companion.keys import load_mavlink_key, load_public
from companion.process import SteadyClock, wait
from companion.reception import Warnings
from companion.statefile import read_state_file, write_state_file
from companion.tlog import TlogWriter
from companion.transport import open_duplex, open_receiver, open_sender, parse_link
from companion.wire import FrameWriter

STATE_PERIOD_S = 1.0
"""How often at most what was accepted last is written to disk."""
BROADCAST_LOG_BYTES_PER_S = 20_000.0
"""Several times what any radio in mind carries; a flood is logged no faster."""
STATUS_PERIOD_S = 60.0
"""How often the state of the broadcast link is told while nothing else is."""


async def run_companion(config: Config, stop: asyncio.Event) -> None:
    """Steer until `stop` is set. Prints one line whenever what it does changes, and now and then how well it hears.

    Raises:
        InputError: a link cannot be opened, a key or state file not used, or a log not written.

    """
    if config.autopilot is None or config.broadcast is None:
        raise InputError("companion: autopilot and broadcast links are needed")
    section = config.broadcast
    link = parse_link(section.link)
    state = _state_of(section)
    is_stream = link.scheme == "serial"
    admission = Admission(trust_of(section), state, is_stream=is_stream)
    framer = StreamFramer() if is_stream else None
    companion = Companion(config, admission=admission)
    marks = FrameWriter()
    clock = SteadyClock()
    with ExitStack() as stack:
        vehicle_log, broadcast_log = _logs(config, stack)

        def believed(take: Callable[[float], list[bytes]]) -> None:
            now_s = clock.now_s()
            for raw in take(now_s):
                vehicle_log.record(now_s, raw)

        def from_broadcast(datagram: bytes) -> None:
            for frames in [datagram] if framer is None else framer.feed(datagram):
                broadcast_log.record(clock.now_s(), frames)
            believed(lambda now_s: companion.hear(datagram, now_s))

        def from_autopilot(datagram: bytes) -> None:
            now_s = clock.now_s()
            companion.receive(datagram, now_s)
            vehicle_log.record(now_s, datagram)

        def send(frames: list[bytes], now_s: float) -> None:
            for frame in frames:
                autopilot.send(frame)
                vehicle_log.record(now_s, frame)

        receiver = await open_receiver(link, from_broadcast)
        stack.callback(receiver.close)
        autopilot = await open_duplex(parse_link(config.autopilot.link), from_autopilot)
        stack.callback(autopilot.close)
        click.echo(
            f"companion: agent {config.agent_id}, {config.autopilot.kind} on {config.autopilot.link}, "
            f"broadcast on {section.link} ({admission.trust.words})"
        )
        uplink = None
        if config.uplink is not None:
            uplink = await open_sender(parse_link(config.uplink.link))
            stack.callback(uplink.close)
        said: set[str] = set()
        doubted = ", unsigned" if section.trust == "unsigned" else ""
        listening = _Listening(companion)
        keeper = _StateKeeper(section.state_file, admission)
        stack.callback(keeper.keep)
        due_s = time.monotonic()
        while not stop.is_set():
            # What waited for its check in a flood is heard of here where nothing else arrives.
            believed(companion.hear_waiting)
            now_s = clock.now_s()
            decision, frames = companion.tick(now_s)
            vehicle_log.record(now_s, marks.encode(decision_frame(decision)))
            send(frames, now_s)
            if uplink is not None:
                for report in companion.report(now_s):
                    uplink.send(report)
            line = line_of(decision) + doubted
            for news in [*listening.news(now_s), line]:
                if news not in said:
                    click.echo(f"companion: {news}")
                    vehicle_log.tell(now_s, news)
            said = {line}
            keeper.keep_now_and_then(now_s)
            due_s = max(due_s + config.guidance_step_s, time.monotonic())
            while due_s - time.monotonic() > REPEAT_PERIOD_S and not stop.is_set():
                await wait(stop, REPEAT_PERIOD_S)
                now_s = clock.now_s()
                send(companion.repeat(now_s), now_s)
            await wait(stop, due_s - time.monotonic())


def trust_of(section: BroadcastSection) -> Trust:
    """Return whom a configuration believes.

    Raises:
        InputError: a key file is missing, no key, or readable by others.

    """
    return Trust(
        mavlink_key=None if section.mavlink_key is None else load_mavlink_key(Path(section.mavlink_key)),
        public_key=None if section.public_key is None else load_public(Path(section.public_key)),
        max_age_s=section.max_age_s,
        ahead_s=section.ahead_s,
        checks_per_s=section.checks_per_s,
        clock_checked=section.clock == "checked",
    )


def _state_of(section: BroadcastSection) -> AdmissionState | None:
    if section.state_file is None:
        return None
    text = read_state_file(Path(section.state_file))
    try:
        return None if text is None else AdmissionState.from_json(text)
    except InputError as error:
        raise InputError(
            f"{section.state_file}: {error}; remove it only if no old broadcast can be replayed"
        ) from error


class _StateKeeper:
    """Keeps what was accepted last on disk; a full disk is no reason to stop steering."""

    def __init__(self, path: str | None, admission: Admission) -> None:
        self._path = None if path is None else Path(path)
        self._admission = admission
        self._kept = admission.state
        self._next_s = 0.0

    def keep_now_and_then(self, now_s: float) -> None:
        """Write what is new, unless it was written a moment ago."""
        if now_s >= self._next_s:
            self._next_s = now_s + STATE_PERIOD_S
            self.keep()

    def keep(self) -> None:
        """Write what is new."""
        state = self._admission.state
        if self._path is not None and state != self._kept:
            try:
                write_state_file(self._path, state.to_json())
            except InputError as error:
                click.echo(f"companion: warning: {error}", err=True)
            self._kept = state


def _logs(config: Config, stack: ExitStack) -> tuple[FlightLog, FlightLog]:
    """Open the logs of this run in a folder of its own: a restart in flight shall not cost what was recorded before."""
    if config.log_dir is None:
        return FlightLog(None), FlightLog(None)
    folder = unused(Path(config.log_dir) / time.strftime("%Y%m%dT%H%M%SZ", time.gmtime()))
    try:
        folder.mkdir(parents=True)
        (folder / f"companion-{config.agent_id}.yaml").write_text(dump_config(config), encoding="utf-8")
    except OSError as error:
        raise InputError(
            f"log_dir: '{config.log_dir}' cannot be used: {error.strerror}; allowed: a writable folder"
        ) from error
    vehicle_log = FlightLog(TlogWriter(folder / f"vehicle-{config.agent_id}.tlog"))
    broadcast_log = FlightLog(
        TlogWriter(folder / f"broadcast-{config.agent_id}.tlog"), most_bytes_per_s=BROADCAST_LOG_BYTES_PER_S
    )
    for log in (vehicle_log, broadcast_log):
        stack.callback(log.close)
    return vehicle_log, broadcast_log


class _Listening:
    """Notices how the broadcast is heard, and when it changes hands: a restarted ground station, or two at once."""

    def __init__(self, companion: Companion) -> None:
        self._companion = companion
        self._warnings = Warnings()
        self._epoch_s: int | None = None
        self._older = self._any_refused = False
        self._status_at_s = -math.inf

    def news(self, now_s: float) -> list[str]:
        """Return what is to be said since the last call."""
        companion = self._companion
        lines = []
        epoch_s = companion.picture.epoch_s
        if epoch_s != self._epoch_s:
            if self._epoch_s is not None:
                lines.append(f"another run of a ground station took over (epoch {epoch_s})")
            self._epoch_s = epoch_s
        refused = companion.admission.rejected
        if refused[OLD_EPOCH] > 0 and not self._older:
            lines.append("warning: frames of an older run are heard too: are two ground stations broadcasting?")
        self._older = refused[OLD_EPOCH] > 0
        quality = companion.reception.quality(now_s)
        warning = self._warnings.update(quality)
        if warning is not None:
            lines.append(warning)
        any_refused = any(refused[reason] for reason in refused.keys() - set(EXPECTED))
        first = any_refused and not self._any_refused
        if first or now_s - self._status_at_s >= STATUS_PERIOD_S:
            self._status_at_s = now_s
            unexpected = [(count, reason) for reason, count in refused.most_common() if reason not in EXPECTED]
            reasons = ", ".join(f"{count} {reason}" for count, reason in unexpected)
            ages = ", ".join(f"{kind} {age_s:.1f} s" for kind, age_s in quality.ages_s.items())
            lines.append(
                f"broadcast ({companion.admission.trust.words}): {quality.share:.0%} of its frames heard, "
                f"age of {ages or 'nothing'}; refused: {reasons or 'none'}"
            )
        self._any_refused = any_refused
        return lines
