"""What became of each agent, from its decisions and its path: six outcomes, and never one without a reason."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.mission.model import AgentSpec, Loss, Mission, TargetSpec, ThreatSpec
from companion.onboard.decision import Decision, Purpose
from companion.onboard.failsafe import OUT_OF_RANGE, UNCERTIFIED, Stage
from sim.agent_log import AgentLog, CertificateLoss
from sim.flown import FlownMission
from sim.outcome import AgentResult, agent_results, first_reason
from sim.score import score
from sim.trajectory import TrajectoryBuilder

FLYING = Decision(0.0, Purpose.TARGET, "assigned", Stage.FRESH, 0.5, target_id=1, certified_s=math.inf)
IDLE = Decision(0.0, Purpose.IDLE, "not ready", Stage.FRESH, 0.5)
LOITERING = Decision(0.0, Purpose.LOITER, "directive hold", Stage.FRESH, 0.5, certified_s=math.inf)


def flown(
    norths_m: list[float], *, ended_early: str | None = None, range_m: float = 9e5, lost: bool = False
) -> FlownMission:
    """Return a flight of one agent due north, past a threat, to a target at 1000 m; a sample a second."""
    mission = Mission(
        name="north",
        agents=(AgentSpec(id=1, north_m=0.0, east_m=0.0, heading_deg=0.0, speed_m_s=50.0, n_max=1.0, range_m=range_m),),
        targets=(TargetSpec(id=1, north_m=1_000.0, east_m=0.0, speed_bound_m_s=0.0),),
        threats=(ThreatSpec(id=7, north_m=100.0, east_m=60.0, detection_radius_m=50.0, attack_radius_m=20.0),),
        losses=(Loss(agent=1, t_s=1.0),) if lost else (),
        arrival_radius_m=100.0,
        integration_step_s=1.0,
        guidance_step_s=1.0,
    )
    builder = TrajectoryBuilder([1], [1], [7])
    for step, north_m in enumerate(norths_m):
        builder.append(float(step), [(north_m, 0.0, 0.0, 50.0)], [(1_000.0, 0.0, 0.0, 0.0)], [(100.0, 60.0, 0.0, 0.0)])
    trajectory = builder.build()
    return FlownMission(mission, trajectory, score(trajectory, mission), 1, "routed", ended_early=ended_early)


def became(flight: FlownMission, *decisions: Decision) -> AgentResult:
    log = AgentLog()
    for t_s, decision in enumerate(decisions):
        log.note(decision, float(t_s))
    (result,) = agent_results(flight, {1: log})
    return result


SHORT = flown([0.0, 50.0, 100.0])


@pytest.mark.parametrize(
    ("flight", "last", "line"),
    [
        (flown([0.0, 500.0, 950.0]), LOITERING, "agent 1: arrived: within 100 m of target 1"),
        (flown([0.0, 50.0], lost=True), FLYING, "agent 1: lost: at 1 s, as the mission says"),
        (SHORT, LOITERING, "agent 1: loitering: directive hold"),
        (
            SHORT,
            replace(LOITERING, purpose=Purpose.IDLE, reason="not armed"),
            "agent 1: loitering: not steered: not armed",
        ),
        (SHORT, replace(FLYING, purpose=Purpose.RETURN, reason="blind"), "agent 1: loitering: returning: blind"),
        (
            SHORT,
            replace(
                FLYING,
                purpose=Purpose.LOITER,
                reason="no way to the target",
                stay="no way to the target",
                note="walled in",
            ),
            "agent 1: blocked: no way to the target; walled in; target 1, 900 m away",
        ),
        (
            SHORT,
            replace(LOITERING, reason=UNCERTIFIED, triggers=(UNCERTIFIED,)),
            "agent 1: blocked: no certified back-up; target 1, 900 m away",
        ),
        (
            SHORT,
            replace(FLYING, purpose=Purpose.RETURN, reason=OUT_OF_RANGE, triggers=(OUT_OF_RANGE,)),
            "agent 1: out of range: range; 100 m flown of 900000 m",
        ),
        (
            flown([0.0, 50.0], range_m=1_500.0),
            replace(LOITERING, reason="no target"),
            "agent 1: out of range: no target; no open target is within its range of 1500 m",
        ),
        (
            SHORT,
            FLYING,
            "agent 1: out of time: on the way to target 1, 900 m away when the time was up, after 2 s; assigned",
        ),
        (
            flown([0.0, 400.0, 200.0], ended_early="interrupted (SIGINT)"),
            FLYING,
            "agent 1: out of time: on the way to target 1, 800 m away (the nearest was 600 m, at 1 s) when the flight "
            "was ended early: interrupted (SIGINT); assigned",
        ),
        (
            SHORT,
            replace(FLYING, guard_changes=("keep-out",)),
            "agent 1: out of time: on the way to target 1, 900 m away when the time was up, after 2 s; assigned; the "
            "guard changed 50 % of its decisions: keep-out",
        ),
    ],
)
def test_each_end_has_its_outcome_and_its_reason(flight: FlownMission, last: Decision, line: str) -> None:
    assert became(flight, FLYING, last).line() == line


decisions = st.builds(
    Decision,
    t_s=st.just(0.0),
    purpose=st.sampled_from(Purpose),
    reason=st.sampled_from(["", "assigned", "no target"]),
    stage=st.sampled_from(Stage),
    picture_age_s=st.sampled_from([None, 1.0]),
    target_id=st.sampled_from([None, 1]),
    stay=st.sampled_from([None, "no way to the target"]),
    note=st.sampled_from([None, "a note"]),
    triggers=st.sampled_from([(), (OUT_OF_RANGE,), (UNCERTIFIED,)]),
    broken=st.sampled_from([(), ("wind",), ("wind", "position")]),
    certified_s=st.sampled_from([0.0, 12.0, math.inf]),
)


@given(st.lists(decisions, max_size=6), st.sampled_from([None, "interrupted (SIGINT)"]))
def test_whatever_was_decided_there_is_a_reason_and_the_entry_is_json(told: list[Decision], early: str | None) -> None:
    flight = flown([0.0, 50.0, 100.0], ended_early=early)
    result = became(flight, *told)
    assert result.outcome != "arrived"
    assert result.reason.strip()
    entry = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert entry["certificate_at_start"]
    assert sum(one["count"] for one in entry["broken"]) == sum(len(decision.broken) for decision in told)
    assert first_reason(flight, [result]) == result.line()


def test_an_agent_that_made_no_decision_has_a_reason_too() -> None:
    (result,) = agent_results(SHORT, {})
    assert result.line().startswith("agent 1: out of time: the flight ended before its first decision")


def test_the_entry_holds_the_least_distances_with_their_times() -> None:
    entry = became(SHORT, FLYING).to_dict()
    assert entry["least_clearance_detection"] == {"m": pytest.approx(10.0), "threat": 7, "t_s": pytest.approx(2.0)}
    assert entry["least_clearance_attack"] == {"m": pytest.approx(40.0), "threat": 7, "t_s": pytest.approx(2.0)}
    assert entry["least_separation"] is None


def test_the_certificate_of_the_start_is_that_of_the_first_decision_that_steers_by_a_picture() -> None:
    blind = replace(LOITERING, picture_age_s=None, certified_s=0.0)
    assert became(SHORT, IDLE, blind, FLYING).to_dict()["certificate_at_start"] == "for ever"
    assert became(SHORT, IDLE).to_dict()["certificate_at_start"] == "none"


def test_the_loss_of_a_certificate_is_told_with_time_and_cause_and_only_the_first() -> None:
    until = replace(FLYING, certified_s=30.5, broken=("new threat",), guard_changes=("keep-out",))
    none = replace(FLYING, certified_s=0.0)
    log = became(SHORT, FLYING, FLYING, until, none).log
    assert log.loss == CertificateLoss(2.0, "until 30.5 s", "new threat; keep-out")


def test_a_certificate_until_some_time_that_runs_down_is_not_lost_before_it_is_none() -> None:
    running = [replace(FLYING, certified_s=certified_s) for certified_s in (30.0, 20.0, 10.0)]
    assert became(SHORT, *running).log.loss is None


def test_the_first_reason_is_that_of_an_agent_whose_target_is_still_open() -> None:
    waits, blocked = became(SHORT, LOITERING), became(SHORT, FLYING)
    assert first_reason(SHORT, [waits, blocked]) == blocked.line()


def test_where_every_agent_arrived_elsewhere_the_open_targets_are_named() -> None:
    assert first_reason(SHORT, []) == "target 1: not reached: every agent arrived elsewhere"
