"""YAML whose aliases stand for more than can be checked is refused at once and in one line, wherever it is read."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import InputError
from companion.files.yaml import MAX_VALUES, parse_yaml, with_numbers
from companion.mission.model import parse_mission
from companion.onboard.config import parse_config

POINTS = ", ".join(["*p"] * 900)
PATHS = f"name: a\ntargets: [{{id: 1, motion: {{path: &q [&p [0, 0, 0], {POINTS}]}}}}"
WIDE_MISSION = PATHS + "".join(f", {{id: {k}, motion: {{path: *q}}}}" for k in range(2, 400)) + "]\n"
"""Valid everywhere, and 360 000 points of 400 paths in a few kilobytes: with the numbers in them too many."""
WIDE_CONFIG = (
    "agent_id: 1\nlimits:\n  exclusions: [&e [&c [0, 0], "
    + ", ".join(["*c"] * 999)
    + "], "
    + ", ".join(["*e"] * 900)
    + "]\n"
)


@pytest.mark.parametrize(
    ("parse", "text", "key"), [(parse_mission, WIDE_MISSION, "targets"), (parse_config, WIDE_CONFIG, "limits")]
)
def test_what_fits_the_model_but_has_no_end_is_refused_by_its_key(
    parse: Callable[[str, str], object], text: str, key: str
) -> None:
    assert len(text) < 20_000
    with pytest.raises(InputError) as caught:
        parse(text, "bomb.yaml")
    assert str(caught.value) == (f"bomb.yaml: {key}: aliases stand for too much; allowed: {MAX_VALUES} values in all")


def test_a_few_aliases_are_a_convenience() -> None:
    text = "agents: [{id: 1, north_m: &n 5, east_m: *n}]\ntargets: [{id: 1, north_m: *n, east_m: 2000}]\n"
    assert parse_mission(text, "x").agents[0].east_m == 5.0


@given(st.integers(1, 40), st.integers(1, 9))
def test_bombs_of_any_shape_are_refused_at_once(depth: int, width: int) -> None:
    text = "name:\n  a0: &a0 [1, 1]\n"
    text += "".join(f"  a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * width)}]\n" for k in range(1, depth))
    with pytest.raises(InputError, match="name"):
        parse_mission(text, "x")
    parse_yaml(text, "x")
    with_numbers(text, "limits", {"speed_m_s": 1.0}, "x")
