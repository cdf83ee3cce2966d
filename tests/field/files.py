"""Situations of disks that are full, read-only or gone, of damaged files, and of what stands in them."""

from __future__ import annotations

import asyncio
import io
import os
import shutil
import socket
import sqlite3
import struct
import threading
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

from click.testing import CliRunner
from pymavlink.dialects.v20 import common as mavlink

from companion.cli import cli
from companion.errors import InputError
from companion.files.state import read_state_file, write_state_file
from companion.files.tlog import TlogWriter, read_tlog
from companion.mission.model import parse_mission
from companion.onboard.companion import Companion
from companion.onboard.config import Config, dump_config, parse_config
from companion.onboard.flight_log import FlightLog
from companion.onboard.recording import RecordedCompanion
from companion.onboard.service import run_companion
from companion.onboard.state_files import AuthenticatorStateFile
from companion.protocol.authenticator import Authenticator, Trust
from companion.protocol.codec import Directive, FrameWriter, Stamp, StateFrame
from companion.protocol.frame import raw_frames
from companion.protocol.keys import keygen
from companion.protocol.mavlink_signing import MavlinkSigner
from companion.protocol.v2_extension import wrap
from companion.runtime.clock import SteadyClock
from companion.runtime.io_thread import IoThread
from companion.transport.endpoints import parse_link
from groundstation.options import Options
from groundstation.service import run_groundstation
from tests.field.situation import Situation

EPOCH_S = 1_790_000_000
MISSION = """
name: files
broadcast_period_s: 0.1
agents: [{id: 1, north_m: 0, east_m: 0}]
targets: [{id: 1, north_m: 20000, east_m: 0}]
"""


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


def config_of(kind: str = "arducopter", autopilot: str = "", more: str = "") -> Config:
    text = (
        f"agent_id: 1\nautopilot: {{kind: {kind}, link: 'udpin:127.0.0.1:{free_port()}'{autopilot}}}\n"
        f"broadcast: {{link: 'udpin:127.0.0.1:{free_port()}', trust: unsigned}}\n"
        "limits: {speed_m_s: 5, n_max: 0.2, height_min_m: 3, height_max_m: 60}\nheight_m: 30\n"
    )
    return parse_config(text + more, "files.yaml")


def run_for(config: Config, seconds: float, meanwhile: Callable[[float], object] = lambda t_s: None) -> None:
    """Run a companion for a time; raises InputError if it does not start.

    `meanwhile` is called with the time so far, and ends the run by the answer True.
    """

    async def body() -> None:
        stop, began_s = asyncio.Event(), time.monotonic()
        running = asyncio.create_task(run_companion(config, stop))
        while (t_s := time.monotonic() - began_s) < seconds and not running.done():
            if meanwhile(t_s) is True:
                break
            await asyncio.sleep(0.05)
        stop.set()
        await running

    asyncio.run(body())


def no_logs_at_the_start() -> str:
    with TemporaryDirectory() as folder:
        (Path(folder) / "disk").write_text("a file, where a folder should be")
        run_for(config_of(more=f"log_dir: {folder}/disk/logs\n"), 0.3)
    return "runs without logs, and says so"


def no_state_at_the_start() -> str:
    with TemporaryDirectory() as folder:
        # A folder in the place of the fresh file: nothing can be written there.
        (Path(folder) / "px4.json.new").mkdir()
        state = f", offboard: direct, state_file: {folder}/px4.json"
        run_for(config_of("px4-copter", state), 0.3)
    return "runs, and a PX4 that flies counts as locked"


def logs_taken_away() -> str:
    with TemporaryDirectory() as folder:
        logs = Path(folder) / "logs"

        removed_at_s: list[float] = []

        def take_away(t_s: float) -> bool:
            logged = any(path.stat().st_size for path in logs.glob("*/vehicle-1.tlog"))
            if removed_at_s:
                return logged
            if logged:
                removed_at_s.append(t_s)
                shutil.rmtree(logs)
            return False

        # A busy computer begins late; the run ends as soon as there is a log again.
        run_for(config_of(more=f"log_dir: {logs}\n"), 10.0, take_away)
        assert removed_at_s, "nothing was logged"
        found = [path for path in logs.glob("*/vehicle-1.tlog") if path.stat().st_size]
        assert found, "nothing was logged any more"
    return "logged again in a new folder"


def old_logs_fill_the_disk() -> str:
    with TemporaryDirectory() as folder:
        old = Path(folder) / "logs" / "20200101T000000Z" / "vehicle-1.tlog"
        old.parent.mkdir(parents=True)
        with old.open("wb") as file:
            file.truncate(5_000_000_000)
        run_for(config_of(more=f"log_dir: {folder}/logs\n"), 0.4)
        assert not old.exists(), "5 GB of an old flight are still there"
    return "the oldest logs made room"


def frames(count: int) -> list[bytes]:
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    made = []
    for number in range(count):
        mav.seq = number % 256
        made.append(bytes(mav.attitude_encode(number, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6).pack(mav)))
    return made


RECORDS = [(EPOCH_S + 0.25 * number, frame) for number, frame in enumerate(frames(40))]


def content(records: list[tuple[float, bytes]] = RECORDS) -> bytes:
    file = io.BytesIO()
    with TlogWriter(file) as log:
        for t_unix_s, frame in records:
            log.write(t_unix_s, frame)
    return file.getvalue()


STARTS = [len(content(RECORDS[:number])) for number in range(len(RECORDS) + 1)]


def read_back(data: bytes) -> list[tuple[float, bytes]]:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "damaged.tlog"
        path.write_bytes(data)
        return list(read_tlog(path))


def zeros_at_the_start() -> str:
    assert read_back(bytes(4096) + content()) == RECORDS
    return "40 of 40 records"


def half_a_record_in_the_middle() -> str:
    torn = content()[: STARTS[20] + 17] + content()[STARTS[20] :]
    assert read_back(torn) == RECORDS
    return "40 of 40 records"


def a_block_is_lost() -> str:
    data = content()
    got = read_back(data[: STARTS[10] + 5] + bytes(300) + data[STARTS[10] + 305 :])
    assert set(got) < set(RECORDS) and len(got) >= 31, f"{len(got)} records"
    return f"{len(got)} of 40 records, none of them wrong"


def a_damaged_length() -> str:
    data = bytearray(content())
    data[STARTS[20] + 9] = STARTS[23] - STARTS[20] - 20
    got = read_back(bytes(data))
    assert got == RECORDS[:20] + RECORDS[21:], f"{len(got)} records"
    return "39 of 40 records, none of them wrong"


def an_absurd_time() -> str:
    data = bytearray(content())
    data[STARTS[20] : STARTS[20] + 8] = struct.pack(">Q", 2**62)
    got = read_back(bytes(data))
    assert all(abs(t_s - EPOCH_S) < 60.0 for t_s, _ in got), "a time in the year 148 000"
    return "its time is that of the record before"


def a_log_with_a_hole_is_replayed() -> str:
    config = config_of()
    with TemporaryDirectory() as folder:
        path = Path(folder) / "vehicle-1.tlog"
        log = FlightLog(TlogWriter(path))
        flight = RecordedCompanion(Companion(config), SteadyClock(), log)
        mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        heartbeat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, 3, 81, 4, 4, 3)
        for number in range(20):
            flight.receive(list(raw_frames(bytes(heartbeat.pack(mav)))))
            flight.decide(flight.clock.now_s() + 0.1 * number)
        log.close()
        data = path.read_bytes()
        half = len(data) // 2
        path.write_bytes(data[:half] + bytes(200) + data[half:])
        (Path(folder) / "companion-1.yaml").write_text(dump_config(config))
        result = CliRunner().invoke(cli, ["replay", str(path)], standalone_mode=False)
        assert result.exception is None, str(result.exception)
    last = result.stdout.strip().splitlines()[-1]
    assert last.startswith(("19 decisions", "20 decisions")), last
    return last


def a_pipe_for_a_state() -> str:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "broadcast.json"
        os.mkfifo(path)
        said: list[str] = []

        def read() -> None:
            try:
                read_state_file(path)
            except InputError as error:
                said.append(str(error))

        thread = threading.Thread(target=read, daemon=True)
        thread.start()
        thread.join(0.5)
        hung = thread.is_alive()
        if hung:
            # So that the thread ends.
            path.open("wb").close()
        assert not hung, "waits for ever"
    return said[0].partition(": ")[2]


def a_link_for_a_fresh_state() -> str:
    with TemporaryDirectory() as folder:
        victim = Path(folder) / "victim"
        victim.write_text("precious")
        (Path(folder) / "broadcast.json.new").symlink_to(victim)
        write_state_file(Path(folder) / "broadcast.json", "{}")
        assert victim.read_text() == "precious", "written through the link"
    return "the link is replaced, what it points to is left"


def one_failed_write() -> str:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "broadcast.json"
        files, authenticator = IoThread("files"), Authenticator(Trust())
        state_file = AuthenticatorStateFile(str(path), authenticator, files)
        in_the_way = Path(f"{path}.new")
        in_the_way.mkdir()
        state = StateFrame(Stamp(1_000, 0, 4), 47.0, 8.0, Directive.NORMAL, 1, 0, 0, 100, (), (), ())
        authenticator.admit(FrameWriter().encode(state), 1_000.0)
        state_file.write_if_due(1_000.0)
        time.sleep(0.2)
        in_the_way.rmdir()
        for second in range(1, 4):
            time.sleep(0.45)
            state_file.write_if_due(1_000.0 + 2.0 * second)
        files.close()
        assert path.exists(), "never written again"
        assert '"sequence": 4' in path.read_text()
    return "written a second later"


def kept_in(state: Path) -> list[tuple[str, str]]:
    with closing(sqlite3.connect(f"file:{state}?mode=ro", uri=True)) as store:
        return store.execute("SELECT name, value FROM kept ORDER BY name").fetchall()


def one_failed_write_on_the_ground() -> str:
    with TemporaryDirectory() as folder:
        keys, state = Path(folder) / "keys", Path(folder) / "ground.state"
        keygen(keys)
        options = Options(parse_link(f"udpout:127.0.0.1:{free_port()}"), "both", keys, state=state)

        async def body() -> None:
            stop = asyncio.Event()
            running = asyncio.create_task(run_groundstation(parse_mission(MISSION, "files"), options, stop))
            while not state.exists() and not running.done():
                await asyncio.sleep(0.05)
            # Another program has the store for longer than a write waits for it.
            with closing(sqlite3.connect(state, isolation_level=None)) as other:
                other.execute("BEGIN IMMEDIATE")
                await asyncio.sleep(2.4)
                spoilt = kept_in(state)
            await asyncio.sleep(2.3)
            written = kept_in(state) != spoilt
            stop.set()
            await running
            assert written, "never written again"

        asyncio.run(body())
    return "written again"


def logged(frame: bytes) -> bytes:
    file = io.BytesIO()
    FlightLog(TlogWriter(file)).record(1.0, frame)
    return file.getvalue()


def a_wrapped_signature() -> str:
    mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=1)
    heartbeat = bytes(mavlink.MAVLink_heartbeat_message(6, 8, 0, 7, 4, 3).pack(mav))
    signed = MavlinkSigner(bytes(range(32)), 0).sign(heartbeat, 1.8e9)
    for frame in (signed, wrap(signed, 0), wrap(wrap(signed, 0), 1)):
        assert signed[-6:] not in logged(frame), "the signature stands in the log"
    return "no signature at any depth"


def a_wrapped_key() -> str:
    mav = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    key = list(range(1, 33))
    setup = bytes(mavlink.MAVLink_setup_signing_message(1, 1, key, 1).pack(mav))
    assert bytes(key) not in logged(wrap(setup, 0)), "the key stands in the log"
    return "left out"


SITUATIONS = (
    Situation(
        "the disk for logs takes nothing when the companion is started",
        "it flies without logs and says so",
        "ends: log_dir cannot be used",
        no_logs_at_the_start,
    ),
    Situation(
        "the disk for the state takes nothing when a PX4's companion is started",
        "it runs, and does not take the vehicle out of a person's hands",
        "ends: cannot write the state",
        no_state_at_the_start,
    ),
    Situation(
        "the folder of the logs is removed in flight",
        "logs go on in a new one",
        "nothing is logged any more, without a word",
        logs_taken_away,
    ),
    Situation(
        "logs of old flights take 5 GB",
        "the oldest make room",
        "they stay until the disk is full",
        old_logs_fill_the_disk,
    ),
    Situation(
        "4096 zeros at the start of a log", "all its records are read", "not a MAVLink frame", zeros_at_the_start
    ),
    Situation(
        "half a record in the middle of a log, where a program died",
        "all other records are read",
        "ends: not a MAVLink frame",
        half_a_record_in_the_middle,
    ),
    Situation(
        "a block of a log is zeros", "what is before and behind it is read", "not a MAVLink frame", a_block_is_lost
    ),
    Situation(
        "the length of one record is damaged and reaches to a later one",
        "that record is left out",
        "38 records, one of three in one",
        a_damaged_length,
    ),
    Situation(
        "the time of one record is damaged",
        "the time of its neighbour",
        "a time in the year 148 000",
        an_absurd_time,
    ),
    Situation(
        "a flight's log with a hole is replayed",
        "decided again up to it and beyond it, with what was left out",
        "ends: not a MAVLink frame",
        a_log_with_a_hole_is_replayed,
    ),
    Situation("a pipe stands in the place of a state file", "refused by name", "waits for ever", a_pipe_for_a_state),
    Situation(
        "a link stands where a state is written before it gets its name",
        "nothing is written through it",
        "the file that it points to is overwritten",
        a_link_for_a_fresh_state,
    ),
    Situation(
        "one write of the state of the broadcast fails",
        "tried again until it is on disk",
        "never written again without a new broadcast",
        one_failed_write,
    ),
    Situation(
        "one write of the ground station's state fails",
        "tried again until it is on disk",
        "never written again",
        one_failed_write_on_the_ground,
    ),
    Situation(
        "a signed frame comes wrapped in V2_EXTENSION, once and twice",
        "its signature is in no log",
        "the signature stands in the log",
        a_wrapped_signature,
    ),
    Situation(
        "SETUP_SIGNING comes wrapped in V2_EXTENSION",
        "its key is in no log",
        "the key stands in the log",
        a_wrapped_key,
    ),
)
