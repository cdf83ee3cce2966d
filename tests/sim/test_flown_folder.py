"""A flown folder on the page: the truth, what each vehicle knew and when, and what it said."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from companion.errors import InputError
from companion.files.tlog import TlogWriter
from companion.mission.model import dump_mission, parse_mission
from companion.onboard.decision import Decision, Purpose
from companion.onboard.failsafe import Stage
from companion.onboard.flight_log import decision_frame, text_frames
from companion.protocol.codec import FrameWriter
from companion.protocol.messages import RadiiFrame
from groundstation.events import Directed, Paused, Who, event_json
from groundstation.ground_station import GroundStation
from groundstation.store.playback import Playback
from groundstation.store.recordings import Recording
from sim.lockstep import FlightOptions, fly
from sim.loop import START_S
from sim.replayed import FlownFolder, heard_words
from sim.score import score
from sim.vehicle_words import read_words
from tests.groundstation.store.test_playback import Screen

MISSION = """
name: heard
agents: [{id: 1, north_m: 0, east_m: 0, heading_deg: 0}, {id: 2, north_m: 0, east_m: 2000, heading_deg: 0}]
targets: [{id: 7, north_m: 1500, east_m: 0}]
threats: [{id: 4, north_m: 1000, east_m: 6000, detection_radius_m: 900, attack_radius_m: 300, speed_bound_m_s: 5}]
broadcast_period_s: 2
max_time_s: 30
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flown")
    mission = parse_mission(MISSION, "heard")
    (folder / "mission.yaml").write_text(dump_mission(mission))
    flight = fly(mission, 1, FlightOptions(out=folder))
    scored = score(flight.trajectory, mission).per_agent
    agents = [
        {"id": one.id, "reached": [{"target": there.target_id, "t_s": there.t_s} for there in one.reached]}
        for one in scored
    ]
    (folder / "result.json").write_text(json.dumps({"agents": agents}))
    return folder


@pytest.fixture(scope="module")
def flown(folder: Path) -> FlownFolder:
    return FlownFolder(folder)


def test_a_picture_tells_where_everything_was_and_what_each_vehicle_had_heard(flown: FlownFolder) -> None:
    picture = flown.picture_at(START_S + 11.2)
    assert picture is not None
    assert picture["t_s"] == START_S + 11.0
    first = picture["agents"][0]
    assert first["north_m"] == pytest.approx(60.0 * 11.0, abs=10.0)
    assert (first["target"], first["certificate"]) == (7, "for ever")
    assert first["link"].endswith("s old, held whole, fresh")
    assert first["said"].startswith("target 7 (assigned), picture fresh, certified for ever")
    (threat,) = picture["threats"]
    assert 0.0 < threat["age_s"] <= 2.2
    assert threat["growth_m"] == pytest.approx(5.0 * threat["age_s"], abs=0.01)


def test_before_anything_was_heard_a_vehicle_knows_nothing(flown: FlownFolder) -> None:
    picture = flown.picture_at(flown.span.from_s)
    assert picture is not None
    assert [one["link"] for one in picture["agents"]] == ["nothing heard yet"] * 2


def test_its_events_are_who_was_sent_where_and_arrived_in_order(flown: FlownFolder) -> None:
    events = flown.events(0.0, flown.span.to_s)
    assert [event["event"] for event in events][:3] == ["started", "revision-began", "assigned"]
    assert [event["number"] for event in events] == list(range(1, len(events) + 1))
    arrived = [event for event in events if event["event"] == "arrived"]
    assert [(event["agent"], event["target"]) for event in arrived] == [(1, 7)]
    at_s = arrived[0]["unix_s"]
    before, after = flown.picture_at(at_s - 1.0), flown.picture_at(at_s + 0.5)
    assert before is not None and after is not None
    assert (before["agents"][0]["state"], after["agents"][0]["state"]) == ("under way", "arrived")
    assert after["targets"][0]["reached_by"] == [1]


def test_it_is_played_like_a_store(flown: FlownFolder) -> None:
    recording: Recording = flown
    playback, screen = Playback(recording), Screen()
    playback.step(screen, 10.0)
    assert screen.taken("picture")[-1]["mode"] == "playback"
    assert screen.taken("mission")[-1]["mission"]["name"] == "heard"
    assert len(screen.heard_s) > 5


def test_a_vehicle_that_heard_no_radii_yet_waits_for_its_threats_and_says_so(tmp_path: Path) -> None:
    station, writer = GroundStation(parse_mission(MISSION, "heard"), START_S), FrameWriter()
    told = [*station.refresh(START_S, 80), *station.carousel(START_S, 80)]
    radii = [frame for frame in told if isinstance(frame, RadiiFrame)]
    decision = decision_frame(Decision(START_S, Purpose.LOITER, "waits", Stage.FRESH, 0.5))
    with TlogWriter(tmp_path / "vehicle-1.tlog") as log:
        for frame in told:
            if not isinstance(frame, RadiiFrame):
                log.write(START_S, writer.encode(frame))
        log.write(START_S + 1.0, writer.encode(decision))
        for text in text_frames("loiter (waits)", 1):
            log.write(START_S + 1.0, text)
        for frame in radii:
            log.write(START_S + 2.0, writer.encode(frame))
        log.write(START_S + 3.0, writer.encode(decision))
    words = read_words(tmp_path / "vehicle-1.tlog", 1)
    assert [one.missing for one in words.known] == ["0 of 1 threats heard", None]
    assert [one.words for one in words.known] == ["loiter (waits)"] * 2
    assert heard_words(words.at(START_S + 2.5), START_S + 2.5) == "picture 2.0 s old, 0 of 1 threats heard, fresh"
    assert words.at(START_S) is None


def test_a_killed_flight_without_a_result_is_opened_and_another_folder_is_refused(folder: Path, tmp_path: Path) -> None:
    for name in ("mission.yaml", "trajectory.csv", "broadcast.tlog"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    left = FlownFolder(tmp_path)
    assert [event["event"] for event in left.events(0.0, left.span.to_s)].count("arrived") == 0
    (tmp_path / "broadcast.tlog").unlink()
    with pytest.raises(InputError, match="no broadcast.tlog; allowed: a folder that `sim fly --out` wrote"):
        FlownFolder(tmp_path)


def test_what_agents_were_told_is_shown_from_when_they_were_told_it(folder: Path, tmp_path: Path) -> None:
    for name in ("mission.yaml", "trajectory.csv", "broadcast.tlog"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    anna = Who(name="anna", role="operator")
    told = Directed(number=1, unix_s=START_S + 5.0, who=anna, directive="return", agent=1)
    paused = Paused(number=2, unix_s=START_S + 9.0, who=anna)
    (tmp_path / "events.jsonl").write_bytes(b"".join(event_json(event) + b"\n" for event in (told, paused)))
    flown = FlownFolder(tmp_path)
    shown = [flown.picture_at(START_S + at_s) for at_s in (4.0, 6.0, 10.0)]
    agents = [[(one["state"], one["directive"]) for one in picture["agents"]] for picture in shown if picture]
    assert [one[0] for one in agents] == [("no target", "normal"), ("recalled", "return"), ("recalled", "return")]
    assert [one[1][1] for one in agents] == ["normal", "normal", "hold"]
    assert [(picture["paused"], picture["directive"]) for picture in shown if picture] == [
        (False, "normal"),
        (False, "normal"),
        (True, "hold"),
    ]
