"""Recorded tracks in a simulated flight: they are threats on the broadcast, there in truth, and in the score."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from companion.errors import InputError
from companion.mission.model import parse_mission
from companion.mission.resolve import resolve
from sim.changes import with_all_things
from sim.flight_files import EVENTS_NAME
from sim.lockstep import Flight, FlightOptions, fly
from sim.score import Score, score
from sim.tracks import track_specs

MISSION = """
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}]
targets: [{id: 1, north_m: 5000, east_m: 0}]
broadcast_period_s: 1
guidance_step_s: 1
integration_step_s: 1
max_time_s: 170
"""
BEGAN_S = 1_000.0
WEST_M_S, FROM_EAST_M, NORTH_M = -10.0, 500.0, 3_500.0
ENDED_S = 40


class Flown(NamedTuple):
    """A flight and its score."""

    flight: Flight
    scored: Score
    folder: Path


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Flown:
    """Fly past an aircraft that comes from the east, as a recording has it for the first 40 s."""
    folder = tmp_path_factory.mktemp("tracks")
    path = folder / "aircraft.csv"
    rows = ["t_s,id,north_m,east_m,velocity_north_m_s,velocity_east_m_s"]
    rows += [f"{BEGAN_S + t},A1,{NORTH_M},{FROM_EAST_M + WEST_M_S * t},0,{WEST_M_S}" for t in range(ENDED_S)]
    path.write_text("\n".join(rows) + "\n")
    mission = resolve(parse_mission(MISSION, "test"), 1)
    specs = track_specs(mission, [f"{path},radius_m=300,timeout_s=10"], "test")
    flight = fly(mission, 1, FlightOptions("routed", tracks=specs, out=folder))
    return Flown(flight, score(flight.trajectory, with_all_things(flight.changes), flight.changes), folder)


def test_what_was_recorded_is_where_it_was_recorded(flown: Flown) -> None:
    trajectory = flown.flight.trajectory
    assert trajectory.threat_ids == (1,)
    there = ~np.isnan(trajectory.threats_ned_m[:, 0, 0])
    t_s = trajectory.t_s[there & (trajectory.t_s < ENDED_S)]
    expected = np.column_stack([np.full(len(t_s), NORTH_M), FROM_EAST_M + WEST_M_S * t_s])
    assert len(t_s) > 10
    assert trajectory.threats_ned_m[there & (trajectory.t_s < ENDED_S), 0] == pytest.approx(expected, abs=1.0)


def test_it_is_kept_clear_of_and_counts_in_the_score(flown: Flown) -> None:
    assert (flown.scored.targets_reached, flown.scored.threat_entries_detection) == (1, 0)
    nearest = flown.scored.per_agent[0].nearest_detection
    assert nearest is not None
    assert 0.0 < nearest.distance_m < 2_000.0


def test_the_simulated_sensor_does_not_see_it_too_as_something_unknown(flown: Flown) -> None:
    events = (flown.folder / EVENTS_NAME).read_text()
    assert "track-began" in events
    assert "unknown-seen" not in events


def test_it_is_retired_once_the_recording_has_ended(flown: Flown) -> None:
    last = flown.flight.changes[-1]
    assert last.mission.threats == ()
    assert ENDED_S + 10.0 <= last.t_s < 90.0


def test_in_truth_it_ends_with_the_recording_and_the_ground_station_has_it_until_it_times_out(flown: Flown) -> None:
    there = ~np.isnan(flown.flight.trajectory.threats_ned_m[:, 0, 0])
    assert flown.flight.trajectory.t_s[there].max() <= ENDED_S


def test_a_recording_without_a_radius_or_that_is_not_there_is_refused_in_one_line() -> None:
    mission = resolve(parse_mission(MISSION, "test"), 1)
    with pytest.raises(InputError, match="radius_m"):
        track_specs(mission, ["aircraft.csv"], "test")
    with pytest.raises(InputError, match=r"nowhere\.csv"):
        track_specs(mission, ["nowhere.csv,radius_m=100"], "test")
