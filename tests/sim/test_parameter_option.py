"""`--param` of `sim fly`: the stand-ins fly with it, and a name or a value that they do not have is refused."""

from __future__ import annotations

import numpy as np
import pytest

from companion.errors import InputError
from companion.mission.model import Mission
from companion.mission.resolve import resolve
from sim.cli import cli
from sim.lockstep import FlightOptions, fly

MISSION = resolve(
    Mission.model_validate(
        {
            "name": "a short way",
            "agents": [{"id": 1, "north_m": 0.0, "east_m": 0.0, "speed_m_s": 8.0}],
            "targets": [{"id": 1, "north_m": 90.0, "east_m": 0.0, "speed_bound_m_s": 0.0}],
            "threats": [],
            "arrival_radius_m": 10.0,
            "max_time_s": 10.0,
        }
    ),
    1,
)


def flown_m(parameters: tuple[tuple[str, float], ...]) -> float:
    options = FlightOptions(law="routed", autopilot="px4-copter", parameters=parameters)
    return float(np.max(fly(MISSION, 1, options).trajectory.agents_ned_m[:, 0, 0]))


def test_a_copter_with_more_drag_is_behind_one_with_less() -> None:
    assert flown_m((("SIH_KDV", 1.0),)) < flown_m(()) - 3.0


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("SIH_KDVV=1", "--param: unknown 'SIH_KDVV'; did you mean 'SIH_KDV'?; allowed: "),
        ("SIH_KDV=-1", "--param: SIH_KDV=-1; allowed: 0 to 10"),
    ],
)
def test_a_parameter_that_the_stand_in_does_not_have_is_refused(given: str, said: str) -> None:
    with pytest.raises(InputError) as refused:
        cli.main(["fly", "copter-demo", "--autopilot", "px4-copter", "--param", given], standalone_mode=False)
    assert said in str(refused.value)
