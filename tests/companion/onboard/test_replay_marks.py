"""What a log tells beside frames and decisions, so that a flight with take-overs and clock steps is decided again."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.autopilot.offboard import MAVSDK_SILENT
from companion.autopilot.telemetry import COMPANION_COMPONENT
from companion.files.records import STAMP
from companion.files.tlog import Tlog, TlogWriter
from companion.onboard.authority import State
from companion.onboard.companion import Companion
from companion.onboard.config import AutopilotSection
from companion.onboard.decision import Decision
from companion.onboard.flight_log import (
    Mark,
    clock_frame,
    clock_offset_s,
    decision_frame,
    gap_before,
    mark_frame,
    mark_of,
)
from companion.onboard.recording import BEGINNINGS
from companion.onboard.replay import replay
from companion.onboard.replay_text import replayed_lines
from companion.protocol.codec import FrameWriter
from companion.protocol.frame import raw_frame
from tests.companion.onboard.companion_flight import CONFIG, GUIDED, SYSTEM, Flight

HOLD_MODE = 4 << 16 | 3 << 24
SLOTS_A_STEP = 5
PARAMETERS = {
    "px4-copter": {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 5.0, "GF_ACTION": 2.0, "MPC_ACC_HOR": 3.0},
    "arducopter": {"WPNAV_ACCEL": 250.0, "ANGLE_MAX": 3000.0, "GUID_TIMEOUT": 1.0, "FS_GCS_ENABLE": 0.0},
}


class Recorded(Flight):
    """A flight that is logged as `companion run` does."""

    def __init__(self, kind: str, was: State) -> None:
        super().__init__(CONFIG, kind)
        section = AutopilotSection(kind=kind, link="udpin:127.0.0.1:14540", system_id=SYSTEM)
        self.config = CONFIG.model_copy(update={"autopilot": section})
        self.companion = Companion(self.config, was=was)
        self.records: list[tuple[float, bytes]] = []
        self.decisions: list[Decision] = []
        self._marks = FrameWriter()
        self._slots = 0
        if was in BEGINNINGS:
            self.note(mark_frame(BEGINNINGS[was], SYSTEM))

    def note(self, frame: bytes) -> None:
        self.records.append((self.now_s, frame))

    def hear(self, frame: bytes) -> None:
        for believed in self.companion.hear(frame, self.now_s):
            self.note(believed.data)

    def tell(self, message: common.MAVLink_message) -> None:
        frame = bytes(message.pack(self._autopilot))
        self.companion.receive(frame, self.now_s)
        self.note(frame)

    def slot(self) -> None:
        self.now_s = round(self.now_s + 0.1, 6)
        self._slots += 1
        if self._slots % SLOTS_A_STEP == 0:
            decision, frames = self.companion.tick(self.now_s)
            self.decisions.append(decision)
            self.note(self._marks.encode(decision_frame(decision)))
        else:
            stood = self.companion.steers
            frames = self.companion.repeat(self.now_s)
            if stood and not self.companion.steers:
                self.note(mark_frame(Mark.WITHDRAWN, SYSTEM))
        for frame in frames:
            self.note(frame)

    def step_clock(self, offset_s: float) -> None:
        if self.companion.note_clock(offset_s):
            self.note(clock_frame(SYSTEM, self.now_s, offset_s))

    def clear(self) -> None:
        self.companion.clear(self.now_s)
        self.note(mark_frame(Mark.CLEARED, SYSTEM))

    def gap(self) -> None:
        self.companion.authority.note_gap(MAVSDK_SILENT)
        self.note(mark_frame(Mark.GAP, SYSTEM))

    def parameters(self) -> None:
        for name, value in PARAMETERS[self.companion.adapter.kind].items():
            self.tell(common.MAVLink_param_value_message(name.encode(), value, common.MAV_PARAM_TYPE_REAL32, 9, 0))

    def restart(self) -> None:
        self.boot_ms = 0
        self.position()


def steered_for(
    slots: int, kind: str = "arducopter", left_at: int | None = None, chosen_at: tuple[int, ...] = (40,)
) -> Recorded:
    """Return a flight of so many slots in which the guided mode is chosen and left at slots."""
    flight = Recorded(kind, State.WAITING)
    flight.heartbeat(GUIDED, HOLD_MODE)
    flight.landed(common.MAV_LANDED_STATE_IN_AIR)
    flight.parameters()
    for slot in range(slots):
        if slot in chosen_at:
            flight.heartbeat()
        if slot % 10 == 0:
            flight.broadcast((2_000.0, 3_000.0))
        if slot == left_at:
            flight.heartbeat(GUIDED, HOLD_MODE)
        flight.position(0.8 * slot, 0.0, (8.0, 0.0))
        flight.slot()
    return flight


@pytest.mark.parametrize("mark", Mark)
def test_a_mark_is_read_back_and_is_for_nobody_else(mark: Mark) -> None:
    frame = mark_frame(mark, SYSTEM)
    assert mark_of(raw_frame(frame)) is mark
    (message,) = common.MAVLink(None).parse_buffer(bytearray(frame))
    assert (message.target_system, message.target_component) == (SYSTEM, COMPANION_COMPONENT)


def test_what_the_companion_asks_of_the_autopilot_is_no_mark() -> None:
    teller = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=COMPANION_COMPONENT)
    orders = [(SYSTEM, 1, Mark.CLEARED), (SYSTEM, COMPANION_COMPONENT, common.MAV_CMD_SET_MESSAGE_INTERVAL)]
    for system, component, command in orders:
        message = common.MAVLink_command_long_message(system, component, command, 0, *[0.0] * 7)
        assert mark_of(raw_frame(bytes(message.pack(teller)))) is None


@given(st.floats(1e9, 4e9), st.floats(-1e6, 1e6))
def test_an_offset_of_the_clock_is_read_back_to_the_millisecond(t_s: float, offset_s: float) -> None:
    offset_read_s = clock_offset_s(raw_frame(clock_frame(SYSTEM, t_s, offset_s)), t_s)
    assert offset_read_s is not None
    assert round(offset_read_s, 3) == round(offset_s, 3)


events = st.sampled_from(
    [
        "offboard",
        "hold",
        "disarm",
        "critical",
        "clear",
        "gap",
        "clock",
        "restart",
        "parameters",
        "low",
        "slots",
        "slots",
    ]
)


@pytest.mark.slow
@settings(max_examples=40)
@given(st.sampled_from(sorted(PARAMETERS)), st.sampled_from(State), st.lists(events, min_size=5, max_size=20))
def test_whatever_happens_in_a_flight_its_log_is_decided_again_to_the_bit(
    kind: str, was: State, history: list[str]
) -> None:
    flight = Recorded(kind, was)
    actions: dict[str, Callable[[], object]] = {
        "offboard": flight.heartbeat,
        "hold": lambda: flight.heartbeat(GUIDED, HOLD_MODE),
        "disarm": lambda: flight.heartbeat(common.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, HOLD_MODE),
        "critical": lambda: flight.heartbeat(state=common.MAV_STATE_CRITICAL),
        "clear": flight.clear,
        "gap": flight.gap,
        "clock": lambda: flight.step_clock(3_599.9996 if len(flight.records) % 2 else 0.0),
        "restart": flight.restart,
        "parameters": flight.parameters,
        "low": lambda: flight.battery(10),
        "slots": lambda: None,
    }
    flight.heartbeat(GUIDED, HOLD_MODE)
    for index, event in enumerate(history):
        actions[event]()
        if index % 3 == 0:
            flight.broadcast()
        for slot in range(7):
            if slot % 2 == 0 and event != "critical":
                flight.position(10.0 * index, 0.0, (5.0, 1.0))
            flight.slot()
    again = list(replay(flight.records, flight.config))
    # By their text: what is not a number is not equal to itself.
    assert repr([one.decision for one in again]) == repr(flight.decisions)
    assert all(one.same for one in again)


@pytest.mark.parametrize("kind", sorted(PARAMETERS))
def test_a_mode_that_is_left_and_chosen_again_between_two_decisions_is_decided_again(kind: str) -> None:
    # Left and chosen again while the last decision would stand.
    flight = steered_for(160, kind, left_at=121, chosen_at=(40, 123))
    assert any(one.setpoint is not None for one in flight.decisions)
    assert [mark_of(raw_frame(frame)) for _, frame in flight.records if is_companions(frame)].count(Mark.WITHDRAWN) == 1
    again = list(replay(flight.records, flight.config))
    assert repr([one.decision for one in again]) == repr(flight.decisions)
    assert all(one.same for one in again)


def is_companions(frame: bytes) -> bool:
    return bool(raw_frame(frame).component == COMPANION_COMPONENT)


@pytest.fixture(scope="module")
def steered() -> Recorded:
    """Return ten seconds in which a vehicle is steered."""
    return steered_for(100)


def test_a_log_that_goes_on_in_mid_flight_begins_with_a_gap_and_nothing_in_it_counts(steered: Recorded) -> None:
    late = steered.records[len(steered.records) // 2 :]
    content = b"".join(STAMP.pack(round(t_s * 1e6)) + frame for t_s, frame in late)
    again = list(replay(Tlog(BytesIO(gap_before(content) + content), "late"), steered.config))
    assert again
    assert all(one.behind_gap for one in again)
    assert not any("sign" in one.decision.reason for one in again)


def test_the_marks_have_numbers_of_their_own() -> None:
    assert len({*map(int, Mark.__members__.values())}) == len(Mark.__members__)


@pytest.mark.parametrize("later_s", [0.0, 3_600.0])
def test_a_second_flight_in_a_log_is_decided_by_a_new_companion_and_told(steered: Recorded, later_s: float) -> None:
    second = [(t_s + later_s, frame) for t_s, frame in steered.records]
    again = list(replay(steered.records + second, steered.config))
    half = len(steered.decisions)
    assert [number for number, one in enumerate(again) if one.begins] == [half]
    assert all(one.same and not one.behind_gap for one in again[:half])
    assert all(one.behind_gap for one in again[half:])
    if later_s == 0.0:
        assert all(one.same for one in again)


def test_the_last_line_says_plainly_what_counts(steered: Recorded, tmp_path: Path) -> None:
    path = tmp_path / "two.tlog"
    with TlogWriter(path) as log:
        for t_s, frame in [*steered.records, *steered.records]:
            log.write(t_s, frame)
    said: list[str] = []
    assert replayed_lines(str(path), [path], steered.config, said.append) == 0
    count = len(steered.decisions)
    assert sum("another flight begins" in line for line in said) == 1
    assert said[-1].startswith(
        f"{2 * count} decisions: {count} before any gap in the log, none different from those in flight; "
        f"{count} behind one, none different, which does not count"
    )


def test_a_long_outage_of_the_disk_is_a_gap_and_no_other_flight(steered: Recorded) -> None:
    half = len(steered.records) // 2
    later = [(t_s + 300.0, frame) for t_s, frame in steered.records[half:]]
    again = list(replay([*steered.records[:half], (later[0][0], mark_frame(Mark.LOST, 1)), *later], steered.config))
    assert not any(one.begins for one in again)
    assert again[-1].behind_gap
