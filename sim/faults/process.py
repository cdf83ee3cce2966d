"""What a fault can affect of the companion's process: its life, its clock, its queued datagrams, its state files."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from companion.autopilot.offboard import is_setpoint
from companion.autopilot.offboard_child import TICK_TIMEOUT_S
from companion.autopilot.registry import ADAPTERS
from companion.onboard.authority import State
from companion.onboard.companion import Companion
from companion.onboard.config import Config
from companion.onboard.decision import Decision
from companion.protocol.authenticator import Authenticator, AuthenticatorState, Trust
from sim.faults.scene import FLEET_KEY, SYSTEM_ID, Setting
from sim.loop import START_S, TOLERANCE_S


@dataclass
class _Program:
    """One run of `companion run` without its sockets."""

    companion: Companion
    clock_ahead_s: float
    """How much the computer's clock was ahead of the true time at the program's start, when it was read."""
    last: Decision | None = None
    setpoints: list[bytes] = field(default_factory=list)
    """The newest setpoints that the program sent, which MAVSDK's child process repeats."""
    waiting: list[bytes] = field(default_factory=list)
    """Datagrams of the autopilot that a hung program has not read yet."""
    waiting_broadcasts: list[bytes] = field(default_factory=list)
    """Datagrams of the broadcast that a hung program has not read yet."""
    due_s: float = -math.inf
    """Time of the flight at which the next decision is due."""


@dataclass
class _StateFiles:
    """The state files on disk, which a process reads from the one before."""

    authority: State = State.WAITING
    authenticator: AuthenticatorState | None = None


class CompanionProcess:
    """`companion run` on one vehicle, which can be killed, started and hung, and whose clock can be stepped."""

    def __init__(
        self, setting: Setting, config: Config, t_s: Callable[[], float], autopilot: Callable[[bytes], list[bytes]]
    ) -> None:
        """Start the process; `t_s` returns the time of the flight, `autopilot` takes a frame and returns replies."""
        self._setting = setting
        self._config = config
        self._t_s = t_s
        self._autopilot = autopilot
        self._files = _StateFiles()
        self._clock_ahead_s = 0.0
        self._hung_since_s: float | None = None
        self._program: _Program | None = None
        self.sent = 0
        """Setpoints that reached the autopilot since the last turn began."""
        self.start()

    # Faults

    def kill(self) -> None:
        """End the process, as a crash or a loss of power does: whatever is not on disk is lost."""
        self._program = None
        self._hung_since_s = None

    def start(self, with_state: bool = True) -> None:
        """Start a process, with the state files of the one before, or without them."""
        if not with_state:
            self._files = _StateFiles()
        trust = Trust(mavlink_key=FLEET_KEY if self._setting.signed else None)
        authenticator = Authenticator(trust, self._files.authenticator)
        adapter = ADAPTERS[self._setting.kind](SYSTEM_ID)
        companion = Companion(self._config, adapter, authenticator=authenticator, was=self._files.authority)
        self._program = _Program(companion, self._clock_ahead_s)

    def hang(self, hung: bool) -> None:
        """Hang the process, while arriving datagrams wait in its sockets; or let it go on."""
        if hung:
            self._hung_since_s = self._t_s()
            return
        self._hung_since_s = None
        self._catch_up()

    def step_clock(self, ahead_s: float) -> None:
        """Step the computer's clock by `ahead_s`; the monotonic clock is not affected."""
        self._clock_ahead_s += ahead_s

    def clear(self) -> None:
        """Clear the companion's lock by a signal to the process, so that the vehicle can be handed over again."""
        if self._program is not None:
            self._program.companion.clear(self._now_s())

    # State

    @property
    def is_dead(self) -> bool:
        """Whether no process is running."""
        return self._program is None

    @property
    def listens(self) -> bool:
        """Whether a process is running and is not hung."""
        return self._program is not None and self._hung_since_s is None

    @property
    def decision(self) -> Decision | None:
        """The last decision of the process; None if it is dead or hung, or has not decided yet."""
        return None if self._program is None or self._hung_since_s is not None else self._program.last

    # Behaviour

    def turn(self, broadcasts: Sequence[bytes], frames: Sequence[bytes]) -> None:
        """Run the process's loop once, with the datagrams of the broadcast and the frames of the autopilot's link."""
        self.sent = 0
        program = self._program
        if program is None:
            return
        if self._hung_since_s is not None:
            program.waiting += frames
            program.waiting_broadcasts += broadcasts
            if self._setting.child and self._t_s() - self._hung_since_s < TICK_TIMEOUT_S - TOLERANCE_S:
                self._deliver(program.setpoints, program)
            return
        now_s = self._now_s()
        for datagram in broadcasts:
            program.companion.hear(datagram, now_s)
        for frame in frames:
            program.companion.receive(frame, now_s)
        self._act(program, now_s)

    def _act(self, program: _Program, now_s: float) -> None:
        companion, t_s = program.companion, self._t_s()
        companion.note_clock(START_S + t_s + self._clock_ahead_s - now_s)
        if t_s >= program.due_s - TOLERANCE_S:
            program.due_s = t_s + self._config.guidance_step_s
            program.last, frames = companion.tick(now_s)
        else:
            frames = companion.repeat(now_s)
        program.setpoints = [frame for frame in frames if is_setpoint(frame)]
        self._deliver(frames, program)
        self._files = _StateFiles(companion.authority.kept, companion.authenticator.state)

    def _catch_up(self) -> None:
        """Go on after a hang: one waiting datagram is read before the loop runs once, the others after it."""
        program = self._program
        if program is None:
            return
        now_s = self._now_s()
        for datagram in program.waiting[:1]:
            program.companion.receive(datagram, now_s)
        self._act(program, now_s)
        for datagram in program.waiting[1:]:
            program.companion.receive(datagram, now_s)
        for datagram in program.waiting_broadcasts:
            program.companion.hear(datagram, now_s)
        program.waiting.clear()
        program.waiting_broadcasts.clear()

    def _deliver(self, frames: Sequence[bytes], program: _Program) -> None:
        now_s = self._now_s()
        for frame in frames:
            self.sent += is_setpoint(frame)
            for reply in self._autopilot(frame):
                if self._hung_since_s is None:
                    program.companion.receive(reply, now_s)
                else:
                    program.waiting.append(reply)

    def _now_s(self) -> float:
        """Return the companion's time: the computer's clock read at its start, and the monotonic clock since."""
        return START_S + self._t_s() + (0.0 if self._program is None else self._program.clock_ahead_s)
