"""The real ground station on a pseudo-terminal that stands in for a 57600-baud radio: bytes, budget, deepest backlog.

Run as `python tests/benchmarks/serial_radio.py` (about 70 s). The radio takes in at once what the ground station
writes, sends it on at its own rate, and reports its buffer once a second. `--air` makes it slower than the ground
station was told.
"""

from __future__ import annotations

import argparse
import os
import select
import subprocess
import sys
import tempfile
import time
import tty
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from pymavlink.dialects.v20 import common

from companion.protocol.dialect import oneway

LINE_BYTES_PER_S = 5760.0
"""Rate of the serial line: 57600 baud at ten bits a byte."""
READ_PERIOD_S = 0.005
REPORT_PERIOD_S = 1.0
MISSION = """
name: serial-radio
draw: {{agents: {agents}, targets: {some}, threats: {some}}}
defaults: {{agent: {{speed_m_s: 25, n_max: 2}}, threat: {{detection_radius_m: 2000, attack_radius_m: 1000}}}}
"""


@dataclass
class Radio:
    """The radio's modem: a buffer that fills with the bytes written and empties at the rate of the air."""

    air_bytes_per_s: float
    buffer_bytes: int
    backlog_bytes: float = 0.0
    deepest_bytes: float = 0.0
    overrun_bytes: float = 0.0
    taken: list[tuple[float, bytes]] = field(default_factory=list)
    longest_pause_s: float = 0.0
    """Longest time between two looks at the line: what piled up meanwhile looks like a burst, though it may have come
    evenly."""
    _last_s: float | None = None

    def step(self, now_s: float, chunk: bytes) -> None:
        """Send on what the air carried since the last step, then take in a chunk."""
        if self._last_s is not None:
            pause_s = now_s - self._last_s
            self.longest_pause_s = max(self.longest_pause_s, pause_s)
            self.backlog_bytes = max(self.backlog_bytes - self.air_bytes_per_s * pause_s, 0.0)
        self._last_s = now_s
        if chunk:
            self.taken.append((now_s, chunk))
        self.backlog_bytes += len(chunk)
        self.deepest_bytes = max(self.deepest_bytes, self.backlog_bytes)
        self.overrun_bytes += max(self.backlog_bytes - self.buffer_bytes, 0.0)
        self.backlog_bytes = min(self.backlog_bytes, self.buffer_bytes)

    def report(self) -> bytes:
        """Return a RADIO_STATUS message with the free share of the buffer."""
        free_percent = round(100.0 * (1.0 - self.backlog_bytes / self.buffer_bytes))
        message = common.MAVLink_radio_status_message(200, 200, free_percent, 30, 30, 0, 0)
        return bytes(message.pack(common.MAVLink(None, srcSystem=51, srcComponent=68)))


def main() -> None:
    """Run the ground station on the radio, and print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--settle", type=float, default=2.0, help="before anything is counted")
    parser.add_argument("--share", type=float, default=1.0)
    parser.add_argument("--agents", type=int, default=500)
    parser.add_argument("--buffer", type=int, default=1024, help="bytes of the radio's buffer")
    parser.add_argument("--air", type=float, default=LINE_BYTES_PER_S, help="bytes per second that the air carries")
    options = parser.parse_args()
    radio = Radio(options.air, options.buffer)
    far, near = os.openpty()
    tty.setraw(near)
    os.set_blocking(far, False)
    with tempfile.TemporaryDirectory() as folder:
        mission = Path(folder) / "mission.yaml"
        mission.write_text(MISSION.format(agents=options.agents, some=max(options.agents // 10, 1)))
        command = ["groundstation", "run", str(mission), "--link", f"serial:{os.ttyname(near)}:57600", "--unsigned"]
        command += ["--radio", "sik-57600", "--share", str(options.share)]
        process = subprocess.Popen([sys.executable, "-m", *command], stdin=subprocess.DEVNULL)
        with suppress(PermissionError):
            # A radio does not wait for a busy computer.
            os.setpriority(os.PRIO_PROCESS, 0, -15)
        try:
            began_s = listen(process, far, radio, options.settle, options.seconds)
        finally:
            process.terminate()
            process.wait(timeout=20)
    tell(radio, options, began_s)


def listen(process: subprocess.Popen[bytes], far: int, radio: Radio, settle_s: float, seconds: float) -> float:
    """Act as the radio from the first byte for `settle_s` and then `seconds`; return when the counting began.

    Bytes count only after the time to settle.
    """
    first_s: float | None = None
    report_due_s = 0.0
    while first_s is None or time.monotonic() < first_s + settle_s + seconds:
        if process.poll() is not None:
            raise SystemExit("the ground station ended early")
        ready, _, _ = select.select([far], [], [], READ_PERIOD_S)
        now_s = time.monotonic()
        chunk = os.read(far, 65_536) if ready else b""
        if chunk and first_s is None:
            first_s = report_due_s = now_s
        radio.step(now_s, chunk)
        if first_s is not None and now_s >= report_due_s:
            report_due_s += REPORT_PERIOD_S
            os.write(far, radio.report())
        time.sleep(READ_PERIOD_S)
    return first_s + settle_s


def tell(radio: Radio, options: argparse.Namespace, began_s: float) -> None:
    """Print what was measured."""
    counted = sum(len(chunk) for at_s, chunk in radio.taken if began_s <= at_s < began_s + options.seconds)
    budget = options.share * LINE_BYTES_PER_S * options.seconds
    parser = oneway.MAVLink(None)
    parser.robust_parsing = True
    stream = b"".join(chunk for _, chunk in radio.taken)
    kinds = Counter(message.get_type() for message in parser.parse_buffer(bytearray(stream)) or [])
    print(f"{options.agents} agents, share {options.share:g}, air {radio.air_bytes_per_s:g} B/s, {options.seconds:g} s")
    print(f"bytes {counted}, budget {budget:.0f}, {100.0 * (counted / budget - 1.0):+.2f} %")
    print(f"deepest backlog {radio.deepest_bytes:.0f} of {radio.buffer_bytes} bytes, overrun {radio.overrun_bytes:.0f}")
    print(f"longest pause between two looks {1000.0 * radio.longest_pause_s:.0f} ms")
    print(", ".join(f"{kind} {count}" for kind, count in kinds.most_common()))


if __name__ == "__main__":
    main()
