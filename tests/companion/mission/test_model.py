"""The mission file: what it says is checked as a whole, drawn from the seed, and refused in one line otherwise."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import companion.cli
import groundstation.cli
import sim.cli
from companion.errors import EXIT_FAILED, EXIT_UNUSABLE, InputError
from companion.files.yaml import MAX_FILE_BYTES, dump_yaml, parse_yaml
from companion.geo.polygon import inside_polygon
from companion.mission.model import (
    Mission,
    agent_height_m,
    dump_mission,
    load_mission,
    packaged_missions,
    parse_mission,
)
from companion.mission.resolve import DRAW_CLEARANCE, resolve

seeds = st.integers(0, 2**63 - 1)

SMALL = """
area_m: {north: 50000, east: 50000}
fence: [[0, 0], [50000, 0], [50000, 40000], [0, 40000]]
exclusions: [[[1000, 20000], [48000, 20000], [48000, 29000]], [[40000, 1000], [49000, 1000], [49000, 15000]]]
agents:
  - {id: 7, north_m: 100, east_m: 200, heading_deg: 30}
  - {id: 2}
targets: [{id: 9, north_m: 30000, east_m: 30000, speed_bound_m_s: 5, motion: {heading_deg: 10, speed_m_s: 5}}]
threats: [{id: 1, north_m: 15000, east_m: 15000, detection_radius_m: 3000, attack_radius_m: 1000}]
draw: {agents: 3, targets: 2, threats: 2}
defaults:
  threat: {detection_radius_m: 2000, attack_radius_m: 500, motion: random}
  agent: {speed_m_s: 40}
losses: [{agent: 2, t_s: 400}]
"""


def small() -> Mission:
    return parse_mission(SMALL, "small.yaml")


# What is packaged


def test_the_packaged_missions_are_found() -> None:
    assert {"paper-static", "paper-dynamic", "copter-demo"} <= set(packaged_missions())


@pytest.mark.parametrize("name", packaged_missions())
def test_a_packaged_mission_can_be_flown_as_it_stands(name: str) -> None:
    mission = resolve(load_mission(name), 1)
    assert mission.resolved
    assert mission.name == name


def test_the_papers_missions_have_the_papers_numbers() -> None:
    mission = resolve(load_mission("paper-dynamic"), 1)
    assert (len(mission.agents), len(mission.targets), len(mission.threats)) == (10, 5, 4)
    assert {agent.speed_m_s for agent in mission.agents} == {60.0}
    assert {(t.detection_radius_m, t.attack_radius_m) for t in mission.threats} == {(10_000.0, 5_000.0)}
    assert (mission.weights.k_d, mission.weights.k_a, mission.weights.k_c) == (1e11, 1e11, 1e10)


# Drawing


@settings(max_examples=20)
@given(seeds)
def test_the_same_seed_draws_the_same_mission(seed: int) -> None:
    assert resolve(small(), seed) == resolve(small(), seed)


def test_another_seed_draws_another_mission() -> None:
    assert resolve(small(), 1) != resolve(small(), 2)


@settings(max_examples=20)
@given(seeds)
def test_a_drawn_mission_lists_everything(seed: int) -> None:
    mission = resolve(small(), seed)
    assert mission.resolved
    assert (len(mission.agents), len(mission.targets), len(mission.threats)) == (5, 3, 3)
    assert [agent.id for agent in mission.agents] == [7, 2, 1, 3, 4]
    assert all(agent.heading_deg is not None and agent.speed_m_s == 40.0 for agent in mission.agents)


@settings(max_examples=30)
@given(seeds, st.sampled_from(["small", "paper-static"]))
def test_a_drawn_start_is_legal(seed: int, name: str) -> None:
    drawn = small() if name == "small" else load_mission(name)
    mission = resolve(drawn, seed)
    listed = {("agents", 7), ("targets", 9), ("threats", 1)} if name == "small" else set()
    for kind, items in (("agents", mission.agents), ("targets", mission.targets)):
        for item in items:
            if (kind, item.id) in listed:
                continue
            north_m, east_m = item.position_ned_m
            assert 0.0 <= north_m <= mission.area_m.north
            assert 0.0 <= east_m <= mission.area_m.east
            assert mission.fence is None or inside_polygon((north_m, east_m), mission.fence)
            assert not any(inside_polygon((north_m, east_m), exclusion) for exclusion in mission.exclusions)
            for threat in mission.threats:
                apart_m = math.dist(item.position_ned_m, threat.position_ned_m)
                assert apart_m > threat.detection_radius_m * (1 + DRAW_CLEARANCE)
    places = [agent.position_ned_m for agent in mission.agents]
    assert all(
        math.dist(place, other) >= 2 * mission.separation_m for k, place in enumerate(places) for other in places[:k]
    )


@settings(max_examples=20)
@given(seeds)
def test_agents_drawn_into_a_crowded_area_are_two_separations_apart(seed: int) -> None:
    text = "area_m: {north: 1000, east: 1000}\ndraw: {agents: 10, targets: 1}\nseparation_m: 80\n"
    places = [agent.position_ned_m for agent in resolve(parse_mission(text, "crowd"), seed).agents]
    assert all(math.dist(place, other) >= 160.0 for k, place in enumerate(places) for other in places[:k])


@settings(max_examples=20)
@given(seeds)
def test_drawing_leaves_what_was_listed_as_it_was(seed: int) -> None:
    before, after = small(), resolve(small(), seed)
    assert after.agents[0] == before.agents[0]
    assert after.targets[0] == before.targets[0]
    assert after.threats[0] == before.threats[0]
    changed = {"agents", "targets", "threats", "draw", "defaults"}
    assert after.model_dump(exclude=changed) == before.model_dump(exclude=changed)


@settings(max_examples=20)
@given(seeds, seeds)
def test_a_resolved_mission_resolves_to_itself_whatever_the_seed(seed: int, other: int) -> None:
    mission = resolve(small(), seed)
    assert resolve(mission, other) == mission


def test_a_thing_on_a_path_starts_where_its_path_does() -> None:
    text = (
        "agents: [{id: 1, north_m: 0, east_m: 0}]\ntargets: [{id: 1, motion: {path: [[0, 500, 600], [100, 900, 600]]}}]"
    )
    assert resolve(parse_mission(text, "x"), 1).targets[0].position_ned_m == (500.0, 600.0)


def test_an_area_without_room_is_refused_in_one_line() -> None:
    text = """
area_m: {north: 1000, east: 1000}
threats: [{id: 1, north_m: 500, east_m: 500, detection_radius_m: 2000, attack_radius_m: 10}]
draw: {agents: 1, targets: 1}
"""
    with pytest.raises(InputError, match=r"^x\.yaml: target 1: no legal start in .* draws; allowed: an area_m"):
        resolve(parse_mission(text, "x.yaml"), 1, "x.yaml")


# Writing back


@pytest.mark.slow
@settings(max_examples=20)
@given(seeds, st.sampled_from(["small", "paper-dynamic", "copter-demo"]))
def test_a_mission_written_and_read_again_is_the_same(seed: int, name: str) -> None:
    mission = resolve(small() if name == "small" else load_mission(name), seed)
    assert parse_mission(dump_mission(mission), "again") == mission


@pytest.mark.parametrize("name", ["small", *packaged_missions()])
def test_an_unresolved_mission_is_written_and_read_again_too(name: str) -> None:
    mission = small() if name == "small" else load_mission(name)
    assert parse_mission(dump_mission(mission), "again") == mission


@pytest.mark.slow
@given(
    st.text(st.characters(codec="utf-8"), min_size=1, max_size=80).filter(
        lambda name: name.isprintable() and name.strip()
    )
    | st.sampled_from(["yes", "1e3", "08", "1.0e11", "null", "~", ".inf", "12:30", "- a", "x: y", "true", "# c"])
)
def test_a_name_returns_whatever_it_looks_like(name: str) -> None:
    mission = small().model_copy(update={"name": name})
    assert parse_mission(dump_mission(mission), "again").name == name


@pytest.mark.slow
@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers(-(10**20), 10**20)
        | st.floats(allow_nan=False)
        | st.text(st.characters(codec="utf-8"), max_size=8),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.text(st.characters(codec="utf-8"), max_size=4), inner, max_size=3)
        ),
        max_leaves=8,
    )
)
def test_data_written_as_yaml_returns_with_its_types(data: object) -> None:
    assert parse_yaml(dump_yaml({"data": data}), "again") == {"data": data}


# Scalars of YAML 1.2


@pytest.mark.parametrize(
    ("scalar", "value"),
    [
        ("1.0e11", 1e11),
        ("1e11", 1e11),
        ("1.5E+3", 1500.0),
        (".5", 0.5),
        ("-3", -3),
        ("010", 10),
        ("08", 8),
        ("12:30", "12:30"),
        ("1_000", "1_000"),
        ("0x10", "0x10"),
        ("yes", "yes"),
        ("no", "no"),
        ("off", "off"),
        ("true", True),
        ("null", None),
        ("~", None),
        ("", None),
        ("2026-01-01", "2026-01-01"),
        ("<<", "<<"),
    ],
)
def test_a_scalar_means_what_yaml_1_2_says(scalar: str, value: object) -> None:
    data = parse_yaml(f"key: {scalar}\n", "x")
    assert isinstance(data, dict)
    assert data["key"] == value
    assert type(data["key"]) is type(value)


def test_a_weight_in_exponential_notation_is_a_number() -> None:
    text = "draw: {agents: 1, targets: 1}\nweights: {k_d: 2.0e11, k_a: 2e11}"
    weights = parse_mission(text, "x").weights
    assert (weights.k_d, weights.k_a) == (2e11, 2e11)


def test_a_threat_may_chase() -> None:
    threat = "threats: [{id: 1, detection_radius_m: 5, attack_radius_m: 1, motion: chase}]\n"
    assert parse_mission(ONE_EACH + threat, "chase").threats[0].motion == "chase"


# Heights


def heights_of(lines: str) -> list[float]:
    mission = resolve(parse_mission(lines, "heights"), 1)
    return [agent_height_m(mission, agent.id) for agent in mission.agents]


def test_an_agent_flies_at_its_own_height() -> None:
    lines = "agents: [{id: 5, height_m: 80}, {id: 3}]\ndraw: {agents: 1, targets: 1}\n"
    assert heights_of(lines) == [80.0, 30.0, 30.0]
    assert heights_of(lines + "defaults: {agent: {height_m: 60}}\n") == [80.0, 60.0, 60.0]


def test_agents_are_dealt_to_the_layers_in_file_order() -> None:
    lines = "agents: [{id: 9}, {id: 2, height_m: 50}, {id: 7}]\ndraw: {agents: 2, targets: 1}\n"
    assert heights_of(lines + "layers: 2\nlayer_spacing_m: 25\n") == [30.0, 75.0, 30.0, 55.0, 30.0]


def test_the_height_of_an_agent_that_is_not_listed_is_an_error() -> None:
    with pytest.raises(ValueError, match="agent 8 is not in mission"):
        agent_height_m(resolve(small(), 1), 8)


@pytest.mark.parametrize("given", ["floor_m: -3.5", "ceiling_m: 900", "floor_m: -3.5, ceiling_m: 900", "floor_m: null"])
def test_a_threat_keeps_its_floor_and_its_ceiling_when_written(given: str) -> None:
    text = (
        f"draw: {{agents: 1, targets: 1}}\nthreats: [{{id: 1, detection_radius_m: 5, attack_radius_m: 1, {given}}}]\n"
    )
    mission = parse_mission(text, "bands")
    (threat,) = parse_mission(dump_mission(mission), "again").threats
    expected = (-3.5 if "-3.5" in given else None, 900.0 if "900" in given else None)
    assert (threat.floor_m, threat.ceiling_m) == expected


# Bad input: one line that names file, key, value and what is allowed

ONE_EACH = "agents: [{id: 1, north_m: 0, east_m: 0}]\ntargets: [{id: 1, north_m: 9000, east_m: 0}]\n"
BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]\n" for k in range(1, 12)
)
THREAT = "threats: [{id: 1, north_m: 20000, east_m: 0, detection_radius_m: %s, attack_radius_m: %s}]\n"

BAD: dict[str, tuple[str, tuple[str, ...]]] = {
    "broken YAML": ("agents: [{id: 1\n", ("not valid YAML", "line 2")),
    "empty": ("", ("empty",)),
    "only a comment": ("# nothing\n", ("empty",)),
    "a list": ("- id: 1\n", ("list", "mapping")),
    "a word": ("hello\n", ("str", "mapping")),
    "two documents": (ONE_EACH + "---\n" + ONE_EACH, ("not valid YAML",)),
    "an unknown key": (ONE_EACH + "arrival_radius: 5\n", ("'arrival_radius'", "did you mean 'arrival_radius_m'")),
    "an unknown key below": ("draw: {agent: 1}\n", ("draw", "'agent'", "did you mean 'agents'")),
    "an unknown merge key": ("<<: {draw: {agents: 1}}\n", ("unknown key '<<'",)),
    "a key given twice": ("name: a\nname: b\n", ("'name' is given twice", "line 2")),
    "a key that is a list": ("[1, 2]: a\n", ("not a word",)),
    "a word for a number": (ONE_EACH + "max_time_s: long\n", ("max_time_s", "'long'", "number")),
    "a number as a word": (ONE_EACH + "max_time_s: '5'\n", ("max_time_s", "'5'", "number")),
    "true for a number": (ONE_EACH + "max_time_s: true\n", ("max_time_s", "True", "number")),
    "half an id": ("agents: [{id: 1.5}]\n", ("agents[0].id", "1.5", "integer")),
    "not a number": (ONE_EACH + "max_time_s: .nan\n", ("max_time_s", "nan", "finite")),
    "infinity": (ONE_EACH + "arrival_radius_m: .inf\n", ("arrival_radius_m", "inf", "finite")),
    "an overflow": (ONE_EACH + "arrival_radius_m: 1.0e999\n", ("arrival_radius_m", "inf", "finite")),
    "a huge integer": (ONE_EACH + f"arrival_radius_m: {'9' * 400}\n", ("arrival_radius_m", "999")),
    "an endless integer": (ONE_EACH + f"arrival_radius_m: {'9' * 5000}\n", ("not valid YAML",)),
    "a negative radius": (ONE_EACH + THREAT % (-5, 1), ("threats[0].detection_radius_m", "-5", "greater than 0")),
    "R_a as large as R_d": (ONE_EACH + THREAT % (5, 5), ("threats[0]", "attack_radius_m: 5", "less than", "5")),
    "no radii": (ONE_EACH + "threats: [{id: 1}]\n", ("threats[0].detection_radius_m", "missing")),
    "more targets than agents": ("draw: {agents: 2, targets: 3}\n", ("targets: 3 with agents: 2", "no more targets")),
    "a flight of too many steps": (
        "draw: {agents: 2, targets: 1}\nmax_time_s: 1.0e12\n",
        ("max_time_s", "1e+12", "20000000 times"),
    ),
    "ids twice": (
        "agents: [{id: 4}, {id: 4}]\ndraw: {targets: 1}\n",
        ("agents[1]", "id 4 is given twice", "each id once"),
    ),
    "id zero": ("agents: [{id: 0}]\n", ("agents[0].id", "0", "greater than or equal to 1")),
    "an id beyond 16 bits": ("agents: [{id: 65536}]\n", ("agents[0].id", "65536", "65535")),
    "no id": ("agents: [{north_m: 1, east_m: 1}]\n", ("agents[0].id", "missing")),
    "n_max zero": ("agents: [{id: 1, n_max: 0}]\n", ("agents[0].n_max", "0", "greater than 0")),
    "speed zero": ("agents: [{id: 1, speed_m_s: 0}]\n", ("agents[0].speed_m_s", "0", "greater than 0")),
    "speed zero by default": (
        "draw: {agents: 1, targets: 1}\ndefaults: {agent: {speed_m_s: 0}}\n",
        ("defaults.agent.speed_m_s", "0", "greater than 0"),
    ),
    "half a position": ("agents: [{id: 1, north_m: 3}]\n", ("agents[0]", "east_m", "both, or neither")),
    "nothing to fly": ("name: nothing\n", ("agents", "none", "at least one")),
    "nowhere to go": ("draw: {agents: 1}\n", ("targets", "none", "at least one")),
    "drawn threats without radii": (
        "draw: {agents: 1, targets: 1, threats: 2}\n",
        ("draw.threats", "2", "defaults.threat.detection_radius_m"),
    ),
    "drawn threats with bad radii": (
        "draw: {agents: 1, targets: 1, threats: 2}\ndefaults: {threat: {detection_radius_m: 5, attack_radius_m: 9}}\n",
        ("defaults.threat.attack_radius_m: 9", "less than"),
    ),
    "drawn targets faster than their bound": (
        "draw: {agents: 1, targets: 1}\n"
        "defaults: {target: {speed_bound_m_s: 5, motion: {heading_deg: 0, speed_m_s: 6}}}\n",
        ("defaults.target.motion", "6", "at most the bound"),
    ),
    "a motion faster than its bound": (
        "targets: [{id: 1, speed_bound_m_s: 5, motion: {heading_deg: 0, speed_m_s: 6}}]\n",
        ("targets[0]", "motion", "6", "speed_bound_m_s 5", "at most the bound"),
    ),
    "a path faster than its bound": (
        "targets: [{id: 1, speed_bound_m_s: 5, motion: {path: [[0, 0, 0], [1, 6, 0]]}}]\n",
        ("targets[0]", "motion", "6", "at most the bound"),
    ),
    "a path out of order": (
        "targets: [{id: 1, motion: {path: [[5, 0, 0], [4, 1, 0]]}}]\n",
        ("targets[0].motion", "path", "increase"),
    ),
    "a path that starts elsewhere": (
        "targets: [{id: 1, north_m: 5, east_m: 0, motion: {path: [[0, 0, 0], [9, 1, 0]]}}]\n",
        ("targets[0]", "motion.path", "the same point"),
    ),
    "a target that chases": ("targets: [{id: 1, motion: chase}]\n", ("targets[0].motion", "'chase'", "'random'")),
    "a motion nobody knows": ("targets: [{id: 1, motion: zigzag}]\n", ("targets[0].motion", "'zigzag'", "'random'")),
    "a floor above its ceiling": (
        ONE_EACH + "threats: [{id: 1, detection_radius_m: 5, attack_radius_m: 1, floor_m: 9, ceiling_m: 9}]\n",
        ("threats[0]", "floor_m: 9", "less than ceiling_m 9"),
    ),
    "a drawn floor above its ceiling": (
        "draw: {agents: 1, targets: 1, threats: 1}\n"
        "defaults: {threat: {detection_radius_m: 5, attack_radius_m: 1, floor_m: 9, ceiling_m: 8}}\n",
        ("defaults.threat.floor_m: 9", "less than ceiling_m 8"),
    ),
    "a floor below the earth": (
        ONE_EACH + "threats: [{id: 1, detection_radius_m: 5, attack_radius_m: 1, floor_m: -40000}]\n",
        ("threats[0].floor_m", "-40000", "-1000"),
    ),
    "an agent below the ground": ("agents: [{id: 1, height_m: -1}]\n", ("agents[0].height_m", "-1", "0")),
    "layers without a spacing": (ONE_EACH + "layers: 3\n", ("layers: 3", "layer_spacing_m 0", "at least 2")),
    "a spacing without layers": (ONE_EACH + "layer_spacing_m: 20\n", ("layers: 1", "layer_spacing_m 20")),
    "no layers": (ONE_EACH + "layers: 0\n", ("layers", "0", "greater than or equal to 1")),
    "layers out of the atmosphere": (
        ONE_EACH + "layers: 3\nlayer_spacing_m: 9990\n",
        ("layer_spacing_m: 9990", "20010 m", "at most 20000"),
    ),
    "drawn agents out of the atmosphere": (
        "draw: {agents: 1, targets: 1}\ndefaults: {agent: {height_m: 19000}}\nlayers: 2\nlayer_spacing_m: 2000\n",
        ("layer_spacing_m: 2000", "21000 m"),
    ),
    "an agent kept for a target that is not": (
        "agents: [{id: 1, only_target: 2}]\ntargets: [{id: 1}]\n",
        ("agents[0].only_target: 2", "a listed target"),
    ),
    "a share of all": (ONE_EACH + "switching_share: 1\n", ("switching_share", "1", "less than 1")),
    "an objective that is not": (ONE_EACH + "objective: fastest\n", ("objective", "'fastest'", "'latest'")),
    "a threat too fast for the wire": (
        "threats: [{id: 1, detection_radius_m: 5, attack_radius_m: 1, speed_bound_m_s: 856}]\n",
        ("threats[0].speed_bound_m_s", "856", "855"),
    ),
    "a position off the map": ("agents: [{id: 1, north_m: 2.0e6, east_m: 0}]\n", ("agents[0].north_m", "2000000")),
    "a latitude beyond the pole": (ONE_EACH + "origin: {lat_deg: 91}\n", ("origin.lat_deg", "91", "90")),
    "a fence of two corners": (ONE_EACH + "fence: [[0, 0], [1, 1]]\n", ("fence", "at least 3")),
    "a fence that crosses itself": (
        ONE_EACH + "fence: [[0, 0], [9, 9], [9, 0], [0, 9]]\n",
        ("fence: the edges after corners 0 and 2 cross or touch", "allowed: a simple polygon"),
    ),
    "an exclusion of two corners": (ONE_EACH + "exclusions: [[[0, 0], [1, 1]]]\n", ("exclusions[0]", "at least 3")),
    "an exclusion without its own brackets": (ONE_EACH + "exclusions: [[0, 0], [1, 1], [2, 0]]\n", ("exclusions[0]",)),
    "an exclusion that is closed by hand": (
        ONE_EACH + "exclusions: [[[7, 0], [8, 0], [8, 1]], [[0, 0], [1, 1], [2, 0], [0, 0]]]\n",
        ("exclusions[1]: corner 3 is corner 0 again", "allowed: a simple polygon"),
    ),
    "an exclusion off the map": (ONE_EACH + "exclusions: [[[0, 0], [1, 1], [2.0e6, 0]]]\n", ("exclusions[0][2][0]",)),
    "a fence corner of three numbers": (ONE_EACH + "fence: [[0, 0, 0], [1, 1], [2, 0]]\n", ("fence[0]",)),
    "a chance above one": (ONE_EACH + "link: {loss: 1.5}\n", ("link.loss", "1.5", "less than or equal to 1")),
    "a case that is not": (ONE_EACH + "case: III\n", ("case", "'III'", "'I' or 'II'")),
    "steps that do not divide": (
        ONE_EACH + "guidance_step_s: 0.5\nintegration_step_s: 0.3\n",
        ("guidance_step_s", "0.5", "whole multiple", "0.3"),
    ),
    "a step of nearly nothing": (ONE_EACH + "integration_step_s: 1.0e-320\n", ("integration_step_s", "0.001")),
    "a period of nearly nothing": (ONE_EACH + "broadcast_period_s: 1.0e-300\n", ("broadcast_period_s", "0.001")),
    "a step longer than guidance bears": (ONE_EACH + "guidance_step_s: 20\n", ("guidance_step_s", "20", "10")),
    "an integer tag on a word": ("name: !!int abc\n", ("not valid YAML",)),
    "an integer tag on nothing": ("name: !!int ''\n", ("not valid YAML",)),
    "a truth tag on a word": ("name: !!bool maybe\n", ("not valid YAML",)),
    "a date tag on a word": ("name: !!timestamp soon\n", ("not valid YAML",)),
    "a tag of Python": ("name: !!python/object/apply:os.getcwd []\n", ("not valid YAML",)),
    "a control character": ("name: 'a\x00b'\n", ("not valid YAML",)),
    "an unknown alias": ("name: *nobody\n", ("not valid YAML", "nobody")),
    "a list that holds itself": ("name: &a [*a]\n", ("name", "string")),
    "a bomb of aliases": (BOMB + "name: *a11\n", ("unknown key 'a0'",)),
    "a bomb of aliases as a value": ("name:\n" + "".join(f"  {line}\n" for line in BOMB.splitlines()), ("name",)),
    "deep lists": ("name: " + "[" * 20_000 + "]" * 20_000 + "\n", ("not valid YAML",)),
    "deep mappings": ("".join(" " * k + "a:\n" for k in range(2_000)), ("not valid YAML",)),
    "a key without end": ("? " + "k" * 100_000 + "\n: 1\n", ("kkk...", "allowed")),
    "a value without end": (f"name: {'v' * 100_000}\n", ("name", "vvv...", "80")),
}

ILLEGAL_STARTS: dict[str, tuple[str, tuple[str, ...]]] = {
    "an agent inside R_a": (
        ONE_EACH + "threats: [{id: 3, north_m: 50, east_m: 0, detection_radius_m: 900, attack_radius_m: 100}]\n",
        ("agents[0]", "id 1", "50.0 m from threat 3", "outside its attack_radius_m 100"),
    ),
    "a target inside R_a": (
        ONE_EACH + "threats: [{id: 3, north_m: 9000, east_m: 0, detection_radius_m: 900, attack_radius_m: 100}]\n",
        ("targets[0]", "id 1", "0.0 m from threat 3", "outside its attack_radius_m 100"),
    ),
    "two agents closer than D_safe": (
        "agents: [{id: 1, north_m: 0, east_m: 0}, {id: 2, north_m: 60, east_m: 0}]\n"
        "targets: [{id: 1, north_m: 9000, east_m: 0}]\n",
        ("agents[1]", "id 2", "60.0 m from agent 1", "at least separation_m 100"),
    ),
    "an agent outside the fence": (
        ONE_EACH + "fence: [[100, -100], [100, 100], [9900, 100], [9900, -100]]\n",
        ("agents[0]", "id 1", "inside the fence"),
    ),
    "an agent inside an exclusion": (
        ONE_EACH + "exclusions: [[[900, 0], [950, 0], [950, 9]], [[-9, -9], [-9, 9], [9, 9], [9, -9]]]\n",
        ("agents[0]", "id 1", "outside exclusions[1]"),
    ),
    "a target inside an exclusion": (
        ONE_EACH + "exclusions: [[[8900, -9], [8900, 9], [9100, 9], [9100, -9]]]\n",
        ("targets[0]", "id 1", "outside exclusions[0]"),
    ),
    "the loss of an unknown agent": (ONE_EACH + "losses: [{agent: 8, t_s: 4}]\n", ("losses[0].agent", "8", "one of 1")),
}


def assert_one_line(message: str, source: str, parts: tuple[str, ...]) -> None:
    assert message.startswith(f"{source}: ")
    assert "\n" not in message
    assert len(message) < 1_500
    for part in parts:
        assert part in message


@pytest.mark.slow
@pytest.mark.parametrize("what", BAD)
def test_a_bad_mission_is_refused_in_one_line_that_says_what_is_wrong(what: str) -> None:
    text, parts = BAD[what]
    with pytest.raises(InputError) as caught:
        parse_mission(text, "bad.yaml")
    assert_one_line(str(caught.value), "bad.yaml", parts)


@pytest.mark.parametrize("what", ILLEGAL_STARTS)
def test_an_illegal_start_is_refused_in_one_line_that_says_what_is_wrong(what: str) -> None:
    text, parts = ILLEGAL_STARTS[what]
    with pytest.raises(InputError) as caught:
        resolve(parse_mission(text, "bad.yaml"), 1, "bad.yaml")
    assert_one_line(str(caught.value), "bad.yaml", parts)


@pytest.mark.slow
@given(st.text(st.sampled_from("ab:[]{}&*!|>-?,#'\"%@`\n\t 01.~<=é\x00"), max_size=40) | st.text(max_size=40))
def test_no_text_whatever_ends_in_anything_but_an_input_error(text: str) -> None:
    try:
        parse_mission(text, "any.yaml")
    except InputError as error:
        assert "\n" not in str(error)


@pytest.mark.slow
@given(
    st.sampled_from(sorted(Mission.model_fields)),
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text(st.characters(codec="utf-8"), max_size=3) | st.integers(),
        lambda inner: (
            st.lists(inner, max_size=3)
            | st.dictionaries(st.sampled_from(["id", "agents", "path", "north_m", "loss", "k_d"]), inner, max_size=3)
        ),
        max_leaves=8,
    ),
)
def test_no_value_under_any_key_ends_in_anything_but_an_input_error(key: str, value: object) -> None:
    try:
        parse_mission(dump_yaml({"draw": {"agents": 1, "targets": 1}, key: value}), "any.yaml")
    except InputError as error:
        assert "\n" not in str(error)


def test_of_several_faults_one_is_named() -> None:
    with pytest.raises(InputError, match=r"agents\[0\]\.speed_m_s"):
        parse_mission("agents: [{id: 1, speed_m_s: -1}]\nmax_time_s: -5\n", "x")


# The same through the real command lines


BadFile = Callable[[Path], Path]


def file_of(data: bytes) -> BadFile:
    def write(folder: Path) -> Path:
        path = folder / "bad.yaml"
        path.write_bytes(data)
        return path

    return write


BAD_FILES: dict[str, BadFile] = {
    "missing": lambda folder: folder / "missing.yaml",
    "a folder": lambda folder: folder,
    "a path through a file": lambda folder: file_of(b"x: 1\n")(folder) / "below.yaml",
    "a name too long for a path": lambda folder: folder / ("n" * 5_000),
    "binary": file_of(bytes(range(256))),
    "huge": file_of(b"# " + b"x" * MAX_FILE_BYTES),
    **{what: file_of(text.encode("utf-8")) for what, (text, _) in BAD.items() if what != "deep lists"},
}


@pytest.fixture
def program(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """Return a caller of a program by its command line: exit status, stdout, stderr."""
    mains = {"sim": sim.cli.main, "groundstation": groundstation.cli.main, "companion": companion.cli.main}

    def call(name: str, *arguments: str | Path) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            mains[name]()
        out, err = capsys.readouterr()
        assert isinstance(caught.value.code, int)
        return caught.value.code, out, err

    return call


Program = Callable[..., tuple[int, str, str]]


def assert_refused(result: tuple[int, str, str], name: str, *parts: str) -> None:
    status, out, err = result
    assert (status, out) == (EXIT_UNUSABLE, "")
    assert err.startswith(f"{name}: ")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    assert "Traceback" not in err
    for part in parts:
        assert part in err


COMMANDS = {
    "sim": ("sim", "fly"),
    "groundstation": ("groundstation", "run", "--link", "udpout:127.0.0.1:9", "--unsigned"),
    "companion": ("companion", "run"),
}


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("what", BAD_FILES)
def test_every_program_refuses_a_bad_file_in_one_line(program: Program, tmp_path: Path, name: str, what: str) -> None:
    path = BAD_FILES[what](tmp_path)
    assert_refused(program(*COMMANDS[name], path), name, path.name if len(path.name) < 100 else "nnn")


@pytest.mark.parametrize("name", ["sim", "groundstation"])
@pytest.mark.parametrize("what", ILLEGAL_STARTS)
def test_every_program_refuses_an_illegal_start_in_one_line(
    program: Program, tmp_path: Path, name: str, what: str
) -> None:
    text, parts = ILLEGAL_STARTS[what]
    assert_refused(program(*COMMANDS[name], file_of(text.encode())(tmp_path)), name, "bad.yaml", *parts)


@pytest.mark.parametrize("name", ["sim", "groundstation"])
def test_a_misspelt_packaged_mission_is_told_the_nearest(program: Program, name: str) -> None:
    assert_refused(program(*COMMANDS[name], "paper-dinamic"), name, "did you mean 'paper-dynamic'?")


def test_a_misspelt_packaged_configuration_is_told_the_nearest(program: Program) -> None:
    assert_refused(program("companion", "run", "copter-demo-l"), "companion", "did you mean 'copter-demo-1'?")


@pytest.mark.parametrize("name", COMMANDS)
def test_an_unknown_option_is_refused_in_one_line(program: Program, name: str) -> None:
    assert_refused(program(*COMMANDS[name], "paper-static", "--sead", "1"), name, "--sead")


@pytest.mark.parametrize("name", COMMANDS)
def test_a_missing_argument_is_refused_in_one_line(program: Program, name: str) -> None:
    assert_refused(program(*COMMANDS[name]), name, "Missing argument")


@pytest.mark.parametrize("name", COMMANDS)
def test_an_unknown_command_is_refused_in_one_line(program: Program, name: str) -> None:
    assert_refused(program(name, "fry"), name, "fry")


@pytest.mark.parametrize("name", COMMANDS)
def test_no_command_at_all_is_refused_in_one_line(program: Program, name: str) -> None:
    assert_refused(program(name), name, "--help")


@pytest.mark.parametrize("name", COMMANDS)
def test_help_comes_with_an_example(program: Program, name: str) -> None:
    status, out, err = program(*COMMANDS[name], "--help")
    assert (status, err) == (0, "")
    assert "Example: " in out


@pytest.mark.parametrize(
    ("arguments", "parts"),
    [
        (("--law", "sead"), ("--law", "'sead'", "did you mean 'seed'?", "allowed: routed, seed, ramp, step")),
        (("--autopilot", "kinematik"), ("--autopilot", "'kinematik'", "did you mean 'kinematic'?", "arducopter")),
        (("--seed", "-1"), ("--seed", "-1")),
        (("--seed", "1.5"), ("--seed", "1.5")),
        (("--seed", str(2**63)), ("--seed",)),
        (("--seed", "one"), ("--seed", "one")),
        (("--vehicles", "0"), ("--vehicles", "0")),
        (("--vehicles", "4"), ("--vehicles", "4", "at least")),
    ],
)
def test_sim_fly_refuses_a_bad_option_in_one_line(
    program: Program, arguments: tuple[str, ...], parts: tuple[str, ...]
) -> None:
    assert_refused(program("sim", "fly", "paper-static", *arguments), "sim", *parts)


def test_sim_fly_refuses_an_output_folder_below_a_file(program: Program, tmp_path: Path) -> None:
    below = file_of(b"x")(tmp_path) / "runs"
    assert_refused(program("sim", "fly", "copter-demo", "--out", below), "sim", "--out", "allowed: a writable folder")


@pytest.mark.parametrize(
    "arguments",
    [
        ("--link", "udpout:127.0.0.1"),
        ("--link", "tcp:127.0.0.1:9"),
        ("--link", "udpout:127.0.0.1:70000"),
        ("--link", "udpin:127.0.0.1:9"),
        ("--link", ""),
        ("--link", "udpout:127.0.0.1:9", "--sensor", "udpin:nowhere"),
        ("--link", "udpout:127.0.0.1:9", "--sensor", "udpout:127.0.0.1:9"),
        ("--link", "udpout:127.0.0.1:9", "--seed", "-1"),
        (),
    ],
)
def test_groundstation_run_refuses_a_bad_option_in_one_line(program: Program, arguments: tuple[str, ...]) -> None:
    option = next((word for word in reversed(arguments) if word.startswith("--")), "--link").removeprefix("--")
    result = program("groundstation", "run", "copter-demo", *arguments, "--unsigned")
    assert_refused(result, "groundstation", "link" if option == "sensor" else option)


def test_groundstation_run_refuses_an_autopilot_that_is_not(program: Program) -> None:
    arguments = ("copter-demo", "--link", "udpout:127.0.0.1:9", "--autopilot", "arducoptor")
    said = ("--autopilot", "'arducoptor'", "did you mean 'arducopter'?", "kinematic")
    assert_refused(program("groundstation", "run", *arguments), "groundstation", *said)


@pytest.mark.parametrize(
    ("lines", "parts"),
    [
        ("case: II\nreport_period_s: 20", ("report_period_s: 20 without --uplink", "allowed: --uplink")),
        ("case: II\nsurrogate: monolithic", ("surrogate: 'monolithic'", "allowed: pairwise, analytic")),
        ("wind: {speed_m_s: 50, gust_m_s: 10}", ("wind: ", "together 60", "allowed: less than the slowest")),
    ],
)
def test_groundstation_run_refuses_what_would_end_badly(
    program: Program, tmp_path: Path, lines: str, parts: tuple[str, ...]
) -> None:
    path = file_of(f"{ONE_EACH}{lines}\n".encode())(tmp_path)
    assert_refused(program("groundstation", "run", path, "--link", "udpout:127.0.0.1:9"), "groundstation", *parts)


def test_groundstation_run_refuses_an_uplink_in_case_i(program: Program, tmp_path: Path) -> None:
    path = file_of(f"{ONE_EACH}case: I\n".encode())(tmp_path)
    arguments = (path, "--link", "udpout:127.0.0.1:9", "--uplink", "udpin:127.0.0.1:0")
    assert_refused(
        program("groundstation", "run", *arguments), "groundstation", "case: 'I' with --uplink", "allowed: II"
    )


@pytest.mark.parametrize("url", ["udpin:nowhere", "udpout:127.0.0.1:9"])
def test_groundstation_run_refuses_an_uplink_that_cannot_be_heard(program: Program, tmp_path: Path, url: str) -> None:
    path = file_of(f"{ONE_EACH}case: II\n".encode())(tmp_path)
    arguments = (path, "--link", "udpout:127.0.0.1:9", "--unsigned", "--uplink", url)
    assert_refused(program("groundstation", "run", *arguments), "groundstation", f"link '{url}'", "allowed: udpin")


@pytest.mark.parametrize(
    ("line", "parts"),
    [
        (
            "surrogate: monolithic",
            ("surrogate", "'monolithic' is not flown", "gradient is noise", "pairwise, analytic", "--allow-monolithic"),
        ),
        (
            "wind: {speed_m_s: 50, gust_m_s: 10}",
            ("wind", "together 60", "allowed: less than the slowest agent's", "60"),
        ),
    ],
)
def test_what_is_not_flown_is_refused_in_one_line(
    program: Program, tmp_path: Path, line: str, parts: tuple[str, ...]
) -> None:
    path = file_of(f"{ONE_EACH}{line}\n".encode())(tmp_path)
    assert_refused(program("sim", "fly", path), "sim", "bad.yaml", *parts)


def test_sim_fly_refuses_an_id_that_the_one_network_has_no_place_for(program: Program, tmp_path: Path) -> None:
    text = ONE_EACH.replace("agents: [{id: 1", "agents: [{id: 11") + "surrogate: monolithic\n"
    result = program("sim", "fly", file_of(text.encode())(tmp_path), "--allow-monolithic")
    assert_refused(result, "sim", "agents[0].id: 11", "allowed: 1 to 10")


def test_sim_fly_flies_the_one_network_when_told_to_and_warns_of_it(program: Program, tmp_path: Path) -> None:
    path = file_of(f"{ONE_EACH}surrogate: monolithic\nmax_time_s: 5\n".encode())(tmp_path)
    status, out, err = program("sim", "fly", path, "--law", "seed", "--allow-monolithic", "--json")
    assert (status, json.loads(out)["steps"]) == (EXIT_FAILED, 10)
    assert err.startswith("sim: warning: ")
    assert "should not fly" in err


# How fast a thing may move, where nobody says


@pytest.mark.parametrize("kind", ["targets", "threats"])
@pytest.mark.parametrize(
    ("motion", "bound_m_s"),
    [("static", 0.0), (None, 0.0), ("random", 10.0), ("{heading_deg: 3, speed_m_s: 4}", 10.0)],
)
def test_only_what_moves_has_a_speed_bound_by_itself(kind: str, motion: str | None, bound_m_s: float) -> None:
    keys = "id: 5, north_m: 700, east_m: 0" + ("" if motion is None else f", motion: {motion}")
    radii = ", detection_radius_m: 9, attack_radius_m: 4" if kind == "threats" else ""
    more = "" if kind == "targets" else "targets: [{id: 1}]\n"
    mission = parse_mission(f"agents: [{{id: 1}}]\n{more}{kind}: [{{{keys}{radii}}}]\n", "test")
    (item,) = getattr(mission, kind)
    assert item.speed_bound_m_s == bound_m_s


def test_a_default_or_a_given_bound_counts_for_what_stands_still_too() -> None:
    mission = parse_mission(
        "agents: [{id: 1}, {id: 2}]\ntargets: [{id: 1}, {id: 2, speed_bound_m_s: 3}]\n"
        "defaults: {target: {speed_bound_m_s: 7}}\n",
        "test",
    )
    assert [target.speed_bound_m_s for target in mission.targets] == [7.0, 3.0]


def test_what_is_drawn_has_the_bound_of_its_motion() -> None:
    text = (
        "draw: {{agents: 1, targets: 1, threats: 1}}\ndefaults:\n  target: {{motion: {0}}}\n"
        "  threat: {{detection_radius_m: 9, attack_radius_m: 4, motion: {0}}}\n"
    )
    for motion, bound_m_s in (("static", 0.0), ("random", 10.0)):
        mission = resolve(parse_mission(text.format(motion), "test"), 1)
        assert [item.speed_bound_m_s for item in (*mission.targets, *mission.threats)] == [bound_m_s, bound_m_s]
