"""The shell of `companion run` itself on a virtual clock: its event loop, its sockets, and a computer that is too slow.

The sockets are real, on this computer's own address, and deliver at once; time passes only where a flight says that
work takes some, where the computer stands still, or where the program waits. Nothing sleeps.
"""

from __future__ import annotations

import asyncio
import csv
import heapq
import itertools
import random
import selectors
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any
from unittest.mock import patch

from pymavlink.dialects.v20 import common as mavlink

from companion.autopilot.kinds import CRUISE_M_S, KINDS
from companion.autopilot.offboard import SETPOINT_IDS
from companion.geo.local_frame import LocalFrame
from companion.onboard import service
from companion.onboard.config import parse_config
from companion.onboard.recording import RecordedCompanion
from companion.protocol import authenticator, ed25519
from companion.protocol.authenticator import Authenticator
from companion.protocol.frame import raw_frames
from companion.protocol.v2_extension import wrap
from companion.runtime.console import program_logger
from sim.faults.scene import DEMANDED
from sim.mavlink_sender import MavlinkSender
from sim.vehicles import CRAFTS, Home, Setup, StandIn
from tests.companion.protocol.hostile import Ground
from tests.ports import free_ports

HERE = "127.0.0.1"
BEGAN_S = 1_000.0
"""What the computer's clocks read at the beginning."""
UNIX_S = 1_790_000_000.0
HANDED_OVER_S = 4.0
"""Time of the flight at which the person hands the vehicle over: parameters are read, and there is a picture."""
PLAYED_S = 0.005
"""Period in which the surroundings are played."""
STEP_S = 0.05
GUIDED = {"arducopter": (4, 0), "arduplane": (15, 0), "px4-copter": (6, 0), "px4-plane": (6, 0)}
HOLDING = {"arducopter": (17, 0), "arduplane": (12, 0), "px4-copter": (4, 3), "px4-plane": (4, 3)}
CONFIG = """
agent_id: 1
autopilot: {{kind: {kind}, link: "udpin:127.0.0.1:{autopilot}", state_file: {folder}/engaged.json{more}}}
broadcast:
  link: "{broadcast}"
  trust: both
  mavlink_key: {folder}/shared
  public_key: {folder}/public
  state_file: {folder}/broadcast.json
limits: {{speed_m_s: {speed}, n_max: 0.15, range_m: 100000, height_min_m: 5, height_max_m: 100}}
height_m: 60
separation_m: 20
arrival_radius_m: 50
guidance_step_s: 0.2
{logs}
"""


class Clocks:
    """The computer's clocks: one that stands still while it is suspended, and two that do not."""

    def __init__(self) -> None:
        self.awake_s = BEGAN_S
        self.suspended_s = 0.0
        self.busy_s = 0.0
        """Processor time of the program."""

    @property
    def t_s(self) -> float:
        """Time of the flight."""
        return self.awake_s + self.suspended_s - BEGAN_S

    def read(self, number: int) -> float:
        """Return what `clock_gettime` returns."""
        return self.awake_s if number == time.CLOCK_MONOTONIC else self.awake_s + self.suspended_s

    @contextmanager
    def everywhere(self) -> Iterator[None]:
        """Have all programs read these clocks meanwhile."""
        with ExitStack() as stack:
            for name, read in (
                ("monotonic", lambda: self.awake_s),
                ("time", lambda: UNIX_S + self.t_s),
                ("process_time", lambda: self.busy_s),
                ("clock_gettime", self.read),
            ):
                stack.enter_context(patch.object(time, name, read))
            yield


class _Selector(selectors.EpollSelector):
    """Waits for sockets in virtual time; the surroundings are played meanwhile."""

    def __init__(self, flight: RealLoop) -> None:
        super().__init__()
        self._flight = flight

    def select(self, timeout: float | None = None) -> list[tuple[selectors.SelectorKey, int]]:
        clocks = self._flight.clocks
        self._flight.play_on()
        ready = super().select(0)
        if timeout is None and not ready:
            # A thread looks up an address or writes a file: that takes no time of the flight.
            return super().select(0.05)
        ends_s = clocks.awake_s + (timeout or 0.0)
        while not ready and clocks.awake_s < ends_s:
            clocks.awake_s = min(ends_s, clocks.awake_s + PLAYED_S)
            self._flight.play_on()
            ready = super().select(0)
        return ready


class _Loop(asyncio.SelectorEventLoop):
    def __init__(self, flight: RealLoop) -> None:
        self._clocks = flight.clocks
        super().__init__(_Selector(flight))

    def time(self) -> float:
        return self._clocks.awake_s


class RealLoop:
    """A flight of `companion run` with its stand-in autopilot, its broadcast, and whatever else is on its links."""

    def __init__(self, kind: str = "arducopter", *, one_radio: bool = False) -> None:
        self.kind = kind
        self.clocks = Clocks()
        self.setpoints_s: list[float] = []
        self.said: list[str] = []
        self.rows: list[dict[str, str]] = []
        """The table of decisions."""
        self.taken_s: float | None = None
        """When the HEARTBEAT that tells that a person took the vehicle was sent."""
        self.believed = 0
        """Number of frames of the broadcast that were believed."""
        self.costs_s = {"datagram": 0.0, "telemetry": 0.0, "decision": 0.0, "check": 0.0}
        """What the companion's work takes: a datagram of the broadcast, frames of the autopilot, a decision, the check
        of a signature."""
        # One radio has no room for both signatures.
        self.ground = Ground("ed25519" if one_radio else "both", random.Random(1), epoch_s=int(UNIX_S))
        self._one_radio = one_radio
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._number = itertools.count()
        self.autopilot_port, self.broadcast_port = free_ports(2)
        self._person = MavlinkSender(255, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._guided = self._silent = False
        self.vehicle = self._stand_in()
        self._sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
        """The autopilot's and the ground station's."""
        for one, port in zip(self._sockets, (self.autopilot_port, self.broadcast_port), strict=True):
            one.connect((HERE, port))
            one.setblocking(False)

    def at(self, t_s: float, act: Callable[[], None]) -> None:
        """Do something at a time of the flight."""
        heapq.heappush(self._due, (t_s, next(self._number), act))

    def every(self, period_s: float, from_s: float, until_s: float, act: Callable[[float], None]) -> None:
        """Do something again and again, with the time at which it is due; late if the program is at work."""

        def do() -> None:
            nonlocal from_s
            due_s, from_s = from_s, from_s + period_s
            if from_s < until_s:
                self.at(from_s, do)
            act(due_s)

        self.at(from_s, do)

    def flood(self, datagram: bytes, from_s: float, until_s: float, per_s: float = 20_000.0, port: int = 0) -> None:
        """Flood a port with a datagram, from a socket of its own; by default the broadcast's."""
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sender.connect((HERE, port or self.broadcast_port))
        self._sockets.append(sender)

        self.every(PLAYED_S, from_s, until_s, lambda _: _burst(sender, datagram, per_s))

    def flood_from_autopilot(self, datagram: bytes, from_s: float, until_s: float, per_s: float) -> None:
        """Flood the autopilot's link from the autopilot's own address, as what it or a router passes on comes."""
        self.every(PLAYED_S, from_s, until_s, lambda _: _burst(self._sockets[0], datagram, per_s))

    def silence(self, from_s: float) -> None:
        """Let the autopilot fall silent."""
        self.at(from_s, lambda: setattr(self, "_silent", True))

    def stand_still(self, t_s: float, seconds: float, *, suspended: bool = False) -> None:
        """Let the program, or the whole computer, stand still for a time; what is sent to it meanwhile waits."""

        def stand_still() -> None:
            if suspended:
                self.clocks.suspended_s += seconds
                self.play_on()
            else:
                self._pass_time(seconds)

        self.at(t_s, stand_still)

    def take_over(self, t_s: float) -> None:
        """Have the person choose another mode, which the autopilot's next HEARTBEAT tells."""
        self.at(t_s, lambda: self._order(HOLDING[self.kind]))

    def run(self, until_s: float, logs: bool = False) -> None:
        """Fly until a time of the flight."""
        with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
            folder = Path(name)
            stack.enter_context(self.clocks.everywhere())
            stack.enter_context(patch.object(service, "trust_of", lambda _: self.ground.trust))
            self._charge(stack)
            logger = program_logger("companion")
            for level in ("info", "warning"):
                stack.enter_context(patch.object(logger, level, self._say))
            self._surround()
            config = parse_config(self._config(folder, logs), "field.yaml")
            stop = asyncio.Event()
            self.at(until_s, stop.set)
            with asyncio.Runner(loop_factory=lambda: _Loop(self)) as runner:
                runner.run(service.run_companion(config, stop))
            if logs:
                self.rows = _rows(next((folder / "logs").rglob("decisions-1.csv")))
        for one in self._sockets:
            one.close()

    def work(self, seconds: float) -> None:
        """Let the program work for a time; what is sent to it meanwhile waits."""
        self._pass_time(seconds)
        self.clocks.busy_s += seconds

    def play_on(self) -> None:
        """Play what is due around the program."""
        self._listen()
        self._pass_time(0.0)
        self._listen()

    def _pass_time(self, seconds: float) -> None:
        """Let time pass without the program, and play what is due meanwhile."""
        ends_s = self.clocks.awake_s + seconds
        ends_at_s = self.clocks.t_s + seconds
        while self._due and self._due[0][0] <= ends_at_s:
            due_s, _, act = heapq.heappop(self._due)
            self.clocks.awake_s += max(0.0, due_s - self.clocks.t_s)
            act()
        self.clocks.awake_s = max(self.clocks.awake_s, ends_s)

    def _surround(self) -> None:
        """Begin to play the vehicle, the ground station and the person."""
        ever_s = 1e9
        self.every(STEP_S, 0.0, ever_s, self._step)
        self.every(1.0, 0.2, ever_s, lambda _: self._broadcast())
        self.every(0.5, HANDED_OVER_S, HANDED_OVER_S + 3.0, lambda _: self._hand_over())

    def _step(self, t_s: float) -> None:
        self.vehicle.step_to(UNIX_S + t_s)
        self._send(self.vehicle.telemetry(UNIX_S + t_s))

    def _broadcast(self) -> None:
        frame = self.ground.frame(UNIX_S + self.clocks.t_s)
        with suppress(OSError):
            if self._one_radio:
                self._sockets[0].send(wrap(frame, 0))
            else:
                self._sockets[1].send(frame)

    def _hand_over(self) -> None:
        if self.taken_s is None and not self._guided:
            self._order(GUIDED[self.kind])

    def _order(self, mode: tuple[int, int]) -> None:
        flag = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
        values = (flag, *map(float, mode), 0.0, 0.0, 0.0, 0.0)
        order = mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_DO_SET_MODE, 0, *values)
        self._send(self.vehicle.receive(self._person.pack(order), UNIX_S + self.clocks.t_s))

    def _send(self, frames: list[bytes]) -> None:
        """Send the autopilot's frames, and note when its HEARTBEAT tells that the mode was changed."""
        for data in frames:
            (frame,) = raw_frames(data)
            if frame.message_id == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
                mode = int.from_bytes(frame.payload[:4].ljust(4, b"\0"), "little")
                was_guided, self._guided = self._guided, mode == self._guided_mode
                if was_guided and not self._guided:
                    self.taken_s = self.clocks.t_s
            with suppress(OSError):
                if not self._silent:
                    self._sockets[0].send(data)

    @property
    def _guided_mode(self) -> int:
        main, _ = GUIDED[self.kind]
        return main << 16 if self.kind.startswith("px4") else main

    def _listen(self) -> None:
        """Take in what the companion sent."""
        with suppress(OSError):
            while True:
                datagram = self._sockets[0].recv(65_536)
                steers = any(frame.version == 2 and frame.message_id in SETPOINT_IDS for frame in raw_frames(datagram))
                if steers:
                    self.setpoints_s.append(self.clocks.t_s)
                self._send(self.vehicle.receive(datagram, UNIX_S + self.clocks.t_s))

    def _stand_in(self) -> StandIn:
        vehicle = StandIn(
            CRAFTS[self.kind],
            Setup(
                1,
                LocalFrame(47.0, 8.0),
                altitude_m=560.0,
                speed_m_s=0.0 if KINDS[self.kind].can_stop else CRUISE_M_S[self.kind],
                home=Home(0.0, 0.0, 500.0),
                in_air=True,
                armed=True,
                start_s=UNIX_S,
            ),
        )
        vehicle.parameters.update(DEMANDED[self.kind])
        return vehicle

    def _config(self, folder: Path, logs: bool) -> str:
        speed_m_s = min(CRUISE_M_S[self.kind], 8.0) if KINDS[self.kind].can_stop else CRUISE_M_S[self.kind]
        return CONFIG.format(
            kind=self.kind,
            autopilot=self.autopilot_port,
            more=", offboard: direct" if self.kind == "px4-copter" else "",
            broadcast="autopilot" if self._one_radio else f"udpin:{HERE}:{self.broadcast_port}",
            folder=folder,
            speed=speed_m_s,
            logs=f"log_dir: {folder}/logs" if logs else "",
        )

    def _charge(self, stack: ExitStack) -> None:
        """Have the companion's work take time, and count what it believes."""
        flight = self

        def charged(owner: type, name: str, cost: str) -> None:
            original = getattr(owner, name)

            def work(self: object, *arguments: Any) -> Any:  # noqa: ANN401 - whatever the original takes
                flight.work(flight.costs_s[cost])
                result = original(self, *arguments)
                if cost == "datagram":
                    flight.believed += len(result)
                return result

            stack.enter_context(patch.object(owner, name, work))

        charged(Authenticator, "admit", "datagram")
        check = ed25519.verify

        def checked(*arguments: Any) -> bool:  # noqa: ANN401 - whatever the original takes
            flight.work(flight.costs_s["check"])
            return check(*arguments)

        stack.enter_context(patch.object(authenticator, "verify", checked))
        charged(RecordedCompanion, "receive", "telemetry")
        charged(RecordedCompanion, "decide", "decision")

    def _say(self, text: str, *values: object) -> None:
        self.said.append(text % values)


def _burst(sender: socket.socket, datagram: bytes, per_s: float) -> None:
    for _ in range(round(per_s * PLAYED_S)):
        with suppress(OSError):
            sender.send(datagram)


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))
