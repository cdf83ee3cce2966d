"""Shell of `companion check`: opens the links, listens and asks for a while, and prints its findings.

It sends what a companion sends before it may steer (heartbeats, requests for parameters and messages), never a
setpoint.
"""

from __future__ import annotations

import asyncio
import math
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import click

from companion.autopilot.identity import AUTOPILOT_COMPONENT
from companion.autopilot.intake import Intake
from companion.autopilot.offboard import require_mavsdk
from companion.autopilot.registry import ADAPTERS
from companion.autopilot.telemetry import HEARTBEAT_PERIOD_S
from companion.errors import EXIT_DONE, EXIT_FAILED, InputError
from companion.onboard.broadcast_causes import CauseWatch
from companion.onboard.causes import AGENT
from companion.onboard.config import ONE_RADIO, Config
from companion.onboard.disk_check import DISK_REMEDY, disk_troubles
from companion.onboard.finding import Finding
from companion.onboard.param_file import check_new, write_param_file
from companion.onboard.peer import Peer
from companion.onboard.preflight import (
    RATES_S,
    finding_on_agent,
    finding_on_cause,
    finding_on_others,
    findings,
)
from companion.onboard.trust import trust_of
from companion.onboard.world_model import WorldModel
from companion.protocol.authenticator import Authenticated, Authenticator
from companion.protocol.codec import FleetFrame, StateFrame
from companion.protocol.link_quality import LinkMonitor
from companion.protocol.mavlink_signing import without_signature
from companion.protocol.v2_extension import unwrap
from companion.runtime.clock import SteadyClock, wait
from companion.transport.endpoints import Address, Duplex, open_duplex, open_receiver, open_sender, parse_link

ASK_PERIOD_S = 0.1
"""Time between two rounds of asking the autopilot and of checking whether all is known."""
SETTLING_S = 3.0
"""Shortest time of listening: slow messages, such as the battery's, come once a second or less often."""


async def check_vehicle(
    config: Config, wait_s: float, stop: asyncio.Event, *, strict: bool = False, param: Path | None = None
) -> int:
    """Listen for at most `wait_s` seconds, or until all is known; print the findings and return the exit status.

    With `strict` a warning fails, too. `param`: a new file into which the parameters that are demanded are written.

    Raises:
        InputError: a link cannot be opened, a key or state file cannot be used, or `param` exists or cannot be written.

    """
    if config.autopilot is None or config.broadcast is None:
        raise InputError("companion: autopilot and broadcast links are needed")
    if param is not None:
        check_new(param)
    with ExitStack() as stack:
        checker = _Checker(config, stack)
        await checker.open()
        await checker.listen(wait_s, stop)
        found = checker.findings()
        status = report(found, strict=strict)
        if param is not None:
            click.echo(checker.write(found, param))
        return status


def report(found: list[Finding], *, strict: bool = False) -> int:
    """Print one line per finding and how many failed; return the exit status. With `strict` a warning fails, too."""
    for finding in found:
        remedy = f" -> {finding.remedy}" if finding.remedy and (not finding.passed or finding.warns) else ""
        click.echo(f"{finding.word}  {finding.text}{remedy}")
    failed, warned = sum(not one.passed for one in found), sum(one.passed and one.warns for one in found)
    warnings = f", {warned} warning{'s' * (warned > 1)}" if warned else ""
    click.echo(f"{len(found)} checked, {failed or 'none'} failed{warnings}")
    return EXIT_FAILED if failed or (strict and warned) else EXIT_DONE


@dataclass
class _Heard:
    """What was heard so far: anything on the autopilot's link, a genuine frame, every frame of one broadcast."""

    intake: Intake = field(default_factory=Intake)
    peer: Peer = field(default_factory=Peer)
    link: bool = False
    broadcast: bool = False
    whole: bool = False
    quality: LinkMonitor = field(default_factory=LinkMonitor)


class _Checker:
    def __init__(self, config: Config, stack: ExitStack) -> None:
        assert config.autopilot is not None and config.broadcast is not None
        self._config, self._autopilot, self._stack = config, config.autopilot, stack
        adapter = ADAPTERS[config.autopilot.kind](config.autopilot.system_id)
        adapter.ask_further()
        self._adapter = adapter
        one_radio = config.broadcast.link == ONE_RADIO
        self._broadcast_link = None if one_radio else parse_link(config.broadcast.link)
        is_stream = self._broadcast_link is not None and self._broadcast_link.scheme == "serial"
        # Without the saved state: a frame that an earlier companion accepted is genuine, too.
        self._authenticator = Authenticator(trust_of(config.broadcast), is_stream=is_stream)
        self._world_model = WorldModel(config.agent_id, clocks_agree=self._authenticator.trust.clock_checked)
        self._watch = CauseWatch(self._authenticator, self._broadcast_link, config.staleness.coasting_after_s)
        self._clock = SteadyClock()
        self._heard = _Heard()
        self._disk_troubles: tuple[str, ...] = ()
        self._link: Duplex

    async def open(self) -> None:
        """Open the links that `companion run` would open; raises InputError."""
        self._disk_troubles = disk_troubles(self._config, self._adapter.resumes_on_stream)
        if self._autopilot.kind == "px4-copter" and self._autopilot.offboard == "mavsdk":
            require_mavsdk()
        if self._broadcast_link is not None:
            receiver = await open_receiver(self._broadcast_link, self._from_broadcast)
            self._stack.callback(receiver.close)
        self._link = await open_duplex(parse_link(self._autopilot.link), self._from_autopilot)
        self._stack.callback(self._link.close)
        self._heard.peer.bind = self._link.bind
        if self._config.uplink is not None:
            self._stack.callback((await open_sender(parse_link(self._config.uplink.link))).close)

    async def listen(self, wait_s: float, stop: asyncio.Event) -> None:
        """Ask and listen until all is known, `wait_s` seconds have passed or `stop` is set."""
        began_s, heartbeat_s = time.monotonic(), -math.inf
        while not stop.is_set() and time.monotonic() - began_s < wait_s:
            now_s = self._clock.now_s()
            self._believe(self._authenticator.due(now_s), now_s)
            self._watch.news(self._world_model, self._heard.quality, now_s)
            if self._all_known and time.monotonic() - began_s >= SETTLING_S:
                return
            if now_s - heartbeat_s >= HEARTBEAT_PERIOD_S:
                heartbeat_s = now_s
                self._link.send(self._adapter.heartbeat())
            for frame in self._adapter.requests(now_s):
                self._link.send(frame)
            await wait(stop, ASK_PERIOD_S)

    def findings(self) -> list[Finding]:
        """Return the findings on all that was heard."""
        found = findings(
            self._config,
            self._adapter,
            link_heard=self._heard.link,
            broadcast_heard=self._heard.broadcast,
            now_s=self._clock.now_s(),
        )
        if self._adapter.refusal is None and self._adapter.telemetry.heartbeat_at_s is not None:
            found.append(finding_on_others(self._config, self._adapter, self._world_model.others_told))
        agent = finding_on_agent(self._config, self._world_model, self._heard.whole)
        if agent is not None:
            found.append(agent)
        causes = self._watch.seen(self._world_model, self._heard.quality, self._clock.now_s())
        found += [finding_on_cause(cause) for cause in causes if cause.name != AGENT]
        found += [Finding(False, trouble, DISK_REMEDY) for trouble in self._disk_troubles]
        return found

    def write(self, found: list[Finding], param: Path) -> str:
        """Write the parameters that the findings demand into a new file; return what was written, in words."""
        values = dict(pair for finding in found for pair in finding.sets)
        if not values:
            return f"{param}: not written: no parameter is demanded, or the vehicle was not heard"
        write_param_file(param, self._adapter.kind, self._adapter.telemetry.system_id or 1, values)
        return f"{param}: {len(values)} parameters written"

    @property
    def _all_known(self) -> bool:
        telemetry, now_s = self._adapter.telemetry, self._clock.now_s()
        healthy = None not in (telemetry.home_deg, telemetry.gps_fix, telemetry.battery_percent)
        told = self._adapter.parameters.settled(now_s) and self._adapter.streams_measured(now_s, RATES_S)
        return self._adapter.refusal is None and told and self._heard.whole and healthy

    def _from_broadcast(self, datagram: bytes) -> None:
        now_s = self._clock.now_s()
        self._believe(self._authenticator.admit(datagram, now_s), now_s)

    def _believe(self, admitted: list[Authenticated], now_s: float) -> None:
        self._heard.broadcast |= bool(admitted)
        for _, frame in admitted:
            self._heard.quality.note(frame, now_s)
            self._world_model.take(frame, now_s)
            if isinstance(frame, StateFrame | FleetFrame):
                self._heard.whole |= self._world_model.order.is_whole(frame.stamp)

    def _from_autopilot(self, chunk: bytes, address: Address | None) -> None:
        self._heard.link = True
        now_s = self._clock.now_s()
        for frame in self._heard.intake.feed(chunk, address):
            if self._broadcast_link is None and (inner := unwrap(frame)) is not None:
                self._from_broadcast(inner)
                continue
            believed = self._adapter.receive(without_signature(frame).data, now_s)
            if believed and frame.is_signed:
                self._adapter.note_signed()
            if address is not None and believed:
                self._heard.peer.note_believed(address, believed, now_s)
            elif address is not None and frame.component == AUTOPILOT_COMPONENT:
                self._heard.peer.note_speaker(address)
