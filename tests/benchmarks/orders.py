"""Kills the ground station with SIGKILL at random moments while commands are under way, and starts it again.

Each run gives commands through the API as fast as they are answered, kills the program at a random moment, starts it
again with the same store, goes on, and kills it once more. Afterwards it must hold that

- every event that was acknowledged is in the store, as it was acknowledged, and their numbers rise;
- no vehicle heard of another target for which the store has no `assigned` event with a reason, before it was heard;
- epochs rise, and the vehicle believes each run;
- a restart is heard within RESTART_S of the kill, with ids, pins and things as the events say.

Run: python -m tests.benchmarks.orders --runs 25 [--workers 2]
"""

from __future__ import annotations

import argparse
import http.client
import json
import random
import shutil
import socket
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import Any, NamedTuple

from companion.mission.model import parse_mission
from companion.mission.resolve import resolve
from companion.protocol.keys import keygen
from companion.protocol.messages import Directive, StateFrame
from groundstation.events import event_from_json
from groundstation.operations import folded
from groundstation.store.database import Database
from groundstation.store.rows import EventRow
from tests.benchmarks.kills import Checks, Child, believer, free_ports

RESTART_S = 2.0
"""Longest time from a kill to the first broadcast that is believed again, on a computer that does nothing else."""
START_LIMIT_S = 60.0
ANSWER_S = 15.0
MISSION = """
name: orders
broadcast_period_s: 0.2
assignment_period_s: 1
agents:
  - {id: 1, north_m: 0, east_m: 0}
  - {id: 2, north_m: 0, east_m: 4000}
  - {id: 3, north_m: 0, east_m: 8000}
  - {id: 4, north_m: 0, east_m: 12000}
targets: [{id: 1, north_m: 30000, east_m: 0}, {id: 2, north_m: 30000, east_m: 6000}]
threats:
  - {id: 1, north_m: 15000, east_m: 3000, detection_radius_m: 900, attack_radius_m: 300, speed_bound_m_s: 0}
  - {id: 2, north_m: 15000, east_m: 9000, detection_radius_m: 900, attack_radius_m: 300, speed_bound_m_s: 0}
"""

Json = dict[str, Any]


class Restart(NamedTuple):
    """How long it took after a kill until a broadcast was believed again."""

    took_s: float
    busy_s: float
    """Time for which the program used the processor."""


@dataclass
class Orders(Checks):
    """What one run saw."""

    acknowledged: int = 0
    """Number of events that were acknowledged."""
    restart: Restart | None = None


class Heard(NamedTuple):
    """A state frame that a vehicle believed."""

    at_s: float
    """Time at which it was heard, by the steady clock."""
    frame: StateFrame


class Ear:
    """A vehicle's end of the broadcast, which believes what is signed and new."""

    def __init__(self, keys: Path) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.02)
        self._vehicle = believer(keys)
        self.heard: list[Heard] = []

    @property
    def port(self) -> int:
        """The port that is listened on."""
        return int(self._socket.getsockname()[1])

    def listen(self, limit_s: float, epoch_after: int = -1) -> bool:
        """Take in frames for a time, or until one of an epoch later than `epoch_after`; return whether one came."""
        ends_s = time.monotonic() + limit_s
        while time.monotonic() < ends_s:
            with suppress(TimeoutError):
                for one in self._vehicle.admit(self._socket.recv(65_536), time.time()):
                    if isinstance(one.frame, StateFrame):
                        self.heard.append(Heard(time.monotonic(), one.frame))
                        if 0 <= epoch_after < one.frame.stamp.epoch_s:
                            return True
        return False

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class Operator(threading.Thread):
    """Gives commands one after the other until it is told to stop, and keeps the events that it was answered with."""

    def __init__(self, port: int, seed: int) -> None:
        super().__init__(daemon=True)
        self._address = f"http://127.0.0.1:{port}/api/v1/commands"
        self._drawn = random.Random(seed)
        self._added: list[int] = []
        self.over = threading.Event()
        self.acknowledged: list[Json] = []
        self.faults: list[str] = []

    def run(self) -> None:
        """Give commands."""
        while not self.over.is_set():
            command = self._command()
            request = urllib.request.Request(
                self._address, json.dumps(command).encode(), {"content-type": "application/json"}, method="POST"
            )
            try:
                with urllib.request.urlopen(request, timeout=ANSWER_S) as answer:
                    event = json.load(answer)
            except urllib.error.HTTPError as error:
                if error.code >= 500 and error.code != 503:
                    self.faults.append(f"{error.code} at {time.monotonic():.2f} for {command}: {error.read()[:200]!r}")
                time.sleep(0.05)
                continue
            except (OSError, ValueError, http.client.HTTPException):
                # Killed, or not up yet.
                time.sleep(0.02)
                continue
            self.acknowledged.append(event)
            if event["event"] == "threat-added":
                self._added.append(event["threat"]["id"])

    def _command(self) -> Json:
        drawn = self._drawn
        place = {"north_m": drawn.uniform(5e3, 25e3), "east_m": drawn.uniform(-5e3, 15e3)}
        agent = drawn.randint(1, 4)
        what = drawn.randrange(8)
        if what == 0 and self._added:
            return {"do": "retire", "kind": "threat", "id": self._added.pop()}
        if what == 1:
            return {"do": "pin", "agent": agent, "target": drawn.choice((1, 2, None))}
        if what == 2:
            return {"do": drawn.choice(("take-out", "put-back")), "agent": agent}
        if what == 3:
            return {"do": "direct", "directive": drawn.choice(("normal", "hold")), "agent": drawn.choice((agent, None))}
        if what == 4:
            return {"do": "change", "kind": "threat", "id": drawn.randint(1, 2), **place}
        if what == 5 and self.acknowledged:
            return {"do": "undo", "number": self.acknowledged[-1]["number"]}
        return {"do": "add-threat", "radius_m": drawn.uniform(100, 900), **place}


def kill_orders(seed: int, folder: Path, restart_s: float) -> Orders:
    """Give commands, kill, start again, go on, and kill once more; then look at the store."""
    drawn = random.Random(seed)
    keys, state = folder / "keys", folder / "ground.state"
    keygen(keys)
    (folder / "mission.yaml").write_text(MISSION, encoding="utf-8")
    ear = Ear(keys)
    (port,) = free_ports(1)
    arguments = (
        "groundstation", "run", str(folder / "mission.yaml"), "--link", f"udpout:127.0.0.1:{ear.port}",
        "--keys", str(keys), "--state", str(state), "--ui", f"127.0.0.1:{port}",
    )  # fmt: skip
    run = Orders()
    program = Child(folder / "out-0.txt", *arguments)
    acknowledged: list[Json] = []
    epochs: list[int] = []
    for life in range(2):
        before = epochs[-1] if epochs else 0
        began_s = time.monotonic()
        run.expect(ear.listen(START_LIMIT_S, before), f"not heard in life {life}: {program.said[-300:]}")
        if not ear.heard:
            break
        if life:
            took_s = ear.heard[-1].at_s - began_s
            run.restart = Restart(took_s, program.processor_s)
            run.expect(took_s <= restart_s, f"heard {took_s:.1f} s after the kill")
        epochs.append(ear.heard[-1].frame.stamp.epoch_s)
        operator = Operator(port, seed + life)
        operator.start()
        if drawn.random() < 0.8:
            # Most kills come while commands are answered, the others while the page starts.
            gives_up_s = time.monotonic() + ANSWER_S
            while not operator.acknowledged and time.monotonic() < gives_up_s:
                ear.listen(0.1)
        ear.listen(drawn.uniform(0.0, 2.0))
        run.expect(not program.has_ended, f"it ended by itself: {program.said[-300:]}")
        program.end()
        killed_s = time.monotonic()
        operator.over.set()
        operator.join()
        acknowledged += operator.acknowledged
        said = [line for line in program.said.splitlines() if line.startswith("groundstation:")]
        run.faults += [f"{fault}; killed at {killed_s:.2f}; {said[-3:]}" for fault in operator.faults]
        if life == 0:
            program = Child(folder / "out-1.txt", *arguments)
    ear.close()
    run.expect(epochs == sorted(set(epochs)), f"epochs {epochs}")
    run.acknowledged = len(acknowledged)
    look_at_store(run, state, acknowledged, ear.heard)
    return run


def look_at_store(run: Orders, state: Path, acknowledged: list[Json], heard: list[Heard]) -> None:
    """Compare the store with what was acknowledged and heard."""
    database = Database.read_only(state)
    rows = list(database.events())
    database.close()
    numbers = [row.number for row in rows]
    run.expect(numbers == sorted(set(numbers)), f"numbers do not rise: {numbers}")
    stored = {row.number: event_from_json(row.body).model_dump(mode="json") for row in rows}
    lost = [event["number"] for event in acknowledged if stored.get(event["number"]) != event]
    run.expect(not lost, f"acknowledged events {lost} are not in the store as they were acknowledged")
    told: dict[int, list[tuple[int | None, str]]] = {}
    for row in rows:
        if row.event == "assigned":
            for change in json.loads(row.body)["changes"]:
                told.setdefault(change["agent"], []).append((change["target"], change["reason"]))
    for agent, targets in heard_targets(heard).items():
        unexplained = unexplained_target(targets, told.get(agent, []))
        run.expect(unexplained is None, f"agent {agent} was sent to {unexplained} without a reason: {told.get(agent)}")
    _look_at_restart(run, rows, heard)


def heard_targets(heard: list[Heard]) -> dict[int, list[int | None]]:
    """Return the targets that each agent was told, one after the other."""
    targets: dict[int, list[int | None]] = {}
    for one in heard:
        for agent in one.frame.agents:
            known = targets.setdefault(agent.id, [])
            if not known or known[-1] != agent.target_id:
                known.append(agent.target_id)
    return targets


def unexplained_target(targets: list[int | None], told: list[tuple[int | None, str]]) -> int | None:
    """Return the first target for which no event came in turn with a reason; None if all are explained."""
    events = iter(told)
    for target in targets:
        if target is None and not told:
            continue
        if not any(event_target == target and reason for event_target, reason in events):
            return target if target is not None else 0
    return None


def _look_at_restart(run: Orders, rows: list[EventRow], heard: list[Heard]) -> None:
    """Compare the first broadcast after the kill with what the events before it make of the mission."""
    begun = [row.number for row in rows if row.event == "started"]
    second = [one.frame for one in heard if one.frame.stamp.epoch_s > heard[0].frame.stamp.epoch_s]
    if len(begun) < 2 or not second:
        return
    events = [event_from_json(row.body) for row in rows if row.number < begun[1]]
    operations = folded(resolve(parse_mission(MISSION, "orders"), 1), events)
    first, orders = second[0], operations.orders
    run.expect(first.directive is orders.told, f"told {first.directive} after the kill, and {orders.told} before it")
    ids = {threat.id for threat in operations.mission.threats}
    run.expect({threat.id for threat in first.threats} <= ids, f"threats {first.threats} after the kill, {ids} before")
    for agent in first.agents:
        kept = orders.own.get(agent.id, Directive.NORMAL)
        run.expect(agent.directive is kept, f"agent {agent.id}: {agent.directive} after the kill, and {kept} before it")


def one_run(seed: int, restart_s: float) -> Orders:
    """Play one run in a folder of its own; an exception is a fault of it."""
    folder = Path(tempfile.mkdtemp(prefix="orders-"))
    try:
        return kill_orders(seed, folder, restart_s)
    except Exception as error:  # noqa: BLE001 every other run is of interest, too
        return Orders(faults=[f"{type(error).__name__}: {error}"])
    finally:
        Child.end_all()
        shutil.rmtree(folder, ignore_errors=True)


def main() -> int:
    """Run it; the exit status is 1 if any run had a fault."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=25, help="each kills twice")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--restart-s", type=float, default=RESTART_S, help="longest time to be heard again, s")
    given = parser.parse_args()
    runs: list[Orders] = []
    with ProcessPoolExecutor(given.workers) as pool:
        for run in pool.map(one_run, range(given.seed, given.seed + given.runs), repeat(given.restart_s)):
            runs.append(run)
            for fault in run.faults:
                print(f"FAULT {' '.join(fault.split())}", flush=True)
    bad = sum(bool(run.faults) for run in runs)
    count = sum(run.acknowledged for run in runs)
    restarts = [run.restart for run in runs if run.restart is not None]
    print(
        f"orders: {2 * len(runs)} killed, {count} events acknowledged, {bad or 'none'} of {len(runs)} runs with a fault"
    )
    if restarts:
        took_s, busy_s = map(sorted, zip(*restarts, strict=True))
        middle = len(took_s) // 2
        print(f"  heard again after {took_s[middle]:.2f} s (median), at most {took_s[-1]:.2f} s")
        print(f"  for which it used the processor for {busy_s[middle]:.2f} s (median), at most {busy_s[-1]:.2f} s")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
