"""Exports of a store: every form holds what the store holds, and common tools read it."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from pymavlink import mavutil

from companion.errors import InputError
from groundstation.store.database import Database
from groundstation.store.export import Slice, event_line, export
from groundstation.store.log_command import log_store, time_of
from groundstation.store.rows import EventRow
from tests.groundstation.store.recorded import NOW_S, recorded_store

WHOLE = Slice()


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("store") / "day.state"
    recorded_store(path)
    return path


def exported(store: Path, out: Path, time: Slice = WHOLE, places: bool = False) -> int:
    database = Database.read_only(store)
    try:
        return export(database, out, time, places)
    finally:
        database.close()


def test_events_as_csv_have_a_row_each_with_who_and_what(store: Path, tmp_path: Path) -> None:
    assert exported(store, tmp_path / "x.csv") == 4
    rows = list(csv.DictReader((tmp_path / "x.csv").open(newline="")))
    assert [(row["number"], row["who"], row["role"], row["event"]) for row in rows] == [
        ("1", "ground station", "station", "started"),
        ("2", "anna", "operator", "pinned"),
        ("3", "anna", "operator", "threat-added"),
        ("4", "anna", "operator", "retired"),
    ]
    assert json.loads(rows[2]["details"])["name"] == 'fire, "north"'
    assert rows[1]["time"].endswith("Z") and float(rows[1]["unix_s"]) == NOW_S + 10.0


def test_events_as_json_are_the_events_and_a_slice_holds_its_time_only(store: Path, tmp_path: Path) -> None:
    exported(store, tmp_path / "x.json", Slice(NOW_S + 15.0, NOW_S + 25.0))
    events = json.loads((tmp_path / "x.json").read_text())["events"]
    assert [event["number"] for event in events] == [3]
    exported(store, tmp_path / "none.json", Slice(0.0, 1.0))
    assert json.loads((tmp_path / "none.json").read_text()) == {"events": []}


def test_places_have_a_row_for_everything_in_each_picture(store: Path, tmp_path: Path) -> None:
    assert exported(store, tmp_path / "x.csv", places=True) == 40 * 4
    rows = list(csv.DictReader((tmp_path / "x.csv").open(newline="")))
    agent = [row for row in rows if (row["kind"], row["id"]) == ("agent", "2")]
    assert [float(row["north_m"]) for row in agent[:3]] == [0.0, 60.0, 120.0]


def test_pymavlink_reads_every_frame_of_the_tlog(store: Path, tmp_path: Path) -> None:
    assert exported(store, tmp_path / "x.tlog") == 40
    log = mavutil.mavlink_connection(str(tmp_path / "x.tlog"))
    times_s = []
    while (message := log.recv_msg()) is not None:
        times_s.append(message._timestamp)
    assert times_s == pytest.approx([NOW_S + second for second in range(40)])


def test_an_mcap_holds_map_scene_and_log_in_the_order_of_time(store: Path, tmp_path: Path) -> None:
    assert exported(store, tmp_path / "x.mcap") == 4 + 40 * 4
    with (tmp_path / "x.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        messages = list(reader.iter_decoded_messages(log_time_order=False))
    first: dict[str, Any] = {}
    for _, channel, _, content in messages:
        first.setdefault(channel.topic, content)
    assert set(first) == {"/events", "/agents/1", "/agents/2", "/map", "/scene"}
    times_ns = [message.log_time for _, _, message, _ in messages]
    assert times_ns == sorted(times_ns)
    fix = first["/agents/1"]
    assert (fix.latitude, fix.longitude) == pytest.approx((47.0, 8.0))
    scene = first["/scene"]
    assert [entity.id for entity in scene.entities] == ["agent 1", "agent 2", "target 7", "threat 4"]
    assert scene.entities[3].cylinders[0].size.x == 2.0 * 910.0
    features = json.loads(first["/map"].geojson)["features"]
    assert [one["properties"]["name"] for one in features][-1] == "fence"


def test_an_unknown_ending_and_places_of_a_tlog_are_refused_and_write_nothing(store: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="--out: .*x.txt'; allowed: a name that ends in .csv, .json, .tlog, .mcap"):
        exported(store, tmp_path / "x.txt")
    with pytest.raises(InputError, match="--places: with --out .*x.tlog; allowed: with .csv and .json"):
        exported(store, tmp_path / "x.tlog", places=True)
    assert list(tmp_path.iterdir()) == []


def test_an_event_is_one_line_for_people(store: Path) -> None:
    database = Database.read_only(store)
    lines = [event_line(row) for row in database.events()]
    database.close()
    assert lines[1] == "     2 2026-09-21T14:13:30.000Z anna: pinned: agent 2, target 7"


@pytest.mark.parametrize(
    "text", ["1790000000", "2026-09-21T14:13:20Z", "2026-09-21T14:13:20", "2026-09-21T16:13:20+02:00"]
)
def test_a_time_is_seconds_or_iso(text: str) -> None:
    assert time_of(text, "--from", 0.0) == NOW_S


@pytest.mark.parametrize(
    "text", ["noon", "inf", "nan", "1e20", "-1", "0001-01-01T00:00:00+14:00", "9999-12-31T23:59:59-12:00"]
)
def test_a_time_that_is_none_or_that_no_date_has_is_refused(text: str) -> None:
    with pytest.raises(InputError) as refused:
        time_of(text, "--to", 0.0)
    assert f"--to: '{text}'; allowed: Unix seconds, or a time such as" in str(refused.value)


def test_an_export_replaces_no_file_and_a_time_that_ends_before_it_begins_is_refused(
    store: Path, tmp_path: Path
) -> None:
    (tmp_path / "day.csv").write_text("kept")
    with pytest.raises(InputError, match="--out: .*day.csv is there already; allowed: the name of a new file"):
        log_store(store, WHOLE, tmp_path / "day.csv", False)
    assert (tmp_path / "day.csv").read_text() == "kept"
    with pytest.raises(InputError, match="--from: 2026-.*, later than --to 2026-"):
        log_store(store, Slice(NOW_S + 1.0, NOW_S), None, False)


@given(st.text(min_size=1, max_size=40), st.text(min_size=1, max_size=40))
def test_no_name_in_a_store_forges_a_line_of_the_days_record(who: str, name: str) -> None:
    body = json.dumps({"number": 3, "who": {"name": who}, "name": name, "event": "threat-added"})
    line = event_line(EventRow(3, NOW_S, who, "threat-added", body))
    assert line.isprintable()
    assert line.startswith("     3 2026-09-21T14:13:20.000Z ")
