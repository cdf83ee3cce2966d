"""`groundstation import`: whatever a valid file draws comes out, and whatever else goes in is refused on one line."""

from __future__ import annotations

import copy
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.errors import InputError
from companion.geo.local_frame import LocalFrame
from companion.mission.model import Mission, parse_mission
from companion.mission.resolve import resolve
from groundstation.cli import cli
from groundstation.imports.command import read_drawing
from groundstation.imports.drawing import MAX_FILE_BYTES
from groundstation.imports.mission_text import Wanted, mission_text

HERE = Path(__file__).parent
PLAN: dict[str, Any] = json.loads((HERE / "survey.plan").read_text())
KML = (HERE / "field.kml").read_text()
GEOJSON: dict[str, Any] = json.loads((HERE / "field.geojson").read_text())
HOME = (47.3977, 8.5456)
FRAME = LocalFrame(*HOME)
NOBODY = Wanted(None, 1, None)
Point = tuple[float, float]


def mission_from(content: bytes, wanted: Wanted = NOBODY) -> Mission:
    text, _ = mission_text(read_drawing(content), wanted, "imported", "file")
    return resolve(parse_mission(text, "file"), 1)


def run(path: Path, *arguments: str) -> tuple[str, str]:
    """Import a file; return the mission's text and what was said."""
    outcome = CliRunner().invoke(cli, ["import", str(path), *arguments], standalone_mode=False)
    assert outcome.exception is None, outcome.exception
    return outcome.stdout, outcome.stderr


@pytest.mark.parametrize("name", ["survey.plan", "field.kml", "field.geojson"])
def test_the_same_field_comes_out_of_each_format(name: str) -> None:
    text, _ = run(HERE / name)
    mission = resolve(parse_mission(text, name), 1)
    assert (mission.origin.lat_deg, mission.origin.lon_deg, mission.origin.alt_m) == (*HOME, 488.0)
    assert mission.fence is not None and len(mission.fence) == 4
    assert [len(corners) for corners in mission.exclusions] == [4]
    assert [(threat.detection_radius_m, threat.speed_bound_m_s) for threat in mission.threats] == [(35.0, 0.0)]
    assert [agent.position_ned_m for agent in mission.agents] == [(0.0, 0.0)]
    found = [target.position_ned_m for target in mission.targets]
    wanted = [FRAME.to_local(*place) for place in ((47.402, 8.547), (47.4018, 8.5515), (47.399, 8.5515))]
    assert all(math.dist(one, other) < 0.02 for one, other in zip(found, wanted, strict=True))
    assert mission.queue


def test_a_plan_says_what_flies_how_fast_and_how_high() -> None:
    agent = mission_from(json.dumps(PLAN).encode()).agents[0]
    assert (agent.speed_m_s, agent.height_m, agent.n_max) == (5.0, 40.0, 0.214)


def test_what_was_left_out_is_said_on_standard_error() -> None:
    _, said = run(HERE / "survey.plan")
    assert "mission.items: 1 left out: MAV_CMD 20" in said
    assert "rallyPoints: 1 left out: the way points are the targets" in said


def test_names_stand_beside_what_they_name() -> None:
    text, said = run(HERE / "field.kml")
    assert "- - {lat_deg: 47.4005000, lon_deg: 8.5490000}   # Barn & yard" in text and "radius_m: 35}   # Mast" in text
    assert "Placemark 2 'Farm land': all points lie inside, so that it became the fence" in said


def test_without_way_points_the_rally_points_are_the_targets() -> None:
    plan = copy.deepcopy(PLAN)
    plan["mission"]["items"] = []
    (target,) = mission_from(json.dumps(plan).encode()).targets
    assert math.dist(target.position_ned_m, FRAME.to_local(47.398, 8.546)) < 0.02


def test_an_inclusion_circle_becomes_a_polygon_inside_it() -> None:
    plan = copy.deepcopy(PLAN)
    plan["geoFence"] = {
        "version": 2,
        "circles": [{"circle": {"center": [47.4, 8.549], "radius": 600}, "inclusion": True}],
    }
    mission = mission_from(json.dumps(plan).encode())
    centre_m = FRAME.to_local(47.4, 8.549)
    assert mission.fence is not None
    assert all(599.0 < math.dist(corner, centre_m) < 600.1 for corner in mission.fence)


def test_home_kind_and_number_of_agents_are_taken_from_the_options_where_given(tmp_path: Path) -> None:
    text, _ = run(HERE / "field.geojson", "--home", "47.3980,8.5460,500", "--autopilot", "px4-copter", "--agents", "3")
    mission = resolve(parse_mission(text, "options"), 1)
    assert (mission.origin.lat_deg, mission.origin.alt_m) == (47.398, 500.0)
    assert [agent.speed_m_s for agent in mission.agents] == [10.0] * 3
    assert [round(agent.position_ned_m[1]) for agent in mission.agents] == [0, 30, 60]
    assert not mission.queue


def test_a_mission_is_written_to_a_new_file_and_to_no_other(tmp_path: Path) -> None:
    out = tmp_path / "mission.yaml"
    assert run(HERE / "survey.plan", "--out", str(out))[0] == ""
    assert parse_mission(out.read_text(), "out").name == "survey"
    refused = CliRunner().invoke(cli, ["import", str(HERE / "survey.plan"), "--out", str(out)], standalone_mode=False)
    assert str(refused.exception) == f"--out: {out} is there already; allowed: the name of a new file"


# Whatever a valid file draws comes out

inside_m = st.tuples(st.integers(-800, 800), st.integers(-800, 800)).map(
    lambda point: (float(point[0]), float(point[1]))
)
far_m = st.tuples(st.integers(1_500, 4_000), st.integers(-4_000, 4_000)).map(
    lambda point: (float(point[0]), float(point[1]))
)
radii_m = st.integers(1, 400).map(float)


def degrees(point_m: Point, *, turned: bool = False) -> list[float]:
    lat_deg, lon_deg = FRAME.to_global(*point_m)
    return [lon_deg, lat_deg] if turned else [lat_deg, lon_deg]


def square_m(centre_m: Point, half_m: float) -> list[Point]:
    return [
        (centre_m[0] + north * half_m, centre_m[1] + east * half_m)
        for north, east in ((-1, -1), (-1, 1), (1, 1), (1, -1))
    ]


def plan_of(targets_m: list[Point], discs: list[tuple[Point, float]], zones: list[tuple[Point, float]]) -> bytes:
    item = {"type": "SimpleItem", "command": 16, "frame": 3}
    return json.dumps({
        "fileType": "Plan", "version": 1,
        "geoFence": {
            "version": 2,
            "circles": [{"circle": {"center": degrees(at), "radius": size}, "inclusion": False} for at, size in discs],
            "polygons": [
                {"polygon": [degrees(each) for each in square_m(at, half)], "inclusion": False} for at, half in zones
            ],
        },
        "mission": {
            "version": 2, "plannedHomePosition": [*HOME, 400],
            "items": [{**item, "params": [0, 0, 0, None, *degrees(target), 30]} for target in targets_m],
        },
    }).encode()  # fmt: skip


def geojson_of(targets_m: list[Point], discs: list[tuple[Point, float]], zones: list[tuple[Point, float]]) -> bytes:
    def feature(kind: str, coordinates: object, **properties: object) -> dict[str, object]:
        return {"type": "Feature", "properties": properties, "geometry": {"type": kind, "coordinates": coordinates}}

    closed = [
        [degrees(corner, turned=True) for corner in (*square_m(at, half), square_m(at, half)[0])] for at, half in zones
    ]
    return json.dumps({
        "type": "FeatureCollection",
        "features": [
            feature("Point", [HOME[1], HOME[0], 400.0], role="home"),
            feature("MultiPoint", [degrees(target, turned=True) for target in targets_m]),
            *(feature("Point", degrees(at, turned=True), radius_m=radius) for at, radius in discs),
            *(feature("Polygon", [ring], name="Keep-out 1") for ring in closed),
        ],
    }).encode()  # fmt: skip


def kml_of(targets_m: list[Point], discs: list[tuple[Point, float]], zones: list[tuple[Point, float]]) -> bytes:
    def text(points_m: list[Point]) -> str:
        places = (degrees(point, turned=True) for point in points_m)
        return f"<coordinates>{' '.join(f'{lon_deg!r},{lat_deg!r},0' for lon_deg, lat_deg in places)}</coordinates>"

    marks = [
        f"<Placemark><name>launch</name><Point><coordinates>{HOME[1]},{HOME[0]},400</coordinates></Point></Placemark>"
    ]
    marks += [f"<Placemark><Point>{text([target])}</Point></Placemark>" for target in targets_m]
    size = "<ExtendedData><Data name='radius_m'><value>{}</value></Data></ExtendedData>"
    marks += [f"<Placemark>{size.format(radius)}<Point>{text([at])}</Point></Placemark>" for at, radius in discs]
    ring = "<Polygon><outerBoundaryIs><LinearRing>{}</LinearRing></outerBoundaryIs></Polygon>"
    marks += [
        f"<Placemark>{ring.format(text([*square_m(at, half), square_m(at, half)[0]]))}</Placemark>"
        for at, half in zones
    ]
    return f"<kml><Folder><name>Exclusions</name>{''.join(marks)}</Folder></kml>".encode()


@settings(max_examples=20, deadline=None)
@given(
    writer=st.sampled_from([plan_of, geojson_of, kml_of]),
    targets_m=st.lists(inside_m, min_size=1, max_size=6),
    discs=st.lists(st.tuples(far_m, radii_m), max_size=4),
    zones=st.lists(st.tuples(far_m, st.integers(5, 300).map(float)), max_size=3),
)
def test_every_point_disc_and_polygon_of_a_valid_file_comes_out(
    writer: Callable[[list[Point], list[tuple[Point, float]], list[tuple[Point, float]]], bytes],
    targets_m: list[Point],
    discs: list[tuple[Point, float]],
    zones: list[tuple[Point, float]],
) -> None:
    mission = mission_from(writer(targets_m, discs, zones))
    found = [target.position_ned_m for target in mission.targets]
    assert all(math.dist(one, other) < 0.05 for one, other in zip(found, targets_m, strict=True))
    for threat, (at, radius_m) in zip(mission.threats, discs, strict=True):
        assert math.dist(threat.position_ned_m, at) < 0.05 and threat.detection_radius_m == radius_m
    for corners, (at, half_m) in zip(mission.exclusions, zones, strict=True):
        assert all(math.dist(one, other) < 0.05 for one, other in zip(corners, square_m(at, half_m), strict=True))


# What is refused, on one line


def plan_with(path: str, value: object) -> bytes:
    plan = copy.deepcopy(PLAN)
    *keys, last = [int(key) if key.isdecimal() else key for key in path.split(".")]
    part: Any = plan
    for key in keys:
        part = part[key]
    if value is None:
        del part[last]
    else:
        part[last] = value
    return json.dumps(plan).encode()


def geojson_with(geometry: object, **properties: object) -> bytes:
    extra = {"type": "Feature", "properties": properties, "geometry": geometry}
    return json.dumps({**GEOJSON, "features": [*GEOJSON["features"], extra]}).encode()


def polygon(*rings: list[list[float]]) -> dict[str, object]:
    return {"type": "Polygon", "coordinates": list(rings)}


RING = [[8.55, 47.400], [8.551, 47.400], [8.551, 47.401], [8.55, 47.401], [8.55, 47.400]]
CROSSED = [[8.55, 47.400], [8.551, 47.401], [8.551, 47.400], [8.55, 47.401], [8.55, 47.400]]
BOMB = '<?xml version="1.0"?><!DOCTYPE kml [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]><kml>&b;</kml>'
REFUSED: dict[str, tuple[bytes, str]] = {
    "nothing": (b"", "neither JSON nor XML; allowed: a plan of QGroundControl, KML, GeoJSON"),
    "a picture": (b"\x89PNG\r\n", "neither JSON nor XML"),
    "an archive": (b"PK\x03\x04", "a zip archive; allowed: KML, so of a KMZ the doc.kml in it"),
    "a list": (b"[1]", "holds a list; allowed: a JSON object"),
    "half a plan": (json.dumps(PLAN).encode()[:400], "not valid JSON: "),
    "no number": (b'{"fileType": "Plan", "version": NaN}', "not valid JSON: NaN is no number"),
    "an endless number": (
        json.dumps(PLAN).encode().replace(b"35.0", b"1e999"),
        "geoFence.circles[0].circle.radius: inf; allowed: ",
    ),
    "not text": (b'{"fileType": "\xff"}', "not valid JSON: "),
    "nested without end": (b'{"a":' * 100_000, "nested too deeply"),
    "another file": (b'{"fileType": "Parameters"}', "fileType: 'Parameters'; allowed: Plan"),
    "no mission": (plan_with("mission", None), "mission: missing"),
    "a later version": (plan_with("version", 2), "version: 2; allowed: 1"),
    "the geofence of an earlier version": (plan_with("geoFence.version", 1), "geoFence.version: 1; allowed: 2"),
    "a word for a radius": (
        plan_with("geoFence.circles.0.circle.radius", "35"),
        "geoFence.circles[0].circle.radius: '35'; allowed: a valid number",
    ),
    "a radius below 0": (
        plan_with("geoFence.circles.0.circle.radius", -1),
        "geoFence.circles[0].circle.radius: -1.0; allowed: a number of metres",
    ),
    "a circle without a centre": (
        plan_with("geoFence.circles.0.circle.center", None),
        "geoFence.circles[0].circle.center: missing",
    ),
    "half a centre": (
        plan_with("geoFence.circles.0.circle.center", [47.0]),
        "geoFence.circles[0].circle.center: 1 numbers; allowed: [lat, lon]",
    ),
    "no parameters": (plan_with("mission.items.1.params", None), "mission.items[1].params: missing"),
    "too few parameters": (plan_with("mission.items.1.params", [0, 1]), "mission.items[1].params: [0, 1]; allowed: "),
    "a way point nowhere": (plan_with("mission.items.1.params.4", "x"), "mission.items[1].params[4]: 'x'; allowed: "),
    "a way point beyond the pole": (
        plan_with("mission.items.1.params.4", 147.4),
        "mission.items[1].params: lat 147.4; allowed: -90 to 90 degrees",
    ),
    "a way point turned round": (
        plan_with("mission.items.1.params", [0, 0, 0, None, 8.547, 47.402, 40]),
        "were latitude and longitude exchanged? lat_deg 47.402, lon_deg 8.547 is near it",
    ),
    "an item of no type": (
        plan_with("mission.items.1.type", "Item"),
        "mission.items[1].type: 'Item'; allowed: SimpleItem, ComplexItem",
    ),
    "two inclusions": (
        plan_with("geoFence.polygons.1.inclusion", True),
        "geoFence.polygons[1]: a second fence, beside geoFence.polygons[0]; ",
    ),
    "two corners": (
        plan_with("geoFence.polygons.1.polygon", [[47.4, 8.5], [47.4, 8.5], [47.5, 8.5]]),
        "geoFence.polygons[1]: 2 corners; allowed: at least 3",
    ),
    "a polygon that crosses itself": (
        plan_with("geoFence.polygons.1.polygon", [[47.400, 8.55], [47.401, 8.551], [47.400, 8.551], [47.401, 8.55]]),
        "geoFence.polygons[1]: the edges after corners 0 and 2 cross or touch; allowed: a simple polygon",
    ),
    "no way point": (
        plan_with("mission.items", []).replace(b"[[47.398, 8.546, 50]]", b"[]"),
        "targets: none; allowed: at least one way point",
    ),
    "a way point outside the fence": (
        plan_with("mission.items.1.params.4", 47.41),
        "targets[0] (mission.items[1].params): id 1 starts at ",
    ),
    "a home outside the fence": (
        plan_with("mission.plannedHomePosition.0", 47.41),
        "agents[0] (mission.plannedHomePosition): id 1 starts at 0 m north, 0 m east of the origin; allowed: inside "
        "the fence (geoFence.polygons[0])",
    ),
    "a way point in an exclusion circle": (
        plan_with("geoFence.circles.0.circle.center", PLAN["mission"]["items"][1]["params"][4:6]),
        "targets[0] (mission.items[1].params): id 1 starts 0.0 m from threat 1 (geoFence.circles[0]); allowed: ",
    ),
    "decimal commas in KML": (
        KML.replace("8.5470,47.3990<", "8,5470,47,3990,0<").encode(),
        "decimal marks are points",
    ),
    "no home": (
        plan_with("mission.plannedHomePosition", None),
        "home: nothing says where the vehicles start; allowed: --home",
    ),
    "GeoJSON of no type": (b'{"type": "Polygons"}', "type: 'Polygons'; allowed: FeatureCollection, Feature, Point"),
    "no features": (b'{"type": "FeatureCollection"}', "features: None; allowed: a list of features"),
    "another grid": (
        b'{"type": "Point", "crs": {"properties": {"name": "EPSG:21781"}}}',
        "crs: 'EPSG:21781'; allowed: WGS84 degrees",
    ),
    "an open ring": (geojson_with(polygon(RING[:-1])), "features[6].geometry.coordinates: "),
    "a hole": (geojson_with(polygon(RING, RING), name="Lake"), "features[6] 'Lake': 1 holes; allowed: none: draw each"),
    "crossing edges": (
        geojson_with(polygon(CROSSED), name="Lake"),
        "features[6] 'Lake': the edges after corners 0 and 2 cross",
    ),
    "longitude and latitude turned round": (
        geojson_with({"type": "Point", "coordinates": [47.4, 8.55]}, name="Tree"),
        "features[6] 'Tree': lat_deg 8.55, lon_deg 47.4 is 5",
    ),
    "a latitude beyond the pole": (
        geojson_with({"type": "Point", "coordinates": [8.55, 97.4]}),
        "features[6]: lat 97.4; allowed: -90 to 90 degrees; it holds [lon, lat]: are they exchanged?",
    ),
    "a word for a number": (
        geojson_with({"type": "Point", "coordinates": ["x", 47.4]}),
        "features[6].geometry.coordinates",
    ),
    "a role that nobody has": (
        geojson_with({"type": "Point", "coordinates": [8.55, 47.4]}, role="targt"),
        "features[6]: role 'targt'; did you mean 'target'?; allowed: home, agent, target, threat",
    ),
    "a radius that is none": (
        geojson_with({"type": "Point", "coordinates": [8.55, 47.4]}, radius_m="wide"),
        "features[6]: radius_m: 'wide'; allowed: a number of metres greater than 0",
    ),
    "two fences": (
        geojson_with(polygon(RING), role="fence"),
        "features[6]: a second fence, beside features[1] 'Flight area'; ",
    ),
    "two homes": (
        geojson_with({"type": "Point", "coordinates": [8.55, 47.4]}, role="home"),
        "features[6]: a second home",
    ),
    "broken XML": (b"<kml><Placemark></kml>", "not valid XML: mismatched tag"),
    "another XML": (b"<gpx/>", "its root is <gpx>; allowed: <kml>"),
    "an entity": (BOMB.encode(), "a document type or an entity; allowed: KML without them"),
    "an entity in another encoding": (BOMB.encode("utf-16"), "a document type or an entity; allowed: KML without them"),
    "coordinates that are words": (
        KML.replace("8.5470,47.3990<", "here,47.3990<").encode(),
        "Placemark 4: could not convert string to float: 'here'; allowed: coordinates",
    ),
    "a ring of two corners": (
        KML.replace(
            "8.5490,47.4005 8.5500,47.4005 8.5500,47.4011 8.5490,47.4011 8.5490,47.4005", "8.549,47.4005 8.55,47.4005"
        ).encode(),
        "Placemark 3: a point, line or polygon without enough coordinates; allowed: 1 for",
    ),
    "a number that is none": (
        KML.replace("<Style", '<Schema><SimpleField name="n" type="int"/></Schema><Style')
        .replace("<Data", '<SchemaData><SimpleData name="n">1e400</SimpleData></SchemaData><Data')
        .encode(),
        "Placemark 4: cannot convert float infinity to integer",
    ),
    "a radius without end": (
        geojson_with({"type": "Point", "coordinates": [8.55, 47.4]}, radius_m=10**400),
        "features[6]: radius_m: 1000",
    ),
    "a point without a place": (
        KML.replace("<coordinates>8.5470,47.3990</coordinates>", "").encode(),
        "Placemark 4: a point, line",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_file_that_cannot_be_used_is_refused_on_one_line_that_says_where(name: str, tmp_path: Path) -> None:
    content, said = REFUSED[name]
    path = tmp_path / "drawn"
    path.write_bytes(content)
    refused = CliRunner().invoke(cli, ["import", str(path)], standalone_mode=False).exception
    assert isinstance(refused, InputError), refused
    assert str(refused).startswith(f"{path}: ") and said in str(refused) and "\n" not in str(refused)


def test_a_map_of_more_features_than_are_gone_through_is_refused() -> None:
    mark = b"<Placemark/>"
    with pytest.raises(InputError, match=r"^Placemark: 10001 in the file; allowed: at most 10000$"):
        read_drawing(b"<kml>" + mark * 10_001 + b"</kml>")
    with pytest.raises(InputError, match=r"^features: 10001 in the file; allowed: at most 10000$"):
        read_drawing(json.dumps({"type": "FeatureCollection", "features": [0] * 10_001}).encode())


def test_a_file_of_more_than_ten_megabytes_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "large.plan"
    path.write_bytes(b"{" + b" " * MAX_FILE_BYTES)
    refused = CliRunner().invoke(cli, ["import", str(path)], standalone_mode=False).exception
    assert str(refused) == f"{path}: too large; allowed: at most 10000000 bytes"


@pytest.mark.parametrize("given", ["47.4", "47.4,8.5,1,2", "north,8.5", "97,8.5", "47.4,8.5,1e9"])
def test_a_home_that_is_none_is_refused(given: str) -> None:
    refused = (
        CliRunner().invoke(cli, ["import", str(HERE / "survey.plan"), "--home", given], standalone_mode=False).exception
    )
    assert isinstance(refused, InputError) and str(refused).startswith("--home: ")


# Whatever goes in, there is no traceback

texts = st.sampled_from([json.dumps(PLAN), KML, json.dumps(GEOJSON)])
junk = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3),
    max_leaves=5,
)


def paths_of(data: object, before: tuple[object, ...] = ()) -> list[tuple[object, ...]]:
    keys = list(data) if isinstance(data, dict) else list(range(len(data))) if isinstance(data, list) else []
    return [before] * bool(before) + [path for key in keys for path in paths_of(data[key], (*before, key))]  # type: ignore[index]


def used_or_refused(content: bytes) -> None:
    try:
        mission_from(content)
    except InputError as error:
        assert "\n" not in str(error)


@settings(max_examples=50, deadline=None)
@given(
    st.binary(max_size=200)
    | st.binary(max_size=50).map(lambda tail: b"{" + tail)
    | st.binary(max_size=50).map(lambda tail: b"<kml>" + tail)
)
def test_any_bytes_are_used_or_refused(content: bytes) -> None:
    used_or_refused(content)


@settings(max_examples=40, deadline=None)
@given(texts, st.data())
def test_a_file_with_a_piece_cut_out_or_doubled_is_used_or_refused(text: str, data: st.DataObject) -> None:
    start = data.draw(st.integers(0, len(text) - 1))
    end = data.draw(st.integers(start, min(len(text), start + 80)))
    piece = data.draw(st.sampled_from(["", text[start:end] * 2, "<Placemark>", "1e400", "\x00", "Polygon"]))
    used_or_refused((text[:start] + piece + text[end:]).encode())


@settings(max_examples=30, deadline=None)
@given(st.sampled_from([PLAN, GEOJSON]), junk, st.data())
def test_a_file_with_anything_in_the_place_of_a_value_is_used_or_refused(
    file: dict[str, Any], value: object, data: st.DataObject
) -> None:
    changed = copy.deepcopy(file)
    path = data.draw(st.sampled_from(paths_of(file)))
    part: Any = changed
    for key in path[:-1]:
        part = part[key]
    part[path[-1]] = value
    used_or_refused(json.dumps(changed).encode())


def test_nulls_that_qgroundcontrol_writes_for_heights_it_does_not_know_are_no_fault() -> None:
    plan = copy.deepcopy(PLAN)
    plan["mission"]["plannedHomePosition"] = [*plan["mission"]["plannedHomePosition"][:2], None]
    plan["geoFence"]["breachReturn"] = [47.4, 8.5, None]
    plan["rallyPoints"]["points"] = [[*point[:2], None] for point in plan["rallyPoints"]["points"]]
    for item in plan["mission"]["items"]:
        item["AMSLAltAboveTerrain"] = None
        if transects := item.get("TransectStyleComplexItem"):
            transects["CameraCalc"] = None
            transects["VisualTransectPoints"] = [
                [*point[:2], None] for point in transects.get("VisualTransectPoints", [])
            ]
    with_nulls = mission_from(json.dumps(plan).encode())
    assert with_nulls.targets == mission_from(json.dumps(PLAN).encode()).targets
    assert with_nulls.origin.alt_m == 0.0


def test_where_the_origin_lies_is_said_so_that_exchanged_coordinates_are_seen() -> None:
    _, said = run(HERE / "field.geojson")
    assert "origin: at 47.39770 N, 8.54560 E\n" in said
