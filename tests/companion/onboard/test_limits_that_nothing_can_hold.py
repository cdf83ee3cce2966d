"""Whatever numbers a configuration holds, it is refused in one line or a companion can be made of it."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from companion.autopilot.kinds import KINDS
from companion.errors import InputError
from companion.files.yaml import dump_yaml
from companion.onboard.companion import Companion
from companion.onboard.config import parse_config

KEYS = (
    "speed_m_s",
    "n_max",
    "range_m",
    "height_min_m",
    "height_max_m",
    "braking_m_s2",
    "reaction_s",
    "rate_share",
    "wind_m_s",
    "position_error_m",
)
numbers = st.sampled_from([0.0, 1e-300, 1e-9, 1e-3, 0.1, 0.49, 0.5, 1.0, 10.0, 100.0, 1e4, 1e9, 1e300, -1.0])
SLOW = (
    "case: II\nagents: [{id: 7, north_m: 0, east_m: 0, speed_m_s: 0.4}]\ntargets: [{id: 1, north_m: 90, east_m: 0}]\n"
)


@given(st.dictionaries(st.sampled_from(KEYS), numbers, max_size=4), st.sampled_from(sorted(KINDS)), st.booleans())
def test_any_limits_are_refused_in_one_line_or_can_be_flown_by(
    limits: dict[str, float], kind: str, routed: bool
) -> None:
    autopilot = {"kind": kind, "link": "udpin:127.0.0.1:14540"}
    text = dump_yaml({"agent_id": 1, "autopilot": autopilot, "limits": limits, "law": "routed" if routed else "seed"})
    try:
        config = parse_config(text, "a.yaml")
    except InputError as error:
        assert str(error).startswith("a.yaml: ")
        assert "\n" not in str(error)
        return
    assert Companion(config).steering.unable is None
