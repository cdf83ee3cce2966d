"""Situations in which other programs change what the autopilot sends, and those in which it does not send it at all."""

from __future__ import annotations

from collections.abc import Iterator

from pymavlink.dialects.v20 import common as mavlink

from companion.onboard.preflight import findings
from tests.field.rig import Rig
from tests.field.situation import Situation

POSITION = mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
LANDED = mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE
BATTERY = mavlink.MAVLINK_MSG_ID_SYS_STATUS
HEARTBEAT = mavlink.MAVLINK_MSG_ID_HEARTBEAT
LOCAL_POSITION = mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED
ATTITUDE = mavlink.MAVLINK_MSG_ID_ATTITUDE
REFUSES_S = 6.0
"""Time from which an autopilot refuses rates: the first questions were granted."""


def flown(kind: str = "arducopter") -> Rig:
    rig = Rig(kind)
    rig.run(12.0)
    assert rig.last.setpoint is not None, rig.words()
    return rig


def every_third(rig: Rig) -> None:
    """Lose every third position."""
    numbers = iter_numbers()
    rig.lost = lambda frame: _id(frame) == POSITION and next(numbers) % 3 == 2


def iter_numbers() -> Iterator[int]:
    number = 0
    while True:
        yield number
        number += 1


def _id(frame: bytes) -> int:
    return int.from_bytes(frame[7:10], "little")


def refuse_rates(rig: Rig) -> None:
    """Let the autopilot keep its streams from now on, whatever the companion asks."""
    receive = rig.vehicle.receive

    def refusing(datagram: bytes, t_s: float) -> list[bytes]:
        ours = datagram[6] == mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
        asks = ours and _id(datagram) == mavlink.MAVLINK_MSG_ID_COMMAND_LONG
        return [] if asks else receive(datagram, t_s)

    rig.vehicle.receive = refusing  # type: ignore[method-assign]


def position_lowered_for_good() -> str:
    rig = flown()
    refuse_rates(rig)
    rig.set_rate(POSITION, 0.8)
    every_third(rig)
    rig.run(60.0)
    changes = rig.changes(12.0)
    assert changes <= 1, f"steering began or ended {changes} times in 48 s"
    assert "Hz of 10 asked" in rig.words(), rig.words()
    return f"steering ended {changes} time in 48 s; {rig.last.purpose.value}, {rig.last.reason}"


def rates_lowered_once() -> str:
    rig = flown()
    rig.set_rates(0.25)
    rig.run(30.0)
    late = sum(one.setpoint is None for one in rig.decisions if one.t_s - rig.now_s > -18.0)
    assert late == 0, f"{late} of 180 decisions without a setpoint"
    return "asked again, steered all the time"


def position_ended() -> str:
    rig = flown("px4-copter")
    rig.set_rate(POSITION, 0.0)
    rig.run(30.0)
    assert rig.changes(12.0) == 0, rig.words()
    return f"{rig.last.purpose.value}, {rig.last.reason}"


def local_position_ended() -> str:
    rig = flown("px4-plane")
    rig.set_rate(LOCAL_POSITION, 0.0)
    rig.run(30.0)
    assert rig.changes(12.0) == 0, rig.words()
    return f"{rig.last.purpose.value}, {rig.last.reason}"


def battery_ended() -> str:
    rig = flown()
    rig.set_rate(BATTERY, 0.0)
    rig.run(14.0)
    rig.vehicle.battery.percent = 20.0
    rig.run(40.0)
    assert "battery low" in rig.words(), rig.words()
    return f"{rig.last.purpose.value}, {rig.last.reason}"


def heartbeat_slowed() -> str:
    rig = flown()
    rig.set_rate(HEARTBEAT, 0.2)
    rig.run(60.0)
    assert rig.changes(25.0) == 0, f"steering began or ended {rig.changes(25.0)} times after 25 s"
    assert rig.last.setpoint is not None, rig.words()
    return f"{rig.changes(12.0)} changes, none after 25 s"


def attitude_ended() -> str:
    rig = flown("arduplane")
    rig.set_rate(ATTITUDE, 0.0)
    rig.run(20.0)
    at_s = rig.companion.adapter.telemetry.attitude_at_s
    assert at_s is not None
    assert rig.now_s - at_s < 1.0, f"attitude {rig.now_s - at_s:.0f} s old"
    return f"attitude {rig.now_s - at_s:.1f} s old"


def landed_state_ended() -> str:
    rig = flown("px4-copter")
    refuse_rates(rig)
    rig.set_rate(LANDED, 0.0)
    rig.run(40.0)
    assert "EXTENDED_SYS_STATE 0 Hz of 1 asked" in rig.words(), rig.words()
    return rig.words()


def a_fight() -> str:
    rig = flown()
    rig.run(112.0, lambda: rig.set_rates(1.0) if round(rig.t_s * 10) % 30 == 0 else None)
    asked = [message_id for at_s, message_id in rig.asked if at_s >= 12.0 and message_id == POSITION]
    assert 3 <= len(asked) <= 8, f"asked {len(asked)} times in 100 s"
    assert rig.changes(12.0) == 0
    return f"position asked for {len(asked)} times in 100 s, {rig.last.purpose.value}: {rig.last.reason}"


def checked(rig: Rig) -> list[str]:
    """Return what `companion check` finds wrong, in words."""
    found = findings(
        rig.companion.config,
        rig.companion.adapter,  # type: ignore[arg-type]
        link_heard=True,
        broadcast_heard=True,
        now_s=rig.now_s,
    )
    return [one.text for one in found if not one.passed]


def check_of_a_slow_position() -> str:
    rig = Rig(GUID_TIMEOUT=1.0)
    refuse_rates(rig)
    rig.set_rate(POSITION, 1.0)
    rig.run(9.0)
    said = [text for text in checked(rig) if text.startswith("GLOBAL_POSITION_INT 1.0 Hz of 10 asked")]
    assert said, checked(rig)
    return said[0]


def check_of_a_missing_landed_state() -> str:
    rig = Rig("px4-copter")
    refuse_rates(rig)
    rig.set_rate(LANDED, 0.0)
    rig.run(9.0)
    said = [text for text in checked(rig) if text.startswith("EXTENDED_SYS_STATE 0 Hz of 1 asked")]
    assert said, checked(rig)
    return said[0]


SITUATIONS = (
    Situation(
        "another program sets the position to 0.8 Hz for good, and the radio loses a third of that",
        "no flapping: it loiters or waits, with both rates as the reason",
        "steering began or ended 24 times in 48 s, and nothing said why",
        position_lowered_for_good,
    ),
    Situation(
        "another program sets every stream to one message in 4 s, once",
        "asked again before the steering ends",
        "76 of 180 decisions without a setpoint",
        rates_lowered_once,
    ),
    Situation(
        "another program ends a PX4's position stream",
        "asked again before PX4 gives up",
        "position too old; locked until it is disarmed",
        position_ended,
    ),
    Situation(
        "another program ends a PX4 plane's local position, which every setpoint contains",
        "asked again before PX4 gives up",
        "no local position; locked until it is disarmed",
        local_position_ended,
    ),
    Situation(
        "another program ends SYS_STATUS, then the battery falls to 20 %",
        "asked again; returns",
        "flies on to its target",
        battery_ended,
    ),
    Situation(
        "another program slows the heartbeat to one in 5 s",
        "asked again; steers on",
        "steering began or ended 14 times in 35 s",
        heartbeat_slowed,
    ),
    Situation(
        "another program ends an ArduPlane's attitude, by which it is banked",
        "asked again within a second",
        "banked by an attitude 8 s old",
        attitude_ended,
    ),
    Situation(
        "whether a PX4 flies is told no more, and it refuses the question",
        "said with both rates",
        "flies on without a word",
        landed_state_ended,
    ),
    Situation(
        "another program sets all rates to 1 Hz every 3 s",
        "the questions are bounded: at most 8 in two minutes for a message; steers on or loiters",
        "never asked again",
        a_fight,
    ),
    Situation(
        "`companion check` where the position comes once a second",
        "fails with both rates",
        "passes",
        check_of_a_slow_position,
    ),
    Situation(
        "`companion check` where nothing tells whether the vehicle flies",
        "fails",
        "passes",
        check_of_a_missing_landed_state,
    ),
)
"""The situations of this area."""
