"""What a router does over many calls: plans that take several, and plans that are not made again."""

from __future__ import annotations

import math
from collections.abc import Generator

import numpy as np
import pytest

from companion.guidance.route import router as module
from companion.guidance.route.plan import Plan, Way
from companion.guidance.route.router import Departure, Reach, Route, Router, shortest_route
from companion.guidance.route.search import Effort
from tests.companion.guidance.test_route import RING, depth_m, flown, unit

HONEYCOMB = np.array([(27.0 * i, 31.0 * (j + 0.5 * (i % 2))) for i in range(7) for j in range(7)]), np.full(49, 15.0)
IDS = np.arange(49)
START, GOAL = (-60.0, 90.0), (240.0, 100.0)


@pytest.fixture
def plans(monkeypatch: pytest.MonkeyPatch) -> list[Plan]:
    """Return a list to which every plan that is begun is added."""
    begun: list[Plan] = []
    way = Plan.way

    def counted(self: Plan, effort: Effort) -> Generator[None, None, Way | None]:
        begun.append(self)
        return way(self, effort)

    monkeypatch.setattr(Plan, "way", counted)
    return begun


@pytest.fixture
def little_effort(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a call do little, so that a plan in the honeycomb takes several."""
    monkeypatch.setattr(module, "BASE_WORK_US", 500.0)
    monkeypatch.setattr(module, "DISC_WORK_US", 0.0)


def test_a_plan_that_takes_several_calls_is_the_one_that_is_made_at_once(little_effort: None) -> None:
    router = Router()
    routes = [router.route(Departure(START), GOAL, *HONEYCOMB, IDS)]
    while routes[-1].reach is Reach.PLANNING:
        assert (routes[-1].pieces, routes[-1].length_m) == ((), math.inf)
        assert math.isnan(routes[-1].heading_rad)
        routes.append(router.route(Departure(START), GOAL, *HONEYCOMB, IDS))
        assert len(routes) < 500
    assert len(routes) > 3
    assert routes[-1].length_m == pytest.approx(shortest_route(START, GOAL, *HONEYCOMB).length_m)


def test_a_vehicle_that_circles_meanwhile_gets_a_way_from_where_it_is_then(little_effort: None) -> None:
    router, calls = Router(), 0
    while True:
        heading_rad = 0.5 * calls
        place = np.array(START) + 10.0 * unit(heading_rad - 0.5 * math.pi)
        route = router.route(Departure(place, heading_rad, 10.0), GOAL, *HONEYCOMB, IDS)
        calls += 1
        if route.reach is not Reach.PLANNING:
            break
        assert calls < 500
    best_m = shortest_route(place, GOAL, *HONEYCOMB, heading_rad, 10.0).length_m
    assert best_m * (1.0 - 1e-9) <= route.length_m <= 1.1 * best_m
    assert depth_m(flown(route), *HONEYCOMB) < 1e-6


def test_the_kept_route_is_flown_on_while_another_is_planned(little_effort: None) -> None:
    router = Router()
    first = until_planned(router, START, HONEYCOMB[0])
    # All discs move aside together, by more than is let pass and by less than closes the kept way.
    aside = HONEYCOMB[0] + np.array([0.0, 0.8])
    second = router.route(Departure(START), GOAL, aside, HONEYCOMB[1], IDS)
    assert (second.reach, second.via) == (Reach.TARGET, first.via)
    assert depth_m(flown(second), aside, HONEYCOMB[1]) < 1e-6


def until_planned(router: Router, place: tuple[float, float], centres: np.ndarray) -> Route:
    for _ in range(500):
        route = router.route(Departure(place), GOAL, centres, HONEYCOMB[1], IDS)
        if route.reach is not Reach.PLANNING:
            return route
    raise AssertionError("no route after 500 calls")


def test_a_route_that_is_followed_among_standing_discs_is_hardly_planned_again(plans: list[Plan]) -> None:
    router, place, flown_m = Router(), np.array(START), 0.0
    for _ in range(400):
        route = router.route(Departure(place), GOAL, *HONEYCOMB, IDS)
        if route.reach is Reach.TARGET:
            if route.length_m <= 2.0:
                break
            place, flown_m = place + 1.0 * unit(route.heading_rad), flown_m + 1.0
    assert math.dist(place, GOAL) < 3.0
    assert len(plans) <= 3  # steps cut corners, which counts where little is left to fly
    assert flown_m <= 1.01 * shortest_route(START, GOAL, *HONEYCOMB).length_m + 2.0


def test_a_vehicle_that_is_blown_off_its_route_plans_again_and_finds_the_best_way(plans: list[Plan]) -> None:
    router = Router()
    until_planned(router, START, HONEYCOMB[0])
    begun = len(plans)
    blown = (-60.0, 10.0)
    routes = [router.route(Departure(blown), GOAL, *HONEYCOMB, IDS) for _ in range(20)]
    assert len(plans) == begun + 1
    assert routes[-1].length_m == pytest.approx(shortest_route(blown, GOAL, *HONEYCOMB).length_m, rel=0.02)


@pytest.mark.parametrize("start", [(200.0, 0.0), (0.0, 1.0)])
def test_that_only_the_nearest_place_can_be_reached_is_found_out_once(
    start: tuple[float, float], plans: list[Plan]
) -> None:
    goal = (1.0, 0.0) if start[0] else (200.0, 0.0)
    router, place = Router(), np.array(start)
    for _ in range(300):
        route = router.route(Departure(place), goal, *RING, np.arange(8))
        assert route.reach is Reach.NEAREST
        place = place + min(1.0, route.length_m) * unit(route.heading_rad)
    assert route.length_m == pytest.approx(0.0, abs=1e-6)
    assert len(plans) <= 2


def test_that_there_is_no_way_is_found_out_again_only_after_some_calls(plans: list[Plan]) -> None:
    centres, radii = np.vstack((RING[0], [[0.0, 0.0]])), np.append(RING[1], 30.0)
    router = Router()
    reaches = [router.route(Departure((0.0, 1.0)), (200.0, 0.0), centres, radii, np.arange(9)).reach for _ in range(12)]
    assert set(reaches) <= {Reach.NONE, Reach.PLANNING}
    assert Reach.NONE in reaches
    assert len(plans) <= 2


def test_a_way_that_was_closed_and_opened_again_is_found(plans: list[Plan]) -> None:
    router, ids = Router(), np.arange(8)
    opened = RING[1].copy()
    opened[0] = 10.0
    reaches = [
        router.route(Departure((0.0, 0.0)), (200.0, 0.0), RING[0], radii, ids).reach
        for radii in (opened, RING[1], opened)
    ]
    assert reaches == [Reach.TARGET, Reach.NEAREST, Reach.TARGET]


def test_plans_of_two_questions_that_are_asked_in_turn_are_both_made(little_effort: None, plans: list[Plan]) -> None:
    router, goals = Router(), (GOAL, (240.0, 60.0))
    routes: dict[tuple[float, float], Route] = {}
    for _ in range(200):
        for goal in goals:
            routes[goal] = router.route(Departure(START), goal, *HONEYCOMB, IDS)
    assert len(plans) == 2
    for goal in goals:
        assert routes[goal].length_m == pytest.approx(shortest_route(START, goal, *HONEYCOMB).length_m)


def test_a_small_disc_that_comes_between_a_vehicle_and_its_way_does_not_need_another_plan(plans: list[Plan]) -> None:
    centres, radii, ids = np.array([[500.0, 5.0], [30.0, -9.0]]), np.array([100.0, 3.0]), np.arange(2)
    router, goal = Router(), (1000.0, 0.0)
    assert router.route(Departure((0.0, 3.0)), goal, centres, radii, ids).via == ((0, 1),)
    blown = router.route(Departure((0.0, -3.0)), goal, centres, radii, ids)
    assert blown.via in (((1, 1), (0, 1)), ((1, -1), (0, 1)))
    assert blown.length_m == pytest.approx(shortest_route((0.0, -3.0), goal, centres, radii).length_m)
    assert len(plans) == 2  # of which one is that of the line above
