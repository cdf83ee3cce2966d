"""The paper's vehicle as an autopilot: a point that flies exact arcs, changes speed at once and cannot stop.

It has ArduCopter's MAVLink interface (modes, GUIDED velocity setpoints and their time-out), but its heartbeat says
that it is a generic autopilot, so that no real plane is ever taken for it. It flies through the air: it crabs to hold
the course of a setpoint, and drifts with the wind while it circles without one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

from pymavlink.dialects.v20 import common as mavlink

from companion.geo.kinematics import GRAVITY_M_S2, advance, shorter_turn_rad, turn_towards
from sim.vehicles.ardupilot import ACCEPTED, FAILED, ArduPilot
from sim.vehicles.craft import Answer, Command, Message, Parameter, Start, Surroundings
from sim.vehicles.modes import COPTER_MODES, GUIDED, LAND, LOITER, RTL, STABILIZE, STICK_MODES
from sim.vehicles.setpoint import Setpoint, clip, understood
from sim.wind import crabbed

_CLIMB_M_S, _DESCENT_M_S = 2.5, 1.5
"""Greatest climb and descent rate, as in `arducopter.py`."""


class Kinematic(ArduPilot):
    """A point whose turn rate is at most n_max g / v; speeds and turn rates are relative to the air."""

    kind = "kinematic"
    mav_type = mavlink.MAV_TYPE_FIXED_WING
    mav_autopilot = mavlink.MAV_AUTOPILOT_GENERIC
    lists_adsb = False
    longest_step_s = math.inf
    parameters = (Parameter("GUID_TIMEOUT", 3.0, 0.1, 5.0), Parameter("FS_GCS_ENABLE", 0.0, 0.0, 7.0))
    modes = COPTER_MODES
    first_mode = STABILIZE
    guided_mode = GUIDED
    holding_mode = LOITER
    stick_modes = STICK_MODES
    return_mode = RTL
    armable = frozenset({STABILIZE, GUIDED, LOITER})
    gcs_failsafe = "FS_GCS_ENABLE"

    def __init__(
        self, start: Start, n_max: float, min_speed_m_s: float, max_speed_m_s: float, hold_side: float = 1.0
    ) -> None:
        """Begin in the air; without a setpoint the point circles to `hold_side`, 1.0 to the right and -1.0 to the left.

        Raises:
            ValueError: `start` is on the ground, where a vehicle that cannot stop cannot be.

        """
        if not start.in_air:
            raise ValueError("a kinematic vehicle cannot stop, so it begins in the air")
        super().__init__(start)
        self._n_max = n_max
        self._min_speed_m_s = min_speed_m_s
        self._max_speed_m_s = max_speed_m_s
        self._hold_side = hold_side
        self._setpoint: Setpoint | None = None
        speed_m_s = clip(self.body.airspeed_m_s, min_speed_m_s, max_speed_m_s)
        self._air_m_s = speed_m_s * math.cos(self.body.heading_rad), speed_m_s * math.sin(self.body.heading_rad)
        self._commands[mavlink.MAV_CMD_NAV_TAKEOFF] = lambda _command, _around, _now_s: FAILED
        self._commands[mavlink.MAV_CMD_NAV_LAND] = partial(self._change, LAND)
        self._commands[mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH] = partial(self._change, RTL)
        self.blow((0.0, 0.0))

    def landed_state(self) -> int:
        """Return EXTENDED_SYS_STATE.landed_state."""
        return int(mavlink.MAV_LANDED_STATE_LANDING if self.mode == LAND else mavlink.MAV_LANDED_STATE_IN_AIR)

    def setpoint(self, message: Message, around: Surroundings, now_s: float) -> None:
        """Obey a velocity in GUIDED; any other SET_POSITION_TARGET_LOCAL_NED makes the point circle."""
        if self.mode != GUIDED or not self.armed or message.get_type() != "SET_POSITION_TARGET_LOCAL_NED":
            return
        self._setpoint = understood(message, self.body, around, now_s)

    def blow(self, wind_m_s: tuple[float, float]) -> None:
        """Set the velocity over the ground to that through the air plus the wind."""
        body = self.body
        body.velocity_north_m_s = self._air_m_s[0] + wind_m_s[0]
        body.velocity_east_m_s = self._air_m_s[1] + wind_m_s[1]
        body.airspeed_m_s = math.hypot(*self._air_m_s)

    def step(self, now_s: float, dt_s: float, around: Surroundings) -> None:
        """Advance by `dt_s` along exact arcs and straight lines; a setpoint expires after GUID_TIMEOUT."""
        self._mind_time(now_s, around)
        until_s = now_s + dt_s
        asked = self._setpoint
        if asked is not None and asked.place_m is None:
            expires_s = asked.t_s + self.values["GUID_TIMEOUT"]
            if expires_s <= now_s:
                asked = None
            elif expires_s < until_s:
                self._fly(asked, around, expires_s - now_s)
                asked, dt_s = None, until_s - expires_s
        self._fly(asked, around, dt_s)

    def _fly(self, asked: Setpoint | None, around: Surroundings, dt_s: float) -> None:
        body, wind_m_s = self.body, around.wind_m_s
        speed_m_s = math.hypot(*self._air_m_s)
        before_rad = body.heading_rad
        wanted_rad: float | None = None
        body.climb_m_s = 0.0
        if asked is not None:
            north_m_s, east_m_s, up_m_s = asked.velocity_m_s
            if north_m_s or east_m_s:
                speed_m_s = clip(math.hypot(north_m_s, east_m_s), self._min_speed_m_s, self._max_speed_m_s)
                wanted_rad = crabbed(math.atan2(east_m_s, north_m_s) - around.convergence_rad, speed_m_s, wind_m_s)
                body.climb_m_s = clip(up_m_s, -_DESCENT_M_S, _CLIMB_M_S)
        rate_rad_s = self._n_max * GRAVITY_M_S2 / speed_m_s
        if wanted_rad is None:
            # Without a setpoint the tightest circle keeps it near, but for the wind.
            body.turn_rate_rad_s = self._hold_side * rate_rad_s
            body.north_m, body.east_m, body.heading_rad = advance(
                body.north_m, body.east_m, body.heading_rad, speed_m_s, body.turn_rate_rad_s, dt_s
            )
        else:
            body.north_m, body.east_m, body.heading_rad = turn_towards(
                body.north_m, body.east_m, body.heading_rad, speed_m_s, wanted_rad, rate_rad_s, dt_s
            )
            body.turn_rate_rad_s = shorter_turn_rad(before_rad, body.heading_rad) / dt_s
        self._air_m_s = speed_m_s * math.cos(body.heading_rad), speed_m_s * math.sin(body.heading_rad)
        body.north_m += wind_m_s[0] * dt_s
        body.east_m += wind_m_s[1] * dt_s
        body.altitude_m = max(body.altitude_m + body.climb_m_s * dt_s, around.ground_m)
        # A coordinated turn through the air.
        body.roll_rad = math.atan(speed_m_s * body.turn_rate_rad_s / GRAVITY_M_S2)
        self.blow(wind_m_s)

    def _change(self, mode: int, _command: Command, around: Surroundings, _now_s: float) -> Answer:
        self._enter(mode, around)
        return ACCEPTED

    def _forget(self) -> None:
        self._setpoint = None


def kinematic_profile(
    n_max: float, min_speed_m_s: float, max_speed_m_s: float, hold_side: float = 1.0
) -> Callable[[Start], Kinematic]:
    """Return the constructor of a `Kinematic` with these speed bounds and a turn rate of at most n_max g / v.

    Without a setpoint it circles to `hold_side`: 1.0 is the right.

    Raises:
        ValueError: n_max is not positive, or the speeds are not 0 < min_speed_m_s <= max_speed_m_s < infinity.

    """
    if not (n_max > 0.0 and 0.0 < min_speed_m_s <= max_speed_m_s < math.inf):
        raise ValueError("a kinematic profile needs n_max > 0 and 0 < min_speed_m_s <= max_speed_m_s")
    return partial(
        Kinematic, n_max=n_max, min_speed_m_s=min_speed_m_s, max_speed_m_s=max_speed_m_s, hold_side=hold_side
    )
