"""The table of parameters by firmware, its page, and that every remedy is in the words of a firmware."""

from __future__ import annotations

import math
import re

import pytest
from pymavlink.dialects.v20 import common

from companion.autopilot.firmware import (
    ENDINGS,
    FAMILIES,
    TABLE,
    Firmware,
    firmware_of,
    known,
    names,
    versions,
)
from companion.autopilot.registry import ADAPTERS
from tests.pages.parameters import MARK, PAGE, page_with_tables

KINDS = tuple(FAMILIES)
NAME = re.compile(r"\b[A-Z][A-Z0-9]+(?:_[A-Z0-9]+)+\b")
"""What looks like a parameter's name."""


def version_frame(major: int, minor: int) -> bytes:
    message = common.MAVLink_autopilot_version_message(
        0, major << 24 | minor << 16 | 255, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0
    )
    return bytes(message.pack(common.MAVLink(None, srcSystem=1, srcComponent=1)))


def test_the_page_is_what_the_table_says() -> None:
    page = PAGE.read_text(encoding="utf-8")
    assert MARK in page
    assert page == page_with_tables(page)


@pytest.mark.parametrize("kind", KINDS)
def test_every_parameter_that_is_read_is_in_the_table_and_has_one_name_in_each_version(kind: str) -> None:
    family = FAMILIES[kind]
    for wanted in ADAPTERS[kind]().wanted:
        rows = [known(kind, name) for name in wanted.names]
        assert all(rows), wanted.names
        for version in versions(family):
            has = [row for row in rows if row is not None and row.is_in(Firmware(family, version))]
            assert len(has) <= 1
            assert has or wanted.optional, (wanted.names, version)


@pytest.mark.parametrize("kind", KINDS)
def test_other_names_differ_by_their_units_alone(kind: str) -> None:
    scale = {"cdeg": 0.01, "deg": 1.0, "cm/s^2": 0.01, "m/s^2": 1.0, "m/s": 1.0, "cm/s": 0.01}
    for wanted in ADAPTERS[kind]().wanted:
        first = known(kind, wanted.name)
        assert first is not None
        for name, factor in wanted.others:
            other = known(kind, name)
            assert other is not None
            assert factor == pytest.approx(scale[other.unit] / scale[first.unit])
            assert other.default * factor == pytest.approx(first.default)


@pytest.mark.parametrize("kind", KINDS)
def test_every_remedy_names_a_parameter_of_that_firmware_and_a_value_in_its_range(kind: str) -> None:
    family = FAMILIES[kind]
    adapter = ADAPTERS[kind]()
    for demand in adapter.parameter_checks:
        for told in adapter.parameters.names_of(demand.name):
            row = known(kind, told.name)
            assert row is not None
            # As far as it was flown: more than the reference recommends, never less.
            assert row.least <= demand.best_for(told) <= row.greatest
            assert set(NAME.findall(demand.remedy(told) + demand.why)) <= names(family) | {"COM_OBL_RC_ACT"}
    assert set(NAME.findall(adapter.abilities.airspeed_remedy)) <= names(family)


def test_the_page_on_deployment_names_only_parameters_that_a_firmware_has() -> None:
    page = (PAGE.parent / "deploy.md").read_text(encoding="utf-8")
    section = page.split("**The autopilot's parameters.**")[1].split("## Before each flight")[0]
    every = {row.name for row in TABLE}
    assert set(NAME.findall(section)) - {"ALT_HOLD"} <= every


@pytest.mark.parametrize("family", sorted(set(FAMILIES.values())))
def test_what_ends_the_steering_is_in_the_table(family: str) -> None:
    assert set(ENDINGS[family]) <= names(family)


def test_the_spans_are_within_the_versions_and_names_are_once_in_each_firmware() -> None:
    assert len({(row.family, row.name) for row in TABLE}) == len(TABLE)
    for row in TABLE:
        assert row.since in versions(row.family)
        assert row.until in versions(row.family)
        assert row.since <= row.until
        assert row.least <= row.default <= row.greatest


@pytest.mark.parametrize(
    ("kind", "version", "words"),
    [("arducopter", (4, 7), "Copter 4.7"), ("ardurover", (4, 4), "Rover 4.4"), ("px4-plane", (1, 16), "PX4 1.16")],
)
def test_the_firmware_is_heard(kind: str, version: tuple[int, int], words: str) -> None:
    heard = firmware_of(kind, version[0] << 24 | version[1] << 16 | 255)
    assert str(heard) == words


@pytest.mark.parametrize(("kind", "number"), [("kinematic", 4 << 24), ("arducopter", 0)])
def test_a_vehicle_without_a_version_has_no_firmware(kind: str, number: int) -> None:
    assert firmware_of(kind, number) is None


def test_a_version_beyond_the_table_counts_as_the_nearest() -> None:
    newest = known("arducopter", "WP_ACC")
    oldest = known("arducopter", "WPNAV_ACCEL")
    assert newest is not None
    assert oldest is not None
    assert newest.is_in(Firmware("Copter", (4, 9)))
    assert oldest.is_in(Firmware("Copter", (4, 0)))
    assert not oldest.is_in(Firmware("Plane", (4, 4)))


def test_bounds_that_the_reference_lacks_are_none() -> None:
    row = known("arducopter", "BATT_CAPACITY")
    assert row is not None
    assert (row.least, row.greatest) == (-math.inf, math.inf)
