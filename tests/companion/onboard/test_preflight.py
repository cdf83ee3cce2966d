"""What `companion check` finds, and that each finding says what to do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega, common

from companion.autopilot.heartbeat import IDENTITIES
from companion.autopilot.linked import LinkedAdapter
from companion.autopilot.registry import ADAPTERS
from companion.errors import EXIT_DONE, EXIT_FAILED
from companion.onboard.config import Config, HealthSection, parse_config
from companion.onboard.finding import Finding, warning
from companion.onboard.preflight import finding_on_agent, findings
from companion.onboard.preflight_service import report
from companion.onboard.world_model import WorldModel
from companion.protocol.codec import AgentEntry, Directive, Stamp, StateFrame, TargetEntry

SYSTEM = 7
NOW_S = 100.0
REAL_KINDS = ("arducopter", "arduplane", "px4-copter", "px4-plane", "ardurover")
GOOD = {
    "arducopter": {"GUID_TIMEOUT": 1.0, "FS_GCS_ENABLE": 0.0, "WPNAV_ACCEL": 250.0, "ANGLE_MAX": 3000.0},
    "arduplane": {
        "ROLL_LIMIT_DEG": 45.0,
        "WP_LOITER_RAD": 60.0,
        "FS_GCS_ENABL": 0.0,
        "AIRSPEED_MIN": 9.0,
        "AIRSPEED_MAX": 30.0,
    },
    "px4-copter": {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 5.0, "MPC_ACC_HOR": 3.0, "MPC_XY_VEL_MAX": 12.0},
    "px4-plane": {"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 5.0, "FW_AIRSPD_TRIM": 15.0, "FW_R_LIM": 50.0},
    "ardurover": {
        "FS_GCS_ENABLE": 0.0,
        "CRUISE_SPEED": 2.0,
        "WP_SPEED": 2.0,
        "ATC_TURN_MAX_G": 0.6,
        "ATC_ACCEL_MAX": 1.0,
    },
    "kinematic": {},
}
SPEED_M_S = {
    "arducopter": 8.0,
    "arduplane": 22.0,
    "px4-copter": 10.0,
    "px4-plane": 15.0,
    "ardurover": 2.0,
    "kinematic": 60.0,
}


def config_of(kind: str, fence: str = "", **limits: float) -> Config:
    chosen = {"speed_m_s": SPEED_M_S[kind], "n_max": 0.1, "braking_m_s2": 0.4, **limits}
    return parse_config(
        f"agent_id: 1\nautopilot: {{kind: {kind}, link: 'udpin:127.0.0.1:14550'}}\n"
        f"limits: {{{', '.join(f'{key}: {value}' for key, value in chosen.items())}{fence}}}\n",
        "test",
    )


def heard(
    kind: str,
    values: dict[str, float] | None = None,
    *,
    now_s: float = NOW_S,
    fix: int = 3,
    h_acc_mm: int = 800,
    percent: int = 90,
    home: bool = True,
    position: bool = True,
) -> LinkedAdapter:
    """Return an adapter that has heard a vehicle with nothing wrong, but for what is given."""
    adapter = ADAPTERS[kind](SYSTEM)
    shown = next(one for one in IDENTITIES if one.kind.name == kind)
    messages = [
        common.MAVLink_heartbeat_message(min(shown.types or (0,)), shown.autopilot, 1, 0, 3, 3),
        common.MAVLink_gps_raw_int_message(0, fix, 0, 0, 0, 80, 0, 0, 0, 12, h_acc=h_acc_mm),
        common.MAVLink_sys_status_message(0, 0, 0, 500, 11_000, -1, percent, 0, 0, 0, 0, 0, 0),
    ]
    if position:
        messages.append(common.MAVLink_global_position_int_message(1, 470_000_000, 80_000_000, 0, 0, 0, 0, 0, 0))
    if home:
        messages.append(
            common.MAVLink_home_position_message(470_000_000, 80_000_000, 0, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)
        )
    messages += [
        common.MAVLink_param_value_message(name.encode(), value, common.MAV_PARAM_TYPE_REAL32, 1, 0)
        for name, value in {**GOOD[kind], **(values or {})}.items()
        if math.isfinite(value)
    ]
    link = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
    for message in messages:
        adapter.receive(bytes(message.pack(link)), now_s)
    return adapter


def found(
    adapter: LinkedAdapter,
    config: Config | None = None,
    *,
    link_heard: bool = True,
    broadcast_heard: bool = True,
    now_s: float = NOW_S,
) -> list[Finding]:
    config = config or config_of(adapter.kind)
    return findings(config, adapter, link_heard=link_heard, broadcast_heard=broadcast_heard, now_s=now_s)


def failed(all_found: Sequence[Finding]) -> list[Finding]:
    return [finding for finding in all_found if not finding.passed]


def only_failure(all_found: Sequence[Finding]) -> Finding:
    (finding,) = failed(all_found)
    assert finding.remedy
    return finding


@pytest.mark.parametrize("kind", REAL_KINDS)
def test_a_vehicle_with_nothing_wrong_passes(kind: str) -> None:
    assert failed(found(heard(kind))) == []


@pytest.mark.parametrize(
    ("kind", "name", "value", "remedy"),
    [
        ("arducopter", "GUID_TIMEOUT", 3.0, "set GUID_TIMEOUT to 1"),
        ("arducopter", "GUID_TIMEOUT", 0.1, "set GUID_TIMEOUT to 1"),
        ("arducopter", "FS_GCS_ENABLE", 1.0, "set FS_GCS_ENABLE to 0"),
        ("arducopter", "ANGLE_MAX", 8000.0, "set ANGLE_MAX to 3000"),
        ("arduplane", "WP_LOITER_RAD", 500.0, "set WP_LOITER_RAD to 60"),
        ("arduplane", "FS_GCS_ENABL", 1.0, "set FS_GCS_ENABL to 0"),
        ("px4-copter", "COM_OF_LOSS_T", 5.0, "set COM_OF_LOSS_T to 1"),
        ("px4-plane", "COM_OF_LOSS_T", 0.5, "set COM_OF_LOSS_T to 1"),
        ("px4-copter", "COM_OBL_RC_ACT", 0.0, "set COM_OBL_RC_ACT to 5"),
        ("px4-plane", "COM_OBL_RC_ACT", 3.0, "set COM_OBL_RC_ACT to 5"),
        ("px4-plane", "FW_R_LIM", 80.0, "set FW_R_LIM to 50"),
    ],
)
def test_a_parameter_that_a_dead_companion_would_not_survive_is_named_with_its_remedy(
    kind: str, name: str, value: float, remedy: str
) -> None:
    finding = only_failure(found(heard(kind, {name: value})))
    assert finding.text.startswith(f"{name}: {value:g}; allowed: ")
    assert finding.remedy == remedy


@pytest.mark.parametrize("kind", REAL_KINDS)
def test_a_parameter_that_is_not_told_fails(kind: str) -> None:
    name = ADAPTERS[kind]().parameter_checks[0].name
    failures = failed(found(heard(kind, {name: math.nan})))
    assert failures[0].text.startswith(f"{name}: not told")


@pytest.mark.parametrize(
    ("kind", "first", "heard_as", "text", "remedy"),
    [
        ("arducopter", "WPNAV_ACCEL", ("WP_ACC", 0.5), "WP_ACC: 0.5; allowed: 1 to 10", "set WP_ACC to 2.5"),
        (
            "arducopter",
            "WPNAV_ACCEL",
            ("WPNAV_ACCEL", 50.0),
            "WPNAV_ACCEL: 50; allowed: 100 to 1000",
            "set WPNAV_ACCEL to 250",
        ),
        (
            "arducopter",
            "ANGLE_MAX",
            ("ATC_ANGLE_MAX", 60.0),
            "ATC_ANGLE_MAX: 60; allowed: 20 to 45",
            "set ATC_ANGLE_MAX to 30",
        ),
        (
            "arduplane",
            "ROLL_LIMIT_DEG",
            ("LIM_ROLL_CD", 2000.0),
            "LIM_ROLL_CD: 2000; allowed: 3000 to 6500",
            "set LIM_ROLL_CD to 4500",
        ),
    ],
)
def test_a_remedy_has_the_name_and_the_unit_that_this_vehicle_uses(
    kind: str, first: str, heard_as: tuple[str, float], text: str, remedy: str
) -> None:
    name, value = heard_as
    finding = failed(found(heard(kind, {first: math.nan, name: value}), config_of(kind, n_max=0.03, braking_m_s2=0.3)))[
        0
    ]
    assert finding.text.startswith(text)
    assert finding.remedy == remedy


def test_a_parameter_that_is_not_told_is_asked_for_by_each_of_its_names() -> None:
    finding = failed(found(heard("arducopter", {"WPNAV_ACCEL": math.nan})))[0]
    assert finding.text.startswith("WPNAV_ACCEL: not told, nor WP_ACC; ")
    assert finding.remedy == ("set WPNAV_ACCEL to 250 (until 4.6) or set WP_ACC to 2.5 (from 4.7), or check the link")


def test_px4s_second_action_counts_where_a_version_has_it() -> None:
    assert failed(found(heard("px4-copter", {"COM_OBL_ACT": 1.0}))) == []
    finding = only_failure(found(heard("px4-copter", {"COM_OBL_ACT": 0.0})))
    assert finding.text.startswith("COM_OBL_ACT: 0; allowed: 1; without radio control")
    assert finding.remedy == "set COM_OBL_ACT to 1"


def test_a_value_that_no_vehicle_has_fails() -> None:
    failures = failed(found(heard("arduplane", {"AIRSPEED_MIN": 1e30})))
    assert [finding.text for finding in failures] == ["AIRSPEED_MIN 1e+30 is not a sane value (5 to 60)"]


@pytest.mark.parametrize(
    ("told", "by", "remedy"),
    [
        ({"ANGLE_MAX": 3000.0}, "ANGLE_MAX 3000", "ANGLE_MAX to 4500 (15 m/s)"),
        ({"ANGLE_MAX": math.nan, "ATC_ANGLE_MAX": 30.0}, "ATC_ANGLE_MAX 30", "ATC_ANGLE_MAX to 45 (15 m/s)"),
    ],
)
def test_a_copter_that_cannot_fly_its_speed_against_its_wind_fails(
    told: dict[str, float], by: str, remedy: str
) -> None:
    finding = only_failure(found(heard("arducopter", told), config_of("arducopter", wind_m_s=5.0)))
    assert finding.text == f"limits.speed_m_s 8 + wind_m_s 5 = 13 m/s through the air; it reaches 10.3 ({by})"
    assert finding.remedy == f"set speed_m_s to 5.3 or wind_m_s to 2.3 or {remedy}"
    fit = heard("arducopter", {**told, by.split()[0]: 45.0 if "ATC" in by else 4500.0})
    assert failed(found(fit, config_of("arducopter", wind_m_s=5.0))) == []


def test_where_the_drag_is_not_known_the_person_is_told_and_what_is_stated_counts() -> None:
    passed = found(heard("px4-copter"), config_of("px4-copter", wind_m_s=5.0))
    assert failed(passed) == []
    assert any("15 m/s through the air; whether this vehicle reaches it is not told" in one.text for one in passed)
    stated = config_of("px4-copter", wind_m_s=5.0, airspeed_max_m_s=12.0)
    assert only_failure(found(heard("px4-copter"), stated)).remedy == "set speed_m_s to 7 or wind_m_s to 2"


def test_px4s_simulator_with_its_own_drag_is_refused_what_it_does_not_reach() -> None:
    values = {"SIH_KDV": 1.0, "SIH_MASS": 1.0, "MPC_TILTMAX_AIR": 45.0}
    finding = only_failure(found(heard("px4-copter", values), config_of("px4-copter", speed_m_s=8.0, wind_m_s=5.0)))
    assert "it reaches 9.8 (MPC_TILTMAX_AIR 45, SIH_KDV 1, SIH_MASS 1)" in finding.text


def test_a_plane_of_one_speed_passes_with_about_that() -> None:
    assert failed(found(heard("px4-plane"), config_of("px4-plane", speed_m_s=15.4))) == []


FENCE = ", fence: [[-100, -100], [100, -100], [100, 100]]"


@pytest.mark.parametrize(
    ("kind", "good", "bad"),
    [
        ("arducopter", {"FENCE_ENABLE": 1.0, "FENCE_ACTION": 1.0}, {"FENCE_ENABLE": 0.0}),
        ("arduplane", {"FENCE_ENABLE": 1.0, "FENCE_ACTION": 1.0}, {"FENCE_ACTION": 0.0}),
        ("px4-copter", {"GF_ACTION": 2.0}, {"GF_ACTION": 0.0}),
        ("px4-plane", {"GF_ACTION": 3.0}, {"GF_ACTION": 1.0}),
    ],
)
def test_who_has_a_fence_needs_the_autopilots_own(kind: str, good: dict[str, float], bad: dict[str, float]) -> None:
    for fence in (FENCE, ", exclusions: [[[-100, -100], [100, -100], [100, 100]]]"):
        config = config_of(kind, fence)
        assert failed(found(heard(kind, good), config)) == []
        assert only_failure(found(heard(kind, {**good, **bad}), config)).text.startswith(next(iter(bad)))
    # Without a fence in the configuration it is the person's own affair.
    assert failed(found(heard(kind, {**good, **bad}))) == []


@pytest.mark.parametrize(
    ("kind", "holding", "letting_go"),
    [
        ("arducopter", {1, 2, 3, 4, 5}, {0, 6, 7}),
        # 6 and 7 put a plane into GUIDED, where it would obey the companion that left the fence.
        ("arduplane", {1, 8}, {0, 6, 7}),
        ("ardurover", {1, 2, 3, 4}, {0, 5}),
    ],
)
def test_only_a_fence_action_that_takes_the_vehicle_from_guided_will_do(
    kind: str, holding: set[int], letting_go: set[int]
) -> None:
    (demand,) = (one for one in ADAPTERS[kind]().parameter_checks if one.name == "FENCE_ACTION")
    assert {value for value in holding | letting_go if demand.met_by(value)} == holding


@pytest.mark.parametrize(
    ("kind", "key", "value", "text"),
    [
        ("arducopter", "n_max", 0.5, "limits.n_max: 0.5; this vehicle turns at most with 0.178"),
        ("arducopter", "braking_m_s2", 3.0, "limits.braking_m_s2: 3; this vehicle brakes at most with 2"),
        ("arducopter", "speed_m_s", 12.0, "limits.speed_m_s: 12; this vehicle flies 0 to 8.755 m/s"),
        ("px4-plane", "speed_m_s", 18.0, "limits.speed_m_s: 18; this vehicle flies 15 m/s"),
    ],
)
def test_limits_beyond_what_the_vehicle_can_do_are_named(kind: str, key: str, value: float, text: str) -> None:
    limits: dict[str, Any] = {key: value}
    assert only_failure(found(heard(kind), config_of(kind, **limits))).text == text


def test_the_simulators_point_can_do_anything() -> None:
    assert failed(found(heard("kinematic"))) == []


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"fix": 2}, "GPS: fix type 2; allowed: at least 3"),
        ({"h_acc_mm": 25_000}, "position good to 25.0 m; allowed: 10"),
        ({"percent": -1}, "battery: not told; returns at 25 %"),
        ({"percent": 20}, "battery: 20 %; returns at 25 %"),
        ({"home": False}, "home not told"),
        ({"position": False}, "no position within 2 s"),
    ],
)
def test_what_ails_the_vehicle_is_named(wrong: dict[str, Any], text: str) -> None:
    assert only_failure(found(heard("arducopter", **wrong))).text == text


def test_nothing_on_the_link_is_told_apart_from_no_heartbeat() -> None:
    silent = found(ADAPTERS["arducopter"](), config_of("arducopter"), link_heard=False)
    assert only_failure(silent).text == "nothing heard on autopilot.link udpin:127.0.0.1:14550"
    others = found(ADAPTERS["arducopter"](), config_of("arducopter"), link_heard=True)
    assert only_failure(others).text.startswith("messages, but no autopilot's heartbeat")


def test_a_heartbeat_that_ended_is_old() -> None:
    assert only_failure(found(heard("arducopter"), now_s=NOW_S + 10.0)).text == "last heartbeat 10 s ago"


def test_the_wrong_kind_is_named_and_nothing_is_concluded_from_its_parameters() -> None:
    adapter = ADAPTERS["arduplane"](SYSTEM)
    link = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
    adapter.receive(bytes(common.MAVLink_heartbeat_message(2, 3, 1, 0, 3, 3).pack(link)), NOW_S)
    finding = only_failure(found(adapter, config_of("arduplane")))
    assert (finding.text, finding.remedy) == (
        "heard ArduPilot of MAV_TYPE 2, configured autopilot.kind arduplane",
        "set autopilot.kind to arducopter",
    )


def test_a_broadcast_that_is_not_heard_fails_whatever_else_is_right() -> None:
    assert only_failure(found(heard("px4-copter"), broadcast_heard=False)).text == "no genuine broadcast heard"


def test_a_command_that_the_autopilot_did_not_do_is_told() -> None:
    adapter = heard("arducopter")
    link = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
    adapter.requests(NOW_S)
    ack = common.MAVLink_command_ack_message(common.MAV_CMD_SET_MESSAGE_INTERVAL, common.MAV_RESULT_DENIED)
    adapter.receive(bytes(ack.pack(link)), NOW_S)
    assert only_failure(found(adapter)).text == "rate of GLOBAL_POSITION_INT: denied"


@pytest.mark.parametrize("kind", REAL_KINDS)
def test_every_demand_is_of_a_parameter_that_is_read_and_names_itself_in_the_remedy(kind: str) -> None:
    adapter = ADAPTERS[kind](SYSTEM)
    assert {demand.name for demand in adapter.parameter_checks} <= {wanted.name for wanted in adapter.wanted}
    for demand in adapter.parameter_checks:
        told = adapter.parameters.told_as(demand.name)
        assert demand.name in demand.remedy(told)
        assert demand.words(told)
        assert demand.met_by(demand.best)


def warned(all_found: Sequence[Finding]) -> list[Finding]:
    return [finding for finding in all_found if finding.word == "warn"]


def version_of(major: int, minor: int) -> common.MAVLink_message:
    number = major << 24 | minor << 16
    return common.MAVLink_autopilot_version_message(0, number, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0)


@pytest.mark.parametrize(
    ("version", "remedy"),
    [((4, 6), "set WPNAV_ACCEL to 250, or check the link"), ((4, 7), "set WP_ACC to 2.5, or check the link")],
)
def test_a_remedy_has_the_words_of_the_firmware_heard(version: tuple[int, int], remedy: str) -> None:
    adapter = heard("arducopter", {"WPNAV_ACCEL": math.nan})
    link = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
    adapter.receive(bytes(version_of(*version).pack(link)), NOW_S)
    assert failed(found(adapter))[0].remedy == remedy


def test_a_circle_to_the_left_is_as_good_as_one_to_the_right() -> None:
    assert failed(found(heard("arduplane", {"WP_LOITER_RAD": -80.0}))) == []
    finding = only_failure(found(heard("arduplane", {"WP_LOITER_RAD": -500.0})))
    assert finding.remedy == "set WP_LOITER_RAD to -60"
    assert finding.sets == (("WP_LOITER_RAD", -60.0),)


def test_without_a_battery_to_return_for_none_need_be_told() -> None:
    config = config_of("arducopter").model_copy(update={"health": HealthSection(battery_return_percent=0.0)})
    all_found = found(heard("arducopter", percent=-1), config)
    assert failed(all_found) == []
    assert [one.text for one in warned(all_found)] == [
        "battery: not told; it never returns for it (health.battery_return_percent 0)"
    ]


def test_another_autopilot_on_the_link_is_told() -> None:
    adapter = ADAPTERS["arducopter"](SYSTEM)
    for system, base_mode in ((SYSTEM, 1), (9, 129)):
        link = common.MAVLink(None, srcSystem=system, srcComponent=1)
        for second in range(3):
            beat = common.MAVLink_heartbeat_message(2, 3, base_mode, 0, 3, 3)
            adapter.receive(bytes(beat.pack(link)), NOW_S + second)
    (told,) = warned(found(adapter, now_s=NOW_S + 2.0))
    assert told.text == "other autopilots on the same link: system 9 (armed)"


def world(*agents: AgentEntry) -> WorldModel:
    model = WorldModel(1)
    targets = (TargetEntry(4, 500.0, -20.0),)
    stamp = Stamp(round(NOW_S), 0, 1)
    model.take(StateFrame(stamp, 47.0, 8.0, Directive.NORMAL, 1, 0, 1, 100, agents, targets, ()), NOW_S)
    return model


def test_an_agent_that_the_broadcast_has_is_told_with_its_target() -> None:
    config = config_of("arducopter")
    finding = finding_on_agent(config, world(AgentEntry(1, 0.0, 0.0, 4)), whole=True)
    assert finding == Finding(True, "agent 1 is in the broadcast: target 4, 500 m north and -20 m east of the origin")
    without = finding_on_agent(config, world(AgentEntry(1, 0.0, 0.0, None)), whole=True)
    assert without is not None
    assert without.word == "warn"


def test_an_agent_that_no_broadcast_has_fails_once_all_of_one_was_heard() -> None:
    config = config_of("arducopter").model_copy(update={"agent_id": 7})
    model = world(AgentEntry(1, 0.0, 0.0, 4), AgentEntry(3, 0.0, 0.0, None))
    assert finding_on_agent(config, model, whole=False) is None
    finding = finding_on_agent(config, model, whole=True)
    assert finding is not None
    assert (finding.word, finding.text) == ("FAIL", "agent 7 is not in the broadcast: it has 1, 3")


def listening(seconds: float, position_hz: float) -> LinkedAdapter:
    """Return an adapter that has heard a vehicle for a while, with everything as it was asked but for the position."""
    adapter = heard("px4-copter")
    link = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
    beat = common.MAVLink_heartbeat_message(2, common.MAV_AUTOPILOT_PX4, 1, 0, 3, 3)
    for tick in range(1, round(seconds * 10) + 1):
        now_s = NOW_S + tick / 10
        messages = [beat] if tick % 10 == 0 else []
        if position_hz and tick % round(10 / position_hz) == 0:
            place = (470_000_000 + tick, 80_000_000)
            messages.append(common.MAVLink_global_position_int_message(tick * 100, *place, 0, 0, 0, 0, 0, 0))
        for message in messages:
            adapter.receive(bytes(message.pack(link)), now_s)
    return adapter


def test_what_comes_too_seldom_fails_with_both_rates() -> None:
    texts = [one.text for one in failed(found(listening(9.0, 1.0), now_s=NOW_S + 9.0))]
    assert "GLOBAL_POSITION_INT 1.0 Hz of 10 asked; the position rests on it" in texts
    assert "SYS_STATUS 0 Hz of 1 asked; the battery rests on it" in texts
    fast = [one.text for one in failed(found(listening(9.0, 10.0), now_s=NOW_S + 9.0))]
    assert not any(text.startswith("GLOBAL_POSITION_INT") for text in fast)


def test_a_question_that_was_refused_is_no_failure_where_the_message_comes() -> None:
    for position_hz, failures in ((10.0, 0), (1.0, 1)):
        adapter = listening(9.0, position_hz)
        adapter.requests(NOW_S + 9.0)
        link = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
        ack = common.MAVLink_command_ack_message(common.MAV_CMD_SET_MESSAGE_INTERVAL, common.MAV_RESULT_DENIED)
        adapter.receive(bytes(ack.pack(link)), NOW_S + 9.0)
        assert sum(one.startswith("rate of GLOBAL_POSITION_INT") for one in adapter.failures) == failures


def test_a_warning_fails_only_where_it_is_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    told = [Finding(True, "good"), warning("some rule ends GUIDED", "change it")]
    assert report(told) == EXIT_DONE
    assert capsys.readouterr().out.splitlines() == [
        "pass  good",
        "warn  some rule ends GUIDED -> change it",
        "2 checked, none failed, 1 warning",
    ]
    assert report(told, strict=True) == EXIT_FAILED


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (0x33F, None),
        (0xA7, "the autopilot's estimate has no position"),
        (0x833F, "the autopilot's estimate says GPS glitch"),
    ],
)
def test_an_estimate_that_does_not_know_its_place_fails(flags: int, words: str | None) -> None:
    adapter = heard("arducopter")
    link = common.MAVLink(None, srcSystem=SYSTEM, srcComponent=1)
    status = ardupilotmega.MAVLink_ekf_status_report_message(flags, 0.0, 0.0, 0.0, 0.0, 0.0)
    adapter.receive(bytes(status.pack(link)), NOW_S)
    told = [one.text for one in failed(found(adapter)) if "estimate" in one.text]
    assert told == ([] if words is None else [words])
