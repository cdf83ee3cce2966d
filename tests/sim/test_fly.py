"""`sim fly` as a process: what it prints, what it writes, and that the figures follow from the files alone."""

from __future__ import annotations

import csv
import json
import math
import re
import subprocess
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
import yaml

from companion.files.tlog import read_tlog
from companion.protocol.codec import FrameReader, MotionFrame, StateFrame

pytestmark = pytest.mark.slow

SEED = 8
"""Two agents pass within 240 m in this flight, so that the separation is worth recomputing."""
SMALL = """
name: paper-dynamic-small
area_m: {north: 80000, east: 80000}
draw: {agents: 5, targets: 3, threats: 2}
defaults:
  agent: {speed_m_s: 60, n_max: 10, range_m: 500000}
  target: {speed_bound_m_s: 10, motion: random}
  threat: {detection_radius_m: 10000, attack_radius_m: 5000, speed_bound_m_s: 10, motion: random}
guidance_step_s: 1
integration_step_s: 0.5
"""
"""The paper's dynamic mission with half of its things on less than half of its width, which flies in a tenth of the
time."""
KEYS = [
    "seed", "law", "arrived", "targets_reached", "targets", "flight_time_s", "path_length_m", "shortest_path_m",
    "threat_entries_detection", "threat_entries_attack", "worst_depth_m", "separation_breaches", "min_separation_m",
    "steps", "guard_interventions", "turn_limited_steps", "decision_us", "broadcast_bytes", "broadcast_frames",
    "frames_lost", "speedup", "ended_early", "agents",
]  # fmt: skip
Point = tuple[float, float]


def sim_fly(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "sim", "fly", *arguments], capture_output=True, text=True, timeout=300, check=False
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, subprocess.CompletedProcess[str]]:
    folder, mission = tmp_path_factory.mktemp("fly"), tmp_path_factory.mktemp("mission") / "small.yaml"
    mission.write_text(SMALL)
    return folder, sim_fly(str(mission), "--seed", str(SEED), "--json", "--out", str(folder))


def result_of(folder: Path) -> dict[str, Any]:
    result: dict[str, Any] = json.loads((folder / "result.json").read_text())
    return result


def tracks(folder: Path) -> dict[tuple[str, int], list[tuple[float, float, float]]]:
    """Read the truth with nothing but the csv module: (t, north, east) per thing."""
    found = defaultdict(list)
    with (folder / "trajectory.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            point = (float(row["t_s"]), float(row["north_m"]), float(row["east_m"]))
            found[row["kind"], int(row["id"])].append(point)
    return dict(found)


def test_it_ends_well_and_prints_the_same_result_that_it_writes(
    run: tuple[Path, subprocess.CompletedProcess[str]],
) -> None:
    folder, process = run
    assert process.returncode == 0
    assert json.loads(process.stdout) == result_of(folder)
    assert list(result_of(folder)) == KEYS


def test_it_is_quiet_in_a_pipe(run: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    assert run[1].stderr == ""


def test_it_writes_every_output(run: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    names = {path.name for path in run[0].iterdir()}
    logs = {"broadcast.tlog"}
    for number in range(1, 6):
        logs |= {f"vehicle-{number}.tlog", f"companion-{number}.yaml"}
    assert names == {"mission.yaml", "trajectory.csv", "result.json", "paths.png", "report.html"} | logs


def test_the_mission_reaches_every_target_without_an_entry(
    run: tuple[Path, subprocess.CompletedProcess[str]],
) -> None:
    result = result_of(run[0])
    assert (result["targets_reached"], result["targets"]) == (3, 3)
    assert result["threat_entries_detection"] == result["threat_entries_attack"] == 0


def test_arrivals_follow_from_the_files(run: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    mission, truth = yaml.safe_load((run[0] / "mission.yaml").read_text()), tracks(run[0])
    open_targets = [target["id"] for target in mission["targets"]]
    arrived: set[int] = set()
    for step in range(len(truth["agent", 1])):
        for target in list(open_targets):
            here = truth["target", target][step]
            close = {
                agent["id"]
                for agent in mission["agents"]
                if agent["id"] not in arrived
                and math.dist(truth["agent", agent["id"]][step][1:], here[1:]) <= mission["arrival_radius_m"]
            }
            if close:
                open_targets.remove(target)
                arrived |= close
    result = result_of(run[0])
    assert result["arrived"] == len(arrived)
    assert result["targets_reached"] == len(mission["targets"]) - len(open_targets)


def test_lengths_and_flight_time_follow_from_the_files(run: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    mission, truth, result = yaml.safe_load((run[0] / "mission.yaml").read_text()), tracks(run[0]), result_of(run[0])
    for agent, length_m in zip(mission["agents"], result["path_length_m"], strict=True):
        track = truth["agent", agent["id"]]
        assert length_m == pytest.approx(sum(math.dist(a[1:], b[1:]) for a, b in zip(track, track[1:], strict=False)))
    assert result["flight_time_s"] == truth["agent", 1][-1][0] - truth["agent", 1][0][0]


def test_entries_and_depth_follow_from_the_files(run: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    mission, truth, result = yaml.safe_load((run[0] / "mission.yaml").read_text()), tracks(run[0]), result_of(run[0])
    entries = {"detection_radius_m": 0, "attack_radius_m": 0}
    depth_m = 0.0
    for agent in mission["agents"]:
        for threat in mission["threats"]:
            apart_m = [
                math.dist(a[1:], b[1:])
                for a, b in zip(truth["agent", agent["id"]], truth["threat", threat["id"]], strict=True)
            ]
            for radius in entries:
                inside = [distance_m < threat[radius] for distance_m in apart_m]
                entries[radius] += sum(b and not a for a, b in zip(inside, inside[1:], strict=False))
            depth_m = max(depth_m, threat["detection_radius_m"] - min(apart_m))
    assert result["threat_entries_detection"] == entries["detection_radius_m"]
    assert result["threat_entries_attack"] == entries["attack_radius_m"]
    assert result["worst_depth_m"] == pytest.approx(depth_m)


def test_separation_follows_from_the_files(run: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    mission, truth, result = yaml.safe_load((run[0] / "mission.yaml").read_text()), tracks(run[0]), result_of(run[0])
    ids = [agent["id"] for agent in mission["agents"]]
    least_m, breaches = math.inf, 0
    for index, first in enumerate(ids):
        for second in ids[:index]:
            pairs = list(zip(truth["agent", first], truth["agent", second], strict=True))
            offsets = [(a[1] - b[1], a[2] - b[2]) for a, b in pairs]
            nearest_m = [nearest(a, b) for a, b in zip(offsets, offsets[1:], strict=False)]
            least_m = min(least_m, *nearest_m)
            close = [False, *(distance_m < mission["separation_m"] for distance_m in nearest_m)]
            breaches += sum(b and not a for a, b in zip(close, close[1:], strict=False))
    # These loops take the paths between samples as straight; at this step and turn limit an arc bulges by 3 m at most.
    assert result["min_separation_m"] == pytest.approx(least_m, abs=6.0)
    assert result["separation_breaches"] == breaches


def nearest(a: Point, b: Point) -> float:
    """Return the least distance from the origin of the segment between two offsets."""
    along = (b[0] - a[0], b[1] - a[1])
    length_2 = along[0] ** 2 + along[1] ** 2
    share = 0.0 if length_2 == 0.0 else min(1.0, max(0.0, -(a[0] * along[0] + a[1] * along[1]) / length_2))
    return math.hypot(a[0] + share * along[0], a[1] + share * along[1])


def test_every_thing_has_a_row_at_every_step_to_the_end(run: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    lengths = {key: len(track) for key, track in tracks(run[0]).items()}
    assert len(lengths) == 10
    assert len(set(lengths.values())) == 1


def test_the_broadcast_log_holds_alternating_state_and_motion_frames(
    run: tuple[Path, subprocess.CompletedProcess[str]],
) -> None:
    reader = FrameReader()
    frames = [frame for _, data in read_tlog(run[0] / "broadcast.tlog") for frame in reader.read(data)]
    kinds = [type(frame) for frame in frames]
    assert kinds[:4] == [StateFrame, MotionFrame, StateFrame, MotionFrame]
    assert len(frames) == result_of(run[0])["broadcast_frames"]


@pytest.mark.parametrize(
    ("name", "shown"), [("broadcast.tlog", "UNKNOWN_10486016"), ("vehicle-1.tlog", "SET_POSITION_TARGET_LOCAL_NED")]
)
def test_mavlogdump_reads_the_logs(run: tuple[Path, subprocess.CompletedProcess[str]], name: str, shown: str) -> None:
    process = subprocess.run(
        [sys.executable, "-m", "pymavlink.tools.mavlogdump", str(run[0] / name)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={"MAVLINK20": "1", "MAVLINK_DIALECT": "common"},
    )
    assert process.returncode == 0, process.stderr
    assert shown in process.stdout


def test_the_report_needs_nothing_from_elsewhere(run: tuple[Path, subprocess.CompletedProcess[str]]) -> None:
    text = (run[0] / "report.html").read_text()
    assert "http://" not in text and "https://" not in text
    assert set(re.findall(r"(?:src|href)\s*=\s*[\"']?(\w*:?)", text)) <= {"data:"}
    assert "inematic" in text and "data:image/png;base64," in text


def test_flying_the_resolved_mission_again_repeats_the_flight_byte_for_byte(tmp_path: Path) -> None:
    first, again = tmp_path / "first", tmp_path / "again"
    sim_fly("copter-demo", "--autopilot", "arducopter", "--out", str(first))
    sim_fly(str(first / "mission.yaml"), "--autopilot", "arducopter", "--out", str(again))
    assert (again / "trajectory.csv").read_bytes() == (first / "trajectory.csv").read_bytes()
    same = [key for key in KEYS if key not in ("decision_us", "speedup")]
    assert [result_of(again)[key] for key in same] == [result_of(first)[key] for key in same]


def test_a_mission_that_cannot_be_finished_in_time_has_failed(tmp_path: Path) -> None:
    mission = tmp_path / "short.yaml"
    mission.write_text(
        "agents: [{id: 1, north_m: 0, east_m: 0}]\ntargets: [{id: 1, north_m: 9000, east_m: 0}]\nmax_time_s: 20\n"
    )
    process = sim_fly(str(mission))
    assert process.returncode == 1
    assert "0 of 1" in process.stdout
    last = process.stdout.splitlines()[-1]
    assert last.startswith("agent 1: out of time: on the way to target 1, ")
    assert "when the time was up, after 20 s" in last


def test_the_number_of_vehicles_can_be_changed(tmp_path: Path) -> None:
    mission = tmp_path / "two.yaml"
    mission.write_text(
        "draw: {agents: 2, targets: 1}\narea_m: {north: 5000, east: 5000}\nmax_time_s: 300\n"
        "defaults: {target: {speed_bound_m_s: 0}}\n"
    )
    process = sim_fly(str(mission), "--vehicles", "4", "--json")
    assert len(json.loads(process.stdout)["path_length_m"]) == 4


def test_an_arducopter_flies_the_copter_mission_in_lockstep(tmp_path: Path) -> None:
    process = sim_fly("copter-demo", "--autopilot", "arducopter", "--json")
    result = json.loads(process.stdout)
    assert process.returncode == 0
    assert result["targets_reached"] == 2 and result["threat_entries_detection"] == 0


def test_realtime_paces_the_flight_by_the_wall_clock(tmp_path: Path) -> None:
    mission = tmp_path / "brief.yaml"
    mission.write_text(
        "agents: [{id: 1, north_m: 0, east_m: 0}]\ntargets: [{id: 1, north_m: 9000, east_m: 0}]\nmax_time_s: 2\n"
    )
    assert json.loads(sim_fly(str(mission), "--realtime", "--json").stdout)["speedup"] <= 1.1
