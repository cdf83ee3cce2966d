"""The files that the pages show are files that the programs take."""

from __future__ import annotations

import re
from pathlib import Path

from companion.files.yaml import parse_yaml, validated
from companion.mission.model import load_mission, parse_mission
from companion.mission.resolve import resolve
from groundstation.fleet.configs import configs_of
from groundstation.fleet.file import Fleet

DOCS = Path(__file__).parents[2] / "docs"


def shown(page: str, begins: str) -> str:
    """Return the YAML block of a page that begins with these words."""
    found = re.search(rf"```yaml\n({begins}.*?)```", (DOCS / page).read_text(), re.DOTALL)
    assert found is not None
    return found.group(1)


def test_the_mission_on_its_page_can_be_flown() -> None:
    assert resolve(parse_mission(shown("mission.md", "name: my-survey"), "docs/mission.md"), 1).resolved


def test_the_fleet_on_its_page_is_that_of_the_packaged_mission() -> None:
    fleet = validated(Fleet, parse_yaml(shown("fleet.md", "all:"), "docs/fleet.md"), "docs/fleet.md")
    mission = resolve(load_mission("copter-field"), 1)
    assert [one.config.agent_id for one in configs_of(mission, fleet, "both", "docs/fleet.md")] == [1, 2, 3]
