"""Case II: where the centre reckons its unseen agents to be, how sure it is, and what a report changes."""

from __future__ import annotations

import math
from collections.abc import Iterable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.errors import InputError
from companion.geo.local_frame import LocalFrame
from companion.mission.model import Mission, parse_mission
from companion.protocol.codec import (
    AgentEntry,
    Detection,
    DetectionsFrame,
    Directive,
    FrameReader,
    FrameWriter,
    Kind,
    MotionFrame,
    ReportFrame,
    Stamp,
    StateFrame,
    TargetEntry,
)
from groundstation.agents import (
    DRIFT_SHARE,
    FIX_ERROR_M,
    DeadReckoner,
    Estimate,
    Fix,
    VehicleModel,
    check_reckonable,
)
from groundstation.events import Retire, Undo, Who
from groundstation.ground_station import GroundStation
from groundstation.notices import noticed

START_S = 1_790_000_000.0
SPEED_M_S = 60.0
STILL = ""
TEXT = """
case: II
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}, {id: 2, north_m: 0, east_m: 20000, heading_deg: 0}]
targets: [{id: 1, north_m: 30000, east_m: 0}, {id: 2, north_m: 30000, east_m: 20000}]
defaults: {target: {speed_bound_m_s: 0}}
"""
WINDY = "wind: {speed_m_s: 8, gust_m_s: 2}\n"
TICK_S = 0.5
TELL_EVERY = 10
FRAME = LocalFrame(47.0, 8.0)


def mission(lines: str = STILL) -> Mission:
    """Return the mission with some of its lines replaced."""
    given = {line.split(":")[0] for line in lines.splitlines()}
    kept = [line for line in TEXT.strip().splitlines() if line.split(":")[0] not in given]
    return parse_mission("\n".join([*kept, lines]), "unseen")


def dead_reckoner(lines: str = STILL, can_stop: bool = False) -> DeadReckoner:
    return DeadReckoner(mission(lines), START_S, VehicleModel(can_stop=can_stop))


Goals = dict[int, tuple[float, float]]


def state(t_s: float, goals: Goals) -> bytes:
    """Return a state frame that sends each agent to a target of its own."""
    stamp = Stamp(int(START_S), round(1000 * t_s), 1 + int(t_s))
    agents = tuple(AgentEntry(identity, None, None, identity) for identity in goals)
    targets = tuple(TargetEntry(identity, *place) for identity, place in goals.items())
    return FrameWriter().encode(StateFrame(stamp, 47.0, 8.0, Directive.NORMAL, 1, 0, 1, 100, agents, targets, ()))


AHEAD = {1: (30_000.0, 0.0), 2: (30_000.0, 20_000.0)}
BEHIND = {1: (-30_000.0, 0.0), 2: (-30_000.0, 20_000.0)}


class Told:
    """A dead reckoner whose agents are told every few seconds where to go."""

    def __init__(
        self, goals: Goals | None, lines: str = STILL, *, flying: Iterable[int] = (1, 2), can_stop: bool = False
    ) -> None:
        self.dead_reckoner = dead_reckoner(lines, can_stop)
        self.goals = goals
        self.flying = set(flying)
        self.step = 0

    def to(self, t_s: float) -> Told:
        while self.step < round(t_s / TICK_S):
            if self.goals is not None and self.step % TELL_EVERY == 0:
                self.dead_reckoner.hear(state(self.step * TICK_S, self.goals), START_S + self.step * TICK_S)
            self.step += 1
            self.dead_reckoner.advance(self.now_s, self.flying)
        return self

    @property
    def now_s(self) -> float:
        return START_S + self.step * TICK_S

    def found(self, agent_id: int = 1) -> Estimate:
        return self.dead_reckoner.estimate(agent_id, self.now_s)


def place(estimate: Estimate) -> tuple[float, float]:
    return estimate.north_m, estimate.east_m


# How it moves


def test_an_agent_is_where_the_mission_says_before_any_time_has_passed() -> None:
    assert place(dead_reckoner().estimate(2, START_S)) == (0.0, 20_000.0)


def test_an_agent_flies_at_its_speed_to_where_it_was_sent() -> None:
    found = Told(AHEAD).to(100.0).found()
    # Until the link had carried the first frame, it loitered where it was for a step.
    assert place(found) == pytest.approx((100.0 * SPEED_M_S, 0.0), abs=SPEED_M_S)
    assert found.speed_m_s == SPEED_M_S
    assert found.flown_m == pytest.approx(100.0 * SPEED_M_S, rel=0.02)


def test_an_agent_turns_no_faster_than_it_can() -> None:
    one = (
        "agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0, n_max: 1}]\ntargets: [{id: 1, north_m: 0, east_m: 0}]"
    )
    told, headings_rad = Told({1: (-30_000.0, 0.0)}, one, flying=[1]), [0.0]
    for step in range(1, 60):
        headings_rad.append(told.to(step * TICK_S).found().heading_rad)
    turns_rad = [abs(math.remainder(b - a, math.tau)) for a, b in zip(headings_rad, headings_rad[1:], strict=False)]
    assert max(turns_rad) == pytest.approx(9.80665 / SPEED_M_S * TICK_S)
    assert abs(headings_rad[-1]) == pytest.approx(math.pi, abs=0.05)


def test_between_steps_an_agent_flies_on_as_last_decided() -> None:
    told = Told(AHEAD).to(20.0)
    later = told.dead_reckoner.estimate(1, told.now_s + 0.4)
    assert later.north_m == pytest.approx(told.found().north_m + 0.4 * SPEED_M_S, abs=0.1)


def test_an_agent_that_can_stop_stands_still_until_it_is_sent() -> None:
    found = Told(None, can_stop=True).to(60.0).found()
    assert place(found) == pytest.approx((0.0, 0.0), abs=1.0)
    assert found.speed_m_s == pytest.approx(0.0, abs=0.5)


def test_an_agent_that_is_sent_nowhere_loiters_about_its_start() -> None:
    assert math.hypot(*place(Told(None).to(120.0).found())) < 500.0


def test_agents_not_flying_stay_where_they_are() -> None:
    told = Told(AHEAD, flying=[1]).to(60.0)
    assert place(told.found(2)) == (0.0, 20_000.0)
    assert told.found(1).north_m > 3_000.0


@pytest.mark.parametrize("delay_s", [0.5, 1.0, 5.0, 20.0])
def test_a_frame_is_heard_only_when_the_link_has_carried_it(delay_s: float) -> None:
    told, deaf = Told(AHEAD, f"link: {{delay_s: {delay_s}}}\n"), Told(None)
    assert told.to(delay_s).found() == deaf.to(delay_s).found()
    assert told.to(delay_s + TICK_S).found() != deaf.to(delay_s + TICK_S).found()


def test_of_two_frames_under_way_each_is_heard_in_its_time() -> None:
    reckoned = dead_reckoner("link: {delay_s: 10}\n")
    reckoned.hear(state(0.0, AHEAD), START_S)
    reckoned.hear(state(20.0, BEHIND), START_S + 20.0)
    norths_m = []
    for step in range(120):
        reckoned.advance(START_S + TICK_S * step, {1})
        norths_m.append(reckoned.estimate(1, START_S + TICK_S * step).north_m)
    assert TICK_S * norths_m.index(max(norths_m)) == pytest.approx(31.0, abs=1.5)
    assert norths_m[-1] < max(norths_m) - 1_000.0


def test_over_many_short_steps_the_clock_of_the_reckoning_does_not_creep() -> None:
    lines = "guidance_step_s: 0.1\nintegration_step_s: 0.1\nlink: {delay_s: 0.1}\n"
    reckoned, deaf = dead_reckoner(lines), dead_reckoner(lines)
    for step in range(301):
        for each in (reckoned, deaf):
            each.advance(START_S + step * 0.1, {1})
        if step == 299:
            reckoned.hear(state(30.0, AHEAD), START_S + step * 0.1)
    assert reckoned.estimate(1, START_S + 30.0) == deaf.estimate(1, START_S + 30.0)
    for each in (reckoned, deaf):
        each.advance(START_S + 301 * 0.1, {1})
    assert reckoned.estimate(1, START_S + 30.1) != deaf.estimate(1, START_S + 30.1)


def nearest_meeting_m(detector_range_m: float) -> float:
    told = Told(
        {1: (3_000.0, 10.0), 2: (-3_000.0, 10.0)},
        "agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0, speed_m_s: 10, n_max: 2}, "
        "{id: 2, north_m: 700, east_m: 20, heading_deg: 180, speed_m_s: 10, n_max: 2}]\n"
        f"separation_m: 200\ndetector_range_m: {detector_range_m}\n",
    )
    steps = [TICK_S * step for step in range(1, 140)]
    return min(math.dist(place(told.to(t_s).found(1)), place(told.found(2))) for t_s in steps)


def test_reckoned_agents_that_meet_see_each_other_with_their_detectors() -> None:
    assert nearest_meeting_m(0.0) < 30.0
    assert nearest_meeting_m(2_000.0) >= 200.0


def test_reckoning_twice_gives_the_same() -> None:
    assert Told(AHEAD).to(30.0).found() == Told(AHEAD).to(30.0).found()


# How sure it is


@pytest.mark.parametrize(("lines", "wind_m_s"), [(STILL, 0.0), (WINDY, 10.0)])
def test_doubt_grows_by_a_share_of_the_way_flown_and_by_the_bound_of_the_wind(lines: str, wind_m_s: float) -> None:
    assert dead_reckoner(lines).estimate(1, START_S).uncertainty_m == FIX_ERROR_M
    told = Told(AHEAD, lines).to(50.0)
    rate_m_s = DRIFT_SHARE * SPEED_M_S + wind_m_s
    assert told.found().uncertainty_m == pytest.approx(FIX_ERROR_M + 50.0 * rate_m_s)
    assert told.dead_reckoner.estimate(1, told.now_s + 0.4).uncertainty_m == pytest.approx(
        FIX_ERROR_M + 50.4 * rate_m_s
    )


@settings(max_examples=20)
@given(age_s=st.floats(0.0, 50.0))
def test_a_fix_leaves_its_own_error_and_what_may_have_happened_since(age_s: float) -> None:
    told = Told(None, WINDY, flying=()).to(50.0)
    told.dead_reckoner.fix(1, Fix((3_000.0, 0.0), (60.0, 0.0), told.now_s - age_s))
    assert told.found(1).uncertainty_m == pytest.approx(FIX_ERROR_M + age_s * 10.6)
    assert told.found(2).uncertainty_m == pytest.approx(FIX_ERROR_M + 50.0 * 10.6)


coordinates = st.floats(-1e5, 1e5)
speeds = st.floats(-80.0, 80.0)


@settings(max_examples=25)
@given(st.tuples(coordinates, coordinates), st.tuples(speeds, speeds), st.floats(0.0, 20.0), st.floats(0.0, 1e5))
def test_a_late_fix_is_carried_on_by_its_velocity(
    fixed_ned_m: tuple[float, float], velocity_m_s: tuple[float, float], age_s: float, flown_m: float
) -> None:
    told = Told(None, flying=()).to(20.0)
    told.dead_reckoner.fix(1, Fix(fixed_ned_m, velocity_m_s, told.now_s - age_s, flown_m))
    found, speed_m_s = told.found(), math.hypot(*velocity_m_s)
    expected = (fixed_ned_m[0] + age_s * velocity_m_s[0], fixed_ned_m[1] + age_s * velocity_m_s[1])
    assert place(found) == pytest.approx(expected, abs=1e-3)
    assert found.flown_m == pytest.approx(flown_m + age_s * speed_m_s, abs=1e-3)
    if speed_m_s > 0.0:
        course_rad = math.atan2(velocity_m_s[1], velocity_m_s[0])
        assert math.remainder(found.heading_rad - course_rad, math.tau) == pytest.approx(0.0, abs=1e-9)


def test_a_fix_without_a_length_leaves_the_way_flown_as_reckoned() -> None:
    told = Told(AHEAD).to(50.0)
    before_m = told.found().flown_m
    told.dead_reckoner.fix(1, Fix((9_000.0, 9_000.0), (60.0, 0.0), told.now_s))
    assert told.found().flown_m == before_m > 2_000.0


def test_the_leap_of_a_fix_is_no_way_flown() -> None:
    told = Told(AHEAD).to(50.0)
    told.dead_reckoner.fix(1, Fix((9_000.0, 9_000.0), (60.0, 0.0), told.now_s, 3_000.0))
    assert told.to(70.0).found().flown_m == pytest.approx(3_000.0 + 20.0 * SPEED_M_S, abs=SPEED_M_S)


def test_from_a_fix_an_agent_flies_on_to_its_target() -> None:
    told = Told(AHEAD).to(50.0)
    told.dead_reckoner.fix(1, Fix((30_000.0, 4_000.0), (60.0, 0.0), told.now_s))
    found = told.to(80.0).found()
    assert math.dist(place(found), AHEAD[1]) == pytest.approx(4_000.0 - 30.0 * SPEED_M_S, abs=100.0)
    assert math.remainder(found.heading_rad + math.pi / 2, math.tau) == pytest.approx(0.0, abs=0.1)


# In the ground station


class Run:
    """A ground station that reckons, ticking on a virtual clock."""

    def __init__(self, lines: str = STILL, sensed: bool = True) -> None:
        self.station = GroundStation(mission(lines), START_S, sensed)
        self.t_s = 0.0
        self.datagrams = self.station.tick(START_S)

    def to(self, t_s: float) -> Run:
        while self.t_s < t_s - 1e-9:
            self.t_s += TICK_S
            self.datagrams += self.station.tick(START_S + self.t_s)
        return self

    def report(
        self,
        north_m: float,
        east_m: float,
        *,
        agent_id: int = 1,
        at_s: float | None = None,
        velocity: tuple[float, float] = (60.0, 0.0),
        flown_m: float = 0.0,
    ) -> None:
        """Let an agent report that it was at a place of the plane; velocity from true north."""
        at_s = self.t_s if at_s is None else at_s
        frame = ReportFrame(
            int(START_S), round(1000 * at_s), agent_id, *FRAME.to_global(north_m, east_m), *velocity, flown_m
        )
        self.station.hear_report(FrameWriter(agent_id, 191).encode(frame), START_S + self.t_s)

    def place(self, agent_id: int = 1) -> tuple[float, float]:
        return self.station.tracks.tracks[Kind.AGENT, agent_id].position_ned_m


def test_the_station_sends_its_agents_and_reckons_them_on_their_way() -> None:
    run = Run().to(100.0)
    assert run.place() == pytest.approx((6_000.0, 0.0), abs=80.0)
    assert run.station.tracks.uncertainty_m[1] == pytest.approx(FIX_ERROR_M + 60.0)
    assert run.station.tracks.flown_m[1] == pytest.approx(6_000.0, abs=80.0)


def test_the_station_broadcasts_neither_place_nor_motion_of_its_agents() -> None:
    frames = [frame for datagram in Run().to(20.0).datagrams for frame in FrameReader().read(datagram)]
    told = {agent.position_ned_m for frame in frames if isinstance(frame, StateFrame) for agent in frame.agents}
    assert told == {None}
    assert {len(frame.agents) for frame in frames if isinstance(frame, MotionFrame)} == {0}


def test_a_stray_detection_of_an_agent_moves_nobody() -> None:
    run, other = Run().to(10.0), Run().to(10.0)
    seen = DetectionsFrame(int(START_S), 10_000, 47.0, 8.0, (Detection(Kind.AGENT, 1, 9_000.0, 9_000.0, 0.0, 0.0),))
    run.station.sense(FrameWriter().encode(seen), START_S + 10.0)
    assert run.to(20.0).place() == other.to(20.0).place()


def test_a_report_moves_the_agent_its_way_flown_and_its_doubt() -> None:
    run = Run(WINDY).to(100.0)
    assert run.station.tracks.uncertainty_m[1] == pytest.approx(FIX_ERROR_M + 1_060.0)
    run.report(4_000.0, 1_500.0, flown_m=7_777.0)
    run.to(100.5)
    assert run.place() == pytest.approx((4_000.0, 1_500.0), abs=0.5 * SPEED_M_S + 1.0)
    assert run.station.tracks.flown_m[1] == pytest.approx(7_777.0, abs=0.5 * SPEED_M_S + 1.0)
    assert run.station.tracks.uncertainty_m[1] == pytest.approx(FIX_ERROR_M + 0.5 * 10.6)
    assert run.station.tracks.uncertainty_m[2] == pytest.approx(FIX_ERROR_M + 100.5 * 10.6)


ONE = "targets: [{id: 1, north_m: 30000, east_m: 0}]\n"


@given(st.floats(-2e5, 2e5), st.floats(-2e5, 2e5), st.floats(-math.pi, math.pi))
@settings(max_examples=15)
def test_a_reported_course_is_turned_from_true_north_to_the_grid(
    north_m: float, east_m: float, course_rad: float
) -> None:
    run = Run(f"agents: [{{id: 1, north_m: {north_m}, east_m: {east_m}, heading_deg: 0}}]\n{ONE}").to(1.0)
    true_rad = course_rad + FRAME.convergence_rad(north_m, east_m)
    run.report(north_m, east_m, velocity=(60.0 * math.cos(true_rad), 60.0 * math.sin(true_rad)))
    reckoned = run.station.reckoner
    assert reckoned is not None
    found = reckoned.estimate(1, START_S + 1.0)
    assert place(found) == pytest.approx((north_m, east_m), abs=0.1)
    assert math.remainder(found.heading_rad - course_rad, math.tau) == pytest.approx(0.0, abs=1e-3)


def untouched(run: Run) -> bool:
    """Return whether everybody is where they are in a run that nobody reported in."""
    now = (run.t_s, run.station.tracks.heard_at_s, [run.place(k) for k in (1, 2)])
    other = Run().to(run.t_s)
    return now == (other.t_s, other.station.tracks.heard_at_s, [other.place(k) for k in (1, 2)])


def test_the_report_of_nobody_known_is_ignored() -> None:
    run = Run().to(10.0)
    run.report(9_000.0, 9_000.0, agent_id=77)
    assert untouched(run.to(12.0))


def test_a_report_older_than_the_last_is_ignored() -> None:
    run, once = Run().to(20.0), Run().to(20.0)
    for each in (run, once):
        each.report(1_000.0, 500.0, at_s=18.0)
    run.report(-5_000.0, 0.0, at_s=17.9)
    assert run.to(25.0).place() == once.to(25.0).place()
    assert run.station.tracks.heard_at_s[1] == START_S + 18.0


def test_a_report_from_before_this_run_is_ignored() -> None:
    run = Run().to(10.0)
    frame = ReportFrame(int(START_S) - 100, 0, 1, 47.1, 8.0, 60.0, 0.0, 0.0)
    run.station.hear_report(FrameWriter().encode(frame), START_S + 10.0)
    assert untouched(run.to(12.0))


def test_a_reporter_whose_clock_is_a_little_ahead_is_believed_as_of_the_receipt() -> None:
    run = Run().to(10.0)
    run.report(600.0, 400.0, at_s=11.9)
    assert run.station.tracks.heard_at_s[1] == START_S + 10.0
    assert run.to(10.5).place() == pytest.approx((600.0, 400.0), abs=0.5 * SPEED_M_S + 1.0)


@pytest.mark.parametrize(("at_s", "cause"), [(58.0, "18.0 s ahead of"), (8.0, "32.0 s behind")])
def test_a_report_by_a_clock_that_differs_is_refused_with_the_difference(at_s: float, cause: str) -> None:
    run = Run().to(40.0)
    run.report(2_400.0, 0.0, at_s=at_s)
    assert untouched(run.to(42.0))
    (line,) = run.station.tracks.refusals.news(START_S + 42.0)
    assert line.startswith("uplink: 1 frames refused, stamped ")
    assert f"its clock is {cause} this computer's" in line


@pytest.mark.slow
@settings(max_examples=15)
@given(st.lists(st.binary(max_size=200) | st.binary(max_size=60).map(lambda data: b"\xfd" + data), max_size=5))
def test_random_bytes_on_the_uplink_change_nothing(junk: list[bytes]) -> None:
    run = Run().to(2.0)
    for datagram in junk:
        run.station.hear_report(datagram, START_S + 2.0)
    assert untouched(run.to(3.0))


def test_the_broadcast_itself_on_the_uplink_changes_nothing() -> None:
    run = Run().to(2.0)
    for datagram in list(run.datagrams):
        run.station.hear_report(datagram, START_S + 2.0)
    assert untouched(run.to(3.0))


def test_a_report_on_the_sensors_channel_is_no_report() -> None:
    run = Run().to(2.0)
    frame = ReportFrame(int(START_S), 2_000, 1, 47.1, 8.0, 60.0, 0.0, 0.0)
    run.station.sense(FrameWriter().encode(frame), START_S + 2.0)
    assert untouched(run.to(3.0))


def test_in_case_i_too_an_agent_is_where_it_reports_to_be() -> None:
    run = Run("case: I\n").to(60.0)
    run.report(0.0, 3_000.0, flown_m=3_100.0)
    assert run.to(61.0).place() == pytest.approx((0.0, 3_000.0), abs=0.1)
    assert run.station.tracks.heard_at_s[1] == START_S + 60.0
    assert run.station.tracks.flown_m[1] == 3_100.0


def test_in_case_i_a_report_from_where_no_flight_leads_is_not_believed() -> None:
    run = Run("case: I\n").to(2.0)
    run.report(9_000.0, 9_000.0)
    assert run.to(3.0).place() == (0.0, 0.0)
    assert run.station.tracks.heard_at_s[1] == START_S


# Who is lost


def test_an_agent_is_lost_when_its_report_is_overdue_by_lost_after_s() -> None:
    run = Run("report_period_s: 60\nlost_after_s: 20\n").to(50.0)
    run.report(3_000.0, 0.0)
    run.report(3_000.0, 20_000.0, agent_id=2, at_s=40.0)
    assert run.to(120.0).station.tracks.progress.lost == frozenset()
    assert run.to(120.5).station.tracks.progress.lost == {2}
    assert run.to(130.0).station.tracks.progress.lost == {2}
    assert run.to(130.5).station.tracks.progress.lost == {1, 2}


def test_an_agent_that_never_reported_is_lost_as_one_that_reported_at_the_start() -> None:
    run = Run("report_period_s: 60\nlost_after_s: 20\n").to(80.0)
    assert run.station.tracks.progress.lost == frozenset()
    assert run.to(80.5).station.tracks.progress.lost == {1, 2}


@pytest.mark.slow
@pytest.mark.parametrize("sensed", [True, False])
def test_without_reports_nobody_is_ever_known_to_be_lost(sensed: bool) -> None:
    run = Run("lost_after_s: 20\n", sensed).to(200.0)
    assert (run.station.tracks.progress.lost, run.station.tracks.active_agents) == (frozenset(), [1, 2])


def test_in_case_ii_losses_do_not_hang_on_the_sensor() -> None:
    assert Run("report_period_s: 60\nlost_after_s: 20\n", sensed=False).to(81.0).station.tracks.progress.lost == {1, 2}


def test_a_lost_agent_is_reckoned_no_further_and_has_no_target() -> None:
    run = Run("report_period_s: 60\nlost_after_s: 20\n").to(50.0)
    run.report(3_000.0, 20_000.0, agent_id=2)
    at_loss = run.to(80.5).place()
    assert run.to(100.0).place() == at_loss
    assert list(run.station.assignment) == [2]


def test_an_agent_that_reports_again_is_back() -> None:
    run = Run("report_period_s: 60\nlost_after_s: 20\n").to(50.0)
    run.report(3_000.0, 20_000.0, agent_id=2)
    assert run.to(90.0).station.tracks.progress.lost == {1}
    run.report(4_000.0, -300.0)
    run.to(91.0)
    assert run.station.tracks.progress.lost == frozenset()
    assert run.place() == pytest.approx((4_000.0, -300.0), abs=1.0 * SPEED_M_S + 1.0)
    assert set(run.station.assignment) == {1, 2}


def test_the_target_of_a_lost_agent_goes_to_another() -> None:
    lines = "targets: [{id: 1, north_m: 30000, east_m: 0}]\nreport_period_s: 30\nlost_after_s: 10\n"
    run = Run(lines).to(30.0)
    run.report(1_800.0, 20_000.0, agent_id=2)
    assert run.station.assignment == {1: 1, 2: 1}
    assert run.to(41.0).station.assignment == {2: 1}
    assert run.station.uncovered == ()


# Arrivals


def test_an_uncertain_arrival_is_believed_as_much_later_as_the_doubt_takes_to_fly() -> None:
    run = Run("targets: [{id: 1, north_m: 6000, east_m: 0}]\nwind: {speed_m_s: 9}\narrival_radius_m: 300\n")
    near_s = None
    while not run.station.tracks.progress.completed and run.t_s < 300.0:
        run.to(run.t_s + TICK_S)
        if near_s is None and math.dist(run.place(), (6_000.0, 0.0)) <= 300.0:
            near_s = run.t_s
    assert near_s is not None
    assert run.station.tracks.progress.arrived == {1}
    # The warning goes on growing while it waits.
    waited_s = run.t_s - near_s
    assert waited_s * SPEED_M_S == pytest.approx(9.6 * run.t_s, abs=2 * SPEED_M_S * TICK_S)


def test_a_report_near_the_target_is_believed_at_once() -> None:
    run = Run("targets: [{id: 1, north_m: 7000, east_m: 0}]\nwind: {speed_m_s: 9}\n").to(100.0)
    run.report(6_900.0, 0.0)
    run.to(101.0)
    assert (run.station.tracks.progress.arrived, run.station.tracks.progress.completed) == (
        frozenset({1}),
        frozenset({1}),
    )


def test_an_agent_that_has_arrived_by_reckoning_keeps_its_target_and_others_are_sent_elsewhere() -> None:
    two = "targets: [{id: 1, north_m: 7000, east_m: 0}, {id: 2, north_m: 30000, east_m: 20000}]\n"
    run = Run(two).to(100.0)
    run.report(6_900.0, 0.0)
    run.to(112.0)
    assert run.station.tracks.progress.arrived == {1}
    frames = [frame for datagram in run.datagrams for frame in FrameReader().read(datagram)]
    last = [frame for frame in frames if isinstance(frame, StateFrame)][-1]
    assert {agent.id: agent.target_id for agent in last.agents} == {1: 1, 2: 2}
    assert {target.id for target in last.targets} == {1, 2}
    assert run.station.assignment == {2: 2}


def test_an_agent_that_has_arrived_by_reckoning_is_told_its_target_again_that_was_retired_by_mistake() -> None:
    two = "targets: [{id: 1, north_m: 7000, east_m: 0}, {id: 2, north_m: 30000, east_m: 20000}]\n"
    run = Run(two).to(100.0)
    run.report(6_900.0, 0.0)
    station, now_s, anna = run.to(112.0).station, START_S + 112.0, Who(name="anna", role="operator")
    for event in noticed(station.operations, station.facts(), now_s):
        station.adopt(event, now_s)
    retired = station.command(Retire(do="retire", kind="target", id=1), anna, now_s)
    station.command(Undo(do="undo", number=retired.number), anna, now_s)
    run.to(115.0)
    frames = [frame for datagram in run.datagrams for frame in FrameReader().read(datagram)]
    last = [frame for frame in frames if isinstance(frame, StateFrame)][-1]
    assert {agent.id: agent.target_id for agent in last.agents} == {1: 1, 2: 2}


def test_an_agent_too_slow_to_be_reckoned_is_named_with_what_is_allowed() -> None:
    slow = parse_mission(
        "case: II\nagents: [{id: 7, north_m: 0, east_m: 0, heading_deg: 0, speed_m_s: 0.4}]\n"
        "targets: [{id: 1, north_m: 90, east_m: 0}]\n",
        "slow.yaml",
    )
    with pytest.raises(InputError, match=r"slow.yaml: agents\[0\].speed_m_s: 0.4; allowed: at least 0.5"):
        check_reckonable(slow, VehicleModel(), "slow.yaml")
    check_reckonable(slow, VehicleModel(can_stop=True), "slow.yaml")
