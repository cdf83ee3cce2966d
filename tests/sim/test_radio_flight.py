"""Closed loop over a declared radio: what fits its budget steers a fleet too large for one state frame."""

from __future__ import annotations

from pathlib import Path

import pytest

from companion.files.tlog import read_tlog
from companion.mission.model import LinkSpec, Mission, parse_mission
from companion.mission.resolve import resolve
from companion.protocol.dialect import oneway
from companion.protocol.frame import raw_frame
from groundstation.radio import parse_radio
from sim.lockstep import Flight, FlightOptions, fly
from sim.score import Score, score

pytestmark = pytest.mark.slow

FLEET = """
name: fleet
area_m: {north: 12000, east: 12000}
draw: {agents: 12, targets: 6, threats: 6}
defaults:
  agent: {speed_m_s: 25, n_max: 1, range_m: 300000}
  target: {speed_bound_m_s: 1, motion: random}
  threat: {detection_radius_m: 1000, attack_radius_m: 500, speed_bound_m_s: 4, motion: random}
separation_m: 40
guidance_step_s: 1
integration_step_s: 1
max_time_s: 2000
"""
PACKED = {
    oneway.MAVLINK_MSG_ID_ONEWAY_FLEET,
    oneway.MAVLINK_MSG_ID_ONEWAY_RADII,
    oneway.MAVLINK_MSG_ID_ONEWAY_MISSION,
}
RADIO = parse_radio("sik-57600", 0.08)


def mission(**changes: object) -> Mission:
    return resolve(parse_mission(FLEET, "fleet"), 3).model_copy(update=changes)


def flown(given: Mission, out: Path | None = None) -> tuple[Flight, Score]:
    flight = fly(given, 3, FlightOptions(law="routed", radio=RADIO, out=out))
    return flight, score(flight.trajectory, given)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Flight, Score, Path]:
    folder = tmp_path_factory.mktemp("radio")
    return *flown(mission(), folder), folder


def test_a_fleet_reaches_its_targets_over_packed_frames_and_enters_nothing(
    recorded: tuple[Flight, Score, Path],
) -> None:
    _, scored, folder = recorded
    ids = {raw_frame(raw).message_id for _, raw in read_tlog(folder / "broadcast.tlog")}
    assert ids == PACKED | {oneway.MAVLINK_MSG_ID_HEARTBEAT}
    assert scored.targets_reached == 6
    assert scored.threat_entries_detection == scored.separation_breaches == 0


def test_what_was_sent_fits_the_radios_share(recorded: tuple[Flight, Score, Path]) -> None:
    flight, _, folder = recorded
    sent = [(t_s, len(raw)) for t_s, raw in read_tlog(folder / "broadcast.tlog")]
    flown_s = float(flight.trajectory.t_s[-1])
    assert sum(size for _, size in sent) <= RADIO.budget_bytes_per_s * flown_s + 252 + 0.1 * RADIO.budget_bytes_per_s
    assert max(size for _, size in sent) <= 252


def test_over_a_radio_that_loses_half_the_fleet_still_arrives_and_enters_nothing() -> None:
    _, scored = flown(mission(link=LinkSpec(loss=0.5)))
    assert scored.targets_reached == 6
    assert scored.threat_entries_detection == 0
