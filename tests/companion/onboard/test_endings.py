"""What of the autopilot's own rules ends the steering, by its parameters."""

from __future__ import annotations

import math
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.autopilot.firmware import ENDINGS, FAMILIES, known
from companion.autopilot.firmware import names as firmware_names
from companion.onboard.config import Config, parse_config
from companion.onboard.endings import endings
from companion.onboard.finding import Finding

KINDS = tuple(FAMILIES)
NAME = re.compile(r"\b[A-Z][A-Z0-9]+(?:_[A-Z0-9]+)+\b")
"""What looks like a parameter's name."""
FENCE = "fence: [[-1000, -1000], [1000, -1000], [1000, 1000], [-1000, 1000]], "


def config_of(kind: str, *, fenced: bool = False, health: str = "", limits: str = "") -> Config:
    return parse_config(
        f"agent_id: 1\nautopilot: {{kind: {kind}, link: 'udpin:127.0.0.1:14550'}}\n"
        f"limits: {{{FENCE if fenced else ''}speed_m_s: 5, height_min_m: 10, height_max_m: 120{limits}}}\n{health}",
        "test",
    )


def stock(kind: str, **values: float) -> dict[str, float]:
    """Return the parameters that end the steering as the firmware comes, with a battery monitor, and others."""
    rows = [known(kind, name) for name in ENDINGS[FAMILIES[kind]]]
    return {row.name: row.default for row in rows if row is not None} | {"BATT_MONITOR": 4.0} | values


def words(kind: str, config: Config | None = None, **values: float) -> dict[str, Finding]:
    """Return what is not simply passed, by its first word."""
    found = endings(config or config_of(kind), kind, stock(kind, **values))
    return {one.text.split()[0].rstrip(":"): one for one in found if one.word != "pass"}


@pytest.mark.parametrize("kind", KINDS)
def test_as_it_comes_nothing_fails_and_the_loss_of_radio_control_is_told(kind: str) -> None:
    found = words(kind)
    assert all(one.word == "warn" for one in found.values())
    # A plane's short failsafe leaves GUIDED alone.
    assert any("loss of radio control ends" in one.text for one in found.values()) == (kind != "arduplane")


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("arducopter", {"FS_OPTIONS": 4.0}),
        ("arducopter", {"FS_THR_ENABLE": 0.0}),
        ("arduplane", {"FS_LONG_ACTN": 1.0, "THR_FAILSAFE": 0.0}),
        ("ardurover", {"FS_ACTION": 0.0}),
        ("px4-copter", {"COM_RCL_EXCEPT": 4.0}),
        ("px4-plane", {"COM_RC_IN_MODE": 4.0}),
    ],
)
def test_a_vehicle_that_flies_on_without_radio_control_is_not_warned_of(kind: str, values: dict[str, float]) -> None:
    assert words(kind, None, **values) == {}


@pytest.mark.parametrize("values", [{"FS_SHORT_ACTN": 2.0}, {"FS_LONG_ACTN": 1.0}])
def test_a_plane_that_leaves_guided_without_radio_control_is_warned_of(values: dict[str, float]) -> None:
    assert words("arduplane", None, **values)["THR_FAILSAFE"].word == "warn"


FAILING = [
    ("px4-copter", {"NAV_DLL_ACT": 2.0}, "NAV_DLL_ACT"),
    ("arducopter", {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 1.0, "FENCE_ALT_MAX": 100.0}, "FENCE_ALT_MAX"),
    (
        "arduplane",
        {"FENCE_ENABLE": 1.0, "FENCE_ACTION": 1.0, "FENCE_TYPE": 8.0, "FENCE_ALT_MIN": 30.0},
        "FENCE_ALT_MIN",
    ),
    ("arducopter", {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 2.0, "FENCE_RADIUS": 300.0}, "FENCE_RADIUS"),
    ("ardurover", {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 2.0, "FENCE_RADIUS": 300.0}, "FENCE_RADIUS"),
    ("px4-copter", {"GF_MAX_HOR_DIST": 500.0}, "GF_MAX_HOR_DIST"),
    ("px4-plane", {"GF_MAX_VER_DIST": 50.0}, "GF_MAX_VER_DIST"),
    ("arducopter", {"BATT_FS_LOW_ACT": 2.0, "BATT_LOW_MAH": 1500.0, "BATT_LOW_VOLT": 0.0}, "BATT_LOW_MAH"),
    ("arduplane", {"BATT_FS_CRT_ACT": 3.0}, "BATT_FS_CRT_ACT"),
    (
        "arduplane",
        {"FENCE_AUTOENABLE": 1.0, "FENCE_ACTION": 1.0, "FENCE_TYPE": 1.0, "FENCE_ALT_MAX": 50.0},
        "FENCE_ALT_MAX",
    ),
    (
        "arducopter",
        {"BATT2_MONITOR": 4.0, "BATT2_FS_LOW_ACT": 2.0, "BATT2_LOW_MAH": 1500.0, "BATT2_LOW_VOLT": 0.0},
        "BATT2_LOW_MAH",
    ),
    (
        "arduplane",
        {"BATT2_MONITOR": 4.0, "BATT2_FS_LOW_ACT": 1.0, "BATT2_LOW_MAH": 3000.0},
        "BATT2_LOW_MAH",
    ),
    ("arduplane", {"BATT2_MONITOR": 4.0, "BATT2_FS_CRT_ACT": 3.0}, "BATT2_FS_CRT_ACT"),
    ("arduplane", {"AFS_ENABLE": 1.0, "AFS_TERM_ACTION": 42.0}, "AFS_ENABLE"),
    ("ardurover", {"AFS_ENABLE": 1.0, "AFS_TERM_ACTION": 42.0}, "AFS_ENABLE"),
    ("arduplane", {"FS_LONG_ACTN": 3.0}, "FS_LONG_ACTN"),
    ("px4-copter", {"COM_LOW_BAT_ACT": 3.0, "BAT_CRIT_THR": 0.3}, "BAT_CRIT_THR"),
    ("arducopter", {"BATT_MONITOR": 0.0}, "BATT_MONITOR"),
    ("arducopter", {"FS_EKF_ACTION": 2.0}, "FS_EKF_ACTION"),
    ("arducopter", {"AVD_ENABLE": 1.0}, "AVD_F_ACTION"),
    ("px4-plane", {"NAV_TRAFF_AVOID": 2.0}, "NAV_TRAFF_AVOID"),
]


@pytest.mark.parametrize(("kind", "values", "name"), FAILING)
def test_what_ends_the_steering_though_nothing_is_wrong_fails_with_a_remedy(
    kind: str, values: dict[str, float], name: str
) -> None:
    finding = words(kind, config_of(kind, fenced=True), **values)[name]
    assert not finding.passed
    assert finding.remedy


@pytest.mark.parametrize(("kind", "values", "name"), FAILING)
def test_what_a_finding_sets_makes_it_pass(kind: str, values: dict[str, float], name: str) -> None:
    config = config_of(kind, fenced=True)
    finding = words(kind, config, **values)[name]
    after = words(kind, config, **(values | dict(finding.sets)))
    assert name not in after or name == "BATT_MONITOR"


def test_a_fence_around_the_limits_passes() -> None:
    values = {"FENCE_ENABLE": 1.0, "FENCE_TYPE": 7.0, "FENCE_ALT_MAX": 122.0, "FENCE_RADIUS": 1417.0}
    assert words("arducopter", config_of("arducopter", fenced=True), FS_OPTIONS=4.0, **values) == {}


def test_a_circle_is_warned_of_where_the_configuration_has_no_fence() -> None:
    found = words("arducopter", FENCE_ENABLE=1.0, FENCE_TYPE=2.0, FENCE_RADIUS=300.0)
    assert found["FENCE_RADIUS"].word == "warn"


def test_a_fence_that_cannot_be_as_wide_as_the_limits_is_to_be_turned_off() -> None:
    wide = "fence: [[-20000, -20000], [20000, -20000], [20000, 20000]], "
    config = parse_config(f"agent_id: 1\nlimits: {{{wide}height_min_m: 10, height_max_m: 1500}}\n", "test")
    found = words("arducopter", config, FENCE_ENABLE=1.0, FENCE_TYPE=7.0)
    assert dict(found["FENCE_RADIUS"].sets) == dict(found["FENCE_ALT_MAX"].sets) == {"FENCE_TYPE": 4.0}


def test_a_fence_that_is_off_or_only_reports_ends_nothing() -> None:
    config = config_of("arducopter")
    for values in ({"FENCE_ENABLE": 0.0}, {"FENCE_ENABLE": 1.0, "FENCE_ACTION": 0.0}):
        assert set(words("arducopter", config, FS_OPTIONS=4.0, FENCE_ALT_MAX=10.0, **values)) == set()


def test_a_fence_that_turns_itself_on_is_judged_without_a_fence_of_the_companions() -> None:
    values = {"FENCE_AUTOENABLE": 3.0, "FENCE_ACTION": 1.0, "FENCE_TYPE": 3.0, "FENCE_ALT_MAX": 50.0}
    found = words("arduplane", None, **values)
    assert not found["FENCE_ALT_MAX"].passed
    assert found["FENCE_RADIUS"].word == "warn"


def test_a_second_battery_that_is_not_monitored_and_a_failsafe_that_is_off_end_nothing() -> None:
    values = {"BATT2_FS_LOW_ACT": 2.0, "BATT2_LOW_MAH": 3000.0, "AFS_TERM_ACTION": 42.0, "FS_OPTIONS": 4.0}
    assert words("arducopter", None, **values) == {}


def test_an_advanced_failsafe_that_does_not_crash_is_warned_of() -> None:
    assert words("arduplane", AFS_ENABLE=1.0)["AFS_ENABLE"].word == "warn"


def test_a_companion_that_never_returns_for_its_battery_leaves_it_to_the_autopilot() -> None:
    config = config_of("arducopter", health="health: {battery_return_percent: 0}\n")
    values = {"BATT_MONITOR": 0.0, "BATT_FS_LOW_ACT": 2.0, "BATT_LOW_MAH": 1500.0, "FS_OPTIONS": 4.0}
    assert words("arducopter", config, **values) == {}


def test_a_voltage_cannot_be_compared_and_is_warned_of() -> None:
    assert words("arducopter", BATT_FS_LOW_ACT=2.0)["BATT_FS_LOW_ACT"].word == "warn"


def test_what_is_not_told_is_not_judged() -> None:
    for kind in KINDS:
        assert list(endings(config_of(kind, fenced=True), kind, {})) == []


def test_the_simulators_point_ends_nothing() -> None:
    assert list(endings(config_of("kinematic"), "kinematic", {"FS_THR_ENABLE": 1.0})) == []


@settings(max_examples=150, deadline=None)
@given(
    st.sampled_from(KINDS),
    st.dictionaries(st.integers(0, 30), st.floats(allow_nan=True, allow_infinity=True, width=32), max_size=8),
    st.booleans(),
)
def test_whatever_is_told_every_finding_is_whole_and_what_it_sets_is_finite(
    kind: str, values: dict[int, float], fenced: bool
) -> None:
    names = ENDINGS[FAMILIES[kind]]
    told = stock(kind) | {names[index % len(names)]: value for index, value in values.items() if math.isfinite(value)}
    for finding in endings(config_of(kind, fenced=fenced), kind, told):
        assert finding.text
        assert finding.remedy or finding.word == "pass"
        assert all(math.isfinite(value) for _, value in finding.sets)
        # By names of this firmware alone.
        assert {*NAME.findall(finding.remedy), *dict(finding.sets)} <= {*firmware_names(FAMILIES[kind])}
