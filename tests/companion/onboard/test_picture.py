"""Which threats are still missing: counted by revision, never by luck, and never too few."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.onboard.picture import Picture
from companion.protocol.messages import REVISIONS


def told(revision: int, sequence: int, threats: int | None, *heard: int) -> Picture:
    picture = Picture()
    return tell(picture, revision, sequence, threats, *heard)


def tell(picture: Picture, revision: int, sequence: int, threats: int | None, *heard: int) -> Picture:
    assert not picture.is_old(revision, sequence)
    picture.follow(revision, sequence)
    if threats is not None:
        picture.count(threats)
    picture.hear(heard)
    return picture


def test_before_anything_is_heard_nothing_is_whole_and_nothing_is_missed() -> None:
    assert not Picture().whole
    assert Picture().missing is None


def test_a_picture_without_threats_is_whole_at_once() -> None:
    assert told(1, 1, 0).whole


def test_it_says_how_many_threats_were_heard_of_how_many() -> None:
    picture = told(1, 1, 5, 1, 2, 7)
    assert (picture.whole, picture.missing) == (False, "3 of 5 threats heard")
    tell(picture, 1, 2, 5, 2, 3, 4)
    assert (picture.whole, picture.missing) == (True, None)


def test_while_the_number_of_threats_is_not_known_the_picture_is_not_whole() -> None:
    picture = told(1, 1, None, 1, 2)
    assert (picture.whole, picture.missing) == (False, "2 threats heard, of how many is not known")


def test_a_new_revision_voids_what_was_whole_and_says_so() -> None:
    picture = told(1, 1, 1, 1)
    tell(picture, 2, 2, 6)
    assert (picture.whole, picture.missing) == (False, "new revision: 0 of 6 threats heard")


def test_a_new_epoch_voids_it_though_its_revision_has_the_same_number() -> None:
    picture = told(1, 1, 1, 1)
    picture.begin_epoch()
    assert picture.missing is None
    tell(picture, 1, 1, 1)
    assert picture.missing == "new revision: 0 of 1 threats heard"


def test_the_same_revision_in_later_broadcasts_voids_nothing() -> None:
    picture = told(7, 1, 1, 1)
    assert not picture.follow(7, 2)
    assert not picture.follow(7, 2 + REVISIONS - 1)
    assert picture.whole


def test_a_number_that_may_have_come_round_while_nothing_was_heard_is_another_revision() -> None:
    picture = told(7, 1, 1, 1)
    assert picture.follow(7, 1 + REVISIONS)
    assert not picture.whole


@pytest.mark.parametrize(
    ("revision", "sequence", "old"),
    [(6, 9, True), (8, 9, True), (7, 9, False), (8, 10, False), (8, 11, False), (6, 11, False), (7, 10 - 256, True)],
)
def test_a_frame_of_an_earlier_broadcast_and_another_revision_is_old(revision: int, sequence: int, old: bool) -> None:
    assert told(7, 10, 1).is_old(revision, sequence) is old


def test_the_same_digest_counts_what_was_heard_of_the_picture_before() -> None:
    picture = told(1, 1, 2, 1, 2)
    assert not picture.name(b"mission1")
    picture.begin_epoch()
    tell(picture, 1, 1, 2)
    assert not picture.whole
    assert not picture.name(b"mission1")
    assert picture.whole


def test_another_digest_counts_nothing_of_it() -> None:
    picture = told(1, 1, 2, 1, 2)
    picture.name(b"mission1")
    picture.begin_epoch()
    tell(picture, 1, 1, 2)
    assert picture.name(b"mission2")
    assert picture.missing == "new revision: 0 of 2 threats heard"


def test_a_threat_told_otherwise_in_between_does_not_count_for_the_first_digest() -> None:
    picture = told(1, 1, 2, 1, 2)
    picture.name(b"mission1")
    picture.begin_epoch()
    tell(picture, 1, 1, 3, 2)
    picture.begin_epoch()
    tell(picture, 1, 1, 2)
    picture.name(b"mission1")
    assert picture.missing == "new revision: 1 of 2 threats heard"


def test_what_was_forgotten_counts_for_nothing() -> None:
    picture = told(1, 1, 1, 1)
    picture.name(b"mission1")
    picture.begin_epoch()
    picture.forget()
    tell(picture, 1, 1, 1)
    picture.name(b"mission1")
    assert not picture.whole


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(1, 4)), max_size=30))
def test_it_is_whole_exactly_when_all_ids_of_the_revision_in_force_were_heard(frames: list[tuple[int, int]]) -> None:
    """Each frame raises the revision by so many and brings one of four ids."""
    picture, number, heard = Picture(), 1, set[int]()
    for sequence, (step, threat) in enumerate(frames, 1):
        if step == 3:
            number, heard = number + 1, set()
        heard.add(threat)
        tell(picture, number % REVISIONS, sequence, 4, threat)
        assert picture.whole == (heard == {1, 2, 3, 4})
