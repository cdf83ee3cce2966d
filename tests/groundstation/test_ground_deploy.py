"""What the ground station is set up with as a service: the unit, the image and the file that starts everything."""

from __future__ import annotations

import configparser
import math
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest
import yaml

from companion.geo.local_frame import LocalFrame
from companion.mission.model import load_mission
from companion.transport.endpoints import parse_link
from groundstation.cli import run
from groundstation.service import LAST_S
from groundstation.web.address import parse_address
from sim.vehicle_service import vehicle
from tests.groundstation.compose_by_hand import DEPLOY, PAGE, commands

MISSION = load_mission(DEPLOY / "demo" / "mission.yaml")
COMMANDS = commands(Path("/scratch"))


def _unit() -> configparser.SectionProxy:
    unit = configparser.ConfigParser(strict=False, interpolation=None)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read_string((DEPLOY / "groundstation.service").read_text())
    return unit["Service"]


def _options(name: str) -> dict[str, Any]:
    """Return the options of a service's command, as the program itself reads them."""
    program, command, *words = COMMANDS[name][2:]
    found = {"groundstation run": run, "sim vehicle": vehicle}[f"{program} {command}"]
    return found.make_context(command, words).params


def test_the_unit_restarts_a_hung_ground_station_and_lets_a_stopped_one_say_so() -> None:
    service = _unit()
    assert (service["Type"], service["Restart"]) == ("notify", "always")
    assert float(service["TimeoutStopSec"]) > LAST_S + 3.0
    assert service["KillMode"] == "mixed"
    assert service["ProtectSystem"] == "strict"
    assert service["CapabilityBoundingSet"] == ""


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here")
def test_systemd_takes_the_unit_and_finds_it_little_exposed() -> None:
    path = str(DEPLOY / "groundstation.service")
    command = ["systemd-analyze", "security", "--offline=true", "--threshold=25", path]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-300:] + done.stderr
    said = subprocess.run(["systemd-analyze", "verify", path], capture_output=True, text=True, check=False).stderr
    assert all("is not executable" in line for line in said.splitlines() if "groundstation.service" in line), said


def test_the_compose_file_starts_three_stand_ins_each_where_the_mission_has_its_agent() -> None:
    frame = LocalFrame(MISSION.origin.lat_deg, MISSION.origin.lon_deg)
    for agent in MISSION.agents:
        options = _options(f"stand-in-{agent.id}")
        assert options["system_id"] == agent.id
        assert options["speed_m_s"] == agent.speed_m_s
        assert math.dist(frame.to_local(options["lat_deg"], options["lon_deg"]), agent.position_ned_m) < 1.0


def test_what_the_compose_file_connects_fits_the_fleet_file() -> None:
    fleet = yaml.safe_load((DEPLOY / "demo" / "fleet.yaml").read_text())
    ground = _options("groundstation")
    assert ground["link"] == fleet["all"]["broadcast_link"]
    for one in fleet["vehicles"]:
        options = _options(f"stand-in-{one['id']}")
        heard = parse_link(fleet["all"]["autopilot_link"].replace("{id}", str(one["id"])))
        assert [link.port for link in options["links"]] == [heard.port]
        assert parse_link(str(options["sensor"])).port == parse_link(str(ground["sensor"])).port
        assert COMMANDS[f"companion-{one['id']}"][-1].endswith(f"vehicle-{one['id']}/{one['id']}.yaml")


def test_the_page_of_the_compose_file_is_on_the_loopback_address_where_its_health_is_asked_for() -> None:
    address = parse_address(str(_options("groundstation")["ui"]))
    assert address.is_loopback
    assert f"http://{address}" == PAGE
    for name in ("compose.yaml", "Containerfile"):
        assert f"{PAGE}/healthz" in (DEPLOY / name).read_text()


def test_every_service_of_the_compose_file_is_confined() -> None:
    for name, service in yaml.safe_load((DEPLOY / "compose.yaml").read_text())["services"].items():
        assert service["read_only"], name
        assert service["cap_drop"] == ["ALL"], name
        assert "privileged" not in service, name
