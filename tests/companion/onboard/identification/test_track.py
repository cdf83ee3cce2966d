"""Reading commands and motion from the frames of a log."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega, common

from companion.guard.types import Setpoint
from companion.onboard.config import AutopilotSection, Config
from companion.onboard.decision import Decision, Purpose
from companion.onboard.failsafe import Stage
from companion.onboard.flight_log import Mark, decision_frame, mark_frame
from companion.onboard.identification.track import track_of
from companion.protocol.codec import FrameWriter

_LINK = AutopilotSection(kind="arducopter", link="udpin:127.0.0.1:14540", system_id=1)
CONFIG = Config(agent_id=1, autopilot=_LINK)
_AUTOPILOT = ardupilotmega.MAVLink(None, srcSystem=1, srcComponent=common.MAV_COMP_ID_AUTOPILOT1)


def told(message: ardupilotmega.MAVLink_message) -> bytes:
    return bytes(message.pack(_AUTOPILOT))


HEARTBEAT = told(ardupilotmega.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3))


def position(boot_ms: int, lat_e7: int = 470_000_000, north_cm_s: int = 800) -> bytes:
    place = (boot_ms, lat_e7, 80_000_000, 530_000, 30_000)
    return told(ardupilotmega.MAVLink_global_position_int_message(*place, north_cm_s, 0, 0, 0))


def decision(t_s: float, heading_rad: float) -> bytes:
    setpoint = Setpoint(heading_rad, 8.0, 30.0)
    made = Decision(t_s, Purpose.TARGET, "", Stage.FRESH, None, setpoint=setpoint)
    return FrameWriter().encode(decision_frame(made))


def test_commands_and_motion_have_their_times() -> None:
    records = [(1.0, HEARTBEAT), (2.0, position(700)), (2.5, decision(2.5, 0.5)), (3.0, position(1_700, 470_000_900))]
    track = track_of(records, CONFIG)
    assert track.commands.tolist() == [pytest.approx([2.5, 0.5, 8.0])]
    assert track.motions[:, :2].tolist() == [[2.0, 0.7], [3.0, 1.7]]
    assert track.motions[1, 2] == pytest.approx(10.0, abs=0.1) and track.motions[1, 4] == 8.0


def test_a_setpoint_that_was_withdrawn_is_no_command_any_more() -> None:
    records = [(1.0, HEARTBEAT), (2.0, decision(2.0, 0.5)), (2.1, mark_frame(Mark.WITHDRAWN, 1))]
    assert math.isnan(track_of(records, CONFIG).commands[1, 1])


def test_the_wind_that_the_autopilot_tells_is_where_it_blows_to() -> None:
    wind = told(ardupilotmega.MAVLink_wind_message(90.0, 5.0, 0.0))
    track = track_of([(1.0, HEARTBEAT), (2.0, wind)], CONFIG)
    assert track.winds[0].tolist() == pytest.approx([2.0, 0.0, -5.0], abs=1e-6)
