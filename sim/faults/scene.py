"""The scene of the fault table: the mission of its one vehicle, and the settings with which each flight begins."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from companion.autopilot.kinds import CRUISE_M_S
from companion.autopilot.kinds import KINDS as AUTOPILOTS
from companion.geo.local_frame import LocalFrame
from companion.mission.model import Mission
from companion.mission.resolve import resolve
from companion.onboard.config import AutopilotSection, Config, StalenessSection, config_for_agent
from companion.protocol.ed25519 import FrameSigner
from companion.protocol.mavlink_signing import MavlinkSigner
from sim.scaling import scaled
from sim.vehicles import CRAFTS, DEFAULT_RATES_HZ, Home, Setup, StandIn
from sim.vehicles.adsb import ADSB_TYPE

KINDS = tuple(CRUISE_M_S)
"""Autopilot kinds with which the faults are flown."""
LOOP_PERIOD_S = 0.1
"""Period of setpoints, telemetry and records of the truth."""
AGENT_ID = 1
SYSTEM_ID = 1
SEED = 1
WAY_M = 3600.0
"""Distance to the target, for a vehicle of 60 m/s."""
HEIGHT_M = 60.0
"""Height above the ground: a plane that circles needs room below it."""
FLEET_KEY = bytes(range(32))
"""Signing key of the fleet, used in this scene alone."""
OTHER_KEY = bytes(range(1, 33))
"""Signing key of an impostor."""
HOLDING_MODES = {"arducopter": 17, "arduplane": 12, "px4-copter": 4 << 16 | 3 << 24, "px4-plane": 4 << 16 | 3 << 24}
"""custom_mode that a safety pilot chooses to take over, by kind: BRAKE, LOITER or HOLD. (ArduCopter's LOITER sinks
without radio control.)"""
DEMANDED: Mapping[str, Mapping[str, float]] = {
    "arducopter": {"GUID_TIMEOUT": 1.0},
    "arduplane": {},
    "px4-copter": {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 5.0},
    "px4-plane": {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 5.0},
}
"""Parameters that `companion check` demands (PARAMETER_CHECKS) with other values than the defaults, by kind."""
STALENESS = StalenessSection(coasting_after_s=3.0, loitering_after_s=6.0, blind_after_s=12.0, recover_after_s=1.0)
"""Thresholds of the failsafe stages for one broadcast a second, short so that all stages fit into a short flight."""


@dataclass(frozen=True)
class Setting:
    """The settings with which a flight begins."""

    kind: str
    mission: Mission
    signed: bool = True
    """Whether the broadcast is signed with FLEET_KEY, and the companion accepts only frames signed so."""
    child: bool = False
    """Whether setpoints leave through MAVSDK's child process, which ends half a second after its parent's last tick."""
    range_m: float | None = None
    """The vehicle's range; None: as the mission says."""
    start_ned_m: tuple[float, float] = (0.0, 0.0)
    heading_deg: float = 0.0
    fence_ahead_s: float | None = None
    """Seconds of flight to the north end of the vehicle's own fence; None: its fence is the mission's."""
    parameters: Mapping[str, float] | None = None
    """The autopilot's parameters by name (others than its own are ignored); None: those of DEMANDED."""


def fault_mission(kind: str, target_deg: float = 0.0, discs: bool = True) -> Mission:
    """Return the scene of the fault table, scaled to a kind's cruise speed; lengths here are for 60 m/s.

    The target is 60 s away in the direction `target_deg` from the vehicle's heading, north. With `discs`, a static disc
    is on the way after 15 s of flight, and a moving one comes near the way after 30 s. The fence leaves 15 s of flight
    to the north and south of vehicle and target, 20 s to the east and west.
    """
    target_rad = math.radians(target_deg)
    target_m = (WAY_M * math.cos(target_rad), WAY_M * math.sin(target_rad))
    south_m, north_m = min(0.0, target_m[0]) - 900.0, max(0.0, target_m[0]) + 900.0
    west_m, east_m = min(0.0, target_m[1]) - 1200.0, max(0.0, target_m[1]) + 1200.0
    threats = [
        {"id": 1, "north_m": 1150.0, "east_m": 120.0, "detection_radius_m": 250.0, "attack_radius_m": 120.0}
        | {"speed_bound_m_s": 0.0},
        {"id": 2, "north_m": 2300.0, "east_m": -800.0, "detection_radius_m": 200.0, "attack_radius_m": 100.0}
        | {"speed_bound_m_s": 12.0, "motion": {"heading_deg": 120.0, "speed_m_s": 10.0}},
    ]
    mission = Mission.model_validate(
        {
            "name": "faults",
            "fence": [[south_m, west_m], [south_m, east_m], [north_m, east_m], [north_m, west_m]],
            "agents": [{"id": AGENT_ID, "north_m": 0.0, "east_m": 0.0, "heading_deg": 0.0, "height_m": HEIGHT_M}],
            "targets": [{"id": 1, "north_m": target_m[0], "east_m": target_m[1], "speed_bound_m_s": 0.0}],
            "threats": threats if discs else [],
            "broadcast_period_s": 1.0,
            "assignment_period_s": 5.0,
            "guidance_step_s": 0.5,
            "integration_step_s": LOOP_PERIOD_S,
        }
    )
    return resolve(scaled(mission, kind), SEED)


def fault_config(setting: Setting) -> Config:
    """Return the companion's configuration for a flight."""
    mission, kind = setting.mission, setting.kind
    config = config_for_agent(mission, AGENT_ID, "routed")
    limits = config.limits
    if setting.range_m is not None:
        limits = limits.model_copy(update={"range_m": setting.range_m})
    if setting.fence_ahead_s is not None and limits.fence is not None:
        ahead_m = setting.fence_ahead_s * CRUISE_M_S[kind]
        limits = limits.model_copy(update={"fence": tuple((min(n, ahead_m), e) for n, e in limits.fence)})
    section = AutopilotSection(kind=kind, link="udpin:127.0.0.1:14540", clear="signal", system_id=SYSTEM_ID)
    return config.model_copy(update={"autopilot": section, "limits": limits, "staleness": STALENESS})


def fault_stand_in(setting: Setting, place_m: tuple[float, float], start_s: float, guided: bool = False) -> StandIn:
    """Return a stand-in of the flight's kind, armed in the air at a place (north, east); its clock begins at `start_s`.

    `start_s` is in Unix seconds; with `guided` it begins in the guided mode, else in the holding mode.
    """
    mission, kind = setting.mission, setting.kind
    vehicle = StandIn(
        CRAFTS[kind],
        Setup(
            SYSTEM_ID,
            LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg),
            north_m=place_m[0],
            east_m=place_m[1],
            altitude_m=mission.origin.alt_m + HEIGHT_M,
            heading_rad=math.radians(setting.heading_deg),
            speed_m_s=0.0 if AUTOPILOTS[kind].can_stop else CRUISE_M_S[kind],
            home=Home(0.0, 0.0, mission.origin.alt_m),
            in_air=True,
            armed=True,
            guided=guided,
            start_s=start_s,
            rates_hz=DEFAULT_RATES_HZ,
        ),
    )
    if ADSB_TYPE in vehicle.parameters:
        vehicle.parameters[ADSB_TYPE] = 1.0
    return vehicle


def frame_signer(key: bytes | None) -> FrameSigner:
    """Return the signer of a broadcast with a MAVLink signing key; None leaves the frames unsigned."""
    return FrameSigner(None, None if key is None else MavlinkSigner(key, 0))
