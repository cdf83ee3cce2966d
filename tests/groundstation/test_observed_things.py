"""Live sources move things: agents that are seen beside agents that are dead-reckoned, and threats that move."""

from __future__ import annotations

import pytest

from companion.mission.model import Mission, parse_mission
from companion.protocol.codec import FrameReader, Kind, MotionFrame, StateFrame
from groundstation.events import Who, command_from
from groundstation.ground_station import GroundStation
from groundstation.origins import SEEN_S, Observation
from groundstation.view import Surroundings, View, picture

TEXT = """
agents:
  - {id: 1, north_m: 0, east_m: 0, heading_deg: 0, speed_m_s: 20}
  - {id: 2, north_m: 0, east_m: 9000, heading_deg: 0, speed_m_s: 20}
targets: [{id: 1, north_m: 20000, east_m: 0}, {id: 2, north_m: 20000, east_m: 9000}]
threats:
  - {id: 1, north_m: 10000, east_m: 4000, detection_radius_m: 900, attack_radius_m: 500, speed_bound_m_s: 10}
  - {id: 2, north_m: -9000, east_m: 4000, detection_radius_m: 900, attack_radius_m: 500}
broadcast_period_s: 1
"""
START_S = 1_790_000_000.0


def mission(case: str) -> Mission:
    return parse_mission(f"{TEXT}case: {case}\n", "test")


class Watched:
    """A ground station with a telemetry source that sees agent 1 once a second."""

    def __init__(self, case: str) -> None:
        self.station = GroundStation(mission(case), START_S, sensed=False)
        self.state: StateFrame | None = None
        self.motion: MotionFrame | None = None
        self.t_s = 0.0

    def to(self, t_s: float, north_m_s: float | None = 20.0) -> Watched:
        """Broadcast until a time; agent 1 is seen on its way unless its speed is None."""
        reader = FrameReader()
        while self.t_s <= t_s:
            now_s = START_S + self.t_s
            if north_m_s is not None and self.t_s % 1.0 == 0.0:
                place = complex(north_m_s * self.t_s, 0.0)
                self.station.observe(Observation(Kind.AGENT, 1, place, complex(north_m_s), now_s, 10.0, "px4"))
            for datagram in self.station.tick(now_s):
                for frame in reader.read(datagram):
                    self.state = frame if isinstance(frame, StateFrame) else self.state
                    self.motion = frame if isinstance(frame, MotionFrame) else self.motion
            self.t_s += 0.5
        return self

    def agent(self, identity: int) -> View:
        """Return what the view shows of an agent."""
        shown = picture(self.station, START_S + self.t_s, Surroundings())
        found: View = next(one for one in shown["agents"] if one["id"] == identity)
        return found


def test_an_agent_with_telemetry_is_told_beside_a_ghost_that_is_not() -> None:
    watched = Watched("II").to(20.0)
    assert watched.state is not None and watched.motion is not None
    places = {agent.id: agent.position_ned_m for agent in watched.state.agents}
    assert places[1] == pytest.approx((400.0, 0.0), abs=25.0)
    assert places[2] is None
    assert [agent.id for agent in watched.motion.agents] == [1]


def test_the_view_shows_who_sees_an_agent_and_the_ellipse_of_one_that_nobody_sees() -> None:
    watched = Watched("II").to(20.0)
    seen, ghost = watched.agent(1), watched.agent(2)
    assert (seen["source"], seen["ellipse"]) == ("telemetry", None)
    assert ghost["source"] == "reckoned"
    assert ghost["age_s"] == pytest.approx(20.5)
    early = ghost["ellipse"]
    late = watched.to(60.0).agent(2)["ellipse"]
    assert late["semi_major_m"] > early["semi_major_m"] >= early["semi_minor_m"]


def test_an_agent_whose_telemetry_ends_goes_on_as_a_ghost_from_where_it_was_seen() -> None:
    watched = Watched("II").to(20.0).to(21.0 + SEEN_S + 10.0, None)
    ghost = watched.agent(1)
    assert ghost["source"] == "reckoned"
    assert ghost["north_m"] == pytest.approx(20.0 * (31.0 + SEEN_S), abs=40.0)


def test_in_case_i_an_agent_that_is_not_seen_any_more_flies_on_with_a_growing_ellipse() -> None:
    watched = Watched("I").to(10.0).to(12.0 + SEEN_S, None)
    ghost = watched.agent(1)
    assert ghost["source"] == "reckoned"
    assert ghost["north_m"] == pytest.approx(20.0 * watched.t_s)
    assert ghost["ellipse"]["semi_major_m"] > 100.0


def test_a_threat_that_moves_within_its_bound_begins_no_revision_and_one_that_jumps_does() -> None:
    watched = Watched("I").to(2.0)
    station, revision = watched.station, watched.station.revision
    station.observe(Observation(Kind.THREAT, 1, complex(10030.0, 4000.0), 10 + 0j, START_S + 3.0, 5.0, "adsb"))
    watched.to(5.0)
    assert station.revision == revision
    station.observe(Observation(Kind.THREAT, 1, complex(12000.0, 4000.0), 10 + 0j, START_S + 6.0, 5.0, "adsb"))
    watched.to(8.0)
    assert station.revision == revision + 1


def test_what_stands_is_not_moved_about_by_the_errors_of_its_source() -> None:
    watched = Watched("I").to(2.0)
    station, revision = watched.station, watched.station.revision
    station.observe(Observation(Kind.THREAT, 2, complex(-9004.0, 4000.0), 0j, START_S + 3.0, 5.0, "ais"))
    watched.to(5.0)
    assert station.tracks.tracks[Kind.THREAT, 2].position_ned_m == (-9000.0, 4000.0)
    assert station.revision == revision


def test_a_threat_that_stands_elsewhere_than_the_error_of_its_source_explains_is_told_there() -> None:
    watched = Watched("I").to(2.0)
    station, revision = watched.station, watched.station.revision
    station.observe(Observation(Kind.THREAT, 2, complex(-9008.0, 4000.0), 0j, START_S + 3.0, 5.0, "ais"))
    watched.to(5.0)
    assert station.tracks.tracks[Kind.THREAT, 2].position_ned_m == (-9008.0, 4000.0)
    assert station.revision == revision + 1


def test_a_sighting_of_what_is_not_there_or_older_than_the_last_is_no_news() -> None:
    station = Watched("I").to(2.0).station
    assert not station.observe(Observation(Kind.THREAT, 9, 0j, 0j, START_S + 3.0, 5.0, "adsb"))
    assert not station.observe(Observation(Kind.AGENT, 1, 0j, 0j, START_S + 1.0, 5.0, "px4"))


@pytest.mark.parametrize(("heard", "share"), [(range(1, 21), 1.0), (range(1, 21, 2), 0.5), (range(1, 2), None)])
def test_the_link_of_an_agent_is_judged_by_the_share_of_its_reports_that_came(
    heard: range, share: float | None
) -> None:
    given = mission("II").model_copy(update={"report_period_s": 5.0})
    station = GroundStation(given, START_S, sensed=False)
    for number in heard:
        station.tracks.origins.report(1, START_S + 5.0 * number)
    now_s = START_S + (100.0 if share is not None else 6.0)
    shown = picture(station, now_s, Surroundings())["agents"][0]["link"]
    assert shown == (None if share is None else {"heard": share, "by": "reports"})


def test_a_threat_that_has_moved_is_put_back_to_where_the_mission_has_it() -> None:
    watched = Watched("I").to(2.0)
    station, key = watched.station, (Kind.THREAT, 1)
    station.observe(Observation(*key, complex(10030.0, 4000.0), 10 + 0j, START_S + 3.0, 5.0, "adsb"))
    revision = watched.to(5.0).station.revision
    back = {"do": "change", "kind": "threat", "id": 1, "north_m": 10000.0, "east_m": 4000.0}
    station.command(command_from(back), Who(name="anna", role="operator"), START_S + watched.t_s)
    assert station.tracks.tracks[key].position_ned_m == (10000.0, 4000.0)
    assert watched.to(8.0).station.revision == revision + 1
