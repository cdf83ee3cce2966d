"""What the ArduPilot kinds share: modes, arming, the ground station failsafe and the time from power-on until ready.

As measured (docs/autopilots.md) unless a comment says otherwise. The paper's point (`kinematic.py`) derives from it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

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

BATTERY_LOW_AFTER_S = 10.0
"""Time below BATT_LOW_VOLT before the battery counts as low: BATT_LOW_TIMER's default (code)."""
BATTERY_PARAMETERS = (Parameter("BATT_LOW_VOLT", 10.5, 0.0, 100.0), Parameter("BATT_FS_LOW_ACT", 0.0, 0.0, 10.0))
"""Parameters of the battery's failsafe, with ArduCopter's defaults (code); the voltage 0 turns it off."""


@dataclass(slots=True)
class _Times:
    """When what an autopilot watches by time began or was last seen."""

    ready_s: float | None = None
    """When start-up ends; None: it has ended."""
    ground_station_s: float | None = None
    """When the ground station was last heard; None: not yet."""
    battery_low_s: float | None = None
    """When the battery fell below BATT_LOW_VOLT; infinity once that had its effect."""


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
    battery_modes: Mapping[int, int]
    """The mode to which a low battery leads, by BATT_FS_LOW_ACT; no mode is changed by others, such as 0."""
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
        self.warned = False
        self._times = _Times()
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
            self._times.ground_station_s = now_s

    def watch(self, now_s: float, has_fix: bool, battery_v: float, around: Surroundings) -> None:
        """Latch the warning of a low battery, and do what BATT_FS_LOW_ACT says of it."""
        if battery_v > self.values.get("BATT_LOW_VOLT", 0.0) or not self.armed:
            if self._times.battery_low_s != math.inf:
                self._times.battery_low_s = None
            return
        if self._times.battery_low_s is None:
            self._times.battery_low_s = now_s
        if now_s - self._times.battery_low_s < BATTERY_LOW_AFTER_S:
            return
        self._times.battery_low_s = math.inf
        self.texts += [f"Battery 1 is low {battery_v:.2f}V used 0 mAh", "Battery Failsafe"]
        mode = self.battery_modes.get(int(self.values["BATT_FS_LOW_ACT"]))
        if mode is not None and self.in_air:
            self._enter(mode, around)
        self.warned = True

    def reboot(self, now_s: float) -> None:
        """Restart in the first mode without setpoints; a vehicle in the air stays armed, as after a watchdog reset."""
        self.mode = self.first_mode
        self.failsafe = self.warned = False
        self._times = _Times()
        self._forget()
        self.boot(now_s)

    def boot(self, now_s: float) -> None:
        """Begin start-up: until the vehicle is ready, a mode that is set is acknowledged, and then lost."""
        self._times.ready_s = now_s + READY_AFTER_S

    @property
    def ready(self) -> bool:
        """Whether start-up has ended, so that the vehicle can be armed."""
        return self._times.ready_s is None

    def _forget(self) -> None:
        """Drop the setpoints and targets of the mode that ends."""

    def _mind_time(self, now_s: float, around: Surroundings) -> None:
        """Do what is due by time alone: end start-up, and trigger the ground station failsafe."""
        if self._times.ready_s is not None and now_s >= self._times.ready_s:
            self._times.ready_s = None
            if self.mode != self.first_mode:
                self._enter(self.first_mode, around)
            self.texts.append(READY_TEXT)
        heard_s = self._times.ground_station_s
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
