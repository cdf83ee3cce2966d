"""A companion under test: real frames go in; decisions, setpoints and reasons come out."""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import common

from companion.autopilot.adapter import Abilities
from companion.autopilot.arducopter import ArduCopterAdapter
from companion.autopilot.boot_clock import BootClock, Clocked
from companion.autopilot.heartbeat import ARDUCOPTER
from companion.autopilot.linked import LinkedAdapter
from companion.autopilot.px4_copter import Px4CopterAdapter
from companion.autopilot.registry import ADAPTERS
from companion.geo.local_frame import LocalFrame
from companion.mission.model import CostWeights
from companion.onboard.authority import State
from companion.onboard.companion import Companion
from companion.onboard.config import Config, LimitsSection, StalenessSection
from companion.onboard.decision import Decision
from companion.onboard.references import ACCELERATION_M_S2
from companion.protocol.codec import (
    THREATS_PER_FRAME,
    AgentEntry,
    BandEntry,
    BandsFrame,
    Directive,
    FrameWriter,
    Stamp,
    StateFrame,
    TargetEntry,
    ThreatEntry,
    frame_resolution_cm,
)

ME = 3
SYSTEM = 9
EPOCH_S = 1_790_000_000
NOW_S = EPOCH_S + 100.0
ORIGIN_DEG = (47.0, 8.0)
ALTITUDE_M = 530.0
"""Altitude of a vehicle 30 m above home."""
HOME_ALTITUDE_M = 500.0
FRAME = LocalFrame(*ORIGIN_DEG)
GUIDED_MODE = ARDUCOPTER.guided_mode
GUIDED = common.MAV_MODE_FLAG_SAFETY_ARMED | common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
CONFIG = Config(
    agent_id=ME,
    limits=LimitsSection(speed_m_s=10.0, n_max=1.0, range_m=50_000.0),
    weights=CostWeights(k_d=1e6, k_a=1e6, k_c=1e5, k_l=1e5),
    arrival_radius_m=100.0,
    separation_m=20.0,
    staleness=StalenessSection(coasting_after_s=15.0, loitering_after_s=60.0, blind_after_s=300.0),
)


class ObedientCopter(ArduCopterAdapter):
    """An ArduCopter adapter without limits or lag of its own, so that the setpoints show the companion's doing."""

    wanted = ()
    rates_hz: dict[int, float] = {}
    abilities = Abilities()

    def _heading_rad(self, wanted_rad: float, speed_m_s: float, now_s: float) -> float:
        return wanted_rad


class ObedientPx4(Px4CopterAdapter):
    """A PX4 adapter without limits or lag, whose vehicle obeys again by itself when setpoints come back."""

    wanted = ()
    rates_hz: dict[int, float] = {}
    abilities = Abilities()

    def _heading_rad(self, wanted_rad: float, speed_m_s: float, now_s: float) -> float:
        return wanted_rad


_OBEDIENT = {"arducopter": ObedientCopter, "px4-copter": ObedientPx4}


def adapter_of(kind: str) -> LinkedAdapter:
    return _OBEDIENT[kind](SYSTEM) if kind in _OBEDIENT else ADAPTERS[kind](SYSTEM)


KINDS = ("arducopter", "kinematic")
"""A kind of autopilot that can stop, and one that cannot."""


class LeapingClock(BootClock):
    """Lets a vehicle be elsewhere at once: the time that its way took counts as passed for the autopilot's clock."""

    leaped_s = 0.0

    def take(self, boot_ms: int, now_s: float) -> Clocked:
        return super().take(boot_ms, now_s + self.leaped_s)


class Flight:
    """A companion whose autopilot and broadcast the test plays."""

    def __init__(self, config: Config = CONFIG, kind: str = "arducopter", was: State = State.WAITING) -> None:
        adapter = adapter_of(kind)
        self.companion = Companion(config, adapter, was=was)
        self._clock = adapter._identity._clock = LeapingClock()
        self.identity = adapter.identity
        self.boot_ms = 60_000
        self.now_s = NOW_S
        self.sequence = 0
        self._modes: tuple[int, int, int] | None = None
        self._here_m: tuple[float, float, float] | None = None
        self._here_s = NOW_S
        self._writer = FrameWriter()
        self._autopilot = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=common.MAV_COMP_ID_AUTOPILOT1)

    def heartbeat(
        self, base_mode: int = GUIDED, custom_mode: int | None = None, state: int = common.MAV_STATE_ACTIVE
    ) -> None:
        """Send a heartbeat with mode and state; it shows the guided mode unless told otherwise."""
        custom_mode = self.identity.guided_mode if custom_mode is None else custom_mode
        self._modes = (base_mode, custom_mode, state)
        self.tell(
            common.MAVLink_heartbeat_message(
                common.MAV_TYPE_QUADROTOR,
                self.identity.autopilot,
                base_mode,
                custom_mode,
                state,
                3,
            )
        )

    def position(
        self,
        north_m: float = 0.0,
        east_m: float = 0.0,
        velocity: tuple[float, float] = (0.0, 0.0),
        hdg: int = 0,
        height_mm: int = 30_000,
        *,
        jumps: bool = False,
    ) -> None:
        """Send a position; the autopilot's clock goes on by the time that the way from the last one takes, if longer.

        With `jumps` it goes on by a tenth of a second only.
        """
        if self._modes is not None:
            # An autopilot says both all the time.
            self.heartbeat(*self._modes)
        lat_deg, lon_deg = FRAME.to_global(north_m, east_m)
        here_m = (north_m, east_m, 1e-3 * height_mm)
        before_m = self._here_m or here_m
        way_m = 0.0 if jumps else math.dist(here_m, before_m)
        passed_s, self._here_s = self.now_s - self._here_s, self.now_s
        flown_m = (before_m[0] + velocity[0] * passed_s, before_m[1] + velocity[1] * passed_s, before_m[2])
        self._here_m = here_m
        if not jumps and math.dist(here_m, flown_m) > 1.0:
            # Whatever its velocity was before.
            takes_s = math.sqrt(2.0 * way_m / ACCELERATION_M_S2) + 4.0 * math.hypot(*velocity) / ACCELERATION_M_S2
            self.boot_ms += math.ceil(1e3 * takes_s)
            self._clock.leaped_s += takes_s
        elif not jumps:
            self.boot_ms += max(0, round(1e3 * passed_s) - 100)
        self.boot_ms += 100
        vx, vy = (round(100 * speed) for speed in velocity)
        self.tell(
            common.MAVLink_global_position_int_message(
                self.boot_ms,
                *(round(lat_deg * 1e7), round(lon_deg * 1e7), round(1e3 * HOME_ALTITUDE_M) + height_mm, height_mm),
                *(vx, vy, 0, hdg),
            )
        )

    def move_home(self, up_mm: int, height_mm: int = 30_000) -> None:
        """Tell of a vehicle that stands, a tenth of a second later, whose home was moved, without HOME_POSITION."""
        self.boot_ms += 100
        place = (round(FRAME.lat_deg * 1e7), round(FRAME.lon_deg * 1e7))
        altitude_mm = round(1e3 * HOME_ALTITUDE_M) + height_mm
        self.tell(
            common.MAVLink_global_position_int_message(
                self.boot_ms, *place, altitude_mm, height_mm - up_mm, *(0, 0, 0, 0)
            )
        )

    def landed(self, state: int = common.MAV_LANDED_STATE_ON_GROUND) -> None:
        self.tell(common.MAVLink_extended_sys_state_message(common.MAV_VTOL_STATE_UNDEFINED, state))

    def battery(self, percent: int) -> None:
        self.tell(common.MAVLink_sys_status_message(*(0, 0, 0, 500, 12_000, -1, percent, 0, 0, 0, 0, 0, 0)))

    def gps(self, fix: int = 3, accuracy_m: float = 1.0) -> None:
        accuracy_mm = round(1e3 * accuracy_m)
        self.tell(common.MAVLink_gps_raw_int_message(*(0, fix, 0, 0, 0, 100, 100, 0, 0, 12), h_acc=accuracy_mm))

    def home(self, north_m: float, east_m: float) -> None:
        lat_deg, lon_deg = FRAME.to_global(north_m, east_m)
        self.tell(
            common.MAVLink_home_position_message(
                round(lat_deg * 1e7), round(lon_deg * 1e7), 500_000, 0, 0, 0, [1.0, 0.0, 0.0, 0.0], 0, 0, 0
            )
        )

    def broadcast(
        self,
        target: tuple[float, float] | None = (5_000.0, 0.0),
        *,
        directive: Directive = Directive.NORMAL,
        own: Directive = Directive.NORMAL,
        threats: tuple[ThreatEntry, ...] = (),
        agents: tuple[AgentEntry, ...] = (),
        revision: int = 1,
        lost: tuple[int, ...] = (),
        is_last: bool = False,
    ) -> None:
        """Broadcast a state in frames of four threats; `lost` are the indices of those that do not arrive.

        `own` is the directive for this vehicle alone. The ground station stops after a broadcast that `is_last`.
        """
        self.sequence += 1
        targets = () if target is None else (TargetEntry(4, *target),)
        me = AgentEntry(ME, 0.0, 0.0, 4 if targets else None, own)
        parts = [threats[k : k + THREATS_PER_FRAME] for k in range(0, max(1, len(threats)), THREATS_PER_FRAME)]
        points = [one.position_ned_m for one in agents]
        points += [(one.north_m, one.east_m) for one in (*targets, *threats)]
        unit_cm = frame_resolution_cm([p for p in points if p is not None], [one.detection_radius_m for one in threats])
        for index, part in enumerate(parts):
            stamp = Stamp(EPOCH_S, round((self.now_s - EPOCH_S) * 1000), self.sequence, index, len(parts))
            frame = StateFrame(
                stamp,
                *ORIGIN_DEG,
                directive,
                revision,
                len(threats),
                len(targets),
                unit_cm,
                (me, *agents),
                targets,
                part,
                is_last,
            )
            if index not in lost:
                self.hear(self._writer.encode(frame))

    def bands(self, *bands: BandEntry) -> None:
        """Broadcast the heights of the threats of the last state frame."""
        stamp = Stamp(EPOCH_S, round((self.now_s - EPOCH_S) * 1000), self.sequence)
        self.hear(self._writer.encode(BandsFrame(stamp, bands)))

    def neighbour(
        self,
        north_m: float,
        east_m: float,
        velocity: tuple[float, float] = (0.0, 0.0),
        *,
        callsign: bytes = b"OW00012",
        address: int = 0xABC,
        above_m: float | None = None,
    ) -> None:
        """Let the vehicle's own detector report another vehicle, with a velocity relative to true north."""
        lat_deg, lon_deg = FRAME.to_global(north_m, east_m)
        course_rad, speed_m_s = math.atan2(velocity[1], velocity[0]), math.hypot(*velocity)
        valid = (
            common.ADSB_FLAGS_VALID_COORDS
            | common.ADSB_FLAGS_VALID_HEADING
            | common.ADSB_FLAGS_VALID_VELOCITY
            | common.ADSB_FLAGS_VALID_CALLSIGN
        )
        if above_m is not None:
            valid |= common.ADSB_FLAGS_VALID_ALTITUDE
        altitude_mm = round(1e3 * (ALTITUDE_M + (above_m or 0.0)))
        altitude_type = common.ADSB_ALTITUDE_TYPE_GEOMETRIC
        place = (address, round(lat_deg * 1e7), round(lon_deg * 1e7), altitude_type, altitude_mm)
        motion = (round(math.degrees(course_rad) * 100) % 36_000, round(speed_m_s * 100), 0)
        self.tell(common.MAVLink_adsb_vehicle_message(*place, *motion, callsign, 14, 0, valid, 0))

    def tick(self) -> tuple[Decision, common.MAVLink_message | None]:
        """Let the companion decide; return the decision and the setpoint sent with it, if any."""
        decision, datagrams = self.companion.tick(self.now_s)
        messages = [common.MAVLink(None).parse_buffer(bytearray(datagram))[0] for datagram in datagrams]
        setpoints = [m for m in messages if m.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]
        assert len(setpoints) <= 1
        assert {m.get_type() for m in messages} <= {"SET_POSITION_TARGET_LOCAL_NED", "HEARTBEAT"}
        return decision, setpoints[0] if setpoints else None

    def at(
        self, north_m: float = 0.0, east_m: float = 0.0, velocity: tuple[float, float] = (0.0, 0.0), hdg: int = 0
    ) -> tuple[Decision, common.MAVLink_message | None]:
        """Send a position, then let the companion decide."""
        self.position(north_m, east_m, velocity, hdg)
        return self.tick()

    @staticmethod
    def parsed(frames: list[bytes]) -> list[common.MAVLink_message]:
        """Return the setpoints among frames."""
        messages = common.MAVLink(None).parse_buffer(b"".join(frames)) or []
        return [message for message in messages if message.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]

    def hear(self, frame: bytes) -> None:
        self.companion.hear(frame, self.now_s)

    def tell(self, message: common.MAVLink_message) -> None:
        self.companion.receive(bytes(message.pack(self._autopilot)), self.now_s)


def guided(config: Config = CONFIG, kind: str = "arducopter") -> Flight:
    """Return a flight whose vehicle the safety pilot has armed, flown and handed over."""
    flight = Flight(config, kind)
    flight.heartbeat()
    flight.position()
    return flight
