"""Watching that a vehicle comes nearer, and closing a passage that the guard refuses."""

from __future__ import annotations

import math

import numpy as np

from companion.guard.types import Piece
from companion.guidance.progress import Progress, after_closing, patience_s, watched
from companion.guidance.turning_place import Room

PLACE = (1_000.0, 0.0)
GATE = Room(np.array([(500.0, 60.0), (500.0, -60.0)]), np.array([50.0, 50.0]), np.zeros((0, 2)), (), 0.0)
"""Two discs with a passage 20 m wide between them."""
STRAIGHT = (Piece(0.0, 0.0, 0.0, 0.0, 1_000.0),)


def test_coming_nearer_is_progress_and_circling_is_none() -> None:
    progress = watched(None, PLACE, 900.0, False, 5.0, 0.0)
    for t_s, to_go_m in ((1.0, 890.0), (2.0, 899.0), (3.0, 886.0)):
        progress = watched(progress, PLACE, to_go_m, t_s == 2.0, 5.0, t_s)
    assert (progress.least_m, progress.since_s, progress.refused) == (890.0, 1.0, True)
    assert watched(progress, PLACE, 880.0, False, 5.0, 4.0) == Progress(PLACE, 880.0, 4.0)


def test_another_place_is_watched_anew() -> None:
    before = Progress(PLACE, 10.0, 0.0, refused=True)
    assert watched(before, (0.0, 0.0), 900.0, False, 5.0, 50.0) == Progress((0.0, 0.0), 900.0, 50.0)


def test_patience_is_three_circles_and_twenty_steps() -> None:
    assert patience_s(100.0, 20.0, 0.5) == 3.0 * math.tau * 5.0 + 10.0


def test_the_first_narrow_place_on_the_way_is_closed_for_a_while() -> None:
    progress = after_closing(Progress(PLACE, 700.0, 10.0, refused=True), STRAIGHT, GATE, 40.0, 40.0)
    (passage,) = progress.closed
    assert (progress.least_m, progress.since_s, progress.refused) == (math.inf, 40.0, False)
    assert 400.0 < passage.centre_ned_m[0] < 500.0 and passage.centre_ned_m[1] == 0.0
    # It overlaps both sides.
    for disc in GATE.centres_ned_m:
        assert math.dist(passage.centre_ned_m, disc) < passage.radius_m + 50.0
    assert passage.until_s == 40.0 + 20.0 * 30.0
    assert watched(progress, PLACE, 900.0, False, 5.0, 639.0).closed == (passage,)
    assert watched(progress, PLACE, 900.0, False, 5.0, 641.0).closed == ()


def test_where_there_is_room_to_turn_everywhere_nothing_is_closed() -> None:
    open_water = Room(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2)), (), 0.0)
    assert after_closing(Progress(PLACE, 700.0, 10.0), STRAIGHT, open_water, 40.0, 40.0).closed == ()
    assert after_closing(Progress(PLACE, 700.0, 10.0), (), GATE, 40.0, 40.0).closed == ()
