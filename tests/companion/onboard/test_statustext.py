"""What the companion says on the autopilot link: when, how often, and that other programs read it."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.guard.types import NO_BACKUP
from companion.onboard.decision import Decision, Purpose
from companion.onboard.failsafe import Stage
from companion.onboard.statustext import CHUNK_BYTES, MOST_CHUNKS, REPEAT_S, TEXT_PERIOD_S, StatusReporter
from companion.runtime.rate import Evenness

SYSTEM = 7
DECISION = Decision(1_000.0, Purpose.TARGET, "assigned", Stage.COASTING, 17.25, target_id=4)


def messages(frames: list[bytes]) -> list[common.MAVLink_message]:
    parser = common.MAVLink(None)
    return [message for frame in frames for message in parser.parse_buffer(frame) or ()]


def text_of(frames: list[bytes]) -> str:
    """Return a text as a ground-control program puts it together."""
    return "".join(message.text for message in messages(frames))


def teller(*, quiet: bool = False, period_s: float = 5.0) -> StatusReporter:
    return StatusReporter(period_s, quiet)


def test_a_line_is_said_once_by_the_vehicles_companion() -> None:
    speaking = teller()
    speaking.note(DECISION, "target 4 (assigned), picture coasting")
    (message,) = messages(speaking.text(0.0, SYSTEM))
    assert (message.get_type(), message.text) == ("STATUSTEXT", "target 4 (assigned), picture coasting")
    assert (message.get_srcSystem(), message.get_srcComponent()) == (SYSTEM, COMPANION_COMPONENT)
    assert speaking.text(100.0, SYSTEM) == []


@pytest.mark.parametrize(
    ("decision", "severity"),
    [
        (replace(DECISION, stage=Stage.FRESH), common.MAV_SEVERITY_INFO),
        (DECISION, common.MAV_SEVERITY_NOTICE),
        (replace(DECISION, stage=Stage.LOITERING), common.MAV_SEVERITY_WARNING),
        (replace(DECISION, stage=Stage.RETURNING), common.MAV_SEVERITY_WARNING),
        (replace(DECISION, stage=Stage.FRESH, guard_changes=(NO_BACKUP,)), common.MAV_SEVERITY_CRITICAL),
    ],
)
def test_the_severity_follows_the_stage(decision: Decision, severity: int) -> None:
    speaking = teller()
    speaking.note(decision, "x")
    assert messages(speaking.text(0.0, SYSTEM))[0].severity == severity


@pytest.mark.slow
@given(st.lists(st.tuples(st.floats(0.0, 1.0), st.text(max_size=60)), max_size=60))
def test_texts_keep_their_distance_and_the_newest_line_is_said(lines: list[tuple[float, str]]) -> None:
    speaking, now_s, said_s = teller(), 0.0, []
    for wait_s, line in lines:
        now_s += wait_s
        speaking.note(DECISION, line)
        if speaking.text(now_s, SYSTEM):
            said_s.append(now_s)
    assert all(later - earlier >= TEXT_PERIOD_S for earlier, later in zip(said_s, said_s[1:], strict=False))
    speaking.note(DECISION, "the last")
    assert text_of(speaking.text(now_s + 2.0 * TEXT_PERIOD_S, SYSTEM)) == "the last"


def test_a_line_that_a_person_must_act_on_is_repeated() -> None:
    speaking, said_s = teller(), []
    for second in range(30):
        speaking.note(DECISION, "climb", insists=True)
        if speaking.text(float(second), SYSTEM):
            said_s.append(second)
    assert said_s == [0, REPEAT_S, 2 * REPEAT_S]
    speaking.note(DECISION, "climb", insists=True)
    (said,) = messages(speaking.text(100.0, SYSTEM))
    assert said.severity == common.MAV_SEVERITY_WARNING
    speaking.note(DECISION, "climb")
    assert speaking.text(200.0, SYSTEM) == []


@pytest.mark.parametrize("length", [1, 49, 50, 51, 99, 100, 149, 150, 199])
def test_a_long_line_is_cut_into_chunks_that_make_it_whole_again(length: int) -> None:
    line = "".join(chr(ord("a") + index % 26) for index in range(length))
    speaking = teller()
    speaking.note(DECISION, line)
    parts = messages(speaking.text(0.0, SYSTEM))
    assert "".join(part.text for part in parts) == line
    assert [part.chunk_seq for part in parts] == list(range(len(parts)))
    if len(parts) > 1:
        assert parts[0].id > 0
        # Who puts them together waits for one that is not full.
        assert len(parts[-1].text) < CHUNK_BYTES
    else:
        assert parts[0].id == 0


def test_a_line_without_end_is_cut_off() -> None:
    speaking = teller()
    speaking.note(DECISION, "x" * 10_000)
    assert len(text_of(speaking.text(0.0, SYSTEM))) == MOST_CHUNKS * CHUNK_BYTES - 1


def test_the_named_values_tell_the_decision() -> None:
    told = messages(teller().values(0.0, SYSTEM, DECISION, Evenness(0.1234, 0.0123)))
    values = {message.name: message.value for message in told}
    assert values == {
        "OW_STAGE": 1,
        "OW_PURPOSE": list(Purpose).index(Purpose.TARGET),
        "OW_TARGET": 4,
        "OW_GUARD": 0,
        "OW_CERT": 0,
        "OW_GAP_MS": 123,
        "OW_LATE_MS": 12,
        "OW_AGE": pytest.approx(17.25),
    }


@pytest.mark.parametrize(
    ("certified_s", "values"),
    [(0.0, {"OW_CERT": 0}), (12.5, {"OW_CERT": 1, "OW_CERT_S": 12.5}), (math.inf, {"OW_CERT": 2})],
)
def test_the_named_values_tell_the_three_certificates_apart(certified_s: float, values: dict[str, float]) -> None:
    told = messages(teller().values(0.0, SYSTEM, replace(DECISION, certified_s=certified_s), Evenness()))
    assert {message.name: message.value for message in told if message.name.startswith("OW_CERT")} == values


def test_an_unknown_age_is_left_out_rather_than_nan() -> None:
    told = messages(teller().values(0.0, SYSTEM, replace(DECISION, picture_age_s=None), Evenness()))
    assert "OW_AGE" not in {message.name for message in told}
    assert all(math.isfinite(message.value) for message in told)


def test_values_come_once_in_their_period() -> None:
    speaking = teller(period_s=5.0)
    times_s = [step / 10 for step in range(201)]
    told_s = [now_s for now_s in times_s if speaking.values(now_s, SYSTEM, DECISION, Evenness())]
    assert told_s == pytest.approx([0.0, 5.0, 10.0, 15.0, 20.0])


def test_a_quiet_companion_says_nothing_at_all() -> None:
    silent = teller(quiet=True)
    silent.note(DECISION, "x")
    assert silent.text(0.0, SYSTEM) == []
    assert silent.values(0.0, SYSTEM, DECISION, Evenness()) == []


def test_nothing_is_said_before_an_autopilot_is_heard() -> None:
    waiting = teller()
    waiting.note(DECISION, "x")
    assert waiting.text(0.0, None) == []
    assert waiting.values(0.0, None, DECISION, Evenness()) == []
    assert text_of(waiting.text(1.0, SYSTEM)) == "x"
