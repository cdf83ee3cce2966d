"""Every field situation as a test: docs/field.md is the table of what is wanted, and of what was seen before."""

from __future__ import annotations

import pytest

from tests.field.table import by_title

SITUATIONS = by_title()


@pytest.mark.parametrize("title", SITUATIONS)
def test_a_situation_of_the_field_ends_as_it_should(title: str) -> None:
    assert SITUATIONS[title].play()
