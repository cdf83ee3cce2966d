"""Shell of `companion run`: sockets, the clock and the log files around the core.

One autopilot link, which goes both ways, and the broadcast link, which is only ever heard (or the same link, where one
radio carries both); an uplink for reports where there is one. Setpoints leave on a fixed grid of the monotonic clock;
the time given to the core is Unix time as it was at the start, carried on by the monotonic clock, so that a step of the
system clock in flight changes no age. Disks and the terminal are waited for on threads of their own.
"""

from __future__ import annotations

import asyncio
import gc
import json
import math
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import click

from companion.autopilot.adapter import SetpointFrame, Velocity
from companion.autopilot.offboard import MAVSDK_SILENT, Offboard, is_setpoint
from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.errors import InputError
from companion.files.state import check_state_file, read_state_file, write_state_file
from companion.files.tlog import TlogWriter
from companion.onboard.authority import State
from companion.onboard.companion import Companion, Decision, Purpose
from companion.onboard.config import ONE_RADIO, AutopilotSection, BroadcastSection, Config, dump_config
from companion.onboard.decision_table import DecisionTable
from companion.onboard.flight_log import FlightLog, Mark, clock_frame, decision_frame, mark_frame, summary_line, unused
from companion.onboard.statustext import StatusReporter
from companion.protocol.authenticator import EXPECTED, Authenticator, AuthenticatorState, Trust
from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM, FrameWriter
from companion.protocol.dialect import oneway
from companion.protocol.frame import RawFrame, raw_frames
from companion.protocol.freshness import OLD_EPOCH
from companion.protocol.keys import load_mavlink_key, load_public
from companion.protocol.link_quality import Warnings
from companion.protocol.v2_extension import unwrap
from companion.runtime.clock import SteadyClock, hear_what_piled_up, wait
from companion.runtime.io_thread import IoThread, IoThreadFile
from companion.runtime.rate import LoopRate, SetpointGaps, next_due_s
from companion.runtime.systemd import Notifier
from companion.transport.endpoints import Duplex, Sender, open_duplex, open_receiver, open_sender, parse_link

STATE_PERIOD_S = 1.0
"""How often at most what was accepted last is written to disk."""
BROADCAST_LOG_BYTES_PER_S = 20_000.0
"""Several times what any radio in mind carries; a flood is logged no faster."""
ONEWAY_IDS = frozenset(oneway.mavlink_map) - {oneway.MAVLINK_MSG_ID_HEARTBEAT}
"""Messages of our own dialect."""
BEGINNINGS = {State.ENGAGED: Mark.RESUMED, State.LOCKED: Mark.LOCKED}
"""What a log begins with after a companion that left the vehicle so."""
STATUS_PERIOD_S = 60.0
"""How often the state of the broadcast link is told while nothing else is."""


async def run_companion(config: Config, stop: asyncio.Event) -> None:
    """Steer until `stop` is set. Prints one line whenever what it does changes, and now and then how well it hears.

    Raises:
        InputError: a link cannot be opened, a key or state file not used, or a log not written.

    """
    if config.autopilot is None or config.broadcast is None:
        raise InputError("companion: autopilot and broadcast links are needed")
    with ExitStack() as stack:
        shell = _Shell(config, config.autopilot, config.broadcast, stack)
        try:
            await shell.open()
        except InputError:
            # Whoever starts it again and again until a port is there shall not find a folder for each time.
            shell.leave_no_logs()
            raise
        await shell.run(stop)


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


def _state_of(section: BroadcastSection) -> AuthenticatorState | None:
    if section.state_file is None:
        return None
    text = read_state_file(Path(section.state_file))
    check_state_file(Path(section.state_file))
    try:
        return None if text is None else AuthenticatorState.from_json(text)
    except InputError as error:
        raise InputError(
            f"{section.state_file}: {error}; remove it only if no old broadcast can be replayed"
        ) from error


def saved_authority(section: AutopilotSection) -> tuple[State, str | None]:
    """Return who had the vehicle when the companion before this one ended, by its state file, and a warning, if any.

    A file that does not tell is no reason not to start in flight: it counts as locked, which lets a person decide.

    Raises:
        InputError: the state file could not be written.

    """
    if section.state_file is None:
        return State.WAITING, None
    path = Path(section.state_file)
    check_state_file(path)
    try:
        text = read_state_file(path)
        return (State.WAITING if text is None else State(json.loads(text)["engagement"])), None
    except (InputError, ValueError, TypeError, KeyError, RecursionError):
        return State.LOCKED, f"{path}: not a state of the engagement: a PX4 counts as locked, ArduPilot's mode decides"


class _Shell:
    """One flight's sockets, files and clock around the core."""

    def __init__(
        self, config: Config, autopilot: AutopilotSection, broadcast: BroadcastSection, stack: ExitStack
    ) -> None:
        """Read keys and states and open the logs, which `stack` closes; raises InputError."""
        self._config, self._autopilot, self._broadcast, self._stack = config, autopilot, broadcast, stack
        # Closed last, after all that still has something for them.
        self._words = _background("words", stack)
        self._files = _background("files", stack)
        link = None if broadcast.link == ONE_RADIO else parse_link(broadcast.link)
        self._broadcast_link = link
        is_stream = link is not None and link.scheme == "serial"
        authenticator = Authenticator(trust_of(broadcast), _state_of(broadcast), is_stream=is_stream)
        self._is_stream = is_stream
        was, warning = saved_authority(autopilot)
        if warning is not None:
            self._say(f"warning: {warning}")
        self._companion = Companion(config, authenticator=authenticator, was=was)
        self._clock = SteadyClock()
        self._logs = _logs(config, self._files, stack)
        if was in BEGINNINGS:
            self._logs.vehicle.record(self._clock.now_s(), mark_frame(BEGINNINGS[was], self._system_id))
        self._marks = FrameWriter()
        self._listening = _Listening(self._companion)
        self._broadcast_state = _StateKeeper(broadcast.state_file, authenticator, self._files)
        self._engagement = _EngagementKeeper(autopilot.state_file, was, self._files)
        stack.callback(self._broadcast_state.keep)
        quiet = config.case == "II" if config.status.quiet is None else config.status.quiet
        self._teller = StatusReporter(config.status.period_s, quiet)
        self._gaps = SetpointGaps()
        self._decision_gaps = SetpointGaps()
        self._said: set[str] = set()
        self._doubted = ", unsigned" if broadcast.trust == "unsigned" else ""
        self._notifier = Notifier()
        stack.callback(self._notifier.close)
        self._link: Duplex
        self._uplink: Sender | None = None
        self._offboard: Offboard | None = None
        self._wanted: Velocity | None = None
        self._awaited = False
        """Whether an armed vehicle may be handed over at any moment: then there is a decision in every slot."""

    async def open(self) -> None:
        """Open the links; raises InputError for one that cannot be used."""
        config, stack = self._config, self._stack
        if self._broadcast_link is not None:
            receiver = await open_receiver(self._broadcast_link, self._from_broadcast)
            stack.callback(receiver.close)
        if self._autopilot.kind == "px4-copter" and self._autopilot.offboard == "mavsdk":
            self._offboard = Offboard(self._transmit, self._after_gap)
            stack.callback(self._offboard.close)
        self._link = await open_duplex(parse_link(self._autopilot.link), self._from_autopilot)
        stack.callback(self._link.close)
        if config.uplink is not None:
            self._uplink = await open_sender(parse_link(config.uplink.link))
            stack.callback(self._uplink.close)
        self._say(
            f"agent {config.agent_id}, {self._autopilot.kind} on {self._autopilot.link}, "
            f"broadcast on {self._broadcast.link} ({self._companion.authenticator.trust.words})"
        )

    def leave_no_logs(self) -> None:
        """Remove the folder of a run that never began."""
        if self._logs.folder is not None:
            shutil.rmtree(self._logs.folder, ignore_errors=True)

    async def run(self, stop: asyncio.Event) -> None:
        """Decide and send on the grid until `stop` is set."""
        asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, self._clear)
        period_s = min(1.0 / self._config.setpoint_rate_hz, self._config.guidance_step_s)
        beat = LoopRate(period_s, time.monotonic())
        decide_s = beat.due_s
        self._notifier.ready()
        with _tidy_memory() as tidy:
            while not stop.is_set():
                if time.monotonic() - beat.due_s > period_s:
                    # A person may have taken over meanwhile.
                    await hear_what_piled_up()
                # A decision falls into the slot nearest to when it is due.
                decides = self._awaited or beat.due_s >= decide_s - 0.5 * period_s
                if decides:
                    decide_s = next_due_s(decide_s, beat.due_s, self._config.guidance_step_s)
                self._slot(decides)
                if decides:
                    tidy()
                await wait(stop, beat.next_after(time.monotonic()) - time.monotonic())
        self._say(self._gaps.words)

    def _slot(self, decides: bool) -> None:
        """Do what one slot of the grid is for: decide, or repeat what was decided, and send it."""
        # What waited for its check in a flood is heard of here where nothing else arrives.
        self._believe(self._companion.hear_waiting)
        now_s = self._clock.now_s()
        self._note_clock(now_s)
        if self._offboard is not None and self._offboard.silent:
            self._after_gap()
        if decides:
            decision, frames = self._companion.tick(now_s)
            self._logs.vehicle.record(now_s, self._marks.encode(decision_frame(decision)))
            self._send(frames, now_s)
            self._tell(decision, now_s)
        else:
            stood = self._companion.steers
            frames = self._companion.repeat(now_s)
            if stood and not self._companion.steers:
                self._logs.vehicle.record(now_s, mark_frame(Mark.WITHDRAWN, self._system_id))
            self._send(frames, now_s)
        self._engagement.note(self._companion.authority.kept)
        for frame in self._teller.text(now_s, self._companion.adapter.telemetry.system_id):
            self._link.send(frame)
        self._notifier.alive()

    def _send(self, frames: list[bytes], now_s: float) -> None:
        """Log what the core wants sent and send it: setpoints through MAVSDK where it is in charge of them."""
        self._wanted = None
        steers = False
        for frame in frames:
            self._logs.vehicle.record(now_s, frame)
            steers = steers or is_setpoint(frame)
            if self._offboard is not None and isinstance(frame, SetpointFrame):
                self._wanted = frame.velocity
            else:
                self._transmit(frame)
        if self._offboard is not None:
            self._offboard.tick(self._companion.adapter.telemetry.system_id, self._wanted)
        if not steers:
            self._gaps.end()
            self._decision_gaps.end()

    def _transmit(self, frame: bytes) -> None:
        self._link.send(frame)
        if is_setpoint(frame):
            now_s = time.monotonic()
            self._gaps.note(now_s)
            self._decision_gaps.note(now_s)

    def _tell(self, decision: Decision, now_s: float) -> None:
        """Report, log and say what was decided."""
        companion = self._companion
        if self._uplink is not None:
            for report in companion.report(now_s):
                self._uplink.send(report)
        line = summary_line(decision) + self._doubted
        if self._offboard is not None and self._wanted is not None and not self._offboard.ready:
            line += ", MAVSDK is not ready yet"
        for news in [*self._listening.news(now_s), line]:
            if news not in self._said:
                self._say(news)
                self._logs.vehicle.tell(now_s, news)
        if self._said != {line}:
            self._notifier.status(line)
        self._said = {line}
        self._teller.note(decision, line)
        telemetry = companion.adapter.telemetry
        if self._teller.values_due(now_s):
            gap_s = self._gaps.take_recent_max_s()
            for frame in self._teller.values(now_s, telemetry.system_id, decision, gap_s):
                self._link.send(frame)
        if self._logs.decisions is not None:
            self._logs.decisions.add(decision, telemetry, self._decision_gaps.take_recent_max_s())
        self._broadcast_state.keep_now_and_then(now_s)
        self._awaited = decision.purpose is Purpose.IDLE and telemetry.armed

    def _say(self, line: str) -> None:
        self._words.do(lambda: click.echo(f"companion: {line}"))

    def _believe(self, take: Callable[[float], list[RawFrame]]) -> None:
        now_s = self._clock.now_s()
        for raw in take(now_s):
            self._logs.vehicle.record_frame(now_s, raw)

    def _from_broadcast(self, datagram: bytes) -> None:
        if self._is_stream:
            frames = list(self._companion.authenticator.deframed(datagram))
            for frame in frames:
                self._logs.broadcast.record_frame(self._clock.now_s(), frame)
            self._believe(lambda now_s: self._companion.hear_frames(frames, now_s))
        else:
            self._logs.broadcast.record(self._clock.now_s(), datagram)
            self._believe(lambda now_s: self._companion.hear(datagram, now_s))

    def _from_autopilot(self, datagram: bytes) -> None:
        frames = [frame for frame in raw_frames(datagram) if not self._is_others(frame)]
        if not frames:
            return
        now_s = self._clock.now_s()
        told = b"".join(frame.data for frame in frames)
        self._companion.receive(told, now_s)
        for frame in frames:
            self._logs.vehicle.record_frame(now_s, frame)
        if self._offboard is not None:
            self._offboard.receive(told)

    def _is_others(self, frame: RawFrame) -> bool:
        """Return whether a frame on the autopilot's link is none of the autopilot's; hear it if it is the broadcast's.

        What the log keeps for the ground station's and for our own must not come from this link, or a replay would
        believe it.
        """
        if self._broadcast_link is None and (inner := unwrap(frame)) is not None:
            self._from_broadcast(inner)
            return True
        if frame.version == 1:
            return False
        ours = frame.component == COMPANION_COMPONENT or frame.message_id in ONEWAY_IDS
        return ours or frame.sender == (GROUND_SYSTEM, GROUND_COMPONENT)

    def _note_clock(self, now_s: float) -> None:
        offset_s = time.time() - now_s
        if self._companion.note_clock(offset_s):
            self._logs.vehicle.record(now_s, clock_frame(self._system_id, now_s, offset_s))

    def _after_gap(self) -> bool:
        """Note that MAVSDK's stream had a gap; return whether it may begin again, as it may while a person flies."""
        authority = self._companion.authority
        may_go_on = not authority.locked
        authority.note_gap(MAVSDK_SILENT)
        if may_go_on and authority.locked:
            self._logs.vehicle.record(self._clock.now_s(), mark_frame(Mark.GAP, self._system_id))
        return not authority.locked

    def _clear(self) -> None:
        """Give the vehicle back to the companion after a take-over, at a person's signal."""
        if self._autopilot.clear != "signal":
            self._say("warning: SIGUSR1 ignored; it counts only with autopilot.clear: signal")
            return
        now_s = self._clock.now_s()
        self._companion.clear(now_s)
        self._logs.vehicle.record(now_s, mark_frame(Mark.CLEARED, self._system_id))
        self._say("cleared by a signal")

    @property
    def _system_id(self) -> int:
        return self._companion.adapter.telemetry.system_id or 1


class _StateKeeper:
    """Keeps what was accepted last on disk; a full disk is no reason to stop steering."""

    def __init__(self, path: str | None, authenticator: Authenticator, files: IoThread) -> None:
        self._path = None if path is None else Path(path)
        self._admission = authenticator
        self._files = files
        self._kept = authenticator.state
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
            _write_in_background(self._path, state.to_json(), self._files)
            self._kept = state


class _EngagementKeeper:
    """Keeps on disk who has the vehicle, for the companion that is started after this one."""

    def __init__(self, path: str | None, was: State, files: IoThread) -> None:
        self._path = None if path is None else Path(path)
        self._kept = was
        self._files = files

    def note(self, state: State) -> None:
        """Write it if it changed."""
        if state is not self._kept and self._path is not None:
            _write_in_background(self._path, json.dumps({"engagement": state.value}), self._files)
        self._kept = state


def _write_in_background(path: Path, text: str, files: IoThread) -> None:
    def write() -> None:
        try:
            write_state_file(path, text)
        except InputError as error:
            click.echo(f"companion: warning: {error}", err=True)

    files.do(write)


def _background(name: str, stack: ExitStack) -> IoThread:
    background = IoThread(name)
    stack.callback(background.close)
    return background


@dataclass(frozen=True)
class _Logs:
    folder: Path | None
    vehicle: FlightLog
    broadcast: FlightLog
    decisions: DecisionTable | None


def _logs(config: Config, files: IoThread, stack: ExitStack) -> _Logs:
    """Open the logs of this run in a folder of its own: a restart in flight shall not cost what was recorded before."""
    if config.log_dir is None:
        return _Logs(None, FlightLog(None), FlightLog(None), None)
    folder = unused(Path(config.log_dir) / time.strftime("%Y%m%dT%H%M%SZ", time.gmtime()))
    try:
        folder.mkdir(parents=True)
        (folder / f"companion-{config.agent_id}.yaml").write_text(dump_config(config), encoding="utf-8")
        vehicle, broadcast, decisions = (
            IoThreadFile(folder / f"{name}-{config.agent_id}.{suffix}", files)
            for name, suffix in (("vehicle", "tlog"), ("broadcast", "tlog"), ("decisions", "csv"))
        )
    except OSError as error:
        raise InputError(
            f"log_dir: '{config.log_dir}' cannot be used: {error.strerror}; allowed: a writable folder"
        ) from error
    broadcast_log = FlightLog(TlogWriter(broadcast), most_bytes_per_s=BROADCAST_LOG_BYTES_PER_S)
    logs = _Logs(folder, FlightLog(TlogWriter(vehicle)), broadcast_log, DecisionTable(decisions))
    for closing in (vehicle.close, broadcast.close, decisions.close):
        stack.callback(closing)
    return logs


@contextmanager
def _tidy_memory() -> Iterator[Callable[[], object]]:
    """Keep Python's search for garbage out of the loop but where it is called: between two slots.

    What is there when the loop begins (modules, tables) stays, and is not searched again.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield gc.collect
    finally:
        gc.enable()
        gc.unfreeze()


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
        epoch_s = companion.world_model.epoch_s
        if epoch_s != self._epoch_s:
            if self._epoch_s is not None:
                lines.append(f"another run of a ground station took over (epoch {epoch_s})")
            self._epoch_s = epoch_s
        refused = companion.authenticator.rejected
        if refused[OLD_EPOCH] > 0 and not self._older:
            lines.append("warning: frames of an older run are heard too: are two ground stations broadcasting?")
        self._older = refused[OLD_EPOCH] > 0
        quality = companion.link_monitor.quality(now_s)
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
                f"broadcast ({companion.authenticator.trust.words}): {quality.share:.0%} of its frames heard, "
                f"age of {ages or 'nothing'}; refused: {reasons or 'none'}"
            )
        self._any_refused = any_refused
        return lines
