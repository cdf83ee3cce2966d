"""A companion, a stand-in autopilot and other programs on its link, on a virtual clock and without a network."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from companion.autopilot.kinds import CRUISE_M_S, KINDS
from companion.geo.local_frame import LocalFrame
from companion.onboard.companion import Companion
from companion.onboard.config import Config, parse_config
from companion.onboard.decision import Decision, Purpose
from companion.protocol.codec import AgentEntry, Directive, FrameWriter, Stamp, StateFrame, TargetEntry
from sim.faults.scene import DEMANDED
from sim.safety_pilot import SafetyPilot
from sim.vehicles import CRAFTS, Home, Setup, StandIn

EPOCH_S = 1_790_000_000
TICK_S = 0.1
ORIGIN_DEG = (47.0, 8.0)
GROUND_M = 500.0
HEIGHT_M = 60.0
TARGET_M = 20_000.0
"""Distance to the target, north: farther than any of these flights goes."""


def config_of(kind: str, more: str = "", limits: str = "") -> Config:
    """Return a configuration that fits the kind as its stand-in comes; `more`: lines, `limits`: keys to add."""
    speed_m_s, braking = CRUISE_M_S[kind], ""
    if KINDS[kind].can_stop:
        speed_m_s, braking = min(speed_m_s, 8.0), ", braking_m_s2: 2"
    return parse_config(
        f"agent_id: 1\nautopilot: {{kind: {kind}, link: 'udpin:127.0.0.1:14550'}}\n"
        "broadcast: {link: 'udpin:127.0.0.1:14600', trust: unsigned}\n"
        f"limits: {{speed_m_s: {speed_m_s}, n_max: 0.15, range_m: 100000{braking}{limits}}}\n"
        f"height_m: {HEIGHT_M}\nseparation_m: 20\narrival_radius_m: 50\n{more}",
        "field.yaml",
    )


STREAMS = (
    mavlink.MAVLINK_MSG_ID_SYS_STATUS,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
    mavlink.MAVLINK_MSG_ID_ATTITUDE,
    mavlink.MAVLINK_MSG_ID_VFR_HUD,
)
"""Messages whose rates ground-control programs set."""


class Rig:
    """One vehicle in the air, handed over after some seconds, with a picture that is always fresh."""

    firmware: tuple[int, int] | None = None
    """Version of the autopilot's firmware; None: the stand-in's own."""

    def __init__(self, kind: str = "arducopter", config: Config | None = None, **parameters: float) -> None:
        """Begin at the origin; `parameters`: the autopilot's, beside those that `companion check` demands."""
        version: dict[str, Any] = {} if self.firmware is None else {"firmware": self.firmware}
        self.kind = kind
        self.companion = Companion(config or config_of(kind))
        self.vehicle = StandIn(
            CRAFTS[kind],
            Setup(
                1,
                LocalFrame(*ORIGIN_DEG),
                altitude_m=GROUND_M + HEIGHT_M,
                speed_m_s=0.0 if KINDS[kind].can_stop else CRUISE_M_S[kind],
                home=Home(0.0, 0.0, GROUND_M),
                in_air=True,
                armed=True,
                start_s=EPOCH_S,
                **version,
            ),
        )
        self.vehicle.parameters.update({**DEMANDED[kind], **parameters})
        self.now_s = float(EPOCH_S)
        self.decisions: list[Decision] = []
        self.asked: list[tuple[float, int]] = []
        """When the companion asked for the rate of which message."""
        self.lost: Callable[[bytes], bool] = lambda frame: False
        """Whether a frame of the autopilot is lost on its way."""
        self.pilot = SafetyPilot(kind, 1)
        self._writer = FrameWriter()
        self._sequence = 0
        self._other = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)

    @property
    def t_s(self) -> float:
        """Time since the beginning."""
        return self.now_s - EPOCH_S

    @property
    def last(self) -> Decision:
        """The newest decision."""
        return self.decisions[-1]

    def run(self, until_s: float, each: Callable[[], None] = lambda: None) -> None:
        """Fly on; `each` is called before each tick."""
        while self.t_s < until_s - TICK_S / 2:
            each()
            self._step()

    def say(self, message: mavlink.MAVLink_message) -> None:
        """Let another program, a ground station, send a message to the autopilot."""
        frame = bytes(message.pack(self._other))
        for reply in self.vehicle.receive(frame, self.now_s):
            self.companion.receive(reply, self.now_s)

    def set_rate(self, message_id: int, rate_hz: float) -> None:
        """Let another program set a message's rate; 0 ends it."""
        interval_us = 1e6 / rate_hz if rate_hz else -1.0
        values = (float(message_id), interval_us, 0.0, 0.0, 0.0, 0.0, 0.0)
        self.say(mavlink.MAVLink_command_long_message(1, 1, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 0, *values))

    def set_rates(self, rate_hz: float) -> None:
        """Let another program set the rates of all streams, as MAVProxy's streamrate does."""
        for message_id in STREAMS:
            self.set_rate(message_id, rate_hz)

    def changes(self, since_s: float) -> int:
        """Return how often steering began or ended since a time of the flight."""
        steers = [one.purpose is not Purpose.IDLE for one in self.decisions if one.t_s - EPOCH_S >= since_s]
        return sum(a is not b for a, b in zip(steers, steers[1:], strict=False))

    def words(self) -> str:
        """Return the newest decision in words, with everything that it says beside its reason."""
        one = self.last
        return "; ".join(filter(None, (one.purpose.value, one.reason, *one.triggers, one.note)))

    def _step(self) -> None:
        companion, vehicle = self.companion, self.vehicle
        if round(self.t_s * 10) % 10 == 0:
            companion.hear(self._broadcast(), self.now_s)
            self._to_autopilot([companion.adapter.heartbeat()])
        vehicle.step_to(self.now_s)
        for frame in vehicle.telemetry(self.now_s):
            if not self.lost(frame):
                companion.receive(frame, self.now_s)
        for order in self.pilot.orders(self.t_s, vehicle.mode):
            vehicle.receive(order, self.now_s)
        decision, frames = companion.tick(self.now_s)
        self.decisions.append(decision)
        self._to_autopilot(frames)
        # Without a rounding error that grows: the times of a long flight stay on their grid.
        self.now_s = EPOCH_S + round((self.t_s + TICK_S) * 10) / 10

    def _to_autopilot(self, frames: list[bytes]) -> None:
        for frame in frames:
            for message in mavlink.MAVLink(None).parse_buffer(bytearray(frame)) or ():
                asks = message.get_type() == "COMMAND_LONG"
                if asks and message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                    self.asked.append((self.t_s, int(message.param1)))
            for reply in self.vehicle.receive(frame, self.now_s):
                if not self.lost(reply):
                    self.companion.receive(reply, self.now_s)

    def _broadcast(self) -> bytes:
        self._sequence += 1
        stamp = Stamp(EPOCH_S, round(self.t_s * 1000), self._sequence)
        me, target = AgentEntry(1, 0.0, 0.0, 1), TargetEntry(1, TARGET_M, 0.0)
        return self._writer.encode(StateFrame(stamp, *ORIGIN_DEG, Directive.NORMAL, 1, 0, 1, 100, (me,), (target,), ()))
