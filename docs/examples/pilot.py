"""A person's part, by MAVLink: put the copter into GUIDED, arm it and take off; then the companion steers it.

Usage: python docs/examples/pilot.py [udpout:127.0.0.1:14550] [HEIGHT_M]
"""

from __future__ import annotations

import os
import sys
import time

os.environ["MAVLINK20"] = "1"

from pymavlink import mavutil  # noqa: E402  (reads MAVLINK20 when imported)

GUIDED = 4


def command(link: mavutil.mavfile, number: int, *parameters: float) -> None:
    """Send a command until it is accepted: an autopilot that has just started refuses for a while."""
    values = [*parameters, 0, 0, 0, 0, 0, 0, 0][:7]
    for _ in range(30):
        link.mav.command_long_send(link.target_system, link.target_component, number, 0, *values)
        answer = link.recv_match(type="COMMAND_ACK", blocking=True, timeout=2)
        if answer is not None and answer.command == number and answer.result == 0:
            return
        time.sleep(1.0)
    sys.exit(f"pilot: command {number} was not accepted")


def choose(link: mavutil.mavfile, mode: int) -> None:
    """Change the mode until the heartbeat shows it: ArduPilot acknowledges it before it is ready, and forgets it."""
    for _ in range(30):
        command(link, mavutil.mavlink.MAV_CMD_DO_SET_MODE, 1, mode)
        for _ in range(2):
            heartbeat = link.recv_match(type="HEARTBEAT", blocking=True, timeout=2)
        if heartbeat is not None and heartbeat.custom_mode == mode:
            return
    sys.exit(f"pilot: mode {mode} was not taken")


def main() -> None:
    """Take off and leave."""
    url = sys.argv[1] if len(sys.argv) > 1 else "udpout:127.0.0.1:14550"
    height_m = float(sys.argv[2]) if len(sys.argv) > 2 else 20.0
    link = mavutil.mavlink_connection(url, source_system=255)
    for _ in range(30):
        # Whoever listens on a udpin link learns of us by what we send.
        link.mav.heartbeat_send(mavutil.mavlink.MAV_TYPE_GCS, mavutil.mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 0)
        if link.wait_heartbeat(timeout=1) is not None:
            break
    else:
        sys.exit(f"pilot: no autopilot on {url}")
    # Armed in the mode that it stands in, so that it is ready: what is chosen before is forgotten.
    command(link, mavutil.mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    choose(link, GUIDED)
    command(link, mavutil.mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height_m)
    print(f"pilot: GUIDED, armed, taking off to {height_m:g} m", flush=True)
    time.sleep(0.1)


if __name__ == "__main__":
    main()
