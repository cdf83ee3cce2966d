"""Agents by their own MAVLink telemetry, and aircraft by ADSB_VEHICLE, on any link and of both versions of MAVLink.

Several vehicles may share a link, and a router may copy frames: of each system, only what is newer by the autopilot's
own clock counts (companion/autopilot/boot_clock.py).
"""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Hashable, Iterator

from pymavlink.dialects.v20 import common

from companion.autopilot.boot_clock import SHARED_MEMORY_S, BootClock, Clocked
from companion.autopilot.identity import AUTOPILOT_COMPONENT
from companion.autopilot.intake import Intake, Message, decode
from companion.geo.degrees import is_on_earth
from companion.protocol.codec import GROUND_SYSTEM
from groundstation.sources.sighting import (
    NO_PLACE,
    Category,
    Datum,
    Sighting,
    altitude_of,
    count,
    short,
    velocity_of,
)

MOST_COPIES = 512
"""Greatest number of aircraft whose newest frame is remembered, to know a copy of it."""
COPY_S = 1.0
"""Time within which the same bytes about an aircraft are a copy and no new word."""
NO_VELOCITY = -32_768
FRESH_S = 30.0
"""Greatest time since an aircraft was last heard by the receiver itself for its report to be taken in."""
_NO_HEADING = 65_535
_SURFACE = (common.ADSB_EMITTER_TYPE_EMERGENCY_SURFACE, common.ADSB_EMITTER_TYPE_SERVICE_SURFACE)


class TelemetryParser:
    """Makes sightings of agents from GLOBAL_POSITION_INT; the key is the system id."""

    def __init__(self) -> None:
        self.refused: Counter[str] = Counter()
        self._intake = Intake()
        self._clocks: dict[int, BootClock] = {}

    def feed(self, data: bytes, now_s: float, peer: Hashable = None) -> list[Sighting]:
        """Return the sightings in the frames that bytes of one sender complete."""
        found = (self._sighting(one, system, component, now_s) for one, system, component in self._messages(data, peer))
        return [one for one in found if one is not None]

    def _messages(self, data: bytes, peer: Hashable) -> Iterator[tuple[Message, int, int]]:
        for frame in self._intake.feed(data, peer):
            if frame.message_id == common.MAVLINK_MSG_ID_GLOBAL_POSITION_INT:
                message = decode(frame)
                if message is not None:
                    yield message, frame.system, frame.component

    def _sighting(self, message: Message, system: int, component: int, now_s: float) -> Sighting | None:
        if component != AUTOPILOT_COMPONENT:
            count(self.refused, "not of an autopilot")
            return None
        clock = self._clocks.setdefault(system, BootClock())
        boot_ms = message.time_boot_ms
        clocked = clock.take(boot_ms, now_s)
        if clocked is not Clocked.NEWER:
            # A copy that a router made says nothing new and is no fault.
            if clocked is not Clocked.SAME:
                count(self.refused, clocked.value)
                clock.compare_place(boot_ms, message.lat, message.lon, now_s)
            return None
        if (message.lat == 0 and message.lon == 0) or not is_on_earth(message.lat, message.lon):
            # An autopilot without a fix tells 0, 0.
            count(self.refused, NO_PLACE)
            return None
        clock.note_place(boot_ms, message.lat, message.lon, now_s)
        if now_s - clock.two.noticed_s <= SHARED_MEMORY_S:
            count(self.refused, f"two autopilots say they are system {system}")
            return None
        return Sighting(
            key=str(system),
            lat_deg=message.lat / 1e7,
            lon_deg=message.lon / 1e7,
            at_s=now_s,
            velocity=complex(message.vx, message.vy) / 100.0 if message.vx != NO_VELOCITY else None,
            altitude_m=altitude_of(message.alt / 1e3),
        )


class AdsbParser:
    """Makes sightings of aircraft from ADSB_VEHICLE; the key is the ICAO address."""

    def __init__(self) -> None:
        self.refused: Counter[str] = Counter()
        self._intake = Intake()
        self._newest: OrderedDict[int, tuple[bytes, float]] = OrderedDict()

    def feed(self, data: bytes, now_s: float, peer: Hashable = None) -> list[Sighting]:
        """Return the sightings in the frames that bytes of one sender complete."""
        found = []
        for frame in self._intake.feed(data, peer):
            if frame.message_id != common.MAVLINK_MSG_ID_ADSB_VEHICLE:
                continue
            if frame.system == GROUND_SYSTEM and frame.component == common.MAV_COMP_ID_ADSB:
                count(self.refused, "a ground station's own mirror")
                continue
            message = decode(frame)
            if message is None or self._is_copy(message.ICAO_address, frame.payload, now_s):
                continue
            sighting = self._sighting(message, now_s)
            if sighting is not None:
                found.append(sighting)
        return found

    def _is_copy(self, address: int, payload: bytes, now_s: float) -> bool:
        before = self._newest.pop(address, None)
        is_copy = before is not None and before[0] == payload and now_s - before[1] < COPY_S
        self._newest[address] = before if is_copy and before is not None else (payload, now_s)
        if len(self._newest) > MOST_COPIES:
            self._newest.popitem(last=False)
        return is_copy

    def _sighting(self, message: Message, now_s: float) -> Sighting | None:
        flags = message.flags
        if not flags & common.ADSB_FLAGS_VALID_COORDS or not is_on_earth(message.lat, message.lon):
            count(self.refused, NO_PLACE)
            return None
        if message.tslc > FRESH_S:
            count(self.refused, "heard too long ago")
            return None
        velocity = None
        if flags & common.ADSB_FLAGS_VALID_VELOCITY:
            heading = message.heading / 100.0 if flags & common.ADSB_FLAGS_VALID_HEADING else None
            velocity = velocity_of(message.hor_velocity / 100.0, None if message.heading == _NO_HEADING else heading)
        altitude_m = message.altitude / 1e3 if flags & common.ADSB_FLAGS_VALID_ALTITUDE else None
        is_geometric = message.altitude_type == common.ADSB_ALTITUDE_TYPE_GEOMETRIC
        return Sighting(
            key=f"{message.ICAO_address & 0xFFFFFF:06X}",
            lat_deg=message.lat / 1e7,
            lon_deg=message.lon / 1e7,
            at_s=now_s - message.tslc,
            velocity=velocity,
            altitude_m=altitude_of(altitude_m),
            datum=Datum.ELLIPSOID if is_geometric else Datum.PRESSURE,
            category=Category.VEHICLE if message.emitter_type in _SURFACE else Category.AIRCRAFT,
            name=_callsign(message) if flags & common.ADSB_FLAGS_VALID_CALLSIGN else "",
        )


def _callsign(message: Message) -> str:
    """Return the callsign of an ADSB_VEHICLE, which pymavlink gives as text or as bytes."""
    told = message.callsign
    return short(told.decode("ascii", "replace") if isinstance(told, bytes) else str(told), 8)
