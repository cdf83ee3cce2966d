"""`companion certify`: where in the plane the bounds hold, what they assume, and what the program prints."""

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from companion.cli import main
from companion.mission.model import Mission, load_mission, packaged_missions
from companion.mission.resolve import resolve
from companion.surrogate.certificates import Assumption, Certificate, Finding, certify
from companion.surrogate.cost import Weights
from companion.surrogate.networks import MonolithicNetwork
from companion.surrogate.profiles import ThreatDiscs, profile_by_name, surrogate_gradient

NAMES = ["printed", "corrected", "sharp", "tight"]
KINDS = [(10_000.0, 5_000.0), (6_000.0, 1_000.0), (12_000.0, 11_900.0)]
"""Mixed radii; with the last both edges count."""


def small(**changes: object) -> dict[str, Any]:
    """Return a mission of one agent, one target and one threat in nobody's way, with changes."""
    base: dict[str, Any] = {
        "name": "small",
        "agents": [{"id": 1, "north_m": 0.0, "east_m": 0.0, "heading_deg": 0.0}],
        "targets": [{"id": 1, "north_m": 60_000.0, "east_m": 0.0, "speed_bound_m_s": 10.0}],
        "threats": [
            {
                "id": 1,
                "north_m": 30_000.0,
                "east_m": 40_000.0,
                "detection_radius_m": 1e4,
                "attack_radius_m": 5e3,
                "speed_bound_m_s": 10.0,
            }
        ],
    }
    return {**base, **changes}


def certificate_of(b_m: float | None = None, **changes: object) -> Certificate:
    return certify(resolve(Mission.model_validate(small(**changes)), 1), 1, b_m)


def finding_of(certificate: Certificate, condition: str, group: int = 0) -> Finding:
    return next(finding for finding in certificate.groups[group].findings if finding.condition == condition)


def assumption_of(certificate: Certificate, name: str) -> Assumption:
    return next(assumption for assumption in certificate.assumptions if assumption.name.startswith(name))


def crowd(surrogate: str, agents: int, kinds: list[tuple[float, float]], speed_bound_m_s: float = 0.0) -> Mission:
    """Return a mission whose threats have those radii; where they stand does not matter."""
    return Mission.model_validate(
        {
            "agents": [
                {"id": k + 1, "north_m": -1000.0 * k, "east_m": 0.0, "heading_deg": 0.0} for k in range(agents)
            ],
            "targets": [{"id": 1, "north_m": 900_000.0, "east_m": 0.0, "speed_bound_m_s": 10.0}],
            "threats": [
                {
                    "id": k + 1, "north_m": 5e5, "east_m": 1e5 * k, "detection_radius_m": kind[0],
                    "attack_radius_m": kind[1], "speed_bound_m_s": speed_bound_m_s,
                }
                for k, kind in enumerate(kinds)
            ],
            "surrogate": surrogate,
        }
    )  # fmt: skip


@pytest.mark.slow
@given(
    surrogate=st.sampled_from(["pairwise", "analytic"]),
    kinds=st.lists(st.sampled_from(KINDS), min_size=1, max_size=4),
    peers=st.integers(0, 3),
    condition=st.sampled_from(NAMES),
    factors=st.lists(st.floats(1.0, 1.3), min_size=7, max_size=7),
    bearings=st.lists(st.floats(0.0, 0.4), min_size=7, max_size=7),
)
def test_farther_off_than_the_distances_the_gradient_is_within_b(
    surrogate: str,
    kinds: list[tuple[float, float]],
    peers: int,
    condition: str,
    factors: list[float],
    bearings: list[float],
) -> None:
    mission = crowd(surrogate, peers + 1, kinds)
    finding = finding_of(certify(mission, 1), condition)
    quiet_m = {(d.detection_radius_m, d.attack_radius_m): d.from_centre_m for d in finding.threat_distances}
    distances_m = [quiet_m[kind] for kind in kinds] + peers * [finding.peer_distance_m or 0.0]
    # All on much the same side, so that their contributions add up: the worst for the agent at the origin.
    places_ned_m = np.array(
        [
            (factor * distance_m * math.cos(bearing), factor * distance_m * math.sin(bearing))
            for distance_m, factor, bearing in zip(distances_m, factors, bearings, strict=False)
        ]
    )
    gradient_m = surrogate_gradient(
        profile_by_name(surrogate),
        np.vstack(([0.0, 0.0], places_ned_m[len(kinds) :])),
        ThreatDiscs(
            places_ned_m[: len(kinds)],
            np.array([kind[0] for kind in kinds]),
            np.array([kind[1] for kind in kinds]),
        ),
        mission.separation_m,
        Weights(),
    )[0]
    assert float(np.hypot(*gradient_m)) <= finding.b_m * (1.0 + 1e-9)


@pytest.mark.parametrize("surrogate", ["pairwise", "analytic"])
def test_the_distances_are_not_merely_safe(surrogate: str) -> None:
    kinds = 4 * [KINDS[0]]
    finding = finding_of(certify(crowd(surrogate, 1, kinds), 1), "tight")
    (distance,) = finding.threat_distances
    gradient_m = surrogate_gradient(
        profile_by_name(surrogate),
        np.zeros((1, 2)),
        ThreatDiscs(np.array(4 * [[distance.from_centre_m - 10.0, 0.0]]), np.full(4, 1e4), np.full(4, 5e3)),
        100.0,
        Weights(),
    )[0]
    assert float(np.hypot(*gradient_m)) > finding.b_m
    assert distance.threats == 4
    assert distance.from_edge_m == pytest.approx(distance.from_centre_m - 1e4)


@pytest.mark.parametrize("bearing", np.linspace(0.0, math.tau, 9))
def test_the_distance_as_heard_allows_for_a_disc_grown_and_displaced(bearing: float) -> None:
    mission = crowd("pairwise", 1, [KINDS[0]], speed_bound_m_s=10.0)
    finding = finding_of(certify(mission, 1), "tight")
    (distance,) = finding.threat_distances
    late_m = 10.0 * 5.1  # a broadcast period and the link's delay
    unit_m = 27.65  # 900 km and 600 s at 10 m/s / 32 767, in whole cm
    off_m = late_m + unit_m * math.sqrt(0.5)
    assert finding.left_b_m == pytest.approx(finding.b_m - off_m * math.sqrt(0.5))
    assert distance.as_heard_m is not None
    heard_ned_m = [distance.as_heard_m + off_m * math.cos(bearing), off_m * math.sin(bearing)]
    gradient_m = surrogate_gradient(
        profile_by_name("pairwise"),
        np.zeros((1, 2)),
        ThreatDiscs(np.array([heard_ned_m]), np.array([1e4 + off_m + unit_m]), np.array([5e3 + off_m + unit_m])),
        100.0,
        Weights(),
    )[0]
    assert float(np.hypot(*gradient_m)) <= (finding.left_b_m or 0.0) * (1.0 + 1e-12)
    assert distance.as_heard_m > distance.from_centre_m + off_m
    assert finding_of(certify(mission, 1), "printed").threat_distances[0].as_heard_m is None


def test_each_bound_is_stated_at_half_of_its_largest_b_unless_one_is_asked_for() -> None:
    for finding in certificate_of().groups[0].findings:
        assert finding.holds
        assert finding.b_m == finding.largest_b_m / 2.0
    held = {finding.condition: finding.holds for finding in certificate_of(b_m=5.0).groups[0].findings}
    assert held == {"printed": False, "corrected": False, "sharp": True, "tight": True}
    assert finding_of(certificate_of(b_m=5.0), "printed").why_not == "b = 5 m is not below 4.06851 m"


@pytest.mark.parametrize("condition", NAMES)
def test_a_b_just_below_the_largest_gives_a_bound_or_none_but_never_a_false_one(condition: str) -> None:
    b_m = finding_of(certificate_of(), condition).largest_b_m
    for _ in range(5):
        b_m = math.nextafter(b_m, 0.0)
        certificate = certificate_of(b_m=b_m)
        finding = finding_of(certificate, condition)
        assert finding.holds == (finding.decrease is not None and finding.decrease > 0.0)
        assert finding.holds == (certificate.agents[0].steps[condition] is not None)


def test_what_does_not_hold_is_given_no_numbers() -> None:
    certificate = certificate_of(b_m=5.0)
    printed = finding_of(certificate, "printed")
    assert (printed.decrease, printed.peer_distance_m, printed.turn_needed_deg, printed.bend_deg) == (None,) * 4
    assert printed.threat_distances == ()
    assert certificate.agents[0].steps["printed"] is None
    assert certificate.agents[0].line_clear["printed"] is None


def test_a_target_as_fast_as_the_agent_leaves_nothing_to_promise() -> None:
    certificate = certificate_of(targets=[{"id": 1, "north_m": 6e4, "east_m": 0.0, "speed_bound_m_s": 60.0}])
    assert not certificate.certified
    for finding in certificate.groups[0].findings:
        assert finding.largest_b_m == 0.0
        assert finding.why_not == "no b satisfies it at delta/v = 1"
    assert assumption_of(certificate, "v > sqrt(2) delta").holds is False
    assert certificate.exclusion == "No bound holds: nothing is promised."


def test_a_step_longer_than_the_arrival_radius_leaves_only_the_tight_bound() -> None:
    certificate = certificate_of(guidance_step_s=5.0, arrival_radius_m=200.0)
    assert [finding.holds for finding in certificate.groups[0].findings] == [False, False, False, True]
    assert "ends within v = 300 m" in str(finding_of(certificate, "printed").why_not)
    assert assumption_of(certificate, "v <= arrival radius").holds is False
    assert certificate.certified


def test_agents_of_different_speeds_have_certificates_of_their_own() -> None:
    agents = [
        {"id": k, "north_m": 0.0, "east_m": 1000.0 * k, "heading_deg": 0.0, "speed_m_s": speed_m_s}
        for k, speed_m_s in ((1, 60.0), (2, 11.0), (3, 60.0))
    ]
    certificate = certificate_of(agents=agents)
    assert [(group.speed_m_s, group.agents) for group in certificate.groups] == [(11.0, (2,)), (60.0, (1, 3))]
    assert not finding_of(certificate, "corrected", 0).holds
    assert finding_of(certificate, "corrected", 1).holds
    steps = {bound.agent: bound.steps["tight"] for bound in certificate.agents}
    assert (steps[2] or 0) > 10 * (steps[1] or 0) > 0


def test_one_speed_without_a_bound_spoils_the_certificate() -> None:
    agents = [
        {"id": k, "north_m": 0.0, "east_m": 1000.0 * k, "heading_deg": 0.0, "speed_m_s": speed_m_s}
        for k, speed_m_s in ((1, 60.0), (2, 9.0))
    ]
    assert not certificate_of(agents=agents).certified


def test_agents_alone_in_the_plane_are_covered_everywhere() -> None:
    certificate = certificate_of(threats=[])
    assert certificate.corollary.component_bound_m == 0.0
    for finding in certificate.groups[0].findings:
        assert finding.weights_suffice
        assert finding.threat_distances == ()
    assert all(certificate.agents[0].line_clear.values())
    assert assumption_of(certificate, "threats known").holds is True


def test_where_the_weights_suffice_no_distance_is_needed() -> None:
    certificate = certificate_of(weights={"k_d": 1.0, "k_a": 1.0, "k_c": 1.0})
    tight = finding_of(certificate, "tight")
    assert tight.weights_suffice
    assert tight.threat_distances[0].from_centre_m == 0.0


def test_the_corollary_counts_every_threat_and_peer_once_for_both_radii_and_pairs() -> None:
    certificate = certify(crowd("analytic", 3, [KINDS[0], KINDS[1]]), 1)
    steepest = 0.25 * 80.0
    threats = 1e11 / 1e4 + 1e11 / 5e3 + 1e11 / 6e3 + 1e11 / 1e3
    assert certificate.corollary.component_bound_m == pytest.approx(steepest * (threats + 2 * 2 * 1e10 / 100.0))
    assert certificate.corollary.weight_sum == 80.0


def test_the_line_is_clear_if_it_keeps_the_distance_at_the_start() -> None:
    clear = certificate_of().agents[0].line_clear
    assert clear == dict.fromkeys(NAMES, True)
    tight_m = finding_of(certificate_of(), "tight").threat_distances[0].from_centre_m
    printed_m = finding_of(certificate_of(), "printed").threat_distances[0].from_centre_m
    threat = {"id": 1, "north_m": 30_000.0, "east_m": (tight_m + printed_m) / 2, "detection_radius_m": 1e4}
    clear = certificate_of(threats=[{**threat, "attack_radius_m": 5e3}]).agents[0].line_clear
    assert clear["tight"] is True
    assert clear["printed"] is False
    # Behind the agent a threat is as far from the line as from the agent.
    threat = {"id": 1, "north_m": -tight_m - 1.0, "east_m": 0.0, "detection_radius_m": 1e4, "attack_radius_m": 5e3}
    assert certificate_of(threats=[threat]).agents[0].line_clear["tight"] is True


def test_each_agent_is_told_of_its_nearest_and_its_farthest_target() -> None:
    targets = [{"id": k, "north_m": 1e4 * k, "east_m": 0.0} for k in (3, 1, 2)]
    agents = [{"id": k, "north_m": 0.0, "east_m": 200.0 * k, "heading_deg": 0.0} for k in (1, 2, 3)]
    bounds = certificate_of(targets=targets, agents=agents, threats=[]).agents
    assert [(b.agent, b.which, b.target) for b in bounds[:2]] == [(1, "nearest", 1), (1, "farthest", 3)]
    assert bounds[1].distance_m == pytest.approx(math.hypot(3e4, 200.0))
    assert bounds[1].steps["tight"] == math.ceil((bounds[1].distance_m - 300.0) / (finding_of(
        certificate_of(targets=targets, agents=agents, threats=[]), "tight").decrease or 0.0))  # fmt: skip


def test_an_agent_that_starts_at_its_target_needs_no_step() -> None:
    bound = certificate_of(targets=[{"id": 1, "north_m": 0.0, "east_m": 0.0}]).agents[0]
    assert set(bound.steps.values()) == {0}


def test_a_fixed_assignment_is_only_sure_with_one_target() -> None:
    assert assumption_of(certificate_of(), "fixed assignment").holds is True
    dynamic = certify(resolve(load_mission("paper-dynamic"), 1), 1)
    assert assumption_of(dynamic, "fixed assignment").holds is None
    assert "every 25 s (50 steps)" in assumption_of(dynamic, "fixed assignment").text


def test_a_turn_limit_of_half_a_circle_never_binds_and_a_small_one_is_to_be_checked() -> None:
    assert "never binds" in assumption_of(certificate_of(guidance_step_s=5.0), "turn limit").text
    agent = {"id": 1, "north_m": 0.0, "east_m": 0.0, "heading_deg": 0.0}
    slow = assumption_of(certificate_of(agents=[{**agent, "n_max": 0.01}]), "turn limit")
    assert slow.holds is None
    assert "to be checked along the run" in slow.text
    gentle = assumption_of(certificate_of(b_m=1e-3, agents=[{**agent, "n_max": 0.5}]), "turn limit")
    assert gentle.holds is True
    assert "at most 77 steps, not counted" in gentle.text


def test_targets_heard_late_use_up_a_part_of_b() -> None:
    late = assumption_of(certificate_of(), "targets known")
    assert late.holds is False
    assert "off by up to 52.43 m" in late.text  # 5.1 s at 10 m/s, and 2.02 m of rounding / sqrt(2)
    assert late.voids == ("as printed", "corrected", "sharp")
    left_m = [finding.left_b_m for finding in certificate_of().groups[0].findings]
    assert left_m == [0.0, 0.0, 0.0, pytest.approx(103.58 - 52.43 / math.sqrt(2.0), abs=0.05)]


def test_what_the_targets_error_leaves_is_left_in_the_worst_case_too() -> None:
    finding = finding_of(certificate_of(), "tight")
    left_m = finding.left_b_m or 0.0
    assert math.sqrt(2.0) * left_m + 51.0 + 2.02 * math.sqrt(0.5) == pytest.approx(math.sqrt(2.0) * finding.b_m)


def test_targets_that_stand_still_are_rounded_by_the_broadcast() -> None:
    still = [{"id": 1, "north_m": 6e4, "east_m": 0.0, "speed_bound_m_s": 0.0}]
    near = assumption_of(certificate_of(targets=still), "targets known")
    assert (near.holds, near.voids) == (True, ())
    assert "rounded to 1.9 m" in near.text
    far = [{"id": 1, "north_m": 2e5, "east_m": 0.0, "speed_bound_m_s": 0.0}]
    certificate = certificate_of(targets=far)
    assert assumption_of(certificate, "targets known").voids == ("as printed", "corrected")
    assert assumption_of(certificate, "targets known").holds is False
    assert finding_of(certificate, "sharp").left_b_m == pytest.approx(finding_of(certificate, "sharp").b_m - 6.17 / 2)


def test_wind_is_against_the_assumptions() -> None:
    assert assumption_of(certificate_of(), "nothing else").holds is None
    windy = assumption_of(certificate_of(wind={"speed_m_s": 5.0}), "nothing else")
    assert windy.holds is False
    assert windy.voids == ("as printed", "corrected", "sharp", "tight")
    assert assumption_of(certificate_of(wind={"gust_m_s": 1.0}), "nothing else").holds is False


def test_it_says_that_bound_and_avoidance_exclude_each_other() -> None:
    certificate = certificate_of()
    assert "the bound and the avoidance exclude each other" in certificate.exclusion
    # The nearest edge is 40 km from the target: sqrt(2) 104 m against an attraction of 40 km.
    bend_deg = finding_of(certificate, "tight").bend_deg or 0.0
    assert bend_deg == pytest.approx(math.degrees(146.5 / 40_000.0), rel=1e-2)
    inside = certificate_of(targets=[{"id": 1, "north_m": 30_000.0, "east_m": 34_000.0}])
    assert "a target lies inside a detection disc" in inside.exclusion
    assert finding_of(inside, "tight").bend_deg is None


@pytest.mark.parametrize(("weight", "suffices"), [(1e-3, True), (1e3, False)])
def test_the_network_of_all_positions_is_judged_by_its_weights_alone(
    weight: float, suffices: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    network = MonolithicNetwork(
        agents=10, threats=4, area_m=2e5, target_low_m2=0.0, target_high_m2=2e5, input_weight=np.ones((1, 28)),
        input_bias=np.zeros(1), output_weight=np.array([weight]), output_bias=0.0,
    )  # fmt: skip
    monkeypatch.setattr("companion.surrogate.certificates.load_monolithic", lambda: network)
    certificate = certify(resolve(load_mission("paper-static"), 1).model_copy(update={"surrogate": "monolithic"}), 1)
    assert certificate.corollary.weight_sum is None
    assert certificate.corollary.component_bound_m == pytest.approx(0.25 * weight)
    for finding in certificate.groups[0].findings:
        assert finding.holds
        assert finding.threat_distances == ()
        assert finding.peer_distance_m is None
        assert finding.weights_suffice is finding.somewhere is suffices
        assert certificate.agents[0].line_clear[finding.condition] is (True if suffices else None)
        assert (certificate.agents[0].steps[finding.condition] is not None) is suffices
    assert certificate.certified is suffices
    assert ("Nothing is certified anywhere" in certificate.exclusion) is not suffices


def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    """Run `companion certify` in this process; return exit status, output and errors."""
    monkeypatch.setattr(sys, "argv", ["companion", "certify", *arguments])
    with pytest.raises(SystemExit) as stopped:
        main()
    out, err = capsys.readouterr()
    assert isinstance(stopped.value.code, int)
    return stopped.value.code, out, err


def written(folder: Path, **changes: object) -> str:
    path = folder / "mission.yaml"
    path.write_text(yaml.safe_dump(small(**changes)))
    return str(path)


@pytest.mark.parametrize("mission", packaged_missions())
def test_every_packaged_mission_has_a_certificate(
    mission: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = run(monkeypatch, capsys, mission)
    assert (status, err) == (0, "")
    for words in ("as printed", "corrected", "sharp", "tight", "largest b", "holds beyond, from the centre (R_d "):
        assert words in out
    assert "holds beyond, from another agent" in out
    assert max(len(line) for line in out.splitlines() if line[:1] not in "┏┃┡│└") <= 120
    for words in ("Assumptions", "fixed assignment", "turn limit", "exclude each other", "the corollary asks"):
        assert words in " ".join(out.split())
    assert "nan" not in out.lower()


def test_the_json_holds_what_the_tables_show(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = run(monkeypatch, capsys, "paper-dynamic", "--seed", "4", "--json")
    assert (status, err) == (0, "")
    content = json.loads(out)
    assert list(content) == [
        "mission", "seed", "surrogate", "guidance_step_s", "arrival_radius_m", "sources", "groups", "corollary",
        "assumptions", "agents", "exclusion", "certified",
    ]  # fmt: skip
    assert (content["mission"], content["seed"], content["certified"]) == ("paper-dynamic", 4, True)
    assert content["sources"] == 4 + 9
    (group,) = content["groups"]
    assert (group["step_m"], group["target_step_m"]) == (30.0, 5.0)
    assert [finding["condition"] for finding in group["findings"]] == NAMES
    assert list(group["findings"][0]) == [
        "condition", "title", "source", "largest_b_m", "b_m", "holds", "why_not", "left_b_m", "decrease",
        "decrease_unit", "weights_suffice", "somewhere", "threat_distances", "peer_distance_m", "turn_needed_deg",
        "bend_deg",
    ]  # fmt: skip
    assert {finding["source"] for finding in group["findings"]} == {"paper: thm_2, thm_2_1", "docs/convergence.md"}
    assert len(content["agents"]) == 20
    assert list(content["agents"][0]["steps"]) == NAMES


def test_another_seed_draws_another_mission_and_the_same_seed_the_same(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    first, again, other = (run(monkeypatch, capsys, "paper-static", "--seed", seed)[1] for seed in ("1", "1", "2"))
    assert first == again != other


def test_without_any_bound_the_status_is_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    fast = written(tmp_path, targets=[{"id": 1, "north_m": 6e4, "east_m": 0.0, "speed_bound_m_s": 60.0}])
    for arguments in ((fast,), (fast, "--json"), ("paper-dynamic", "--b", "300")):
        status, out, err = run(monkeypatch, capsys, *arguments)
        assert (status, err) == (1, "")
        assert out
    status, out, _ = run(monkeypatch, capsys, fast)
    assert "tight does not hold: no b satisfies it" in out
    assert out.endswith("No bound holds: nothing is promised.\n")
    assert cells_of(out, "largest b") == cells_of(out, "stated at b") == 4 * ["-"]


def cells_of(out: str, label: str) -> list[str]:
    """Return the figures of the first row of that label."""
    row = next(line for line in out.splitlines() if line.strip("│ ").startswith(label))
    return [cell.strip() for cell in row.strip("│").split("│")[1:]]


def test_bounds_void_in_flight_are_named_above_their_steps(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, _ = run(monkeypatch, capsys, "paper-dynamic")
    assert status == 0
    assert cells_of(out, "condition satisfied") == 4 * ["yes"]
    assert cells_of(out, "left of b after late targets")[:3] == 3 * ["0"]
    note = "Void in flight: as printed, corrected, sharp. Their steps hold only with targets known at every step"
    _, below = " ".join(out.split()).split(note)
    assert below.startswith(", as the theorem assumes. ┏")
    assert "6 891 782" in below


def test_a_network_that_is_quiet_nowhere_is_given_no_steps(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    status, out, _ = run(monkeypatch, capsys, written(tmp_path, surrogate="monolithic"))
    assert status == 1
    assert cells_of(out, "holds beyond") == 4 * ["nowhere known"]
    assert cells_of(out, "1 ") == ["1, only", "60000", *(5 * ["-"])]
    assert "Void in flight" not in out


def test_an_agent_alone_and_the_analytic_profile_are_told_in_their_own_words(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    alone = run(monkeypatch, capsys, written(tmp_path, threats=[]))[1]
    assert cells_of(alone, "holds beyond") == 4 * ["everywhere"]
    assert "the corollary asks" not in alone
    assert "no threats and no other agents: F* is zero" in alone
    analytic = run(monkeypatch, capsys, written(tmp_path, surrogate="analytic"))[1]
    assert "The profile's steepness alone allows" in analytic
    assert "network's weights" not in analytic
    assert cells_of(analytic, "1 ")[0] == "1, only"
    asked = run(monkeypatch, capsys, written(tmp_path), "--b", "1")[1]
    assert "(sqrt(2) b, 1.41 m)" in " ".join(asked.split())


@pytest.mark.parametrize("seed", range(1, 7))
def test_the_page_is_right_about_how_little_f_turns_the_path(seed: int) -> None:
    certificate = certify(resolve(load_mission("paper-dynamic"), seed), seed)
    assert max(finding.bend_deg or 0.0 for finding in certificate.groups[0].findings) < 1.0
    assert certificate.corollary.component_bound_m > 1e8 * max(f.b_m for f in certificate.groups[0].findings)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["paper-dynamics"], "did you mean 'paper-dynamic'"),
        (["paper-dynamic", "--b", "0"], "--b: 0; allowed: a positive number of metres"),
        (["paper-dynamic", "--b", "-1"], "--b: -1; allowed"),
        (["paper-dynamic", "--b", "nan"], "--b: nan; allowed"),
        (["paper-dynamic", "--b", "inf"], "--b: inf; allowed"),
        (["paper-dynamic", "--b", "much"], "'much'"),
        (["paper-dynamic", "--seed", "-1"], "--seed"),
        ([], "MISSION"),
    ],
)
def test_bad_input_ends_in_one_line_and_status_two(
    arguments: list[str], words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    status, out, err = run(monkeypatch, capsys, *arguments)
    assert (status, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1


def test_the_help_has_an_example(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert "Example: companion certify paper-dynamic" in run(monkeypatch, capsys, "--help")[1]


def test_several_speeds_and_radii_are_shown_each(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    mission = crowd("pairwise", 1, KINDS).model_dump(mode="json")
    agents = [
        {"id": k, "north_m": 0.0, "east_m": 1000.0 * k, "heading_deg": 0.0, "speed_m_s": 30.0 * k} for k in (1, 2)
    ]
    status, out, _ = run(monkeypatch, capsys, written(tmp_path, agents=agents, threats=mission["threats"], weights={}))
    assert status == 0
    assert "agents at 30 m/s: 1" in out
    assert "agents at 60 m/s: 1" in out
    for detection_m, attack_m in KINDS:
        assert out.count(f"from the centre (R_d {detection_m:g}, R_a {attack_m:g}; 1 threat)") == 2


def test_the_page_shows_the_numbers_of_the_packaged_mission() -> None:
    page = (Path(__file__).parents[3] / "docs" / "convergence.md").read_text()
    certificate = certify(resolve(load_mission("paper-dynamic"), 1), 1)
    findings = certificate.groups[0].findings
    rows = [
        ("largest b", [f"{finding.largest_b_m:.4g} m" for finding in findings]),
        ("stated at", [f"{finding.b_m:.4g} m" for finding in findings]),
        ("holds from the edge", [f"{finding.threat_distances[0].from_edge_m:.0f} m" for finding in findings]),
        ("steps from 55.6 km", [f"{certificate.agents[0].steps[name]}" for name in NAMES]),
    ]
    last_table = page[page.index("On `paper-dynamic`") :]
    for label, cells in rows:
        line = next(line for line in last_table.splitlines() if line.startswith(f"| {label}"))
        assert [cell.strip().replace(" ", "") for cell in line.split("|")[2:-1]] == [c.replace(" ", "") for c in cells]
