"""Places in degrees beside places in metres: converted once, refused on one line, and the same mission either way."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.errors import InputError
from companion.files.yaml import dump_yaml
from companion.geo.local_frame import LocalFrame
from companion.mission.model import Mission, PathMotion, dump_mission, parse_mission
from companion.mission.resolve import resolve

ORIGIN = (47.4, 8.5)
FRAME = LocalFrame(*ORIGIN)
Point = tuple[float, float]
offsets_m = st.integers(-20_000, 20_000).map(float)
points_m = st.tuples(offsets_m, offsets_m)
forms = st.lists(st.booleans(), min_size=12, max_size=12)


def in_degrees(point_m: Point) -> dict[str, float]:
    lat_deg, lon_deg = FRAME.to_global(*point_m)
    return {"lat_deg": lat_deg, "lon_deg": lon_deg}


def place(point_m: Point, degrees: bool) -> dict[str, float]:
    return in_degrees(point_m) if degrees else {"north_m": point_m[0], "east_m": point_m[1]}


def corner(point_m: Point, degrees: bool) -> object:
    return in_degrees(point_m) if degrees else list(point_m)


def mission_of(shift_m: Point, degrees: list[bool]) -> Mission:
    """Return a mission whose places, all moved by a shift, stand in degrees where `degrees` says so."""
    use = iter(degrees)

    def at(north_m: float, east_m: float) -> Point:
        return north_m + shift_m[0], east_m + shift_m[1]

    square = [at(-900, -900), at(-900, 900), at(900, 900), at(900, -900)]
    data = {
        "origin": {"lat_deg": ORIGIN[0], "lon_deg": ORIGIN[1], "alt_m": 400},
        "fence": [corner(point, next(use)) for point in square],
        "exclusions": [[corner(at(*point), next(use)) for point in ((-500, 300), (-400, 300), (-400, 400))]],
        "agents": [{"id": 1, "heading_deg": 0, **place(at(-700, 0), next(use))}],
        "targets": [{"id": 1, **place(at(700, 0), next(use))}],
        "threats": [
            {"id": 1, "radius_m": 120, **place(at(0, 40), next(use))},
            {
                "id": 2, "radius_m": 60,
                "motion": {"path": [
                    {"t_s": 0, **place(at(0, -400), next(use))}, {"t_s": 60, **place(at(90, -400), next(use))},
                ]},
            },
        ],
    }  # fmt: skip
    return resolve(parse_mission(dump_yaml(data), "places"), 1)


def points_of(mission: Mission) -> list[Point]:
    things = [agent.position_ned_m for agent in mission.agents]
    things += [thing.position_ned_m for thing in (*mission.targets, *mission.threats)]
    path = mission.threats[1].motion
    assert isinstance(path, PathMotion) and mission.fence is not None
    return [*things, *mission.fence, *mission.exclusions[0], *(point[1:] for point in path.path)]


@settings(max_examples=25, deadline=None)
@given(points_m, forms)
def test_a_place_is_the_same_whether_it_stands_in_degrees_or_in_metres(shift_m: Point, degrees: list[bool]) -> None:
    in_metres, mixed = mission_of(shift_m, [False] * 12), mission_of(shift_m, degrees)
    pairs = zip(points_of(in_metres), points_of(mixed), strict=True)
    assert all(math.dist(one, other) <= 2e-3 for one, other in pairs)


@settings(max_examples=10, deadline=None)
@given(points_m, forms)
def test_a_mission_in_degrees_is_written_in_metres_and_read_again_the_same(shift_m: Point, degrees: list[bool]) -> None:
    mission = mission_of(shift_m, degrees)
    assert "lat_deg" not in dump_mission(mission).split("fence", 1)[1]
    assert parse_mission(dump_mission(mission), "again") == mission


def test_a_threat_of_one_radius_is_kept_out_of_to_that_radius_and_its_inner_radius_is_half_of_it() -> None:
    threats = parse_mission(
        "draw: {agents: 1, targets: 1, threats: 1}\n"
        "threats: [{id: 1, radius_m: 80}, {id: 2}, {id: 3, detection_radius_m: 9, attack_radius_m: 3}]\n"
        "defaults: {threat: {radius_m: 500}}\n",
        "radii",
    )
    radii = [(threat.detection_radius_m, threat.attack_radius_m) for threat in resolve(threats, 1).threats]
    assert radii == [(80.0, 40.0), (500.0, 250.0), (9.0, 3.0), (500.0, 250.0)]


@pytest.mark.parametrize(("motion", "bound_m_s"), [("", 4.0), (", motion: static", 0.0), (", motion: random", 4.0)])
def test_a_default_bound_is_not_for_what_stands_by_its_own_word(motion: str, bound_m_s: float) -> None:
    text = (
        f"draw: {{agents: 1, targets: 1}}\nthreats: [{{id: 1, radius_m: 5{motion}}}]\n"
        "defaults: {threat: {speed_bound_m_s: 4}}\n"
    )
    assert parse_mission(text, "bounds").threats[0].speed_bound_m_s == bound_m_s


BASE = "origin: {lat_deg: 47.4, lon_deg: 8.5}\ndraw: {agents: 1, targets: 1}\n"
REFUSED = {
    "half a place": ("agents: [{id: 1, lat_deg: 47.4}]", "agents[0].lon_deg: missing beside lat_deg; allowed: lat_deg"),
    "two places": (
        "targets: [{id: 1, lat_deg: 47.4, lon_deg: 8.5, north_m: 3, east_m: 4}]",
        "targets[0].lat_deg: given beside north_m; allowed: lat_deg and lon_deg (degrees), or north_m and east_m (m",
    ),
    "a word": ("agents: [{id: 1, lat_deg: north, lon_deg: 8}]", "agents[0].lat_deg: 'north'; allowed: a number of"),
    "no number": ("agents: [{id: 1, lat_deg: .nan, lon_deg: 8}]", "agents[0].lat_deg: 'nan'; allowed: a number of"),
    "no latitude": (
        "agents: [{id: 1, lat_deg: 97, lon_deg: 8}]",
        "agents[0].lat_deg: 97; allowed: -90 to 90 degrees",
    ),
    "exchanged": (
        "agents: [{id: 1, lat_deg: 8.5, lon_deg: 47.4}]",
        "were latitude and longitude exchanged? lat_deg 47.4, lon_deg 8.5 is near it",
    ),
    "elsewhere": ("fence: [{lat_deg: 40, lon_deg: -100}]", "fence[0]: lat_deg 40, lon_deg -100 is 8"),
    "a corner without its east": ("fence: [{north_m: 3}]", "fence[0].east_m: missing; allowed: lat_deg"),
    "an unknown key of a corner": ("exclusions: [[{north: 3}]]", "exclusions[0][0]: unknown key 'north'; allowed: lat"),
    "a point without its time": (
        "targets: [{id: 1, motion: {path: [{north_m: 1, east_m: 1}]}}]",
        "targets[0].motion.path[0].t_s: missing; allowed: t_s, lat_deg",
    ),
    "an unknown key": ("agents: [{id: 1, lat: 47.4}]", "unknown key 'lat'; did you mean 'lat_deg'?; allowed: id"),
    "one radius and two": (
        "threats: [{id: 1, radius_m: 5, attack_radius_m: 3}]",
        "threats[0].radius_m: given beside attack_radius_m; allowed: radius_m alone, or detection_radius_m and",
    ),
    "a negative radius": (
        "threats: [{id: 1, radius_m: -5}]",
        "threats[0].radius_m: '-5'; allowed: a number of metres greater than 0",
    ),
    "a radius without end": (f"threats: [{{id: 1, radius_m: {'9' * 400}}}]", "threats[0].radius_m: '9999"),
    "a radius of an agent": ("agents: [{id: 1, radius_m: 5}]", "unknown key 'radius_m'"),
    "a place for all": ("defaults: {agent: {lat_deg: 1, lon_deg: 2}}", "defaults.agent: unknown key 'lat_deg'"),
    "a number beyond its bounds": ("agents: [{id: 1, speed_m_s: 5000}]", "allowed: less than or equal to 1000 m/s"),
    "a corner beyond the plane": ("fence: [[2.0e6, 0], [0, 0], [0, 1]]", "fence[0][0]: 2000000.0; allowed: less than"),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_a_place_or_a_radius_that_is_none_is_refused_on_one_line(name: str) -> None:
    line, said = REFUSED[name]
    with pytest.raises(InputError) as refused:
        parse_mission(BASE + line, "m.yaml")
    assert said in str(refused.value) and "\n" not in str(refused.value)
    assert str(refused.value).startswith("m.yaml: ")


def test_degrees_need_an_origin_that_the_file_says() -> None:
    with pytest.raises(InputError, match=r"^m: origin.lat_deg: missing, with a place in degrees, agents\[0\]; allowed"):
        parse_mission("agents: [{id: 1, lat_deg: 47.4, lon_deg: 8.5}]\norigin: {alt_m: 3}\n", "m")


def test_a_bad_origin_is_named_before_the_places_about_it() -> None:
    with pytest.raises(InputError, match=r"^m: origin.lat_deg: 91; allowed: less than or equal to 90 degrees$"):
        parse_mission("agents: [{id: 1, lat_deg: 47.4, lon_deg: 8.5}]\norigin: {lat_deg: 91, lon_deg: 8}\n", "m")
