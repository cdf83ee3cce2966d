"""Shows threats and dead-reckoned agents as ADSB_VEHICLE on common ground-control programs.

It is a display on a port of its own: no vehicle of ours listens to it, and nothing depends on it.
"""

from __future__ import annotations

import math

from pymavlink.dialects.v20 import common

from companion.geo.local_frame import LocalFrame
from companion.mission.model import Mission, agent_height_m
from companion.protocol.codec import GROUND_SYSTEM, Kind
from groundstation.track import Track
from groundstation.tracks import TrackTable

PERIOD_S = 1.0
"""Period of the frames; ground-control programs drop a contact after some seconds without one."""
THREAT_ADDRESS, AGENT_ADDRESS = 0xFE0000, 0xFD0000
"""Offsets added to an id to make a contact's 24-bit address; no state's block of addresses is that high."""
_DUE_TOLERANCE_S = 1e-6
_LONGEST_UNHEARD_S = 255
_MOST_CM_S = 65_535
_CALLSIGN_BYTES = 8
_KNOWN = (
    common.ADSB_FLAGS_VALID_COORDS
    | common.ADSB_FLAGS_VALID_HEADING
    | common.ADSB_FLAGS_VALID_VELOCITY
    | common.ADSB_FLAGS_VALID_CALLSIGN
)


class AdsbMirror:
    """Makes the frames of the display once every PERIOD_S."""

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self._frame = LocalFrame(mission.origin.lat_deg, mission.origin.lon_deg)
        self._mav = common.MAVLink(None, srcSystem=GROUND_SYSTEM, srcComponent=common.MAV_COMP_ID_ADSB)
        self._due_s = -math.inf

    def tick(self, picture: TrackTable, now_s: float) -> list[bytes]:
        """Return a heartbeat and one frame for each contact; nothing before they are due."""
        if now_s < self._due_s - _DUE_TOLERANCE_S:
            return []
        self._due_s = now_s + PERIOD_S
        heartbeat = common.MAVLink_heartbeat_message(
            common.MAV_TYPE_ADSB, common.MAV_AUTOPILOT_INVALID, 0, 0, common.MAV_STATE_ACTIVE, 3
        )
        messages = [heartbeat]
        for threat in picture.mission.threats:
            messages.append(self._contact(Kind.THREAT, threat.id, picture.tracks[Kind.THREAT, threat.id], now_s))
        if self._mission.case == "II":
            for identity in picture.present_agents:
                messages.append(self._contact(Kind.AGENT, identity, picture.tracks[Kind.AGENT, identity], now_s))
        return [self._packed(message) for message in messages]

    def _contact(self, kind: Kind, identity: int, track: Track, now_s: float) -> common.MAVLink_adsb_vehicle_message:
        lat_deg, lon_deg, convergence_rad = self._frame.to_global_with_convergence(*track.position_ned_m)
        course_rad = math.atan2(track.velocity_east_m_s, track.velocity_north_m_s) + convergence_rad
        speed_m_s = math.hypot(track.velocity_north_m_s, track.velocity_east_m_s)
        is_agent = kind is Kind.AGENT
        # A threat's height is unknown; the origin's is sent without the flag that would mark it as valid.
        height_m = agent_height_m(self._mission, identity) if is_agent else 0.0
        return common.MAVLink_adsb_vehicle_message(
            ICAO_address=(AGENT_ADDRESS if is_agent else THREAT_ADDRESS) + identity,
            lat=round(lat_deg * 1e7),
            lon=round(lon_deg * 1e7),
            altitude_type=common.ADSB_ALTITUDE_TYPE_GEOMETRIC,
            altitude=round((self._mission.origin.alt_m + height_m) * 1_000.0),
            heading=round(math.degrees(course_rad) * 100.0) % 36_000,
            hor_velocity=min(round(speed_m_s * 100.0), _MOST_CM_S),
            ver_velocity=0,
            callsign=f"{'A' if is_agent else 'T'}{identity}".encode()[:_CALLSIGN_BYTES],
            emitter_type=common.ADSB_EMITTER_TYPE_UAV if is_agent else common.ADSB_EMITTER_TYPE_NO_INFO,
            tslc=min(math.ceil(track.age_s(now_s)), _LONGEST_UNHEARD_S),
            flags=_KNOWN | (common.ADSB_FLAGS_VALID_ALTITUDE if is_agent else 0),
            squawk=0,
        )

    def _packed(self, message: common.MAVLink_message) -> bytes:
        data = bytes(message.pack(self._mav))
        self._mav.seq = (self._mav.seq + 1) % 256
        return data
