"""How soon setpoints end when a person takes over, and how even they leave, while the broadcast link is flooded.

    python -m tests.benchmarks.takeover [--before TREE] [--kinds px4-copter ...] [--runs 10] [--rate 20000]

`companion run`, the sender of the flood and a process that keeps a core busy share one core; the stand-in autopilot,
the ground station and this script have the others. In each run a person hands the vehicle over, waits for a random
time and takes it back; the latency is the time from the HEARTBEAT that tells the new mode until the last setpoint that
follows it, 0 if none does. `--before` flies another checkout of the companion in the same minutes, turn by turn.
`--connect` flies a vehicle that is there already, armed, in the air and in a mode that holds it: a program of an
autopilot that sends to that UDP port.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import random
import selectors
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common as mavlink

from companion.files.mavlink_layout import MARKER_V2
from companion.protocol.codec import GROUND_COMPONENT, GROUND_SYSTEM
from companion.protocol.frame import BROADCAST_IDS, ED25519_BYTES, raw_frames
from companion.protocol.keys import keygen, load_mavlink_key
from companion.protocol.mavlink_signing import MavlinkSigner
from sim.mavlink_sender import MavlinkSender
from tests.benchmarks.loop import HERE, MISSION, SPEEDS_M_S, Between, said, start
from tests.companion.protocol.hostile import Ground, forged_seal
from tests.ports import free_ports

ROOT = Path(__file__).parents[2]
KINDS = ("arducopter", "arduplane", "px4-copter", "px4-copter/direct", "px4-plane")
"""What is flown; px4-copter alone goes through MAVSDK."""
FLOODS = ("starts", "junk", "forged", "keyed")
"""Beginnings of frames, whose checksums are all reckoned, the costliest without a key; random bytes; newer frames with
a right checksum and a wrong hash; the same with the fleet's own shared key."""
START = bytes((MARKER_V2, 255, 0, 0, 0, GROUND_SYSTEM, GROUND_COMPONENT)) + min(BROADCAST_IDS).to_bytes(3, "little")
STARTS = 42 * START
"""Beginnings of the longest frame of the broadcast, one upon the other."""
WATCHED_S = 6.0
"""Time after a take-over in which a setpoint still counts: more than the longest latency ever seen."""
LONG_GAP_S = 0.3
TOLD = ("stood still", "was busy", "flooded", "setpoint gaps", "slots at most")
"""What of the companion's own words is shown with `--said`."""
CAUGHT_UP_S = 0.1
"""Time up to which the sender of the flood catches up with its rate."""
PATIENCE_S = 60.0
"""Longest time for which anything is waited for."""
SO_TIMESTAMPNS = 35
"""Socket option of asm-generic/socket.h that the standard library lacks: tells when a datagram came."""
SETTLED_S = 1.0
"""Time after a hand-over from which gaps between setpoints count."""
REPEAT_S = 1.5
"""Time after which an order is given again: PX4 shows a mode up to a second late."""
PINNED = """
import os, sys
os.sched_setaffinity(0, {%d})
os.nice(%d)
os.execv(sys.executable, [sys.executable, *sys.argv[1:]])
"""
STAND_IN = "from sim.vehicle_service import vehicle; vehicle()"
"""`sim vehicle`, without what the other `sim` commands load."""
TEMPLATES = 2048
GUIDED = {"arducopter": (4, 0), "arduplane": (15, 0), "px4-copter": (6, 0), "px4-plane": (6, 0)}
"""Main and sub mode of the mode in which each kind obeys its companion."""
HOLDING = {"arducopter": (17, 0), "arduplane": (12, 0), "px4-copter": (4, 3), "px4-plane": (4, 3)}
"""Main and sub mode in which it holds: BRAKE, LOITER, and HOLD."""
CONFIG = """
agent_id: 1
autopilot: {{kind: {kind}, link: "udpin:{here}:{autopilot}", state_file: {folder}/engaged.json{more}}}
broadcast:
  link: "udpin:{here}:{broadcast}"
  trust: both
  mavlink_key: {folder}/keys/broadcast.mavlink
  public_key: {folder}/keys/broadcast.public
  state_file: {folder}/broadcast.json
limits: {{speed_m_s: {speed}, n_max: 0.17, range_m: 50000, height_min_m: 3, height_max_m: 200}}
height_m: 30
separation_m: 15
arrival_radius_m: 30
log_dir: {folder}/logs
"""


@dataclass
class Seen:
    """What was seen of one kind, of one checkout."""

    latencies_s: list[float] = field(default_factory=list)
    gaps_s: list[float] = field(default_factory=list)
    """Gaps between setpoints while the vehicle was handed over."""
    sent_per_s: list[float] = field(default_factory=list)
    cpu_shares: list[float] = field(default_factory=list)
    """Share of a core that the companion used in each flood."""
    said: list[str] = field(default_factory=list)
    """What the companions said of stalls and floods, and at their end."""

    def add(self, other: Seen) -> None:
        """Add what was seen in another flight."""
        self.latencies_s += other.latencies_s
        self.gaps_s += other.gaps_s
        self.sent_per_s += other.sent_per_s
        self.cpu_shares += other.cpu_shares
        self.said += other.said

    @property
    def words(self) -> str:
        """The figures as one line."""
        latencies_ms, gaps_ms = 1e3 * np.array(self.latencies_s), 1e3 * np.array(self.gaps_s)
        if not len(latencies_ms) or not len(gaps_ms):
            return "never steered"
        p50, p99 = np.percentile(latencies_ms, [50.0, 99.0])
        gap50, gap99 = np.percentile(gaps_ms, [50.0, 99.0])
        return (
            f"{len(latencies_ms)} take-overs: setpoints end after {p50:.0f} ms (median), {p99:.0f} ms (99 %), at most "
            f"{latencies_ms.max():.0f} ms; {len(gaps_ms)} gaps: {gap50:.0f} ms, {gap99:.0f} ms, at most "
            f"{gaps_ms.max():.0f} ms, {int(np.sum(gaps_ms > 1e3 * LONG_GAP_S))} over {LONG_GAP_S:g} s; "
            f"{np.mean(self.sent_per_s):.0f} hostile datagrams/s; the companion used "
            f"{100.0 * np.mean(self.cpu_shares):.0f} % of its core"
        )


class Stamped(socket.socket):
    """A UDP socket that knows when the kernel took in what it read last, and tells when it sends.

    The program may be held up before it reads, or between looking at a frame and passing it on.
    """

    arrived_s = 0.0
    """By the monotonic clock."""
    on_send: Callable[[float], None]
    """Takes the time of each datagram, just before it is sent."""

    def __init__(self) -> None:
        super().__init__(socket.AF_INET, socket.SOCK_DGRAM)
        self.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self.setblocking(False)

    def recv(self, size: int, flags: int = 0) -> bytes:
        """Read a datagram."""
        datagram, ancillary, _, _ = self.recvmsg(size, 64, flags)
        seconds, nanoseconds = struct.unpack_from("=qq", ancillary[0][2])
        self.arrived_s = seconds + 1e-9 * nanoseconds - time.time() + time.monotonic()
        return datagram

    def send(self, data: Any, flags: int = 0) -> int:  # noqa: ANN401 - as the base class takes it
        """Send a datagram."""
        self.on_send(time.monotonic())
        return super().send(data, flags)


class Watched(Between):
    """Passes datagrams between companion and vehicle, and notes setpoints, modes and where the vehicle is."""

    def __init__(self, companion_port: int, safety_pilot_port: int, connect: str | None) -> None:
        """Wait for the vehicle on a port of its own, or on that of `connect`, udpin:HOST:PORT."""
        super().__init__(companion_port, safety_pilot_port)
        self._selector.unregister(self.companion)
        self.companion.close()
        self.companion: Stamped = Stamped()
        self.companion.connect((HERE, companion_port))
        self._selector.register(self.companion, selectors.EVENT_READ)
        self.companion.on_send = self._send_at
        self._new_mode: int | None = None
        """Mode that the HEARTBEAT tells which is passed on next, if it is a new one."""
        self.modes: list[tuple[float, int]] = []
        """Each change of mode, with the time at which its HEARTBEAT was passed on."""
        self.place_deg: tuple[float, float] | None = None
        self._person = MavlinkSender(255, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._connected = connect is not None
        if connect is not None:
            host, port = connect.removeprefix("udpin:").split(":")
            self._selector.unregister(self.vehicle)
            self.vehicle.close()
            self.vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self.vehicle.bind((host, int(port)))
            self.vehicle.setblocking(False)
            self._selector.register(self.vehicle, selectors.EVENT_READ)

    def close(self) -> None:
        """Close all sockets."""
        for one in (self.vehicle, self.companion, self.safety_pilot):
            one.close()

    def order(self, mode: tuple[int, int]) -> None:
        """Have the person order a mode, and say that a ground-control program is there."""
        heartbeat = self._person.mav.heartbeat_encode(
            mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE
        )
        command = self._person.mav.command_long_encode(
            1, mavlink.MAV_COMP_ID_AUTOPILOT1, mavlink.MAV_CMD_DO_SET_MODE, 0,
            mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, *map(float, mode), 0.0, 0.0, 0.0, 0.0,
        )  # fmt: skip
        for message in (heartbeat, command):
            frame = self._person.pack(message)
            with suppress(OSError):
                if not self._connected:
                    self.safety_pilot.send(frame)
                elif self.vehicle_address is not None:
                    self.vehicle.sendto(frame, self.vehicle_address)

    def _note_setpoints(self, datagram: bytes) -> None:
        # This script may come to read it late: the kernel's time counts.
        count = len(self.setpoints_s)
        super()._note_setpoints(datagram)
        self.setpoints_s[count:] = [self.companion.arrived_s] * (len(self.setpoints_s) - count)

    def _send_at(self, now_s: float) -> None:
        if self._new_mode is not None:
            self.modes.append((now_s, self._new_mode))
            self._new_mode = None

    def _note_mode(self, datagram: bytes) -> None:
        for frame in raw_frames(datagram):
            if frame.version != 2 or frame.component != 1:
                continue
            if frame.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                mode = int.from_bytes(frame.payload[:4].ljust(4, b"\0"), "little")
                self._new_mode = mode if mode != self.custom_mode else None
                self.custom_mode = mode
            elif frame.message_id == mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
                lat_e7, lon_e7 = (int.from_bytes(frame.payload[at : at + 4], "little", signed=True) for at in (4, 8))
                self.place_deg = lat_e7 / 1e7, lon_e7 / 1e7


def flood(port: int, rate: float, kind: str, key: Path, core: int, sent: Synchronized[int]) -> None:
    """Send hostile datagrams to a port, in a process of its own, until it is ended."""
    os.sched_setaffinity(0, {core})
    rng = random.Random(1)
    ground = Ground("both", rng, epoch_s=int(time.time()))
    signer = MavlinkSigner(load_mavlink_key(key) if kind == "keyed" else rng.randbytes(32), 0)

    def forged() -> bytes:
        raw = ground.unsealed(time.time() + 1.0, rng.randrange(1 << 31, 1 << 32))
        return signer.sign(forged_seal(raw, rng.randbytes(ED25519_BYTES)), time.time())

    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.connect((HERE, port))
    makes = {"starts": lambda: STARTS, "junk": lambda: rng.randbytes(rng.randrange(20, 280))}
    templates = [makes.get(kind, forged)() for _ in range(TEMPLATES)]
    due_s, renewed = time.monotonic(), 0
    while True:
        # What is due goes out in small bursts, as from any sender that sleeps between; what was slept through does not.
        due_s = max(due_s, time.monotonic() - CAUGHT_UP_S)
        while due_s < time.monotonic():
            due_s += 1.0 / rate
            with suppress(OSError):
                sock.send(templates[sent.value % TEMPLATES])
            sent.value += 1
        # A stamp may be 2 s ahead and 30 s old: old ones would be refused for that, which costs less.
        if kind not in makes:
            templates[renewed % TEMPLATES], renewed = forged(), renewed + 1
        time.sleep(0.001)


def keep_busy(core: int) -> None:
    """Keep a core busy, in a process of its own, until it is ended."""
    os.sched_setaffinity(0, {core})
    while True:
        pass


class Hostile:
    """The sender of the flood and the processes that keep the companion's core busy."""

    def __init__(self, port: int, folder: Path, options: argparse.Namespace) -> None:
        """Start them; they stand still until `flooding`."""
        context, core = multiprocessing.get_context("fork"), options.core
        self._sent: Synchronized[int] = context.Value("q", 0, lock=False)
        self._flooded_s = 0.0
        key = folder / "keys" / "broadcast.mavlink"
        sends = port, options.rate, options.flood, key, core, self._sent
        self._jobs = [context.Process(target=flood, args=sends, daemon=True)]
        self._jobs += [context.Process(target=keep_busy, args=(core,), daemon=True) for _ in range(options.busy)]
        for job in self._jobs:
            job.start()
        self._tell(signal.SIGSTOP)

    @contextmanager
    def flooding(self) -> Iterator[None]:
        """Flood the link, and keep the core busy, meanwhile."""
        began_s = time.monotonic()
        self._tell(signal.SIGCONT)
        try:
            yield
        finally:
            self._tell(signal.SIGSTOP)
            self._flooded_s += time.monotonic() - began_s

    @property
    def sent_per_s(self) -> float:
        """Mean rate of the flood."""
        return self._sent.value / self._flooded_s

    def close(self) -> None:
        """End them."""
        for job in self._jobs:
            job.kill()
            job.join()

    def _tell(self, number: signal.Signals) -> None:
        for job in self._jobs:
            os.kill(job.pid or 0, number)


@dataclass(frozen=True)
class Companion:
    """A companion that runs, and its surroundings."""

    kind: str
    folder: Path
    process: subprocess.Popen[bytes]
    broadcast_port: int

    @property
    def cpu_s(self) -> float:
        """The processor time that it has used, without that of MAVSDK's processes."""
        text = Path(f"/proc/{self.process.pid}/stat").read_text()
        return sum(map(int, text.rsplit(")", 1)[1].split()[11:13])) / os.sysconf("SC_CLK_TCK")

    @property
    def guided(self) -> int:
        """The custom_mode in which its autopilot obeys it."""
        main, _ = GUIDED[self.kind]
        return main << 16 if self.kind.startswith("px4") else main


def core_of_companion() -> int:
    """Return the core that the companion shares with the flood and the busy process."""
    return max(os.sched_getaffinity(0))


def fly(kind: str, tree: Path, options: argparse.Namespace, runs: int) -> Seen:
    """Fly one kind with the companion of a checkout; return what was seen."""
    name, _, offboard = kind.partition("/")
    companion_port, broadcast, pilot, sensor = free_ports(4)
    watched = Watched(companion_port, pilot, options.connect)
    running: list[subprocess.Popen[bytes]] = []
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        keygen(folder / "keys")
        more = (", clear: signal" if name.startswith("px4") else "") + (f", offboard: {offboard}" if offboard else "")
        fields = {"kind": name, "here": HERE, "autopilot": companion_port, "broadcast": broadcast, "more": more}
        (folder / "c.yaml").write_text(CONFIG.format(**fields, speed=SPEEDS_M_S[name], folder=folder))
        try:
            if options.connect is None:
                running.append(start_vehicle(name, folder, watched.port, pilot))
            until(watched, lambda: watched.place_deg is not None, folder, "the autopilot's position")
            lat_deg, lon_deg = watched.place_deg or (0.0, 0.0)
            origin = f"origin: {{lat_deg: {lat_deg}, lon_deg: {lon_deg}}}\n"
            (folder / "mission.yaml").write_text(MISSION + origin)
            running.append(
                start(
                    folder / "ground.txt", "-m", "groundstation", "run", str(folder / "mission.yaml"),
                    "--keys", str(folder / "keys"), "--state", str(folder / "ground.json"),
                    "--link", f"udpout:{HERE}:{broadcast}", "--sensor", f"udpin:{HERE}:{sensor}",
                )
            )  # fmt: skip
            running.append(start_companion(tree, folder, options))
            return judge(watched, Companion(name, folder, running[-1], broadcast), options, runs)
        finally:
            watched.close()
            for process in running:
                process.kill()
                process.wait()


def start_vehicle(name: str, folder: Path, port: int, pilot: int) -> subprocess.Popen[bytes]:
    """Start a stand-in autopilot in the air, with a link to the companion and one to the person."""
    return start(
        folder / "vehicle.txt", "-c", STAND_IN, "--autopilot", name, "--in-air", "30",
        "--connect", f"udpout:{HERE}:{port}", "--connect", f"udpin:{HERE}:{pilot}",
    )  # fmt: skip


def start_companion(tree: Path, folder: Path, options: argparse.Namespace) -> subprocess.Popen[bytes]:
    """Start the companion of a checkout on its core."""
    launcher = PINNED % (options.core, options.nice)
    with (folder / "companion.txt").open("ab") as file:
        return subprocess.Popen(
            [sys.executable, "-c", launcher, "-m", "companion", "run", str(folder / "c.yaml")],
            cwd=tree,
            stdout=file,
            stderr=subprocess.STDOUT,
            env={**os.environ, "PYTHONUNBUFFERED": "1", "PYTHONPATH": str(tree)},
        )


def until(watched: Watched, condition: Callable[[], bool], folder: Path, awaited: str) -> None:
    """Pass datagrams on until a condition holds; end the program with what the companion said if it never does."""
    ends_s = time.monotonic() + PATIENCE_S
    while not condition():
        watched.pass_on(time.monotonic() + 0.05)
        if time.monotonic() > ends_s:
            text = said(folder) if (folder / "companion.txt").exists() else ""
            raise SystemExit(f"{awaited} never came: {text}")


def judge(watched: Watched, companion: Companion, options: argparse.Namespace, runs: int) -> Seen:
    """Hand the vehicle over and take it back; return what was seen. The flood begins when the vehicle is steered."""
    rng, seen = random.Random(options.seed), Seen()
    hostile = Hostile(companion.broadcast_port, companion.folder, options)
    try:
        for _ in range(runs):
            hand_over(watched, companion)
            cpu_s, began_s = companion.cpu_s, time.monotonic()
            with hostile.flooding():
                steady_s = time.monotonic() + SETTLED_S
                watched.pass_on(steady_s + rng.uniform(0.5, 2.5))
                taken_s = take_over(watched, companion)
                watched.pass_on(taken_s + WATCHED_S)
            seen.cpu_shares.append((companion.cpu_s - cpu_s) / (time.monotonic() - began_s))
            seen.latencies_s.append(max(0.0, watched.setpoints_s[-1] - taken_s))
            seen.gaps_s += gaps_s(watched.setpoints_s, steady_s, taken_s)
        seen.sent_per_s.append(hostile.sent_per_s)
    finally:
        hostile.close()
    companion.process.send_signal(signal.SIGINT)
    companion.process.wait(PATIENCE_S)
    told = said(companion.folder).splitlines()
    seen.said += [line for line in told if any(word in line for word in TOLD)]
    return seen


def gaps_s(setpoints_s: list[float], steady_s: float, taken_s: float) -> list[float]:
    """Return the gaps between setpoints from when the vehicle was steered until it was taken over.

    That from the last one until then counts too, if it is long.
    """
    before_s = [time_s for time_s in setpoints_s if time_s <= taken_s]
    since = max(0, sum(time_s < steady_s for time_s in before_s) - 1)
    gaps = np.diff(before_s[since:]).tolist()
    last_s = taken_s - before_s[-1]
    return [*gaps, last_s] if last_s > LONG_GAP_S else gaps


def hand_over(watched: Watched, companion: Companion) -> None:
    """Have the person hand the vehicle over, and wait until it is steered."""
    if companion.kind.startswith("px4") and companion.guided in [mode for _, mode in watched.modes]:
        # What a take-over locked is cleared by the person's signal; then "hold here" is streamed, and OFFBOARD obeyed.
        companion.process.send_signal(signal.SIGUSR1)
    ordered_s = -math.inf
    count = len(watched.modes)

    def steered() -> bool:
        nonlocal ordered_s
        if time.monotonic() - ordered_s > REPEAT_S:
            ordered_s = time.monotonic()
            watched.order(GUIDED[companion.kind])
        guided = [at_s for at_s, mode in watched.modes[count:] if mode == companion.guided]
        return bool(guided and watched.setpoints_s and watched.setpoints_s[-1] > guided[-1])

    until(watched, steered, companion.folder, "a setpoint")


def take_over(watched: Watched, companion: Companion) -> float:
    """Have the person take the vehicle; return when the HEARTBEAT that tells the new mode was passed on."""
    count, ordered_s = len(watched.modes), -math.inf

    def taken() -> bool:
        nonlocal ordered_s
        if time.monotonic() - ordered_s > REPEAT_S:
            ordered_s = time.monotonic()
            watched.order(HOLDING[companion.kind])
        return len(watched.modes) > count

    until(watched, taken, companion.folder, "the new mode")
    return watched.modes[count][0]


def main() -> None:
    """Fly every kind with every checkout, in turns, and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, metavar="TREE", help="another checkout of this project")
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS, metavar="KIND")
    parser.add_argument("--runs", type=int, default=10, help="take-overs of each kind and checkout")
    parser.add_argument("--turns", type=int, default=1, help="flights of each kind and checkout, which share the runs")
    parser.add_argument("--rate", type=float, default=20_000.0, help="hostile datagrams per second")
    parser.add_argument("--flood", choices=FLOODS, default="starts")
    parser.add_argument("--busy", type=int, default=1, help="processes that keep the companion's core busy")
    parser.add_argument("--nice", type=int, default=0, help="of the companion; the unit's is -10, which needs root")
    parser.add_argument("--connect", metavar="udpin:HOST:PORT", help="a vehicle that is there already")
    parser.add_argument("--said", action="store_true", help="show what the companions said of it")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    others = os.sched_getaffinity(0) - {core_of_companion()}
    options.core = core_of_companion()
    os.sched_setaffinity(0, others or {options.core})
    trees = ([("before", options.before.resolve())] if options.before else []) + [("now", ROOT)]
    print(
        f"{options.flood} flood, {options.rate:g} datagrams/s on the broadcast link; companion (nice {options.nice}), "
        f"sender and {options.busy} busy on core {options.core}, all else on {sorted(others)}; "
        f"load {os.getloadavg()[0]:.1f}",
        flush=True,
    )
    for kind in options.kinds:
        seen = {name: Seen() for name, _ in trees}
        for _ in range(options.turns):
            for name, tree in trees:
                seen[name].add(fly(kind, tree, options, max(1, options.runs // options.turns)))
        for name, one in seen.items():
            print(f"{kind}, {name}: {one.words}", flush=True)
            if options.said:
                print("\n".join(f"    {line}" for line in one.said), flush=True)


if __name__ == "__main__":
    main()
