"""`groundstation check`: a mission's places in metres and degrees, what is doubtful about it, and a picture."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from companion.errors import EXIT_DONE, EXIT_FAILED, InputError
from companion.geo.local_frame import LocalFrame
from companion.guidance.settings import DEFAULT_LAW
from companion.mission.model import load_mission, parse_mission
from companion.mission.resolve import resolve
from companion.onboard.lint.warnings import lint_flight
from groundstation.check.overview import ahead_m, bounds_m, overview
from groundstation.check.text import overview_text
from groundstation.cli import cli

EVERYTHING = """
name: everything
origin: {lat_deg: 47, lon_deg: 8, alt_m: 400}
fence: [[-500, -500], [-500, 4000], [4000, 4000], [4000, -500]]
exclusions: [[[100, 900], [200, 900], [200, 1000]]]
agents:
  - {id: 7, north_m: 0, east_m: 0, heading_deg: 90, speed_m_s: 8, n_max: 0.17, only_target: 2}
  - {id: 9, north_m: 0, east_m: 300, heading_deg: 0, speed_m_s: 8, n_max: 0.17}
targets: [{id: 2, north_m: 3000, east_m: 100}, {id: 4, motion: {path: [[0, 3000, 900], [900, 3500, 950]]}}]
threats:
  - {id: 1, north_m: 1000, east_m: 600, radius_m: 80, floor_m: 300, ceiling_m: 900}
  - {id: 3, north_m: 2000, east_m: 2000, detection_radius_m: 90, attack_radius_m: 30,
     motion: {heading_deg: 180, speed_m_s: 1}}
arrival_radius_m: 20
separation_m: 20
"""


def run(*arguments: str) -> Result:
    return CliRunner().invoke(cli, ["check", *arguments], standalone_mode=False)


def printed(*arguments: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(run(*arguments, "--json").stdout)
    return found


def test_a_mission_without_a_doubt_is_shown_and_passes() -> None:
    outcome = run("copter-field", "--autopilot", "arducopter")
    assert outcome.return_value == EXIT_DONE
    assert outcome.stdout.splitlines()[-1] == "no warnings, for arducopter"


def test_every_warning_of_the_flight_is_said_and_fails(tmp_path: Path) -> None:
    path = tmp_path / "doubtful.yaml"
    path.write_text(EVERYTHING)
    found = printed(str(path), "--autopilot", "arducopter")
    mission = resolve(load_mission(path), 1)
    assert found["warnings"] == lint_flight(mission, DEFAULT_LAW, ("arducopter",), str(path)) != []
    outcome = run(str(path), "--autopilot", "arducopter")
    assert outcome.return_value == EXIT_FAILED
    assert all(f"warning: {warning}" in outcome.stdout for warning in found["warnings"])


def test_a_speed_and_a_turn_that_the_kind_does_not_fly_are_warnings() -> None:
    (first, second, *_) = printed("paper-static", "--autopilot", "px4-plane")["warnings"]
    assert "agents: id 1 has n_max 10 g, but px4-plane turns with 0.4 g: the ground station reckons with" in second
    assert first == (
        "agents: id 1 has speed_m_s 60 m/s, but px4-plane flies 15 m/s: `sim fly` refuses it without --scale (and 9 "
        "more like it)"
    )


def test_every_place_stands_in_metres_and_in_degrees() -> None:
    found = overview(resolve(parse_mission(EVERYTHING, "test"), 1), 1, "arducopter", "test")
    frame = LocalFrame(47.0, 8.0)
    assert [(place.what, place.id) for place in found.places] == [
        ("agent", 7), ("agent", 9), ("target", 2), ("target", 4), ("threat", 1), ("threat", 3),
    ]  # fmt: skip
    assert [corner.what for corner in found.corners] == ["fence"] * 4 + ["exclusion 1"] * 3
    rows = [(row.lat_deg, row.lon_deg, row.north_m, row.east_m) for row in found.places]
    rows += [(row.lat_deg, row.lon_deg, row.north_m, row.east_m) for row in found.corners]
    assert all(frame.to_local(*row[:2]) == pytest.approx(row[2:], abs=0.02) for row in rows)


@pytest.mark.parametrize(
    "words",
    [
        "heading 90 deg, 8 m/s, n_max 0.17 g, range 500000 m, height 30 m, only to target 2",
        "on a path of 2 points, at most 10 m/s",
        "R_d 80 m, R_a 40 m, stands, from 300 m above sea level, up to 900 m above sea level",
        "R_d 90 m, R_a 30 m, 1 m/s towards 180 deg, at most 10 m/s",
        "everything, seed 1, Case I; origin 47.0000000, 8.0000000, 400 m above sea level",
    ],
)
def test_the_tables_say_every_number_with_its_unit(words: str) -> None:
    assert words in overview_text(overview(resolve(parse_mission(EVERYTHING, "test"), 1), 1, "arducopter", "test"))


def test_without_a_kind_only_what_holds_for_all_is_a_warning(tmp_path: Path) -> None:
    assert printed("paper-dynamic")["warnings"] == lint_flight(
        resolve(load_mission("paper-dynamic"), 1), DEFAULT_LAW, ("kinematic", "arducopter"), "paper-dynamic"
    )
    assert "vehicles that can stop and others" in run("paper-dynamic").stdout


def test_a_mission_that_cannot_be_flown_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "inside.yaml"
    path.write_text(EVERYTHING.replace("north_m: 1000, east_m: 600", "north_m: 10, east_m: 10"))
    refused = run(str(path)).exception
    assert isinstance(refused, InputError) and str(refused).startswith(f"{path}: agents[0]: id 7 starts 14.1 m from")


def test_all_that_is_drawn_is_within_the_pictures_bounds() -> None:
    mission = resolve(parse_mission(EVERYTHING, "test"), 1)
    assert bounds_m(mission) == ((-500.0, -500.0), (4000.0, 4000.0))
    assert bounds_m(mission.model_copy(update={"fence": None})) == ((0.0, 0.0), (3500.0, 2090.0))


def test_a_heading_points_clockwise_from_north() -> None:
    assert ahead_m((10.0, 20.0), 90.0, 5.0) == pytest.approx((10.0, 25.0))


@pytest.mark.parametrize(("name", "begins"), [("a.png", b"\x89PNG"), ("a.SVG", b"<?xml")])
def test_a_picture_is_drawn_and_is_the_same_each_time(name: str, begins: bytes, tmp_path: Path) -> None:
    first, again = tmp_path / name, tmp_path / f"again-{name}"
    for path in (first, again):
        run("copter-field", "--out", str(path))
    assert first.read_bytes().startswith(begins) and first.read_bytes() == again.read_bytes()


def test_the_picture_names_each_thing_and_its_number(tmp_path: Path) -> None:
    path = tmp_path / "mission.yaml"
    path.write_text(EVERYTHING)
    run(str(path), "--out", str(tmp_path / "a.svg"))
    text = (tmp_path / "a.svg").read_text()
    for label in ("everything", "fence", "exclusion (hatched)", "threat: attack radius R_a", "arrival radius"):
        assert f"<!-- {label} -->" in text
    assert all(f"<!-- {number} -->" in text for number in (7, 9, 2, 4, 1, 3))


def test_a_picture_of_another_kind_is_refused_before_anything_is_done() -> None:
    assert "--out: 'a.jpg'; allowed: a name that ends in .png or .svg" in str(
        run("nowhere", "--out", "a.jpg").exception
    )
