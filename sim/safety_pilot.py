"""The safety pilot, who has the vehicle: gives it to the companion by a mode change, as ground-control programs do."""

from __future__ import annotations

from pymavlink.dialects.v20 import common as mavlink

from sim.mavlink_sender import MavlinkSender

HAND_OVER_S = 2.0
"""When the safety pilot acts, from the beginning of a flight: by then the companion has its autopilot's parameters."""
REPEAT_S = 1.0
"""A mode change that HEARTBEAT does not show is asked for again: PX4 wants a second of setpoints before it obeys."""
_GROUND_CONTROL_SYSTEM = 255
_PX4_OFFBOARD = 6
"""PX4's main mode, bits 16 to 23 of its custom_mode."""
_GUIDED = {"arducopter": 4, "arduplane": 15, "px4-copter": _PX4_OFFBOARD << 16, "px4-plane": _PX4_OFFBOARD << 16}
"""custom_mode of the mode that obeys a companion, by autopilot kind."""


class SafetyPilot:
    """Asks one vehicle to obey its companion until it does, then leaves it alone: whatever takes it away is final."""

    def __init__(self, kind: str, system_id: int) -> None:
        """Mind the vehicle of that MAVLink system id; KeyError for a kind that nobody hands over."""
        self.guided_mode = _GUIDED[kind]
        self._is_px4 = kind.startswith("px4")
        self._system_id = system_id
        self._sender = MavlinkSender(_GROUND_CONTROL_SYSTEM, mavlink.MAV_COMP_ID_MISSIONPLANNER)
        self._next_s = HAND_OVER_S
        self.done = False

    def orders(self, t_s: float, mode: int | None) -> list[bytes]:
        """Return what is sent to the vehicle at a time of the flight, its HEARTBEAT having shown a custom_mode."""
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
        """Return the ground-control program's heartbeat."""
        return self._sender.pack(
            self._sender.mav.heartbeat_encode(
                mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE
            )
        )
