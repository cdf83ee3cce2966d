"""The PX4 copter's setpoint is the one that MAVSDK sends: what is tested without it holds with it."""

from __future__ import annotations

import math
import subprocess
import sys

from pymavlink.dialects.v20 import common

from companion.autopilot.registry import ADAPTERS
from companion.guard.types import Setpoint

SYSTEM = 1
SPEED_M_S, HEADING_DEG, CLIMB_M_S = 5.0, 60.0, 0.5
MAVSDK = f"""
import os, sys, threading, time
import mavsdk
from mavsdk import logging
from mavsdk.plugins import offboard
from pymavlink.dialects.v20 import common

SETPOINT = common.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED
logging.log_subscribe(lambda *_: True)
found = threading.Event()

def sent(data):
    if int.from_bytes(data[7:10], "little") == SETPOINT and not found.is_set():
        sys.stdout.write(data.hex())
        sys.stdout.flush()
        found.set()

kit = mavsdk.Mavsdk(mavsdk.Configuration.create_manual({SYSTEM}, 191, False))
kit.add_any_connection("raw://")
kit.subscribe_raw_bytes_to_be_sent(sent)
autopilot = common.MAVLink(None, srcSystem={SYSTEM}, srcComponent=1)
beat = common.MAVLink_heartbeat_message(2, common.MAV_AUTOPILOT_PX4, 1, 4 << 16, 4, 3)
steering = None
for _ in range(100):
    kit.pass_received_raw_bytes(bytes(beat.pack(autopilot)))
    if steering is None and any(system.has_autopilot() for system in kit.get_systems()):
        steering = offboard.Offboard(next(system for system in kit.get_systems() if system.has_autopilot()))
    if steering is not None:
        steering.set_velocity_ned(offboard.VelocityNedYaw({SPEED_M_S * math.cos(math.radians(HEADING_DEG))!r},
            {SPEED_M_S * math.sin(math.radians(HEADING_DEG))!r}, {-CLIMB_M_S!r}, {HEADING_DEG!r}))
    if found.wait(0.05):
        os._exit(0)
os._exit(1)
"""


def decoded(frame: bytes) -> common.MAVLink_message:
    (message,) = common.MAVLink(None).parse_buffer(bytearray(frame))
    return message


def ours() -> bytes:
    adapter = ADAPTERS["px4-copter"](SYSTEM)
    autopilot = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
    vx, vy = (round(100.0 * SPEED_M_S * part(math.radians(HEADING_DEG))) for part in (math.cos, math.sin))
    for message in (
        common.MAVLink_heartbeat_message(2, common.MAV_AUTOPILOT_PX4, 129, 6 << 16, 4, 3),
        common.MAVLink_global_position_int_message(1, 470_000_000, 80_000_000, 0, 20_000, vx, vy, 0, 0),
    ):
        adapter.receive(bytes(message.pack(autopilot)), 0.0)
    heading_rad = math.radians(HEADING_DEG)
    # The second says the heading itself: the first was still on the way from what telemetry said.
    adapter.encode(Setpoint(heading_rad, SPEED_M_S, 20.0 + 2.0 * CLIMB_M_S), 0.0, 0.0)
    (frame,) = adapter.encode(Setpoint(heading_rad, SPEED_M_S, 20.0 + 2.0 * CLIMB_M_S), 0.0, 1.0)
    return frame


def test_mavsdk_sends_the_same_velocity_yaw_mask_and_frame() -> None:
    run = subprocess.run([sys.executable, "-c", MAVSDK], capture_output=True, text=True, timeout=30, check=True)
    theirs, own = decoded(bytes.fromhex(run.stdout)), decoded(ours())
    for name in ("target_system", "target_component", "coordinate_frame", "type_mask", "x", "y", "z", "yaw_rate"):
        assert getattr(theirs, name) == getattr(own, name), name
    for name in ("vx", "vy", "vz", "afx", "afy", "afz", "yaw"):
        # MAVSDK turns degrees into radians in single precision.
        assert math.isclose(getattr(theirs, name), getattr(own, name), abs_tol=1e-6), name
