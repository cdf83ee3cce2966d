"""Kills the programs with SIGKILL at random moments, on disks that are full, read-only, taken away or renamed.

Each run starts a program as a process of its own, lets it work on real sockets of this computer, does something to its
disk, kills it, and starts it once more. Afterwards it must hold that

- no state file is torn, and the program starts again on the disk as it then is;
- nothing that was broadcast before is believed by the companion that was started again;
- a vehicle whose companion died is left to its autopilot's own failsafe, and a PX4 does not go back to OFFBOARD;
- the ground station's next run is believed by whoever heard the one before, and keeps its directive;
- what `sim fly` wrote until then can be read.

Disks of their own need the right to mount (root): without it only the last two kinds are tried.

Run: python tests/benchmarks/kills.py --runs 200 [--programs companion groundstation sim] [--workers 2]
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

from companion.files.log_series import LEAST_FREE_BYTES
from companion.files.tlog import read_tlog
from companion.geo.local_frame import LocalFrame
from companion.onboard.config import load_config
from companion.onboard.state_files import saved_authenticator_state, saved_authority
from companion.onboard.trust import trust_of
from companion.protocol.authenticator import Authenticator, Trust
from companion.protocol.codec import AgentEntry, FrameWriter, Stamp, StateFrame, TargetEntry
from companion.protocol.ed25519 import FrameSigner
from companion.protocol.frame import raw_frame
from companion.protocol.keys import keygen, load_mavlink_key, load_private, load_public
from companion.protocol.messages import Directive
from groundstation.saved_state import state_in
from sim.faults.scene import DEMANDED
from sim.safety_pilot import SafetyPilot
from sim.vehicles import CRAFTS, Home, Setup, StandIn

DISK_BYTES = LEAST_FREE_BYTES + 4 * 2**20
DISKS = ("good", "full", "read-only", "taken away", "renamed")
KINDS = ("arducopter", "px4-copter")
STEP_S = 0.05
START_LIMIT_S = 240.0
"""Longest time that a program may take to start, many at once on a small machine."""
AFTERWARDS_S = 3.0
"""Time for which the vehicle is watched after the companion was started again."""
BRAKING_S = 6.0
"""Further time in which a vehicle whose companion died must come to stand."""
STANDS_M_S = 1.0
REPORT_RUNS = 20
"""Number of runs after which the count so far is printed."""
OFFBOARD = 6 << 16
MISSION = """
name: kills
broadcast_period_s: 0.2
agents: [{id: 1, north_m: 0, east_m: 0}]
targets: [{id: 1, north_m: 20000, east_m: 0}]
threats: [{id: 1, north_m: 10000, east_m: 0, detection_radius_m: 900, attack_radius_m: 300, speed_bound_m_s: 5}]
"""


class Disk:
    """A folder on a disk of its own, if mounting is permitted, to which something can be done."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        folder.mkdir()
        self._mounted = may_mount()
        if self._mounted:
            self._mount()

    def spoil(self, how: str) -> None:
        """Do to the disk what `how`, one of DISKS, says."""
        if how == "full":
            self._fill()
        elif how == "read-only":
            # A mount with files that are being written cannot be made read-only: a copy that is one is put over it.
            copy, read_only = self.folder.with_name("copy"), self.folder.with_name("read-only")
            shutil.copytree(self.folder, copy)
            read_only.mkdir()
            subprocess.run(["mount", "--bind", str(copy), str(read_only)], check=True)
            subprocess.run(["mount", "-o", "remount,bind,ro", str(read_only)], check=True)
            subprocess.run(["mount", "--bind", str(read_only), str(self.folder)], check=True)
        elif how == "taken away" and self._mounted:
            subprocess.run(["umount", "-l", str(self.folder)], check=True)
        elif how == "taken away":
            shutil.rmtree(self.folder)
        elif how == "renamed":
            for one in self.folder.iterdir():
                one.rename(one.with_name(f"{one.name}-gone"))

    def mend(self, how: str) -> None:
        """Let the disk work again; what is on a disk that was taken away is gone."""
        if how == "full":
            (self.folder / "filler").unlink()
        elif how == "read-only":
            subprocess.run(["mount", "-o", "remount,bind,rw", str(self.folder)], check=True)
        elif how == "taken away" and self._mounted:
            self._mount()

    def close(self) -> None:
        """Give the disk back."""
        for _ in range(2 * self._mounted):
            subprocess.run(["umount", "-l", str(self.folder)], check=False, stderr=subprocess.DEVNULL)

    def _mount(self) -> None:
        size = f"size={DISK_BYTES}"
        subprocess.run(["mount", "-t", "tmpfs", "-o", size, "tmpfs", str(self.folder)], check=True)

    def _fill(self) -> None:
        with suppress(OSError), (self.folder / "filler").open("wb", buffering=0) as file:
            while True:
                file.write(bytes(4096))


def may_mount() -> bool:
    """Return whether this process has mounts of its own (see `main`)."""
    return os.environ.get("KILLS_MAY_MOUNT") == "1"


def disks() -> tuple[str, ...]:
    """Return what can be done to a disk here."""
    return DISKS if may_mount() else ("good", "taken away", "renamed")


@dataclass
class Checks:
    """What must hold of one run, and did not."""

    faults: list[str] = field(default_factory=list, kw_only=True)

    def expect(self, holds: bool, otherwise: str) -> None:
        """Note a fault unless something holds."""
        if not holds:
            self.faults.append(otherwise)


@dataclass
class Run(Checks):
    """What one run saw."""

    program: str
    disk: str
    moment: str


class Child:
    """A program as a process, with its output in a file."""

    processes: ClassVar[list[subprocess.Popen[bytes]]] = []
    """Every process that was started, so that none outlives its run."""

    def __init__(self, output: Path, *arguments: str) -> None:
        self._output = output
        with output.open("ab") as file:
            self._process = subprocess.Popen(
                [sys.executable, "-m", *arguments],
                stdin=subprocess.PIPE,
                stdout=file,
                stderr=file,
                # As systemd gives it: in memory, over restarts.
                env={**os.environ, "RUNTIME_DIRECTORY": str(output.parent / "memory")},
            )

        self.processes.append(self._process)

    @classmethod
    def end_all(cls) -> None:
        """Kill every process that is left."""
        while cls.processes:
            with suppress(ProcessLookupError):
                cls.processes.pop().kill()

    @property
    def said(self) -> str:
        """All that it and those before it said."""
        return self._output.read_text(errors="replace")

    @property
    def has_ended(self) -> bool:
        """Whether it ended by itself."""
        return self._process.poll() is not None

    @property
    def processor_s(self) -> float:
        """Processor time that it has used."""
        fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Let it stand still for a while: what is done to its disk then is done at one moment."""
        self._process.send_signal(signal.SIGSTOP)
        try:
            yield
        finally:
            self._process.send_signal(signal.SIGCONT)

    def order(self, line: str) -> None:
        """Give it a line on its standard input."""
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.write(f"{line}\n".encode())
            self._process.stdin.flush()

    def end(self, how: signal.Signals = signal.SIGKILL) -> None:
        """End it, and wait until it is gone."""
        self._process.send_signal(how)
        self._process.wait(30.0)
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()


class World:
    """A stand-in on real sockets and the real clock, its safety pilot, and a signed broadcast."""

    def __init__(self, kind: str, keys: Path, ports: tuple[int, int]) -> None:
        self._vehicle = StandIn(
            CRAFTS[kind],
            Setup(
                1, LocalFrame(47.0, 8.0), altitude_m=530.0, home=Home(0.0, 0.0, 500.0), in_air=True, armed=True,
                start_s=time.time(),
            ),
        )  # fmt: skip
        self._vehicle.parameters.update(DEMANDED[kind])
        self._pilot = SafetyPilot(kind, 1)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.setblocking(False)
        self._autopilot, self._broadcast = (("127.0.0.1", port) for port in ports)
        self._signer = FrameSigner(load_private(keys / "broadcast.private"), None)
        self._writer = FrameWriter()
        self._epoch_s, self._sequence, self._next_s = int(time.time()), 0, 0.0
        self._began_s = time.monotonic()
        self.sent: list[bytes] = []
        """Every frame of the broadcast."""
        self.modes: list[int] = []

    @property
    def guided(self) -> bool:
        """Whether the vehicle obeys the companion."""
        return self._vehicle.mode == self._pilot.guided_mode

    @property
    def speed_m_s(self) -> float:
        """Speed over the ground."""
        return self._vehicle.truth.speed_m_s

    @property
    def height_m(self) -> float:
        """Height above home."""
        return self._vehicle.truth.altitude_m - 500.0

    def go_on(
        self, until: Callable[[], bool], limit_s: float, broadcasts: bool = True, hands_over: bool = True
    ) -> bool:
        """Let time pass until something holds, or for `limit_s`; return whether it holds."""
        ends_s = time.monotonic() + limit_s
        while not until():
            if time.monotonic() > ends_s:
                return False
            self._step(broadcasts, hands_over)
            time.sleep(STEP_S)
        return True

    def replay(self) -> None:
        """Send all that was broadcast once more."""
        for frame in self.sent:
            self._socket.sendto(frame, self._broadcast)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _step(self, broadcasts: bool, hands_over: bool) -> None:
        now_s, vehicle = time.time(), self._vehicle
        replies: list[bytes] = []
        with suppress(BlockingIOError, ConnectionRefusedError):
            while True:
                replies += vehicle.receive(self._socket.recv(65_536), now_s)
        vehicle.step_to(now_s)
        if hands_over:
            for order in self._pilot.orders(time.monotonic() - self._began_s, vehicle.mode):
                replies += vehicle.receive(order, now_s)
        for frame in [*vehicle.telemetry(now_s), *replies]:
            with suppress(ConnectionRefusedError):
                self._socket.sendto(frame, self._autopilot)
        self.modes.append(vehicle.mode)
        if broadcasts and now_s >= self._next_s:
            self._next_s = now_s + 0.2
            self._sequence += 1
            stamp = Stamp(self._epoch_s, round(1e3 * (now_s - self._epoch_s)), self._sequence)
            agents, targets = (AgentEntry(1, 0.0, 0.0, 1),), (TargetEntry(1, 20_000.0, 0.0),)
            state = StateFrame(stamp, 47.0, 8.0, Directive.NORMAL, 1, 0, 1, 100, agents, targets, ())
            self.sent.append(self._signer.sign(self._writer.encode(state), now_s))
            with suppress(ConnectionRefusedError):
                self._socket.sendto(self.sent[-1], self._broadcast)


def free_ports(count: int) -> tuple[int, ...]:
    """Return UDP ports that were free a moment ago."""
    sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(count)]
    for one in sockets:
        one.bind(("127.0.0.1", 0))
    ports = tuple(int(one.getsockname()[1]) for one in sockets)
    for one in sockets:
        one.close()
    return ports


def kill_companion(seed: int, folder: Path) -> Run:
    """Fly a vehicle, spoil the disk, kill the companion, start it again, and watch."""
    drawn = random.Random(seed)
    kind, how, mended = drawn.choice(KINDS), drawn.choice(disks()), drawn.random() < 0.5
    disk, keys = Disk(folder / "disk"), folder / "keys"
    keygen(keys)
    autopilot, broadcast = free_ports(2)
    config = folder / "companion.yaml"
    config.write_text(
        f"agent_id: 1\nautopilot: {{kind: {kind}, link: 'udpin:127.0.0.1:{autopilot}', "
        f"{'offboard: direct, ' * (kind == 'px4-copter')}state_file: {disk.folder}/state/autopilot.json}}\n"
        f"broadcast: {{link: 'udpin:127.0.0.1:{broadcast}', trust: ed25519, public_key: {keys}/broadcast.public, "
        f"state_file: {disk.folder}/state/broadcast.json}}\n"
        f"limits: {{speed_m_s: 5, n_max: 0.2, height_min_m: 3, height_max_m: 60}}\nheight_m: 30\n"
        f"log_dir: {disk.folder}/logs\n",
        encoding="utf-8",
    )
    world = World(kind, keys, (autopilot, broadcast))
    in_flight = drawn.random() < 0.7
    run = Run("companion", f"{how}{', mended' * (mended and how != 'good')}", "in flight" if in_flight else "starting")
    program = Child(folder / "out.txt", "companion", "run", str(config))
    if in_flight:
        if not world.go_on(lambda: "target 1 (" in program.said or program.has_ended, START_LIMIT_S):
            # A stand-in that stood still on a busy machine jumps, and is then loitered with until handed over again.
            run.moment = "in flight, to no target"
        world.go_on(lambda: False, drawn.uniform(0.0, 1.5))
    else:
        world.go_on(lambda: False, drawn.uniform(0.0, 2.0))
    with program.paused():
        disk.spoil(how)
    world.go_on(lambda: False, drawn.uniform(0.0, 1.5))
    run.expect(not program.has_ended, "it ended by itself")
    program.end()
    _companion_after(run, world, disk, how if mended else "", Again(config, folder / "again.txt", how))
    world.close()
    disk.close()
    return run


@dataclass(frozen=True)
class Again:
    """How the companion is started again."""

    config: Path
    output: Path
    spoilt: str


def _companion_after(run: Run, world: World, disk: Disk, mend: str, again: Again) -> None:
    had_it = world.guided
    # The autopilot's own failsafe acts within some seconds, and the vehicle then brakes.
    world.go_on(lambda: False, AFTERWARDS_S, broadcasts=False, hands_over=False)
    world.go_on(lambda: world.speed_m_s < STANDS_M_S, BRAKING_S, broadcasts=False, hands_over=False)
    run.expect(world.height_m > 20.0, f"{world.height_m:.0f} m high after its death")
    run.expect(world.speed_m_s < STANDS_M_S, f"{world.speed_m_s:.1f} m/s after its death")
    left = not world.guided
    if mend:
        disk.mend(mend)
    _look_at_state(run, again.config, world)
    world.modes.clear()
    program = Child(again.output, "companion", "run", str(again.config))
    started = world.go_on(
        lambda: "agent 1, " in program.said or program.has_ended, START_LIMIT_S, broadcasts=False, hands_over=False
    )
    run.expect(started and not program.has_ended, f"not started again: {program.said[-300:]}")
    for _ in range(3):
        world.replay()
        world.go_on(lambda: False, AFTERWARDS_S / 3, broadcasts=False, hands_over=False)
    run.expect("picture fresh" not in program.said, "an old broadcast was believed")
    if had_it and left:
        run.expect(OFFBOARD not in world.modes, "it went back to OFFBOARD by itself")
    program.end()


def _look_at_state(run: Run, path: Path, world: World) -> None:
    """Read the state files as the next companion does; nothing that was broadcast may be accepted again."""
    config = load_config(str(path))
    assert config.autopilot is not None and config.broadcast is not None
    saved, authority = saved_authenticator_state(config.broadcast), saved_authority(config.autopilot)
    torn = [one for one in (*saved.warnings, *authority.warnings) if "not readable" in one or "not a state" in one]
    run.expect(not torn, f"torn: {torn}")
    authenticator = Authenticator(trust_of(config.broadcast), saved.state)
    believed = sum(len(authenticator.admit(frame, time.time())) for frame in world.sent)
    run.expect(believed == 0, f"{believed} of {len(world.sent)} old frames would be believed")


def believer(keys: Path) -> Authenticator:
    """Return what a vehicle believes a broadcast by, with keys that `keygen` made."""
    public = load_public(keys / "broadcast.public")
    return Authenticator(Trust(mavlink_key=load_mavlink_key(keys / "broadcast.mavlink"), public_key=public))


def kill_groundstation(seed: int, folder: Path) -> Run:
    """Broadcast, order, spoil the disk, kill the ground station, start it again, and hear what it says."""
    drawn = random.Random(seed)
    how, mended, orders = drawn.choice(disks()), drawn.random() < 0.5, drawn.random() < 0.6
    disk, keys = Disk(folder / "disk"), folder / "keys"
    keygen(keys)
    (folder / "mission.yaml").write_text(MISSION, encoding="utf-8")
    ear = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ear.bind(("127.0.0.1", 0))
    state = disk.folder / "ground.state"
    arguments = (
        "groundstation", "run", str(folder / "mission.yaml"), "--link", f"udpout:127.0.0.1:{ear.getsockname()[1]}",
        "--keys", str(keys), "--state", str(state), "--log", str(disk.folder / "ground.tlog"),
    )  # fmt: skip
    run = Run("groundstation", f"{how}{', mended' * (mended and how != 'good')}", "ordering" if orders else "telling")
    vehicle = believer(keys)
    program = Child(folder / "out.txt", *arguments)
    before = _heard(ear, vehicle, START_LIMIT_S, 1) + _heard(ear, vehicle, drawn.uniform(0.0, 1.0))
    if orders:
        # On disk before it is on the air, unless the disk is spoilt first.
        program.order("hold")
        before += _heard(ear, vehicle, drawn.uniform(0.0, 0.7))
    with program.paused():
        disk.spoil(how)
    before += _heard(ear, vehicle, drawn.uniform(0.0, 1.5))
    run.expect(not program.has_ended, f"it ended by itself: {program.said[-300:]}")
    program.end()
    before += _heard(ear, vehicle, 0.1)
    if mended:
        disk.mend(how)
    if state.exists():
        state_in(state)
    program = Child(folder / "again.txt", *arguments)
    after = _heard(ear, vehicle, START_LIMIT_S, 2)
    run.expect(len(after) >= 2, f"not believed after it was started again: {program.said[-300:]}; {vehicle.rejected}")
    kept = how == "good" or (
        (how == "full" or how == "read-only") and "cannot write" not in (folder / "out.txt").read_text()
    )
    if kept and Directive.HOLD in before and after:
        run.expect(set(after) == {Directive.HOLD}, "the directive was forgotten")
    program.end()
    ear.close()
    disk.close()
    return run


def _heard(ear: socket.socket, vehicle: Authenticator, limit_s: float, most: int | None = None) -> list[Directive]:
    """Return the directives of the broadcasts that a vehicle believes within a time, at most so many."""
    heard: list[Directive] = []
    ends_s = time.monotonic() + limit_s
    while (left_s := ends_s - time.monotonic()) > 0.0 and (most is None or len(heard) < most):
        ear.settimeout(min(left_s, 0.1))
        with suppress(TimeoutError):
            for one in vehicle.admit(ear.recv(65_536), time.time()):
                if isinstance(one.frame, StateFrame):
                    heard.append(one.frame.directive)
    return heard


def kill_sim(seed: int, folder: Path) -> Run:
    """Kill `sim fly` while it writes, and read what it left."""
    drawn = random.Random(seed)
    how = drawn.choice(disks())
    disk = Disk(folder / "disk")
    out = disk.folder / "out"
    run = Run("sim", how, "flying")
    program = Child(folder / "out.txt", "sim", "fly", "copter-demo", "--seed", str(seed % 1_000), "--out", str(out))
    began_s = time.monotonic()
    while not (out / "broadcast.tlog").exists() and time.monotonic() - began_s < START_LIMIT_S:
        time.sleep(0.05)
    time.sleep(drawn.uniform(0.0, 2.5))
    with program.paused():
        disk.spoil(how)
    time.sleep(drawn.uniform(0.0, 1.5))
    with suppress(ProcessLookupError):
        program.end()
    run.expect("Traceback" not in program.said, program.said[-300:])
    if how == "taken away":
        disk.close()
        return run
    left = next((one for one in (out, out.with_name("out-gone")) if one.exists()), None)
    for path in () if left is None else left.glob("*.tlog"):
        log = read_tlog(path)
        frames = [raw_frame(frame) for _, frame in log] if path.stat().st_size >= 64 else []
        run.expect(log.places <= 1, f"{path.name}: {len(frames)} frames, {log.words}")
    table = None if left is None else left / "trajectory.csv"
    if table is not None and table.exists():
        rows = table.read_text().split("\n")[:-1]
        run.expect(all(row.count(",") == rows[0].count(",") for row in rows), "a torn row in the middle")
    disk.close()
    return run


PROGRAMS: dict[str, Callable[[int, Path], Run]] = {
    "companion": kill_companion,
    "groundstation": kill_groundstation,
    "sim": kill_sim,
}


def one_run(program: str, seed: int) -> Run:
    """Play one run in a folder of its own; an exception is a fault of it."""
    folder = Path(tempfile.mkdtemp(prefix="kills-"))
    os.environ["RUNTIME_DIRECTORY"] = str(folder / "memory")
    try:
        return PROGRAMS[program](seed, folder)
    except Exception as error:  # noqa: BLE001 every other run is of interest, too
        return Run(program, "?", "?", faults=[f"{type(error).__name__}: {error}"])
    finally:
        Child.end_all()
        for name in ("disk", "disk", "read-only") * may_mount():
            subprocess.run(["umount", "-l", str(folder / name)], check=False, stderr=subprocess.DEVNULL)
        shutil.rmtree(folder, ignore_errors=True)


def main() -> int:
    """Run it; the exit status is 1 if any run had a fault."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=200, help="of each program")
    parser.add_argument("--programs", nargs="+", choices=tuple(PROGRAMS), default=list(PROGRAMS))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    unshare = ["unshare", "--mount", "--propagation", "private"]
    if not may_mount() and subprocess.run([*unshare, "true"], check=False, stderr=subprocess.DEVNULL).returncode == 0:
        # In a mount namespace of its own, so that nothing that is mounted here outlives it or is seen by others.
        command: Sequence[str] = [*unshare, sys.executable, __file__, *sys.argv[1:]]
        return subprocess.run(command, check=False, env={**os.environ, "KILLS_MAY_MOUNT": "1"}).returncode
    faulty = 0
    for program in given.programs:
        runs: list[Run] = []
        with ProcessPoolExecutor(given.workers) as pool:
            tasks = [pool.submit(one_run, program, given.seed + number) for number in range(given.runs)]
            for number, task in enumerate(tasks, 1):
                run = task.result()
                runs.append(run)
                for fault in run.faults:
                    words = " ".join(fault.split())
                    print(f"FAULT {run.program}, disk {run.disk}, {run.moment}: {words}", flush=True)
                if number % REPORT_RUNS == 0:
                    print(
                        f"{program}: {number} killed, {sum(bool(one.faults) for one in runs)} with a fault", flush=True
                    )
        kinds = Counter(f"{run.disk}, {run.moment}" for run in runs)
        bad = sum(bool(run.faults) for run in runs)
        faulty += bad
        print(f"{program}: {len(runs)} killed, {bad or 'none'} with a fault", flush=True)
        for name, count in sorted(kinds.items()):
            print(f"  {count:4d} disk {name}", flush=True)
    return 1 if faulty else 0


if __name__ == "__main__":
    sys.exit(main())
