"""A point that stands for a vehicle: to its companion it is an autopilot that needs no bytes."""

from companion.autopilot.aircraft import Neighbour
from companion.autopilot.point import PointAdapter
from companion.guard.types import Setpoint


def test_telemetry_is_what_the_owner_put_into_it() -> None:
    adapter = PointAdapter(can_stop=False, home_deg=(47.0, 8.0), height_m=100.0)
    adapter.tell(Neighbour(3, 47.1, 8.1, 20.0, -5.0, 12.0, 600.0), 0.5, 12.0)
    told = adapter.telemetry
    assert (told.lat_deg, told.lon_deg, told.altitude_m, told.height_m) == (47.1, 8.1, 600.0, 100.0)
    assert (told.velocity_north_m_s, told.velocity_east_m_s, told.yaw_rad) == (20.0, -5.0, 0.5)
    assert (told.position_at_s, told.heartbeat_at_s, told.home_deg, told.armed) == (12.0, 12.0, (47.0, 8.0), True)


def test_the_newest_setpoint_is_kept_and_makes_no_frames() -> None:
    adapter = PointAdapter(can_stop=True, home_deg=(47.0, 8.0), height_m=100.0)
    setpoint = Setpoint(1.0, 20.0, 600.0)
    assert adapter.setpoint is None
    assert adapter.encode(setpoint, 0.1, 12.0) == []
    assert adapter.setpoint is setpoint
