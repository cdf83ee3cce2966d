"""The adapter of a simulated point vehicle, which has no autopilot to exchange bytes with.

The ground station uses it for the dead reckoning of its agents, and the arena flies it.
"""

from __future__ import annotations

from companion.autopilot.adapter import Abilities
from companion.autopilot.aircraft import Neighbour
from companion.autopilot.streams import Shortfall
from companion.autopilot.telemetry import Telemetry
from companion.guard.types import Setpoint


class PointAdapter:
    """Gives its companion the telemetry that its owner sets, and stores the setpoint, which a point obeys at once."""

    kind = "kinematic"
    resumes_on_stream = False
    steerable = True
    refusal: str | None = None
    missing_telemetry: str | None = None
    sees_others: bool | None = True
    asks_for_others = False
    steers_in_local_frame = False
    abilities = Abilities()
    parameters_known = True

    def __init__(self, can_stop: bool, home_deg: tuple[float, float], height_m: float) -> None:
        """Set the home position (latitude, longitude) and the constant height above home, as telemetry reports them."""
        self.can_stop = can_stop
        self.neighbours: list[Neighbour] = []
        self.telemetry = Telemetry()
        self.setpoint: Setpoint | None = None
        """The newest setpoint that the companion commanded; None before the first."""
        self._home_deg = home_deg
        self._height_m = height_m

    def tell(self, here: Neighbour, yaw_rad: float | None, now_s: float) -> None:
        """Set the telemetry of `now_s`: the vehicle is where `here`, the position a detector would report, says."""
        self.telemetry = Telemetry(
            system_id=1,
            heartbeat_at_s=now_s,
            armed=True,
            position_at_s=now_s,
            lat_deg=here.lat_deg,
            lon_deg=here.lon_deg,
            height_m=self._height_m,
            altitude_m=here.altitude_m,
            velocity_north_m_s=here.velocity_north_m_s,
            velocity_east_m_s=here.velocity_east_m_s,
            yaw_rad=yaw_rad,
            home_deg=self._home_deg,
            in_air=True,
        )

    def encode(self, setpoint: Setpoint, convergence_rad: float, now_s: float) -> list[bytes]:
        """Store the setpoint and return no frames, because there is no autopilot."""
        self.setpoint = setpoint
        return []

    def receive(self, datagram: bytes, now_s: float) -> int:
        """Do nothing: there is no autopilot to hear."""
        return 0

    def shortfalls(self, now_s: float) -> tuple[Shortfall, ...]:
        """Return nothing: nothing was asked for."""
        return ()

    def too_seldom(self, timeout_s: float, now_s: float) -> str | None:
        """Return None: the owner sets the telemetry."""
        return None

    def requests(self, now_s: float) -> list[bytes]:
        """Return no frames: there is no autopilot to ask."""
        return []

    def silence(self, now_s: float) -> str | None:
        """Return None: there is no autopilot to answer."""
        return None

    @property
    def unusual(self) -> str | None:
        """None: there is no autopilot that sends anything."""
        return None

    def note_signed(self) -> bool:
        """Return False: there is no autopilot that signs anything."""
        return False

    def hold(self, now_s: float) -> list[bytes]:
        """Return no frames: a point needs no setpoint stream before it is steered."""
        return []

    def release(self) -> None:
        """Do nothing: no state of an engagement is stored."""

    def heartbeat(self) -> bytes:
        """Return no bytes: there is no autopilot to hear a heartbeat."""
        return b""
