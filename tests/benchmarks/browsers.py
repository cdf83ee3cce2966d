"""What watching costs: send times and CPU of `groundstation run` without and with browsers on its page.

    python -m tests.benchmarks.browsers [--agents N] [--targets N] [--threats N] [--browsers N] [--seconds S]

A ground station broadcasts a mission of that size once a second over UDP, first with nobody on its page and then with
N pages in headless Chromium, in turns. Printed are, for both: how far the first frame of each broadcast came from a
grid of one second (the jitter, at the receiver), the CPU of the broadcasting process and of the web process, and their
memory; with browsers also how many pictures a second each page got, and how many drawings it made. Chromium itself
takes CPU of the same machine, which browsers of operators would not: with `--nice 19` it takes what nobody else wants.
"""

from __future__ import annotations

import argparse
import functools
import math
import os
import select
import signal
import socket
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from groundstation.web.address import Address, bound, listen
from tests.web.rig import ARGUMENTS, CHROMIUM, WIDE

if TYPE_CHECKING:
    from playwright.sync_api import WebSocket

ALL_SEEN = (
    "--disable-renderer-backgrounding",
    "--disable-background-timer-throttling",
    "--disable-backgrounding-occluded-windows",
)
"""Arguments of Chromium without which pages in the background draw nothing, as nobody sees them."""
SETTLE_S = 3.0
"""Time before anything is counted."""
TICKS_PER_S = os.sysconf("SC_CLK_TCK")
MISSION = """
name: many
area_m: {{north: 200000, east: 200000}}
draw: {{agents: {agents}, targets: {targets}, threats: {threats}}}
defaults:
  agent: {{speed_m_s: 60, n_max: 10, range_m: 500000}}
  target: {{speed_bound_m_s: 10}}
  threat: {{detection_radius_m: 2000, attack_radius_m: 1000, speed_bound_m_s: 10}}
broadcast_period_s: 1
assignment_period_s: 25
"""
COUNTERS = """
window.counted = {drawn: 0};
const clear = CanvasRenderingContext2D.prototype.clearRect;
CanvasRenderingContext2D.prototype.clearRect = function (...box) { window.counted.drawn += 1; clear.apply(this, box); };
"""
"""Counts the drawings of a page, each of which begins with an empty canvas."""


class Usage(NamedTuple):
    """CPU time of a process, s, and its resident memory, MB."""

    cpu_s: float
    memory_mb: float


def usage(pid: int) -> Usage:
    """Return what a process has used until now."""
    after_name = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    ticks = int(after_name[11]) + int(after_name[12])
    return Usage(ticks / TICKS_PER_S, pages * os.sysconf("SC_PAGE_SIZE") / 1e6)


def children(pid: int) -> list[int]:
    """Return the processes that a process has started, and theirs."""
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in map(int, (task / "children").read_text().split()):
            found += [child, *children(child)]
    return found


class Station:
    """A ground station in a process, and the socket that receives its broadcast."""

    def __init__(self, mission: Path, stack: ExitStack) -> None:
        self.receiver = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        self.receiver.bind(("127.0.0.1", 0))
        self.receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
        with listen(Address(port=0)) as probe:
            self.page = bound(probe)
        link = f"udpout:127.0.0.1:{self.receiver.getsockname()[1]}"
        self.process = subprocess.Popen(
            [
                *(sys.executable, "-m", "groundstation", "run", str(mission), "--link", link, "--unsigned"),
                *("--ui", str(self.page)),
            ],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            stdin=subprocess.DEVNULL,
        )
        stack.callback(self.process.wait, 20.0)
        stack.callback(self.process.send_signal, signal.SIGINT)

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{self.page}/"

    def begins_s(self, seconds: float) -> np.ndarray:  # (B,) s
        """Return when the broadcasts of some seconds began, by the receiver's clock."""
        times_s, until_s, last_s = [], time.monotonic() + seconds, -math.inf
        while (left_s := until_s - time.monotonic()) > 0.0:
            if select.select([self.receiver], [], [], left_s)[0]:
                self.receiver.recv(2048)
                now_s = time.monotonic()
                # A broadcast of state frames begins after a pause; motion frames follow it by half a period.
                if now_s - last_s > 0.2:
                    times_s.append(now_s)
                last_s = now_s
        return np.array(times_s)

    def wait(self) -> None:
        """Wait until it broadcasts."""
        if not select.select([self.receiver], [], [], 60.0)[0]:
            raise SystemExit("the ground station did not broadcast within 60 s")


def jitter_ms(times_s: np.ndarray) -> np.ndarray:  # (B,) s -> (B,) ms
    """Return how far the beginnings of broadcasts, half a second apart, are from a grid that fits them best."""
    off_s = (times_s + 0.25) % 0.5
    # The grid's phase is unknown: it is where the offsets lie in the median, seen from one of them.
    off_s = (off_s - off_s[0] + 0.25) % 0.5
    return np.asarray(1000.0 * np.abs(off_s - np.median(off_s)))


def _count(counted: dict[str, int], stream: WebSocket) -> None:
    """Count the messages of a stream by their type."""

    def take(data: str | bytes) -> None:
        head = data[:40] if isinstance(data, str) else data[:40].decode(errors="replace")
        counted["moves"] += '"moves"' in head
        counted["pictures"] += '"picture"' in head

    stream.on("framereceived", take)


def open_pages(url: str, count: int, nice: int, stack: ExitStack) -> list[Any]:
    """Open a page in each of some contexts of one Chromium."""
    from playwright.sync_api import sync_playwright

    driver = stack.enter_context(sync_playwright())
    for pid in children(os.getpid()):
        # Its driver, which starts the browser; the ground station keeps its priority.
        if b"playwright" in Path(f"/proc/{pid}/cmdline").read_bytes():
            os.setpriority(os.PRIO_PROCESS, pid, nice)
    browser = driver.chromium.launch(executable_path=str(CHROMIUM), args=[*ARGUMENTS, *ALL_SEEN])
    stack.callback(browser.close)
    pages = []
    for _ in range(count):
        page = browser.new_context(viewport=WIDE).new_page()
        page.add_init_script(COUNTERS)
        counted = {"moves": 0, "pictures": 0}
        page.on("websocket", functools.partial(_count, counted))
        page.goto(url)
        pages.append((page, counted))
    return pages


def measure(station: Station, seconds: float, pages: list[Any]) -> str:
    """Return one row of the table, measured for some seconds."""
    # One page is asked to let events of the driver come in, without which nothing is counted.
    for page, counted in pages:
        page.wait_for_timeout(10)
        counted.update(moves=0, pictures=0)
        page.evaluate("window.counted.drawn = 0")
    own = station.process.pid
    web = children(own)
    before = {pid: usage(pid) for pid in (own, *web)}
    began_s = time.monotonic()
    times_s = station.begins_s(seconds)
    lasted_s = time.monotonic() - began_s
    after = {pid: usage(pid) for pid in before}
    off_ms = jitter_ms(times_s)
    cpu = {pid: 100.0 * (after[pid].cpu_s - before[pid].cpu_s) / lasted_s for pid in before}
    row = (
        f"{len(pages):3} | {len(times_s):4} | {np.median(off_ms):6.2f} | {np.quantile(off_ms, 0.99):6.2f} | "
        f"{off_ms.max():6.2f} | {cpu[own]:5.1f} | {sum(cpu[pid] for pid in web):5.1f} | {after[own].memory_mb:5.0f} | "
        f"{sum(after[pid].memory_mb for pid in web):5.0f}"
    )
    if not pages:
        return row
    rates = []
    for page, counted in pages:
        page.wait_for_timeout(10)
        drawn = page.evaluate("window.counted.drawn")
        whole_s = time.monotonic() - began_s
        rates.append((counted["moves"] / whole_s, counted["pictures"] / whole_s, drawn / whole_s))
    least = np.min(rates, axis=0)
    return f"{row} | {least[0]:.1f} moves, {least[1]:.1f} pictures, {least[2]:.0f} drawings a second"


def main() -> None:
    """Measure in turns without and with browsers, and print a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--agents", type=int, default=500)
    parser.add_argument("--targets", type=int, default=50)
    parser.add_argument("--threats", type=int, default=50)
    parser.add_argument("--browsers", type=int, default=5)
    parser.add_argument("--nice", type=int, default=0, help="of the browsers")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each turn")
    parser.add_argument("--turns", type=int, default=2)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        mission = Path(folder) / "many.yaml"
        mission.write_text(MISSION.format(agents=given.agents, targets=given.targets, threats=given.threats))
        station = Station(mission, stack)
        station.wait()
        print(
            "pages | broadcasts | jitter ms: median | 99 % | most | CPU % | web's | MB | web's | each page, the least"
        )
        for _ in range(given.turns):
            station.begins_s(SETTLE_S)
            print(measure(station, given.seconds, []), flush=True)
            if given.browsers and CHROMIUM.exists():
                with ExitStack() as watched:
                    pages = open_pages(station.url, given.browsers, given.nice, watched)
                    station.begins_s(SETTLE_S)
                    print(measure(station, given.seconds, pages), flush=True)


if __name__ == "__main__":
    main()
