"""Missions flown by the stand-ins of the four autopilots: scaled, handed over by a person, steered frame by frame."""

from __future__ import annotations

import functools
import json
import tempfile
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from pymavlink.dialects.v20 import common as mavlink

from companion.autopilot.kinds import CRUISE_M_S
from companion.errors import InputError
from companion.files.tlog import read_tlog
from companion.mission.model import Mission, load_mission, parse_mission
from companion.mission.resolve import resolve
from companion.onboard.config import parse_config
from companion.onboard.decision import Purpose
from companion.onboard.replay import replay
from companion.protocol.v2_extension import V2_EXTENSION_ID
from groundstation.cli import cli as groundstation_cli
from sim.cli import cli
from sim.lockstep import Flight, FlightOptions, fly
from sim.safety_pilot import HAND_OVER_S, SafetyPilot
from sim.scaling import scaled
from sim.score import score
from sim.trajectory import Trajectory

pytestmark = pytest.mark.slow

KINDS = tuple(CRUISE_M_S)
MISSION = """
name: a crossing
agents:
  - {id: 1, north_m: 0, east_m: 0, heading_deg: 0}
  - {id: 2, north_m: 0, east_m: 3000, heading_deg: 90}
targets:
  - {id: 1, north_m: 8000, east_m: 2500, speed_bound_m_s: 5, motion: random}
  - {id: 2, north_m: 8000, east_m: 0, speed_bound_m_s: 0}
threats:
  - {id: 1, north_m: 4500, east_m: 600, detection_radius_m: 1200, attack_radius_m: 600, motion: random}
max_time_s: 400
"""
SETPOINTS = frozenset(
    {mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED, mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET}
)


def crossing(kind: str, changes: str = "") -> Mission:
    return scaled(resolve(parse_mission(MISSION + changes, "a crossing"), 1), kind)


@functools.cache
def flown(kind: str) -> tuple[Mission, Flight, Path]:
    mission, folder = crossing(kind), Path(tempfile.mkdtemp(prefix="oneway-"))
    return mission, fly(mission, 1, FlightOptions(law="routed", autopilot=kind, out=folder)), folder


def assert_good(mission: Mission, trajectory: Trajectory) -> None:
    result = score(trajectory, mission)
    assert result.targets_reached == result.targets
    assert (result.threat_entries_detection, result.threat_entries_attack, result.worst_depth_m) == (0, 0, 0.0)
    assert result.separation_breaches == 0


def message_ids(folder: Path, agent: int = 1) -> list[tuple[float, int]]:
    return [(t_s, int.from_bytes(raw[7:10], "little")) for t_s, raw in read_tlog(folder / f"vehicle-{agent}.tlog")]


@pytest.mark.parametrize("kind", KINDS)
def test_every_target_is_reached_without_an_entry_or_a_breach(kind: str) -> None:
    mission, flight, _ = flown(kind)
    assert_good(mission, flight.trajectory)


@pytest.mark.parametrize("kind", KINDS)
def test_the_vehicle_flies_at_its_cruise_speed(kind: str) -> None:
    _, flight, _ = flown(kind)
    on_its_way = (flight.trajectory.t_s > 20.0) & (flight.trajectory.t_s < 60.0)
    assert np.median(flight.trajectory.agents_speed_m_s[on_its_way]) == pytest.approx(CRUISE_M_S[kind], rel=0.05)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_decided_before_a_person_hands_the_vehicle_over_and_something_soon_after(kind: str) -> None:
    _, _, folder = flown(kind)
    config = parse_config((folder / "companion-1.yaml").read_text(), "companion-1.yaml")
    decisions = [one.decision for one in replay(read_tlog(folder / "vehicle-1.tlog"), config)]
    begins_s = decisions[0].t_s
    engaged_s = next(one.t_s for one in decisions if one.purpose is not Purpose.IDLE) - begins_s
    assert HAND_OVER_S <= engaged_s <= HAND_OVER_S + 3.0


@pytest.mark.parametrize("kind", KINDS)
def test_the_flight_is_decided_again_to_the_bit_from_its_recording(kind: str) -> None:
    _, _, folder = flown(kind)
    config = parse_config((folder / "companion-2.yaml").read_text(), "companion-2.yaml")
    again = list(replay(read_tlog(folder / "vehicle-2.tlog"), config))
    assert len(again) > 200
    assert all(one.same for one in again)


@pytest.mark.parametrize("kind", KINDS)
def test_setpoints_leave_ten_times_a_second_once_it_is_steered(kind: str) -> None:
    _, _, folder = flown(kind)
    times_s = np.array([t_s for t_s, message_id in message_ids(folder) if message_id in SETPOINTS])
    steered_s = times_s[times_s > times_s[0] + 10.0]
    assert np.max(np.diff(steered_s)) == pytest.approx(0.1, abs=1e-3)


def test_the_same_flight_is_the_same_bit_for_bit() -> None:
    mission, flight, _ = flown("arduplane")
    again = fly(mission, 1, FlightOptions(law="routed", autopilot="arduplane")).trajectory
    assert np.array_equal(again.agents_ned_m, flight.trajectory.agents_ned_m)


@pytest.mark.parametrize("kind", ["arduplane", "px4-copter"])
def test_in_a_wind_of_a_sixth_of_its_speed_it_arrives_too(kind: str) -> None:
    mission = crossing(kind, "wind: {from_deg: 200, speed_m_s: 7, gust_m_s: 3}\n")
    assert_good(mission, fly(mission, 1, FlightOptions(law="routed", autopilot=kind)).trajectory)


# One radio


@pytest.mark.parametrize("kind", ["arducopter", "px4-plane"])
def test_a_broadcast_through_the_autopilot_steers_as_well_as_one_heard_beside_it(kind: str, tmp_path: Path) -> None:
    mission = crossing(kind)
    assert_good(
        mission, fly(mission, 1, FlightOptions(law="routed", autopilot=kind, one_radio=True, out=tmp_path)).trajectory
    )
    broadcast = [raw for _, raw in read_tlog(tmp_path / "broadcast.tlog")]
    assert {int.from_bytes(raw[7:10], "little") for raw in broadcast} == {V2_EXTENSION_ID}


def test_one_radio_needs_frames_that_an_autopilot_passes_on() -> None:
    given = ["fly", "copter-demo", "--autopilot", "arducopter", "--one-radio", "--radio", "lora"]
    outcome = CliRunner().invoke(cli, given, standalone_mode=False)
    assert "--one-radio: with --radio lora; allowed: --radio lora/v2ext" in str(outcome.exception)


# The command line


def test_asked_to_sim_fly_scales_and_writes_by_how_much(tmp_path: Path) -> None:
    (tmp_path / "crossing.yaml").write_text(MISSION.replace("max_time_s: 400", "max_time_s: 5"))
    out = tmp_path / "out"
    given = ["fly", str(tmp_path / "crossing.yaml"), "--autopilot", "px4-plane", "--scale", "--out", str(out)]
    outcome = CliRunner().invoke(cli, given, standalone_mode=False)
    assert outcome.exception is None
    assert "px4-plane stand-ins, scale 0.25" in outcome.output
    written = parse_mission((out / "mission.yaml").read_text(), "mission.yaml")
    assert written.scale is not None and written.scale.factor == 0.25
    assert written.targets[0].position_ned_m == (2_000.0, 625.0)


def test_unasked_the_mission_is_flown_as_it_is_written(tmp_path: Path) -> None:
    given = ["fly", "copter-demo", "--autopilot", "arducopter", "--out", str(tmp_path), "--json"]
    result = json.loads(CliRunner().invoke(cli, given, standalone_mode=False).output)
    written = parse_mission((tmp_path / "mission.yaml").read_text(), "mission.yaml")
    assert written == resolve(load_mission("copter-demo"), 1)
    assert (result["targets_reached"], result["threat_entries_detection"]) == (2, 0)


def test_sim_fly_flies_the_mission_that_groundstation_run_broadcasts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, broadcast = tmp_path / "mission.yaml", []
    path.write_text(
        "draw: {agents: 3, targets: 2, threats: 1}\narea_m: {north: 4000, east: 4000}\nmax_time_s: 1\n"
        "defaults: {agent: {speed_m_s: 8}, threat: {radius_m: 300}}\n"
    )
    monkeypatch.setattr("companion.runtime.clock.run_until_signal", lambda start: start(None))
    monkeypatch.setattr("groundstation.service.run_groundstation", lambda mission, *_: broadcast.append(mission))
    given = ["run", str(path), "--link", "udpout:127.0.0.1:9", "--unsigned", "--seed", "7"]
    CliRunner().invoke(groundstation_cli, given, standalone_mode=False, catch_exceptions=False)
    given = ["fly", str(path), "--autopilot", "arducopter", "--seed", "7", "--out", str(tmp_path / "out"), "--json"]
    CliRunner().invoke(cli, given, standalone_mode=False)
    assert broadcast == [load_mission(tmp_path / "out" / "mission.yaml")]


@pytest.mark.parametrize(
    ("mission", "kind", "said"),
    [
        (
            "paper-dynamic",
            "arducopter",
            "agents[0].speed_m_s: 60 m/s with --autopilot arducopter, which flies 0 to 8.7",
        ),
        ("paper-dynamic", "px4-plane", "agents[0].speed_m_s: 60 m/s with --autopilot px4-plane, which flies 15 m/s; "),
        (
            "copter-demo",
            "arduplane",
            "agents[0].speed_m_s: 4 m/s with --autopilot arduplane, which flies 9 to 22 m/s; ",
        ),
    ],
)
def test_speeds_that_the_autopilots_vehicle_does_not_fly_are_refused_with_the_way_out(
    mission: str, kind: str, said: str
) -> None:
    outcome = CliRunner().invoke(cli, ["fly", mission, "--autopilot", kind], standalone_mode=False)
    assert isinstance(outcome.exception, InputError)
    assert str(outcome.exception).startswith(f"{mission}: {said}")
    assert "--scale, which multiplies every length and speed by" in str(outcome.exception)


# The person


def test_a_person_asks_until_heartbeat_shows_the_mode_and_never_again() -> None:
    pilot = SafetyPilot("px4-copter", 7)
    offboard = 6 << 16
    asked_s = [t_s for t_s in np.arange(0.0, 10.0, 0.5) if pilot.orders(float(t_s), offboard if t_s > 4.2 else 0)]
    assert asked_s == [2.0, 3.0, 4.0]
    assert pilot.orders(60.0, 0) == []


def test_the_vehicle_stays_where_it_is_held_until_it_is_handed_over() -> None:
    _, flight, _ = flown("px4-copter")
    before = flight.trajectory.t_s <= HAND_OVER_S
    place_ned_m = flight.trajectory.agents_ned_m[before, 0]
    assert np.max(np.hypot(*(place_ned_m - place_ned_m[0]).T)) < 1.0
