"""Situations before a flight: what `companion check` finds of an autopilot that would end the mission by itself."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from companion.autopilot.linked import LinkedAdapter
from companion.onboard import preflight
from companion.onboard.config import Config
from companion.onboard.world_model import WorldModel
from companion.protocol.codec import AgentEntry, Directive, Stamp, StateFrame, TargetEntry
from tests.field.rig import EPOCH_S, ORIGIN_DEG, Rig, config_of
from tests.field.situation import Situation

HEARD_S = 9.0
"""Time for which the check listens to a vehicle."""
FENCE = ", fence: [[-900, -900], [900, -900], [900, 900], [-900, 900]]"


def listened(kind: str = "arducopter", config: Config | None = None, **told: float) -> Rig:
    """Return a rig whose companion has listened to a vehicle that tells these parameters."""
    rig = Rig(kind, config)
    getattr(rig.companion.adapter, "ask_further", lambda: None)()
    rig.run(HEARD_S)
    for name, value in told.items():
        tell(rig, mavlink.MAVLink_param_value_message(name.encode(), value, mavlink.MAV_PARAM_TYPE_REAL32, 1, 0))
    return rig


def tell(rig: Rig, message: mavlink.MAVLink_message) -> None:
    link = mavlink.MAVLink(None, srcSystem=1, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
    rig.companion.receive(bytes(message.pack(link)), rig.now_s)


def findings(rig: Rig) -> list[Any]:
    adapter = rig.companion.adapter
    assert isinstance(adapter, LinkedAdapter)
    return preflight.findings(rig.companion.config, adapter, link_heard=True, broadcast_heard=True, now_s=rig.now_s)


def said(rig: Rig, name: str) -> str:
    """Return what the check says against a parameter."""
    against = [one for one in findings(rig) if not one.passed or getattr(one, "warns", False)]
    lines = [f"{one.text} -> {one.remedy}" for one in against if one.text.startswith(name)]
    assert lines, f"passes: {[one.text for one in against] or 'nothing said'}"
    return lines[0]


def against(name: str, kind: str = "arducopter", limits: str = "", **told: float) -> Callable[[], str]:
    """Return a play in which a vehicle tells parameters against one of which the check speaks."""

    def play() -> str:
        return said(listened(kind, config_of(kind, limits=limits), **told), name)

    return play


def without_words(kind: str, more: str = "", **told: float) -> list[str]:
    rig = listened(kind, config_of(kind, more), **told)
    return [one.text for one in findings(rig) if not one.passed]


def circle_to_the_left() -> str:
    failed = without_words("arduplane", WP_LOITER_RAD=-60.0)
    assert failed == [], failed
    return "passes"


def no_battery_wanted() -> str:
    rig = Rig("arducopter", config_of("arducopter", "health: {battery_return_percent: 0}\n"), BATT_MONITOR=0.0)
    rig.lost = lambda frame: int.from_bytes(frame[7:10], "little") == mavlink.MAVLINK_MSG_ID_SYS_STATUS
    getattr(rig.companion.adapter, "ask_further", lambda: None)()
    rig.run(4.0)
    failed = [one.text for one in findings(rig) if not one.passed]
    assert failed == [], failed
    return "passes, and says that it never returns for it"


def remedy_of_a_firmware() -> str:
    rig = Rig("arducopter")
    rig.lost = lambda frame: int.from_bytes(frame[7:10], "little") == mavlink.MAVLINK_MSG_ID_PARAM_VALUE
    rig.run(HEARD_S)
    version = 4 << 24 | 7 << 16
    tell(rig, mavlink.MAVLink_autopilot_version_message(0, version, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0))
    remedies = [one.remedy for one in findings(rig) if not one.passed]
    (remedy,) = [one for one in remedies if "WP_ACC" in one]
    assert "WPNAV_ACCEL" not in remedy, remedy
    return str(remedy)


def an_agent_that_nobody_has() -> str:
    finding_on_agent = getattr(preflight, "finding_on_agent", None)
    assert finding_on_agent is not None, "passes"
    model, agents = WorldModel(7), tuple(AgentEntry(identity, 0.0, 0.0, 1) for identity in (1, 2, 3))
    targets = (TargetEntry(1, 500.0, -20.0),)
    model.take(
        StateFrame(Stamp(EPOCH_S, 0, 1), *ORIGIN_DEG, Directive.NORMAL, 1, 0, 1, 100, agents, targets, ()), EPOCH_S
    )
    wrong = finding_on_agent(config_of("arducopter").model_copy(update={"agent_id": 7}), model, whole=True)
    assert not wrong.passed
    return str(wrong.text)


def an_absurd_radius() -> str:
    rig = Rig("arduplane")
    rig.run(1.5)
    told = mavlink.MAVLink_param_value_message(b"WP_LOITER_RAD", 4_000.0, mavlink.MAV_PARAM_TYPE_REAL32, 1, 0)
    rig.run(8.0, lambda: tell(rig, told))
    assert rig.last.setpoint is None, "adopted: a dead companion leaves a circle of 4000 m"
    return str(rig.last.reason)


def an_absurd_drag() -> str:
    rig = listened("px4-copter", SIH_KDV=1e-30)
    reached_m_s = rig.companion.adapter.abilities.airspeed_max_m_s
    by = rig.companion.adapter.abilities.airspeed_by
    assert "not told" in by, f"reaches {reached_m_s:.3g} m/s through the air"
    return f"whether it reaches its airspeed is {by}"


def a_parameter_file() -> str:
    rig = listened(GUID_TIMEOUT=3.0, FS_GCS_ENABLE=1.0)
    values = dict(pair for one in findings(rig) for pair in getattr(one, "sets", ()))
    assert values, "no such option"
    from companion.onboard.param_file import write_param_file

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "demanded.param"
        write_param_file(path, "arducopter", 1, values)
        lines = dict(line.split(",") for line in path.read_text().splitlines())
    failed = without_words("arducopter", "", **{name: float(value) for name, value in lines.items()})
    assert failed == [], failed
    return f"{len(lines)} parameters written; loaded, the check passes"


SITUATIONS = (
    Situation(
        "the loss of radio control returns an ArduCopter",
        "the check says that it ends GUIDED",
        "not a word",
        against("FS_THR_ENABLE", FS_THR_ENABLE=1.0, FS_OPTIONS=16.0),
    ),
    Situation(
        "the loss of a ground station returns a PX4",
        "the check fails",
        "passes",
        against("NAV_DLL_ACT", "px4-plane", NAV_DLL_ACT=2.0),
    ),
    Situation(
        "the autopilot's circle fence of 300 m lies inside a mission's fence of 1800 m",
        "the check fails with the radius that is needed",
        "passes",
        against(
            "FENCE_RADIUS",
            limits=FENCE,
            FENCE_ENABLE=1.0,
            FENCE_ACTION=1.0,
            FENCE_TYPE=7.0,
            FENCE_RADIUS=300.0,
            FENCE_ALT_MAX=200.0,
        ),
    ),
    Situation(
        "the autopilot's fence by height lies below `limits.height_max_m`",
        "the check fails",
        "passes",
        against("GF_MAX_VER_DIST", "px4-copter", GF_MAX_VER_DIST=80.0),
    ),
    Situation(
        "the autopilot returns on its battery at 45 %, the companion at 25 %",
        "the check fails with both",
        "passes",
        against("BATT_LOW_MAH", BATT_FS_LOW_ACT=2.0, BATT_LOW_MAH=1500.0, BATT_CAPACITY=3300.0, BATT_LOW_VOLT=0.0),
    ),
    Situation(
        "the autopilot avoids aircraft by itself",
        "the check fails",
        "passes",
        against("AVD_F_ACTION", "arduplane", AVD_ENABLE=1.0, AVD_F_ACTION=2.0),
    ),
    Situation(
        "a copter without sticks goes to ALT_HOLD when its estimate is lost",
        "the check fails",
        "passes",
        against("FS_EKF_ACTION", FS_EKF_ACTION=2.0),
    ),
    Situation(
        "WP_LOITER_RAD is -60: a circle to the left",
        "the check passes",
        "fails: allowed 20 to 200",
        circle_to_the_left,
    ),
    Situation(
        "no battery monitor, and `health.battery_return_percent: 0`",
        "the check passes and says so",
        "fails: battery not told",
        no_battery_wanted,
    ),
    Situation(
        "ArduCopter 4.7 does not tell its acceleration",
        "the remedy has 4.7's name and unit alone",
        "set WPNAV_ACCEL to 250 (set WP_ACC to 2.5)",
        remedy_of_a_firmware,
    ),
    Situation(
        "`agent_id` 7, and the broadcast has 1, 2 and 3",
        "the check fails and names them",
        "passes",
        an_agent_that_nobody_has,
    ),
    Situation(
        "WP_LOITER_RAD is 4000 in flight",
        "refused by name and bounds",
        "adopted: a dead companion leaves a circle of 4000 m",
        an_absurd_radius,
    ),
    Situation(
        "SIH_KDV is 1e-30",
        "not reckoned with",
        "reaches 9.8e+30 m/s through the air",
        an_absurd_drag,
    ),
    Situation(
        "a vehicle loads what `companion check --param` wrote",
        "then the check passes",
        "no such option",
        a_parameter_file,
    ),
)
"""The situations of this area."""
