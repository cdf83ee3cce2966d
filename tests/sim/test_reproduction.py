"""`sim reproduce`: the pure core beside the wire, the claims and their verdicts, and what the command writes."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import sim.reproduction.command as command
import sim.reproduction.experiments as experiments
from companion.errors import InputError, run_program
from companion.geo.kinematics import shorter_turn_rad, turn_rate_rad_s
from companion.mission.model import LinkSpec, Loss, Mission, parse_mission
from companion.mission.resolve import resolve
from sim.cli import cli
from sim.lockstep import fly
from sim.reproduction.claims import Claim, Verdict, all_claims
from sim.reproduction.core_flight import fly_core
from sim.reproduction.experiments import (
    DYNAMIC,
    N_MAX,
    STATIC_SEED,
    STATIC_STEP,
    FlightFigures,
    Flown,
    Results,
    Settings,
    Training,
    WireComparison,
    all_series,
    check_trainable,
    compare_with_wire,
    illustrative_seed,
    median_seed,
    paper_mission,
    run_all,
)
from sim.reproduction.figures import (
    APPROXIMATION,
    LEARNING,
    SNAPSHOTS,
    STATIC_SEED_PATHS,
    STATIC_STEP_PATHS,
    STEP_TIMES,
)
from sim.reproduction.report import content_of, markdown
from sim.score import score

METHOD_SECTION_4 = {
    "training-mse",
    "static-surrogate",
    "static-step",
    "dynamic-reached",
    "dynamic-steps",
    "mean-time",
    "greatest-time",
}
"""Every claim of docs/method.md section 4."""
METHOD_SECTION_2 = {"learns-nothing", "inputs", "turn-limit", "separation", "weights"}
SMALL = """
name: small
area_m: {north: 30000, east: 30000}
draw: {agents: 4, targets: 2, threats: 2}
defaults:
  target: {speed_bound_m_s: 10, motion: random}
  threat: {detection_radius_m: 3000, attack_radius_m: 1500, speed_bound_m_s: 10, motion: random}
range_policy: arrive
link: {delay_s: 0.0}
max_time_s: 600
"""
FIGURES = dict.fromkeys(
    (APPROXIMATION, LEARNING, STATIC_SEED_PATHS, STATIC_STEP_PATHS, SNAPSHOTS, STEP_TIMES), "a caption"
)
BESIDE_A_THREAT = """
name: beside a threat
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}]
targets: [{id: 1, north_m: 9000, east_m: 0, speed_bound_m_s: 0}]
threats: [{id: 1, north_m: 5000, east_m: 600, detection_radius_m: 1500, attack_radius_m: 700, speed_bound_m_s: 10,
           motion: {heading_deg: 300, speed_m_s: 10}}]
range_policy: arrive
link: {delay_s: 0.0}
max_time_s: 300
"""
FACE_TO_FACE = """
name: face to face
agents:
  - {id: 1, north_m: -130, east_m: 0, heading_deg: 0, n_max: 1}
  - {id: 2, north_m: 12130, east_m: 0, heading_deg: 180, n_max: 1}
  - {id: 3, north_m: 0, east_m: 20000, heading_deg: 0}
targets:
  - {id: 1, north_m: 6000, east_m: 0, speed_bound_m_s: 0}
  - {id: 2, north_m: 12000, east_m: 20000, speed_bound_m_s: 0}
range_policy: arrive
link: {delay_s: 0.0}
max_time_s: 300
"""
TINY: dict[str, Any] = {"wire_seeds": 1, "fine_seeds": 1, "time_limit_s": 60.0}


def small(seed: int, n_max: float = 10.0, guidance_s: float = 5.0, integration_s: float = 1.0) -> Mission:
    drawn = resolve(parse_mission(SMALL, "small"), seed)
    return drawn.model_copy(
        update={
            "agents": tuple(agent.model_copy(update={"n_max": n_max}) for agent in drawn.agents),
            "guidance_step_s": guidance_s,
            "integration_step_s": integration_s,
        }
    )


# The pure core


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "n_max", "guidance_s", "integration_s"), [(2, 2.0, 5.0, 1.0), (3, 10.0, 5.0, 1.0), (3, 0.5, 0.5, 0.5)]
)
def test_the_pure_core_flies_as_the_wire_does(seed: int, n_max: float, guidance_s: float, integration_s: float) -> None:
    compared = compare_with_wire(small(seed, n_max, guidance_s, integration_s), seed)

    assert compared.agrees
    assert compared.targets_core == (1, 2)
    assert compared.steps_core == compared.steps_wire
    # Positions are rounded to a centimetre's multiple of the area on the wire, radii upwards.
    assert compared.apart_m < 5.0 or compared.guard_interventions
    assert compared.core_us.shape == (compared.steps_core,)
    assert compared.wire_us.shape == (compared.steps_wire,)


@pytest.mark.slow
def test_between_broadcasts_threats_grow_in_the_core_as_they_do_on_board() -> None:
    mission = resolve(parse_mission(BESIDE_A_THREAT, "scene"), 1)
    nearest_m = [
        np.sort(np.hypot(*(flight.trajectory.agents_ned_m - flight.trajectory.threats_ned_m)[:, 0].T))[:40]
        for flight in (fly_core(mission, 1), fly(mission, 1))
    ]

    # Grazing a disc, an agent is thrown to and fro at every step, so that the paths differ; how near it comes does not.
    assert nearest_m[0].min() == pytest.approx(nearest_m[1].min(), abs=3.0)
    assert nearest_m[0].mean() == pytest.approx(nearest_m[1].mean(), abs=3.0)


@pytest.mark.slow
def test_agents_that_arrive_together_loiter_in_the_core_where_they_do_over_the_wire() -> None:
    mission = resolve(parse_mission(FACE_TO_FACE, "scene"), 1)
    core, wire = fly_core(mission, 1).trajectory, fly(mission, 1).trajectory

    samples = min(len(core.t_s), len(wire.t_s))
    assert abs(len(core.t_s) - len(wire.t_s)) <= 1
    assert np.abs(core.agents_ned_m[:samples] - wire.agents_ned_m[:samples]).max() < 5.0


def test_the_same_seed_flies_the_same_to_the_last_bit_and_another_one_does_not() -> None:
    first, again, other = (fly_core(small(seed), 1).trajectory for seed in (1, 1, 2))

    assert np.array_equal(first.agents_ned_m, again.agents_ned_m)
    assert np.array_equal(first.threats_ned_m, again.threats_ned_m)
    assert not np.array_equal(first.agents_ned_m[0], other.agents_ned_m[0])


@pytest.mark.parametrize("n_max", [10.0, 0.5])
def test_no_agent_turns_by_more_than_the_turn_limit_allows_and_the_binding_steps_are_counted(n_max: float) -> None:
    mission = small(2, n_max)
    flight = fly_core(mission, 2)

    greatest_rad = turn_rate_rad_s(60.0, n_max) * 5.0
    at_steps = np.radians(flight.trajectory.agents_heading_deg[::5])
    turns_rad = np.abs([[shorter_turn_rad(*pair) for pair in column] for column in _pairs(at_steps)])
    assert turns_rad.max() <= min(greatest_rad, math.pi) + 1e-5
    binding = int((turns_rad > greatest_rad - 1e-5).sum())
    assert flight.turn_limited_steps == binding
    assert (binding > 0) is (n_max == 0.5)


def _pairs(headings_rad: np.ndarray) -> list[list[tuple[float, float]]]:
    return [list(zip(column[:-1], column[1:], strict=True)) for column in headings_rad.T]


def test_with_the_gradient_of_f_agents_fly_through_what_the_surrogate_leads_them_around() -> None:
    scene = """
name: ahead
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}]
targets: [{id: 1, north_m: 40000, east_m: 0, speed_bound_m_s: 0}]
threats: [{id: 1, north_m: 20000, east_m: 500, detection_radius_m: 5000, attack_radius_m: 1000, speed_bound_m_s: 0}]
range_policy: arrive
link: {delay_s: 0.0}
guidance_step_s: 5
integration_step_s: 1
max_time_s: 1500
"""
    mission = resolve(parse_mission(scene, "ahead"), 1)
    around, through = (score(fly_core(mission, 1, law).trajectory, mission) for law in ("seed", "step"))

    assert (around.threat_entries_detection, around.targets_reached) == (0, 1)
    assert (through.threat_entries_detection, through.targets_reached) == (1, 1)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"link": LinkSpec(delay_s=0.1)}, "link"),
        ({"losses": (Loss(agent=1, t_s=5.0),)}, "losses"),
        ({"broadcast_period_s": 0.5}, "broadcast_period_s"),
        ({"range_policy": "return"}, "range_policy"),
        ({"case": "II"}, "case"),
        ({"objective": "route"}, "objective"),
        ({"surrogate": "monolithic"}, "surrogate"),
    ],
)
def test_the_core_refuses_what_it_does_not_model(changes: dict[str, Any], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        fly_core(small(1).model_copy(update=changes), 1)


# What is run


def test_the_experiments_are_those_that_were_asked_for() -> None:
    series = all_series(Settings())

    assert [each.key for each in series][:3] == [STATIC_SEED, STATIC_STEP, DYNAMIC]
    assert all(len(each.seeds) == 200 for each in series if each.guidance_step_s == 5.0)
    for step_s in (5.0, 0.5):
        swept = [each.n_max for each in series if each.mission == "paper-dynamic" and each.guidance_step_s == step_s]
        assert tuple(swept) == N_MAX == (10.0, 2.0, 1.0, 0.5)
    mission = paper_mission(series[2], 1)
    assert (mission.guidance_step_s, mission.integration_step_s, mission.max_time_s) == (5.0, 1.0, 8330.0)
    assert (len(mission.agents), len(mission.targets), len(mission.threats)) == (10, 5, 4)
    assert {agent.n_max for agent in paper_mission(series[5], 1).agents} == {0.5}


def test_flights_for_the_figures_are_chosen_by_rule() -> None:
    none, one, three, four = ((), (2,), (1, 2, 3), (1, 2, 3, 4))

    assert illustrative_seed([flight_of(1, entered=one), flight_of(2, entered=three), flight_of(3, entered=four)]) == 2
    assert illustrative_seed([flight_of(1, entered=none), flight_of(2, entered=one), flight_of(3, entered=one)]) == 2
    assert median_seed([flight_of(1, steps=30), flight_of(2, steps=10), flight_of(3, steps=20)]) == 3
    assert median_seed([flight_of(1, steps=30), flight_of(2, steps=10)]) == 2


def test_without_torch_one_line_says_how_to_get_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)

    with pytest.raises(InputError, match=re.escape("pip install '.[train]'")):
        check_trainable()
    status, printed = sim_reproduce(monkeypatch, capsys, "--out", str(tmp_path / "out"))
    assert status == 2
    assert printed.err.count("\n") == 1
    assert "torch" in printed.err


@pytest.mark.parametrize("arguments", [("--seeds", "4"), ("--seeds", "many"), ("--epochs", "0"), ("--out", "")])
def test_unusable_options_are_refused_on_one_line(
    arguments: tuple[str, str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    status, printed = sim_reproduce(monkeypatch, capsys, *arguments)

    assert status == 2
    assert printed.err.count("\n") == 1
    assert arguments[0] in printed.err


# Verdicts


def flight_of(seed: int, **figures: Any) -> FlightFigures:  # noqa: ANN401
    made: dict[str, Any] = {
        "steps": 210, "time_s": 1050.0, "targets_reached": 5, "targets": 5, "arrived": 5, "entries_detection": 0,
        "entries_attack": 0, "entered": (), "worst_depth_m": 0.0, "breaches": 0, "breaches_at_steps": 0,
        "min_separation_m": 150.0, "turn_limited": 0, "decisions": 2100,
    }  # fmt: skip
    return FlightFigures(seed=seed, **{**made, **figures})


def training_of(test_mse: float, variance: float) -> Training:
    curve = [(1, 0.3, 0.31), (2, 0.1, 0.12)]
    return Training(75, 100_000, 1000, 2, 0.9 * test_mse, test_mse, test_mse, variance, curve)


def compared_of(seed: int, **figures: Any) -> WireComparison:  # noqa: ANN401
    made: dict[str, Any] = {
        "targets_core": (1, 2), "targets_wire": (1, 2), "entries_core": (0, 0), "entries_wire": (0, 0),
        "steps_core": 210, "steps_wire": 210, "apart_m": 1.5, "apart_agent": 3, "apart_t_s": 40.0,
        "typical_apart_m": 0.5, "guard_interventions": 0, "core_us": np.full(210, 500.0),
        "wire_us": np.full(210, 4_000.0),
    }  # fmt: skip
    return WireComparison(seed=seed, **{**made, **figures})


@pytest.fixture(scope="module")
def good() -> Results:
    """Return results in which everything that the paper claims holds, as far as it can be compared."""
    settings = Settings(seeds=5, fine_seeds=5)
    series = all_series(settings)
    flights = {each.key: tuple(flight_of(seed) for seed in each.seeds) for each in series}
    flights[STATIC_STEP] = tuple(flight_of(seed, entered=(4, 6, 9), entries_detection=3) for seed in range(1, 6))
    flights[DYNAMIC] = tuple(flight_of(seed, steps=800 + 100 * seed) for seed in range(1, 6))
    dynamic = next(each for each in series if each.key == DYNAMIC)
    mission = paper_mission(dynamic, 1, 30.0)
    flight = fly_core(mission, 1)
    flown = Flown(mission, 1, flight.trajectory, score(flight.trajectory, mission), flight.steps)
    return Results(
        settings=settings,
        torch_version="0",
        monolithic=training_of(0.047, 0.045),
        pairwise=training_of(4e-5, 0.22),
        series=series,
        flights=flights,
        wire=tuple(compared_of(seed) for seed in range(1, 6)),
        static_pair=(flown, flown),
        dynamic=flown,
    )


def claims_of(results: Results) -> dict[str, Claim]:
    return {claim.key: claim for claim in all_claims(results)}


def with_flights(results: Results, key: str, **figures: Any) -> Results:  # noqa: ANN401
    """Change one flight of a series."""
    flights = dict(results.flights)
    flights[key] = (replace(flights[key][0], **figures), *flights[key][1:])
    return replace(results, flights=flights)


def with_all_flights(results: Results, key: str, **figures: Any) -> Results:  # noqa: ANN401
    flights = dict(results.flights)
    flights[key] = tuple(replace(flight, **figures) for flight in flights[key])
    return replace(results, flights=flights)


def test_the_table_holds_every_claim_once(good: Results) -> None:
    claims = all_claims(good)

    assert [claim.key for claim in claims if not claim.ours] == list(claims_of(good))[: len(METHOD_SECTION_4)]
    assert {claim.key for claim in claims if not claim.ours} == METHOD_SECTION_4
    assert {claim.key for claim in claims if claim.ours} == METHOD_SECTION_2
    paper = " ".join(f"{claim.claim} {claim.paper}" for claim in claims)
    for number in ("2.449e-4", "4, 6 and 9", "1007", "3.6 ms", "12.5 ms", "14"):
        assert number in paper
    assert all(claim.reason.endswith(".") and ". " not in claim.reason for claim in claims), "one sentence each"


def with_weights(results: Results, k_a: float) -> Results:
    weights = results.dynamic.mission.weights.model_copy(update={"k_a": k_a})
    mission = results.dynamic.mission.model_copy(update={"weights": weights})
    return replace(results, dynamic=replace(results.dynamic, mission=mission))


def with_times(results: Results, *core_us: float) -> Results:
    return replace(results, wire=(compared_of(1, core_us=np.array(core_us)),))


def with_threats(results: Results, count: int) -> Results:
    mission = results.dynamic.mission
    threats = tuple(mission.threats[0].model_copy(update={"id": index}) for index in range(1, count + 1))
    agents = mission.agents[:4]
    changed = mission.model_copy(update={"threats": threats, "agents": agents})
    return replace(results, dynamic=replace(results.dynamic, mission=changed))


@pytest.mark.parametrize(
    ("key", "change", "verdict"),
    [
        ("training-mse", lambda good: good, Verdict.INCOMPARABLE),
        ("static-surrogate", lambda good: good, Verdict.HOLDS),
        ("static-surrogate", lambda good: with_flights(good, STATIC_SEED, entries_detection=1), Verdict.FAILS),
        ("static-step", lambda good: good, Verdict.HOLDS),
        ("static-step", lambda good: with_all_flights(good, STATIC_STEP, entered=(4,)), Verdict.INCOMPARABLE),
        ("static-step", lambda good: with_all_flights(good, STATIC_STEP, entered=()), Verdict.FAILS),
        ("dynamic-reached", lambda good: good, Verdict.HOLDS),
        ("dynamic-reached", lambda good: with_flights(good, DYNAMIC, targets_reached=4), Verdict.FAILS),
        ("dynamic-steps", lambda good: good, Verdict.HOLDS),
        ("dynamic-steps", lambda good: with_all_flights(good, DYNAMIC, steps=210), Verdict.INCOMPARABLE),
        ("dynamic-steps", lambda good: with_all_flights(good, DYNAMIC, targets_reached=4), Verdict.INCOMPARABLE),
        ("mean-time", lambda good: good, Verdict.HOLDS),
        ("mean-time", lambda good: with_times(good, 3_700.0), Verdict.FAILS),
        ("greatest-time", lambda good: good, Verdict.HOLDS),
        ("greatest-time", lambda good: with_times(good, 1.0, 12_600.0), Verdict.FAILS),
        ("learns-nothing", lambda good: good, Verdict.HOLDS),
        ("learns-nothing", lambda good: replace(good, monolithic=training_of(0.01, 0.045)), Verdict.FAILS),
        ("inputs", lambda good: good, Verdict.HOLDS),
        ("inputs", lambda good: with_threats(good, 3), Verdict.FAILS),
        ("turn-limit", lambda good: good, Verdict.HOLDS),
        ("turn-limit", lambda good: with_flights(good, DYNAMIC, turn_limited=1), Verdict.FAILS),
        ("separation", lambda good: good, Verdict.INCOMPARABLE),
        ("separation", lambda good: with_flights(good, DYNAMIC, breaches=1), Verdict.HOLDS),
        ("separation", lambda good: with_flights(good, DYNAMIC, breaches=1, breaches_at_steps=1), Verdict.FAILS),
        ("weights", lambda good: good, Verdict.HOLDS),
        ("weights", lambda good: with_weights(good, 2e11), Verdict.FAILS),
    ],
)
def test_a_verdict_follows_from_what_was_measured(
    good: Results, key: str, change: Callable[[Results], Results], verdict: Verdict
) -> None:
    assert claims_of(change(good))[key].verdict is verdict


@pytest.mark.parametrize(
    ("figures", "agrees"),
    [
        ({}, True),
        ({"steps_wire": 211}, True),
        ({"steps_wire": 212}, False),
        ({"targets_wire": (1,)}, False),
        ({"entries_wire": (1, 0)}, False),
        ({"entries_wire": (0, 1)}, False),
    ],
)
def test_the_wire_agrees_in_targets_entries_and_steps_within_one(figures: dict[str, Any], agrees: bool) -> None:
    assert compared_of(1, **figures).agrees is agrees


# The report


def test_the_report_is_made_from_the_json_alone_and_says_what_it_is(good: Results) -> None:
    content = content_of(good, all_claims(good), FIGURES, 12.0)
    text = markdown(json.loads(json.dumps(content)))

    assert text.count("kinematic") >= 1
    for claim in all_claims(good):
        assert f"**{claim.verdict.value}**" in text
        assert claim.claim.replace("F*", "F\\*") in text
    assert "(seeds 1 to 5)" in text
    assert "guidance every 5 s, integration and sampling every 1 s" in text
    assert all(f"![{name}]({name})" in text for name in FIGURES)
    assert "smaller than the paper's" not in text
    smaller = replace(good, settings=replace(good.settings, epochs=10))
    assert "smaller than the paper's" in markdown(content_of(smaller, all_claims(smaller), FIGURES, 12.0))


def sim_reproduce(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: str
) -> tuple[object, Any]:
    monkeypatch.setattr(sys, "argv", ["sim", "reproduce", *arguments])
    with pytest.raises(SystemExit) as ended:
        run_program(cli, "sim")
    return ended.value.code, capsys.readouterr()


@pytest.mark.slow
def test_the_command_writes_every_file_and_processes_change_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setattr(command, "Settings", partial(Settings, **TINY))
    monkeypatch.setattr(command, "MAX_WORKERS", 1)
    out = tmp_path / "deep" / "out"
    options = ("--seeds", "5", "--samples", "200", "--epochs", "2")
    status, printed = sim_reproduce(monkeypatch, capsys, "--out", str(out), *options)

    assert printed.err == "", "nothing but the table in a pipe"
    assert status == 0
    content = json.loads((out / "reproduce.json").read_text())
    text = (out / "reproduce.md").read_text()
    drawn = {path.name for path in out.glob("*.png")}
    assert drawn == set(FIGURES) == set(content["figures"]) == set(re.findall(r"\]\(([^)]+)\)", text))
    assert all((out / name).stat().st_size > 5_000 for name in drawn)
    assert {claim["key"] for claim in content["claims"]} == METHOD_SECTION_4 | METHOD_SECTION_2
    assert all(claim["claim"] in printed.out for claim in content["claims"])
    assert (content["settings"]["seeds"], content["settings"]["samples"]) == (5, 200)
    assert "smaller than the paper's" in text

    # The training's own tests say that it depends on its arguments alone.
    monkeypatch.setattr(experiments._TrainingJob, "run", lambda job: (training_of(0.047, 0.045), "0"))
    alone = run_all(Settings(seeds=5, samples=200, epochs=2, **TINY), 0)
    again = json.loads(json.dumps(content_of(alone, all_claims(alone), content["figures"], 0.0)))
    for key in ("series", "wire", "illustrated"):
        assert content[key] == again[key], key


@pytest.mark.parametrize("agrees", [True, False])
def test_the_status_says_whether_the_wire_agreed(
    good: Results,
    agrees: bool,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:
    results = good if agrees else replace(good, wire=(*good.wire[:4], compared_of(5, steps_wire=300)))
    failing = with_flights(results, STATIC_SEED, entries_detection=1)
    monkeypatch.setattr(command, "run_all", lambda *arguments: failing)
    monkeypatch.setattr(command, "draw_all", lambda *arguments: FIGURES)
    status, printed = sim_reproduce(monkeypatch, capsys, "--out", str(tmp_path))

    assert status == (0 if agrees else 1), "a verdict is a result, a disagreement is not"
    assert ("seeds 5" in printed.err) is not agrees
    assert "does not hold" in printed.out
    assert ("**no**" in (tmp_path / "reproduce.md").read_text()) is not agrees
