"""Commands: sent again until they are answered, a few times, and what came of them told in a line."""

from __future__ import annotations

import pytest
from pymavlink.dialects.v20 import common

from companion.autopilot.commands import RESEND_S, SENDS, Command, Commands
from companion.autopilot.telemetry import COMPANION_COMPONENT

SYSTEM = 7
SPEED = Command(common.MAV_CMD_GUIDED_CHANGE_SPEED, "airspeed 22 m/s", (0.0, 22.0, 0.0, 0.0), frame=3)
HEIGHT = Command(common.MAV_CMD_GUIDED_CHANGE_ALTITUDE, "height 100 m", frame=3, altitude_m=100.0)


def rate(message_id: int) -> Command:
    return Command(
        common.MAV_CMD_SET_MESSAGE_INTERVAL, f"rate of {message_id}", (message_id, 1e5, 0, 0), key=message_id
    )


def ack(
    command: int, result: int, system: int = SYSTEM, component: int = COMPANION_COMPONENT
) -> common.MAVLink_message:
    return common.MAVLink_command_ack_message(command, result, 0, 0, system, component)


def commands(*ordered: Command) -> Commands:
    made = Commands()
    for one in ordered:
        made.queue(one)
    return made


def sent(made: Commands, start_s: float, seconds: float) -> list[float]:
    times_s = [start_s + 0.1 * step for step in range(round(10 * seconds))]
    return [now_s for now_s in times_s for _ in made.due(now_s, SYSTEM)]


def test_a_command_that_is_not_answered_is_sent_three_times_a_second_apart_and_given_up() -> None:
    made = commands(SPEED)
    assert sent(made, 0.0, 20.0) == pytest.approx([0.0, RESEND_S, 2.0 * RESEND_S], abs=0.11)
    assert made.failures == ("airspeed 22 m/s: no answer",)


def test_a_command_that_is_accepted_is_sent_once() -> None:
    made = commands(SPEED)
    sent(made, 0.0, 0.5)
    made.take(ack(SPEED.number, common.MAV_RESULT_ACCEPTED), SYSTEM)
    assert sent(made, 0.5, 20.0) == []
    assert made.failures == ()


@pytest.mark.parametrize(
    ("result", "words"),
    [
        (common.MAV_RESULT_DENIED, "denied"),
        (common.MAV_RESULT_FAILED, "failed"),
        (common.MAV_RESULT_UNSUPPORTED, "unsupported"),
    ],
)
def test_a_command_that_is_refused_is_not_sent_again_and_told(result: int, words: str) -> None:
    made = commands(SPEED)
    sent(made, 0.0, 0.1)
    made.take(ack(SPEED.number, result), SYSTEM)
    assert sent(made, 0.1, 10.0) == []
    assert made.failures == (f"airspeed 22 m/s: {words}",)


def test_one_that_is_rejected_for_the_moment_is_tried_again() -> None:
    made = commands(SPEED)
    for start_s in range(SENDS):
        assert len(sent(made, start_s, 1.0)) == 1
        made.take(ack(SPEED.number, common.MAV_RESULT_TEMPORARILY_REJECTED), SYSTEM)
    assert sent(made, SENDS, 10.0) == []
    assert made.failures == ("airspeed 22 m/s: temporarily rejected",)


def test_work_in_progress_is_no_answer_yet() -> None:
    made = commands(SPEED)
    sent(made, 0.0, 0.1)
    made.take(ack(SPEED.number, common.MAV_RESULT_IN_PROGRESS), SYSTEM)
    assert len(sent(made, 1.0, 0.5)) == 1


def test_of_two_acknowledgements_the_last_counts() -> None:
    made = commands(SPEED)
    sent(made, 0.0, 0.1)
    made.take(ack(SPEED.number, common.MAV_RESULT_ACCEPTED), SYSTEM)
    made.take(ack(SPEED.number, common.MAV_RESULT_DENIED), SYSTEM)
    assert made.failures == ("airspeed 22 m/s: denied",)


@pytest.mark.parametrize(("system", "component"), [(SYSTEM, 190), (255, COMPANION_COMPONENT)])
def test_another_ones_acknowledgement_is_not_ours(system: int, component: int) -> None:
    made = commands(SPEED)
    sent(made, 0.0, 0.1)
    made.take(ack(SPEED.number, common.MAV_RESULT_ACCEPTED, system, component), SYSTEM)
    assert len(sent(made, 1.0, 0.5)) == 1


def test_an_acknowledgement_to_nobody_in_particular_is_ours() -> None:
    made = commands(SPEED)
    sent(made, 0.0, 0.1)
    made.take(ack(SPEED.number, common.MAV_RESULT_ACCEPTED, 0, 0), SYSTEM)
    assert sent(made, 1.0, 5.0) == []


def test_an_acknowledgement_of_what_was_never_sent_is_ignored() -> None:
    made = commands()
    made.take(ack(SPEED.number, common.MAV_RESULT_DENIED), SYSTEM)
    assert made.failures == ()


def test_a_newer_order_replaces_the_one_that_waits_for_its_answer() -> None:
    made = commands(SPEED)
    made.due(0.0, SYSTEM)
    made.queue(Command(SPEED.number, "airspeed 25 m/s", (0.0, 25.0, 0.0, 0.0), frame=3))
    (message,) = made.due(0.1, SYSTEM)
    assert message.param2 == 25.0


def test_commands_of_one_number_wait_for_each_other() -> None:
    made = commands(rate(30), rate(33))
    (first,) = made.due(0.0, SYSTEM)
    assert made.due(0.1, SYSTEM) == []
    made.take(ack(first.command, common.MAV_RESULT_ACCEPTED), SYSTEM)
    (second,) = made.due(0.2, SYSTEM)
    assert (first.param1, second.param1) == (30, 33)


def test_each_of_one_number_has_an_outcome_of_its_own() -> None:
    made = commands(rate(30), rate(33))
    for now_s, result in ((0.0, common.MAV_RESULT_DENIED), (0.1, common.MAV_RESULT_ACCEPTED)):
        made.due(now_s, SYSTEM)
        made.take(ack(common.MAV_CMD_SET_MESSAGE_INTERVAL, result), SYSTEM)
    assert made.failures == ("rate of 30: denied",)


def test_what_is_accepted_later_is_no_trouble_any_more() -> None:
    made = commands(SPEED)
    sent(made, 0.0, 5.0)
    assert made.failures
    made.queue(SPEED)
    made.due(5.0, SYSTEM)
    made.take(ack(SPEED.number, common.MAV_RESULT_ACCEPTED), SYSTEM)
    assert made.failures == ()


def test_what_is_cleared_is_never_sent() -> None:
    made = commands(SPEED, HEIGHT)
    made.due(0.0, SYSTEM)
    made.clear()
    assert sent(made, 0.1, 10.0) == []


def test_a_command_with_a_frame_goes_as_an_integer_command_and_else_as_a_long_one() -> None:
    place = Command(192, "go", (-1.0, 0.0, 60.0, 0.0), frame=3, place_deg=(47.1234567, -8.5), altitude_m=30.0)
    (as_int,) = commands(place).due(0.0, SYSTEM)
    assert as_int.get_type() == "COMMAND_INT"
    assert (as_int.x, as_int.y, as_int.z, as_int.frame) == (471_234_567, -85_000_000, 30.0, 3)
    made = commands(rate(30))
    (as_long,) = made.due(0.0, SYSTEM)
    (again,) = made.due(1.0, SYSTEM)
    assert as_long.get_type() == "COMMAND_LONG"
    # MAVLink: the confirmation counts the times it was sent before.
    assert (as_long.confirmation, again.confirmation) == (0, 1)
