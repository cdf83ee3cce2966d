"""Feed hostile bytes to everything that takes bytes: `python -m tests.benchmarks.fuzz --count 1000000`.

Prints a line for each parser: how many inputs, exceptions (none is allowed but the InputError of files), the growth of
memory and the slowest input. The exit status is 1 if there was an exception, if memory grew by more than GROWTH_MB, or
if an input took longer than SLOWEST_S of processor time.
"""

from __future__ import annotations

import argparse
import gc
import os
import random
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache, partial
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from cryptography.hazmat.primitives import serialization
from pymavlink.dialects.v20 import ardupilotmega
from takproto import TAKProtoVer, xml2proto

from companion.autopilot.kinds import KINDS
from companion.errors import InputError
from companion.files.tlog import Tlog, TlogWriter, whole_frames
from companion.geo.local_frame import LocalFrame
from companion.mission.model import parse_mission
from companion.onboard.broadcast_causes import CauseWatch
from companion.onboard.companion import Companion
from companion.onboard.config import parse_config
from companion.onboard.flight_log import FlightLog, clock_offset_s, mark_of
from companion.onboard.inputs import AutopilotInput
from companion.onboard.recording import RecordedCompanion
from companion.onboard.world_model import WorldModel
from companion.protocol.authenticator import Authenticator, AuthenticatorState, Trust
from companion.protocol.codec import Detection, FrameReader, FrameWriter, Kind, ReportFrame
from companion.protocol.dialect import oneway
from companion.protocol.frame import raw_frame
from companion.protocol.keys import MAVLINK_NAME, PRIVATE_NAME, PUBLIC_NAME, load_mavlink_key, load_private, load_public
from companion.protocol.link_quality import LinkMonitor
from companion.protocol.log_secrets import without_secrets
from companion.protocol.other_dialect import other_dialect
from companion.protocol.radio_status import RadioStatusReader
from companion.protocol.v2_extension import V2_EXTENSION_CRC_EXTRA, V2_EXTENSION_ID, unwrap, wrap
from companion.runtime.clock import SteadyClock
from groundstation.ground_station import GroundStation
from groundstation.saved_state import saved_state_from
from groundstation.sources.sources import Sources
from sim.sensor import mission_sensor
from sim.vehicles import CRAFTS, Setup, StandIn
from tests.benchmarks.hostile import resident_mb
from tests.companion.protocol.hostile import AUTHENTICATIONS, START_S, Ground
from tests.fuzz_inputs import Bytes, Frames, Sentences, Texts
from tests.groundstation.sources.given import COT, DATA, ObeyingDesk, basestation_bytes, mission

GROWTH_MB = 8.0
"""Growth of the resident memory that is allowed after the first tenth of a parser's inputs."""
SLOWEST_S = 2.0
"""Longest processor time of one input that is allowed; the machine may be loaded."""
STEP_S = 0.01
"""Time from one input to the next, by the virtual clock."""
LOOK_EVERY = 500
"""Of this many inputs, one is followed by what a program does with what it has heard."""
MOST_WRAPPED_BYTES = 240
"""Length of a frame up to which it fits into a V2_EXTENSION."""
MOST_SHOWN = 3
"""Most exceptions of a parser that are printed."""

_ONEWAY = {number: (kind.crc_extra, kind.unpacker.size) for number, kind in oneway.mavlink_map.items()} | {
    V2_EXTENSION_ID: (V2_EXTENSION_CRC_EXTRA, 254)
}
_COMMON = {
    number: (kind.crc_extra, min(255, kind.unpacker.size)) for number, kind in ardupilotmega.mavlink_map.items()
} | _ONEWAY
MISSION = """name: fuzzed
agents: [{id: 1, north_m: 0, east_m: 0, n_max: 1}, {id: 2, north_m: 500, east_m: &far 0}]
targets: [{id: 1, north_m: 5.0e+3, east_m: *far}]
threats: [{id: 1, north_m: 2500, east_m: 900, detection_radius_m: 300, attack_radius_m: 100, speed_bound_m_s: 1}]
fence: [[-1000, -1000], [9000, -1000], [9000, 5000], [-1000, 5000]]
"""
CONFIG = """agent_id: 1
autopilot: {kind: arducopter, link: "udpin:127.0.0.1:14550", system_id: 1}
broadcast: {link: "udpin:127.0.0.1:14600", trust: unsigned}
limits: {speed_m_s: 5, n_max: 0.25, range_m: 5000, fence: &f [[0, 0], [0, 9], [9, 9]], exclusions: [*f]}
staleness: {coasting_after_s: 3}
"""


class Parser(NamedTuple):
    """What is fuzzed: a source of inputs, what takes one, and what is done with what was heard now and then."""

    make: Callable[[], bytes]
    take: Callable[[bytes, float], object]
    look: Callable[[float], object] = lambda now_s: None


class Result(NamedTuple):
    """What came of one parser."""

    errors: int
    grown_mb: float
    slowest_s: float
    inputs_per_s: float

    @property
    def is_good(self) -> bool:
        """Whether nothing went wrong."""
        return self.errors == 0 and self.grown_mb < GROWTH_MB and self.slowest_s < SLOWEST_S


@cache
def genuine(word: str, count: int = 12) -> list[bytes]:
    """Return frames of every kind that a ground station broadcasts, signed."""
    ground = Ground(word, random.Random(0))
    frames: list[bytes] = []
    for text in (MISSION, MISSION + "link: {rate_bytes_per_s: 2000}\n"):
        with suppress(InputError):
            station = GroundStation(parse_mission(text, "fuzz"), START_S)
            for second in range(count):
                frames += station.tick(START_S + second)
    return [ground.frame_signer.sign(raw, START_S) for raw in frames] + [ground.frame(START_S) for _ in range(8)]


def broadcast(word: str, rng: random.Random, *, is_stream: bool) -> Parser:
    """Return the gate of the broadcast with all that takes what it accepts."""
    ground = Ground(word, random.Random(0))
    gate = Authenticator(ground.trust, is_stream=is_stream, rng=rng)
    world, quality = WorldModel(1), LinkMonitor()
    watch = CauseWatch(gate, None)

    def take(datagram: bytes, now_s: float) -> None:
        for _, frame in gate.admit(datagram, now_s):
            quality.note(frame, now_s)
            world.take(frame, now_s)

    def look(now_s: float) -> None:
        world.view(now_s, (0.0, 100.0))
        quality.quality(now_s)
        watch.news(world, quality, now_s)
        AuthenticatorState.from_json(gate.state.to_json())

    valid = genuine(word)
    return Parser(
        Frames(rng, [*valid, *(wrap(raw, 0) for raw in valid if len(raw) < MOST_WRAPPED_BYTES)], _ONEWAY), take, look
    )


def autopilot(kind: str, rng: random.Random) -> Parser:
    """Return the autopilot's link of a companion: intake, identity, telemetry, authority, and the decisions."""
    config = parse_config(CONFIG.replace("arducopter", kind), "fuzz")
    companion = Companion(config)
    clock = SteadyClock()
    link = AutopilotInput(RecordedCompanion(companion, clock, FlightLog(None)), None, None)

    def look(now_s: float) -> None:
        companion.tick(clock.now_s())
        companion.adapter.requests(clock.now_s())

    return Parser(Frames(rng, telemetry_of(kind), _COMMON), lambda data, now_s: link.receive(data, ("a", 1)), look)


@cache
def telemetry_of(kind: str) -> list[bytes]:
    """Return what an autopilot sends within some seconds, with answers to requests."""
    vehicle = stand_in(kind)
    frames: list[bytes] = []
    requests = Companion(parse_config(CONFIG.replace("arducopter", kind), "fuzz")).adapter.requests(START_S)
    for request in requests:
        frames += vehicle.receive(request, START_S)
    for tick in range(40):
        vehicle.step_to(START_S + tick / 10)
        frames += vehicle.telemetry(START_S + tick / 10)
    return frames


def stand_in(kind: str) -> StandIn:
    """Return a stand-in in the air."""
    speed_m_s = 0.0 if KINDS[kind].can_stop else 20.0
    setup = Setup(
        1, LocalFrame(47.0, 8.0), altitude_m=560.0, speed_m_s=speed_m_s, in_air=True, armed=True, start_s=START_S
    )
    return StandIn(CRAFTS[kind], setup)


def stand_in_input(kind: str, rng: random.Random) -> Parser:
    """Return the stand-in's input."""
    vehicle = stand_in(kind)
    companion = Companion(parse_config(CONFIG.replace("arducopter", kind), "fuzz"))
    valid = [*companion.adapter.requests(START_S), companion.adapter.heartbeat()]

    def look(now_s: float) -> None:
        vehicle.step_to(now_s)
        vehicle.telemetry(now_s)

    return Parser(Frames(rng, valid, _COMMON), vehicle.receive, look)


def ground(channel: str, rng: random.Random) -> Parser:
    """Return an input of the ground station: the sensor's channel or the uplink."""
    mission = parse_mission(MISSION + ("case: II\n" if channel == "uplink" else ""), "fuzz")
    station = GroundStation(mission, START_S)
    if channel == "sensor":
        seen = [Detection(Kind.AGENT, 1, 1.0, 2.0, 3.0, 4.0), Detection(Kind.THREAT, 1, 2500.0, 900.0, 0.0, 0.0)]
        valid = mission_sensor(mission, int(START_S)).look(seen, START_S + 1.0)
        take = station.sense
    else:
        report = ReportFrame(int(START_S), 500, 1, 47.0, 8.0, 1.0, 1.0, 10.0)
        valid = [FrameWriter(1, 191).encode(report)]
        take = station.hear_report
    return Parser(Frames(rng, valid, _ONEWAY), take, station.tick)


def log(rng: random.Random) -> Parser:
    """Return the reader of telemetry logs, with what replay reads in each frame."""
    sink = BytesIO()
    writer = TlogWriter(sink)
    for number, frame in enumerate((telemetry_of("arducopter") + genuine("both"))[:60]):
        writer.write(START_S + number / 10, frame)
    writer.flush()
    whole = sink.getvalue()
    valid = [whole[:600], whole[300:1400], whole[-900:]]

    def take(content: bytes, now_s: float) -> None:
        with suppress(InputError):
            for t_s, data in Tlog(BytesIO(content), "fuzz.tlog"):
                frame = raw_frame(data)
                without_secrets(frame)
                if frame.version == 2:
                    mark_of(frame)
                    clock_offset_s(frame, t_s)

    return Parser(Bytes(rng, valid), take)


def keys(rng: random.Random, folder: Path) -> Parser:
    """Return the three readers of key files."""
    station = Ground("both", random.Random(0))
    private = station.private_key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    public = station.private_key.public_key().public_bytes(
        serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo
    )
    loaders = {PRIVATE_NAME: load_private, PUBLIC_NAME: load_public, MAVLINK_NAME: load_mavlink_key}
    names = tuple(loaders)
    for name in names:
        (folder / name).touch(0o600)

    def take(content: bytes, now_s: float) -> None:
        name = rng.choice(names)
        (folder / name).write_bytes(content)
        with suppress(InputError):
            loaders[name](folder / name)

    return Parser(Texts(rng, [private, public, station.mavlink_key.hex().encode() + b"\n"]), take)


def states(rng: random.Random) -> Parser:
    """Return the readers of the state files of vehicle and ground station."""
    gate = Authenticator(Trust(mavlink_key=bytes(32), clock_checked=False))
    text = gate.state.to_json()
    full = (
        '{"epoch_s": 1800000000, "sequence": 7, "streams": [[0, 254, 190, 37992960000000]], '
        '"newest_unix_s": 1800000000.5, "spans": [[1800000000, 1, 1800000000, 7]], "open": true}'
    )
    station = (
        '{"epoch_s": 1800000000, "signing_timestamp": 5, "threats": "abc", "began_s": 1.8e9, '
        '"directive": "normal", "revision": 3}'
    )

    def take(content: bytes, now_s: float) -> None:
        with suppress(InputError, UnicodeDecodeError):
            AuthenticatorState.from_json(content.decode())
        with suppress(InputError, UnicodeDecodeError):
            saved_state_from(content.decode(), Path("state.json"))

    return Parser(Texts(rng, [text.encode(), full.encode(), station.encode()]), take)


def yaml(what: str, rng: random.Random) -> Parser:
    """Return the reader of missions or of configurations."""
    parse = parse_mission if what == "mission" else parse_config
    valid = MISSION if what == "mission" else CONFIG

    def take(content: bytes, now_s: float) -> None:
        with suppress(InputError, UnicodeDecodeError):
            parse(content.decode(), "fuzz.yaml")

    return Parser(Texts(rng, [line.encode() for line in (valid, *valid.splitlines(keepends=True))]), take)


def small(rng: random.Random) -> Parser:
    """Return the readers that every datagram of some link passes: of radios' reports, wrapped frames and dialects."""
    radio, reader = RadioStatusReader(), FrameReader()
    status = ardupilotmega.MAVLink_radio_status_message(200, 200, 50, 20, 20, 0, 0)
    valid = [
        bytes(status.pack(ardupilotmega.MAVLink(None))),
        *(wrap(raw, 0) for raw in genuine("unsigned") if len(raw) < 240),
    ]

    def take(content: bytes, now_s: float) -> None:
        radio.feed(content)
        other_dialect(content)
        reader.read(content)
        for data in whole_frames(content):
            unwrap(raw_frame(data))

    return Parser(Frames(rng, valid, _COMMON), take)


def live_source(kind: str, rng: random.Random) -> Parser:
    """Return the parser of a live source, with everything that takes its sightings."""
    made = mission(
        f"{{name: s, kind: {kind}, {'url' if kind in ('telemetry', 'adsb') else 'file'}: x"
        f"{'' if kind == 'telemetry' else ', radius_m: 500'}}}"
    )
    station = GroundStation(made, START_S)
    sources, desk = Sources(made, made.sources), ObeyingDesk(station)
    feed = sources.feeds["s"]

    def take(content: bytes, now_s: float) -> None:
        # Not by the feed's own door, which would count an exception as a refusal.
        feed.offer(feed.parser.feed(content, now_s, len(content) % 3), now_s)
        desk.now_s = now_s
        sources.tick(station, desk, now_s)
        desk.events.clear()

    def look(now_s: float) -> None:
        station.tick(now_s)
        sources.view(station, now_s)
        sources.news(now_s)

    return Parser(_source_inputs(kind, rng), take, look)


def _source_inputs(kind: str, rng: random.Random) -> Callable[[], bytes]:
    valid = {
        "basestation": basestation_bytes()[:4_000].splitlines(keepends=True),
        "ais": (DATA / "ais.nmea").read_bytes().splitlines(keepends=True),
        "cot": [COT.encode(), *(bytes(xml2proto(COT, version)) for version in (TAKProtoVer.MESH, TAKProtoVer.STREAM))],
        "csv": [b"t_s,id,lat_deg,lon_deg,heading_deg,speed_m_s\n", b"1790000000.5,7,48.7,2.35,90,10\n"],
        "jsonl": [b'{"t_s": 1790000000.5, "id": 7, "lat_deg": 48.7, "lon_deg": 2.35, "altitude_m": 9}\n'],
    }
    if kind == "ais":
        return Sentences(rng, valid[kind])
    if kind in valid:
        return Texts(rng, valid[kind])
    aircraft = ardupilotmega.MAVLink_adsb_vehicle_message(
        0x4B1C22, 487_000_000, 23_500_000, 0, 1_000_000, 9_000, 5_000, 0, b"SWR12", 1, 1, 31, 7_000
    )
    return Frames(rng, [bytes(aircraft.pack(ardupilotmega.MAVLink(None))), *telemetry_of("arducopter")], _COMMON)


def parsers(rng: random.Random, folder: Path) -> dict[str, Callable[[], Parser]]:
    """Return all that is fuzzed, by name."""
    found: dict[str, Callable[[], Parser]] = {
        f"broadcast {word}": partial(broadcast, word, rng, is_stream=False) for word in (*AUTHENTICATIONS, "unsigned")
    }
    found["broadcast serial"] = partial(broadcast, "unsigned", rng, is_stream=True)
    for kind in CRAFTS:
        found[f"autopilot {kind}"] = partial(autopilot, kind, rng)
        found[f"stand-in {kind}"] = partial(stand_in_input, kind, rng)
    for channel in ("sensor", "uplink"):
        found[channel] = partial(ground, channel, rng)
    found |= {"small": partial(small, rng), "tlog": partial(log, rng), "keys": partial(keys, rng, folder)}
    found["state"] = partial(states, rng)
    for what in ("mission", "config"):
        found[what] = partial(yaml, what, rng)
    for kind in ("telemetry", "adsb", "basestation", "ais", "cot", "csv", "jsonl"):
        found[f"source {kind}"] = partial(live_source, kind, rng)
    return found


def run(name: str, parser: Parser, count: int) -> Result:
    """Feed a parser; print the exceptions."""
    errors, slowest_s, warm_mb = 0, 0.0, 0.0
    began_s = time.monotonic()
    for number in range(count):
        if number == count // 10:
            gc.collect()
            warm_mb = resident_mb()
        content, now_s = parser.make(), START_S + number * STEP_S
        at_s = time.process_time()
        try:
            parser.take(content, now_s)
            if number % LOOK_EVERY == 0:
                parser.look(now_s)
        except Exception:
            errors += 1
            if errors <= MOST_SHOWN:
                print(f"{name}: input {number}: {content!r}", flush=True)
                traceback.print_exc(file=sys.stdout)
        slowest_s = max(slowest_s, time.process_time() - at_s)
    passed_s = time.monotonic() - began_s
    gc.collect()
    return Result(errors, resident_mb() - warm_mb, slowest_s, count / passed_s)


def chosen(names: Iterator[str], only: str) -> list[str]:
    """Return the names that contain one of the words of `only`, separated by commas; all if it is empty."""
    words = [word for word in only.split(",") if word]
    return [name for name in names if not words or any(word in name for word in words)]


def main() -> int:
    """Fuzz all parsers, or those asked for; return the exit status."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--count", type=int, default=20_000, help="inputs of each parser")
    arguments.add_argument("--only", default="", help="words of the names to run, separated by commas")
    arguments.add_argument("--seed", type=int, default=1)
    options = arguments.parse_args()
    good = True
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as folder:
        rng = random.Random(options.seed)
        found = parsers(rng, Path(folder))
        for name in chosen(iter(found), options.only):
            result = run(name, found[name](), options.count)
            good &= result.is_good
            print(
                f"{'passed' if result.is_good else 'FAILED'} {name}: {options.count} inputs, "
                f"{result.errors} exceptions, memory grew by {result.grown_mb:.1f} MB, "
                f"slowest {1e3 * result.slowest_s:.0f} ms, {result.inputs_per_s:.0f} a second",
                flush=True,
            )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
