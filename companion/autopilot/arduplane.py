"""The ArduPlane adapter: in GUIDED, a heading loop on board over roll-only SET_ATTITUDE_TARGET (mask 0xC6).

docs/autopilots.md: the plane ignores velocity setpoints, and a heading command never expires. A commanded bank is held
exactly while the autopilot keeps height and speed; 3.0 s after the last one the plane goes back to its GUIDED target.
So the adapter sets that target to a loiter at the plane's own position every few seconds: when the companion dies, the
plane circles nearby.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from pymavlink.dialects.v20 import common

from companion.autopilot.adapter import Abilities
from companion.autopilot.air import AirDensity
from companion.autopilot.ardupilot import RATES_HZ, RECEIVER, fence_checks, no_gcs_failsafe
from companion.autopilot.commands import Command
from companion.autopilot.course import CourseRamp
from companion.autopilot.heartbeat import ARDUPLANE
from companion.autopilot.linked import AIRSPEED_RATE_HZ, LinkedAdapter, is_usable, milliseconds
from companion.autopilot.parameter_checks import ParameterCheck
from companion.autopilot.parameters import Wanted
from companion.autopilot.streams import RESTS_ON
from companion.geo.kinematics import GRAVITY_M_S2, turn_rate_rad_s
from companion.guard.types import Setpoint

ROLL_ONLY = 0xC6
"""type_mask of SET_ATTITUDE_TARGET with which, as measured, the autopilot takes only the roll of the attitude."""
COURSE_GAIN = 3.0
"""Gain from the course error to the commanded bank, rad per rad."""
GREATEST_BANK_DEG = 45.0
"""Greatest bank that is commanded: entering a bank of 65 degrees oscillates for 4 s."""
TURN_SHARE = 0.73
"""Share of the turn rate g tan(bank) / v that a sustained turn achieves."""
BANK_RESERVE_DEG = 5.0
"""Part of the greatest bank that turns do not use, kept for correcting the course in them."""
REACTION_S = 0.25
"""Time from a setpoint to its effect, with the bank of the turn fed forward. On the stand-in 0.15 s fits turns of 8 to
360 degrees best (tests/benchmarks/lags.py), but a plane that turns for a minute in front of a fence then leaves it by
5 m."""
TRACKING_M = 5.5
"""Distance within which the plane stays of its path with REACTION_S, at 22 m/s in a reversal."""
LOITER_PERIOD_S = 4.0
"""Time after which the loiter that a dead companion leaves behind is set to the plane's present position again."""
RESEND_PERIOD_S = 10.0
"""Time after which unchanged height and speed are commanded again, because entering GUIDED resets them."""
HEIGHT_STEP_M = 0.5
"""Change of the wanted height up to which it is not commanded again."""
SPEED_STEP_M_S = 0.1
"""Change of the wanted speed up to which it is not commanded again."""
EXTRAPOLATED_S = 0.5
"""Greatest age for which a reported course is extrapolated."""
_REFUSED_M = (0.0, -1.0)
"""Altitudes that GUIDED_CHANGE_ALTITUDE refuses (ArduPlane's source)."""
_AIRSPEED = 0.0
"""Value of the speed type of MAV_CMD_GUIDED_CHANGE_SPEED for airspeed."""
_KEEP_SPEED = -1.0
"""Value of the speed of MAV_CMD_DO_REPOSITION that leaves it unchanged."""

WANTED = (
    Wanted("ROLL_LIMIT_DEG", 45.0, (("LIM_ROLL_CD", 0.01),), least=10.0, greatest=85.0),
    Wanted("WP_LOITER_RAD", 60.0, least=-1_000.0, greatest=1_000.0),
    Wanted("AIRSPEED_MIN", 9.0, (("ARSPD_FBW_MIN", 1.0),), least=5.0, greatest=60.0),
    Wanted("AIRSPEED_MAX", 22.0, (("ARSPD_FBW_MAX", 1.0),), least=5.0, greatest=120.0),
    Wanted("FS_GCS_ENABL", 0.0),
    Wanted("FENCE_ENABLE", 0.0),
    Wanted("FENCE_ACTION", 0.0),
    RECEIVER,
)
PARAMETER_CHECKS = (
    ParameterCheck("ROLL_LIMIT_DEG", "it bounds how fast the plane turns", 45.0, 30.0, 65.0),
    ParameterCheck("WP_LOITER_RAD", "a plane whose companion died circles so wide", 60.0, 20.0, 200.0, by_size=True),
    no_gcs_failsafe("FS_GCS_ENABL"),
    *fence_checks((1.0, 8.0)),
)


class _Sent(NamedTuple):
    """What was commanded last, and when; NaN and -inf before the first command of an engagement."""

    altitude_m: float
    """Altitude above sea level that the plane is to fly at."""
    height_m: float
    """The same as a height above home."""
    frame: int
    """The MAV_FRAME in which it is commanded."""
    indicated_m_s: float
    commanded_s: float
    loiter_s: float

    @property
    def ordered_m(self) -> float:
        """The commanded altitude or height."""
        return self.altitude_m if self.frame == common.MAV_FRAME_GLOBAL else self.height_m


_NOTHING_SENT = _Sent(math.nan, math.nan, common.MAV_FRAME_GLOBAL, math.nan, -math.inf, -math.inf)


class ArduPlaneAdapter(LinkedAdapter):
    """Steers by bank, from the course error and the course's rate; commands height and speed with acknowledgement."""

    identity = ARDUPLANE
    wanted: tuple[Wanted, ...] = WANTED
    rates_hz = {**RATES_HZ, common.MAVLINK_MSG_ID_VFR_HUD: AIRSPEED_RATE_HZ}
    rests_on = {**RESTS_ON, common.MAVLINK_MSG_ID_ATTITUDE: "the bank"}
    parameter_checks = PARAMETER_CHECKS

    def __init__(self, system_id: int | None = None) -> None:
        """Listen to the autopilot of this system id; None for whichever is heard first."""
        super().__init__(system_id)
        self._ramp = CourseRamp()
        self._air = AirDensity()
        self._sent = _NOTHING_SENT

    @property
    def abilities(self) -> Abilities:
        """The performance limits that follow from ROLL_LIMIT_DEG and, as true airspeeds, AIRSPEED_MIN and _MAX."""
        bank_rad = self._bank_max_rad() - math.radians(BANK_RESERVE_DEG)
        slowest_m_s, fastest_m_s = (self._air.ratio * indicated_m_s for indicated_m_s in self._indicated_m_s())
        return Abilities(
            speed_min_m_s=slowest_m_s,
            speed_max_m_s=fastest_m_s,
            airspeed_max_m_s=fastest_m_s,
            airspeed_by=str(self.parameters.told_as("AIRSPEED_MAX")),
            n_max=TURN_SHARE * math.tan(bank_rad),
            reaction_s=REACTION_S,
            tracking_m=TRACKING_M,
            assumed=tuple(
                name for name in self.parameters.assumed if not name.startswith(("FS_", "FENCE_", "WP_LOITER", "ADSB_"))
            ),
            insane=self.parameters.insane + self._contradiction(),
        )

    def encode(self, setpoint: Setpoint, convergence_rad: float, now_s: float) -> list[bytes]:
        """Return SET_ATTITUDE_TARGET with the bank, and the commands of height, speed and loiter that are due."""
        present_rad = self._course_rad()
        if present_rad is None or not is_usable(setpoint, convergence_rad):
            return []
        self._air.engage()
        bank_rad = self._bank_rad(setpoint.heading_rad + convergence_rad, present_rad, now_s)
        if not math.isfinite(bank_rad):
            return []
        self._queue_commands(setpoint, now_s)
        commands = [self._pack(message) for message in self._commands.due(now_s, self._system_id)]
        return [self._bank(bank_rad, now_s), *commands]

    def release(self) -> None:
        """Forget the course and which height and speed were commanded."""
        super().release()
        self._ramp.release()
        self._air.release()
        self._sent = _NOTHING_SENT

    def receive(self, datagram: bytes, now_s: float) -> int:
        """Process whole frames from the autopilot link, and note how dense the air is where the plane flies."""
        believed = super().receive(datagram, now_s)
        self._air.note(self.telemetry.altitude_m)
        return believed

    def _indicated_m_s(self) -> tuple[float, float]:
        """Return least and greatest indicated airspeed: the autopilot refuses what is outside."""
        slowest_m_s = self.parameters.value("AIRSPEED_MIN")
        return slowest_m_s, max(self.parameters.value("AIRSPEED_MAX"), slowest_m_s)

    def _contradiction(self) -> tuple[str, ...]:
        """Return what is wrong between AIRSPEED_MIN and AIRSPEED_MAX."""
        slowest, fastest = self.parameters.told_as("AIRSPEED_MIN"), self.parameters.told_as("AIRSPEED_MAX")
        if self.parameters.value("AIRSPEED_MAX") >= self.parameters.value("AIRSPEED_MIN"):
            return ()
        return (f"{fastest} is below {slowest}",)

    def _bank_max_rad(self) -> float:
        return math.radians(min(self.parameters.value("ROLL_LIMIT_DEG"), GREATEST_BANK_DEG))

    def _bank_rad(self, wanted_rad: float, present_rad: float, now_s: float) -> float:
        telemetry = self.telemetry
        speed_m_s = math.hypot(telemetry.velocity_north_m_s, telemetry.velocity_east_m_s)
        rate_max_rad_s = turn_rate_rad_s(max(speed_m_s, 1.0), self.abilities.n_max)
        course_rad, rate_rad_s = self._ramp.towards(wanted_rad, present_rad, rate_max_rad_s, now_s)
        # The reported course is a moment old; since then the plane has turned as its bank makes it.
        age_s = min(max(now_s - (telemetry.position_at_s or now_s), 0.0), EXTRAPOLATED_S)
        roll_rad = telemetry.roll_rad if math.isfinite(telemetry.roll_rad) else 0.0
        present_rad += age_s * GRAVITY_M_S2 * math.tan(roll_rad) / max(speed_m_s, 1.0)
        error_rad = math.remainder(course_rad - present_rad, math.tau)
        bank_rad = COURSE_GAIN * error_rad + math.atan(speed_m_s * rate_rad_s / GRAVITY_M_S2)
        bank_max_rad = self._bank_max_rad()
        return min(max(bank_rad, -bank_max_rad), bank_max_rad)

    def _queue_commands(self, setpoint: Setpoint, now_s: float) -> None:
        sent = self._sent
        again = now_s - sent.commanded_s >= RESEND_PERIOD_S
        if again:
            sent = sent._replace(commanded_s=now_s)
        telemetry = self.telemetry
        ordered = self._ordered(sent, setpoint.altitude_m)
        if again or (ordered.frame, ordered.ordered_m) != (sent.frame, sent.ordered_m):
            of = "sea level" if ordered.frame == common.MAV_FRAME_GLOBAL else "home"
            self._commands.queue(
                Command(
                    common.MAV_CMD_GUIDED_CHANGE_ALTITUDE,
                    f"{ordered.ordered_m:.0f} m above {of}",
                    frame=ordered.frame,
                    altitude_m=_commandable_m(ordered.ordered_m),
                )
            )
        sent = ordered
        # A setpoint's speed is through the air, the command's is what the airspeed sensor shows.
        slowest_m_s, fastest_m_s = self._indicated_m_s()
        indicated_m_s = setpoint.speed_m_s / self._air.ratio_at(telemetry.altitude_m)
        indicated_m_s = min(max(indicated_m_s, slowest_m_s), fastest_m_s)
        if again or not abs(indicated_m_s - sent.indicated_m_s) <= SPEED_STEP_M_S:
            sent = sent._replace(indicated_m_s=indicated_m_s)
            self._commands.queue(
                Command(
                    common.MAV_CMD_GUIDED_CHANGE_SPEED,
                    f"indicated airspeed {indicated_m_s:.1f} m/s",
                    (_AIRSPEED, indicated_m_s, 0.0, 0.0),
                    frame=common.MAV_FRAME_GLOBAL_RELATIVE_ALT,
                )
            )
        if now_s - sent.loiter_s >= LOITER_PERIOD_S and math.isfinite(telemetry.lat_deg):
            sent = sent._replace(loiter_s=now_s)
            self._commands.queue(
                Command(
                    common.MAV_CMD_DO_REPOSITION,
                    "loiter underneath",
                    (_KEEP_SPEED, 0.0, self.parameters.value("WP_LOITER_RAD"), 0.0),
                    frame=sent.frame,
                    place_deg=(telemetry.lat_deg, telemetry.lon_deg),
                    altitude_m=sent.ordered_m,
                )
            )
        self._sent = sent

    def _ordered(self, sent: _Sent, height_m: float) -> _Sent:
        """Return what is commanded for a height above home, as the autopilot tells it now.

        It is an altitude above sea level: one above home moves with home, even after the plane has got it. Where sea
        level has moved, as the altitude to command has changed and the height has not, it is a height. A height that is
        the present one changes nothing: the plane keeps by itself what it was last commanded.
        """
        telemetry = self.telemetry
        altitude_m = height_m - telemetry.height_m + telemetry.altitude_m
        same_altitude = abs(altitude_m - sent.altitude_m) <= HEIGHT_STEP_M
        same_height = abs(height_m - sent.height_m) <= HEIGHT_STEP_M
        if math.isfinite(sent.altitude_m) and height_m == telemetry.height_m:
            return sent
        if same_altitude and sent.frame == common.MAV_FRAME_GLOBAL:
            return sent._replace(height_m=height_m)
        if same_height and sent.frame == common.MAV_FRAME_GLOBAL_RELATIVE_ALT:
            return sent._replace(altitude_m=altitude_m)
        frame = common.MAV_FRAME_GLOBAL_RELATIVE_ALT if same_height and not same_altitude else common.MAV_FRAME_GLOBAL
        return sent._replace(altitude_m=altitude_m, height_m=height_m, frame=frame)

    def _bank(self, bank_rad: float, now_s: float) -> bytes:
        return self._pack(
            common.MAVLink_set_attitude_target_message(
                milliseconds(now_s),
                self._system_id,
                common.MAV_COMP_ID_AUTOPILOT1,
                ROLL_ONLY,
                [math.cos(bank_rad / 2.0), math.sin(bank_rad / 2.0), 0.0, 0.0],
                0.0,
                0.0,
                0.0,
                0.0,
            )
        )


def _commandable_m(altitude_m: float) -> float:
    """Return an altitude that the autopilot accepts: beside those that it takes for none."""
    refused = any(abs(altitude_m - one) < 0.05 for one in _REFUSED_M)
    return altitude_m + 0.1 if refused else altitude_m
