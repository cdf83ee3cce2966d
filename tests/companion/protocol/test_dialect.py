"""The private dialect: generated from its XML, valid, small enough for every frame, and out of everybody's way."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import pymavlink.generator
import pytest
from lxml import etree
from pymavlink.dialects.v20 import minimal

from companion.protocol.dialect import oneway
from companion.protocol.dialect.__main__ import FOLDER, generate

XML = FOLDER / "oneway.xml"
OUR_MESSAGES = (
    "ONEWAY_STATE",
    "ONEWAY_MOTION",
    "ONEWAY_DETECTIONS",
    "ONEWAY_REPORT",
    "ONEWAY_BANDS",
    "ONEWAY_FLEET",
    "ONEWAY_RADII",
    "ONEWAY_MISSION",
    "ONEWAY_DECISION",
)
CRC_EXTRA = {
    "ONEWAY_STATE": 223,
    "ONEWAY_MOTION": 60,
    "ONEWAY_DETECTIONS": 88,
    "ONEWAY_REPORT": 110,
    "ONEWAY_BANDS": 62,
    "ONEWAY_FLEET": 183,
    "ONEWAY_RADII": 247,
    "ONEWAY_MISSION": 117,
    "ONEWAY_DECISION": 233,
}
"""A change of a field changes these: old and new vehicles then no longer hear each other."""
MESSAGE_IDS = {
    "ONEWAY_STATE": 0xA00100,
    "ONEWAY_MOTION": 0xA00101,
    "ONEWAY_DETECTIONS": 0xA00102,
    "ONEWAY_REPORT": 0xA00103,
    "ONEWAY_BANDS": 0xA00104,
    "ONEWAY_FLEET": 0xA00105,
    "ONEWAY_RADII": 0xA00106,
    "ONEWAY_MISSION": 0xA00107,
    "ONEWAY_DECISION": 0xA00108,
}
FLOATS = ("picture_age", "wanted_heading", "heading", "speed", "altitude")
"""Floats of a decision that may be missing."""
GREATEST_PUBLIC_ID = 0xA00000
GREATEST_PAYLOAD_BYTES = 255
IN_UNITS_OF_RESOLUTION = ("in units of resolution", "in units of 256 times the resolution")
COUNTS_AND_NAMES = {
    "sequence",
    "frame_index",
    "frame_count",
    "agent_count",
    "target_count",
    "threat_count",
    "count",
    "id",
    "agent_id",
    "target_id",
    "threat_id",
    "agent_id_base",
    "target_id_base",
    "threat_id_base",
    "agent_target",
    "ed25519_signature",
    "data",
    "purpose",
    "stage",
    "surrogate_digest",
    "mission_digest",
    "revision",
    "picture_threats",
    "picture_targets",
    "words_crc",
    # A code, of which the text of the field says what it means.
    "threat_speed_bound",
}
ENUM_FIELDS = {
    ("ONEWAY_STATE", "directive"): "ONEWAY_DIRECTIVE",
    ("ONEWAY_DETECTIONS", "kind"): "ONEWAY_KIND",
    ("ONEWAY_FLEET", "directive"): "ONEWAY_DIRECTIVE",
    ("ONEWAY_DECISION", "flags"): "ONEWAY_DECISION_FLAGS",
}


def messages() -> dict[str, type[oneway.MAVLink_message]]:
    return {kind.msgname: kind for kind in oneway.mavlink_map.values()}


def fields() -> Iterator[tuple[str, ElementTree.Element]]:
    for message in ElementTree.parse(XML).getroot().iter("message"):
        for field in message.iter("field"):
            yield message.attrib["name"], field


def in_units_of_resolution(field: ElementTree.Element) -> bool:
    return any(unit in (field.text or "").lower() for unit in IN_UNITS_OF_RESOLUTION)


def test_regenerating_gives_the_files_that_are_shipped(tmp_path: Path) -> None:
    generated = generate(tmp_path)
    assert {path.name for path in generated} == {"oneway.py", "oneway.lua"}
    for path in generated:
        assert path.read_bytes() == (FOLDER / path.name).read_bytes()


def test_the_xml_obeys_the_mavlink_schema_with_its_units() -> None:
    schema_path = Path(pymavlink.generator.__file__).parent / "mavschema.xsd"
    schema = etree.XMLSchema(etree.parse(str(schema_path)))
    assert schema.validate(etree.parse(str(XML))), schema.error_log


def test_the_schema_would_refuse_a_unit_that_does_not_exist() -> None:
    schema_path = Path(pymavlink.generator.__file__).parent / "mavschema.xsd"
    schema = etree.XMLSchema(etree.parse(str(schema_path)))
    broken = etree.fromstring(XML.read_bytes().replace(b'units="cm/s"', b'units="knots"', 1))
    assert not schema.validate(broken)


@pytest.mark.parametrize("name", OUR_MESSAGES)
def test_every_message_fits_a_mavlink_payload(name: str) -> None:
    assert messages()[name].unpacker.size <= GREATEST_PAYLOAD_BYTES


@pytest.mark.parametrize("name", OUR_MESSAGES)
def test_the_layout_of_a_message_is_pinned(name: str) -> None:
    assert messages()[name].crc_extra == CRC_EXTRA[name]


@pytest.mark.parametrize("name", OUR_MESSAGES)
def test_the_id_of_a_message_is_pinned_far_from_the_public_ranges(name: str) -> None:
    assert messages()[name].id == MESSAGE_IDS[name]
    assert GREATEST_PUBLIC_ID < MESSAGE_IDS[name] < 2**24


def test_the_dialect_holds_its_messages_and_the_minimal_set_only() -> None:
    public = {kind.msgname for kind in minimal.mavlink_map.values()}
    assert set(messages()) == {*OUR_MESSAGES, *public}
    assert "HEARTBEAT" in public


def test_every_field_with_a_dimension_names_its_unit() -> None:
    bare = {
        (message, field.attrib["name"])
        for message, field in fields()
        if "units" not in field.attrib
        and "enum" not in field.attrib
        and not in_units_of_resolution(field)
        and field.attrib["name"] not in COUNTS_AND_NAMES
    }
    assert bare == set()


def test_lengths_in_units_of_resolution_belong_to_a_message_that_says_what_its_resolution_is() -> None:
    scaled = {message for message, field in fields() if in_units_of_resolution(field)}
    resolutions = {
        message for message, field in fields() if field.attrib["name"] == "resolution" and field.attrib["units"] == "cm"
    }
    assert scaled == {"ONEWAY_STATE", "ONEWAY_FLEET"}
    # The radii of ONEWAY_RADII are in its data, as the enum of sections says.
    assert resolutions == {"ONEWAY_STATE", "ONEWAY_FLEET", "ONEWAY_RADII"}


def test_fields_that_mean_one_of_a_few_things_name_their_enum() -> None:
    named = {(m, field.attrib["name"]): field.attrib["enum"] for m, field in fields() if "enum" in field.attrib}
    assert named == ENUM_FIELDS
    assert set(named.values()) <= set(oneway.enums)


def test_every_message_and_field_is_described() -> None:
    for message in ElementTree.parse(XML).getroot().iter("message"):
        description = message.find("description")
        assert description is not None
        assert description.text
    assert all((field.text or "").strip() for _, field in fields())


@pytest.mark.parametrize("name", ["ONEWAY_STATE", "ONEWAY_MOTION", "ONEWAY_BANDS"])
def test_an_unsigned_frame_ends_before_the_signature(name: str) -> None:
    kind = messages()[name]
    assert kind.ordered_fieldnames[-1] == "ed25519_signature"
    assert kind.lengths[-1] == 64


def test_a_value_that_stands_for_unknown_is_said_in_the_xml() -> None:
    unknown = {
        (message, field.attrib["name"]): field.attrib["invalid"]
        for message, field in fields()
        if "invalid" in field.attrib
    }
    assert unknown == {
        ("ONEWAY_STATE", "agent_north"): "[INT16_MIN]",
        ("ONEWAY_STATE", "agent_east"): "[INT16_MIN]",
        ("ONEWAY_MOTION", "agent_heading"): "[UINT16_MAX]",
        ("ONEWAY_BANDS", "threat_floor"): "[INT16_MIN]",
        ("ONEWAY_BANDS", "threat_ceiling"): "[INT16_MAX]",
        **{("ONEWAY_DECISION", name): "NaN" for name in FLOATS},
        ("ONEWAY_DECISION", "target_id"): "0",
    }


def test_nothing_on_the_air_is_a_float_that_could_be_no_number() -> None:
    floats = {(message, field.attrib["name"]) for message, field in fields() if field.attrib["type"] == "float"}
    assert floats == {("ONEWAY_DECISION", name) for name in (*FLOATS, "certified")}


@pytest.mark.parametrize("name", ["ONEWAY_FLEET", "ONEWAY_RADII", "ONEWAY_MISSION"])
def test_a_packed_message_ends_with_the_size_of_its_data_and_the_data(name: str) -> None:
    kind = messages()[name]
    assert kind.ordered_fieldnames[:3] == ["epoch", "time_ms", "sequence"]
    assert kind.ordered_fieldnames[-2:] == ["size", "data"]
    assert kind.unpacker.size == GREATEST_PAYLOAD_BYTES
