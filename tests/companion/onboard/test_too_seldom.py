"""What the companion does when the autopilot's messages come too seldom to steer by."""

from __future__ import annotations

from pymavlink.dialects.v20 import common

from companion.autopilot.linked import COMMON_RATES_HZ
from companion.onboard.companion import Companion
from companion.onboard.decision import Decision, Purpose
from companion.onboard.failsafe import Stage
from tests.companion.onboard.companion_flight import CONFIG, Flight, ObedientCopter


class AskingCopter(ObedientCopter):
    """An obedient copter that asks for its messages like a real one."""

    rates_hz = dict(COMMON_RATES_HZ)


def flown(flight: Flight, seconds: float, position_s: float) -> list[Decision]:
    """Fly on, deciding ten times a second, with a position every so often; return the decisions."""
    decisions = []
    for tick in range(round(seconds * 10)):
        flight.now_s = round(flight.now_s + 0.1, 3)
        if tick % 10 == 0:
            flight.broadcast()
            flight.heartbeat()
        if tick % round(position_s * 10) == 0:
            flight.boot_ms += round(1000 * position_s) - 100
            flight.position()
        decisions.append(flight.companion.tick(flight.now_s)[0])
    return decisions


def asking() -> Flight:
    flight = Flight()
    flight.companion = Companion(CONFIG, AskingCopter())
    flight.heartbeat()
    flight.position()
    flight.landed(2)
    return flight


def test_while_it_is_steered_it_loiters_with_both_rates_as_the_reason() -> None:
    flight = asking()
    assert flown(flight, 12.0, 0.1)[-1].purpose is Purpose.TARGET
    last = flown(flight, 12.0, 1.0)[-1]
    assert (last.purpose, last.stage) == (Purpose.LOITER, Stage.LOITERING)
    assert "GLOBAL_POSITION_INT 1.0 Hz of 10 asked, 1.5 needed" in last.triggers
    assert flown(flight, 8.0, 0.1)[-1].purpose is Purpose.TARGET


def test_before_it_is_steered_it_waits_for_that_reason_and_does_not_come_and_go() -> None:
    flight = asking()
    flown(flight, 5.0, 2.2)
    flight.tell(common.MAVLink_command_ack_message(common.MAV_CMD_SET_MESSAGE_INTERVAL, common.MAV_RESULT_ACCEPTED))
    decisions = flown(flight, 40.0, 2.2)[100:]
    assert {one.purpose for one in decisions} == {Purpose.IDLE}
    assert any(one.reason == "GLOBAL_POSITION_INT 0.5 Hz of 10 asked, 1.5 needed" for one in decisions)


def test_what_safety_rests_on_and_does_not_come_is_said_beside_the_decision() -> None:
    flight = asking()
    note = flown(flight, 12.0, 0.1)[-1].note
    assert note is not None
    assert "SYS_STATUS 0 Hz of 1 asked" in note
