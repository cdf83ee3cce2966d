"""What the parsers make of real bytes: BaseStation, AIS and Cursor on Target, cut anywhere and damaged."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from takproto import TAKProtoVer, xml2proto

from groundstation.sources.ais import AisParser
from groundstation.sources.basestation import ON_GROUND, BaseStationParser, time_in
from groundstation.sources.cot import NO_THING, CotParser
from groundstation.sources.lines import TOO_LONG, Lines
from groundstation.sources.recording import NO_ID, NO_TIME, OTHER_KIND, RecordingParser, header_fault
from groundstation.sources.sighting import NO_PLACE, NOT_WHOLE, Category, Datum, Parser, Sighting
from tests.groundstation.sources.given import COT, DATA, FRAME, START_S, basestation_bytes

POSITION = b"MSG,3,1,1,4B1C22,1,2021/10/07,12:00:01.500,2021/10/07,12:00:01.500,,3500,,,48.7,2.35,,,,,,0\r\n"
VELOCITY = b"MSG,4,1,1,4B1C22,1,2021/10/07,12:00:01.500,2021/10/07,12:00:01.500,,,100,90,,,-640,,,,,0\r\n"
CALLSIGN = b"MSG,1,1,1,4B1C22,1,2021/10/07,12:00:01.500,2021/10/07,12:00:01.500,SWR12  ,,,,,,,,,,,0\r\n"


def pieces(parser: Parser, data: bytes, size: int, now_s: float = START_S) -> list[Sighting]:
    return [one for at in range(0, len(data), size) for one in parser.feed(data[at : at + size], now_s)]


def test_an_aircraft_of_basestation_is_where_its_position_says_with_the_velocity_and_name_of_its_other_lines() -> None:
    (seen,) = BaseStationParser().feed(CALLSIGN + VELOCITY + POSITION, START_S)
    assert (seen.key, seen.lat_deg, seen.lon_deg, seen.name) == ("4B1C22", 48.7, 2.35, "SWR12")
    assert seen.velocity == pytest.approx(51.444j, abs=1e-3)
    assert seen.altitude_m == pytest.approx(3500 * 0.3048)
    assert (seen.datum, seen.category) == (Datum.PRESSURE, Category.AIRCRAFT)


def test_a_velocity_of_basestation_is_forgotten_when_it_is_old() -> None:
    parser = BaseStationParser()
    parser.feed(VELOCITY, START_S)
    (seen,) = parser.feed(POSITION, START_S + 60.0)
    assert seen.velocity is None


def test_the_real_recording_holds_120_aircraft_and_nothing_that_is_refused() -> None:
    parser = BaseStationParser()
    seen = parser.feed(basestation_bytes(), START_S)
    assert len({one.key for one in seen}) == 120
    assert len(seen) == 3000
    assert not parser.refused


def test_bytes_cut_anywhere_make_the_same_sightings() -> None:
    data = basestation_bytes()[:20_000]
    assert pieces(BaseStationParser(), data, 7) == BaseStationParser().feed(data, START_S)
    ais = (DATA / "ais.nmea").read_bytes()[:1_000]
    assert pieces(AisParser(), ais, 5) == AisParser().feed(ais, START_S)
    cot = COT.encode() * 3
    assert pieces(CotParser(), cot, 11) == CotParser().feed(cot, START_S)


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (POSITION.replace(b"48.7", b"98.7"), NO_PLACE),
        (POSITION.replace(b",,,,0\r", b",,,,-1\r"), ON_GROUND),
        (POSITION.replace(b"4B1C22", b"XYZ"), NOT_WHOLE),
        (b"MSG,3,1\r\n", NOT_WHOLE),
        (b"GET / HTTP/1.1\r\n", NOT_WHOLE),
        (b"M" * 600 + b"\n", TOO_LONG),
    ],
)
def test_a_line_of_basestation_that_cannot_be_used_is_counted_by_its_reason(line: bytes, reason: str) -> None:
    parser = BaseStationParser()
    assert parser.feed(line, START_S) == []
    assert parser.refused == {reason: 1}


def test_ones_own_aircraft_are_seen_on_the_ground_too() -> None:
    line = POSITION.replace(b",,,,0\r", b",,,,-1\r")
    assert len(BaseStationParser(takes_grounded=True).feed(line, START_S)) == 1


@pytest.mark.parametrize("word", ["nan", "inf", "-inf", "1e999"])
def test_what_is_no_number_is_no_place(word: str) -> None:
    assert BaseStationParser().feed(POSITION.replace(b"48.7", word.encode()), START_S) == []


def test_a_recordings_lines_tell_when_they_were_made() -> None:
    assert time_in(VELOCITY) is not None
    assert (time_in(POSITION) or 0.0) % 60.0 == 1.5
    assert time_in(b"MSG,3") is None


def test_of_a_line_that_is_too_long_nothing_is_kept_and_the_next_one_is_found() -> None:
    lines = Lines(10, refused := AisParser().refused)
    found = [lines.feed(part) for part in (b"x" * 50, b"x" * 50, b"x\nshort\n")]
    assert found == [[], [], [b"short"]]
    assert refused == {TOO_LONG: 1}


def test_the_real_sentences_of_ais_are_60_ships_and_aircraft_where_pyais_has_them() -> None:
    parser = AisParser()
    seen = parser.feed((DATA / "ais.nmea").read_bytes(), START_S)
    assert len(seen) == 83
    assert len({one.key for one in seen}) == 60
    assert sum(one.category is Category.AIRCRAFT for one in seen) == 3
    assert not parser.refused


@pytest.mark.parametrize(("minute_s", "ago_s"), [(59.0, 0.0), (62.0, 3.0), (57.0, 0.0), (40.0, 41.0)])
def test_a_sentence_of_ais_tells_the_second_of_the_minute_at_which_it_was_true(minute_s: float, ago_s: float) -> None:
    # It was true at second 59; one that is a little ahead is of now.
    line = b"!AIVDM,1,1,,B,15M67FC000G?ufbE`FepT@3n00Sa,0*5C\n"
    now_s = 60.0 * 29_833_333 + minute_s
    (seen,) = AisParser().feed(line, now_s)
    assert now_s - seen.at_s == pytest.approx(ago_s, abs=1e-3)


def test_a_sentence_of_ais_that_was_cut_off_is_refused_even_if_its_checksum_is_right() -> None:
    parser = AisParser()
    assert parser.feed(b"!AIVDO,1,1,,A,10000NwP0000000000,*4C\r\n", START_S) == []
    assert parser.refused == {NOT_WHOLE: 1}


def test_a_sentence_of_ais_with_a_wrong_checksum_is_refused() -> None:
    parser = AisParser()
    line = (DATA / "ais.nmea").read_bytes().split(b"\n")[0]
    assert parser.feed(line[:-1] + (b"0" if line[-1:] != b"0" else b"1") + b"\n", START_S) == []
    assert parser.refused == {NOT_WHOLE: 1}


def test_an_event_of_cot_is_a_thing_with_its_time_velocity_error_and_the_time_until_which_it_counts() -> None:
    (seen,) = CotParser().feed(COT.encode(), START_S)
    assert (seen.key, seen.name, seen.category) == ("ICAO-4B1C22", "SWR12", Category.AIRCRAFT)
    assert seen.at_s == pytest.approx(START_S + 0.123456)
    assert seen.until_s == START_S + 120.0
    assert seen.velocity == pytest.approx(51.4j)
    assert (seen.altitude_m, seen.datum, seen.error_m) == (620.0, Datum.ELLIPSOID, 35.0)


@pytest.mark.parametrize("version", [TAKProtoVer.MESH, TAKProtoVer.STREAM])
def test_the_same_event_encoded_by_takproto_is_the_same_thing(version: TAKProtoVer) -> None:
    (seen,) = CotParser().feed(bytes(xml2proto(COT, version)), START_S)
    (by_xml,) = CotParser().feed(COT.encode(), START_S)
    assert seen._replace(at_s=0.0) == by_xml._replace(at_s=0.0)
    assert seen.at_s == pytest.approx(by_xml.at_s, abs=1e-3)


def test_an_event_that_takproto_itself_cannot_convert_is_read() -> None:
    text = COT.replace("20.123456Z", "20.1234567Z").replace("85", "85.5")
    assert CotParser().feed(text.encode(), START_S) == CotParser().feed(COT.encode(), START_S)


def test_events_of_both_kinds_on_one_stream_are_found_one_after_the_other() -> None:
    stream = COT.encode() + bytes(xml2proto(COT, TAKProtoVer.STREAM)) + b"\n" + COT.encode()
    assert len(pieces(CotParser(), stream, 13)) == 3


def test_entities_of_a_document_type_are_never_expanded() -> None:
    parser = CotParser()
    kind = '<!DOCTYPE e [<!ENTITY a "aaaaaaaaaa">]>'
    bomb = COT.replace("<event", f"{kind}<event", 1).replace("SWR12", "&a;")
    inside = COT.replace("<point", f"{kind}<point", 1)
    assert parser.feed(bomb.encode() + inside.encode(), START_S) == []
    assert parser.refused == {NOT_WHOLE: 2}


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (("a-n-A-C-F", "b-m-p-s-m"), NO_THING),
        (('lat="48.70"', 'lat="NaN"'), NO_PLACE),
        (("2026-09-21T14:13:20.123456Z", "yesterday"), NOT_WHOLE),
        (("</detail>", ""), NOT_WHOLE),
    ],
)
def test_an_event_of_cot_that_cannot_be_used_is_counted_by_its_reason(change: tuple[str, str], reason: str) -> None:
    parser = CotParser()
    assert parser.feed(COT.replace(*change).encode(), START_S) == []
    assert parser.refused == {reason: 1}


def test_a_recording_as_csv_and_the_same_as_json_make_the_same_sightings() -> None:
    csv = b"t_s,id,lat_deg,lon_deg,heading_deg,speed_m_s,other\n1.5,7,48.7,2.35,90,10,x\n"
    line = b'{"t_s": 1.5, "id": 7, "lat_deg": 48.7, "lon_deg": 2.35, "heading_deg": 90, "speed_m_s": 10}\n'
    (by_csv,) = RecordingParser(FRAME, "threats", is_json=False).feed(csv, 0.0)
    (by_json,) = RecordingParser(FRAME, "threats", is_json=True).feed(line, 0.0)
    assert by_csv == by_json
    assert (by_csv.key, by_csv.at_s) == ("7", 1.5)
    assert by_csv.velocity == pytest.approx(10j)


def test_a_recording_in_metres_of_several_kinds_is_read_as_the_kind_that_is_meant() -> None:
    csv = b"t_s,kind,id,north_m,east_m,heading_deg,speed_m_s\n0,agent,1,0,0,0,9\n0,threat,2,1000,500,0,9\n"
    parser = RecordingParser(FRAME, "threats", is_json=False)
    (seen,) = parser.feed(csv, 0.0)
    assert FRAME.to_local(seen.lat_deg, seen.lon_deg) == pytest.approx((1000.0, 500.0), abs=1e-3)
    assert parser.refused == {OTHER_KIND: 1}


PARSERS: dict[str, tuple[Callable[[], Parser], bytes]] = {
    "basestation": (BaseStationParser, CALLSIGN + VELOCITY + POSITION),
    "ais": (AisParser, b"!AIVDM,1,1,,B,15M67FC000G?ufbE`FepT@3n00Sa,0*5C\n"),
    "cot": (CotParser, COT.encode()),
    "csv": (lambda: RecordingParser(FRAME, "threats", is_json=False), b"t_s,id,lat_deg,lon_deg\n1,2,3,4\n"),
    "jsonl": (lambda: RecordingParser(FRAME, "threats", is_json=True), b'{"t_s":1,"id":2,"lat_deg":3,"lon_deg":4}\n'),
}


@pytest.mark.parametrize("name", PARSERS)
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_damaged_bytes_never_raise_and_what_is_seen_is_on_the_earth(name: str, data: st.DataObject) -> None:
    make, valid = PARSERS[name]
    parser: Parser = make()
    damaged = bytearray(valid)
    for _ in range(data.draw(st.integers(0, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    for seen in parser.feed(bytes(damaged) + data.draw(st.binary(max_size=20)) + b"\n", START_S):
        assert abs(seen.lat_deg) <= 90.0 and abs(seen.lon_deg) <= 180.0
        assert seen.velocity is None or math.isfinite(abs(seen.velocity))


COLUMNS = "t_s,id,lat_deg,lon_deg,name"
ROW = "1.5,7,48.7,2.35,x"


@pytest.mark.parametrize(
    "text",
    [
        f"\ufeff{COLUMNS}\r\n{ROW}\r\n",
        f"{COLUMNS}\n{ROW}\n".replace(",", "\t"),
        f"\ufeff{COLUMNS}\n{ROW}\n".replace(",", ";"),
        f"{COLUMNS}\n{ROW}\n".replace(",", ";").replace(".", ","),
    ],
)
def test_a_csv_as_spreadsheets_write_it_is_read(text: str) -> None:
    parser = RecordingParser(FRAME, "threats", is_json=False)
    (seen,) = parser.feed(text.encode(), 0.0)
    assert (seen.at_s, seen.key, seen.lat_deg, seen.lon_deg, seen.name) == (1.5, "7", 48.7, 2.35, "x")


def test_a_header_without_what_a_sighting_needs_is_told_with_what_was_found() -> None:
    assert header_fault(b"time,id,lat,lon\n") == (
        "no column t_s; lat_deg and lon_deg, or north_m and east_m; found: time, id, lat, lon; allowed: t_s, id and a "
        "place"
    )
    assert header_fault(b"\xff\xfet\x00") == "its first line is no text; allowed: CSV in UTF-8 with a header"
    assert header_fault(COLUMNS.encode()) is None


def test_a_row_without_time_or_id_is_counted_by_what_it_lacks() -> None:
    parser = RecordingParser(FRAME, "threats", is_json=False)
    assert parser.feed(f"{COLUMNS}\n,7,48.7,2.35,x\n1,,48.7,2.35,x\n".encode(), 0.0) == []
    assert parser.refused == {NO_TIME: 1, NO_ID: 1}
