"""Whatever an autopilot tells as its parameters, what is reckoned with and sent is finite and sane for the kind."""

from __future__ import annotations

import math

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common

from companion.autopilot.heartbeat import IDENTITIES
from companion.autopilot.linked import LinkedAdapter
from companion.autopilot.registry import ADAPTERS
from companion.guard.types import Setpoint

KINDS = ("arducopter", "arduplane", "px4-copter", "px4-plane", "ardurover")
FASTEST_M_S = 150.0
"""Faster than any vehicle of these kinds."""
MOST_G = 20.0
"""A greater load factor than any of them bears."""
FARTHEST_M = 1_000.0
"""A greater radius than any circle that a dead companion may leave behind."""


def told(kind: str, values: dict[str, float]) -> LinkedAdapter:
    """Return an adapter of a vehicle in the air that told these parameters."""
    adapter = ADAPTERS[kind](7)
    shown = next(one for one in IDENTITIES if one.kind.name == kind)
    link = common.MAVLink(None, srcSystem=7, srcComponent=1)
    messages = [
        common.MAVLink_heartbeat_message(min(shown.types or (0,)), shown.autopilot, 129, shown.guided_mode, 4, 3),
        common.MAVLink_global_position_int_message(1, 470000000, 80000000, 600000, 60000, 1000, 0, 0, 0),
        common.MAVLink_local_position_ned_message(1, 0.0, 0.0, -60.0, 10.0, 0.0, 0.0),
    ]
    messages += [
        common.MAVLink_param_value_message(name.encode(), value, common.MAV_PARAM_TYPE_REAL32, 1, 0)
        for name, value in values.items()
    ]
    for message in messages:
        adapter.receive(bytes(message.pack(link)), 5.0)
    return adapter


def names_of(kind: str) -> list[str]:
    return [name for wanted in ADAPTERS[kind]().wanted for name in wanted.names]


@settings(max_examples=80, deadline=None)
@given(
    st.sampled_from(KINDS),
    st.dictionaries(st.integers(0, 20), st.floats(width=32) | st.sampled_from([1e30, -1e30, 0.0, -1.0]), max_size=6),
)
@example("px4-copter", dict.fromkeys(range(10), 1e-30))
@example("arduplane", dict.fromkeys(range(10), 1e30))
@example("arduplane", dict.fromkeys(range(10), 4000.0))
@example("arducopter", dict.fromkeys(range(10), math.nan))
def test_what_is_reckoned_with_and_sent_is_sane(kind: str, values: dict[int, float]) -> None:
    names = names_of(kind)
    adapter = told(kind, {names[index % len(names)]: value for index, value in values.items()})
    abilities = adapter.abilities
    for bound_m_s in (abilities.speed_min_m_s, abilities.speed_max_m_s):
        assert 0.0 <= bound_m_s <= FASTEST_M_S
    assert abilities.airspeed_max_m_s > 0.0
    assert math.isinf(abilities.airspeed_max_m_s) or abilities.airspeed_max_m_s <= 1e6
    assert 0.0 < abilities.n_max <= MOST_G
    assert math.isinf(abilities.braking_m_s2) or 0.0 < abilities.braking_m_s2 <= MOST_G * 9.81
    for step in range(4):
        for frame in adapter.encode(Setpoint(1.0, 10.0, 80.0), 0.0, 5.0 + 0.5 * step):
            message = common.MAVLink(None).parse_buffer(bytearray(frame))[0]
            if message.get_type() == "COMMAND_INT":
                assert all(map(math.isfinite, (message.param1, message.param2, message.param3, message.z)))
                assert abs(message.param1) <= FASTEST_M_S
                assert abs(message.param2) <= FASTEST_M_S
                assert abs(message.param3) <= FARTHEST_M


@pytest.mark.parametrize("kind", KINDS)
def test_every_parameter_that_is_reckoned_with_has_bounds(kind: str) -> None:
    adapter = ADAPTERS[kind]()
    demanded = {demand.name for demand in adapter.parameter_checks}
    for wanted in adapter.wanted:
        bounded = math.isfinite(wanted.least) and math.isfinite(wanted.greatest)
        # What is only demanded is compared with what is allowed; ADSB_TYPE is compared with 0.
        assert bounded or wanted.name in demanded or wanted.name == "ADSB_TYPE"
