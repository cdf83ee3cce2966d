"""The safety pilot, who hands a vehicle to its companion by a mode change, as ground-control programs do."""

from __future__ import annotations

from pymavlink.dialects.v20 import common as mavlink

from sim.mavlink_sender import MavlinkSender

HAND_OVER_S = 2.0
"""Time of the flight at which the pilot hands over: by then the companion has read the autopilot's parameters."""
REPEAT_S = 1.0
"""Time after which the mode change is commanded again if HEARTBEAT does not show it: PX4 obeys only once it has had
setpoints for a second."""
_GROUND_CONTROL_SYSTEM = 255
_PX4_OFFBOARD = 6
"""OFFBOARD as PX4's main mode, which is in bits 16 to 23 of its custom_mode."""
_GUIDED = {"arducopter": 4, "arduplane": 15, "px4-copter": _PX4_OFFBOARD << 16, "px4-plane": _PX4_OFFBOARD << 16}
"""custom_mode of the guided mode, in which an autopilot obeys its companion, by autopilot kind."""


class SafetyPilot:
    """Commands one vehicle into its guided mode until it is there, and never again when the mode changes later."""

    def __init__(self, kind: str, system_id: int) -> None:
        """Hand over the vehicle with this MAVLink system id; raise KeyError for a kind without a guided mode."""
        self.guided_mode = _GUIDED[kind]
        self._is_px4 = kind.startswith("px4")
        self._system_id = system_id
        self._sender = MavlinkSender(_GROUND_CONTROL_SYSTEM, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._next_s = HAND_OVER_S
        self.done = False

    def orders(self, t_s: float, mode: int | None) -> list[bytes]:
        """Return the frames to send at a time of the flight to the vehicle, whose HEARTBEAT shows this custom_mode."""
        self.done = self.done or mode == self.guided_mode
        if self.done or t_s < self._next_s:
            return []
        self._next_s = t_s + REPEAT_S
        number = _PX4_OFFBOARD if self._is_px4 else self.guided_mode
        return [
            self._sender.pack(
                self._sender.mav.command_long_encode(
                    self._system_id,
                    mavlink.MAV_COMP_ID_AUTOPILOT1,
                    mavlink.MAV_CMD_DO_SET_MODE,
                    0,
                    *(mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, number, 0.0, 0.0, 0.0, 0.0, 0.0),
                )
            )
        ]

    def heartbeat(self) -> bytes:
        """Return a HEARTBEAT frame of the pilot's ground-control program."""
        return self._sender.pack(
            self._sender.mav.heartbeat_encode(
                mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE
            )
        )
