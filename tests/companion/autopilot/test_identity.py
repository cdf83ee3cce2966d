"""One identity: only what the autopilot itself says, and says newly, is believed."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.autopilot.arducopter import ArduCopterAdapter
from companion.autopilot.boot_clock import SHARED_MEMORY_S
from companion.autopilot.identity import OTHERS_MEMORY_S, STRAY_MEMORY_S
from companion.autopilot.linked import LinkedAdapter
from companion.autopilot.px4_copter import Px4CopterAdapter
from companion.autopilot.telemetry import Telemetry
from tests.companion.autopilot.autopilot_stream import (
    ARMED,
    DISARMED,
    FRAMES_PER_S,
    GUIDED,
    LOITER,
    START_S,
    SYSTEM,
    Autopilot,
    Sent,
    heard,
)


def copter(system_id: int | None = SYSTEM) -> LinkedAdapter:
    return ArduCopterAdapter(system_id)


def refusal(adapter: LinkedAdapter) -> str | None:
    """Return why the autopilot is refused."""
    return adapter.refusal


def without_times(telemetry: Telemetry) -> dict[str, object]:
    """Return what is told, not when it came; what is not told is left out."""
    values = {name: value for name, value in vars(telemetry).items() if not name.endswith("_at_s")}
    return {name: value for name, value in values.items() if value == value}


def states(adapter: LinkedAdapter, sent: list[Sent]) -> list[Telemetry]:
    """Return the telemetry after each frame, in the order in which they come."""
    told = []
    for at_s, frame in sorted(sent, key=lambda one: one.at_s):
        adapter.receive(frame, at_s)
        told.append(adapter.telemetry)
    return told


def busy(seconds: int = 14) -> list[Sent]:
    """Return a flight in which arming and mode change, up to the end."""
    autopilot, sent = Autopilot(), []
    modes = [(DISARMED, LOITER), (ARMED, LOITER), (ARMED, GUIDED), (ARMED, LOITER), (ARMED, GUIDED)]
    for step in range(seconds):
        autopilot.base_mode, autopilot.custom_mode = modes[step * len(modes) // seconds]
        sent += autopilot.second(START_S + step)
    return sent


BUSY = busy()
TOLD = [without_times(one) for one in states(copter(), BUSY)]


# Copies, and frames out of order


@settings(max_examples=10, deadline=None)
@given(st.lists(st.floats(0.0, 10.0), min_size=20, max_size=60))
def test_copies_that_come_within_ten_seconds_change_nothing_at_any_time(delays_s: list[float]) -> None:
    copies = [Sent(one.at_s + delays_s[k % len(delays_s)], one.frame) for k, one in enumerate(BUSY)]
    arriving = sorted([(*one, False) for one in BUSY] + [(*one, True) for one in copies], key=lambda one: one[0])
    adapter, k = copter(), 0
    for at_s, frame, is_copy in arriving:
        adapter.receive(frame, at_s)
        k += not is_copy
        if k:
            assert without_times(adapter.telemetry) == TOLD[k - 1]
    assert (adapter.refusal, adapter.telemetry.restarts) == (None, 0)


@pytest.mark.parametrize("late_s", [0.1, 1.0, 5.0, 10.0])
def test_every_frame_twice_is_every_frame_once(late_s: float) -> None:
    adapter = heard(copter(), BUSY + [Sent(one.at_s + late_s, one.frame) for one in BUSY])
    assert without_times(adapter.telemetry) == TOLD[-1]
    assert adapter.refusal is None
    assert sum(adapter.rejected[reason] for reason in ("duplicate", "late")) > 0.85 * len(BUSY)


@settings(max_examples=15, deadline=None)
@given(st.lists(st.floats(0.0, 3.0), min_size=20, max_size=80), st.floats(0.0, 0.5))
def test_in_whatever_order_and_with_whatever_losses_they_come_the_newest_counts_in_the_end(
    delays_s: list[float], loss: float
) -> None:
    kept = [one for k, one in enumerate(BUSY) if (k * 0.618) % 1.0 >= loss or k >= len(BUSY) - FRAMES_PER_S]
    adapter = heard(
        copter(), [one._replace(at_s=one.at_s + delays_s[k * 7 % len(delays_s)]) for k, one in enumerate(kept)]
    )
    assert without_times(adapter.telemetry) == TOLD[-1]
    assert (adapter.refusal, adapter.telemetry.restarts) == (None, 0)


@pytest.mark.parametrize("late_s", [1.1, 2.5, 5.0, 7.3, 9.0])
def test_a_heartbeat_that_comes_late_for_the_first_time_disarms_nobody(late_s: float) -> None:
    autopilot = Autopilot()
    sent = autopilot.seconds(3)
    autopilot.base_mode = DISARMED
    late = autopilot.heartbeat(START_S + 3.0)
    autopilot.base_mode = ARMED
    sent += autopilot.seconds(12, START_S + 3.0)
    told = states(copter(), [*sent, Sent(late.at_s + late_s, late.frame)])
    assert all(one.armed for one in told)


def test_a_position_counts_from_when_it_was_due_however_late_it_comes() -> None:
    autopilot = Autopilot()
    sent = autopilot.seconds(3)
    late, newer = autopilot.position(START_S + 3.0), autopilot.attitude(START_S + 3.8)
    adapter = heard(copter(), [*sent, newer, Sent(START_S + 3.9, late.frame)])
    assert adapter.telemetry.position_at_s == pytest.approx(START_S + 3.1)


def test_of_two_ways_the_slow_one_may_be_heard_first() -> None:
    sent = Autopilot().seconds(12)
    slow, fast = [one._replace(at_s=one.at_s + 4.0) for one in sent], sent[6 * FRAMES_PER_S :]
    adapter = heard(copter(), slow + fast)
    assert (adapter.refusal, adapter.telemetry.restarts) == (None, 0)
    assert adapter.telemetry.position_at_s == sent[-1].at_s


# Restarts, and the end of the clock


def test_a_restart_is_a_clock_near_zero_that_goes_on() -> None:
    autopilot = Autopilot()
    before = autopilot.seconds(3)
    autopilot.reboot(START_S + 4.0)
    after = autopilot.seconds(2, START_S + 6.0)
    adapter = heard(copter(), before + after)
    assert (adapter.telemetry.restarts, adapter.refusal) == (1, None)
    assert adapter.telemetry.position_at_s == after[-1].at_s


@pytest.mark.parametrize("up_ms", [100, 5_000, 50_000, 3_000_000, 2**32 - 3_000])
def test_one_frame_with_any_clock_is_no_restart_and_shuts_nobody_out(up_ms: int) -> None:
    sent = Autopilot().seconds(6)
    stray = Autopilot(number=99, up_ms=up_ms).position(START_S + 3.0)
    alone = heard(copter(), sent).telemetry
    adapter = heard(copter(), [*sent, Sent(START_S + 3.05, stray.frame)])
    assert (adapter.telemetry, adapter.refusal) == (alone, None)


def test_the_clock_begins_again_after_49_days_and_that_is_no_restart() -> None:
    sent = Autopilot(up_ms=2**32 - 2_000).seconds(5)
    adapter = heard(copter(), sent)
    assert (adapter.telemetry.restarts, adapter.telemetry.position_at_s) == (0, sent[-1].at_s)
    assert adapter.rejected.total() == 0


def test_what_comes_late_from_before_a_restart_changes_nothing() -> None:
    autopilot = Autopilot()
    before = autopilot.seconds(4)
    autopilot.reboot(START_S + 4.0)
    after = autopilot.seconds(6, START_S + 5.5)
    late = [Sent(one.at_s + 6.0, one.frame) for one in before]
    adapter = heard(copter(), before + after + late)
    assert (adapter.telemetry.restarts, adapter.refusal) == (1, None)
    assert adapter.telemetry == heard(copter(), before + after).telemetry


def test_an_autopilot_is_heard_again_after_any_silence() -> None:
    autopilot = Autopilot()
    sent = autopilot.seconds(3) + autopilot.seconds(3, START_S + 400.0)
    adapter = heard(copter(), sent)
    assert (adapter.telemetry.restarts, adapter.telemetry.position_at_s) == (0, sent[-1].at_s)


# Two autopilots with one id


@pytest.mark.parametrize("up_ms", [0, 60_000, 60_030, 60_300, 61_500, 70_000, 3_000_000])
def test_two_autopilots_with_one_system_id_are_found_whatever_their_clocks(up_ms: int) -> None:
    first, second = Autopilot(), Autopilot(up_ms=up_ms, number=100, east_e7=80_002_000)
    # Where one clock is ahead by what may be the delay of a second way, the places tell only after that time.
    together = 14 if up_ms == 70_000 else 4
    meanwhile = [one._replace(at_s=one.at_s + 0.03) for one in second.seconds(together, START_S + 2.0)]
    adapter = heard(copter(), first.seconds(2 + together) + meanwhile)
    assert adapter.refusal is not None
    assert "two autopilots say they are system 7" in adapter.refusal
    alone = first.seconds(int(SHARED_MEMORY_S) + 15, START_S + 2.0 + together)
    assert heard(adapter, alone).refusal is None


def test_one_autopilot_over_two_of_its_links_with_numbers_of_their_own_is_one() -> None:
    links = Autopilot(), Autopilot(number=120)
    sent = links[0].seconds(8) + [one._replace(at_s=one.at_s + 0.004) for one in links[1].seconds(8)]
    adapter = heard(copter(), sent)
    assert (adapter.refusal, adapter.telemetry.restarts) == (None, 0)
    newest_s = max(one.at_s for one in sent)
    assert newest_s - (adapter.telemetry.heartbeat_at_s or 0.0) < 2.0
    assert newest_s - (adapter.telemetry.position_at_s or 0.0) < 0.2


# Others on the link


def others() -> st.SearchStrategy[bytes]:
    """Return frames of others: other systems, other components, and what no autopilot is in the autopilot's name."""
    strangers = st.sampled_from([(1, 1), (SYSTEM, 191), (SYSTEM, 154), (SYSTEM, 0), (125, 1), (255, 190), (SYSTEM, 1)])
    kinds = st.sampled_from(
        [
            common.MAVLink_heartbeat_message(common.MAV_TYPE_GCS, common.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3),
            common.MAVLink_heartbeat_message(common.MAV_TYPE_GENERIC, common.MAV_AUTOPILOT_GENERIC, 0, 0, 4, 3),
            common.MAVLink_heartbeat_message(common.MAV_TYPE_ONBOARD_CONTROLLER, 3, 0, 0, 4, 3),
            common.MAVLink_heartbeat_message(common.MAV_TYPE_FIXED_WING, 3, 0, 0, 5, 3),
            common.MAVLink_heartbeat_message(common.MAV_TYPE_QUADROTOR, common.MAV_AUTOPILOT_PX4, 0, 0, 5, 3),
            common.MAVLink_global_position_int_message(60_000, 1, 2, 3, 4, 5, 6, 7, 8),
            common.MAVLink_sys_status_message(*[0] * 13),
            common.MAVLink_home_position_message(1, 2, 3, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0),
        ]
    )
    return st.builds(_packed, strangers, kinds, st.integers(0, 255), st.booleans())


def _packed(sender: tuple[int, int], message: common.MAVLink_message, number: int, old: bool) -> bytes:
    is_heartbeat = message.get_type() == "HEARTBEAT"
    sender = (125, 1) if sender == (SYSTEM, 1) and not is_heartbeat else sender
    mav = common.MAVLink(None, srcSystem=sender[0], srcComponent=sender[1])
    mav.seq = number
    return bytes(message.pack(mav, force_mavlink1=old))


@settings(max_examples=20, deadline=None)
@given(st.lists(st.tuples(st.floats(0.0, 5.0), others()), max_size=60), st.booleans())
def test_no_frame_of_another_sender_changes_anything(strays: list[tuple[float, bytes]], named: bool) -> None:
    sent = Autopilot().seconds(6)
    system_id = SYSTEM if named else None
    alone = heard(copter(system_id), sent)
    adapter = heard(copter(system_id), sent + [Sent(START_S + after_s, frame) for after_s, frame in strays])
    assert (adapter.telemetry, adapter.refusal) == (alone.telemetry, None)
    assert adapter.telemetry.system_id == SYSTEM


@pytest.mark.parametrize("kind", [ArduCopterAdapter, Px4CopterAdapter])
def test_one_that_is_heard_before_its_configured_kind_is_named_and_then_forgotten(kind: type[LinkedAdapter]) -> None:
    router = common.MAVLink(None, srcSystem=125, srcComponent=1)
    beat = common.MAVLink_heartbeat_message(common.MAV_TYPE_GENERIC, common.MAV_AUTOPILOT_GENERIC, 0, 0, 4, 3)
    adapter = kind()
    adapter.receive(bytes(beat.pack(router)), START_S)
    assert refusal(adapter) is not None
    if kind is ArduCopterAdapter:
        heard(adapter, Autopilot().seconds(4, START_S + 1.0))
        assert refusal(adapter) is None
        assert adapter.telemetry.system_id == SYSTEM


def test_without_a_system_id_one_is_chosen_after_a_time_of_listening() -> None:
    autopilot, adapter = Autopilot(), copter(None)
    heard(adapter, autopilot.seconds(1))
    assert without_times(adapter.telemetry) == without_times(Telemetry())
    heard(adapter, autopilot.seconds(3, START_S + 1.0))
    assert adapter.telemetry.system_id == SYSTEM


def test_several_autopilots_on_a_link_are_refused_without_a_system_id_and_all_are_named() -> None:
    vehicles = [Autopilot(system=system) for system in (9, SYSTEM, 8)]
    adapter = heard(copter(None), [one for vehicle in vehicles for one in vehicle.seconds(5)])
    assert adapter.refusal == (
        "several autopilots are heard, systems 7, 8, 9: set autopilot.system_id to this vehicle's own"
    )


def test_with_a_system_id_the_right_one_of_several_is_taken_and_the_others_are_harmless() -> None:
    vehicles = [Autopilot(system=system, up_ms=1_000 * system) for system in (9, SYSTEM, 8)]
    adapter = heard(copter(), [one for vehicle in vehicles for one in vehicle.seconds(5)])
    assert adapter.refusal is None
    alone = heard(copter(), Autopilot(up_ms=7_000).seconds(5)).telemetry
    assert without_times(adapter.telemetry) == without_times(alone)


def test_another_autopilot_that_comes_near_in_flight_changes_nothing() -> None:
    own, other = Autopilot(), Autopilot(system=8)
    adapter = heard(copter(None), own.seconds(12) + other.seconds(4, START_S + 8.0))
    assert (adapter.refusal, adapter.telemetry.system_id) == (None, SYSTEM)


def test_another_autopilot_that_joins_on_the_ground_is_refused_until_it_is_gone() -> None:
    own, other = Autopilot(), Autopilot(system=8)
    own.base_mode = DISARMED
    adapter = heard(copter(None), own.seconds(8) + other.seconds(4, START_S + 4.0))
    assert adapter.refusal is not None and "systems 7, 8" in adapter.refusal
    heard(adapter, own.seconds(int(OTHERS_MEMORY_S) + 2, START_S + 8.0))
    assert adapter.refusal is None


def test_one_heartbeat_of_another_autopilot_is_soon_forgotten() -> None:
    own, stray = Autopilot(), Autopilot(system=8).heartbeat(START_S)
    adapter = heard(copter(None), [stray, *own.seconds(3)])
    assert without_times(adapter.telemetry) == without_times(Telemetry())
    heard(adapter, own.seconds(int(STRAY_MEMORY_S) + 1, START_S + 3.0))
    assert adapter.telemetry.system_id == SYSTEM
    assert refusal(adapter) is None
