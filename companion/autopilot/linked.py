"""The base class of the adapters of linked autopilots: telemetry, identification, parameters and message rates.

A companion sends as the onboard computer of its autopilot's system, so it uses the system id of the autopilot it hears.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Collection, Mapping

from pymavlink.dialects.v20 import common

from companion.autopilot.adapter import Abilities, SetpointFrame, Velocity
from companion.autopilot.aircraft import Neighbour
from companion.autopilot.commands import Command, Commands
from companion.autopilot.dialogue import Dialogue
from companion.autopilot.firmware import ENDINGS, FAMILIES, SWITCHES, Firmware, firmware_of, known
from companion.autopilot.heartbeat import HeartbeatIdentity
from companion.autopilot.identity import STANDS_STILL, Identity
from companion.autopilot.intake import DAMAGED, decode, is_whole
from companion.autopilot.parameter_checks import ParameterCheck
from companion.autopilot.parameters import ParameterReader, Wanted, request
from companion.autopilot.streams import IF_ANY, RESTS_ON, SPARSE, Shortfall, StreamWatch, message_name
from companion.autopilot.telemetry import (
    HEARTBEAT_TIMEOUT_S,
    Telemetry,
    TelemetryReader,
)
from companion.guard.types import Setpoint
from companion.protocol.frame import RawFrame, raw_frames

COMMON_RATES_HZ: Mapping[int, float] = {
    common.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
    common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    common.MAVLINK_MSG_ID_ATTITUDE: 10.0,
    common.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
    common.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
    common.MAVLINK_MSG_ID_GPS_RAW_INT: 1.0,
    common.MAVLINK_MSG_ID_GPS2_RAW: 1.0,
    common.MAVLINK_MSG_ID_HOME_POSITION: 0.2,
    common.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: 0.2,
}
"""The messages that every adapter requests, by message id, and their rates."""
ADSB_RATE_HZ = 10.0
"""Rate of ADSB_VEHICLE that ArduPilot is asked for: at each of these times it sends one of those that it knows, and
begins with the first again after a second at the earliest."""
ADSB_TYPE = "ADSB_TYPE"
"""ArduPilot's parameter that says which ADS-B receiver is mounted."""
NO_RECEIVER = 0.0
"""Value of ADSB_TYPE without a receiver."""
WIND_RATE_HZ = 1.0
"""Rate of the wind's message, which kinds name differently."""
AIRSPEED_RATE_HZ = 2.0
"""Rate of VFR_HUD, from a vehicle that has an airspeed."""
HEIGHT_GAIN_1_S = 0.5
"""Commanded vertical speed per metre of height error."""
VERTICAL_SPEED_M_S = 2.0
"""Greatest commanded vertical speed."""
COURSE_SPEED_M_S = 1.0
"""Ground speed below which the course over ground is noise and the yaw is used instead."""
_UINT32 = 2**32


class LinkedAdapter(ABC):
    """An adapter without its steering: each kind implements `encode` and `abilities`."""

    identity: HeartbeatIdentity
    parameter_checks: tuple[ParameterCheck, ...] = ()
    wanted: tuple[Wanted, ...] = ()
    rates_hz: Mapping[int, float] = COMMON_RATES_HZ
    steers_in_local_frame = False
    """Whether setpoints hold places in the autopilot's local frame; velocities are about no origin."""
    rests_on: Mapping[int, str] = RESTS_ON
    """What safety rests on, by the message that tells it."""

    def __init__(self, system_id: int | None = None) -> None:
        """Steer the autopilot of this kind with this system id; None steers the only one that is heard."""
        self.kind = self.identity.kind.name
        self.parameters = ParameterReader(self.wanted, bytewise=self.identity.autopilot == common.MAV_AUTOPILOT_PX4)
        self.rejected: Counter[str] = Counter()
        """The number of rejected messages, by reason."""
        self._identity = Identity(self.identity, system_id, self.rejected)
        self._reader = TelemetryReader(self.rejected)
        self._message_ids = self._reader.message_ids | {
            *self.rates_hz,
            common.MAVLINK_MSG_ID_PARAM_VALUE,
            common.MAVLINK_MSG_ID_COMMAND_ACK,
            common.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
        }
        self._message_intervals = Commands()
        self._commands = Commands()
        self._dialogue = Dialogue()
        self.firmware: Firmware | None = None
        """The autopilot's firmware; None until it tells it, for which it is asked by `ask_further`."""
        self._streams = StreamWatch(self.rates_hz, self.rests_on)
        self._heard_after: int | None = None
        """Number of the autopilot's restarts that the streams and parameters know of; None before it is heard."""

    @property
    def can_stop(self) -> bool:
        """Whether the vehicle can stop and hold its position."""
        return self.identity.kind.can_stop

    @property
    def resumes_on_stream(self) -> bool:
        """Whether the autopilot re-enters its guided mode by itself when a stream of setpoints comes back."""
        return self.identity.kind.resumes_on_stream

    @property
    def telemetry(self) -> Telemetry:
        """The newest telemetry of the autopilot."""
        return self._reader.telemetry

    @property
    def neighbours(self) -> Collection[Neighbour]:
        """The aircraft that the vehicle's own detector has seen."""
        return self._reader.neighbours.values()

    @property
    def sees_others(self) -> bool | None:
        """Whether the vehicle has a detector: True once it showed anybody, False if it has none, None if not known."""
        # Whoever was seen stays there until another is.
        if self._reader.neighbours:
            return True
        return False if self.parameters.values.get(ADSB_TYPE) == NO_RECEIVER else None

    @property
    def steerable(self) -> bool:
        """Whether a safety pilot has armed the vehicle and put it into the mode that obeys setpoints."""
        return self.telemetry.armed and self.telemetry.custom_mode == self.identity.guided_mode

    @property
    def parameters_known(self) -> bool:
        """Whether each wanted parameter was received, or requested in vain for the last time."""
        return self.parameters.all_known

    @property
    def failures(self) -> tuple[str, ...]:
        """The requests and commands that the autopilot did not accept, each as one short line."""
        return self._refused() + self._commands.failures

    @property
    def asks_for_others(self) -> bool:
        """Whether the autopilot sends what its detector shows only when it is asked."""
        return common.MAVLINK_MSG_ID_ADSB_VEHICLE in self.rates_hz

    @property
    def missing_telemetry(self) -> str | None:
        """The telemetry that this kind needs for steering and lacks; none, unless a kind needs more than positions."""
        return None

    @property
    def refusal(self) -> str | None:
        """The reason why this autopilot is not steered at all, and the remedy; None if it may be steered."""
        return self._identity.refusal

    @property
    def unusual(self) -> str | None:
        """What is unusual of the frames that the autopilot sends, in words; None if nothing is."""
        return self._dialogue.note()

    @property
    def beside(self) -> str | None:
        """Which other autopilots are heard on the link, in words; None if there are none."""
        return self._identity.beside

    @property
    def abilities(self) -> Abilities:
        """The vehicle's performance limits; without parameters there are none."""
        return Abilities()

    def receive(self, datagram: bytes, now_s: float) -> int:
        """Process whole frames from the autopilot link: telemetry, parameters and command acknowledgements.

        Returns how many of them were read: the autopilot's own, and newer than what it said before.
        """
        return sum(self._take(frame, now_s) for frame in raw_frames(datagram) if frame.message_id in self._message_ids)

    def requests(self, now_s: float) -> list[bytes]:
        """Return the requests for message rates and parameters that are due; all are due again after a restart."""
        telemetry = self.telemetry
        if telemetry.heartbeat_at_s is None or self.refusal is not None:
            return []
        for message_id in self._streams.due(now_s, self._reader.seen_s):
            self._message_intervals.queue(_interval(message_id, self.rates_hz[message_id]))
        questions = [
            *self._message_intervals.due(now_s, self._system_id),
            *(request(name, self._system_id) for name in self.parameters.due(now_s)),
        ]
        if self._dialogue.asked(len(questions), now_s):
            self.parameters.restart()
        return [self._pack(message) for message in questions]

    def silence(self, now_s: float) -> str | None:
        """Return in words that the autopilot is heard and answers nothing, and the remedy; None if it answers."""
        return self._dialogue.silence(now_s)

    def note_signed(self) -> bool:
        """Note that the autopilot signs its frames; return whether that is new."""
        is_new, self._dialogue.signed = not self._dialogue.signed, True
        return is_new

    def ask_further(self) -> None:
        """Ask for what only a check before the flight needs: the firmware, and what ends the guided mode by itself."""
        names = ENDINGS.get(FAMILIES.get(self.kind, ""), ())
        rows = [row for name in names if (row := known(self.kind, name)) is not None]
        self.parameters.add(Wanted(row.name, row.default, optional=True, switch=SWITCHES.get(row.name)) for row in rows)
        params = (float(common.MAVLINK_MSG_ID_AUTOPILOT_VERSION), 0.0, 0.0, 0.0)
        self._message_intervals.queue(Command(common.MAV_CMD_REQUEST_MESSAGE, "AUTOPILOT_VERSION", params))

    def shortfalls(self, now_s: float) -> tuple[Shortfall, ...]:
        """Return what safety rests on and arrives much more seldom than asked; none while nothing is heard."""
        return self._streams.shortfalls(now_s)

    def too_seldom(self, timeout_s: float, now_s: float) -> str | None:
        """Return which message comes too seldom to steer by, with its rates; None if none does or nothing is heard.

        `timeout_s`: the age beyond which a position is not steered by.
        """
        return self._streams.too_seldom(self._ages_s(timeout_s), now_s)

    def streams_measured(self, now_s: float, within_s: float) -> bool:
        """Return whether the rate of each message was measured, but for those for which that takes over `within_s`."""
        return self._streams.measured(now_s, within_s)

    @abstractmethod
    def encode(self, setpoint: Setpoint, convergence_rad: float, now_s: float) -> list[bytes]:
        """Return the frames that command a setpoint, whose heading is from grid north."""

    def hold(self, now_s: float) -> list[bytes]:
        """Return no frames: autopilots other than PX4 need no setpoint stream before the guided mode."""
        return []

    def release(self) -> None:
        """Forget the unanswered commands of the engagement that ended."""
        self._commands.clear()

    def heartbeat(self) -> bytes:
        """Return the companion's HEARTBEAT as an onboard controller: one of a ground station would mask its loss."""
        return self._pack(
            common.MAVLink_heartbeat_message(
                type=common.MAV_TYPE_ONBOARD_CONTROLLER,
                autopilot=common.MAV_AUTOPILOT_INVALID,
                base_mode=0,
                custom_mode=0,
                system_status=common.MAV_STATE_ACTIVE,
                mavlink_version=3,
            )
        )

    def _take(self, frame: RawFrame, now_s: float) -> bool:
        """Process a frame of a message that is read; return whether it is the autopilot's and newer than before."""
        if not is_whole(frame):
            self.rejected[DAMAGED] += 1
            return False
        reason, at_s = self._identity.take(frame, now_s)
        self._reader.note_restarts(self._identity.restarts)
        if reason in (None, STANDS_STILL):
            if self._heard_after != self.telemetry.restarts:
                self._begin(now_s)
            self._streams.arrived(frame.message_id, now_s)
        message = decode(frame) if reason is None else None
        if message is None:
            return False
        self._dialogue.heard(frame.version)
        if frame.message_id == common.MAVLINK_MSG_ID_PARAM_VALUE:
            self._dialogue.answered()
            self.parameters.take(message)
        elif frame.message_id == common.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
            self.firmware = firmware_of(self.kind, message.flight_sw_version)
        elif frame.message_id == common.MAVLINK_MSG_ID_COMMAND_ACK:
            self._dialogue.answered()
            self._message_intervals.take(message, self._system_id)
            self._commands.take(message, self._system_id)
        else:
            self._reader.take(message, at_s)
        return True

    def _ages_s(self, timeout_s: float) -> dict[int, float]:
        """Return the ages beyond which a message is not steered by, by message id."""
        return {
            common.MAVLINK_MSG_ID_HEARTBEAT: HEARTBEAT_TIMEOUT_S,
            common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: timeout_s,
        }

    def _begin(self, now_s: float) -> None:
        """Ask for everything anew: the autopilot is first heard, or has restarted."""
        if self._heard_after is not None:
            self.parameters.restart()
            self._dialogue.restart()
        self._heard_after = self.telemetry.restarts
        self._streams.begin(now_s)

    def _refused(self) -> tuple[str, ...]:
        """Return the questions for rates that the autopilot did not accept, each as one short line.

        What arrives as it was asked for is no failure, whatever the answer was. A board without ADS-B refuses that: it
        is no failure, but a vehicle without a detector.
        """
        arriving = {message_id for message_id in self.rates_hz if self._streams.arrives(message_id)}
        told = {_interval(message_id, 1.0).name for message_id in set(self.rates_hz) - SPARSE - IF_ANY - arriving}
        return tuple(one for one in self._message_intervals.failures if one.partition(": ")[0] in told)

    @property
    def _system_id(self) -> int:
        return self.telemetry.system_id or 0

    def _course_rad(self) -> float | None:
        """Return the course over ground from local true north, or the yaw below COURSE_SPEED_M_S."""
        telemetry = self.telemetry
        north_m_s, east_m_s = telemetry.velocity_north_m_s, telemetry.velocity_east_m_s
        if math.hypot(north_m_s, east_m_s) >= COURSE_SPEED_M_S:
            return math.atan2(east_m_s, north_m_s)
        return telemetry.yaw_rad

    def _climb_m_s(self, height_m: float) -> float:
        """Return the vertical speed to command, positive upwards, to reach a height above home."""
        climb_m_s = HEIGHT_GAIN_1_S * (height_m - self.telemetry.height_m)
        return min(max(climb_m_s, -VERTICAL_SPEED_M_S), VERTICAL_SPEED_M_S)

    def _pack(self, message: common.MAVLink_message) -> bytes:
        # A companion shares its autopilot's system id, which is known once a heartbeat was heard.
        return self._dialogue.packed(message, self.telemetry.system_id or 1)

    def _local_target(
        self,
        type_mask: int,
        now_s: float,
        velocity_m_s: tuple[float, float, float] = (0.0, 0.0, 0.0),
        place_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
        yaw_rad: float = 0.0,
    ) -> list[bytes]:
        """Return SET_POSITION_TARGET_LOCAL_NED with vectors (north, east, down); no frame if a value is not finite."""
        if not all(map(math.isfinite, (*velocity_m_s, *place_m, yaw_rad))):
            return []
        message = common.MAVLink_set_position_target_local_ned_message(
            milliseconds(now_s),
            self._system_id,
            common.MAV_COMP_ID_AUTOPILOT1,
            common.MAV_FRAME_LOCAL_NED,
            type_mask,
            *place_m,
            *velocity_m_s,
            0.0,
            0.0,
            0.0,
            yaw_rad,
            0.0,
        )
        return [SetpointFrame(self._pack(message), Velocity(*velocity_m_s, yaw_rad))]


def is_usable(setpoint: Setpoint, convergence_rad: float) -> bool:
    """Return whether a setpoint may be sent: all its values must be finite."""
    values = (setpoint.heading_rad, setpoint.speed_m_s, setpoint.altitude_m, convergence_rad)
    return all(map(math.isfinite, values))


def milliseconds(now_s: float) -> int:
    """Return a time in milliseconds, wrapped to the 32 bits of a setpoint's time_boot_ms."""
    return int(now_s * 1000.0) % _UINT32


def _interval(message_id: int, rate_hz: float) -> Command:
    return Command(
        common.MAV_CMD_SET_MESSAGE_INTERVAL,
        f"rate of {message_name(message_id)}",
        (float(message_id), round(1e6 / rate_hz), 0.0, 0.0),
        key=float(message_id),
    )
