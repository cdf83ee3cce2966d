"""What a vehicle's computer is set up with: each example is a valid configuration, the unit one that systemd takes."""

from __future__ import annotations

import configparser
from importlib import resources
from pathlib import Path

import pytest

from companion.autopilot.linked import LinkedAdapter
from companion.autopilot.parameters import Told
from companion.autopilot.registry import ADAPTERS
from companion.onboard.config import ONE_RADIO, Config, load_config
from companion.onboard.limits import unable

ROOT = Path(__file__).parents[3]
FOLDER = resources.files("companion.onboard") / "deploy"
EXAMPLES = tuple(sorted(entry.name for entry in FOLDER.iterdir() if entry.name.endswith(".yaml")))


def example(name: str) -> Config:
    return load_config(str(FOLDER / name))


def test_there_is_an_example_for_every_autopilot_and_for_one_radio() -> None:
    expected = {*ADAPTERS, "one-radio"} - {"kinematic"}
    assert {name.removesuffix(".yaml") for name in EXAMPLES} == expected


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_is_a_configuration_for_flying(name: str) -> None:
    config = example(name)
    assert config.autopilot is not None and config.broadcast is not None
    assert config.autopilot.kind == ("arducopter" if name == "one-radio.yaml" else name.removesuffix(".yaml"))
    assert (config.broadcast.link == ONE_RADIO) == (name == "one-radio.yaml")
    assert config.broadcast.trust == "both"


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_asks_no_more_than_the_autopilots_defaults_can(name: str) -> None:
    config = example(name)
    assert config.autopilot is not None
    adapter = ADAPTERS[config.autopilot.kind]()
    assert isinstance(adapter, LinkedAdapter)
    abilities, limits = adapter.abilities, config.limits
    assert abilities.speed_min_m_s <= limits.speed_m_s <= abilities.speed_max_m_s
    assert limits.n_max <= abilities.n_max
    assert unable(limits, abilities, can_stop=adapter.can_stop) is None
    if adapter.can_stop:
        assert limits.braking_m_s2 <= abilities.braking_m_s2


@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_explains_every_key_of_its_first_level(name: str) -> None:
    text = (FOLDER / name).read_text()
    assert text.count("#") >= 25


def test_the_unit_restarts_a_hung_companion_and_waits_for_the_clock() -> None:
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read_string((FOLDER / "companion@.service").read_text())
    service = unit["Service"]
    assert (service["Type"], service["Restart"]) == ("notify", "always")
    assert float(service["WatchdogSec"]) <= 3.0
    assert "time-sync.target" in unit["Unit"]["After"]


def test_what_the_unit_lets_be_written_is_where_the_examples_write() -> None:
    for name in EXAMPLES:
        config = example(name)
        assert config.broadcast is not None and config.autopilot is not None
        assert str(config.broadcast.state_file).startswith("/var/lib/oneway-guidance/")
        assert (config.autopilot.state_file or "/var/lib/oneway-guidance/").startswith("/var/lib/oneway-guidance/")
        assert config.log_dir == "/var/log/oneway-guidance"


def test_px4_examples_keep_whether_they_steer() -> None:
    kept = {name for name in EXAMPLES if (section := example(name).autopilot) is not None and section.state_file}
    assert kept == {"px4-copter.yaml", "px4-plane.yaml"}


def test_the_page_lists_what_the_check_demands_of_each_autopilot() -> None:
    page = (ROOT / "docs" / "deploy.md").read_text(encoding="utf-8").split("<!-- demands -->")[1]
    rows = []
    for kind, build in ADAPTERS.items():
        adapter = build()
        for demand in adapter.parameter_checks:
            default = next(wanted.default for wanted in adapter.wanted if wanted.name == demand.name)
            when = " with `limits.fence`" if demand.when_fenced else " where it exists" if demand.when_told else ""
            words = demand.words(Told(demand.name, default, 1.0))
            rows.append(f"| `{kind}` | {demand.name} | {default:g} | {words}{when} | {demand.why} |")
    assert page.strip().splitlines()[2:] == rows
