"""What the ArduPilot kinds share: modes, arming, the ground station failsafe and the time from power-on until ready.

As measured (docs/autopilots.md) unless a comment says otherwise. The paper's point (`kinematic.py`) derives from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from pymavlink.dialects.v20 import common as mavlink

from sim.vehicles.craft import Answer, Body, Command, Home, Message, Parameter, Start, Surroundings

FORCE_DISARM = 21196.0
"""Second parameter of MAV_CMD_COMPONENT_ARM_DISARM that stops the motors even in flight (as MAVLink defines it)."""
READY_TEXT = "ArduPilot Ready"
"""STATUSTEXT that is sent when start-up has ended."""
READY_AFTER_S = 3.0
"""Time from power-on to READY_TEXT. Chosen: the effect was measured, its duration was not."""
GROUND_STATION_SYSTEM = 255
"""System id whose heartbeats the ground station failsafe watches (ArduPilot's default)."""
GCS_TIMEOUT_S = 5.0
"""Time without a ground station heartbeat before its failsafe: FS_GCS_TIMEOUT and FS_LONG_TIMEOUT's defaults, from
ArduPilot's source."""

ACCEPTED = Answer((mavlink.MAV_RESULT_ACCEPTED,))
DENIED = Answer((mavlink.MAV_RESULT_DENIED,))
FAILED = Answer((mavlink.MAV_RESULT_FAILED,))
UNSUPPORTED = Answer((mavlink.MAV_RESULT_UNSUPPORTED,))

OnCommand = Callable[[Command, Surroundings, float], Answer]
"""Handler of a command, given the surroundings and the time in seconds."""


class ArduPilot:
    """The base class of the ArduPilot crafts: a subclass adds its modes, commands, setpoints and motion."""

    kind: str
    mav_type: int
    mav_autopilot: int = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    announces = True
    lists_adsb = True
    longest_step_s: float
    parameters: tuple[Parameter, ...]
    modes: Mapping[int, str]
    """The modes' names, by custom_mode."""
    first_mode: int
    """The mode (custom_mode) after power-on."""
    guided_mode: int
    holding_mode: int
    """The mode that keeps the vehicle where it is without a pilot's sticks."""
    stick_modes: frozenset[int]
    """The modes that are flown by the pilot's sticks."""
    return_mode: int
    armable: frozenset[int]
    gcs_failsafe: str
    """The name of the parameter that enables the ground station failsafe when it is not 0."""

    def __init__(self, start: Start) -> None:
        """Begin in the guided mode if `start` says so, else in the holding mode (in the air) or the first mode."""
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
        """Answer a command; return None for a command that this kind does not handle."""
        handler = self._commands.get(command.command)
        return None if handler is None else handler(command, around, now_s)

    def setpoint(self, message: Message, around: Surroundings, now_s: float) -> None:
        """Ignore a setpoint; a kind that obeys setpoints overrides this."""

    def heartbeat_heard(self, system: int, component: int, mav_type: int, now_s: float) -> None:
        """Note when the ground station was last heard; only a mode change ends its failsafe, not a new heartbeat."""
        if system == GROUND_STATION_SYSTEM:
            self._ground_station_at_s = now_s

    def reboot(self, now_s: float) -> None:
        """Restart in the first mode without setpoints; a vehicle in the air stays armed, as after a watchdog reset."""
        self.mode = self.first_mode
        self.failsafe = False
        self._ground_station_at_s = None
        self._forget()
        self.boot(now_s)

    def boot(self, now_s: float) -> None:
        """Begin start-up: until the vehicle is ready, a mode that is set is acknowledged, and then lost."""
        self._ready_at_s = now_s + READY_AFTER_S

    @property
    def ready(self) -> bool:
        """Whether start-up has ended, so that the vehicle can be armed."""
        return self._ready_at_s is None

    def _forget(self) -> None:
        """Drop the setpoints and targets of the mode that ends."""

    def _mind_time(self, now_s: float, around: Surroundings) -> None:
        """Do what is due by time alone: end start-up, and trigger the ground station failsafe."""
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
        # Entering any mode, even the guided one again, drops the setpoint and a take-off under way.
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
        """Return whether the motors can be stopped in the air: only where the kind models the fall."""
        return False

    def _on_armed(self, around: Surroundings) -> None:
        """Reset what depends on arming, after the vehicle was armed or disarmed; a kind may override it."""


def changes_mode(command: Command) -> bool:
    """Return whether a DO_REPOSITION has the flag that lets it change the mode."""
    flags = command.param2
    return math.isfinite(flags) and bool(int(flags) & mavlink.MAV_DO_REPOSITION_FLAGS_CHANGE_MODE)
