"""What the lane of real programs measures, on paths and logs that are known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from pymavlink.dialects.v20 import common as mavlink

from companion.files.tlog import TlogWriter
from companion.geo.local_frame import LocalFrame
from companion.mission.model import dump_mission
from companion.onboard.config import load_config
from tests.real.config import write_config
from tests.real.flight import wind_parameters
from tests.real.kinds import KINDS
from tests.real.lane import Job, broken_bounds, jobs
from tests.real.scenarios import SCENARIOS
from tests.real.score import Figures, figures_of, longest_gap_s, setpoint_times_s, standing_from_s
from tests.real.truth import Sample, sample_of, trajectory_of

BEGIN_S = 1_700_000_000.0
PAGE = Path(__file__).parents[2] / "docs" / "real-autopilots.md"
CALM = next(scenario for scenario in SCENARIOS if scenario.name == "discs")
COPTER = KINDS["arducopter"]


@pytest.mark.parametrize("job", jobs(), ids=lambda job: job.name)
def test_every_scenario_is_a_legal_mission_with_a_legal_configuration(job: Job, tmp_path: Path) -> None:
    mission = job.scenario.mission(job.kind)
    write_config(tmp_path / "companion.yaml", job.kind, mission, (1, 0), job.scenario.config_of(job.kind, 1))
    (tmp_path / "keys").mkdir()
    config = load_config(str(tmp_path / "companion.yaml"))
    assert config.limits.speed_m_s == mission.agents[0].speed_m_s
    assert {target.id for target in mission.targets} == {agent.only_target for agent in mission.agents}


def test_standing_begins_after_the_last_time_it_was_quick_for_two_seconds() -> None:
    t_s = np.arange(0.0, 20.0, 0.1)
    speed_m_s = np.where((t_s < 5.0) | ((t_s > 6.0) & (t_s < 7.0)), 1.0, 0.1)
    assert standing_from_s(t_s, speed_m_s, 3.0) == pytest.approx(6.9)
    assert standing_from_s(t_s, np.full(len(t_s), 1.0), 3.0) is None


def test_a_gap_between_setpoints_counts_only_within_the_span() -> None:
    times_s = np.array([0.0, 5.0, 5.1, 5.4, 9.0])
    assert longest_gap_s(times_s, (4.0, 6.0)) == pytest.approx(0.3)
    assert longest_gap_s(times_s, (6.0, 8.0)) is None


def test_wind_from_the_north_blows_to_the_south_in_both_simulators() -> None:
    assert wind_parameters(KINDS["px4-plane"], 4.0, 0.0) == {"SIH_WIND_N": -4.0, "SIH_WIND_E": pytest.approx(0.0)}
    assert wind_parameters(COPTER, 4.0, 0.0) == {"SIM_WIND_SPD": 4.0, "SIM_WIND_DIR": 0.0}


def test_both_simulators_words_put_a_vehicle_at_the_same_place() -> None:
    frame = LocalFrame(-35.0, 149.0)
    lat_deg, lon_deg = frame.to_global(100.0, -50.0)
    e7 = (round(lat_deg * 1e7), round(lon_deg * 1e7))
    ardupilot = mavlink.MAVLink_sim_state_message(*[0.0] * 13, lat_deg, lon_deg, 600.0, 0, 0, 3.0, 4.0, 0.0, *e7)
    px4 = mavlink.MAVLink_hil_state_quaternion_message(0, [1, 0, 0, 0], 0, 0, 0, *e7, 600_000, 300, 400, *[0] * 6)
    for message in (ardupilot, px4):
        sample = sample_of(message, 1.0, frame)
        assert sample is not None
        assert sample == pytest.approx((1.0, 100.0, -50.0, 600.0, 3.0, 4.0), abs=0.02)
        assert sample.speed_m_s == pytest.approx(5.0)


def flown(folder: Path, *, drift_m_s: float = 0.0) -> Figures:
    """Write a flight straight to the target's place at 8 m/s, which then stands or drifts away, and score it."""
    mission = CALM.mission(COPTER)
    samples = []
    for t_s in np.arange(-1.0, 130.0, 0.05):
        north_m, v_m_s = (
            (8.0 * max(0.0, t_s - 2.0), 8.0) if t_s < 77.0 else (600.0 + drift_m_s * (t_s - 77.0), drift_m_s)
        )
        samples.append(Sample(BEGIN_S + t_s, min(north_m, 700.0), 0.0, 614.0, v_m_s, 0.0))
    (folder / "mission.yaml").write_text(dump_mission(mission))
    trajectory_of({1: samples}, mission, 1, BEGIN_S).write_csv(folder / "trajectory.csv")
    (folder / "logs-1" / "start").mkdir(parents=True)
    writer = TlogWriter(folder / "logs-1" / "start" / "vehicle-1.tlog")
    teller = mavlink.MAVLink(None, srcSystem=1, srcComponent=mavlink.MAV_COMP_ID_ONBOARD_COMPUTER)
    velocity = mavlink.MAVLink_set_position_target_local_ned_message(0, 1, 1, 1, 0x0DC7, *[0.0] * 11)
    for t_s in (2.0, 4.0, 4.1, 4.5):
        writer.write(BEGIN_S + t_s, bytes(velocity.pack(teller)))
    writer.close()
    (folder / "companion-1.log").write_text("1.0 companion: loiter\n")
    heights_m = [(seen.t_unix_s, 29.5 if seen.north_m else 30.5) for seen in samples]
    record = {
        "scenario": "discs", "kind": "arducopter", "begin_unix_s": BEGIN_S, "load": 1.0, "pause_s": 0.03,
        "notes": [(BEGIN_S, "ready"), (BEGIN_S + 2.0, "handed over"), (BEGIN_S + 129.0, "over")],
        "modes": {"1": [(BEGIN_S + 2.0, 4)]}, "heights_m": {"1": heights_m},
    }  # fmt: skip
    (folder / "flight.json").write_text(json.dumps(record))
    return figures_of(folder)


def test_a_flight_straight_through_discs_has_entries_as_deep_as_they_were(tmp_path: Path) -> None:
    figures = flown(tmp_path)
    # The path passes the standing disc of 70 m 20 m beside its middle, and the moving one of 50 m 45 m beside it.
    assert figures.entries == 2
    assert figures.deepest_m == pytest.approx(50.0, abs=0.1)
    assert "entries 2, at most 0" in broken_bounds(figures, Job(CALM, "arducopter"))


def test_a_vehicle_that_stands_at_its_target_holds_it(tmp_path: Path) -> None:
    agent = flown(tmp_path).agents[0]
    assert agent.arrived_s == pytest.approx(72.5, abs=0.1)
    assert agent.path_m == pytest.approx(580.0, abs=1.0)
    assert agent.stands_after_s == pytest.approx(2.5, abs=0.2)
    assert (agent.held_within_m, agent.off_target_m) == (0.0, 0.0)
    assert agent.farthest_after_arrival_m == pytest.approx(20.0, abs=0.5)
    assert agent.gap_s == pytest.approx(0.4)
    assert agent.height_m == (29.5, 30.5)


def test_a_vehicle_that_flies_away_after_its_arrival_is_found_out(tmp_path: Path) -> None:
    figures = flown(tmp_path, drift_m_s=1.0)
    assert figures.agents[0].farthest_after_arrival_m == pytest.approx(52.0, abs=1.0)
    broken = broken_bounds(figures, Job(CALM, "arducopter"))
    assert any(line.startswith("farthest_after_arrival_m") for line in broken)
    assert any(line.startswith("stands_after_s unknown") for line in broken)


def test_a_flight_whose_simulator_did_not_run_is_none(tmp_path: Path) -> None:
    assert flown(tmp_path).truth_share > 0.95
    record = json.loads((tmp_path / "flight.json").read_text())
    record["heights_m"]["1"] = [told for told in record["heights_m"]["1"] if not 30.0 < told[0] - BEGIN_S < 33.0]
    (tmp_path / "flight.json").write_text(json.dumps(record))
    figures = figures_of(tmp_path)
    assert figures.truth_share == pytest.approx(0.4, abs=0.02)
    assert "no flight: simulator starved, 41 % of its samples came" in broken_bounds(figures, Job(CALM, "arducopter"))


def test_a_height_counts_from_that_at_the_first_event(tmp_path: Path) -> None:
    flown(tmp_path)
    record = json.loads((tmp_path / "flight.json").read_text())
    record["notes"].insert(2, (BEGIN_S + 20.0, "home moved by 0, 0, -560 m up"))
    heights_m = ((2.0, 28.0), (20.0, 30.0), (30.0, 31.0), (100.0, 24.0))
    record["heights_m"]["1"] = [(BEGIN_S + t_s, height_m) for t_s, height_m in heights_m]
    (tmp_path / "flight.json").write_text(json.dumps(record))
    figures = figures_of(tmp_path)
    assert figures.agents[0].height_off_m == 6.0
    assert figures.events[0].height_m == (24.0, 31.0)
    level = next(scenario for scenario in SCENARIOS if scenario.name == "home-lower")
    assert "height_off_m 6, at most 5" in broken_bounds(figures, Job(level, "arducopter"))


def test_on_a_wire_the_time_counts_in_which_no_setpoint_reached_the_autopilot(tmp_path: Path) -> None:
    flown(tmp_path)
    record = json.loads((tmp_path / "flight.json").read_text())
    record["delivered_s"] = {"1": [BEGIN_S + t_s for t_s in (*np.arange(2.0, 30.0, 0.1), *np.arange(31.0, 70.0, 0.1))]}
    (tmp_path / "flight.json").write_text(json.dumps(record))
    agent = figures_of(tmp_path).agents[0]
    assert agent.arrived_s == pytest.approx(72.5, abs=0.1)
    # From 69.9 s, the last that was delivered, to 2.0 s + 72.5 s, the arrival.
    assert agent.delivered_gap_s == pytest.approx(4.6, abs=0.15)


def test_after_a_take_over_on_a_wire_what_was_carried_counts(tmp_path: Path) -> None:
    flown(tmp_path)
    record = json.loads((tmp_path / "flight.json").read_text())
    record["notes"].insert(2, (BEGIN_S + 20.0, "mode wait"))
    record["delivered_s"] = {"1": [BEGIN_S + t_s for t_s in np.arange(2.0, 23.0, 0.1)]}
    record["told_s"] = {"1": [BEGIN_S + 2.0, BEGIN_S + 20.4, BEGIN_S + 22.0]}
    (tmp_path / "flight.json").write_text(json.dumps(record))
    figures = figures_of(tmp_path)
    assert figures.events[0].delivered_after_told_s == pytest.approx(2.5)
    flood = next(scenario for scenario in SCENARIOS if scenario.name == "flood")
    assert "delivered_after_told_s 2.5, at most 0.25" in broken_bounds(figures, Job(flood, "arducopter"))


def test_setpoints_of_all_starts_of_a_companion_count_and_no_other_messages(tmp_path: Path) -> None:
    flown(tmp_path)
    again = tmp_path / "logs-1" / "start-2"
    again.mkdir()
    writer = TlogWriter(again / "vehicle-1.tlog")
    autopilot = mavlink.MAVLink(None, srcSystem=1, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
    writer.write(BEGIN_S + 9.0, bytes(mavlink.MAVLink_heartbeat_message(2, 3, 0, 0, 4, 3).pack(autopilot)))
    companion = mavlink.MAVLink(None, srcSystem=1, srcComponent=mavlink.MAV_COMP_ID_ONBOARD_COMPUTER)
    bank = mavlink.MAVLink_set_attitude_target_message(0, 1, 1, 0xC6, [1, 0, 0, 0], 0, 0, 0, 0)
    writer.write(BEGIN_S + 10.0, bytes(bank.pack(companion)))
    writer.close()
    assert list(setpoint_times_s(tmp_path / "logs-1") - BEGIN_S) == pytest.approx([2.0, 4.0, 4.1, 4.5, 10.0])


def test_a_configuration_is_the_packaged_one_of_its_kind_but_for_the_flights_links(tmp_path: Path) -> None:
    write_config(tmp_path / "c.yaml", COPTER, CALM.mission(COPTER), (2, 1), {"staleness": {"loitering_after_s": 8}})
    content = yaml.safe_load((tmp_path / "c.yaml").read_text())
    assert content["autopilot"]["link"] == "tcp:127.0.0.1:5770"
    assert content["staleness"] == {
        "coasting_after_s": 15, "loitering_after_s": 8, "blind_after_s": 300, "recover_after_s": 1,
    }  # fmt: skip


def test_a_gap_is_not_the_companions_fault_while_the_computer_itself_stood_still(tmp_path: Path) -> None:
    figures = flown(tmp_path)
    late = replace(figures, agents=(replace(figures.agents[0], gap_s=0.8),))
    assert any(line.startswith("gap_s") for line in broken_bounds(late, Job(CALM, "arducopter")))
    stood = replace(late, pause_s=0.4)
    assert not any(line.startswith("gap_s") for line in broken_bounds(stood, Job(CALM, "arducopter")))


def test_the_page_says_what_each_scenario_shows() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for scenario in SCENARIOS:
        assert f"| `{scenario.name}` | {scenario.shows} |" in page
