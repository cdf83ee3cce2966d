"""What a radio's name stands for, and what is no radio."""

from __future__ import annotations

import pytest

from companion.errors import InputError
from groundstation.choices import RADIOS_BYTES_PER_S
from groundstation.radio import Radio, parse_radio


@pytest.mark.parametrize("name", RADIOS_BYTES_PER_S)
def test_a_named_radio_has_its_rate(name: str) -> None:
    assert parse_radio(name, 1.0) == Radio(name, RADIOS_BYTES_PER_S[name], 252, 1.0, heartbeats=name.startswith("sik"))


@pytest.mark.parametrize("text", ["1200", "1200 B/s", "1200B/s", "1200.0"])
def test_a_number_is_bytes_per_second(text: str) -> None:
    assert parse_radio(text, 1.0).bytes_per_s == 1_200.0


def test_the_share_is_of_the_radios_bytes() -> None:
    assert parse_radio("sik-57600", 0.25).budget_bytes_per_s == 1_440.0


@pytest.mark.parametrize(
    ("text", "frame_bytes", "outer_bytes"),
    [("sik-57600/v2ext", 235, 17), ("sik-57600/v2ext-signed", 222, 30), ("900 B/s/v2ext", 235, 17)],
)
def test_inside_a_v2_extension_a_frame_is_shorter(text: str, frame_bytes: int, outer_bytes: int) -> None:
    radio = parse_radio(text, 1.0)
    assert (radio.max_frame_bytes, radio.outer_bytes, radio.wrapped) == (frame_bytes, outer_bytes, True)
    assert radio.max_frame_bytes + radio.outer_bytes == 252


@pytest.mark.parametrize(
    ("text", "added_bytes"), [("sik-57600", 0), ("sik-57600/v2ext", 0), ("sik-57600/v2ext-signed", 13)]
)
def test_only_an_outer_signature_is_added_on_the_way(text: str, added_bytes: int) -> None:
    assert parse_radio(text, 1.0).added_bytes == added_bytes


@pytest.mark.parametrize("path", ["v2ext", "v2ext-signed"])
def test_behind_an_autopilot_no_heartbeat_of_ours_goes_out(path: str) -> None:
    assert not parse_radio(f"sik-57600/{path}", 1.0).heartbeats


def test_loras_rate_is_the_formula_of_its_data_sheet() -> None:
    payload, symbol_s = 252, 2**7 / 125e3
    # Spreading factor 7, CRC, explicit header, no low data rate optimisation, coding rate 4/5, a preamble of 8 symbols.
    symbols = 8 + -(-(8 * payload - 4 * 7 + 28 + 16) // (4 * 7)) * 5
    on_air_s = (8 + 4.25 + symbols) * symbol_s
    assert RADIOS_BYTES_PER_S["lora"] == int(payload / on_air_s)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("sik-5760", ("radio 'sik-5760'", "did you mean 'sik-57600'?", "allowed: sik-57600, sik-64k-ecc, lora or a")),
        ("sik-57600/v2", ("did you mean 'sik-57600/v2ext'?",)),
        ("lora/v2ext-singed", ("did you mean 'lora/v2ext-signed'?",)),
        ("", ("radio ''", "allowed: sik-57600")),
        ("/v2ext", ("radio '/v2ext'",)),
        ("-5", ("radio '-5'",)),
        ("nan", ("radio 'nan'",)),
        ("5 B/s", ("5 B/s; allowed: 10 to 1e+08",)),
        ("1" + 9 * "0", ("allowed: 10 to 1e+08",)),
    ],
)
def test_what_is_no_radio_is_refused_with_what_is_allowed(text: str, parts: tuple[str, ...]) -> None:
    with pytest.raises(InputError) as caught:
        parse_radio(text, 1.0)
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.parametrize("share", [0.0, -0.1, 1.01, float("nan"), float("inf")])
def test_a_share_is_more_than_nothing_and_at_most_all(share: float) -> None:
    with pytest.raises(InputError, match="share: .*; allowed: more than 0, at most 1"):
        parse_radio("lora", share)
