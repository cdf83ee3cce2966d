"""A stand-in autopilot's side of MAVLink's command protocol."""

from __future__ import annotations

import math
from collections.abc import Callable

from pymavlink.dialects.v20 import common as mavlink

from sim.mavlink_sender import MavlinkSender
from sim.vehicles.craft import Answer, Command, Home, Message
from sim.vehicles.dynamics import FlightDynamics
from sim.vehicles.setpoint import SANE_POSITION_M
from sim.vehicles.telemetry import Telemetry


class CommandProtocol:
    """Passes commands to the craft, and answers by itself those that every autopilot answers alike."""

    def __init__(
        self,
        dynamics: FlightDynamics,
        telemetry: Telemetry,
        sender: MavlinkSender,
        move_home: Callable[[Home], None],
    ) -> None:
        """Handle the commands for the vehicle of `dynamics`, with replies made by `telemetry` and `sender`.

        `move_home` sets home anew.
        """
        self._move_home = move_home
        self._dynamics = dynamics
        self._craft = dynamics.craft
        self._telemetry = telemetry
        self._sender = sender

    def on_command_long(self, message: Message, t_s: float) -> list[bytes]:
        """Execute a COMMAND_LONG at the time `t_s`; return the replies as frames."""
        command = Command(
            message.command,
            *(message.param1, message.param2, message.param3, message.param4),
            *(message.param5, message.param6, message.param7),
            int_frame=False,
        )
        return self._answer(command, message, t_s)

    def on_command_int(self, message: Message, t_s: float) -> list[bytes]:
        """Execute a COMMAND_INT at the time `t_s`; return the replies as frames."""
        command = Command(
            message.command,
            *(message.param1, message.param2, message.param3, message.param4),
            *(message.x, message.y, message.z),
            int_frame=True,
            frame=message.frame,
        )
        return self._answer(command, message, t_s)

    def _answer(self, command: Command, message: Message, t_s: float) -> list[bytes]:
        answer, told = self._obey(command, t_s)
        frames: list[bytes] = []
        if answer is None:
            result, requested = self._serve(command, t_s)
            answer, told = Answer((result,)), requested
        for result in answer.results:
            ack = self._sender.mav.command_ack_encode(
                command.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
            )
            frames.append(self._sender.pack(ack))
        frames += [self._telemetry.text(text, mavlink.MAV_SEVERITY_CRITICAL) for text in answer.texts]
        return frames + told

    def _obey(self, command: Command, t_s: float) -> tuple[Answer | None, list[bytes]]:
        """Let the craft execute a command; return its answer, and the heartbeat that announces a new state, if any."""
        before = self._telemetry.heartbeat_state()
        answer = self._craft.command(command, self._dynamics.surroundings(), t_s)
        return answer, self._telemetry.announce_change(before, t_s)

    def _serve(self, command: Command, t_s: float) -> tuple[int, list[bytes]]:
        """Execute a command that every autopilot handles alike; return the MAV_RESULT and the messages requested."""
        if command.command == mavlink.MAV_CMD_REQUEST_MESSAGE:
            known = math.isfinite(command.param1) and self._telemetry.encoder.knows(int(command.param1))
            if not known:
                return mavlink.MAV_RESULT_UNSUPPORTED, []
            return mavlink.MAV_RESULT_ACCEPTED, [self._telemetry.message(int(command.param1), t_s)]
        if command.command == mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
            return mavlink.MAV_RESULT_ACCEPTED, [self._telemetry.message(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION, t_s)]
        if command.command == mavlink.MAV_CMD_DO_SET_HOME:
            return self._set_home(command), []
        if command.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            return self._set_message_interval(command, t_s), []
        return mavlink.MAV_RESULT_UNSUPPORTED, []

    def _set_home(self, command: Command) -> int:
        """Set home to the vehicle's place or to the command's; obeyed armed and in flight too (measured)."""
        if command.param1 == 1.0:
            body = self._craft.body
            self._move_home(Home(body.north_m, body.east_m, body.altitude_m))
            return int(mavlink.MAV_RESULT_ACCEPTED)
        scale = 1e-7 if command.int_frame else 1.0
        place_m = self._dynamics.place_on_earth(command.x * scale, command.y * scale)
        if place_m is None or not abs(command.z) < SANE_POSITION_M:
            return int(mavlink.MAV_RESULT_DENIED)
        self._move_home(Home(*place_m, command.z))
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def _set_message_interval(self, command: Command, t_s: float) -> int:
        message_id, interval_us = command.param1, command.param2
        if not (math.isfinite(message_id) and math.isfinite(interval_us)):
            return int(mavlink.MAV_RESULT_DENIED)
        # Accepted for an unknown message too: ground stations request streams that not every autopilot has.
        if message_id.is_integer() and self._telemetry.streamable(int(message_id)):
            self._telemetry.streams.set_interval(int(message_id), interval_us, t_s)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def on_request_data_stream(self, message: Message, t_s: float) -> list[bytes]:
        """Set the rate of a group of streams, as ArduPilot does; PX4 has no such groups."""
        if self._craft.mav_autopilot != mavlink.MAV_AUTOPILOT_PX4:
            rate_hz = float(message.req_message_rate) if message.start_stop else 0.0
            self._telemetry.streams.set_group(message.req_stream_id, rate_hz, t_s)
        return []

    def on_set_mode(self, message: Message, t_s: float) -> list[bytes]:
        """Execute a SET_MODE, which is not acknowledged; return the heartbeat that announces a new mode, if any."""
        if not message.base_mode & mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED:
            return []
        mode, sub_mode = message.custom_mode, 0
        if self._craft.mav_autopilot == mavlink.MAV_AUTOPILOT_PX4:
            mode, sub_mode = message.custom_mode >> 16 & 0xFF, message.custom_mode >> 24
        parameters = (mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, mode, sub_mode, 0.0, 0.0, 0.0, 0.0)
        return self._obey(Command(mavlink.MAV_CMD_DO_SET_MODE, *parameters, int_frame=False), t_s)[1]
