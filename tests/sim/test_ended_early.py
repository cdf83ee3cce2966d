"""A flight that is ended early, at whatever time and by whatever, leaves whole files of what was flown."""

from __future__ import annotations

import json
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.files.tlog import read_tlog
from companion.mission.model import AgentSpec, Mission, TargetSpec, ThreatSpec
from sim.flown import FlownMission
from sim.lockstep import Flight, FlightOptions, fly
from sim.outcome import agent_results
from sim.score import score
from sim.stop import Stop, stop_at_signals
from sim.trajectory import TrajectoryBuilder, TrajectoryFile, read_csv

MISSION = Mission(
    name="to be cut short",
    agents=(
        AgentSpec(id=1, north_m=0.0, east_m=0.0, heading_deg=0.0, speed_m_s=50.0, n_max=1.0),
        AgentSpec(id=2, north_m=0.0, east_m=900.0, heading_deg=0.0, speed_m_s=50.0, n_max=1.0),
    ),
    targets=(TargetSpec(id=1, north_m=3_000.0, east_m=0.0, speed_bound_m_s=0.0),),
    threats=(
        ThreatSpec(
            id=1,
            north_m=1_500.0,
            east_m=100.0,
            detection_radius_m=400.0,
            attack_radius_m=200.0,
            speed_bound_m_s=0.0,
        ),
    ),
    max_time_s=60.0,
)
LONG_FLIGHT = """
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0, speed_m_s: 10}]
targets: [{id: 1, north_m: 200000, east_m: 0}]
max_time_s: 90000
"""


def stop_at_tick(tick: int) -> Callable[[], Stop | None]:
    """Return the function that ends a flight when it was asked `tick` times."""
    asked = 0

    def stop() -> Stop | None:
        nonlocal asked
        asked += 1
        return Stop("enough", 3) if asked > tick else None

    return stop


def flown_of(flight: Flight) -> FlownMission:
    early = None if flight.stop is None else flight.stop.why
    return FlownMission(MISSION, flight.trajectory, score(flight.trajectory, MISSION), 1, "routed", ended_early=early)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 140))
def test_wherever_a_flight_is_ended_its_files_are_whole_and_every_agent_has_a_reason(tick: int) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        flight = fly(MISSION, 1, FlightOptions("routed", out=folder, stop=stop_at_tick(tick)))
        read = read_csv(folder / "trajectory.csv")
        np.testing.assert_array_equal(read.agents_ned_m, flight.trajectory.agents_ned_m)
        assert all(list(read_tlog(log)) for log in folder.glob("*.tlog"))
    results = agent_results(flown_of(flight), flight.logs)
    assert [result.score.id for result in results] == [1, 2]
    assert all(result.reason for result in results)
    assert json.loads(json.dumps([result.to_dict() for result in results], allow_nan=False))
    if flight.stop is not None:
        assert (len(read.t_s), flight.stop.why) == (tick + 1, "enough")
        assert all(result.outcome == "arrived" or "enough" in result.reason or tick == 0 for result in results)


def test_an_ended_flight_is_the_beginning_of_the_whole_one(tmp_path: Path) -> None:
    whole, part = tmp_path / "whole", tmp_path / "part"
    for folder, tick in ((whole, 10_000), (part, 33)):
        folder.mkdir()
        fly(MISSION, 1, FlightOptions("routed", out=folder, stop=stop_at_tick(tick)))
    written = (part / "trajectory.csv").read_bytes()
    assert (whole / "trajectory.csv").read_bytes().startswith(written)


def started(folder: Path, limit_bytes: int | None = None) -> subprocess.Popen[str]:
    mission = folder / "long.yaml"
    mission.write_text(LONG_FLIGHT)

    def limit() -> None:
        if limit_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, limit_bytes))

    return subprocess.Popen(
        [sys.executable, "-m", "sim", "fly", str(mission), "--out", str(folder / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=limit,  # noqa: PLW1509 the tests start no threads
    )


def wait_for_bytes(path: Path, count: int) -> None:
    until_s = time.monotonic() + 60.0
    while not (path.exists() and path.stat().st_size > count):
        assert time.monotonic() < until_s, f"{path} does not grow"
        time.sleep(0.05)


def check_whole(folder: Path, why: str) -> None:
    """Check that a folder holds the trajectory, the result and the pictures of a flight that was ended early."""
    trajectory, result = read_csv(folder / "trajectory.csv"), json.loads((folder / "result.json").read_text())
    assert why in result["ended_early"]
    assert result["flight_time_s"] == trajectory.t_s[-1]
    assert why in result["agents"][0]["reason"]
    assert (folder / "paths.png").read_bytes().endswith(b"IEND\xaeB`\x82")
    assert "ended early" in (folder / "report.html").read_text()
    assert "</html>" in (folder / "report.html").read_text()


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_the_flight_and_leaves_everything(tmp_path: Path, number: signal.Signals, status: int) -> None:
    process = started(tmp_path)
    wait_for_bytes(tmp_path / "out" / "trajectory.csv", 1_000)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == status
    assert "Traceback" not in errors
    assert errors.splitlines()[-1].startswith("sim: ended early, after ")
    check_whole(tmp_path / "out", number.name)


def test_a_disk_that_takes_no_more_ends_the_flight_and_leaves_everything(tmp_path: Path) -> None:
    process = started(tmp_path, limit_bytes=400_000)
    _, errors = process.communicate(timeout=120)
    assert process.returncode == 2
    assert "Traceback" not in errors
    assert errors.splitlines()[-1].startswith("sim: ended early, after ")
    check_whole(tmp_path / "out", "File too large")


def test_a_killed_flight_leaves_a_trajectory_that_can_be_read(tmp_path: Path) -> None:
    process = started(tmp_path)
    wait_for_bytes(tmp_path / "out" / "trajectory.csv", 1_000)
    process.kill()
    process.communicate(timeout=60)
    assert len(read_csv(tmp_path / "out" / "trajectory.csv").t_s) > 1
    assert list(read_tlog(tmp_path / "out" / "vehicle-1.tlog"))
    assert not (tmp_path / "out" / "result.json").exists()


def test_a_second_signal_interrupts_at_once() -> None:
    with stop_at_signals() as stop:
        assert stop() is None
        signal.raise_signal(signal.SIGINT)
        assert stop() == Stop("interrupted (SIGINT)", 130)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@given(st.integers(0, 400), st.integers(1, 4))
def test_a_trajectory_that_does_not_fit_ends_with_a_whole_step(room_bytes: int, objects: int) -> None:
    builder = TrajectoryBuilder(range(1, objects + 1), [], [])
    for step in range(20):
        builder.append(float(step), [(step, 0.0, 0.0, 1.0)] * objects, [], [])
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "trajectory.csv"
        file = TrajectoryFile(path, builder)
        before = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (path.stat().st_size + room_bytes, before[1]))
        try:
            with pytest.raises(OSError, match="File too large"):
                file.catch_up()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        lines = path.read_text().splitlines()[1:]
        assert len(lines) == file.steps * objects
        file.close()
        assert len(read_csv(path).t_s) == 20
