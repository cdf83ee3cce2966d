"""Live sources as a run has them: 100 real aircraft become threats, telemetry moves agents, and health is told."""

from __future__ import annotations

import asyncio
import gzip
import time
from collections.abc import Hashable, Iterator
from contextlib import ExitStack
from io import BytesIO
from itertools import count
from pathlib import Path

import pytest

from companion.errors import InputError
from companion.mission.model import dump_mission, parse_mission
from companion.protocol.codec import Kind, StateFrame, decode_frame
from companion.protocol.frame import raw_frame
from groundstation.events import Retire, Who
from groundstation.ground_station import GroundStation
from groundstation.sources.choices import source_specs
from groundstation.sources.feed import MOST_WAITING, Pulse
from groundstation.sources.links import run_source
from groundstation.sources.playback import Due, open_recording, replayed, sightings_in
from groundstation.sources.sighting import Sighting
from groundstation.sources.sources import MOST_PER_TICK, Sources
from tests.groundstation.sources.given import DATA, START_S, ObeyingDesk, basestation_bytes, mission, sighting
from tests.ports import free_port

RECEIVER = "{name: receiver, kind: basestation, file: x, radius_m: 800, within_m: 200000}"
OPERATOR = Who(name="ada", role="operator")


class Run:
    """A ground station with live sources on a virtual clock."""

    def __init__(self, *sources: str, agents: str = "") -> None:
        made = mission(*sources, agents=agents)
        self.station = GroundStation(made, START_S)
        self.sources = Sources(made, made.sources)
        self.desk = ObeyingDesk(self.station)
        for feed in self.sources.feeds.values():
            feed.link.fault = None

    def tick(self, t_s: float) -> None:
        self.desk.now_s = START_S + t_s
        self.sources.tick(self.station, self.desk, START_S + t_s)

    def row(self, t_s: float, name: str = "receiver") -> dict[str, object]:
        return next(row for row in self.sources.view(self.station, START_S + t_s) if row["name"] == name)


def real_aircraft(run: Run) -> Iterator[Due]:
    feed = run.sources.feeds["receiver"]
    with open_recording(str(DATA / "basestation.txt.gz")) as file:
        for block in sightings_in(file, "basestation", feed.parse):
            yield from block


@pytest.fixture(scope="module")
def paris() -> Run:
    """Return a run that has heard 120 real aircraft for 40 s."""
    run = Run(RECEIVER)
    seen = real_aircraft(run)
    one = first = next(seen)
    revisions = []
    for tick in range(200):
        t_s = tick / 5.0
        while one.at_s - first.at_s <= t_s:
            run.sources.feeds["receiver"].offer([replayed(one, START_S - first.at_s, 1.0)], START_S + t_s)
            one = next(seen)
        run.tick(t_s)
        if not tick % 5:
            run.station.tick(START_S + t_s)
            revisions.append(run.station.revision)
    assert revisions[-1] - revisions[0] <= 5
    return run


def test_more_than_100_real_aircraft_become_threats_that_move_with_their_velocity(paris: Run) -> None:
    threats = paris.station.mission.threats
    assert len(threats) == 120
    tracks = [paris.station.tracks.tracks[Kind.THREAT, threat.id] for threat in threats]
    assert sum(track.age_s(START_S + 40.0) < 10.0 for track in tracks) > 110
    for threat, track in zip(threats, tracks, strict=True):
        speed_m_s = abs(complex(track.velocity_north_m_s, track.velocity_east_m_s))
        assert speed_m_s <= threat.speed_bound_m_s
    assert paris.desk.kinds().count("track-began") == 120


def test_the_health_of_the_receiver_is_good_with_its_rate_and_things(paris: Run) -> None:
    row = paris.row(40.0)
    assert (row["state"], row["things"], row["refused"]) == ("good", 120, 0)
    assert 15.0 < float(str(row["rate_hz"])) < 25.0
    assert paris.row(200.0)["state"] == "silent"


def test_the_real_aircraft_are_on_the_air(paris: Run) -> None:
    frames = [decode_frame(raw_frame(data)) for data in paris.station.tick(START_S + 50.0)]
    told = [threat for frame in frames if isinstance(frame, StateFrame) for threat in frame.threats]
    assert len(told) == 120


def test_telemetry_moves_an_agent_and_one_that_the_mission_does_not_have_is_told() -> None:
    run = Run("{name: fleet, kind: telemetry, url: 'udpin:127.0.0.1:1', ids: {'7': 1}}")
    for t_s in (0.0, 1.0):
        seen = [sighting("7", 10.0 * t_s, 0.0, START_S + t_s), sighting("8", 50.0, 0.0, START_S + t_s)]
        run.sources.feeds["fleet"].offer(seen, START_S + t_s)
        run.tick(t_s)
    assert run.station.tracks.tracks[Kind.AGENT, 1].north_m == pytest.approx(10.0, abs=0.5)
    assert run.station.tracks.origins.by[Kind.AGENT, 1] == "fleet"
    assert run.row(1.0, "fleet")["unknown"] == 1
    (unknown,) = run.sources.unknown_view(START_S + 1.0)
    assert (unknown["kind"], unknown["id"], unknown["count"]) == ("agent", 8, 2)


def test_a_thing_that_an_operator_retires_stays_away_and_a_restart_knows_the_ids_of_the_others() -> None:
    run = Run("{name: receiver, kind: jsonl, file: x, radius_m: 800}")
    for t_s in range(4):
        seen = [sighting(key, 15_000.0, 900.0 * k, START_S + t_s) for k, key in enumerate("AB")]
        run.sources.feeds["receiver"].offer(seen, START_S + t_s)
        run.tick(float(t_s))
    first, second = run.station.mission.threats
    run.station.command(Retire(do="retire", kind="threat", id=first.id), OPERATOR, START_S + 4.0)
    again = GroundStation(run.station.mission, START_S + 5.0)
    again.operations = run.station.operations
    sources = Sources(run.station.mission, run.station.mission.sources)
    sources.restore(again, START_S + 5.0)
    desk = ObeyingDesk(again)
    for t_s in range(6, 30):
        for key in "AB":
            sources.feeds["receiver"].offer([sighting(key, 15_000.0, 0.0, START_S + t_s)], START_S + t_s)
        desk.now_s = START_S + t_s
        sources.tick(again, desk, START_S + t_s)
    assert [threat.id for threat in again.mission.threats] == [second.id]
    assert again.tracks.tracks[Kind.THREAT, second.id].age_s(START_S + 29.0) == 0.0


def test_what_no_command_can_say_is_refused_and_told() -> None:
    run = Run("{name: receiver, kind: jsonl, file: x, radius_m: 8, within_m: 1000000}")
    for t_s in range(5):
        run.sources.feeds["receiver"].offer([sighting("A", 1_002_500.0, 0.0, START_S + t_s)], START_S + t_s)
        run.tick(float(t_s))
    assert run.station.mission.threats == ()
    assert any("north_m" in line for line in run.sources.news(START_S + 4.0)[1])


def test_a_thing_with_an_id_of_its_own_comes_back_under_another_one_as_none_is_given_twice() -> None:
    run = Run("{name: receiver, kind: jsonl, file: x, radius_m: 8, ids: {A: 40}, timeout_s: 5}")
    ids = []
    for t_s in [*range(5), *range(60, 90)]:
        run.sources.feeds["receiver"].offer([sighting("A", 15_000.0, 0.0, START_S + t_s)], START_S + t_s)
        run.tick(float(t_s))
        run.tick(t_s + 0.7)
        if t_s == 4:
            for later_s in range(5, 60):
                run.tick(float(later_s))
        ids += [threat.id for threat in run.station.mission.threats if threat.id not in ids]
    assert ids == [40, 41]


def test_what_the_ground_station_refuses_is_told_and_not_asked_again_at_once() -> None:
    run = Run("{name: receiver, kind: jsonl, file: x, as: targets}")
    run.sources.news(START_S)
    for t_s in range(10):
        run.sources.feeds["receiver"].offer([sighting("A", 5_000.0, 0.0, START_S + t_s)], START_S + t_s)
        run.tick(float(t_s))
    assert run.row(9.0)["refused"] == 1
    assert any("no more targets than agents" in line for line in run.sources.news(START_S + 9.0)[1])


def test_a_flood_waits_in_a_bounded_queue_and_a_tick_weighs_a_bounded_share_of_every_source() -> None:
    run = Run("{name: receiver, kind: jsonl, file: x, radius_m: 8}", "{name: b, kind: jsonl, file: x, radius_m: 8}")
    flood = [sighting(f"f{number}", 9_000.0, 0.0, START_S) for number in range(MOST_WAITING + 500)]
    run.sources.feeds["receiver"].offer(flood, START_S)
    run.sources.feeds["b"].offer([sighting("B", 9_000.0, 0.0, START_S)], START_S)
    run.tick(0.0)
    assert run.sources.feeds["b"].next() is None
    left = sum(1 for _ in iter(run.sources.feeds["receiver"].next, None))
    assert left == MOST_WAITING - (MOST_PER_TICK - 1)
    assert run.row(0.0)["refused"] == 500
    assert any("500 now" in line for line in run.sources.news(START_S)[1])


def test_a_source_is_late_after_some_of_its_periods_silent_after_more_and_failed_while_its_link_is_not_there() -> None:
    pulse = Pulse()
    assert pulse.health(START_S).state == "silent"
    for t_s in range(20):
        pulse.note(1, START_S + t_s)
    assert [pulse.health(START_S + t_s).state for t_s in (19.5, 25.0, 60.0)] == ["good", "late", "silent"]
    pulse.link.fault = "Connection refused"
    assert pulse.health(START_S + 20.0).state == "failed"


def test_how_a_source_does_is_told_when_that_changes_with_the_reason_and_not_again_and_again() -> None:
    run = Run("{name: receiver, kind: basestation, url: 'tcp:127.0.0.1:1', radius_m: 8}")
    feed = run.sources.feeds["receiver"]
    feed.link.fault = "Connection refused"
    assert run.sources.news(START_S) == ([], ["receiver: failed: Connection refused"])
    assert run.sources.news(START_S + 60.0) == ([], [])
    feed.link.fault, feed.link.note = None, "tcp:127.0.0.1:1"
    feed.hear(b"$GPGGA,no,aircraft\r\n", START_S + 60.0)
    silent = "receiver: silent: tcp:127.0.0.1:1; 1 not readable"
    unread = "receiver: 1 message could not be used: not readable"
    assert run.sources.news(START_S + 61.0) == ([], [unread, silent])
    feed.pulse.note(1, START_S + 80.0)
    assert run.sources.news(START_S + 80.0) == (["receiver: good: tcp:127.0.0.1:1; 1 not readable"], [])


def test_a_recording_played_faster_has_faster_things_and_times_of_now() -> None:
    seen = sighting("A", 0.0, 0.0, 100.0, velocity=10 + 0j, until_s=160.0)
    played = replayed(Due(100.0, seen), START_S - 100.0, 2.0)
    assert (played.at_s, played.velocity, played.until_s) == (START_S, 20 + 0j, START_S + 30.0)


def test_a_recording_of_ais_without_times_is_played_line_by_line() -> None:
    run = Run("{name: receiver, kind: ais, file: x, radius_m: 8}")
    blocks = sightings_in(BytesIO((DATA / "ais.nmea").read_bytes()), "ais", run.sources.feeds["receiver"].parse)
    played = [due for block in blocks for due in block]
    times_s = [due.at_s for due in played]
    assert times_s == sorted(times_s) == [due.sighting.at_s for due in played]
    assert times_s[-1] - times_s[0] == pytest.approx(8.2)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("basestation", "'basestation'; allowed: KIND=URL-OR-FILE"),
        ("adsb=udpin:127.0.0.1:1,radius_m=20,radius_m=30", "radius_m is given twice; allowed: each key once"),
        ("basestaton=tcp:127.0.0.1:30003", "did you mean 'basestation'"),
        ("basestation=tcp:127.0.0.1:30003", "radius_m"),
        ("adsb=udpin:0.0.0.0:14550,radius_m=500", "unsigned"),
        ("csv=nowhere.csv,radius_m=500", "not there"),
        ("telemetry=udpin:127.0.0.1:14550,colour=red", "colour"),
        ("telemetry=udpin:127.0.0.1:14550,most=many", "most"),
        ("ais=file:x.tlog,radius_m=5", "telemetry log"),
        ("adsb=udpin:127.0.0.1:1,radius_m=9,speed_bound_m_s=900", "900 m/s for threats; allowed: at most 855 m/s"),
    ],
)
def test_a_source_on_the_command_line_that_cannot_be_used_is_refused_with_what_is_allowed(text: str, word: str) -> None:
    with pytest.raises(InputError, match="--source") as refused:
        source_specs(mission(), [text], "m", unsigned=False)
    assert word in str(refused.value)
    assert "allowed:" in str(refused.value)


def test_sources_of_mission_and_command_line_have_names_of_their_own() -> None:
    made = mission("{name: telemetry, kind: telemetry, url: 'udpin:127.0.0.1:1'}")
    typed = ["telemetry=udpin:127.0.0.1:2", "adsb=mcast:239.1.1.1:5,radius_m=9,unsigned=true"]
    assert [spec.name for spec in source_specs(made, typed, "m", unsigned=False)] == [
        "telemetry",
        "telemetry-2",
        "adsb",
    ]


def test_a_mission_with_sources_reads_back_equal() -> None:
    made = mission("{name: team, kind: cot, url: 'mcast:239.2.3.1:6969', as: targets, unsigned: true, ids: {x: 4}}")
    assert parse_mission(dump_mission(made), "again") == made


def test_a_damaged_recording_is_played_as_far_as_it_can_be_read_once_and_told(tmp_path: Path) -> None:
    whole = gzip.compress(basestation_bytes())
    (tmp_path / "cut.gz").write_bytes(whole[: len(whole) // 2])
    run = Run(f"{{name: receiver, kind: basestation, file: {tmp_path / 'cut.gz'}, radius_m: 9, play_speed: 1000}}")
    feed = run.sources.feeds["receiver"]
    asyncio.run(asyncio.wait_for(run_source(feed, time.time), 20.0))
    assert feed.pulse.heard > 100
    assert feed.link.fault is not None


def test_a_library_that_fails_on_a_line_of_a_recording_does_not_end_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "ships.nmea").write_bytes((DATA / "ais.nmea").read_bytes())
    run = Run(f"{{name: receiver, kind: ais, file: {tmp_path / 'ships.nmea'}, radius_m: 9, play_speed: 1000}}")
    feed = run.sources.feeds["receiver"]
    parse, calls = feed.parser.feed, count()

    def fails_once(data: bytes, now_s: float, peer: Hashable = None) -> list[Sighting]:
        if next(calls) == 3:
            raise KeyError("a table of the library")
        return parse(data, now_s, peer)

    monkeypatch.setattr(feed.parser, "feed", fails_once)
    asyncio.run(asyncio.wait_for(run_source(feed, time.time), 20.0))
    assert feed.pulse.heard > 10
    assert feed.link.note.endswith("played to its end")
    assert feed.parser.refused["fault of a library: KeyError"] == 1


def test_a_tcp_server_that_comes_later_is_heard_and_its_end_is_told() -> None:
    async def flown() -> tuple[str, str, int]:
        run = Run(f"{{name: receiver, kind: basestation, url: 'tcp:127.0.0.1:{(port := free_port())}', radius_m: 9}}")
        feed = run.sources.feeds["receiver"]
        with ExitStack() as stack:
            run.sources.listen(lambda: START_S, stack)
            while feed.link.fault is None:
                await asyncio.sleep(0.01)
            refused = feed.link.fault

            async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
                writer.write(b"MSG,3,1,1,4B1C22,1,,,,,,3500,,,48.7,2.35,,,,,,0\r\n")
                await writer.drain()
                writer.close()

            async with asyncio.timeout(10.0), await asyncio.start_server(serve, "127.0.0.1", port):
                while not feed.pulse.heard or feed.link.fault is None:
                    await asyncio.sleep(0.01)
            return refused, feed.link.fault, feed.pulse.heard

    refused, ended, heard = asyncio.run(flown())
    assert "refused" in refused
    assert "ended" in ended
    assert heard >= 1


def test_why_messages_of_a_source_are_not_used_is_told_with_the_main_reason_and_again_a_minute_later() -> None:
    run = Run("{name: rows, kind: csv, file: x, radius_m: 8}")
    feed = run.sources.feeds["rows"]
    feed.hear(b"t_s,id,lat_deg,lon_deg\n,A,1,1\n0,A,91,8\n1,A,92,8\n", START_S)
    told = "rows: 3 messages could not be used: 2 not a place on the Earth"
    assert told in run.sources.news(START_S)[1]
    assert run.row(0.0, "rows")["detail"] == "; 2 not a place on the Earth"
    feed.hear(b"2,A,93,8\n", START_S)
    assert run.sources.news(START_S + 1.0)[1] == []
    assert "rows: 4 messages could not be used: 3 not a place on the Earth" in run.sources.news(START_S + 61.0)[1]


def test_two_sources_that_put_one_agent_at_different_places_are_told_apart_by_how_much() -> None:
    run = Run(*(f"{{name: {name}, kind: telemetry, url: 'udpin:127.0.0.1:1'}}" for name in ("one", "two")))
    for name, north_m in (("one", 0.0), ("two", 111.0)):
        run.sources.feeds[name].offer([sighting("1", north_m, 0.0, START_S)], START_S)
    run.tick(0.0)
    (told,) = [line for line in run.sources.news(START_S)[1] if "sees too" in line]
    assert told.endswith("sees too: the two differ by 111 m")


def test_a_folder_or_a_csv_without_the_columns_is_refused_at_the_start(tmp_path: Path) -> None:
    (tmp_path / "wrong.csv").write_text("time,id,lat,lon\n")
    for name, words in (("", "is a folder; allowed: a recording"), ("wrong.csv", "found: time, id, lat, lon")):
        with pytest.raises(InputError, match=words):
            source_specs(mission(), [f"csv={tmp_path / name},radius_m=5"], "m", unsigned=False)
