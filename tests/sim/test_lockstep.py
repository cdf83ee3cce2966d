"""Closed-loop behaviour of the whole system over frames: scenario tables, and that nothing passes beside the wire."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from companion.errors import InputError
from companion.mission.model import Mission, parse_mission
from companion.mission.resolve import resolve
from companion.onboard.companion import Companion
from companion.onboard.decision import Decision, Purpose
from companion.protocol.codec import AgentEntry, Directive, FrameReader, FrameWriter, StateFrame
from sim.lockstep import Flight, FlightOptions, fly
from sim.score import Score, score

BASE = """
name: small
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}]
targets: [{id: 1, north_m: 12000, east_m: 0}]
threats: []
defaults:
  target: {speed_bound_m_s: 0}
  threat: {detection_radius_m: 1500, attack_radius_m: 700, speed_bound_m_s: 0}
max_time_s: 600
"""


def mission_of(changes: str = "") -> Mission:
    lines = [line for line in BASE.strip().splitlines() if line.split(":")[0] not in _keys(changes)]
    return resolve(parse_mission("\n".join([*lines, changes]), "test"), seed=1)


def _keys(text: str) -> set[str]:
    return {line.split(":")[0] for line in text.splitlines() if line and not line.startswith(" ")}


def all_reached(flight: Flight, scored: Score) -> bool:
    return scored.targets_reached == scored.targets


def all_arrived(flight: Flight, scored: Score) -> bool:
    return scored.arrived == len(scored.per_agent)


def places_apart(flight: Flight, scored: Score) -> bool:
    settled = flight.trajectory.t_s >= 260.0
    first, second = (flight.trajectory.agents_ned_m[settled, index].mean(axis=0) for index in (0, 1))
    return float(np.hypot(*(first - second))) >= 200.0


def none_reached(flight: Flight, scored: Score) -> bool:
    return scored.targets_reached == 0


def no_entry(flight: Flight, scored: Score) -> bool:
    return scored.threat_entries_detection == 0 and scored.worst_depth_m == 0.0


def enters_detection(flight: Flight, scored: Score) -> bool:
    return scored.threat_entries_detection > 0


def depth_below_a_step(flight: Flight, scored: Score) -> bool:
    return scored.worst_depth_m < 30.0


def stays_out_of_attack(flight: Flight, scored: Score) -> bool:
    return scored.threat_entries_attack == 0


def nearly_straight(flight: Flight, scored: Score) -> bool:
    return all(agent.path_to_end_m <= 1.02 * agent.shortest_path_m for agent in scored.per_agent)


def no_breach(flight: Flight, scored: Score) -> bool:
    return scored.separation_breaches == 0


def agent_one_stopped_where_lost(flight: Flight, scored: Score) -> bool:
    after = flight.trajectory.agents_ned_m[flight.trajectory.t_s >= 60.0, 0]
    return bool(np.all(after == after[0]))


def never_left(flight: Flight, scored: Score) -> bool:
    apart_m = np.hypot(*np.moveaxis(flight.trajectory.agents_ned_m - flight.trajectory.agents_ned_m[0], 2, 0))
    return float(np.max(apart_m)) < 500.0


def agent_one_never_left(flight: Flight, scored: Score) -> bool:
    track = flight.trajectory.agents_ned_m[:, 0]
    return float(np.max(np.hypot(*(track - track[0]).T))) < 500.0


def went_far(flight: Flight, scored: Score) -> bool:
    track = flight.trajectory.agents_ned_m[:, 0]
    return float(np.max(np.hypot(*(track - track[0]).T))) > 3_000.0


def home_within_range(flight: Flight, scored: Score) -> bool:
    """Return whether the agent came back from afar before it had flown FLEEING_RANGE_M, and stayed."""
    track = flight.trajectory.agents_ned_m[:, 0]
    flown_m = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(track, axis=0).T))))
    home_m = np.hypot(*(track - track[0]).T)
    farthest = int(np.argmax(home_m))
    home = farthest + np.flatnonzero(home_m[farthest:] <= 300.0)
    return len(home) > 0 and flown_m[home[0]] <= FLEEING_RANGE_M and float(np.max(home_m[home[0] :])) < 500.0


Check = Callable[[Flight, Score], bool]
FLEEING_RANGE_M = 14_000.0
FLEEING = (
    f"agents: [{{id: 1, north_m: 0, east_m: 0, heading_deg: 0, range_m: {FLEEING_RANGE_M}}}]\n"
    "targets: [{id: 1, north_m: 5000, east_m: 0, speed_bound_m_s: 40, motion: {heading_deg: 0, speed_m_s: 40}}]\n"
    "max_time_s: 300"
)
"""A target that keeps out of reach: it is sent for, and then too far for the way there and back."""
DISC_AHEAD = "threats: [{id: 1, north_m: 6000, east_m: 300}]"
SCENARIOS: list[tuple[str, str, dict[str, Any], list[Check]]] = [
    ("with nothing in the way the path is straight", "", {}, [all_reached, nearly_straight]),
    ("the surrogate bends the path around a disc ahead", DISC_AHEAD, {}, [all_reached, no_entry]),
    (
        "the polygon's gradient begins at the edge: it grazes R_d by less than a step",
        DISC_AHEAD,
        {"law": "ramp"},
        [all_reached, depth_below_a_step, stays_out_of_attack],
    ),
    (
        "the gradient of F is nothing and goes through R_d, but the guard keeps out of R_a",
        DISC_AHEAD,
        {"law": "step"},
        [enters_detection, stays_out_of_attack],
    ),
    (
        "a threat that drifts across the path is avoided",
        "threats: [{id: 1, north_m: 6000, east_m: -1500, speed_bound_m_s: 10, "
        "motion: {heading_deg: 90, speed_m_s: 10}}]",
        {},
        [all_reached, no_entry],
    ),
    (
        "a moving target is reached where it is, not where it was",
        "targets: [{id: 1, north_m: 9000, east_m: 0, speed_bound_m_s: 15, motion: {heading_deg: 90, speed_m_s: 15}}]",
        {},
        [all_reached],
    ),
    (
        "a guidance step longer than the autopilot's patience is flown straight",
        # Its first decision is the first after a picture.
        "guidance_step_s: 5\nlink: {delay_s: 0}",
        {},
        [all_reached, nearly_straight],
    ),
    (
        "half of the frames lost changes little",
        DISC_AHEAD + "\nlink: {loss: 0.5, jitter_s: 1.0, duplicate: 0.3, reorder: 0.3}",
        {},
        [all_reached, no_entry],
    ),
    (
        "the targets of a lost agent go to the others",
        "agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}, {id: 2, north_m: 0, east_m: 4000, heading_deg: 0}]\n"
        "targets: [{id: 1, north_m: 12000, east_m: 0}]\nlosses: [{agent: 1, t_s: 60}]",
        {},
        [all_reached, agent_one_stopped_where_lost],
    ),
    (
        "two agents that arrive together from opposite sides loiter apart",
        "agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}, "
        "{id: 2, north_m: 24000, east_m: 0, heading_deg: 180}, {id: 3, north_m: 0, east_m: 30000, heading_deg: 0}]\n"
        "targets: [{id: 1, north_m: 12000, east_m: 0}, {id: 2, north_m: 20000, east_m: 30000}]",
        {},
        [all_reached, all_arrived, no_breach],
    ),
    (
        "two agents that arrive together side by side loiter about places two separations apart",
        "agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}, "
        "{id: 2, north_m: 1607.7, east_m: -6000, heading_deg: 30}, "
        "{id: 3, north_m: 0, east_m: 30000, heading_deg: 0}]\n"
        "targets: [{id: 1, north_m: 12000, east_m: 0}, {id: 2, north_m: 20000, east_m: 30000}]",
        {},
        [all_reached, all_arrived, no_breach, places_apart],
    ),
    (
        "a cross wind is crabbed against and hardly bends the path",
        "wind: {from_deg: 90, speed_m_s: 15, gust_m_s: 5}",
        {},
        [all_reached, nearly_straight],
    ),
    ("gusts blow nobody into a disc", DISC_AHEAD + "\nwind: {speed_m_s: 5, gust_m_s: 10}", {}, [all_reached, no_entry]),
    (
        "an agent is not sent where its range does not reach and back",
        "agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0, range_m: 13000}]\nmax_time_s: 300",
        {},
        [none_reached, never_left],
    ),
    (
        "under the policy to arrive it is sent where it can arrive",
        "agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0, range_m: 13000}]\nrange_policy: arrive",
        {},
        [all_reached],
    ),
    (
        "a target out of the range of the nearest agent is another's",
        "agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0, range_m: 13000}, "
        "{id: 2, north_m: 0, east_m: 6000, heading_deg: 0}, {id: 3, north_m: 0, east_m: 9000, heading_deg: 0}]",
        {},
        [all_reached, agent_one_never_left],
    ),
    (
        "an agent whose target flees beyond its range turns home while its range still reaches",
        FLEEING + "\nassignment_period_s: 1000",
        {},
        [none_reached, went_far, home_within_range],
    ),
    (
        "an agent whose target is taken from it, being out of range, comes home in time as well",
        FLEEING,
        {},
        [none_reached, went_far, home_within_range],
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("title", "changes", "options", "checks"), SCENARIOS, ids=[row[0] for row in SCENARIOS])
def test_scenario(title: str, changes: str, options: dict[str, Any], checks: list[Check]) -> None:
    mission = mission_of(changes)
    flight = fly(mission, 1, FlightOptions(**options))
    scored = score(flight.trajectory, mission)
    for check in checks:
        assert check(flight, scored), f"{title}: {check.__name__}: {scored}"


@pytest.mark.slow
def test_the_same_seed_gives_the_same_trajectory_bit_for_bit() -> None:
    mission = mission_of(
        "targets: [{id: 1, north_m: 12000, east_m: 0, speed_bound_m_s: 10, motion: random}]\n"
        "link: {loss: 0.3, jitter_s: 2.0, reorder: 0.2}"
    )
    first, second, other = (fly(mission, seed).trajectory for seed in (7, 7, 8))
    assert np.array_equal(first.agents_ned_m, second.agents_ned_m)
    assert np.array_equal(first.targets_ned_m, second.targets_ned_m)
    assert not np.array_equal(first.targets_ned_m[: len(other.t_s)], other.targets_ned_m[: len(first.t_s)])


def watched(monkeypatch: pytest.MonkeyPatch) -> list[Decision]:
    """Record every decision of every companion."""
    decisions: list[Decision] = []
    tick = Companion.tick

    def recording(companion: Companion, now_s: float) -> tuple[Decision, list[bytes]]:
        decision, frames = tick(companion, now_s)
        decisions.append(decision)
        return decision, frames

    monkeypatch.setattr(Companion, "tick", recording)
    return decisions


def test_companions_that_hear_nothing_have_no_picture_and_do_not_steer(monkeypatch: pytest.MonkeyPatch) -> None:
    decisions = watched(monkeypatch)
    flight = fly(mission_of("link: {loss: 1.0}\nmax_time_s: 300"), 1)
    assert {decision.purpose for decision in decisions} == {Purpose.IDLE}
    assert decisions[-1].reason == "no picture"
    assert all(companion.world_model.age_s(0.0) is None for companion in flight.companions.values())
    track = flight.trajectory.agents_ned_m[:, 0]
    assert float(np.max(np.hypot(*(track - track[0]).T))) < 500.0


def test_a_companion_believes_what_the_wire_says_and_nothing_else() -> None:
    reader, writer = FrameReader(), FrameWriter()

    def elsewhere(datagram: bytes, generator: np.random.Generator) -> bytes:
        frame = reader.read(datagram)[0]
        if not isinstance(frame, StateFrame):
            return datagram
        target = frame.targets[0]
        moved = type(target)(target.id, -12_000.0, 0.0)
        agents = tuple(AgentEntry(agent.id, agent.north_m, agent.east_m, target.id) for agent in frame.agents)
        return writer.encode(
            replace(frame, directive=Directive.NORMAL, picture_threats=0, agents=agents, targets=(moved,), threats=())
        )

    flight = fly(mission_of("max_time_s: 150"), 1, FlightOptions(tamper=elsewhere))
    assert flight.trajectory.agents_ned_m[-1, 0, 0] < -5_000.0


def test_damaged_frames_are_counted_and_leave_the_companion_blind_but_flying(monkeypatch: pytest.MonkeyPatch) -> None:
    def damaged(datagram: bytes, generator: np.random.Generator) -> bytes:
        data = bytearray(datagram)
        for _ in range(3):
            data[int(generator.integers(len(data)))] ^= int(generator.integers(1, 256))
        return bytes(data)

    decisions = watched(monkeypatch)
    flight = fly(mission_of("max_time_s: 200"), 1, FlightOptions(tamper=damaged))
    (companion,) = flight.companions.values()
    assert companion.authenticator.rejected.total() > 20
    assert companion.authenticator.state.epoch_s is None
    assert {decision.reason for decision in decisions} == {"no picture"}


@pytest.mark.slow
def test_dropped_frames_make_the_picture_older(monkeypatch: pytest.MonkeyPatch) -> None:
    ages = []
    for loss in (0.0, 0.7):
        decisions = watched(monkeypatch)
        fly(mission_of(f"max_time_s: 200\nlink: {{loss: {loss}}}"), 1)
        ages.append(max(decision.picture_age_s or 0.0 for decision in decisions))
        monkeypatch.undo()
    assert ages[0] < 6.0 < ages[1]


@pytest.mark.slow
def test_a_broadcast_that_ends_leads_through_the_named_stages_and_home(monkeypatch: pytest.MonkeyPatch) -> None:
    reader = FrameReader()

    def cut_after_a_minute(datagram: bytes, generator: np.random.Generator) -> bytes:
        frame = reader.read(datagram)[0]
        late = isinstance(frame, StateFrame) and frame.stamp.time_ms > 60_000
        return b"" if late else datagram

    decisions = watched(monkeypatch)
    flight = fly(
        mission_of("max_time_s: 600\ntargets: [{id: 1, north_m: 30000, east_m: 0}]"),
        1,
        FlightOptions(tamper=cut_after_a_minute),
    )
    stages = [stage for stage, _ in itertools.groupby(decision.stage.value for decision in decisions)]
    assert stages == ["loitering", "fresh", "coasting", "loitering", "returning"]
    track = flight.trajectory.agents_ned_m[:, 0]
    assert float(np.hypot(*(track[-1] - track[0]))) < 500.0


@pytest.mark.slow
def test_an_arrived_agent_loiters_where_it_arrived() -> None:
    mission = mission_of(
        "agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}, {id: 2, north_m: 0, east_m: 30000, heading_deg: 0}]\n"
        "targets: [{id: 1, north_m: 3000, east_m: 0}, {id: 2, north_m: 24000, east_m: 30000}]"
    )
    flight = fly(mission, 1)
    arrived_s = next(agent.arrived_t_s for agent in score(flight.trajectory, mission).per_agent if agent.id == 1)
    assert arrived_s is not None
    after = flight.trajectory.agents_ned_m[flight.trajectory.t_s > arrived_s + 10.0, 0]
    assert float(np.max(np.hypot(*(after - after[0]).T))) < 300.0
    assert math.isclose(float(flight.trajectory.agents_speed_m_s[-1, 0]), 60.0, abs_tol=0.01)


def flight_time_s(changes: str) -> float:
    mission = mission_of(changes)
    scored = score(fly(mission, 1).trajectory, mission)
    assert scored.targets_reached == 1
    return scored.flight_time_s


@pytest.mark.slow
def test_the_wind_pushes_the_flight() -> None:
    still_s = flight_time_s("")
    head_s, tail_s = (flight_time_s(f"wind: {{from_deg: {deg}, speed_m_s: 20}}") for deg in (0, 180))
    assert head_s == pytest.approx(still_s * 60.0 / 40.0, rel=0.05)
    assert tail_s == pytest.approx(still_s * 60.0 / 80.0, rel=0.05)


def test_gusts_follow_from_the_seed() -> None:
    mission = mission_of("wind: {gust_m_s: 10}\nmax_time_s: 30")
    first, second, other = (fly(mission, seed).trajectory.agents_ned_m for seed in (7, 7, 8))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)


MONOLITHIC = "surrogate: monolithic\nmax_time_s: 10"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            "wind: {speed_m_s: 45, gust_m_s: 15}",
            "small: wind: speed_m_s and gust_m_s together 60 m/s; allowed: less than",
        ),
        (MONOLITHIC, "small: surrogate: 'monolithic' is not flown: .*gradient is noise; allowed: pairwise, analytic"),
    ],
)
def test_what_is_not_flown_is_refused_instead_of_ignored(changes: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as caught:
        fly(mission_of(changes), 1)
    assert "\n" not in str(caught.value)


def test_a_wind_that_the_slowest_agent_can_hold_its_course_in_is_flown() -> None:
    assert fly(mission_of("wind: {speed_m_s: 45, gust_m_s: 14.9}\nmax_time_s: 10"), 1).steps == 20


def test_the_one_network_flies_when_it_is_allowed_to_and_steers_another_way() -> None:
    disc = DISC_AHEAD + "\n"
    first = fly(mission_of(disc + MONOLITHIC), 1, FlightOptions(allow_monolithic=True)).trajectory.agents_ned_m
    other = fly(mission_of(disc + "max_time_s: 10"), 1).trajectory.agents_ned_m
    assert first.shape == other.shape
    assert not np.array_equal(first, other)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ("agents: [{id: 1, north_m: 0, east_m: 0}, {id: 11, north_m: 500, east_m: 0}]", "agents.1..id: 11.*1 to 10"),
        ("threats: [{id: 5, north_m: 6000, east_m: 300}]", "threats.0..id: 5; allowed: 1 to 4"),
    ],
)
def test_the_one_network_flies_nobody_that_it_has_no_inputs_for(changes: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        fly(mission_of(f"{changes}\n{MONOLITHIC}"), 1, FlightOptions(allow_monolithic=True))


SLALOM = """
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0, n_max: 1}]
targets: [{id: 1, north_m: 17000, east_m: 0}]
threats:
  - {id: 1, north_m: 4500, east_m: 400}
  - {id: 2, north_m: 9000, east_m: -300}
  - {id: 3, north_m: 12800, east_m: 500}
"""


@pytest.mark.parametrize(("guidance_s", "integration_s"), [(5.0, 5.0), (5.0, 2.5), (10.0, 1.0), (10.0, 10.0)])
def test_a_setpoint_holds_for_the_whole_of_a_guidance_step_longer_than_the_autopilots_time_out(
    guidance_s: float, integration_s: float
) -> None:
    steps = f"guidance_step_s: {guidance_s}\nintegration_step_s: {integration_s}\n"
    mission = mission_of(SLALOM + steps)
    flight = fly(mission, 1, FlightOptions(law="routed", autopilot="kinematic"))
    scored = score(flight.trajectory, mission)
    assert scored.targets_reached == 1
    assert (scored.threat_entries_detection, scored.worst_depth_m) == (0, 0.0)
