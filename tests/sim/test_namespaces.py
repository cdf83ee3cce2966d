"""Over a real network between two network namespaces: interfaces that come and go, and programs that are killed."""

from __future__ import annotations

import asyncio
import ctypes
import os
import random
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from companion.protocol.authenticator import Trust
from companion.protocol.keys import keygen
from companion.transport import udp as udp_module
from companion.transport.endpoints import open_receiver, open_sender, parse_link

CLONE_NEWNET = 0x40000000
GROUP = "239.255.145.50:14600"


def ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True, timeout=20)


@dataclass(frozen=True)
class Network:
    """Two namespaces, each at an end of one cable: the ground station's at 10.77.0.1, the vehicles' at 10.77.0.2."""

    ground: str
    vehicles: str

    def plug_in(self) -> None:
        ip("link", "add", "cable", "netns", self.ground, "type", "veth", "peer", "cable", "netns", self.vehicles)
        for host, namespace in enumerate((self.ground, self.vehicles), start=1):
            ip("-n", namespace, "address", "add", f"10.77.0.{host}/24", "brd", "10.77.0.255", "dev", "cable")
            ip("-n", namespace, "link", "set", "cable", "up")

    def unplug(self) -> None:
        ip("-n", self.ground, "link", "delete", "cable")

    def run(self, namespace: str, body: Callable[[], Awaitable[None]]) -> None:
        """Run a coroutine in a namespace: a thread of its own, for a namespace is a thread's property."""
        failures: list[BaseException] = []

        async def within_time() -> None:
            await asyncio.wait_for(body(), 15.0)

        def enter_and_run() -> None:
            try:
                enter(namespace)
                asyncio.run(within_time())
            except BaseException as failure:
                failures.append(failure)

        thread = threading.Thread(target=enter_and_run)
        thread.start()
        thread.join()
        if failures:
            raise failures[0]


def enter(namespace: str) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    descriptor = os.open(f"/run/netns/{namespace}", os.O_RDONLY)
    try:
        if libc.setns(descriptor, CLONE_NEWNET) != 0:
            raise OSError(ctypes.get_errno(), "setns")
    finally:
        os.close(descriptor)


@pytest.fixture
def network() -> Iterator[Network]:
    if os.geteuid() != 0 or shutil.which("ip") is None:
        pytest.skip("network namespaces need root and the program ip")
    network = Network(f"ground-{os.getpid()}", f"vehicles-{os.getpid()}")
    made: list[str] = []
    try:
        try:
            for namespace in (network.ground, network.vehicles):
                ip("netns", "add", namespace)
                made.append(namespace)
                ip("-n", namespace, "link", "set", "lo", "up")
            network.plug_in()
        except subprocess.CalledProcessError as error:
            pytest.skip(f"no network namespaces here: {error.stderr.decode().strip()}")
        yield network
    finally:
        for namespace in made:
            ip("netns", "delete", namespace)


async def until(condition: Callable[[], bool], meanwhile: Callable[[], None] = lambda: None) -> None:
    for _ in range(1000):
        if condition():
            return
        meanwhile()
        await asyncio.sleep(0.01)
    raise AssertionError("it never came")


def test_a_group_is_heard_on_the_chosen_interface_alone(network: Network) -> None:
    async def body() -> None:
        heard: dict[str, list[bytes]] = {"127.0.0.1": [], "10.77.0.1": []}
        receivers = [
            await open_receiver(parse_link(f"mcast:{GROUP}@{interface}"), messages.append)
            for interface, messages in heard.items()
        ]
        for interface in heard:
            sender = await open_sender(parse_link(f"mcast:{GROUP}@{interface}"))
            sender.send(interface.encode())
            sender.close()
        await until(lambda: all(heard.values()))
        await asyncio.sleep(0.05)
        assert heard == {interface: [interface.encode()] for interface in heard}
        for receiver in receivers:
            receiver.close()

    network.run(network.ground, body)


def test_a_group_is_heard_again_after_its_interface_was_unplugged(
    network: Network, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(udp_module, "REJOIN_PERIOD_S", 0.05)

    async def body() -> None:
        heard: list[bytes] = []
        link = parse_link(f"mcast:{GROUP}@10.77.0.1")
        receiver, sender = await open_receiver(link, heard.append), await open_sender(link)
        await until(lambda: bool(heard), lambda: sender.send(b"before"))
        network.unplug()
        await until(lambda: sender.counts.failed > 0, lambda: sender.send(b"lost"))
        network.plug_in()
        await until(lambda: heard[-1] == b"after", lambda: sender.send(b"after"))
        # Once each for the membership that was lost, never for one that stood.
        assert receiver.counts.reopened == 1
        receiver.close()
        sender.close()

    network.run(network.ground, body)


REFRESH_S = 1.0
"""Of a mission this small over this radio (groundstation/schedule.py): copies of it take what else the budget holds."""
RADIO = ("--radio", "sik-57600", "--share", "0.5")
AIR = ("--loss", "0.3", "--delay", "0.05", "--jitter", "0.05", "--duplicate", "0.1", "--reorder", "0.2")
AGENTS = (1, 2)
KILLS = ("groundstation", "companion-1", "companion-2", "groundstation")
DEAF_S = Trust().ahead_s
PATIENCE_S = 60.0
JUST_THE_VEHICLE = "from sim.vehicle_service import vehicle; vehicle()"
"""`sim vehicle`, without the seconds that the plots and methods of the other `sim` commands take to load."""
MISSION = """
name: over-a-cable
agents: [{id: 1, north_m: 0, east_m: 0}, {id: 2, north_m: 0, east_m: 300}]
targets: [{id: 1, north_m: 600, east_m: 0}, {id: 2, north_m: 600, east_m: 300}]
threats: [{id: 1, north_m: 300, east_m: 900, detection_radius_m: 100, attack_radius_m: 50}]
defaults: {agent: {speed_m_s: 5, n_max: 0.25}, target: {speed_bound_m_s: 0}}
broadcast_period_s: 1
assignment_period_s: 2
arrival_radius_m: 10
separation_m: 10
"""
CONFIG = """
agent_id: {agent}
autopilot: {{kind: arducopter, link: "udpin:127.0.0.1:1454{agent}"}}
broadcast:
  link: "udpin:127.0.0.1:1460{agent}"
  trust: both
  mavlink_key: {keys}/broadcast.mavlink
  public_key: {keys}/broadcast.public
  state_file: {folder}/broadcast-{agent}.json
limits: {{speed_m_s: 5, n_max: 0.25, height_min_m: 3, height_max_m: 50}}
height_m: 8
separation_m: 10
arrival_radius_m: 10
guidance_step_s: 0.1
"""


class Program:
    """One of the programs as a process in a namespace; what it says is kept with the time at which it said it."""

    def __init__(self, namespace: str, *command: str) -> None:
        self._command = ("ip", "netns", "exec", namespace, sys.executable, *command)
        self.start()

    def start(self) -> None:
        """Start, or start again after it was killed."""
        self.said: list[tuple[float, str]] = []
        self._process = subprocess.Popen(
            self._command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1"},
        )
        self._listening = threading.Thread(target=self._listen)
        self._listening.start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self.said.append((time.monotonic(), line))

    def kill(self) -> None:
        self._process.kill()
        self._process.wait(timeout=20)
        self._listening.join(timeout=20)
        assert self._process.stdout is not None
        self._process.stdout.close()

    def said_at(self, text: str, after_s: float = 0.0) -> float:
        """Return when it first said a text after a time, waiting for it."""
        patience_ends_s = time.monotonic() + PATIENCE_S
        while True:
            for at_s, line in list(self.said):
                if at_s >= after_s and text in line:
                    return at_s
            assert self._process.poll() is None, f"ended early: {self.said}"
            assert time.monotonic() < patience_ends_s, f"never said '{text}': {self.said}"
            time.sleep(0.02)


@pytest.fixture
def programs(network: Network, tmp_path: Path) -> Iterator[dict[str, Program]]:
    """Start everything: each companion behind an air of its own, its autopilot beside it."""
    keys = tmp_path / "keys"
    keygen(keys)
    (tmp_path / "mission.yaml").write_text(MISSION)
    running: dict[str, Program] = {}
    try:
        running["groundstation"] = Program(
            network.ground, "-m", "groundstation", "run", str(tmp_path / "mission.yaml"),
            "--link", "udpbcast:10.77.0.255:14600", *RADIO,
            "--keys", str(keys), "--state", str(tmp_path / "groundstation.json"),
        )  # fmt: skip
        for agent in AGENTS:
            config = tmp_path / f"companion-{agent}.yaml"
            config.write_text(CONFIG.format(agent=agent, keys=keys, folder=tmp_path))
            running[f"air-{agent}"] = Program(
                network.vehicles, "-m", "sim.relay", "--listen", "udpbcast:10.77.0.255:14600",
                "--to", f"udpout:127.0.0.1:1460{agent}", *AIR, "--seed", str(agent),
            )  # fmt: skip
            running[f"vehicle-{agent}"] = Program(
                network.vehicles, "-c", JUST_THE_VEHICLE, "--autopilot", "arducopter", "--system-id", str(agent),
                "--connect", f"udpout:127.0.0.1:1454{agent}",
            )  # fmt: skip
            running[f"companion-{agent}"] = Program(network.vehicles, "-m", "companion", "run", str(config))
        yield running
    finally:
        for program in running.values():
            program.kill()


@pytest.mark.slow
def test_companions_are_current_again_within_refreshes_of_any_sides_sudden_death(
    programs: dict[str, Program],
) -> None:
    generator = random.Random(5)
    companions = [programs[f"companion-{agent}"] for agent in AGENTS]
    for companion in companions:
        companion.said_at("picture fresh")
    for name in generator.sample(KILLS, len(KILLS)):
        time.sleep(generator.uniform(0.0, 2.0))
        victim = programs[name]
        victim.kill()
        time.sleep(generator.uniform(0.0, 1.0))
        victim.start()
        if victim in companions:
            up_at_s = victim.said_at("companion: agent ")
            waits_s = [victim.said_at("picture fresh") - up_at_s]
        else:
            up_at_s = victim.said_at("groundstation: over-a-cable")
            waits_s = [companion.said_at("took over", up_at_s) - up_at_s for companion in companions]
        print(f"{name}: current after {', '.join(f'{wait_s:.2f}' for wait_s in waits_s)} s")
        # A companion that was killed believes nothing stamped less than DEAF_S after its start.
        assert max(waits_s) <= (DEAF_S + 3.0 * REFRESH_S if victim in companions else 2.0 * REFRESH_S)
    for companion in companions:
        _, last_status = [line for line in companion.said if "picture" in line[1]][-1]
        assert "picture fresh" in last_status
