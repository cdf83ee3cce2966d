"""Shell of `companion run`: sockets, the clock and the log files around the core.

It opens the autopilot link, which goes both ways; the broadcast link, which is only ever received (or is the same link,
where one radio carries both); and an uplink for reports, if configured. Setpoints are sent on a fixed grid of the
steady clock. The core gets the Unix time of the start carried on by the steady clock, so that a step of the system
clock in flight changes no age. Threads of their own wait for disks and the terminal.

In each slot the autopilot's link is read until nothing waits, then the decision is made and the setpoint sent; what
came on the broadcast link, which anybody may have sent, has its turns between the slots.
"""

from __future__ import annotations

import asyncio
import gc
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.autopilot.offboard import Offboard, is_setpoint
from companion.errors import InputError
from companion.onboard.authority import State
from companion.onboard.companion import Companion
from companion.onboard.config import ONE_RADIO, AutopilotSection, Config
from companion.onboard.decision import Decision, Purpose
from companion.onboard.decision_reporter import DecisionReporter
from companion.onboard.inputs import AutopilotInput, BroadcastInput
from companion.onboard.log_folder import LogFolder, VehicleLog, open_log_folder
from companion.onboard.loop_watch import Counts, FloodWatch, LoopWatch, StallWatch
from companion.onboard.output import AutopilotOutput
from companion.onboard.recording import RecordedCompanion
from companion.onboard.state_files import (
    AuthenticatorStateFile,
    AuthorityStateFile,
    saved_authenticator_state,
    saved_authority,
)
from companion.onboard.trust import trust_of
from companion.onboard.turn_queue import TurnQueue
from companion.onboard.uplink import Uplink, open_uplink
from companion.protocol.authenticator import Authenticator
from companion.runtime.clock import SteadyClock, drain_sockets, steady_s, wait
from companion.runtime.console import messages_written_by, program_logger
from companion.runtime.io_thread import IoThread, open_io_thread
from companion.runtime.rate import LoopRate, next_due_s
from companion.runtime.systemd import Notifier
from companion.transport.endpoints import Address, Link, open_duplex, open_receiver, parse_link

LOGGER = program_logger("companion")
BROADCAST_SHARE = 0.25
"""Greatest mean share of the time that is spent on what came on the broadcast link."""
READING_SHARE = 1.0 / 16.0
"""Greatest share of the time that is spent on reading the broadcast link, before anything is worked on."""
STRANGERS_SHARE = 0.05
"""The same for what came on the autopilot's link from addresses that are not its own."""
CHECKS_AT_ONCE = 4
"""Greatest number of Ed25519 signatures checked in one go, 0.13 ms each here and several times that on a small
computer."""
OLD_S = 0.1
"""Age of a decision from which it is looked at again before its setpoint is sent: the program was held up meanwhile."""

ITS_LOG = VehicleLog()
Build = Callable[[Config, Authenticator, State], Companion]
"""Makes the companion of a flight from its configuration, its authenticator and the state saved before."""


def _steering(config: Config, authenticator: Authenticator, was: State) -> Companion:
    return Companion(config, authenticator=authenticator, was=was)


async def run_companion(
    config: Config, stop: asyncio.Event, build: Build = _steering, log: VehicleLog = ITS_LOG
) -> Path | None:
    """Steer until `stop` is set; print a line when the decision changes, and regularly how well the broadcast is heard.

    Returns the folder of the logs, if there is one; `build` makes the companion, `log` says how its log is kept. A disk
    that takes neither logs nor state is told of, and no reason not to fly.

    Raises:
        InputError: a link cannot be opened, or a key or state file cannot be used.

    """
    if config.autopilot is None or config.broadcast is None:
        raise InputError("companion: autopilot and broadcast links are needed")
    with ExitStack() as stack:
        # Opened first and so closed last, after everything that still has messages to print or bytes to write.
        stack.enter_context(messages_written_by("companion", open_io_thread("words", stack).do))
        files = open_io_thread("files", stack)
        # Threads of their own: a disk for logs that hangs must not keep the state from being written.
        logs = open_log_folder(config, open_io_thread("logs", stack), stack, log)
        vehicle = _prepare(config, build, logs, files, stack)
        try:
            links = await _open_links(vehicle, config.autopilot, stack)
        except InputError:
            # A program that is restarted again and again until a port is there must not leave a folder each time.
            vehicle.logs.discard()
            raise
        LOGGER.info(
            "agent %d, %s on %s, broadcast on %s (%s)",
            config.agent_id,
            config.autopilot.kind,
            config.autopilot.link,
            config.broadcast.link,
            vehicle.flight.companion.authenticator.trust.words,
        )
        await SetpointLoop(vehicle, links).run(stop)
    return vehicle.logs.path


@dataclass(frozen=True)
class _Vehicle:
    """Everything of a flight beside its links: core, logs, state files and the notifier to systemd."""

    config: Config
    flight: RecordedCompanion
    logs: LogFolder
    broadcast_link: Link | None
    """Link of the broadcast; None where it comes over the autopilot's link."""
    authority_file: AuthorityStateFile
    authenticator_file: AuthenticatorStateFile
    notifier: Notifier


def _prepare(config: Config, build: Build, logs: LogFolder, files: IoThread, stack: ExitStack) -> _Vehicle:
    """Read keys and state files, and make the companion; `stack` closes what it opens. Raises InputError."""
    autopilot, broadcast = config.autopilot, config.broadcast
    assert autopilot is not None and broadcast is not None
    link = None if broadcast.link == ONE_RADIO else parse_link(broadcast.link)
    clock = SteadyClock()
    saved, before = saved_authenticator_state(broadcast), saved_authority(autopilot)
    for warning in (*saved.warnings, *before.warnings):
        LOGGER.warning("%s", warning)
    trust = trust_of(broadcast)
    authenticator = Authenticator(trust, saved.state, is_stream=_is_stream(link), checks_at_once=CHECKS_AT_ONCE)
    companion = build(config, authenticator, before.state)
    flight = RecordedCompanion(companion, clock, logs.vehicle)
    flight.begin(before.state)
    authenticator_file = AuthenticatorStateFile(broadcast.state_file, authenticator, files)
    authenticator_file.begin()
    stack.callback(authenticator_file.write)
    notifier = Notifier()
    stack.callback(notifier.close)
    return _Vehicle(
        config=config,
        flight=flight,
        logs=logs,
        broadcast_link=link,
        authority_file=AuthorityStateFile(autopilot.state_file, files),
        authenticator_file=authenticator_file,
        notifier=notifier,
    )


@dataclass(frozen=True)
class _Untrusted:
    """Inputs that anybody may have sent: they have turns of their own, after the autopilot's."""

    queues: tuple[TurnQueue[Any], ...]
    watches: tuple[FloodWatch, ...]
    """Those who notice that more comes than there are turns for."""

    def hold(self) -> None:
        """Give no turns."""
        for queue in self.queues:
            queue.hold()

    def go_on(self, for_s: float) -> None:
        """Give turns for so many seconds; see TurnQueue.go_on."""
        for queue in self.queues:
            queue.go_on(for_s)


@dataclass(frozen=True)
class _Links:
    """The open links of a flight."""

    output: AutopilotOutput
    untrusted: _Untrusted
    uplink: Uplink | None


async def _open_links(vehicle: _Vehicle, autopilot: AutopilotSection, stack: ExitStack) -> _Links:
    """Open the links, which `stack` closes; raises InputError."""
    flight, logs, loop = vehicle.flight, vehicle.logs, asyncio.get_running_loop()
    broadcast = BroadcastInput(flight, logs.broadcast, is_stream=_is_stream(vehicle.broadcast_link))
    queue = TurnQueue(broadcast.receive, BROADCAST_SHARE, loop, flight.hear_waiting)
    overruns: Callable[[], int] = _none
    if vehicle.broadcast_link is not None:
        receiver = await open_receiver(vehicle.broadcast_link, queue.offer, most_share=READING_SHARE)
        stack.callback(receiver.close)
        overruns = receiver.overruns
    offboard = None
    if autopilot.kind == "px4-copter" and autopilot.offboard == "mavsdk":
        # MAVSDK sends nothing before the loop ticks; by then `output` is set.
        offboard = Offboard(lambda frame: output.transmit(frame), flight.note_stream_gap)
        stack.callback(offboard.close)
    heard = AutopilotInput(flight, queue.offer if vehicle.broadcast_link is None else None, offboard)
    strangers = TurnQueue[tuple[bytes, Address]](lambda said: heard.receive(*said), STRANGERS_SHARE, loop)

    def hear(chunk: bytes, address: Address | None) -> None:
        if address is None or heard.peer.knows(address):
            heard.receive(chunk, address)
        else:
            strangers.offer((chunk, address))

    link = await open_duplex(parse_link(autopilot.link), hear)
    stack.callback(link.close)
    heard.peer.bind = link.bind
    watches = (
        FloodWatch("broadcast link", lambda: Counts(queue.offered, queue.dropped, overruns())),
        FloodWatch(
            "autopilot's link, by others,", lambda: Counts(strangers.offered, strangers.dropped, link.overruns())
        ),
    )
    untrusted = _Untrusted((queue, strangers), watches)
    stack.callback(untrusted.hold)
    output = AutopilotOutput(flight.companion, link, logs.vehicle, offboard)
    return _Links(output, untrusted, await open_uplink(vehicle.config.uplink, stack))


class SetpointLoop:
    """The loop of a flight: in each slot of a fixed grid it decides, or repeats the last decision, and sends it."""

    def __init__(self, vehicle: _Vehicle, links: _Links) -> None:
        self._vehicle = vehicle
        self._flight = vehicle.flight
        self._output = links.output
        self._untrusted = links.untrusted
        self._stalls = StallWatch()
        watch = LoopWatch(self._stalls, links.untrusted.watches)
        self._reporter = DecisionReporter(
            vehicle.flight.companion, links.output, vehicle.logs, vehicle.notifier, links.uplink, watch
        )
        self._handover_awaited = False
        """Whether an armed vehicle may be handed over at any moment, so that a decision is made in every slot."""

    async def run(self, stop: asyncio.Event) -> None:
        """Decide and send on the grid until `stop` is set."""
        config, notifier = self._vehicle.config, self._vehicle.notifier
        asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, self._clear)
        period_s = min(1.0 / config.setpoint_rate_hz, config.guidance_step_s)
        rate = LoopRate(period_s, steady_s())
        decide_s = rate.due_s
        notifier.ready()
        with _garbage_between_slots() as collect:
            while not stop.is_set():
                self._stalls.note_slot(rate.due_s, steady_s(), time.process_time())
                # A decision falls into the slot nearest to when it is due.
                decides = self._handover_awaited or rate.due_s >= decide_s - 0.5 * period_s
                if decides:
                    decide_s = next_due_s(decide_s, rate.due_s, config.guidance_step_s)
                await self._slot(decides)
                if decides:
                    collect()
                wait_s = rate.next_after(steady_s()) - steady_s()
                self._untrusted.go_on(wait_s)
                await wait(stop, wait_s)
        LOGGER.info("%s", self._output.gaps.summary)
        LOGGER.info("%s", self._stalls.lateness.summary)

    async def _slot(self, decides: bool) -> None:
        """Hear the autopilot; decide, or repeat the last decision, and send the frames; then save and report."""
        flight = self._flight
        self._untrusted.hold()
        # The safety pilot may have taken over: what waits on the autopilot's link comes before everything else.
        await drain_sockets()
        now_s = flight.clock.now_s()
        flight.note_clock(now_s)
        if self._output.is_silent:
            flight.note_stream_gap()
        decision = None
        if decides:
            decision, frames = flight.decide(now_s)
        else:
            frames = flight.repeat(now_s)
        if flight.clock.now_s() - now_s > OLD_S:
            frames = await self._again(frames)
        self._output.send(frames, now_s)
        self._vehicle.authority_file.write(flight.companion.authority.kept)
        if decision is not None:
            self._tell(decision, now_s)
        self._reporter.send_text(now_s)
        self._vehicle.notifier.alive()

    async def _again(self, frames: list[bytes]) -> list[bytes]:
        """Return frames that were made before the program was held up, with setpoints only if they still hold."""
        await drain_sockets()
        kept = [frame for frame in frames if not is_setpoint(frame)]
        return kept + self._flight.repeat(self._flight.clock.now_s())

    def _tell(self, decision: Decision, now_s: float) -> None:
        self._reporter.tell(decision, now_s)
        self._vehicle.authenticator_file.write_if_due(now_s)
        self._handover_awaited = decision.purpose is Purpose.IDLE and self._flight.companion.adapter.telemetry.armed

    def _clear(self) -> None:
        """Clear a take-over at the safety pilot's signal (SIGUSR1), if the configuration allows that."""
        autopilot = self._vehicle.config.autopilot
        if autopilot is None or autopilot.clear != "signal":
            LOGGER.info("warning: SIGUSR1 ignored; it counts only with autopilot.clear: signal")
            return
        self._flight.clear()
        LOGGER.info("cleared by a signal")


def _none() -> int:
    """Return how many datagrams the kernel dropped of a broadcast that comes over the autopilot's link: none known."""
    return 0


def _is_stream(link: Link | None) -> bool:
    return link is not None and link.scheme == "serial"


@contextmanager
def _garbage_between_slots() -> Iterator[Callable[[], object]]:
    """Turn Python's garbage collection off, and yield the function that runs it, to be called between two slots.

    Objects that exist when the loop begins (modules, tables) stay, and are not searched again.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield gc.collect
    finally:
        gc.enable()
        gc.unfreeze()
