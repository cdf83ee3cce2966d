"""Flown to the end: with whatever share of the frames lost, nobody enters a threat that the broadcast tells of."""

from __future__ import annotations

import math
import random
from collections.abc import Iterable
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from companion.mission.model import Mission, parse_mission
from companion.mission.resolve import resolve
from companion.protocol.messages import REVISIONS
from groundstation import ground_station
from groundstation.radio import parse_radio
from groundstation.revision import Revision, next_revision
from groundstation.tracks import TrackTable
from sim.lockstep import Flight, FlightOptions, fly
from sim.score import score

pytestmark = pytest.mark.slow

DISCS = "\n".join(
    f"- {{id: {k}, north_m: {north_m}, east_m: {east_m}, detection_radius_m: {radius_m}, "
    f"attack_radius_m: {radius_m / 2}, speed_bound_m_s: {bound_m_s}, motion: {motion}}}"
    for k, (north_m, east_m, radius_m, bound_m_s, motion) in enumerate(
        [
            (-1500, -2600, 400, 0, "static"),
            (-1500, -800, 400, 0, "static"),
            (-1500, 900, 400, 0, "static"),
            (-1400, 2500, 300, 0, "static"),
            (3500, 100, 900, 0, "static"),
            (3600, 2100, 700, 0, "static"),
            (3700, -2300, 600, 4, "random"),
        ],
        1,
    )
)
TEXT = f"""
name: lost
agents:
- {{id: 1, north_m: 0, east_m: 0, heading_deg: 0, speed_m_s: 40, n_max: 4}}
targets:
- {{id: 1, north_m: 7000, east_m: 0, speed_bound_m_s: 0, motion: static}}
threats:
{DISCS}
arrival_radius_m: 100
broadcast_period_s: 10
max_time_s: 900
"""
LINKS = {
    "0 %": "loss: 0",
    "30 %": "loss: 0.3",
    "60 %": "loss: 0.6",
    "90 %": "loss: 0.9",
    "bursts": "burst: {enter: 0.2, leave: 0.2, loss: 1.0}",
    "late and doubled": "loss: 0.3, jitter_s: 8, duplicate: 0.3, reorder: 0.3",
}


def mission(link: str, loss: str) -> Mission:
    return resolve(parse_mission(f"{TEXT}link: {{{link}}}\n", f"lost {loss}"), 3)


def flown(task: Mission, packed: bool) -> Flight:
    return fly(task, 5, FlightOptions(law="routed", radio=parse_radio("sik-57600", 0.1) if packed else None))


@pytest.mark.parametrize("packed", [False, True], ids=["state", "packed"])
@pytest.mark.parametrize("loss", LINKS)
def test_nobody_enters_a_threat_of_the_broadcast_and_whoever_has_heard_it_arrives(loss: str, packed: bool) -> None:
    task = mission(LINKS[loss], loss)
    flight = flown(task, packed)
    scored = score(flight.trajectory, task)
    assert (scored.threat_entries_detection, scored.threat_entries_attack) == (0, 0)
    model = flight.companions[1].world_model
    assert scored.targets_reached == 1 or model.missing is not None or loss == "90 %"


def drawn(chance: random.Random, link: str) -> Mission:
    """Return a flight north among five to ten discs anywhere but at its two ends, of which some move."""
    discs: list[tuple[float, float, float]] = []
    while len(discs) < 5 or (len(discs) < 10 and chance.random() < 0.7):
        north_m, east_m, radius_m = chance.uniform(-2e3, 8e3), chance.uniform(-4e3, 4e3), chance.uniform(60.0, 900.0)
        if all(math.dist((north_m, east_m), end) > radius_m + 1_200.0 for end in ((0.0, 0.0), (6_000.0, 0.0))):
            discs.append((north_m, east_m, radius_m))
    threats = "\n".join(
        f"- {{id: {k}, north_m: {north_m:.1f}, east_m: {east_m:.1f}, detection_radius_m: {radius_m:.1f}, "
        f"attack_radius_m: {radius_m / 2.0:.1f}, "
        + chance.choice(["speed_bound_m_s: 0, motion: static}"] * 3 + ["speed_bound_m_s: 2, motion: random}"])
        for k, (north_m, east_m, radius_m) in enumerate(discs, 1)
    )
    text = f"""
name: drawn
agents: [{{id: 1, north_m: 0, east_m: 0, heading_deg: {chance.uniform(0.0, 360.0):.0f}, speed_m_s: 40, n_max: 4}}]
targets: [{{id: 1, north_m: 6000, east_m: 0, speed_bound_m_s: 0, motion: static}}]
threats:
{threats}
arrival_radius_m: 100
broadcast_period_s: {chance.choice([1, 5, 20])}
max_time_s: 300
link: {{{link}}}
"""
    return resolve(parse_mission(text, "drawn"), 3)


@pytest.mark.parametrize("packed", [False, True], ids=["state", "packed"])
@settings(max_examples=12, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 2**32 - 1), link=st.sampled_from(sorted(LINKS.values())))
def test_nobody_enters_a_threat_though_revisions_begin_in_flight_and_frames_of_them_are_lost(
    packed: bool, seed: int, link: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    chance = random.Random(seed)

    def restless(revision: Revision, task: Mission, tracks: TrackTable, radii_m: Iterable[float]) -> Revision:
        after = next_revision(revision, task, tracks, radii_m)
        return replace(after, number=(after.number + (chance.random() < 0.1)) % REVISIONS)

    monkeypatch.setattr(ground_station, "next_revision", restless)
    task = drawn(chance, link)
    assert score(flown(task, packed).trajectory, task).threat_entries_detection == 0
