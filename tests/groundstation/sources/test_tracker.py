"""Which sightings become things of the picture, for how long, and in which batches."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.protocol.codec import Kind
from groundstation.sources.sighting import Category, Datum
from groundstation.sources.tracker import BATCH_S, RETIRED_WITHIN_S, Dropped, Taken, Tracker
from tests.groundstation.sources.given import START_S, mission, sighting, spec

AGENTS = [0j]
FAR_M = 15_000.0
"""A place that nothing here reaches before the next batch."""


def tracker(*specs: Any, agents: str = "") -> Tracker:  # noqa: ANN401 - SourceSpec or its keys
    made = [one if not isinstance(one, dict) else spec(**one) for one in specs or ({},)]
    return Tracker(mission(agents=agents), made)


def see(sky: Tracker, key: str, north_m: float, t_s: float, source: str = "s", **more: Any) -> Any:  # noqa: ANN401
    return sky.take(source, sighting(key, north_m, more.pop("east_m", 0.0), START_S + t_s, **more), START_S + t_s)


def wanted(sky: Tracker, t_s: float, failed: tuple[str, ...] = ()) -> list[Taken | Dropped]:
    return sky.due(AGENTS, 0.0, START_S + t_s, failed)


def take_in(sky: Tracker, t_s: float, first_id: int = 10) -> list[Taken]:
    taken = [one for one in wanted(sky, t_s) if isinstance(one, Taken)]
    for number, one in enumerate(taken):
        sky.taken(one, one.id or first_id + number, is_listed=False)
    return taken


def test_an_aircraft_is_taken_in_when_two_sightings_agree_and_moves_from_then_on() -> None:
    sky = tracker()
    see(sky, "A", FAR_M, 0.0, velocity=50j)
    assert wanted(sky, 0.0) == []
    assert see(sky, "A", FAR_M, 1.0, velocity=50j) is None
    (one,) = take_in(sky, 1.0)
    assert (one.kind, one.is_new, one.key) == (Kind.THREAT, True, ("s", "A"))
    moved = see(sky, "A", FAR_M, 2.0, velocity=50j)
    assert (moved.kind, moved.id, moved.source) == (Kind.THREAT, 10, "s")
    assert moved.place.real == pytest.approx(FAR_M, abs=1.0)


def test_what_comes_within_a_batch_waits_for_the_next_one() -> None:
    sky = tracker()
    for t_s in (0.0, 1.0):
        see(sky, "A", FAR_M, t_s)
    assert len(take_in(sky, 1.0)) == 1
    for t_s in (2.0, 3.0):
        see(sky, "B", -FAR_M, t_s)
        see(sky, "C", FAR_M, t_s, east_m=900.0)
    assert wanted(sky, 3.0) == []
    assert len(take_in(sky, 1.0 + BATCH_S)) == 2


def test_a_threat_that_could_reach_an_agent_before_the_next_batch_does_not_wait_and_takes_the_others_along() -> None:
    sky = tracker()
    for t_s in (0.0, 1.0):
        see(sky, "A", FAR_M, t_s)
    take_in(sky, 1.0)
    for t_s in (2.0, 3.0):
        see(sky, "B", 1_500.0 - 60.0 * t_s, t_s, velocity=-60 + 0j)
        see(sky, "C", -FAR_M, t_s)
    assert {one.key.key for one in take_in(sky, 3.0)} == {"B", "C"}


def test_a_thing_that_is_not_seen_any_more_is_retired_and_told_why() -> None:
    sky = tracker()
    for t_s in range(5):
        see(sky, "A", FAR_M, float(t_s))
        see(sky, "B", -FAR_M, float(t_s))
        take_in(sky, float(t_s))
    for t_s in range(5, 80):
        see(sky, "B", -FAR_M, float(t_s))
    (gone,) = wanted(sky, 79.0)
    assert isinstance(gone, Dropped)
    assert (gone.key.key, gone.why) == ("A", "not seen for 75 s")
    sky.dropped(gone)
    assert sky.things("s", START_S) == 1


def test_retiring_waits_for_a_batch_but_not_for_ever() -> None:
    sky = tracker({"timeout_s": 10.0})
    for t_s in range(60):
        see(sky, "B", -FAR_M, float(t_s))
        if t_s < 3:
            see(sky, "A", FAR_M, float(t_s))
        if t_s < 2:
            take_in(sky, float(t_s))
    assert wanted(sky, 12.0 + RETIRED_WITHIN_S - 5.0) == []
    assert [type(one) for one in wanted(sky, 12.0 + RETIRED_WITHIN_S + 1.0)] == [Dropped]


@pytest.mark.parametrize("failed", [(), ("s",)])
def test_while_a_source_is_deaf_its_things_stay_three_times_as_long(failed: tuple[str, ...]) -> None:
    sky = tracker()
    for t_s in range(3):
        for key in ("A",) if failed else ("A", "B"):
            see(sky, key, FAR_M, float(t_s))
        take_in(sky, float(t_s))
    assert wanted(sky, 70.0, failed) == []
    assert wanted(sky, 91.0 + 2.0 + RETIRED_WITHIN_S, failed) != []


def test_a_thing_of_cot_stays_until_the_time_that_its_event_names() -> None:
    sky = tracker({"kind": "cot", "url": "udpin:127.0.0.1:1", "timeout_s": 10.0})
    see(sky, "A", FAR_M, 0.0, until_s=START_S + 300.0)
    take_in(sky, 0.0)
    assert wanted(sky, 299.0) == []
    assert wanted(sky, 301.0 + RETIRED_WITHIN_S) != []


def test_only_what_is_near_enough_is_taken_in_and_it_leaves_farther_out() -> None:
    sky = tracker({"within_m": 5_000.0})
    # The mission's box ends with its target, 3 km north.
    for t_s in (0.0, 1.0):
        see(sky, "far", 8_500.0, t_s)
        see(sky, "near", 7_500.0, t_s)
    assert [one.key.key for one in take_in(sky, 1.0)] == ["near"]
    for t_s in range(2, 16):
        see(sky, "near", 7_500.0 + 75.0 * (t_s - 1), float(t_s), velocity=75 + 0j)
    for t_s in range(16, 70):
        see(sky, "near", 8_550.0, float(t_s))
    assert wanted(sky, 69.0) == [], "it is outside, but not by enough to leave"
    for t_s in range(70, 90):
        see(sky, "near", 8_550.0 + 75.0 * (t_s - 69), float(t_s), velocity=75 + 0j)
    gone = wanted(sky, 89.0 + RETIRED_WITHIN_S)
    assert [one.why for one in gone if isinstance(one, Dropped)] == ["too far away, too high or too low"]


@pytest.mark.parametrize(
    ("altitude_m", "datum", "counts"),
    [
        (900.0, Datum.MEAN_SEA_LEVEL, True),
        (1_050.0, Datum.MEAN_SEA_LEVEL, False),
        (1_050.0, Datum.ELLIPSOID, True),
        (1_350.0, Datum.PRESSURE, True),
        (1_450.0, Datum.PRESSURE, False),
        (None, Datum.PRESSURE, True),
    ],
)
def test_a_height_counts_by_what_its_datum_may_be_off(altitude_m: float | None, datum: Datum, counts: bool) -> None:
    sky = tracker({"ceiling_m": 1_000.0})
    for t_s in (0.0, 1.0):
        see(sky, "A", FAR_M, t_s, altitude_m=altitude_m, datum=datum)
    assert bool(wanted(sky, 1.0)) is counts


def test_a_sudden_jump_moves_nothing_until_it_is_confirmed_and_is_counted() -> None:
    sky = tracker()
    for t_s in range(10):
        see(sky, "A", FAR_M, float(t_s))
        take_in(sky, float(t_s))
    assert see(sky, "A", FAR_M - 4_000.0, 10.0) is None
    assert sky.doubts.refused["s"] == 1
    assert see(sky, "A", FAR_M, 11.0) is not None
    seen = [see(sky, "A", FAR_M - 1_500.0, 12.0 + t_s) for t_s in range(8)]
    assert seen[0] is None
    assert seen[-1] is not None
    assert seen[-1].place.real == pytest.approx(FAR_M - 1_500.0, abs=20.0)


def test_a_duplicate_and_a_late_sighting_move_nothing_back() -> None:
    sky = tracker()
    for t_s in range(5):
        see(sky, "A", FAR_M + 100.0 * t_s, float(t_s), velocity=100 + 0j)
        take_in(sky, float(t_s))
    late = sighting("A", FAR_M + 200.0, 0.0, START_S + 2.0, velocity=100 + 0j)
    assert sky.take("s", late, START_S + 5.0) is None
    again = see(sky, "A", FAR_M + 400.0, 4.0, velocity=100 + 0j)
    assert again.place.real == pytest.approx(FAR_M + 400.0, abs=1.0)
    assert sky.doubts.refused["s"] == 0


@pytest.mark.parametrize(("off_s", "word"), [(60.0, "60.0 s ahead"), (-300.0, "300.0 s behind")])
def test_a_source_whose_clock_is_wrong_is_refused_and_told_by_how_much(off_s: float, word: str) -> None:
    sky = tracker({"kind": "cot"})
    assert sky.take("s", sighting("A", FAR_M, 0.0, START_S + off_s), START_S) is None
    assert sky.doubts.refused["s"] == 1
    assert word in sky.doubts.news(START_S)[0]


def test_a_velocity_that_nothing_has_is_not_believed_and_makes_no_wide_disc() -> None:
    sky = tracker()
    for t_s in (0.0, 1.0):
        assert see(sky, "A", FAR_M, t_s, velocity=1_500 + 0j) is None
    assert wanted(sky, 1.0) == []
    assert "1500 m/s" in sky.doubts.news(START_S)[0]


def test_an_agent_at_the_other_end_of_the_world_does_not_move_there() -> None:
    sky = tracker({"kind": "telemetry"})
    assert see(sky, "1", 9.0e6, 0.0) is None
    assert "9" in sky.doubts.news(START_S)[0]
    assert see(sky, "1", 100.0, 1.0) is not None


def test_a_thing_that_says_to_count_for_years_counts_for_a_day() -> None:
    sky = tracker({"kind": "cot"})
    see(sky, "A", FAR_M, 0.0, until_s=START_S + 1e9)
    take_in(sky, 0.0)
    assert wanted(sky, 86_000.0) == []
    assert wanted(sky, 90_000.0) != []


def test_the_computers_clock_that_was_set_does_not_make_a_sources_stamps_wrong() -> None:
    sky = tracker({"kind": "cot"})
    sky.ahead_s = 3_600.0
    sky.take("s", sighting("A", FAR_M, 0.0, START_S + 3_600.0), START_S)
    assert sky.doubts.refused["s"] == 0


def test_a_thing_that_two_sources_see_is_one_threat_and_stays_it_when_one_of_them_falls_silent() -> None:
    sky = tracker({"name": "s"}, {"name": "t", "kind": "basestation"})
    for t_s in range(3):
        see(sky, "A", FAR_M, float(t_s))
        assert see(sky, "A", FAR_M, float(t_s), source="t") is None
    assert [one.key.source for one in take_in(sky, 2.0)] == ["s"]
    for t_s in range(3, 95):
        assert see(sky, "A", FAR_M, float(t_s), source="t") is None
        for one in wanted(sky, float(t_s)):
            assert isinstance(one, Dropped)
            assert one.heir == ("t", "A")
            sky.dropped(one)
            assert see(sky, "A", FAR_M, float(t_s) + 0.5, source="t").id == 10
            return
    pytest.fail("the second source did not go on")


def test_of_an_agent_that_two_sources_see_the_second_one_moves_it_only_when_the_first_is_silent() -> None:
    sky = tracker(
        spec(name="s", kind="telemetry"), spec(name="t", kind="jsonl", url=None, file="x", **{"as": "agents"})
    )
    assert see(sky, "1", 0.0, 0.0) is not None
    assert see(sky, "1", 0.0, 0.5, source="t") is None
    assert sky.doubts.refused["t"] == 1
    assert see(sky, "1", 0.0, 10.0, source="t") is not None


def test_an_agent_that_the_mission_does_not_have_is_counted_and_told() -> None:
    sky = tracker({"kind": "telemetry"})
    for t_s in range(3):
        assert see(sky, "77", 100.0, float(t_s)) is None
    (unknown,) = sky.unknown()
    assert (unknown.id, unknown.times, unknown.source) == (77, 3, "s")
    assert "77" in sky.doubts.news(START_S)[0]


def test_keys_to_ignore_are_never_taken_in() -> None:
    sky = tracker({"ignore": ["a"]})
    for t_s in (0.0, 1.0):
        assert see(sky, "A", FAR_M, t_s) is None
    assert wanted(sky, 1.0) == []


def test_of_too_many_things_the_nearest_are_in_the_picture_and_a_nearer_one_takes_the_place_of_the_farthest() -> None:
    sky = tracker({"most": 2})
    for t_s in (0.0, 1.0):
        for number in range(4):
            see(sky, f"A{number}", FAR_M + 500.0 * number, t_s)
    assert {one.key.key for one in take_in(sky, 1.0)} == {"A0", "A1"}
    for t_s in range(2, 24):
        for number in range(4):
            see(sky, f"A{number}", FAR_M + 500.0 * number, float(t_s))
        see(sky, "B", -8_000.0, float(t_s))
    drop, take = wanted(sky, 23.0)
    assert (drop.key.key, take.key.key) == ("A1", "B")


def test_a_flood_of_keys_does_not_grow_without_bound_nor_push_out_what_is_in_the_picture() -> None:
    sky = tracker({"most": 2})
    for t_s in (0.0, 1.0):
        see(sky, "A", FAR_M, t_s)
    take_in(sky, 1.0)
    for number in range(200):
        see(sky, f"flood {number}", -FAR_M, 1.5)
    assert sky.things("s", START_S) == 1
    assert len(sky._tables["s"]) <= 8  # noqa: SLF001 - the bound itself
    assert any("at once" in line for line in sky.doubts.news(START_S))


def test_what_an_operator_has_retired_is_not_taken_in_again_until_it_has_timed_out() -> None:
    sky = tracker()
    for t_s in (0.0, 1.0):
        see(sky, "A", FAR_M, t_s)
    take_in(sky, 1.0)
    sky.follow(mission())
    for t_s in range(2, 60):
        assert see(sky, "A", FAR_M, float(t_s)) is None
        assert wanted(sky, float(t_s)) == []
    ended = [one for t_s in range(95, 130) for one in wanted(sky, float(t_s))]
    for one in ended[:1]:
        assert isinstance(one, Dropped)
        sky.dropped(one)
    for t_s in (150.0, 151.0):
        see(sky, "A", FAR_M, t_s)
    assert len(take_in(sky, 151.0)) == 1


def test_ids_stay_over_a_restart_of_the_ground_station() -> None:
    there = mission(more="threats: [{id: 10, north_m: 9, east_m: 9, radius_m: 9, speed_bound_m_s: 100}]")
    sky = tracker()
    sky.restore({("s", "A"): (Kind.THREAT, 10), ("s", "B"): (Kind.THREAT, 11)}, there, START_S)
    assert see(sky, "A", FAR_M, 1.0).id == 10
    assert see(sky, "B", FAR_M, 1.0) is None
    assert see(sky, "B", FAR_M, 2.0) is None
    assert wanted(sky, 2.0) == [], "B was retired by hand in the last run"
    for t_s in range(2, 150):
        see(sky, "B", FAR_M, float(t_s))
    gone = [one for one in wanted(sky, 150.0) if isinstance(one, Dropped)]
    assert [one.id for one in gone] == [10], "what was taken in before the restart is retired as any other"


@pytest.mark.parametrize(
    ("category", "speed_m_s", "bound_m_s"),
    [
        (Category.AIRCRAFT, None, 255.0),
        (Category.AIRCRAFT, 40.0, 100.0),
        (Category.AIRCRAFT, 90.0, 255.0),
        (Category.AIRCRAFT, 250.0, 300.0),
        (Category.AIRCRAFT, 290.0, 350.0),
        (Category.SHIP, None, 25.0),
        (Category.SHIP, 5.0, 15.0),
        (Category.SHIP, 30.0, 50.0),
        (Category.VEHICLE, 10.0, 20.0),
    ],
)
def test_a_bound_is_by_the_category_and_never_less_than_the_velocity_that_is_told(
    category: Category, speed_m_s: float | None, bound_m_s: float
) -> None:
    sky = tracker()
    velocity = None if speed_m_s is None else complex(0.0, speed_m_s)
    for t_s in (0.0, 1.0):
        see(sky, "A", FAR_M, t_s, velocity=velocity, category=category)
    (one,) = take_in(sky, 1.0)
    assert one.bound_m_s == bound_m_s


@given(st.floats(0.0, 600.0))
def test_no_threat_is_faster_than_its_bound(speed_m_s: float) -> None:
    sky = tracker({"speed_bound_m_s": 50.0})
    for t_s in (0.0, 1.0):
        see(sky, "A", FAR_M + speed_m_s * t_s, t_s, velocity=complex(speed_m_s, 0.0))
    (one,) = take_in(sky, 1.0)
    assert one.bound_m_s >= speed_m_s


def test_a_thing_that_becomes_faster_than_its_bound_is_told_so_with_the_next_batch() -> None:
    sky = tracker()
    north_m = FAR_M
    for t_s in range(60):
        speed_m_s = min(120.0, 40.0 + 5.0 * t_s)
        north_m += speed_m_s
        see(sky, "A", north_m - 6_000.0, float(t_s), velocity=complex(speed_m_s, 0.0))
        for one in take_in(sky, float(t_s)):
            if not one.is_new:
                assert one.bound_m_s == 255.0
                return
    pytest.fail("its bound stayed")


@settings(max_examples=30, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from("ABC"), st.floats(-3e4, 3e4), st.floats(-3e4, 3e4), st.floats(-50, 50), st.floats(0, 300)
        ),
        max_size=30,
    )
)
def test_whatever_is_sighted_at_most_so_many_things_are_in_the_picture_and_places_are_finite(
    seen: list[tuple[str, float, float, float, float]],
) -> None:
    sky = tracker({"most": 2})
    for number, (key, north_m, east_m, off_s, speed_m_s) in enumerate(seen):
        now_s = START_S + number
        one = sighting(key, north_m, east_m, now_s + off_s, velocity=complex(speed_m_s, 0.0))
        moved = sky.take("s", one, now_s)
        assert moved is None or abs(moved.place) < 1e7
        take_in(sky, float(number), first_id=10 * (number + 1))
        assert sky.things("s", START_S) <= 2
