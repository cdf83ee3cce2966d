"""A plane with PX4: its response to OFFBOARD setpoints, and what it does when they stop.

As measured on PX4 v1.16.1 at 15 m/s (docs/autopilots.md). "(chosen)" marks what was neither measured nor read. A
setpoint steers the plane only if it has a position. Turns are limited by the bank alone. With SIH_T_MAX 6, as the
simulator's airplane comes, it reaches 13.6 m/s indicated and flies too low; here it has the thrust for its speeds.

Not modelled: the approach to a landing (the plane circles down), the roll on the runway, stall.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import common as mavlink

from companion.geo.air_density import true_per_indicated
from companion.geo.kinematics import GRAVITY_M_S2, shorter_turn_rad
from sim.vehicles import px4
from sim.vehicles.craft import Parameter, Start, Surroundings
from sim.vehicles.fixed_wing import Airframe, FixedWing, climb_towards_m_s, loiter_course_rad
from sim.vehicles.px4 import Offboard, Px4, Reposition
from sim.vehicles.setpoint import clip

_COURSE_LAG_S = 1.07
"""Delay with which an evenly changing course is followed. With setpoints at 5 Hz it gives the measured 1.17 s within
3 %."""
_AIRFRAME = Airframe(
    roll_lag_s=0.3,
    roll_rate_rad_s=math.radians(70.0),
    turn_share=1.0,
    acceleration_m_s2=1.0,
    airspeed_lag_s=1.5,
    climb_lag_s=1.0,
)
"""How the airframe responds. The bank's lag fits the measured 90 degree turn in 5 s, the roll rate is FW_R_RMAX's
default. The rest is chosen: a level coordinated turn, which no measurement contradicts."""
_ALTITUDE_GAIN_1_S = 0.5
"""Gain from an altitude error to a climb rate (chosen)."""
_NEAR_CARROT_M = 70.0
"""Distance below which a setpoint's position without a velocity is circled while its altitude differs by more than
_CARROT_ALTITUDE_M (measured at 60 m)."""
_CARROT_ALTITUDE_M = 10.0
"""Altitude difference above which a near position without a velocity is circled (measured)."""
_SMALL_SPEED_M_S = 0.1
"""Speed below which a setpoint's velocity counts as none."""
_TAKE_OFF_ALTITUDE_M = 30.0
"""Default of MIS_TAKEOFF_ALT (chosen: PX4 sets a plane's by its airframe)."""
_TAKE_OFF_DONE_M = 2.0
"""Height below the take-off altitude at which a take-off is complete."""
_TAKE_OFF_SPEED_M_S = 1.0
"""Airspeed with which the plane is launched by hand."""
_LAND_SINK_M_S = 1.5
"""Sink rate in LAND (chosen)."""
_STOCK_THRUST_N = 6.0
"""SIH_T_MAX of the simulator's airplane, as it comes (code)."""
_STOCK_FASTEST_M_S = 13.6
"""Greatest indicated airspeed with _STOCK_THRUST_N: measured 13.5 to 13.6 m/s where 15 and 18 were asked for. It grows
with the root of the thrust, as the drag with the square of the speed."""
_THRUST_N = 13.0
"""Default of SIH_T_MAX here: enough for FW_AIRSPD_MAX."""
_STEP_S = 0.05
"""Longest step of the motion."""

_PARAMETERS = (
    *px4.COMMON_PARAMETERS,
    Parameter("FW_AIRSPD_MAX", 20.0, 0.5, 200.0),
    Parameter("FW_AIRSPD_MIN", 10.0, 0.5, 200.0),
    Parameter("FW_AIRSPD_TRIM", 15.0, 0.5, 200.0),
    Parameter("FW_R_LIM", 50.0, 35.0, 65.0),
    Parameter("FW_T_CLMB_R_SP", 3.0, 0.5, 15.0),
    Parameter("FW_T_SINK_R_SP", 2.0, 0.5, 15.0),
    Parameter("MIS_TAKEOFF_ALT", _TAKE_OFF_ALTITUDE_M, 0.0, 1000.0),
    Parameter("NAV_LOITER_RAD", 80.0, 25.0, 1000.0),
    Parameter("RTL_DESCEND_ALT", 30.0, 0.0, 100.0),
    Parameter("RTL_RETURN_ALT", 60.0, 0.0, 150.0),
    Parameter("SIH_T_MAX", _THRUST_N, 0.5, 100.0),
)


class Px4Plane(Px4):
    """A fixed-wing vehicle with PX4: it banks towards the course over the ground that its mode demands."""

    kind = "px4-plane"
    mav_type = mavlink.MAV_TYPE_FIXED_WING
    longest_step_s = _STEP_S
    reaction_s = 0.0
    parameters = _PARAMETERS

    def __init__(self, start: Start) -> None:
        """Begin on the ground, or flying at the airspeed of `start`, or at FW_AIRSPD_TRIM if that is 0."""
        super().__init__(start)
        if start.in_air and start.body.airspeed_m_s <= 0.0:
            start.body.airspeed_m_s = self.values["FW_AIRSPD_TRIM"] * true_per_indicated(start.body.altitude_m)
        self._wing = FixedWing(_AIRFRAME, start.body)
        self._frozen_climb_m_s: float | None = None
        self._straight_rad = start.body.heading_rad

    def blow(self, wind_m_s: tuple[float, float]) -> None:
        """Change the velocity over the ground at once: the air carries the plane."""
        if self.in_air:
            self._wing.blow(wind_m_s)

    def step(self, now_s: float, dt_s: float, around: Surroundings) -> None:
        """Advance by `dt_s` as the mode demands."""
        self._mind_time(now_s)
        if not self.in_air:
            if not (self.armed and self.mode == px4.TAKE_OFF):
                return
            # A hand launch: it flies at once.
            self.in_air = True
            self.body.airspeed_m_s = max(self.body.airspeed_m_s, _TAKE_OFF_SPEED_M_S)
        bank_rad, climb_m_s = self._wanted(around)
        speed_m_s = min(self._asked_speed_m_s(), self._fastest_m_s())
        self._wing.fly(bank_rad, speed_m_s, climb_m_s, around.wind_m_s, dt_s)
        if self.body.altitude_m <= around.ground_m and self.body.climb_m_s <= 0.0:
            self._touch_down(around.ground_m)

    def _asked_speed_m_s(self) -> float:
        if self._hold.speed_m_s is None:
            return self.values["FW_AIRSPD_TRIM"]
        return clip(self._hold.speed_m_s, self.values["FW_AIRSPD_MIN"], self.values["FW_AIRSPD_MAX"])

    def _fastest_m_s(self) -> float:
        return _STOCK_FASTEST_M_S * math.sqrt(self.values["SIH_T_MAX"] / _STOCK_THRUST_N)

    def _wanted(self, around: Surroundings) -> tuple[float, float]:
        """Return the bank (rad) and the climb rate (m/s) that the mode demands."""
        home = around.home
        if not self.armed or self.mode in px4.STICK_MODES:
            # Without radio control it flies straight on at its altitude.
            return self._towards(self._straight_rad), self._climb_to(self._hold.place.altitude_m)
        if self.mode == px4.OFFBOARD:
            return self._asked_bank_and_climb()
        if self.mode == px4.TAKE_OFF:
            if self._hold.place.altitude_m - self.body.altitude_m <= _TAKE_OFF_DONE_M:
                altitude_m = self._hold.place.altitude_m
                self._intended = px4.HOLD
                self._fly_mode(px4.HOLD)
                self._hold.place = Reposition(self._hold.place.north_m, self._hold.place.east_m, altitude_m)
            return self._towards(self._straight_rad), self._climb_to(self._hold.place.altitude_m)
        if self.mode == px4.RETURN:
            altitude_m = home.altitude_m + self.values["RTL_RETURN_ALT"]
            return self._circling(Reposition(home.north_m, home.east_m, altitude_m))
        if self.mode == px4.LAND:
            return self._circling(self._hold.place)[0], -_LAND_SINK_M_S
        return self._circling(self._hold.place)

    def _fly_mode(self, mode: int) -> None:
        super()._fly_mode(mode)
        self._straight_rad = self._wing.course_rad()
        self._frozen_climb_m_s = None

    def _circling(self, place: Reposition) -> tuple[float, float]:
        radius_m = place.radius_m or self.values["NAV_LOITER_RAD"]
        north_m, east_m = place.north_m - self.body.north_m, place.east_m - self.body.east_m
        course_rad = loiter_course_rad(north_m, east_m, radius_m, right=True)
        # On the circle the course turns steadily: without this turn rate the plane would fly wide by its lag.
        near = abs(math.hypot(north_m, east_m) - radius_m) < 0.5 * radius_m
        return self._towards(course_rad, self.body.airspeed_m_s / radius_m if near else 0.0), self._climb_to(
            place.altitude_m
        )

    def _asked_bank_and_climb(self) -> tuple[float, float]:
        """Return the bank (rad) and the climb rate (m/s) that the newest setpoint leads to.

        A position with a velocity steers along the velocity, one without is flown to or circled. A setpoint without a
        position keeps the stream alive, but leaves bank and climb as they are.
        """
        asked = self._stream.asked
        if asked is None or asked.north_m is None or asked.east_m is None:
            # The stream is alive, but the setpoint is ignored: bank and climb stay as they are.
            if self._frozen_climb_m_s is None:
                self._frozen_climb_m_s = self.body.climb_m_s
            return self.body.roll_rad, self._frozen_climb_m_s
        self._frozen_climb_m_s = None
        altitude_m = self.body.altitude_m if asked.altitude_m is None else asked.altitude_m
        if asked.velocity_m_s is not None and math.hypot(*asked.velocity_m_s) > _SMALL_SPEED_M_S:
            course_rad = math.atan2(asked.velocity_m_s[1], asked.velocity_m_s[0])
            return self._towards(course_rad, self._curvature_rate_rad_s(asked, course_rad)), self._climb_to(altitude_m)
        north_m, east_m = asked.north_m - self.body.north_m, asked.east_m - self.body.east_m
        near = math.hypot(north_m, east_m) < _NEAR_CARROT_M
        if near and abs(altitude_m - self.body.altitude_m) > _CARROT_ALTITUDE_M:
            return self._circling(Reposition(asked.north_m, asked.east_m, altitude_m))
        return self._towards(math.atan2(east_m, north_m)), self._climb_to(altitude_m)

    def _curvature_rate_rad_s(self, asked: Offboard, course_rad: float) -> float:
        """Return the turn rate that a setpoint's acceleration across the course adds: PX4 turns to the wrong side."""
        if asked.acceleration_m_s2 is None:
            return 0.0
        north_m_s2, east_m_s2 = asked.acceleration_m_s2
        across_m_s2 = east_m_s2 * math.cos(course_rad) - north_m_s2 * math.sin(course_rad)
        return -across_m_s2 / self.body.airspeed_m_s

    def _towards(self, course_rad: float, rate_rad_s: float = 0.0) -> float:
        """Return the bank that leads to a course over the ground which itself turns at `rate_rad_s`."""
        error_rad = shorter_turn_rad(self._wing.course_rad(), course_rad)
        bank_rad = self._wing.bank_rad(error_rad / _COURSE_LAG_S + rate_rad_s, self.body.airspeed_m_s)
        limit_rad = math.radians(self.values["FW_R_LIM"])
        return clip(bank_rad, -limit_rad, limit_rad)

    def _climb_to(self, altitude_m: float) -> float:
        """Return the climb rate towards an altitude, less the height that the autopilot gives for lacking airspeed.

        TECS controls height and airspeed by their energies' sum and difference (code): at full thrust the plane flies
        as much lower as its airspeed is too low, 77.3 m where 80 are asked for with 13.6 m/s where 15 are (measured).
        """
        asked_m_s, fastest_m_s = self._asked_speed_m_s(), self._fastest_m_s()
        lacking_m2_s2 = max(asked_m_s**2 - fastest_m_s**2, 0.0) * true_per_indicated(self.body.altitude_m) ** 2
        return climb_towards_m_s(
            altitude_m - 0.5 * lacking_m2_s2 / GRAVITY_M_S2 - self.body.altitude_m,
            _ALTITUDE_GAIN_1_S,
            self.values["FW_T_CLMB_R_SP"],
            self.values["FW_T_SINK_R_SP"],
        )
