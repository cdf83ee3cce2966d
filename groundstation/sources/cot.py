"""Cursor on Target events: XML as TAK servers stream it, or TAK's protocol of version 1 (protobuf) by takproto.

An event's `time` is when it was made and `stale` until when it counts. XML is read by the standard library and not by
takproto's converter, which refuses an event for a battery's decimal point and for times with seven decimals. What
stands before an event is not read: so no document type can make gigabytes of a few bytes, as none can be inside of one.
"""

from __future__ import annotations

import math
import re
from collections import Counter, OrderedDict
from collections.abc import Hashable
from datetime import UTC, datetime
from xml.etree import ElementTree

from groundstation.sources.lines import MOST_SENDERS
from groundstation.sources.sighting import (
    NO_PLACE,
    NOT_WHOLE,
    Category,
    Datum,
    Sighting,
    altitude_of,
    count,
    is_place,
    number_from,
    short,
    velocity_of,
)

MOST_EVENT_BYTES = 65_536
"""Greatest length of an event, that of the longest datagram."""
UNKNOWN_M = 9_999_999.0
"""Value of `hae`, `ce` and `le` that stands for an unknown one."""
NO_THING = "no place of a thing"
"""Reason for events that are no atoms: drawings, chats, tasks and pings."""
_MAGIC = 0xBF
_MESH = bytes((_MAGIC, 1, _MAGIC))
"""Beginning of a datagram of TAK's protocol, version 1; on a stream the length follows the first byte."""
_BEGIN = re.compile(rb"<event[\s>]|\xbf")
_END = b"</event>"
_DIMENSIONS = {"A": Category.AIRCRAFT, "S": Category.SHIP, "U": Category.SHIP, "G": Category.VEHICLE}
"""Categories by the battle dimension in an event's type, a-AFFILIATION-DIMENSION-..."""
_MOST_LENGTH_BYTES = 3
"""Greatest number of bytes of a length on a stream that MOST_EVENT_BYTES needs."""


class CotParser:
    """Makes sightings of the things in CoT events, which come in datagrams or on a stream."""

    def __init__(self) -> None:
        self.refused: Counter[str] = Counter()
        self._kept: OrderedDict[Hashable, bytes] = OrderedDict()

    def feed(self, data: bytes, now_s: float, peer: Hashable = None) -> list[Sighting]:
        """Return the sightings in the events that bytes of one sender complete."""
        if data.startswith(_MESH):
            # A datagram, and so whole.
            found = [self._from_protobuf(data[len(_MESH) : MOST_EVENT_BYTES])]
        else:
            found = self._from_stream(self._kept.pop(peer, b"") + data, peer)
        return [one for one in found if one is not None]

    def _from_stream(self, data: bytes, peer: Hashable) -> list[Sighting | None]:
        found: list[Sighting | None] = []
        at = 0
        while (begin := _BEGIN.search(data, at)) is not None:
            at = begin.start()
            if data[at] == _MAGIC:
                body = _delimited(data, at + 1)
                if body is None:
                    count(self.refused, NOT_WHOLE)
                    at += 1
                    continue
                start, end = body
                if end > len(data):
                    break
                found.append(self._from_protobuf(data[start:end]))
            else:
                end = data.find(_END, at)
                if end < 0:
                    break
                end += len(_END)
                found.append(self._from_xml(data[at:end]))
            at = end
        else:
            # A start may be cut off at the end.
            at = max(at, len(data) - len(b"<event"))
        if len(data) - at > MOST_EVENT_BYTES:
            count(self.refused, "event too long")
            return found
        if at < len(data):
            self._kept[peer] = data[at:]
            if len(self._kept) > MOST_SENDERS:
                self._kept.popitem(last=False)
        return found

    def _from_xml(self, data: bytes) -> Sighting | None:
        try:
            event = ElementTree.fromstring(data.decode("utf-8"))
        except (ValueError, ElementTree.ParseError, RecursionError):
            count(self.refused, NOT_WHOLE)
            return None
        point, track = event.find("point"), event.find("detail/track")
        contact = event.find("detail/contact")
        made_s, stale_s = _unix_s(event.get("time", "")), _unix_s(event.get("stale", ""))
        if point is None or made_s is None:
            count(self.refused, NOT_WHOLE)
            return None
        lat_deg, lon_deg, hae_m, ce_m = (number_from(point.get(key, "")) for key in ("lat", "lon", "hae", "ce"))
        speed_m_s, course_deg = (None if track is None else number_from(track.get(k, "")) for k in ("speed", "course"))
        name = "" if contact is None else contact.get("callsign", "")
        event_type, uid = event.get("type", ""), event.get("uid", "")
        velocity = velocity_of(speed_m_s, course_deg)
        return self._sighting(event_type, uid, (lat_deg, lon_deg, hae_m, ce_m), (made_s, stale_s), velocity, name)

    def _from_protobuf(self, data: bytes) -> Sighting | None:
        from google.protobuf.message import DecodeError
        from takproto import parse_mesh

        try:
            message = parse_mesh(_MESH + data)
        except (DecodeError, ValueError, RecursionError):
            count(self.refused, NOT_WHOLE)
            return None
        event = message.cotEvent
        track = event.detail.track
        has_track = event.detail.HasField("track")
        velocity = velocity_of(track.speed, track.course) if has_track else None
        times_s = (event.sendTime / 1e3, event.staleTime / 1e3 if event.staleTime else None)
        point = (event.lat, event.lon, event.hae, event.ce)
        return self._sighting(event.type, event.uid, point, times_s, velocity, event.detail.contact.callsign)

    def _sighting(
        self,
        event_type: str,
        uid: str,
        point: tuple[float | None, float | None, float | None, float | None],
        times_s: tuple[float, float | None],
        velocity: complex | None,
        name: str,
    ) -> Sighting | None:
        """Return the sighting in an event; `point` is latitude, longitude, height and circular error."""
        lat_deg, lon_deg, hae_m, ce_m = point
        key = short(uid, 80)
        if not event_type.startswith("a-") or not key:
            count(self.refused, NO_THING)
            return None
        if lat_deg is None or lon_deg is None or not is_place(lat_deg, lon_deg):
            count(self.refused, NO_PLACE)
            return None
        dimension = event_type.split("-")[2:3]
        return Sighting(
            key=key,
            lat_deg=lat_deg,
            lon_deg=lon_deg,
            at_s=times_s[0],
            velocity=velocity,
            altitude_m=altitude_of(None if hae_m is None or not hae_m < UNKNOWN_M else hae_m),
            datum=Datum.ELLIPSOID,
            category=_DIMENSIONS.get(dimension[0]) if dimension else None,
            error_m=ce_m if ce_m is not None and 0.0 < ce_m < UNKNOWN_M else None,
            name=short(name),
            until_s=times_s[1],
        )


def _delimited(data: bytes, at: int) -> tuple[int, int] | None:
    """Return where a message on a stream begins and ends, after its length; None if that is no sane length.

    While the length itself is not all there the end is beyond the data.
    """
    length = shift = 0
    for place in range(at, at + _MOST_LENGTH_BYTES):
        if place >= len(data):
            return place, len(data) + 1
        length |= (data[place] & 0x7F) << shift
        shift += 7
        if data[place] < 0x80:
            return (place + 1, place + 1 + length) if 0 < length <= MOST_EVENT_BYTES else None
    return None


def _unix_s(text: str) -> float | None:
    """Return the Unix time of an ISO 8601 text, taken for UTC where it names no zone; None if it is none."""
    try:
        read = datetime.fromisoformat(text)
    except ValueError:
        return None
    unix_s = (read if read.tzinfo is not None else read.replace(tzinfo=UTC)).timestamp()
    return unix_s if math.isfinite(unix_s) else None
