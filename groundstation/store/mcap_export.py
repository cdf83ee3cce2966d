"""Exports a store as MCAP, which Foxglove and the tools around it open: map, scene and log of the day.

The messages are Foxglove's own schemas as protobuf: `/events` (Log), `/agents/ID` (LocationFix), `/map` (GeoJSON of
targets, threats and fence) and `/scene` (SceneUpdate in metres: x east, y north).
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from foxglove_schemas_protobuf.Color_pb2 import Color
from foxglove_schemas_protobuf.GeoJSON_pb2 import GeoJSON
from foxglove_schemas_protobuf.LocationFix_pb2 import LocationFix
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.writer import Writer

from companion.geo.local_frame import LocalFrame
from companion.mission.places import DEGREE_DECIMALS
from groundstation.store.database import Database
from groundstation.store.export import Slice, details_of, events_in

FRAME = "mission"
"""Name of the scene's frame: the mission's plane, its origin at (0, 0)."""
NS_PER_S = 1_000_000_000
LIFETIME_S = 5
"""Time after which what no picture has any more leaves the scene."""
CIRCLE_POINTS = 48
_COLOURS = {
    "agent": (1.0, 1.0, 1.0, 1.0),
    "target": (0.2, 0.7, 0.3, 0.9),
    "detection": (0.12, 0.37, 0.82, 0.25),
    "attack": (0.82, 0.11, 0.11, 0.35),
}
_HEIGHT_M = 1.0
"""Height of the flat cylinders of radii."""

Json = Mapping[str, Any]


def write_mcap(database: Database, path: Path, time: Slice) -> int:
    """Write events and pictures of a time in its order; return the number of messages.

    Raises:
        OSError: the file cannot be written.

    """
    count = 0
    with path.open("wb") as file, Writer(file) as writer:
        for at_s, topic, message in _merged(database, time):
            at_ns = round(at_s * NS_PER_S)
            writer.write_message(topic, message, log_time=at_ns, publish_time=at_ns)
            count += 1
    return count


def _merged(database: Database, time: Slice) -> Iterator[tuple[float, str, Message]]:
    """Yield what is written, by time: the events up to each picture before it."""
    events = events_in(database, time)
    event = next(events, None)
    for recorded in database.recorded("picture", time.from_s, time.to_s):
        while event is not None and event.unix_s <= recorded.unix_s:
            yield event.unix_s, "/events", _log(event.unix_s, event.event, event.who, details_of(event))
            event = next(events, None)
        for topic, message in picture_messages(json.loads(recorded.body), recorded.unix_s):
            yield recorded.unix_s, topic, message
    while event is not None:
        yield event.unix_s, "/events", _log(event.unix_s, event.event, event.who, details_of(event))
        event = next(events, None)


def picture_messages(picture: Json, at_s: float) -> Iterator[tuple[str, Message]]:
    """Yield the messages that show one picture, with their topics."""
    origin = picture["origin"]
    frame = LocalFrame(origin["lat_deg"], origin["lon_deg"])
    stamp = _stamp(at_s)
    for agent in picture["agents"]:
        lat_deg, lon_deg = frame.to_global(agent["north_m"], agent["east_m"])
        fix = LocationFix(
            timestamp=stamp, frame_id=FRAME, latitude=lat_deg, longitude=lon_deg, altitude=origin["alt_m"]
        )
        yield f"/agents/{agent['id']}", fix
    yield "/map", GeoJSON(geojson=json.dumps(_features(picture, frame)))
    yield "/scene", SceneUpdate(entities=list(_entities(picture, stamp)))


def _log(at_s: float, event: str, who: str, details: Json) -> Log:
    words = json.dumps(details) if details else ""
    return Log(timestamp=_stamp(at_s), level=Log.INFO, message=f"{event} {words}".strip(), name=who)


def _entities(picture: Json, stamp: Timestamp) -> Iterator[SceneEntity]:
    for agent in picture["agents"]:
        entity = _entity(f"agent {agent['id']}", stamp)
        arrow = entity.arrows.add()
        arrow.pose.CopyFrom(_pose(agent, agent.get("heading_deg") or 0.0))
        arrow.shaft_length, arrow.shaft_diameter, arrow.head_length, arrow.head_diameter = 6.0, 2.0, 6.0, 5.0
        arrow.color.CopyFrom(_colour("agent"))
        _add_text(entity, agent, str(agent["id"]))
        yield entity
    for target in picture["targets"]:
        entity = _entity(f"target {target['id']}", stamp)
        _add_disc(entity, target, picture["arrival_radius_m"], "target")
        _add_text(entity, target, target["name"] or str(target["id"]))
        yield entity
    for threat in picture["threats"]:
        entity = _entity(f"threat {threat['id']}", stamp)
        for key, colour in (("detection_radius_m", "detection"), ("attack_radius_m", "attack")):
            _add_disc(entity, threat, threat[key] + threat["growth_m"], colour)
        _add_text(entity, threat, threat["name"] or f"T{threat['id']}")
        yield entity


def _entity(name: str, stamp: Timestamp) -> SceneEntity:
    entity = SceneEntity(timestamp=stamp, frame_id=FRAME, id=name)
    entity.lifetime.seconds = LIFETIME_S
    return entity


def _add_disc(entity: SceneEntity, thing: Json, radius_m: float, colour: str) -> None:
    disc = entity.cylinders.add()
    disc.pose.CopyFrom(_pose(thing, 0.0))
    disc.size.x = disc.size.y = 2.0 * radius_m
    disc.size.z = _HEIGHT_M
    disc.bottom_scale = disc.top_scale = 1.0
    disc.color.CopyFrom(_colour(colour))


def _add_text(entity: SceneEntity, thing: Json, words: str) -> None:
    text = entity.texts.add()
    text.pose.CopyFrom(_pose(thing, 0.0))
    text.billboard, text.scale_invariant, text.font_size, text.text = True, True, 14.0, words
    text.color.CopyFrom(_colour("agent"))


def _pose(thing: Json, heading_deg: float) -> Pose:
    """Return the pose of a thing: x east, y north, turned from east to its heading."""
    pose = Pose()
    pose.position.x, pose.position.y = thing["east_m"], thing["north_m"]
    half_rad = math.radians(90.0 - heading_deg) / 2.0
    pose.orientation.z, pose.orientation.w = math.sin(half_rad), math.cos(half_rad)
    return pose


def _colour(name: str) -> Color:
    red, green, blue, alpha = _COLOURS[name]
    return Color(r=red, g=green, b=blue, a=alpha)


def _stamp(at_s: float) -> Timestamp:
    whole_s, rest_ns = divmod(round(at_s * NS_PER_S), NS_PER_S)
    return Timestamp(seconds=whole_s, nanos=rest_ns)


def _features(picture: Json, frame: LocalFrame) -> Json:
    """Return targets, the radii of threats, fence and exclusions as GeoJSON."""
    features = []
    for target in picture["targets"]:
        place = {"type": "Point", "coordinates": _lon_lat(frame, target["north_m"], target["east_m"])}
        features.append(_feature(place, f"target {target['id']}"))
    for threat in picture["threats"]:
        for key in ("detection_radius_m", "attack_radius_m"):
            ring = _circle(threat, threat[key] + threat["growth_m"])
            features.append(_feature(_polygon(frame, ring), f"threat {threat['id']}, {key.split('_')[0]}"))
    if picture["fence"] is not None:
        features.append(_feature(_polygon(frame, picture["fence"]), "fence"))
    features += [_feature(_polygon(frame, corners), "exclusion") for corners in picture["exclusions"]]
    return {"type": "FeatureCollection", "features": features}


def _feature(geometry: Json, name: str) -> Json:
    return {"type": "Feature", "properties": {"name": name}, "geometry": geometry}


def _polygon(frame: LocalFrame, corners: Sequence[Sequence[float]]) -> Json:
    return {"type": "Polygon", "coordinates": [[_lon_lat(frame, *corner) for corner in (*corners, corners[0])]]}


def _lon_lat(frame: LocalFrame, north_m: float, east_m: float) -> list[float]:
    lat_deg, lon_deg = frame.to_global(north_m, east_m)
    return [round(lon_deg, DEGREE_DECIMALS), round(lat_deg, DEGREE_DECIMALS)]


def _circle(thing: Json, radius_m: float) -> list[tuple[float, float]]:
    steps = [2.0 * math.pi * step / CIRCLE_POINTS for step in range(CIRCLE_POINTS)]
    return [
        (thing["north_m"] + radius_m * math.cos(angle), thing["east_m"] + radius_m * math.sin(angle)) for angle in steps
    ]
