"""What is believed of sightings: everything that can be true, and of the rest nothing."""

from __future__ import annotations

import cmath
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.mission.model import parse_mission
from companion.protocol.codec import Detection, DetectionsFrame, FrameReader, FrameWriter, Kind, StateFrame
from groundstation.filter import Motion, Noise
from groundstation.ground_station import GroundStation
from groundstation.plausibility import SENSOR_ERROR_M, SLACK_S, Bound, Known, Sample, Verdict, Weighed, weigh

ERROR_M = SENSOR_ERROR_M
SPEED_M_S = 10.0
BOUND = Bound(SPEED_M_S, Noise(ERROR_M, 2.0 * SPEED_M_S))
UNGATED = BOUND._replace(is_gated=False)
START_S = 1_790_000_000.0
MISSION = parse_mission(
    """
name: bounds
origin: {lat_deg: 47.0, lon_deg: 8.0}
agents: [{id: 1, north_m: 0, east_m: 0, speed_m_s: 20}]
targets: [{id: 1, north_m: 5000, east_m: 0, speed_bound_m_s: 2}]
threats:
- {id: 1, north_m: 2000, east_m: 0, detection_radius_m: 300, attack_radius_m: 100, speed_bound_m_s: 0}
- {id: 2, north_m: -2000, east_m: 900, detection_radius_m: 300, attack_radius_m: 100, speed_bound_m_s: 5}
""",
    "bounds",
)


def seen(bound: Bound = BOUND) -> Known:
    """Return what is known of a thing that was at the origin, and was seen there."""
    known, _ = weigh(Known.placed(0j, 0.0, bound, 0.0), Sample(0j, 0.0), bound, 0.0)
    return known


def after(known: Known, samples: list[tuple[float, complex]], bound: Bound = BOUND) -> tuple[Known, list[Weighed]]:
    """Return what is known after samples, each a time and a place, that come in at once."""
    weighed = []
    for at_s, place in samples:
        known, one = weigh(known, Sample(place, at_s), bound, at_s)
        weighed.append(one)
    return known, weighed


LEGS = st.lists(
    st.tuples(
        st.floats(0.05, 30.0),
        st.floats(-math.pi, math.pi),
        st.floats(0.0, SPEED_M_S),
        st.floats(0.0, ERROR_M),
        st.floats(-math.pi, math.pi),
    ),
    max_size=30,
)
"""Legs of a way: how long, which way and how fast; and by how much, and which way, the sighting at its end is off."""


@settings(max_examples=40)
@given(LEGS)
def test_nothing_within_its_bounds_is_ever_where_it_cannot_be(legs: list[tuple[float, ...]]) -> None:
    known, at_s, place = seen(), 0.0, 0j
    for lasts_s, heading_rad, speed_m_s, off_m, bearing_rad in legs:
        at_s += lasts_s
        place += cmath.rect(speed_m_s * lasts_s, heading_rad)
        known, one = weigh(known, Sample(place + cmath.rect(off_m, bearing_rad), at_s), BOUND, at_s)
        assert one.verdict is not Verdict.BEYOND
        reach = known.believed.reach
        assert abs(place - reach.place) <= reach.radius_at_m(at_s, BOUND) + 1e-6


FORGED = st.lists(
    st.tuples(st.floats(0.0, 2.0), st.floats(-2e7, 2e7), st.floats(-2e7, 2e7))
    | st.tuples(st.floats(0.0, 2.0), st.floats(-200.0, 200.0), st.floats(-200.0, 200.0)),
    max_size=60,
)


@settings(max_examples=40)
@given(FORGED, st.booleans())
def test_whatever_is_seen_nothing_that_was_seen_is_believed_to_be_faster_than_its_bound(
    forged: list[tuple[float, float, float]], is_gated: bool
) -> None:
    bound = BOUND if is_gated else UNGATED
    known, at_s = seen(bound), 0.0
    for after_s, north_m, east_m in forged:
        at_s += after_s
        known, one = weigh(known, Sample(complex(north_m, east_m), at_s), bound, at_s)
        if one.verdict is Verdict.BELIEVED:
            # Twice the error may be gained once in SLACK_S.
            most_m = 2.0 * ERROR_M * (1.0 + at_s / SLACK_S) + (SPEED_M_S + ERROR_M / SLACK_S) * at_s
            assert abs(complex(north_m, east_m)) <= most_m + 1e-6


def test_ten_thousand_samples_in_a_second_creep_no_farther_than_a_few() -> None:
    known, place = seen(UNGATED), 0j
    for step in range(1, 10_001):
        reach = known.believed.reach
        at_s = step / 10_000.0
        # As far as the narrowed disc gives way a little each time.
        known, _ = weigh(known, Sample(reach.place + 0.02 * ERROR_M, at_s), UNGATED, at_s)
        place = known.believed.reach.place
    assert abs(place) <= 2.0 * ERROR_M + SPEED_M_S + 2.0 * ERROR_M / SLACK_S


@settings(max_examples=20)
@given(FORGED)
def test_what_stands_stands_whatever_is_seen(forged: list[tuple[float, float, float]]) -> None:
    bound = Bound(0.0, Noise(ERROR_M, 0.0))
    known, weighed = after(seen(bound), [(at_s, complex(*place)) for at_s, *place in forged], bound)
    assert known.believed.motion.place == 0j
    for one, (_, *place) in zip(weighed, forged, strict=True):
        assert (one.verdict is Verdict.BELIEVED) == (abs(complex(*place)) <= ERROR_M)


@settings(max_examples=10)
@given(st.lists(st.tuples(st.floats(-500.0, -100.0), st.floats(-500.0, 500.0)), min_size=2, max_size=2))
def test_a_thing_that_is_seen_every_second_is_followed_though_others_say_it_is_elsewhere(
    forged: list[tuple[float, float]],
) -> None:
    known = seen()
    for step in range(1, 60):
        place = complex(0.8 * SPEED_M_S * step, 0.0)
        known, _ = after(known, [(step - 0.6, complex(*forged[0])), (step - 0.3, complex(*forged[1])), (step, place)])
        assert abs(known.believed.motion.place - place) <= ERROR_M


def test_a_jump_is_believed_when_three_sightings_show_it_and_the_old_track_is_silent() -> None:
    jump = [(float(t_s), 280.0 + 0j) for t_s in (20, 21, 22)]
    known, weighed = after(seen(), [(1.0, 0j), (2.0, 0j), *jump])
    assert [one.verdict for one in weighed[2:]] == [Verdict.JUMP, Verdict.JUMP, Verdict.BELIEVED]
    assert weighed[-1].replaced
    assert known.believed.motion.place == pytest.approx(280.0, abs=1.0)


def test_a_jump_is_not_believed_while_the_old_track_is_seen() -> None:
    both = [(2.0 + 0.5 * step, (280.0 + 0j) * (step % 2)) for step in range(40)]
    known, weighed = after(seen(), [(1.0, 0j), *both])
    assert known.believed.motion.place == pytest.approx(0.0, abs=ERROR_M)
    assert {one.verdict for one in weighed[2::2]} == {Verdict.BEYOND}


def test_a_jump_beyond_the_bounds_is_never_believed_of_what_was_seen() -> None:
    known, weighed = after(seen(), [(1.0, 0j), *((2.0 + 0.1 * step, 5_000.0 + 0j) for step in range(100))])
    assert {one.verdict for one in weighed[1:]} == {Verdict.BEYOND}
    assert known.believed.motion.place == 0j
    assert len(known.suspects) == 1


def test_a_thing_that_was_never_seen_may_be_elsewhere_than_the_mission_says() -> None:
    never = Known.placed(0j, 0.0, BOUND, 0.0)
    known, weighed = after(never, [(float(t_s), 9_000.0 + 0j) for t_s in (1, 2, 3)])
    assert [one.verdict for one in weighed] == [Verdict.BEYOND, Verdict.BEYOND, Verdict.BELIEVED]
    assert known.believed.motion.place == pytest.approx(9_000.0, abs=1.0)


def test_one_datagram_is_no_three() -> None:
    never = Known.placed(0j, 0.0, BOUND, 0.0)
    known, _ = after(never, [(1.0, 9_000.0 + 0j)] * 20)
    assert known.believed.motion.place == 0j


def test_a_bad_sample_is_left_within_seconds_of_the_next_good_ones() -> None:
    good = [(float(t_s), 0j) for t_s in range(1, 10)]
    known, _ = after(seen(), [*good, (10.0, 38.0 + 0j)])
    assert known.believed.motion.place.real > 15.0
    known, _ = after(known, [(11.0 + step, 0j) for step in range(6)])
    assert abs(known.believed.motion.place) <= 5.0


def test_suspects_are_few() -> None:
    known, _ = after(seen(), [(0.01 * step, complex(1e4 * step, 0.0)) for step in range(1, 500)])
    assert len(known.suspects) == 4


@settings(max_examples=15)
@given(st.floats(0.5, 9.0), st.floats(-9.0, 9.0), st.floats(-9.0, 9.0))
def test_the_filter_expects_what_keeps_its_velocity_where_it_goes(
    dt_s: float, north_m_s: float, east_m_s: float
) -> None:
    dt_s, velocity = round(dt_s, 3), complex(north_m_s, east_m_s)
    motion = Motion.begun(0j, 0.0, BOUND.noise, SPEED_M_S)
    for step in range(1, 40):
        motion = motion.updated(velocity * dt_s * step, dt_s * step, BOUND.noise)
    assert motion.expected(dt_s * 40) == pytest.approx(velocity * dt_s * 40, abs=0.5)
    assert ERROR_M <= motion.gate_m(dt_s * 40, BOUND.noise)


def told(station: GroundStation, t_s: float) -> StateFrame:
    """Return what a station broadcasts at a time."""
    frames = [frame for raw in station.tick(START_S + t_s) for frame in FrameReader().read(raw)]
    (state,) = [frame for frame in frames if isinstance(frame, StateFrame)]
    return state


DETECTIONS = st.lists(
    st.builds(
        Detection,
        st.sampled_from(Kind),
        st.integers(1, 3),
        st.floats(-2e7, 2e7) | st.floats(-3_000.0, 3_000.0),
        st.floats(-2e7, 2e7) | st.floats(-3_000.0, 3_000.0),
        st.floats(-300.0, 300.0),
        st.floats(-300.0, 300.0),
    ),
    min_size=1,
    max_size=6,
)


@settings(max_examples=25, deadline=None)
@given(DETECTIONS, st.integers(-40_000, 40_000), st.sampled_from([(47.0, 8.0), (47.1, 8.3), (-80.0, 170.0)]))
def test_no_single_datagram_changes_what_is_broadcast_by_more_than_the_bounds_allow(
    detections: list[Detection], stamped_ms: int, origin_deg: tuple[float, float]
) -> None:
    station = GroundStation(MISSION, START_S)
    before = told(station, 0.0)
    stamped_ms = max(0, 50_000 + stamped_ms)
    frame = DetectionsFrame(int(START_S) - 40, stamped_ms, *origin_deg, tuple(detections))
    station.sense(FrameWriter(254, 191).encode(frame), START_S + 10.0)
    after_it = told(station, 10.0)
    moved = {
        one.id: math.dist((one.north_m, one.east_m), (was.north_m, was.east_m))
        for one, was in zip(after_it.threats, before.threats, strict=True)
    }
    assert moved[1] == 0.0
    assert moved[2] <= 5.0 * 10.0 + 3.0 * ERROR_M
    assert [target.id for target in after_it.targets] == [1]
    assert station.tracks.flown_m[1] <= 30.0 * 10.0
    assert station.tracks.progress.completed == frozenset()
