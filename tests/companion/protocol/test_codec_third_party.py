"""Everybody's tools read the broadcast: from a log, and from the dialect's XML alone."""

from __future__ import annotations

import json
import math
import os
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import pytest

from companion.files.tlog import TlogWriter
from companion.protocol.codec import (
    GROUND_COMPONENT,
    GROUND_SYSTEM,
    AgentEntry,
    AgentMotion,
    BandEntry,
    BandsFrame,
    Directive,
    FleetFrame,
    FrameWriter,
    Grid,
    MissionFrame,
    MotionFrame,
    PointMotion,
    RadiiEntry,
    RadiiFrame,
    Stamp,
    StateFrame,
    TargetEntry,
    ThreatEntry,
    ThreatPlace,
)
from companion.protocol.dialect import oneway
from companion.protocol.dialect.__main__ import FOLDER

LIMIT_S = 60
NAMES = ["ONEWAY_STATE", "ONEWAY_MOTION", "ONEWAY_BANDS", "ONEWAY_FLEET", "ONEWAY_RADII", "ONEWAY_MISSION"]
STAMP = Stamp(1_790_000_000, 12_345, 7, 0, 1)
STATE = StateFrame(
    stamp=STAMP,
    origin_lat_deg=47.1234567,
    origin_lon_deg=-8.7654321,
    directive=Directive.RETURN,
    revision=3,
    picture_threats=4,
    picture_targets=5,
    resolution_cm=458,
    agents=tuple(
        AgentEntry(1_000 + k, 150_000.0 - 997.0 * k, -120_000.0 + 991.0 * k, 2_000 + k % 5) for k in range(10)
    ),
    targets=tuple(TargetEntry(2_000 + k, 90_000.0 + 983.0 * k, -60_000.0 + 977.0 * k) for k in range(5)),
    threats=tuple(
        ThreatEntry(3_000 + k, 30_000.0 - 971.0 * k, 50_000.0 + 967.0 * k, 10_000.0, 5_000.0, 10.0 + k)
        for k in range(4)
    ),
)
MOTION = MotionFrame(
    stamp=STAMP,
    agents=tuple(AgentMotion(1_000 + k, math.radians(30.0 * k), 60.0 - k, 0.1 * k) for k in range(10)),
    targets=tuple(PointMotion(2_000 + k, -1.0 * k, 2.0 * k, 100.0 * k) for k in range(5)),
    threats=tuple(PointMotion(3_000 + k, 9.0 - k, -9.0, 0.5) for k in range(4)),
)
BANDS = BandsFrame(STAMP, tuple(BandEntry(3_000 + k, None if k == 1 else -5.0 * k, 900.0 + k) for k in range(4)))
FLEET = FleetFrame(
    stamp=STAMP,
    directive=Directive.HOLD,
    revision=3,
    grid=Grid(305, 0, 0),
    agents=tuple(AgentEntry(k, 400.0 * k, 390.0 * k, 1 + k % 5) for k in range(1, 31)),
    targets=tuple(TargetEntry(k, 9_000.0 + k, 6_000.0 - k) for k in range(1, 6)),
    threats=tuple(ThreatPlace(k, 3_000.0 * k, 5_000.0 * k, 0.7 * k) for k in range(1, 5)),
)
RADII = RadiiFrame(STAMP, 3, 16, tuple(RadiiEntry(k, 10_000.0, 5_000.0 + k, 10.0, None, 900.0) for k in range(1, 5)))
MISSION = MissionFrame(
    STAMP,
    3,
    47.1234567,
    -8.7654321,
    512.3,
    100.0,
    300.0,
    bytes(range(8)),
    30,
    5,
    4,
    "thirty over the hills",
    bytes(range(8)),
)
FRAMES = (STATE, MOTION, BANDS, FLEET, RADII, MISSION)
SIGNATURE = bytes(range(192, 256))

MAVSDK_READER = """
import json, os, sys, threading
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.mavlink_direct_server import MavlinkDirectServer

xml, names, *datagrams = json.load(sys.stdin)
got, done = [], threading.Event()

def take(message, *_):
    got.append([message.system_id, message.component_id, json.loads(message.fields_json)])
    done.set()

mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER))
mavsdk.add_any_connection("raw://")
server = MavlinkDirectServer(mavsdk.server_component(0))
server.load_custom_xml(xml)
for name in names:
    server.subscribe_message(name, take)
for datagram in datagrams:
    done.clear()
    mavsdk.pass_received_raw_bytes(bytes.fromhex(datagram))
    if not done.wait(20):
        break
print("GOT " + json.dumps(got), flush=True)
os._exit(0)  # its threads would outlive us
"""


def datagrams() -> list[bytes]:
    """Return a frame of each message, signed where it has a field for it."""
    writer = FrameWriter()
    signed = [with_signature(writer.encode(frame)) for frame in FRAMES[:3]]
    return signed + [writer.encode(frame) for frame in FRAMES[3:]]


def with_signature(datagram: bytes) -> bytes:
    (message,) = oneway.MAVLink(None).parse_buffer(bytearray(datagram))
    message.ed25519_signature = list(SIGNATURE)
    return bytes(message.pack(oneway.MAVLink(None, srcSystem=GROUND_SYSTEM, srcComponent=GROUND_COMPONENT)))


def fields_of(datagram: bytes) -> dict[str, object]:
    (message,) = oneway.MAVLink(None).parse_buffer(bytearray(datagram))
    return {name: getattr(message, name) for name in message.fieldnames}


def broadcast_log(folder: Path) -> Path:
    path = folder / "broadcast.tlog"
    with TlogWriter(path) as log:
        for index, datagram in enumerate(datagrams() * 2):
            log.write(1_790_000_000.0 + index, datagram)
    return path


def mavlogdump(*arguments: str, environment: dict[str, str] | None = None) -> str:
    return subprocess.run(
        [sys.executable, "-m", "pymavlink.tools.mavlogdump", *arguments],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=True,
        env={**os.environ, "MAVLINK20": "1", **(environment or {})},
    ).stdout


@pytest.fixture(scope="module")
def read_by_mavsdk() -> list[tuple[int, int, dict[str, object]]]:
    """Return (system, component, fields) of each frame as MAVSDK decodes it, knowing only the XML."""
    xml = (FOLDER / "oneway.xml").read_text(encoding="utf-8")
    request = [xml, NAMES, *(datagram.hex() for datagram in datagrams())]
    done = subprocess.run(
        [sys.executable, "-c", MAVSDK_READER],
        input=json.dumps(request),
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=True,
    )
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("GOT ")]
    return [(system, component, fields) for system, component, fields in json.loads(line.removeprefix("GOT "))]


def test_mavlogdump_lists_every_frame_of_a_log_without_knowing_the_dialect(tmp_path: Path) -> None:
    dumped = mavlogdump(str(broadcast_log(tmp_path)))
    ids = {kind.msgname: kind.id for kind in oneway.mavlink_map.values()}
    for name in NAMES:
        assert dumped.count(f"UNKNOWN_{ids[name]}") == 2


def test_mavlogdump_decodes_every_field_once_it_knows_the_dialect(tmp_path: Path) -> None:
    # pymavlink finds dialects in its own package only; sitecustomize adds our folder to it, in a way any user could.
    (tmp_path / "sitecustomize.py").write_text(
        f"import pymavlink.dialects.v20 as v20\nv20.__path__.append({str(FOLDER)!r})\n", encoding="utf-8"
    )
    dumped = mavlogdump(
        "--dialect",
        "oneway",
        "--format",
        "json",
        str(broadcast_log(tmp_path)),
        environment={"PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])},
    )
    records = [json.loads(line) for line in dumped.splitlines() if line.startswith("{")]
    assert [record["meta"]["type"] for record in records] == NAMES * 2
    for record, datagram in zip(records, datagrams() * 2, strict=True):
        assert record["data"] == fields_of(datagram)


@pytest.mark.parametrize(("index", "name"), list(enumerate(NAMES)))
def test_mavsdk_decodes_every_field_from_the_xml_alone(
    read_by_mavsdk: list[tuple[int, int, dict[str, object]]], index: int, name: str
) -> None:
    assert len(read_by_mavsdk) == len(NAMES)
    system, component, fields = read_by_mavsdk[index]
    assert (system, component) == (GROUND_SYSTEM, GROUND_COMPONENT)
    assert fields.pop("message_name") == name
    fields.pop("message_id")
    assert fields == fields_of(datagrams()[index])


# tshark


def capture(folder: Path, port: int) -> Path:
    """Write a capture file (pcap, raw IPv4) of a broadcast: one UDP datagram to each frame."""
    path = folder / "broadcast.pcap"
    with path.open("wb") as file:
        file.write(struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65_535, 101))
        for index, datagram in enumerate(datagrams()):
            udp = struct.pack(">HHHH", 40_000, port, 8 + len(datagram), 0) + datagram
            addresses = bytes([10, 0, 0, 1, 239, 0, 0, 1])
            packet = struct.pack(">BBHHHBBH", 0x45, 0, 20 + len(udp), index, 0, 1, 17, 0) + addresses + udp
            file.write(struct.pack("<IIII", 1_790_000_000 + index, 0, len(packet), len(packet)) + packet)
    return path


def tshark(path: Path, *arguments: str) -> str:
    program = shutil.which("tshark")
    if program is None:
        pytest.skip("tshark is not installed")
    return subprocess.run(
        [program, "-X", f"lua_script:{FOLDER / 'oneway.lua'}", "-r", str(path), *arguments],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=True,
    ).stdout


def test_tshark_decodes_a_capture_of_the_broadcast_with_the_lua_file(tmp_path: Path) -> None:
    names = ["mavlink_proto.sysid", "mavlink_proto.compid", "mavlink_proto.msgid"]
    for name in NAMES:
        names += [f"mavlink_proto.{name}_{field}" for field in ("epoch", "sequence")]
    wanted = [part for name in names for part in ("-e", name)]
    listed = tshark(capture(tmp_path, 14_550), "-T", "fields", "-E", "separator=,", *wanted).splitlines()
    ids = {kind.msgname: kind.id for kind in oneway.mavlink_map.values()}
    assert len(listed) == len(NAMES)
    for index, line in enumerate(listed):
        system, component, number, *times = line.split(",")
        assert (int(system), int(component)) == (GROUND_SYSTEM, GROUND_COMPONENT)
        assert int(number.split()[0], 0) == ids[NAMES[index]]
        told = ["", ""] * index + [str(STAMP.epoch_s), str(STAMP.sequence)] + ["", ""] * (len(NAMES) - index - 1)
        assert times == told


def test_tshark_shows_the_fields_and_data_of_a_packed_frame_on_any_port(tmp_path: Path) -> None:
    fields = ["north_base", "east_base", "resolution", "frame_count", "size", "data_0", "data_1", "data_199"]
    wanted = [part for field in fields for part in ("-e", f"mavlink_proto.ONEWAY_FLEET_{field}")]
    path = capture(tmp_path, 14_600)
    decoded = tshark(
        path, "-d", "udp.port==14600,mavlink_proto", "-T", "fields", "-E", "separator=,", *wanted
    ).splitlines()
    sent = fields_of(datagrams()[NAMES.index("ONEWAY_FLEET")])
    data = sent["data"]
    assert isinstance(data, list)
    head = [sent[name] for name in fields[:5]]
    assert decoded[NAMES.index("ONEWAY_FLEET")].split(",") == [str(x) for x in (*head, data[0], data[1], data[199])]
