"""Writing numbers into a YAML file without touching anything else of it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import InputError
from companion.files.yaml import parse_yaml, with_numbers

BLOCK = """# mine
agent_id: 1
limits:          # as flown
  # turns
  rate_share: 1  # guessed
  n_max: 0.25
height_m: 20
"""
FLOW = "agent_id: 1  # mine\nlimits: {speed_m_s: 4, rate_share: 1.0}   # as flown\n"


def test_a_number_that_is_there_is_replaced_and_its_comment_stays() -> None:
    assert with_numbers(BLOCK, "limits", {"rate_share": 0.35}, "c") == BLOCK.replace(
        "rate_share: 1 ", "rate_share: 0.35 "
    )


def test_a_key_that_is_not_there_goes_before_the_others_of_a_block() -> None:
    written = with_numbers(BLOCK, "limits", {"reaction_s": 0.8}, "c")
    assert written == BLOCK.replace("  rate_share", "  reaction_s: 0.8\n  rate_share")


def test_keys_are_set_and_added_in_braces() -> None:
    written = with_numbers(FLOW, "limits", {"rate_share": 0.35, "reaction_s": 0.8}, "c")
    assert written == FLOW.replace(
        "{speed_m_s: 4, rate_share: 1.0}", "{reaction_s: 0.8, speed_m_s: 4, rate_share: 0.35}"
    )


def test_a_section_that_is_not_there_goes_to_the_end() -> None:
    assert with_numbers("agent_id: 1\n", "limits", {"n_max": 0.2}, "c") == "agent_id: 1\nlimits: {n_max: 0.2}\n"


def test_a_section_that_is_no_mapping_is_an_error_on_one_line() -> None:
    with pytest.raises(InputError, match=r"^c: limits: not a mapping that numbers can be written into$"):
        with_numbers("limits: 3\n", "limits", {"n_max": 0.2}, "c")


@given(
    st.sampled_from((BLOCK, FLOW, "agent_id: 1\n")),
    st.dictionaries(st.sampled_from(("rate_share", "reaction_s", "n_max")), st.integers(1, 999), min_size=1),
)
def test_the_section_then_holds_the_numbers_and_all_else_is_as_before(text: str, hundredths: dict[str, int]) -> None:
    values = {key: number / 100.0 for key, number in hundredths.items()}
    before, after = parse_yaml(text, "c"), parse_yaml(with_numbers(text, "limits", values, "c"), "c")
    assert isinstance(before, dict) and isinstance(after, dict)
    assert after == before | {"limits": before.get("limits", {}) | values}
    assert [line.partition("#")[2] for line in text.splitlines() if "#" in line] == [
        line.partition("#")[2] for line in with_numbers(text, "limits", values, "c").splitlines() if "#" in line
    ]
