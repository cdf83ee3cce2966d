"""The command `sim vehicle`: one stand-in autopilot on real sockets and the real clock.

Any MAVLink program (MAVSDK, MAVProxy, a ground station, the companion) can talk to the stand-in, which forwards
messages between its links as the real autopilots do.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np

from companion.autopilot.firmware import Version
from companion.autopilot.intake import Intake
from companion.errors import EXIT_DONE, InputError, nearest_hint
from companion.geo.local_frame import LocalFrame
from companion.protocol.codec import Kind
from companion.protocol.keys import load_mavlink_key
from companion.protocol.mavlink_signing import MavlinkSigner
from companion.runtime.clock import run_until_signal, wait
from companion.transport.endpoints import (
    Address,
    Duplex,
    Link,
    Receiver,
    Sender,
    open_duplex,
    open_receiver,
    open_sender,
    parse_link,
)
from sim.detector import Fleet, Transponder
from sim.parameter_option import parameter_option
from sim.sensor import Sensor, detection_of_row
from sim.vehicles import CRAFTS, Craft, Home, Setup, StandIn, Start, Truth, kinematic_profile
from sim.vehicles.adsb import ADSB_TYPE
from sim.vehicles.ardupilot import ArduPilot
from sim.vehicles.parameters import set_parameters
from sim.vehicles.routing import Router
from sim.vehicles.stand_in import parse

AUTOPILOTS = (*CRAFTS, "kinematic")
"""Names that `--autopilot` takes."""

_STEP_S = 0.05
"""Period of the loop, half that of the fastest telemetry. With setpoints at 10 Hz in and 36 frames a second out, one
process was measured to take 1.4 % of a core."""
_GIVE_UP_CATCHING_UP_S = 1.0
"""Delay of the loop from which the missed time is dropped, rather than flown in one burst; as after a suspend."""
_TRUTH_PERIOD_STEPS = round(1.0 / _STEP_S)
"""Number of steps between two reports of the true state, which is one second."""

# The kinematic vehicle is the paper's: it cannot stop, so it begins in the air.
_KINEMATIC_N_MAX = 10.0
_KINEMATIC_HEIGHT_M = 100.0

OnTruth = Callable[[float, Truth], None]
"""Function called once a second with the Unix time in seconds and the vehicle's true state."""


@dataclass(frozen=True, slots=True)
class VehicleOptions:
    """The options of `sim vehicle`; `alt_m` is the altitude of the ground above sea level."""

    autopilot: str
    links: tuple[Link, ...]
    lat_deg: float = 47.0
    lon_deg: float = 8.0
    alt_m: float = 500.0
    heading_deg: float = 0.0
    speed_m_s: float = 60.0
    system_id: int = 1
    sensor: Link | None = None
    """Link to a ground station that gets this vehicle's position as detections of the agent `system_id`; None: none."""
    sensor_key: str | None = None
    """File with the key that signs the detections; None: they are unsigned."""
    adsb_to: tuple[Link, ...] = ()
    """Links to the receivers of other vehicles that hear this one's transponder, as agent `system_id`; none has one."""
    adsb_from: Link | None = None
    """Link on which its own ADS-B receiver hears the transponders of others; None: it has no receiver."""
    in_air_m: float | None = None
    """Height above the ground at which the vehicle begins, armed and in its holding mode; None: on the ground."""
    wind_from_deg: float = 0.0
    wind_speed_m_s: float = 0.0
    gps_noise_m: float = 0.0
    gps_delay_s: float = 0.0
    battery_percent: float = 100.0
    endurance_min: float | None = None
    """Minutes for which a full battery lasts while armed; None: for ever."""
    parameters: tuple[tuple[str, float], ...] = ()
    """Names and values of autopilot parameters that differ from their defaults."""
    firmware: Version | None = None
    """Version of the autopilot's firmware, whose parameters it has; None: the kind's default."""


async def run_vehicle(
    options: VehicleOptions, *, stop: asyncio.Event | None = None, on_truth: OnTruth | None = None
) -> None:
    """Fly one stand-in in real time until `stop` is set, or for ever.

    `on_truth` gets the true state in the plane whose origin is the start.

    Raises:
        InputError: the autopilot or a parameter is unknown, or a link cannot be opened.

    """
    stop = asyncio.Event() if stop is None else stop
    linked = _LinkedStandIn(_build(options))
    tellers: list[OnTruth] = [] if on_truth is None else [on_truth]
    senders: list[Sender] = []
    try:
        await linked.open(options.links, options.adsb_from)
        if options.sensor is not None:
            senders.append(await open_sender(options.sensor))
            tellers.append(_sensing(options, senders[-1]))
        for link in options.adsb_to:
            senders.append(await open_sender(link))
            tellers.append(_transponding(options, linked.vehicle, senders[-1]))
        names = ", ".join(str(link) for link in options.links)
        click.echo(f"sim vehicle: {options.autopilot}, system {options.system_id}, on {names}")
        await _fly(linked, tellers, stop)
    finally:
        linked.close()
        for sender in senders:
            sender.close()


class _LinkedStandIn:
    """A stand-in with its links, between which it forwards messages."""

    def __init__(self, vehicle: StandIn) -> None:
        self.vehicle = vehicle
        self.began_s = asyncio.get_running_loop().time()
        """The event loop's time at which the stand-in's clock is 0."""
        self._router = Router(vehicle.system_id)
        self._intake = Intake()
        self._links: list[Duplex] = []
        self._receiver: Receiver | None = None

    async def open(self, links: Sequence[Link], adsb_from: Link | None) -> None:
        """Open the links and answer on them, and the receiver's; raise InputError for one that cannot be opened."""
        for index, link in enumerate(links):
            self._links.append(await open_duplex(link, partial(self._answer, index)))
        if adsb_from is not None:
            self._receiver = await open_receiver(adsb_from, self._hear_adsb)

    def send(self, frames: Iterable[bytes]) -> None:
        """Send frames of the stand-in on every link."""
        for frame in frames:
            for end_point in self._links:
                end_point.send(frame)

    def close(self) -> None:
        """Close the links that are open."""
        for end_point in self._links:
            end_point.close()
        if self._receiver is not None:
            self._receiver.close()

    def _hear_adsb(self, datagram: bytes) -> None:
        self.send(self.vehicle.hear_adsb([datagram], asyncio.get_running_loop().time() - self.began_s))

    def _answer(self, index: int, chunk: bytes, address: Address | None) -> None:
        frames = self._intake.feed(chunk, (index, address))
        if frames and address is not None:
            # As an autopilot does: whoever spoke last is answered.
            self._links[index].bind(address)
        messages = [message for frame in frames for message in parse(frame.data)]
        for other, frame in self._router.route(index, messages):
            self._links[other].send(frame)
        for frame in self.vehicle.take(messages, asyncio.get_running_loop().time() - self.began_s):
            self._links[index].send(frame)


async def _fly(linked: _LinkedStandIn, tellers: Sequence[OnTruth], stop: asyncio.Event) -> None:
    """Fly in real time from now on until `stop` is set."""
    loop = asyncio.get_running_loop()
    linked.began_s = loop.time()
    steps = 0
    while not stop.is_set():
        t_s = steps * _STEP_S
        linked.vehicle.step_to(t_s)
        linked.send(linked.vehicle.telemetry(t_s))
        if steps % _TRUTH_PERIOD_STEPS == 0:
            for tell in tellers:
                tell(time.time(), linked.vehicle.truth)
        steps += 1
        wait_s = linked.began_s + steps * _STEP_S - loop.time()
        if wait_s < -_GIVE_UP_CATCHING_UP_S:
            linked.began_s -= wait_s
        await wait(stop, wait_s)


def _sensing(options: VehicleOptions, sender: Sender) -> OnTruth:
    """Return the function that sends the vehicle's true state as a detection to a ground station; raises InputError."""
    sensor = Sensor(options.lat_deg, options.lon_deg, int(time.time()))
    # A link id of its own, as each vehicle's detections are a stream of their own.
    key = options.sensor_key
    signer = None if key is None else MavlinkSigner(load_mavlink_key(Path(key)), options.system_id)

    def tell(t_unix_s: float, truth: Truth) -> None:
        row = np.array([truth.north_m, truth.east_m, math.degrees(truth.heading_rad), truth.speed_m_s])
        for datagram in sensor.look([detection_of_row(Kind.AGENT, options.system_id, row)], t_unix_s):
            sender.send(datagram if signer is None else signer.sign(datagram, t_unix_s))

    return tell


def _transponding(options: VehicleOptions, vehicle: StandIn, sender: Sender) -> OnTruth:
    """Return the function that sends where the vehicle is to the receiver of another one."""
    transponder = Transponder(options.system_id, LocalFrame(options.lat_deg, options.lon_deg))

    def tell(_t_unix_s: float, _truth: Truth) -> None:
        sender.send(transponder.squitter(Fleet.of({options.system_id: vehicle})))

    return tell


def _build(options: VehicleOptions) -> StandIn:
    _require_known(options.autopilot)
    height_m = options.in_air_m
    speed_m_s = 0.0
    build: Callable[[Start], Craft]
    guided = options.autopilot == "kinematic"
    if guided:
        height_m = _KINEMATIC_HEIGHT_M if height_m is None else height_m
        speed_m_s = options.speed_m_s
        build = kinematic_profile(_KINEMATIC_N_MAX, speed_m_s, speed_m_s)
    else:
        build = CRAFTS[options.autopilot]
    vehicle = StandIn(
        build,
        Setup(
            options.system_id,
            LocalFrame(options.lat_deg, options.lon_deg),
            altitude_m=options.alt_m + (height_m or 0.0),
            heading_rad=math.radians(options.heading_deg),
            speed_m_s=speed_m_s,
            home=Home(0.0, 0.0, options.alt_m),
            in_air=height_m is not None,
            armed=height_m is not None,
            guided=guided,
            firmware=options.firmware,
        ),
    )
    from_rad = math.radians(options.wind_from_deg)
    vehicle.wind_m_s = -options.wind_speed_m_s * math.cos(from_rad), -options.wind_speed_m_s * math.sin(from_rad)
    vehicle.sensors.noise_m = options.gps_noise_m
    vehicle.sensors.delay_s = options.gps_delay_s
    vehicle.battery.percent = options.battery_percent
    if options.endurance_min is not None:
        vehicle.battery.drain_percent_s = 100.0 / (60.0 * options.endurance_min)
    if options.adsb_from is not None and ADSB_TYPE in vehicle.parameters:
        vehicle.parameters[ADSB_TYPE] = 1.0
    set_parameters(vehicle, options.parameters)
    if height_m is None and isinstance(vehicle.craft, ArduPilot):
        vehicle.craft.boot(0.0)
    return vehicle


def _require_known(autopilot: str) -> None:
    if autopilot not in AUTOPILOTS:
        hint = nearest_hint(autopilot, AUTOPILOTS)
        raise InputError(f"--autopilot: unknown '{autopilot}'; allowed: {', '.join(AUTOPILOTS)}{hint}")


def _known_autopilot(_context: click.Context, _parameter: click.Parameter, value: str) -> str:
    _require_known(value)
    return value


def _parsed_links(_context: click.Context, _parameter: click.Parameter, values: tuple[str, ...]) -> tuple[Link, ...]:
    return tuple(parse_link(value) for value in values)


def _parsed_link(_context: click.Context, _parameter: click.Parameter, value: str | None) -> Link | None:
    return None if value is None else parse_link(value)


def _version(_context: click.Context, parameter: click.Parameter, value: str | None) -> Version | None:
    if value is None:
        return None
    major, dot, minor = value.partition(".")
    if not (dot and major.isdecimal() and minor.isdecimal()):
        raise click.BadParameter(f"'{value}' is no version like 4.6", param=parameter)
    return int(major), int(minor)


def _finite(_context: click.Context, parameter: click.Parameter, value: float) -> float:
    if not math.isfinite(value):
        raise click.BadParameter(f"{value} is not a finite number", param=parameter)
    return value


def _finite_if_given(context: click.Context, parameter: click.Parameter, value: float | None) -> float | None:
    return None if value is None else _finite(context, parameter, value)


@click.command(
    "vehicle",
    epilog="Example: sim vehicle --autopilot arducopter --connect udpout:127.0.0.1:14540",
    short_help="One stand-in autopilot in real time.",
)
@click.option(
    "--autopilot",
    required=True,
    callback=_known_autopilot,
    metavar=f"[{'|'.join(AUTOPILOTS)}]",
    help="Which autopilot to stand in for.",
)
@click.option(
    "--connect",
    "links",
    required=True,
    multiple=True,
    callback=_parsed_links,
    metavar="URL",
    help="udpin:HOST:PORT or udpout:HOST:PORT; may be given several times: it passes messages on between them.",
)
@click.option(
    "--lat", "lat_deg", type=click.FloatRange(-90, 90), callback=_finite, default=47.0, show_default=True, help="deg"
)
@click.option(
    "--lon", "lon_deg", type=click.FloatRange(-180, 180), callback=_finite, default=8.0, show_default=True, help="deg"
)
@click.option(
    "--alt",
    "alt_m",
    type=click.FloatRange(-500, 10000),
    callback=_finite,
    default=500.0,
    show_default=True,
    help="Height of the ground above sea level, m.",
)
@click.option(
    "--heading",
    "heading_deg",
    type=float,
    callback=_finite,
    default=0.0,
    show_default=True,
    help="From true north, deg.",
)
@click.option(
    "--speed",
    "speed_m_s",
    type=click.FloatRange(1, 300),
    callback=_finite,
    default=60.0,
    show_default=True,
    help="Of a kinematic vehicle, which cannot stop and begins in the air, m/s.",
)
@click.option(
    "--sensor",
    callback=_parsed_link,
    metavar="URL",
    help="udpout:HOST:PORT of a ground station that shall see this vehicle, as the agent numbered like its system id.",
)
@click.option(
    "--sensor-key", metavar="FILE", help="Sign what --sensor sends, with the sensor.mavlink of `groundstation keygen`."
)
@click.option(
    "--adsb-to",
    "adsb_to",
    multiple=True,
    callback=_parsed_links,
    metavar="URL",
    help="udpout:HOST:PORT of another vehicle's --adsb-from, which shall hear this one's ADS-B; may be given often.",
)
@click.option(
    "--adsb-from",
    "adsb_from",
    callback=_parsed_link,
    metavar="URL",
    help="udpin:HOST:PORT where its own ADS-B receiver hears others; without it the vehicle sees nobody.",
)
@click.option(
    "--in-air",
    "in_air_m",
    type=click.FloatRange(1, 10000),
    callback=_finite_if_given,
    metavar="HEIGHT",
    help="Begin flying at this height above the ground, m: armed, in the mode that holds it there, planes at cruise.",
)
@click.option(
    "--wind-from",
    "wind_from_deg",
    type=float,
    callback=_finite,
    default=0.0,
    show_default=True,
    help="Where the wind comes from, deg.",
)
@click.option(
    "--wind-speed",
    "wind_speed_m_s",
    type=click.FloatRange(0, 100),
    callback=_finite,
    default=0.0,
    show_default=True,
    help="m/s.",
)
@click.option(
    "--gps-noise",
    "gps_noise_m",
    type=click.FloatRange(0, 100),
    callback=_finite,
    default=0.0,
    show_default=True,
    help="Standard deviation of the reported position, m.",
)
@click.option(
    "--gps-delay",
    "gps_delay_s",
    type=click.FloatRange(0, 5),
    callback=_finite,
    default=0.0,
    show_default=True,
    help="Age of the reported position, s.",
)
@click.option(
    "--battery",
    "battery_percent",
    type=click.FloatRange(0, 100),
    callback=_finite,
    default=100.0,
    show_default=True,
    help="Charge at the start, percent.",
)
@click.option(
    "--endurance",
    "endurance_min",
    type=click.FloatRange(0.1, 10000),
    callback=_finite_if_given,
    help="Minutes that a full battery lasts once armed; for ever unless given.",
)
@click.option(
    "--firmware",
    callback=_version,
    metavar="VERSION",
    help="Version of the autopilot's firmware, 4.3 to 4.7 or PX4's 1.13 to 1.17, whose parameter names it has.",
)
@parameter_option()
@click.option("--system-id", type=click.IntRange(1, 255), default=1, show_default=True, help="MAVLink system id.")
def vehicle(**options: Any) -> int:  # noqa: ANN401 click gives each option its type
    """Run one stand-in autopilot that speaks MAVLink, until it is interrupted.

    It waits on the ground unless told to begin in the air; a kinematic vehicle circles until it gets setpoints.
    """
    asked = VehicleOptions(**options)
    run_until_signal(lambda stop: run_vehicle(asked, stop=stop))
    return EXIT_DONE
