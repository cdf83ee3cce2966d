"""A stand-in that is identified in virtual time: its companion flies the pattern, and every frame is kept."""

from __future__ import annotations

from collections.abc import Callable

from companion.geo.local_frame import LocalFrame
from companion.onboard.authority import State
from companion.onboard.config import AutopilotSection, Config, LimitsSection
from companion.onboard.flight_log import Mark, decision_frame, mark_frame
from companion.onboard.identification.identifier import Identifier
from companion.protocol.authenticator import Authenticator, Trust
from companion.protocol.codec import Directive, FrameWriter, Stamp, StateFrame
from sim.aircraft import AutopilotLink
from sim.loop import START_S
from sim.safety_pilot import SafetyPilot
from sim.vehicles import CRAFTS, Home, Setup, StandIn, kinematic_profile

HEIGHT_M = 60.0
SLOT_S = 0.1
LONGEST_S = 300.0
ORIGIN_DEG = (47.0, 8.0)
LIMITS = {
    "arducopter": LimitsSection(speed_m_s=8.0, n_max=0.25),
    "px4-copter": LimitsSection(speed_m_s=8.0, n_max=0.25),
    "arduplane": LimitsSection(speed_m_s=22.0, n_max=0.6),
    "px4-plane": LimitsSection(speed_m_s=15.0, n_max=0.4),
    "kinematic": LimitsSection(speed_m_s=15.0, n_max=0.4),
}


def config_of(kind: str, **more: object) -> Config:
    """Return the configuration of a vehicle of one kind with the limits of LIMITS."""
    return Config.model_validate(
        {
            "agent_id": 1,
            "autopilot": AutopilotSection(kind=kind, link="udpin:127.0.0.1:14540"),
            "limits": LIMITS[kind],
            "height_m": HEIGHT_M,
            "arrival_radius_m": 10.0,
        }
        | more
    )


def square_m(half_m: float) -> tuple[tuple[float, float], ...]:
    """Return the corners (north, east) of a square about the origin."""
    return (half_m, half_m), (half_m, -half_m), (-half_m, -half_m), (-half_m, half_m)


class IdentifyFlight:
    """A stand-in in the air with the companion that identifies it, on one virtual clock."""

    def __init__(self, config: Config, wind_m_s: tuple[float, float] = (0.0, 0.0)) -> None:
        assert config.autopilot is not None
        kind, speed_m_s = config.autopilot.kind, config.limits.speed_m_s
        self.over = False
        self.companion = Identifier(config, Authenticator(Trust()), State.WAITING, self._end)
        self.vehicle = StandIn(
            kinematic_profile(config.limits.n_max, speed_m_s, speed_m_s) if kind == "kinematic" else CRAFTS[kind],
            Setup(
                1,
                LocalFrame(*ORIGIN_DEG),
                altitude_m=500.0 + HEIGHT_M,
                speed_m_s=speed_m_s if kind == "kinematic" else 0.0,
                home=Home(0.0, 0.0, 500.0),
                in_air=True,
                armed=True,
                guided=kind == "kinematic",
                start_s=START_S,
            ),
        )
        self.vehicle.wind_m_s = wind_m_s
        self.records: list[tuple[float, bytes]] = []
        self.sent_s: list[float] = []
        self.asked_m_s: list[float] = []
        """Speed of each setpoint sent."""
        self.silent = False
        """Whether nothing of the vehicle reaches the companion."""
        self.t_s = 0.0
        self.said: list[str] = []
        self._pilot = None if kind == "kinematic" else SafetyPilot(kind, 1)
        self._link = AutopilotLink(self.companion, self.vehicle, self)  # type: ignore[arg-type]
        self._marks = FrameWriter()

    def write(self, t_s: float, frame: bytes) -> None:
        """Keep a frame as a log does."""
        self.records.append((t_s, frame))

    @property
    def now_s(self) -> float:
        """The Unix time of the flight."""
        return START_S + self.t_s

    def tell_origin(self) -> None:
        """Let the companion hear a picture without threats, whose origin is where the vehicle begins."""
        stamp = Stamp(int(START_S), 0, 1, 0, 1)
        state = StateFrame(stamp, *ORIGIN_DEG, Directive.NORMAL, 1, 0, 0, 100, (), (), ())
        self.companion.hear(self._marks.encode(state), self.now_s)

    def fly(self, until: Callable[[], bool] = lambda: False) -> None:
        """Fly until the pattern has ended or a condition holds."""
        while not self.over and not until() and self.t_s < LONGEST_S:
            self.slot()

    def slot(self) -> None:
        """Fly one slot of the companion's loop."""
        slots = round(self.t_s / SLOT_S)
        self.t_s = (slots + 1) * SLOT_S
        now_s = START_S + self.t_s
        self.vehicle.step_to(now_s)
        for order in [] if self._pilot is None else self._pilot.orders(self.t_s, self.vehicle.mode):
            self.vehicle.receive(order, now_s)
        for frame in [] if self.silent else self.vehicle.telemetry(now_s):
            self._link.deliver(frame, now_s)
        if slots % round(self.companion.config.guidance_step_s / SLOT_S) == 0:
            decision, frames = self.companion.tick(now_s)
            self.write(now_s, self._marks.encode(decision_frame(decision)))
            if not self.said or self.said[-1] != decision.reason:
                self.said.append(decision.reason)
        else:
            steered = self.companion.steers
            frames = self.companion.repeat(now_s)
            if steered and not self.companion.steers:
                self.write(now_s, mark_frame(Mark.WITHDRAWN, 1))
        engagement = self.companion.engagement
        if engagement is not None and engagement.setpoint is not None:
            self.sent_s.append(self.t_s)
            self.asked_m_s.append(engagement.setpoint.setpoint.speed_m_s)
        self._link.send(frames, now_s)

    def _end(self) -> None:
        self.over = True
