"""Commands that the autopilot acknowledges: each is resent until it is answered, and its outcome is recorded.

At most one command of each MAV_CMD number is unanswered at a time, because COMMAND_ACK names nothing but the number.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from pymavlink.dialects.v20 import common

from companion.autopilot.intake import Message
from companion.autopilot.telemetry import COMPANION_COMPONENT

SENDS = 3
"""Number of times that a command is sent before it counts as not answered."""
RESEND_S = 1.0
"""Time without an answer after which a command is sent again."""
COMMANDS_AT_ONCE = 2
"""Greatest number of commands sent in one call of `Commands.due`."""
MAX_WAITING = 20
"""Greatest number of commands that wait to be sent; further ones are dropped."""
_DEGREES_E7 = 1e7
_RESULTS = {
    common.MAV_RESULT_ACCEPTED: "accepted",
    common.MAV_RESULT_TEMPORARILY_REJECTED: "temporarily rejected",
    common.MAV_RESULT_DENIED: "denied",
    common.MAV_RESULT_UNSUPPORTED: "unsupported",
    common.MAV_RESULT_FAILED: "failed",
}
NO_ANSWER = "no answer"
"""Outcome of a command that was sent SENDS times without an answer."""
_MAY_CHANGE = common.MAV_RESULT_TEMPORARILY_REJECTED
"""The result after which a command is sent again, because the next answer may differ."""


@dataclass(frozen=True)
class Command:
    """One command, sent as COMMAND_INT if it has a `frame` (the reference of its altitude), else as COMMAND_LONG."""

    number: int
    """The command's MAV_CMD."""
    name: str
    """The command's name in messages about its failure."""
    params: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    """The command's parameters 1 to 4."""
    frame: int | None = None
    """The MAV_FRAME of a COMMAND_INT; None for a COMMAND_LONG."""
    place_deg: tuple[float, float] = (0.0, 0.0)
    """Latitude and longitude of a COMMAND_INT; a COMMAND_LONG ignores them."""
    altitude_m: float = 0.0
    key: float = 0.0
    """Distinguishes commands of one number: with the same key a new one replaces the old one, with another it waits."""

    def message(self, system_id: int, sends: int) -> Message:
        """Return the MAVLink message of the command, for its `sends`-th transmission (counted from 1)."""
        if self.frame is None:
            return common.MAVLink_command_long_message(
                system_id,
                common.MAV_COMP_ID_AUTOPILOT1,
                self.number,
                sends - 1,
                *self.params,
                0.0,
                0.0,
                self.altitude_m,
            )
        lat_deg, lon_deg = self.place_deg
        x, y = round(lat_deg * _DEGREES_E7), round(lon_deg * _DEGREES_E7)
        return common.MAVLink_command_int_message(
            system_id,
            common.MAV_COMP_ID_AUTOPILOT1,
            self.frame,
            self.number,
            0,
            0,
            *self.params,
            x,
            y,
            self.altitude_m,
        )


@dataclass
class _UnderWay:
    command: Command
    sends: int = 0
    sent_s: float = -math.inf


@dataclass
class Commands:
    """Sends commands to one autopilot and records their outcomes. Times are the caller's, in seconds of one clock."""

    outcomes: dict[tuple[int, float], tuple[str, str]] = field(default_factory=dict)
    """Name and outcome of the last answered command, by number and key."""
    _waiting: dict[tuple[int, float], Command] = field(default_factory=dict)
    _under_way: dict[int, _UnderWay] = field(default_factory=dict)
    _done: dict[int, Command] = field(default_factory=dict)

    @property
    def failures(self) -> tuple[str, ...]:
        """The commands that were not accepted, each as one short line with its outcome."""
        return tuple(f"{name}: {outcome}" for name, outcome in self.outcomes.values() if outcome != "accepted")

    def queue(self, command: Command) -> None:
        """Queue a command for sending; it replaces an unanswered one of the same number and key."""
        under_way = self._under_way.get(command.number)
        if under_way is not None and under_way.command.key == command.key:
            del self._under_way[command.number]
        if len(self._waiting) < MAX_WAITING or (command.number, command.key) in self._waiting:
            self._waiting[command.number, command.key] = command

    def clear(self) -> None:
        """Discard all commands that are not answered yet, so that they are not sent again."""
        self._waiting.clear()
        self._under_way.clear()

    def due(self, now_s: float, system_id: int) -> list[Message]:
        """Return the messages to send now: new commands, and those not answered in time."""
        for number, under_way in list(self._under_way.items()):
            if under_way.sends >= SENDS and now_s - under_way.sent_s >= RESEND_S:
                self._end(number, NO_ANSWER)
        for key, command in list(self._waiting.items()):
            if command.number not in self._under_way:
                self._under_way[command.number] = _UnderWay(command)
                del self._waiting[key]
        messages: list[Message] = []
        for under_way in self._under_way.values():
            if now_s - under_way.sent_s >= RESEND_S and len(messages) < COMMANDS_AT_ONCE:
                under_way.sends += 1
                under_way.sent_s = now_s
                messages.append(under_way.command.message(system_id, under_way.sends))
        return messages

    def take(self, message: Message, system_id: int) -> None:
        """Record a COMMAND_ACK that is addressed to this companion or to everyone; ignore others."""
        meant = message.target_system in (0, system_id) and message.target_component in (0, COMPANION_COMPONENT)
        if not meant or message.result not in _RESULTS:
            return
        outcome = _RESULTS[message.result]
        if message.command in self._under_way:
            if message.result != _MAY_CHANGE or self._under_way[message.command].sends >= SENDS:
                self._end(message.command, outcome)
        elif message.command in self._done:
            # PX4 acknowledges some commands twice, and the last one counts.
            self._note(self._done[message.command], outcome)

    def _end(self, number: int, outcome: str) -> None:
        command = self._under_way.pop(number).command
        self._done[number] = command
        self._note(command, outcome)

    def _note(self, command: Command, outcome: str) -> None:
        self.outcomes[command.number, command.key] = (command.name, outcome)
