"""What the ArduPilot kinds share: modes, arming, the ground station failsafe and the seconds until it is ready.

As measured (docs/autopilots.md) unless a comment says otherwise. The stand-in of the paper's point borrows it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from pymavlink.dialects.v20 import common as mavlink

from sim.vehicles.craft import Answer, Body, Command, Home, Message, Parameter, Start, Surroundings

FORCE_DISARM = 21196.0
"""The magic second parameter of MAV_CMD_COMPONENT_ARM_DISARM that stops motors in flight."""
READY_TEXT = "ArduPilot Ready"
READY_AFTER_S = 3.0
"""From power to the text; chosen: it was seen to matter, not timed."""
GROUND_STATION_SYSTEM = 255
"""MYGCS: whose heartbeats the ground station failsafe minds."""
GCS_TIMEOUT_S = 5.0
"""FS_GCS_TIMEOUT, FS_LONG_TIMEOUT (code, defaults)."""

ACCEPTED = Answer((mavlink.MAV_RESULT_ACCEPTED,))
DENIED = Answer((mavlink.MAV_RESULT_DENIED,))
FAILED = Answer((mavlink.MAV_RESULT_FAILED,))
UNSUPPORTED = Answer((mavlink.MAV_RESULT_UNSUPPORTED,))

OnCommand = Callable[[Command, Surroundings, float], Answer]


class ArduPilot:
    """The base of a craft: a kind adds its modes, commands, setpoints and motion."""

    kind: str
    mav_type: int
    mav_autopilot: int = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    announces = True
    longest_step_s: float
    parameters: tuple[Parameter, ...]
    modes: Mapping[int, str]
    """By custom_mode."""
    first_mode: int
    """After power on."""
    guided_mode: int
    holding_mode: int
    """In which it stays where it is, without sticks."""
    stick_modes: frozenset[int]
    """Modes that are flown by the pilot's sticks."""
    return_mode: int
    armable: frozenset[int]
    gcs_failsafe: str
    """The parameter that is not 0 where the ground station failsafe returns the vehicle."""

    def __init__(self, start: Start) -> None:
        """Begin in the guided mode if asked to, else holding in the air and in the first mode on the ground."""
        self.body: Body = start.body
        self.home: Home = start.home
        self.armed = start.armed
        self.in_air = start.in_air
        self.failsafe = False
        self.mode = self.guided_mode if start.guided else self.holding_mode if start.in_air else self.first_mode
        self.values = {parameter.name: parameter.default for parameter in self.parameters}
        self.texts: list[str] = []
        self._ready_at_s: float | None = None
        self._ground_station_at_s: float | None = None
        self._commands: dict[int, OnCommand] = {
            mavlink.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
        }

    def base_mode(self) -> int:
        """Return HEARTBEAT.base_mode."""
        base_mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | mavlink.MAV_MODE_FLAG_STABILIZE_ENABLED
        if self.mode in self.stick_modes:
            base_mode |= mavlink.MAV_MODE_FLAG_MANUAL_INPUT_ENABLED
        else:
            base_mode |= mavlink.MAV_MODE_FLAG_GUIDED_ENABLED
        if self.armed:
            base_mode |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED
        return int(base_mode)

    def command(self, command: Command, around: Surroundings, now_s: float) -> Answer | None:
        """Answer a command; None if it is none of this kind's."""
        handler = self._commands.get(command.command)
        return None if handler is None else handler(command, around, now_s)

    def setpoint(self, message: Message, around: Surroundings, now_s: float) -> None:
        """Mind a setpoint: a kind that obeys any says which."""

    def heartbeat_heard(self, system: int, component: int, mav_type: int, now_s: float) -> None:
        """Remember when the ground station was heard; a failsafe ends by a mode change, not by its return."""
        if system == GROUND_STATION_SYSTEM:
            self._ground_station_at_s = now_s

    def reboot(self, now_s: float) -> None:
        """Begin anew: what was asked is forgotten. A vehicle in the air stays armed, as after a watchdog reset."""
        self.mode = self.first_mode
        self.failsafe = False
        self._ground_station_at_s = None
        self._forget()
        self.boot(now_s)

    def boot(self, now_s: float) -> None:
        """Be as freshly powered: a mode that is set before it is ready is acknowledged, and then lost."""
        self._ready_at_s = now_s + READY_AFTER_S

    @property
    def ready(self) -> bool:
        """Whether it has come up, and would arm."""
        return self._ready_at_s is None

    def _forget(self) -> None:
        """Drop what was asked in the mode that ends."""

    def _mind_time(self, now_s: float, around: Surroundings) -> None:
        """Do what the time alone makes due: coming up, the ground station's failsafe."""
        if self._ready_at_s is not None and now_s >= self._ready_at_s:
            self._ready_at_s = None
            if self.mode != self.first_mode:
                self._enter(self.first_mode, around)
            self.texts.append(READY_TEXT)
        heard_s = self._ground_station_at_s
        if (
            heard_s is not None
            and now_s - heard_s > GCS_TIMEOUT_S
            and self._gcs_failsafe_acts()
            and self.armed
            and self.in_air
            and self.mode != self.return_mode
            and not self.failsafe
        ):
            self._enter(self.return_mode, around)
            self.failsafe = True
            self.texts.append("GCS Failsafe")

    def _gcs_failsafe_acts(self) -> bool:
        return self.values[self.gcs_failsafe] != 0.0

    def _do_set_mode(self, command: Command, around: Surroundings, now_s: float) -> Answer:
        if not (math.isfinite(command.param1) and math.isfinite(command.param2)):
            return DENIED
        if not int(command.param1) & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return DENIED
        mode = int(command.param2)
        if mode not in self.modes:
            return Answer((mavlink.MAV_RESULT_FAILED,), (f"No such mode {mode}",))
        self._enter(mode, around)
        return ACCEPTED

    def _enter(self, mode: int, around: Surroundings) -> None:
        # Entering any mode, the guided one again included, forgets the setpoint and a take-off under way.
        self._forget()
        self.failsafe = False
        self.mode = mode

    def _arm_disarm(self, command: Command, around: Surroundings, now_s: float) -> Answer:
        if command.param1 not in (0.0, 1.0):
            return UNSUPPORTED
        arm = command.param1 == 1.0
        if arm == self.armed:
            return ACCEPTED
        if arm and self.mode not in self.armable:
            text = f"Arm: {self.modes[self.mode]} mode not armable"
            return Answer((mavlink.MAV_RESULT_DENIED,), (text,))
        if arm and not self.ready:
            return Answer((mavlink.MAV_RESULT_FAILED,), ("Arm: System not initialised",))
        if not arm and self.in_air and not (command.param2 == FORCE_DISARM and self._can_fall()):
            return Answer((mavlink.MAV_RESULT_DENIED,), ("Disarm: flying",))
        self.armed = arm
        self._on_armed(around)
        return ACCEPTED

    def _can_fall(self) -> bool:
        """Whether its motors can be cut off in the air: whether there is a fall to fly."""
        return False

    def _on_armed(self, around: Surroundings) -> None:
        """Do what arming or disarming begins or ends."""


def changes_mode(command: Command) -> bool:
    """Return whether a DO_REPOSITION may change the mode."""
    flags = command.param2
    return math.isfinite(flags) and bool(int(flags) & mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE)
