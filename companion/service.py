"""Shell of `companion run`: sockets, the clock and the log files around the core.

One autopilot link, which goes both ways, and the broadcast link, which is only ever heard; an uplink for reports where
there is one. Setpoints leave on a fixed
grid of the monotonic clock; the time given to the core is Unix time as it was at the start, carried on by the monotonic
clock, so that a step of the system clock in flight changes no age.
"""

from __future__ import annotations

import asyncio
import time
from contextlib import ExitStack
from pathlib import Path

import click

from companion.config import Config
from companion.core import REPEAT_PERIOD_S, Companion, Decision
from companion.errors import InputError
from companion.picture import Picture
from companion.process import SteadyClock, wait
from companion.tlog import TlogWriter, whole_frames
from companion.transport import open_duplex, open_receiver, open_sender, parse_link


async def run_companion(config: Config, stop: asyncio.Event) -> None:
    """Steer until `stop` is set. Prints one line whenever what it does changes.

    Raises:
        InputError: a link cannot be opened or a log not written.

    """
    if config.autopilot is None or config.broadcast is None:
        raise InputError("companion: autopilot and broadcast links are needed")
    companion = Companion(config)
    clock = SteadyClock()
    with ExitStack() as stack:
        vehicle_log, broadcast_log = _logs(config, stack)

        def from_broadcast(datagram: bytes) -> None:
            companion.hear(datagram, clock.now_s())
            broadcast_log.record(clock.now_s(), datagram)

        def from_autopilot(datagram: bytes) -> None:
            companion.receive(datagram, clock.now_s())
            vehicle_log.record(clock.now_s(), datagram)

        def send(frames: list[bytes]) -> None:
            for frame in frames:
                autopilot.send(frame)
                vehicle_log.record(clock.now_s(), frame)

        receiver = await open_receiver(parse_link(config.broadcast.link), from_broadcast)
        stack.callback(receiver.close)
        autopilot = await open_duplex(parse_link(config.autopilot.link), from_autopilot)
        stack.callback(autopilot.close)
        click.echo(
            f"companion: agent {config.agent_id}, {config.autopilot.kind} on {config.autopilot.link}, "
            f"broadcast on {config.broadcast.link} (unsigned)"
        )
        uplink = None
        if config.uplink is not None:
            uplink = await open_sender(parse_link(config.uplink.link))
            stack.callback(uplink.close)
        said: set[str] = set()
        listening = _Listening()
        due_s = time.monotonic()
        while not stop.is_set():
            decision, frames = companion.tick(clock.now_s())
            send(frames)
            if uplink is not None:
                for report in companion.report(clock.now_s()):
                    uplink.send(report)
            for line in [*listening.news(companion.picture), _line(decision)]:
                if line not in said:
                    click.echo(f"companion: {line}")
            said = {_line(decision)}
            due_s = max(due_s + config.guidance_step_s, time.monotonic())
            while due_s - time.monotonic() > REPEAT_PERIOD_S and not stop.is_set():
                await wait(stop, REPEAT_PERIOD_S)
                send(companion.repeat(clock.now_s()))
            await wait(stop, due_s - time.monotonic())


def _logs(config: Config, stack: ExitStack) -> tuple[FlightLog, FlightLog]:
    if config.log_dir is None:
        return FlightLog(None), FlightLog(None)
    folder = Path(config.log_dir)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"log_dir: '{folder}' cannot be made: {error.strerror}; allowed: a writable folder") from error
    logs = []
    for name in (f"vehicle-{config.agent_id}.tlog", f"broadcast-{config.agent_id}.tlog"):
        logs.append(FlightLog(TlogWriter(folder / name)))
        stack.callback(logs[-1].close)
    return logs[0], logs[1]


class FlightLog:
    """A tlog that gives up, with a word, rather than disturb a flight: a full disk is no reason to stop steering."""

    def __init__(self, writer: TlogWriter | None) -> None:
        self._writer = writer

    def record(self, t_unix_s: float, datagram: bytes) -> None:
        """Log the frames of a datagram; what is not a frame has no place in a tlog."""
        if self._writer is not None:
            try:
                for frame in whole_frames(datagram):
                    self._writer.write(t_unix_s, frame)
            except OSError as error:
                self._give_up(error)

    def close(self) -> None:
        """Write out what is buffered."""
        if self._writer is not None:
            try:
                self._writer.close()
            except OSError as error:
                self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        self._writer = None
        click.echo(f"companion: warning: no longer logging: {error.strerror}", err=True)


class _Listening:
    """Notices when the broadcast changes hands: a restarted ground station, or two at once."""

    def __init__(self) -> None:
        self._epoch_s: int | None = None
        self._older = 0

    def news(self, picture: Picture) -> list[str]:
        """Return what is to be said since the last call."""
        lines = []
        if picture.epoch_s != self._epoch_s:
            if self._epoch_s is not None:
                lines.append(f"another run of a ground station took over (epoch {picture.epoch_s})")
            self._epoch_s = picture.epoch_s
        older = picture.rejected["old epoch"]
        if older > 0 and self._older == 0:
            lines.append("warning: frames of an older run are heard too: are two ground stations broadcasting?")
        self._older = older
        return lines


def _line(decision: Decision) -> str:
    target = f" {decision.target_id}" if decision.target_id is not None else ""
    changes = f", guard: {', '.join(decision.guard_changes)}" if decision.guard_changes else ""
    changes += "".join(f", {said}" for said in (decision.note, decision.gave_way) if said is not None)
    changes += f", broken: {', '.join(decision.broken)}" if decision.broken else ""
    picture = "none" if decision.picture_age_s is None else decision.stage.value
    return f"{decision.purpose.value}{target} ({decision.reason}), picture {picture}{changes}"
