"""The adapter of a point that stands for a vehicle, where there is no autopilot to exchange bytes with.

The ground station reckons with it where its agents must be, and the arena flies it.
"""

from __future__ import annotations

from companion.autopilot.adapter import Abilities
from companion.autopilot.telemetry import Neighbour, Telemetry
from companion.guard.types import Setpoint


class PointAdapter:
    """Tells its companion what its owner puts into it, and keeps the setpoint: a point obeys at once, exactly."""

    kind = "kinematic"
    resumes_on_stream = False
    steerable = True
    refusal: str | None = None
    missing_telemetry: str | None = None
    abilities = Abilities()
    parameters_known = True

    def __init__(self, can_stop: bool, home_deg: tuple[float, float], height_m: float) -> None:
        """Fly at a height in metres above home, a latitude and longitude in degrees."""
        self.can_stop = can_stop
        self.neighbours: list[Neighbour] = []
        self.telemetry = Telemetry()
        self.setpoint: Setpoint | None = None
        """The newest that it was asked for."""
        self._home_deg = home_deg
        self._height_m = height_m

    def tell(self, here: Neighbour, yaw_rad: float | None, now_s: float) -> None:
        """Tell the companion, as telemetry of this moment, that the vehicle is where a neighbour would see it."""
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
        """Take the setpoint: there is nobody to send frames to."""
        self.setpoint = setpoint
        return []

    def receive(self, datagram: bytes, now_s: float) -> None:
        """There is no autopilot to hear."""

    def requests(self, now_s: float) -> list[bytes]:
        """There is nobody to ask."""
        return []

    def hold(self, now_s: float) -> list[bytes]:
        """Nothing need flow before it is steered."""
        return []

    def release(self) -> None:
        """Nothing is kept of a steering that ended."""

    def heartbeat(self) -> bytes:
        """Nobody listens to it."""
        return b""
