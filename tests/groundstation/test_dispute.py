"""Sightings that contradict each other: neither is believed, and the disc holds the thing wherever it is."""

from __future__ import annotations

import cmath
import math

from hypothesis import example, given, settings
from hypothesis import strategies as st

from companion.mission.model import parse_mission
from companion.protocol.codec import Detection, DetectionsFrame, Kind
from groundstation.dispute import UNDISPUTED_S
from groundstation.plausibility import SENSOR_ERROR_M
from groundstation.tracks import TrackTable

START_S = 1_790_000_000.0
SPEED_M_S = 5.0
AGAIN_S = 10.0
"""Time after a forger's last word in which the sensor is believed again, though it first seems to agree with him."""
MISSION = parse_mission(
    """
name: dispute
origin: {lat_deg: 47.0, lon_deg: 8.0}
agents: [{id: 1, north_m: 0, east_m: 0, speed_m_s: 20}]
targets: [{id: 1, north_m: 5000, east_m: 0, speed_bound_m_s: 2}]
threats: [{id: 2, north_m: 0, east_m: 0, detection_radius_m: 300, attack_radius_m: 100, speed_bound_m_s: 5}]
""",
    "dispute",
)


class Field:
    """A ground station's tracks, and what it is told of threat 2, or of another thing."""

    def __init__(self, key: tuple[Kind, int] = (Kind.THREAT, 2)) -> None:
        self.key = key
        self.tracks = TrackTable(MISSION, START_S, 30.0)

    def see(self, place: complex, t_s: float) -> None:
        detection = Detection(*self.key, place.real, place.imag, 0.0, 0.0)
        frame = DetectionsFrame(int(START_S), round(1000.0 * t_s), 47.0, 8.0, (detection,))
        self.tracks.take(frame, START_S + t_s)

    def off_m(self, truth: complex) -> float:
        """Return how far the track is from the truth."""
        return abs(complex(*self.tracks.tracks[self.key].position_ned_m) - truth)

    def outside_m(self, truth: complex, t_s: float) -> float:
        """Return how far outside its disc, as it has grown by its bound, a thing is."""
        return self.off_m(truth) - SPEED_M_S * self.tracks.tracks[self.key].age_s(START_S + t_s)


FORGED = st.one_of(
    st.builds(lambda to_m_s, heading: ("away", cmath.rect(to_m_s, heading)), st.floats(0, 6), st.floats(-3.1, 3.1)),
    st.builds(lambda off_m, heading: ("beside", cmath.rect(off_m, heading)), st.floats(0, 400), st.floats(-3.1, 3.1)),
    st.builds(lambda off_m, heading: ("leaps", cmath.rect(off_m, heading)), st.floats(0, 300), st.floats(-3.1, 3.1)),
)
"""What a forger says: that the thing goes another way from where it was, is beside its true place, or leaps about."""


def lie(forged: tuple[str, complex], truth: complex, step: int) -> complex:
    """Return where a forger says that a thing is, at a step of 0.1 s since he began."""
    how, by = forged
    if how == "away":
        return 4.0 * SPEED_M_S + 0j + by * 0.1 * step
    return truth + (by if how == "beside" or step % 3 else -by)


@settings(max_examples=40, deadline=None)
@given(
    FORGED,
    st.floats(0.0, SPEED_M_S),
    st.floats(-math.pi, math.pi),
    st.sampled_from([2, 5, 10]),
    st.sampled_from([1, 3]),
    st.floats(0.0, 1.0),
)
@example(("away", -5j), SPEED_M_S, math.pi / 2.0, 2, 1, 0.0)
@example(("away", -4j), 3.0, math.pi / 2.0, 10, 1, 1.0)
@example(("away", 3.0 + 0j), SPEED_M_S, math.pi, 2, 3, 0.5)
def test_whatever_a_forger_says_the_disc_holds_the_thing_and_the_sensor_is_believed_soon_after_him(
    forged: tuple[str, complex], speed_m_s: float, heading_rad: float, every: int, forged_every: int, noise: float
) -> None:
    field, truth, warm, ends, last = Field(), 0j, 40, 300, 300 + round(10 * AGAIN_S)
    for step in range(last):
        t_s = 0.1 * step
        if step == warm:
            truth = 4.0 * SPEED_M_S + 0j
        if step < warm:
            truth = SPEED_M_S * t_s + 0j
        else:
            truth += cmath.rect(0.1 * speed_m_s, heading_rad)
        error = cmath.rect(noise * SENSOR_ERROR_M, 2.4 * step)
        if step % every == 0:
            field.see(truth + error, t_s)
        if warm <= step < ends and step % forged_every == 0:
            field.see(lie(forged, truth, step - warm), t_s + 0.03)
        # What lies by less than two errors contradicts nothing.
        assert field.outside_m(truth, t_s + 0.04) <= 3.0 * SENSOR_ERROR_M + SPEED_M_S
    assert field.off_m(truth) <= SENSOR_ERROR_M + SPEED_M_S * field.tracks.tracks[field.key].age_s(START_S + 0.1 * last)


def test_a_threat_that_a_forger_drags_away_is_held_and_its_disc_grows() -> None:
    field = Field()
    for step in range(400):
        t_s = 0.1 * step
        if step % 2 == 0:
            field.see(complex(0.0, 3.0 * t_s), t_s)
        if step > 40:
            field.see(complex(0.0, 12.0 - 5.0 * (t_s - 4.0)), t_s + 0.02)
    assert field.outside_m(complex(0.0, 3.0 * 39.9), 39.9) <= 0.0
    (line,) = [line for line in field.tracks.refusals.news(START_S + 40.0) if "contradict" in line]
    assert line.startswith("sensor: sightings of threat 2 contradict each other by ")
    assert "held at its last undisputed place, and its disc grows" in line
    for step in range(400, 400 + round(10 * UNDISPUTED_S) + 3):
        field.see(complex(0.0, 0.3 * step), 0.1 * step)
    assert field.off_m(complex(0.0, 0.3 * step)) <= SENSOR_ERROR_M


def test_one_bad_sighting_holds_a_thing_for_three_seconds_only() -> None:
    field = Field()
    for step in range(40):
        field.see(0j, 0.5 * step)
        if step == 20:
            field.see(100.0 + 0j, 10.1)
        is_held = field.tracks.tracks[field.key].seen_at_s < START_S + 0.5 * step
        assert is_held == (20 <= step < 20 + 2 * UNDISPUTED_S + 1)


def test_an_agent_whose_place_is_disputed_reaches_nothing_and_is_not_lost() -> None:
    field = Field((Kind.AGENT, 1))
    for step in range(600):
        t_s = 0.5 * step
        north_m = min(4_700.0, 20.0 * t_s)
        field.see(complex(north_m, 0.0), t_s)
        if t_s > 200.0:
            # Nearer with every look, to the target at last.
            field.see(complex(north_m + min(300.0, 10.0 * (t_s - 200.0)), 0.0), t_s + 0.2)
        field.tracks.update(START_S + t_s + 0.3, {1: 1})
    progress = field.tracks.progress
    assert (progress.arrived, progress.lost, progress.completed) == (frozenset(), frozenset(), frozenset())


def test_a_bad_sighting_of_an_agent_takes_no_earlier_arrival_back() -> None:
    field = Field((Kind.AGENT, 1))
    for step in range(540):
        t_s = 0.5 * step
        field.see(complex(min(5_000.0, 20.0 * t_s), 0.0), t_s)
        if step == 530:
            field.see(complex(4_900.0, 0.0), t_s + 0.1)
        field.tracks.update(START_S + t_s + 0.2, {1: 1})
    assert field.tracks.progress.completed == {1}
