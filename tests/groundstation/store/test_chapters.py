"""Which events a run goes on from: those of the same mission, and none of another one."""

from __future__ import annotations

import pytest

from companion.errors import InputError
from companion.mission.model import Mission, parse_mission
from groundstation.store.chapters import beginning, chapters_in
from groundstation.store.rows import EventRow
from tests.groundstation.store.recorded import MISSION, events, mission, row_of

ROWS = [row_of(event) for event in events()]


def kept_of(mission: Mission) -> dict[str, str]:
    return dict([beginning(mission, {}, ()).chapter.kept])


def test_the_first_run_begins_a_chapter_without_a_word() -> None:
    begun = beginning(mission(), {}, ())
    assert (begun.chapter.first, begun.words, begun.operations.next_number) == (1, "", 1)


def test_the_same_mission_goes_on_with_pins_ids_and_things() -> None:
    begun = beginning(mission(), kept_of(mission()), ROWS)
    assert begun.operations.orders.pins == {2: 7}
    assert [threat.id for threat in begun.operations.mission.threats] == [5]
    assert (begun.chapter.first, begun.operations.next_number) == (1, 5)
    assert begun.words == "goes on after event 4"


def test_another_period_is_no_other_mission() -> None:
    slower = parse_mission(MISSION + "broadcast_period_s: 7\n", "kept")
    begun = beginning(slower, kept_of(mission()), ROWS)
    assert begun.operations.orders.pins == {2: 7}
    assert begun.operations.mission.broadcast_period_s == 7.0


@pytest.mark.parametrize(
    ("was", "now", "key"),
    [
        ("name: kept", "name: other", "name"),
        ("12000, east_m: 0", "12500, east_m: 0", "targets"),
        ("900,", "901,", "threats"),
        ("id: 2, north_m: 0", "id: 2, north_m: 9", "agents"),
        ("[-2000, -2000]", "[-2001, -2000]", "fence"),
        ("fence:", "case: II\nfence:", "case"),
        ("fence:", "origin: {lat_deg: 48, lon_deg: 8}\nfence:", "origin"),
        ("fence:", "exclusions: [[[9000, 0], [9000, 99], [9099, 0]]]\nfence:", "exclusions"),
    ],
)
def test_other_things_begin_a_chapter_that_carries_nothing_over_and_says_so(was: str, now: str, key: str) -> None:
    other = parse_mission(MISSION.replace(was, now), "kept")
    begun = beginning(other, kept_of(mission()), ROWS)
    assert begun.operations.orders.pins == {}
    assert begun.operations.mission == other
    assert (begun.chapter.first, begun.operations.next_number) == (5, 5)
    assert begun.words.startswith(
        f"{key} of {other.name} differ from the last run's: 4 events are kept but not carried over"
    )


def test_a_new_flight_of_the_same_mission_begins_a_chapter_when_it_is_asked_for() -> None:
    begun = beginning(mission(), kept_of(mission()), ROWS, anew=True)
    assert (begun.chapter.first, begun.operations.orders.pins) == (5, {})
    assert begun.words.startswith("a new flight: 4 events are kept, and nothing")
    both = kept_of(mission()) | dict([begun.chapter.kept])
    assert [chapter.first for chapter in chapters_in(both)] == [1, 5]
    assert beginning(mission(), both, ROWS).operations.orders.pins == {}


def test_an_event_of_a_later_release_is_refused_by_its_number() -> None:
    rows = [*ROWS, EventRow(5, 0.0, "anna", "unheard-of", '{"event": "unheard-of", "number": 5}')]
    with pytest.raises(InputError, match="event 5, 'unheard-of', is not understood by this release"):
        beginning(mission(), kept_of(mission()), rows)
