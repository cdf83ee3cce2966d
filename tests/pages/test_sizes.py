"""Functions and classes keep the limits of docs/design.md, Sizes, or stand there with their reason."""

from __future__ import annotations

import re

from tests.pages.citations import DOCS
from tests.pages.sizes import sizes

MAX_LINES = 60
MAX_PARAMETERS = 6
MAX_ATTRIBUTES = 12


def test_no_function_is_longer_than_the_design_allows() -> None:
    assert [each for each in sizes() if not each.is_class and each.lines > MAX_LINES] == []


def test_no_class_has_more_attributes_than_the_design_allows() -> None:
    assert [each for each in sizes() if each.is_class and each.attributes > MAX_ATTRIBUTES] == []


def test_every_function_with_many_parameters_stands_in_the_design_with_its_reason() -> None:
    table = (DOCS / "design.md").read_text().split("<!-- parameters -->")[1]
    rows = re.findall(r"^\| `([^`]+)` \| (\d+) \| (.+) \|$", table, re.MULTILINE)
    assert {(name, int(count)) for name, count, _ in rows} == {
        (each.name, each.parameters) for each in sizes() if each.parameters > MAX_PARAMETERS
    }
    assert all(len(reason.split()) >= 4 for *_, reason in rows)
