"""What the sensor sees and the mission does not have: counted, shown, and by the sensor's rule taken in as threats."""

from __future__ import annotations

from companion.mission.model import Mission, parse_mission
from companion.protocol.codec import Detection, DetectionsFrame, FrameWriter, Kind
from groundstation.desk import Desk
from groundstation.events import AddThreat, TrackBegan, Who
from groundstation.ground_station import GroundStation
from groundstation.notices import MOST_TOLD
from groundstation.origins import MOST_UNKNOWN, Stranger
from groundstation.sources.sources import Sources
from groundstation.view import Surroundings, View, picture
from tests.groundstation.test_desk import Disk

TEXT = """
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}]
targets: [{id: 1, north_m: 9000, east_m: 0}]
"""
RULE = """
sources: [{name: radar, kind: sensor, url: "udpin:127.0.0.1:14700", radius_m: 200, speed_bound_m_s: 30, timeout_s: 20}]
"""
START_S = 1_790_000_000.0


class Watch:
    """A ground station whose sensor sees a threat 7 that flies north at 10 m/s."""

    def __init__(self, mission: Mission) -> None:
        self.disk = Disk()
        self.station = GroundStation(mission, START_S)
        self.desk = Desk(self.station, self.disk)
        self.sources = Sources(mission, mission.sources)
        self.t_s = 0

    def to(self, t_s: int, sees: bool = True) -> Watch:
        while self.t_s < t_s:
            self.t_s += 1
            stranger = Detection(Kind.THREAT, 7, 4000.0 + 10.0 * self.t_s, 500.0, 10.0, 0.0)
            frame = DetectionsFrame(int(START_S), 1000 * self.t_s, 47.0, 8.0, (stranger,) if sees else ())
            self.station.sense(FrameWriter().encode(frame), START_S + self.t_s)
            self.station.tick(START_S + self.t_s)
            self.sources.tick(self.station, self.desk, START_S + self.t_s)
            self.desk.tick(START_S + self.t_s)
            self.desk.notice(START_S + self.t_s)
        return self

    @property
    def kinds(self) -> list[str]:
        return [row.event for row in self.disk.rows]

    def shown(self) -> View:
        return picture(self.station, START_S + self.t_s, Surroundings())


def test_a_stranger_is_counted_told_once_and_shown_where_it_is() -> None:
    watch = Watch(parse_mission(TEXT, "test")).to(5)
    (unknown,) = watch.shown()["unknown"]
    assert unknown == {
        "source": "sensor",
        "kind": "threat",
        "id": 7,
        "north_m": 4050.0,
        "east_m": 500.0,
        "age_s": 0.0,
        "count": 5,
    }
    assert watch.kinds.count("unknown-seen") == 1
    assert watch.shown()["threats"] == []


def test_by_the_sensors_rule_a_stranger_is_taken_in_as_a_threat_that_moves_and_is_retired() -> None:
    watch = Watch(parse_mission(TEXT + RULE, "test")).to(12)
    (threat,) = watch.shown()["threats"]
    assert (threat["detection_radius_m"], threat["speed_bound_m_s"]) == (200.0, 30.0)
    assert abs(threat["north_m"] - 4120.0) < 30.0
    assert watch.shown()["unknown"] == []
    watch.to(100, sees=False)
    assert watch.shown()["threats"] == []
    assert watch.kinds.count("threat-added") == watch.kinds.count("retired") == 1


def test_a_flood_of_strangers_is_no_flood_of_events() -> None:
    watch = Watch(parse_mission(TEXT, "test"))
    for number in range(1000):
        stranger = Stranger((Kind.THREAT, number), 0j, 0j, START_S)
        watch.station.tracks.origins.meet(stranger)
        watch.desk.notice(START_S)
    assert watch.kinds.count("unknown-seen") == MOST_TOLD
    assert len(watch.shown()["unknown"]) == MOST_UNKNOWN


def test_what_a_live_source_has_added_is_not_what_the_sensor_calls_by_that_number() -> None:
    mission = parse_mission(TEXT, "strangers")
    station = GroundStation(mission, START_S)
    radar = Who(name="receiver", role="source")
    added = station.command(
        AddThreat(do="add-threat", id=7, north_m=4_010.0, east_m=500.0, radius_m=99.0, speed_bound_m_s=255.0),
        radar,
        START_S,
    )
    began = TrackBegan(
        number=added.number + 1, unix_s=START_S, who=radar, source="receiver", key="A", kind="threat", id=7
    )
    station.adopt(began, START_S)
    for t_s in range(1, 20):
        stranger = Detection(Kind.THREAT, 7, 4_000.0 + 100.0 * t_s, 500.0, 100.0, 0.0)
        frame = DetectionsFrame(int(START_S), 1000 * t_s, 47.0, 8.0, (stranger,))
        station.sense(FrameWriter().encode(frame), START_S + t_s)
    assert station.tracks.tracks[Kind.THREAT, 7].north_m == 4_010.0
    assert station.tracks.origins.unknown[Kind.THREAT, 7].times == 19
