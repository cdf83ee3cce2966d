"""Field situations of the ground station's program: its clock, its keys, and a second one beside it."""

from __future__ import annotations

import asyncio
import logging
import socket
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import redirect_stdout, suppress
from io import StringIO
from pathlib import Path
from unittest import mock

from companion.errors import InputError
from companion.mission.model import Mission, parse_mission
from companion.protocol.authenticator import Authenticator, Trust
from companion.protocol.codec import Detection, DetectionsFrame, FrameWriter, Kind, ReportFrame
from companion.protocol.keys import load_public
from companion.transport.endpoints import parse_link
from groundstation import cli
from groundstation.options import Options, run_of
from groundstation.service import run_groundstation
from tests.field.situation import Situation
from tests.ports import free_port

TEXT = """
name: shell
broadcast_period_s: 0.1
agents: [{id: 1, north_m: 0, east_m: 0}, {id: 2, north_m: 0, east_m: 5000}]
targets: [{id: 1, north_m: 20000, east_m: 0}]
threats: [{id: 1, north_m: 10000, east_m: 0, detection_radius_m: 3000, attack_radius_m: 1000, speed_bound_m_s: 0}]
"""
MOST_S = 5.0
"""Longest time for which a situation is waited for."""


class Ear:
    """A UDP port of this computer that hears the broadcast."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self.link = parse_link(f"udpout:127.0.0.1:{self._socket.getsockname()[1]}")

    def heard(self) -> list[bytes]:
        """Return what has come in since the last call."""
        found = []
        with suppress(BlockingIOError):
            while True:
                found.append(self._socket.recv(2048))
        return found


class Words(logging.Handler):
    """The lines that a ground station says."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.lines.append(record.getMessage())

    def about(self, word: str) -> str | None:
        """Return the last line with a word; None without one."""
        return next((line for line in reversed(self.lines) if word in line), None)


def run_until(done: Callable[[Words], bool], *runs: tuple[Mission, Options]) -> Words:
    """Run ground stations until something holds, and return what they said; raises what ends one of them."""
    words = Words()
    logger = logging.getLogger("groundstation")
    logger.addHandler(words)

    async def together() -> None:
        stop = asyncio.Event()
        tasks = []
        for mission, options in runs:
            tasks.append(asyncio.create_task(run_groundstation(mission, options, stop)))
            await asyncio.sleep(0.05)
        ends_s = asyncio.get_running_loop().time() + MOST_S
        while not done(words) and asyncio.get_running_loop().time() < ends_s and not any(task.done() for task in tasks):
            await asyncio.sleep(0.02)
        stop.set()
        await asyncio.gather(*tasks)

    try:
        with mock.patch.object(sys, "stdin", None), redirect_stdout(StringIO()):
            asyncio.run(together())
    finally:
        logger.removeHandler(words)
    return words


def keys_in(folder: Path) -> Path:
    """Make the keys of a fleet by the program's own command."""
    keys = folder / "keys"
    with mock.patch.object(sys, "argv", ["groundstation", "keygen", str(keys)]), redirect_stdout(StringIO()):
        with suppress(SystemExit):
            cli.main()
    return keys


def mission(lines: str = "") -> Mission:
    return parse_mission(TEXT + lines, "shell")


def after_a_change_of_clocks(wall_s: float, boottime_s: float) -> tuple[int, Words]:
    """Return how many frames a vehicle accepts after clocks of the ground station's computer moved on, and the words.

    The vehicle has the ground station's time, before and after.
    """
    ear, moved = Ear(), [0.0, 0.0]
    true_time, true_gettime = time.time, time.clock_gettime
    accepted = [0, 0]

    def gettime(clock: int) -> float:
        return true_gettime(clock) + (moved[1] if clock == time.CLOCK_BOOTTIME else 0.0)

    with (
        tempfile.TemporaryDirectory() as folder,
        mock.patch.object(time, "time", lambda: true_time() + moved[0]),
        mock.patch.object(time, "clock_gettime", gettime),
    ):
        keys = keys_in(Path(folder))
        vehicle = Authenticator(Trust(public_key=load_public(keys / "broadcast.public")))
        began_s = time.monotonic()

        def done(_: Words) -> bool:
            phase = int(moved[0] != 0.0)
            accepted[phase] += sum(len(vehicle.admit(raw, time.time())) for raw in ear.heard())
            if not phase and accepted[0] >= 2:
                moved[:] = [wall_s, boottime_s]
            return accepted[1] >= 3 or time.monotonic() - began_s > 3.0

        words = run_until(done, (mission(), Options(ear.link, "ed25519", keys)))
    assert accepted[0] >= 2
    return accepted[1], words


def a_laptop_slept() -> str:
    accepted, words = after_a_change_of_clocks(312.0, 312.0)
    line = words.about("slept")
    assert accepted >= 3
    assert line is not None and "312 s" in line
    return f'heard again at once; "{line}"'


def the_clock_is_set_back() -> str:
    accepted, words = after_a_change_of_clocks(-0.9, 0.0)
    line = words.about("clock was set")
    assert line is not None and "0.9 s back" in line
    assert accepted >= 3
    return f'heard again at once; "{line}"'


def a_second_station_on_one_computer() -> str:
    ear = Ear()
    with tempfile.TemporaryDirectory() as folder:
        options = Options(ear.link, "unsigned", state=Path(folder) / "ground.state")
        began_s = time.monotonic()
        try:
            run_until(lambda _: time.monotonic() - began_s > 1.5, (mission(), options), (mission(), options))
        except InputError as error:
            assert "another ground station runs" in str(error)
            return "the second is refused in one line"
    raise AssertionError("both run")


def a_second_station_on_the_air() -> str:
    link = parse_link(f"mcast:239.255.145.71:{free_port()}@127.0.0.1")
    with tempfile.TemporaryDirectory() as folder:
        keys = keys_in(Path(folder))
        copy = Path(folder) / "copy"
        copy.mkdir(mode=0o700)
        for path in keys.iterdir():
            (copy / path.name).write_bytes(path.read_bytes())
            (copy / path.name).chmod(path.stat().st_mode & 0o777)
        found = "another ground station broadcasts with this key"
        began_s = time.monotonic()
        words = run_until(
            lambda words: words.about(found) is not None or time.monotonic() - began_s > 3.0,
            (mission(), Options(link, "both", keys)),
            (mission(), Options(link, "both", copy)),
        )
    line = words.about(found)
    assert line is not None
    return f'"{line}"'


def arguments(**given: object) -> dict[str, object]:
    """Return the arguments of `groundstation run` as they are if nothing is given."""
    nothing = ("keys", "auth", "radio", "share", "state", "log", "mirror", "sensor", "uplink", "listen")
    values: dict[str, object] = dict.fromkeys(nothing)
    values.update(mission="copter-demo", link="udpout:127.0.0.1:9", unsigned=True, autopilot="kinematic", seed=1)
    values.update(dict.fromkeys(("ui", "ui_tokens", "ui_cert", "ui_key", "ui_client_ca", "ui_tiles")))
    values.update(log_mb=1_000.0, store_mb=1_000.0, new_flight=False, log_format="text")
    values.update(sensor_error=30.0, unsigned_inputs=False, source=())
    return {**values, **given}


def a_sensors_link_that_anybody_can_send_to() -> str:
    try:
        run_of(arguments(sensor="udpin:0.0.0.0:14601"))  # type: ignore[arg-type]
    except InputError as error:
        assert "--unsigned-inputs" in str(error)
        run_of(arguments(sensor="udpin:127.0.0.1:14601"))  # type: ignore[arg-type]
        return f'"{error}"'
    raise AssertionError("it runs")


def an_unsigned_sighting_from_the_network() -> str:
    ear, port = Ear(), free_port()
    seen = DetectionsFrame(int(time.time()), 0, 47.0, 8.0, (Detection(Kind.AGENT, 1, 20.0, 0.0, 0.0, 0.0),))
    datagram = FrameWriter(254, 191).encode(seen)
    return _unsigned_from_the_network(ear, port, datagram, "sensor", mission())


def an_unsigned_report_from_the_network() -> str:
    ear, port = Ear(), free_port()
    frame = ReportFrame(int(time.time()), 0, 1, 47.0001, 8.0, 0.0, 0.0, 10.0)
    given = mission("case: II\nreport_period_s: 10\n")
    return _unsigned_from_the_network(ear, port, FrameWriter(1, 191).encode(frame), "uplink", given)


def _unsigned_from_the_network(ear: Ear, port: int, datagram: bytes, name: str, given: Mission) -> str:
    """Send a datagram to an input of a ground station with keys that hears other computers; return what it said."""
    sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    began_s = time.monotonic()

    def done(words: Words) -> bool:
        sender.sendto(datagram, ("127.0.0.1", port))
        return words.about("refused: unsigned") is not None or time.monotonic() - began_s > 1.5

    with tempfile.TemporaryDirectory() as folder:
        link = parse_link(f"udpin:0.0.0.0:{port}")
        keys = keys_in(Path(folder))
        options = (
            Options(ear.link, "both", keys, sensor=link)
            if name == "sensor"
            else Options(ear.link, "both", keys, uplink=link)
        )
        line = run_until(done, (given, options)).about("refused: unsigned")
    assert line is not None
    return f'"{line}"'


SITUATIONS = (
    Situation(
        "the ground station's laptop sleeps for 312 s",
        "it says so, and the vehicles hear it again at once",
        "every frame refused as stamped too long ago, for good and in silence",
        a_laptop_slept,
    ),
    Situation(
        "the clock of the ground station's computer is set back by 0.9 s",
        "it says so, and the vehicles hear it again at once",
        "in silence: stamps keep the old time",
        the_clock_is_set_back,
    ),
    Situation(
        "a second ground station is started with the same state on one computer",
        "it is refused in one line",
        "both broadcast, and one overwrites the other's state",
        a_second_station_on_one_computer,
    ),
    Situation(
        "a second ground station with a copy of the keys broadcasts on the same multicast group",
        "both say so, and which epoch is older",
        "in silence: vehicles hear one of them only",
        a_second_station_on_the_air,
    ),
    Situation(
        "the sensor's link listens on every interface and there are no keys",
        "refused in one line; on 127.0.0.1, or by its word, it runs",
        "anybody on the network moves threats",
        a_sensors_link_that_anybody_can_send_to,
    ),
    Situation(
        "an unsigned sighting comes in from the network where there are keys",
        "it is refused, counted and said",
        "believed",
        an_unsigned_sighting_from_the_network,
    ),
    Situation(
        "an unsigned report comes in from the network where there are keys",
        "it is refused, counted and said",
        "believed",
        an_unsigned_report_from_the_network,
    ),
)
