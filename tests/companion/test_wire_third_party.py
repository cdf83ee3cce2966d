"""Everybody's tools read the broadcast: from a log, and from the dialect's XML alone."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest

from companion.dialect import oneway
from companion.dialect.__main__ import FOLDER
from companion.tlog import TlogWriter
from companion.wire import (
    GROUND_COMPONENT,
    GROUND_SYSTEM,
    AgentEntry,
    AgentMotion,
    BandEntry,
    BandsFrame,
    Directive,
    FrameWriter,
    MotionFrame,
    PointMotion,
    Stamp,
    StateFrame,
    TargetEntry,
    ThreatEntry,
)

LIMIT_S = 60
NAMES = ["ONEWAY_STATE", "ONEWAY_MOTION", "ONEWAY_BANDS"]
STAMP = Stamp(1_790_000_000, 12_345, 7, 0, 1)
STATE = StateFrame(
    stamp=STAMP,
    origin_lat_deg=47.1234567,
    origin_lon_deg=-8.7654321,
    directive=Directive.RETURN,
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
SIGNATURE = bytes(range(192, 256))

MAVSDK_READER = """
import json, os, sys, threading
from mavsdk import ComponentType, Configuration, Mavsdk
from mavsdk.plugins.mavlink_direct_server import MavlinkDirectServer

xml, *datagrams = json.load(sys.stdin)
got, done = [], threading.Event()

def take(message, *_):
    got.append([message.system_id, message.component_id, json.loads(message.fields_json)])
    done.set()

mavsdk = Mavsdk(Configuration.create_with_component_type(ComponentType.COMPANION_COMPUTER))
mavsdk.add_any_connection("raw://")
server = MavlinkDirectServer(mavsdk.server_component(0))
server.load_custom_xml(xml)
for name in ("ONEWAY_STATE", "ONEWAY_MOTION", "ONEWAY_BANDS"):
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
    writer = FrameWriter()
    return [writer.encode(frame, SIGNATURE) for frame in (STATE, MOTION, BANDS)]


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
    request = [(FOLDER / "oneway.xml").read_text(encoding="utf-8"), *(datagram.hex() for datagram in datagrams())]
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
