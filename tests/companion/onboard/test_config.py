"""The vehicle's configuration: complete before a flight, and refused in one line otherwise."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.errors import InputError
from companion.files.yaml import dump_yaml, parse_yaml, validated
from companion.guidance.settings import LAWS, LawName
from companion.mission.model import load_mission, packaged_missions, parse_mission
from companion.mission.resolve import resolve
from companion.onboard.config import Config, config_for_agent, dump_config, load_config, packaged_configs, parse_config

GOOD = """
agent_id: 3
autopilot: {kind: arducopter, link: "udpin:127.0.0.1:14540"}
broadcast: {link: "udpin:127.0.0.1:14600", trust: unsigned}
"""
UPLINK = 'uplink: {link: "udpout:127.0.0.1:14700"}\n'
WITHOUT_AUTOPILOT = "agent_id: 3\nbroadcast: {link: 'udpin:127.0.0.1:14600', trust: unsigned}\n"
WITHOUT_BROADCAST = "agent_id: 3\nautopilot: {kind: arducopter, link: 'udpin:127.0.0.1:14540'}\n"


def with_autopilot(line: str) -> str:
    return GOOD.replace("kind: arducopter,", f"kind: arducopter, {line},")


BAD: dict[str, tuple[str, tuple[str, ...]]] = {
    "empty": ("", ("empty",)),
    "a list": ("- 1\n", ("mapping",)),
    "broken YAML": ("agent_id: [\n", ("not valid YAML", "line")),
    "no agent": (GOOD.replace("agent_id: 3", ""), ("agent_id", "missing")),
    "no autopilot": (WITHOUT_AUTOPILOT, ("autopilot", "missing")),
    "no broadcast": (WITHOUT_BROADCAST, ("broadcast", "missing")),
    "an unknown key": (GOOD + "hight_m: 5\n", ("'hight_m'", "did you mean 'height_m'?")),
    "an unknown key below": (GOOD + "limits: {range: 5}\n", ("limits", "'range'", "did you mean 'range_m'?")),
    "a key given twice": (GOOD + "agent_id: 4\n", ("'agent_id' is given twice",)),
    "an agent as a word": (GOOD.replace("3", "three"), ("agent_id", "'three'", "integer")),
    "an unknown autopilot": (
        GOOD.replace("arducopter", "arducoptor"),
        ("autopilot", "kind: 'arducoptor'", "did you mean 'arducopter'?", "kinematic"),
    ),
    "an autopilot without a link": (GOOD.replace(', link: "udpin:127.0.0.1:14540"', ""), ("autopilot.link", "missing")),
    "a bad autopilot link": (GOOD.replace("udpin:127.0.0.1:14540", "serial:ttyS0"), ("autopilot", "serial", "allowed")),
    "a bad port": (GOOD.replace("14600", "146000"), ("broadcast", "146000", "65535")),
    "a broadcast link that sends": (
        GOOD.replace("udpin:127.0.0.1:14600", "udpout:127.0.0.1:14600"),
        ("broadcast", "link: 'udpout:127.0.0.1:14600'", "udpin:HOST:PORT"),
    ),
    "hardly any checks": (
        GOOD.replace("trust: unsigned", "trust: unsigned, checks_per_s: 1.0e-320"),
        ("broadcast.checks_per_s", "greater than or equal to 1"),
    ),
    "checks without end": (
        GOOD.replace("trust: unsigned", "trust: unsigned, checks_per_s: 1.0e+6"),
        ("broadcast.checks_per_s", "less than or equal to 100000"),
    ),
    "an unknown law": (GOOD + "law: sead\n", ("law", "'sead'", "'seed'")),
    "the surrogate that does not fly": (
        GOOD + "surrogate: monolithic\n",
        ("surrogate", "'monolithic'", "allowed: pairwise, analytic"),
    ),
    "a surrogate that is not": (GOOD + "surrogate: monolith\n", ("surrogate", "'monolith'", "'pairwise'")),
    "an uplink without a period": (GOOD + UPLINK, ("report_period_s: 0 with an uplink", "a period above 0")),
    "a period without an uplink": (GOOD + "report_period_s: 30\n", ("report_period_s: 30 without an uplink",)),
    "a period of less than nothing": (GOOD + UPLINK + "report_period_s: -1\n", ("report_period_s", "-1")),
    "an uplink that listens": (
        GOOD + UPLINK.replace("udpout", "udpin") + "report_period_s: 30\n",
        ("uplink", "link: 'udpin:127.0.0.1:14700'", "allowed: udpout:HOST:PORT"),
    ),
    "an uplink without a link": (GOOD + "uplink: {}\nreport_period_s: 30\n", ("uplink.link", "missing")),
    "a bad uplink": (GOOD + UPLINK.replace("14700", "0"), ("uplink", "port '0'", "65535")),
    "a detector behind the vehicle": (GOOD + "detector_range_m: -1\n", ("detector_range_m", "-1")),
    "a height below the band": (GOOD + "height_m: 1\n", ("height_m: 1", "limits.height_min_m 5")),
    "a height above the band": (GOOD + "height_m: 500\n", ("height_m: 500", "limits.height_max_m 120")),
    "a band upside down": (
        GOOD + "limits: {height_min_m: 50, height_max_m: 40}\n",
        ("limits", "height_min_m: 50", "height_max_m 40"),
    ),
    "thresholds out of order": (
        GOOD + "staleness: {coasting_after_s: 80}\n",
        ("staleness", "coasting_after_s <= loitering_after_s"),
    ),
    "no turning": (GOOD + "limits: {n_max: 0}\n", ("limits.n_max", "0", "greater than 0")),
    "no speed": (GOOD + "limits: {speed_m_s: 0}\n", ("limits.speed_m_s", "0", "greater than 0")),
    "a speed that is no number": (GOOD + "limits: {speed_m_s: .nan}\n", ("limits.speed_m_s", "nan")),
    "an endless range": (GOOD + "limits: {range_m: .inf}\n", ("limits.range_m", "inf", "finite")),
    "a step of nothing": (GOOD + "guidance_step_s: 0\n", ("guidance_step_s", "0", "greater than or equal to 0.001")),
    "a step of nearly nothing": (GOOD + "guidance_step_s: 1.0e-6\n", ("guidance_step_s", "0.001")),
    "a plane that would turn on the spot": (
        GOOD.replace("arducopter", "arduplane") + "limits: {speed_m_s: 0.4}\n",
        ("limits.speed_m_s: 0.4 with autopilot.kind 'arduplane'", "at least 0.5", "cannot stop"),
    ),
    "a step too long": (GOOD + "guidance_step_s: 11\n", ("guidance_step_s", "11", "10")),
    "a fence of two corners": (GOOD + "limits: {fence: [[0, 0], [1, 1]]}\n", ("limits.fence", "3")),
    "a fence that folds back": (
        GOOD + "limits: {fence: [[0, 0], [9, 0], [4, 0]]}\n",
        ("limits.fence: its three corners are on one line", "allowed: a simple polygon"),
    ),
    "an exclusion that crosses itself": (
        GOOD + "limits: {exclusions: [[[0, 0], [9, 9], [9, 0], [0, 9]]]}\n",
        ("limits.exclusions[0]: the edges after corners 0 and 2 cross", "allowed: a simple polygon"),
    ),
    "a keep-out that is not": (GOOD + "keep_out: all\n", ("keep_out", "'all'", "'attack' or 'detection'")),
    "a wind as fast as the vehicle": (
        GOOD + "limits: {speed_m_s: 5, wind_m_s: 5}\n",
        ("limits", "wind_m_s: 5", "less than speed_m_s 5"),
    ),
    "a wind of less than nothing": (GOOD + "limits: {wind_m_s: -1}\n", ("limits.wind_m_s", "-1")),
    "a reaction before the setpoint": (GOOD + "limits: {reaction_s: -0.1}\n", ("limits.reaction_s", "-0.1")),
    "no share of the turn rate": (GOOD + "limits: {rate_share: 0}\n", ("limits.rate_share", "greater than 0")),
    "more than the turn rate": (GOOD + "limits: {rate_share: 1.1}\n", ("limits.rate_share", "1.1")),
    "an endless error": (GOOD + "limits: {position_error_m: .inf}\n", ("limits.position_error_m", "inf")),
    "layers of less than nothing": (GOOD + "vertical_separation_m: -1\n", ("vertical_separation_m", "-1")),
    "another case": (GOOD + "case: III\n", ("case", "'III'", "'I' or 'II'")),
    "setpoints too seldom": (GOOD + "setpoint_rate_hz: 1\n", ("setpoint_rate_hz", "1", "2")),
    "setpoints too often": (GOOD + "setpoint_rate_hz: 51\n", ("setpoint_rate_hz", "51", "50")),
    "a system that is none": (with_autopilot("system_id: 0"), ("autopilot.system_id", "0", "1")),
    "a system beyond all": (with_autopilot("system_id: 256"), ("autopilot.system_id", "256", "255")),
    "an offboard that is not": (with_autopilot("offboard: mavlink"), ("autopilot.offboard", "'mavlink'", "'direct'")),
    "offboard of another kind": (
        with_autopilot("offboard: direct"),
        ("autopilot", "offboard: 'direct'", "kind 'arducopter'", "only with px4-copter"),
    ),
    "a clearing that is not": (with_autopilot("clear: rc"), ("autopilot.clear", "'rc'", "'disarm' or 'signal'")),
    "a state file without a name": (with_autopilot("state_file: ''"), ("autopilot.state_file", "1")),
    "a PX4 without a state file": (
        GOOD.replace("arducopter", "px4-plane"),
        ("autopilot.state_file: missing", "'px4-plane'", "started again in flight"),
    ),
    "no time to say anything": (GOOD + "status: {period_s: 0.5}\n", ("status.period_s", "0.5", "1")),
    "half quiet": (GOOD + "status: {quiet: half}\n", ("status.quiet", "'half'", "boolean")),
    "a stage that ends before": (GOOD + "staleness: {recover_after_s: -1}\n", ("staleness.recover_after_s", "-1")),
    "an empty battery as limit": (
        GOOD + "health: {battery_return_percent: 91}\n",
        ("health.battery_return_percent", "91", "90"),
    ),
    "a position without any accuracy": (
        GOOD + "health: {position_accuracy_m: 0}\n",
        ("health.position_accuracy_m", "greater than 0"),
    ),
    "a fix beyond all": (GOOD + "health: {gps_fix_min: 7}\n", ("health.gps_fix_min", "7", "6")),
    "no patience with the guard": (
        GOOD + "health: {infeasible_after_s: 0}\n",
        ("health.infeasible_after_s", "greater than 0"),
    ),
    "a clock that never errs": (GOOD + "health: {clock_step_s: 0}\n", ("health.clock_step_s", "greater than 0")),
    "a log folder without a name": (GOOD + "log_dir: ''\n", ("log_dir", "1")),
}


def load(folder: Path, text: str) -> Config:
    path = folder / "config.yaml"
    path.write_text(text, encoding="utf-8")
    return load_config(str(path))


@pytest.mark.parametrize("name", packaged_configs())
def test_a_packaged_configuration_is_ready_to_fly(name: str) -> None:
    config = load_config(name)
    assert config.autopilot is not None
    assert config.broadcast is not None


def test_the_packaged_configuration_is_of_an_agent_of_its_mission_and_flies_as_it_does() -> None:
    config, mission = load_config("copter-demo-1"), load_mission("copter-demo")
    (agent,) = [agent for agent in mission.agents if agent.id == config.agent_id]
    assert (config.limits.speed_m_s, config.limits.n_max, config.limits.range_m) == (
        agent.speed_m_s,
        agent.n_max,
        agent.range_m,
    )
    assert config.weights == mission.weights
    assert (config.separation_m, config.arrival_radius_m, config.guidance_step_s) == (
        mission.separation_m,
        mission.arrival_radius_m,
        mission.guidance_step_s,
    )


def test_a_configuration_needs_only_agent_and_links(tmp_path: Path) -> None:
    config = load(tmp_path, GOOD)
    assert (config.agent_id, config.law, config.keep_out) == (3, "routed", "detection")


def test_a_vehicle_with_one_radio_hears_the_broadcast_through_its_autopilot(tmp_path: Path) -> None:
    config = load(tmp_path, GOOD.replace("udpin:127.0.0.1:14600", "autopilot"))
    assert config.broadcast is not None
    assert config.broadcast.link == "autopilot"


@pytest.mark.parametrize(("key", "config"), [("case", "I"), ("case", "II")])
def test_a_mission_tells_its_case_to_each_agent(key: str, config: str) -> None:
    mission = resolve(load_mission("paper-static").model_copy(update={key: config}), 1)
    assert config_for_agent(mission, 1, "routed").case == config


@pytest.mark.parametrize("kind", ["arducopter", "px4-copter"])
def test_a_configuration_written_out_is_read_back_the_same(kind: str) -> None:
    given = {"kind": kind, "link": "udpin:127.0.0.1:14540", "state_file": "a", "system_id": 3, "clear": "signal"}
    config = Config.model_validate({"agent_id": 1, "autopilot": given, "status": {"quiet": True}, "case": "II"})
    assert parse_config(dump_config(config), "written") == config


@pytest.mark.parametrize("law", LAWS)
def test_every_law_can_be_chosen(tmp_path: Path, law: str) -> None:
    assert load(tmp_path, GOOD + f"law: {law}\n").law == law


@pytest.mark.parametrize("what", BAD)
def test_a_bad_configuration_is_refused_in_one_line_that_says_what_is_wrong(tmp_path: Path, what: str) -> None:
    text, parts = BAD[what]
    with pytest.raises(InputError) as caught:
        load(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'config.yaml'}: ")
    assert "\n" not in message
    for part in parts:
        assert part in message


@pytest.mark.parametrize("name", ["copter-demo-l", "nowhere/config.yaml", "n" * 5_000])
def test_a_configuration_that_is_not_there_is_named_beside_the_packaged_ones(name: str) -> None:
    with pytest.raises(InputError, match="no such configuration file .* packaged: copter-demo-1"):
        load_config(name)


@pytest.mark.slow
@given(
    st.sampled_from(sorted(Config.model_fields)),
    st.recursive(st.none() | st.floats() | st.integers() | st.text(st.characters(codec="utf-8"), max_size=3), st.lists),
)
def test_no_value_under_any_key_ends_in_anything_but_an_input_error(key: str, value: object) -> None:
    try:
        validated(Config, parse_yaml(dump_yaml({"agent_id": 1, key: value}), "any"), "any")
    except InputError as error:
        assert "\n" not in str(error)


@pytest.mark.parametrize("name", packaged_missions())
def test_a_mission_implies_the_configuration_of_each_of_its_agents(name: str) -> None:
    mission = resolve(load_mission(name), 1)
    for agent in mission.agents:
        config = config_for_agent(mission, agent.id, "seed")
        assert config.agent_id == agent.id
        assert config.limits.speed_m_s == agent.speed_m_s
        assert config.limits.range_m == agent.range_m
        assert config.range_policy == mission.range_policy
        assert (config.autopilot, config.broadcast) == (None, None)


@given(
    st.floats(0.001, 10.0),
    st.floats(0.001, 1e6),
    st.floats(1e-6, 1e3),
    st.floats(1e-6, 100.0),
    st.floats(1e-6, 1e9),
)
def test_every_legal_mission_implies_a_legal_configuration(
    step_s: float, period_s: float, speed_m_s: float, n_max: float, range_m: float
) -> None:
    text = dump_yaml(
        {
            "agents": [
                {"id": 1, "north_m": 0, "east_m": 0, "speed_m_s": speed_m_s, "n_max": n_max, "range_m": range_m}
            ],
            "targets": [{"id": 1, "north_m": 9, "east_m": 0}],
            "guidance_step_s": step_s,
            "integration_step_s": step_s,
            "broadcast_period_s": period_s,
        }
    )
    config = config_for_agent(parse_mission(text, "x"), 1, "seed")
    assert config.guidance_step_s == step_s
    assert config.staleness.coasting_after_s > period_s


def implied(lines: str, law: LawName = "seed") -> Config:
    return config_for_agent(parse_mission(f"agents: [{{id: 1}}]\ntargets: [{{id: 1}}]\n{lines}\n", "x"), 1, law)


def test_the_surrogate_that_does_not_fly_is_implied_for_the_simulator_only() -> None:
    assert implied("surrogate: monolithic").surrogate == "monolithic"


def test_reports_are_implied_in_case_ii_only() -> None:
    assert implied("case: II\nreport_period_s: 60").report_period_s == 60.0
    assert implied("case: II").report_period_s == 0.0
    assert implied("case: I\nreport_period_s: 60").report_period_s == 0.0


def test_the_range_of_the_detector_is_the_missions() -> None:
    assert implied("detector_range_m: 750").detector_range_m == 750.0


def test_an_uplink_with_a_period_is_ready_to_fly(tmp_path: Path) -> None:
    config = load(tmp_path, GOOD + UPLINK + "report_period_s: 30\n")
    assert config.uplink is not None
    assert (config.uplink.link, config.report_period_s) == ("udpout:127.0.0.1:14700", 30.0)


def test_by_itself_a_configuration_assumes_a_vehicle_that_obeys_at_once_and_whole_in_still_air(tmp_path: Path) -> None:
    limits = load(tmp_path, GOOD).limits
    assert (limits.reaction_s, limits.rate_share, limits.wind_m_s, limits.position_error_m) == (0.0, 1.0, 0.0, 0.0)


def test_the_strongest_wind_of_the_mission_is_implied_with_its_gusts() -> None:
    assert implied("wind: {speed_m_s: 5, gust_m_s: 2}").limits.wind_m_s == 7.0


@pytest.mark.parametrize(("law", "keep_out"), [(law, "detection" if law == "routed" else "attack") for law in LAWS])
def test_the_guard_makes_up_for_none_of_the_papers_laws_outside_the_attack_discs(law: LawName, keep_out: str) -> None:
    assert implied("", law).keep_out == keep_out


def test_layers_are_told_apart_half_way_between_them() -> None:
    assert implied("layers: 3\nlayer_spacing_m: 40").vertical_separation_m == 20.0
    assert implied("").vertical_separation_m == 0.0
