"""`groundstation fleet`: a configuration for each vehicle from mission and fleet file, which do not contradict it."""

from __future__ import annotations

import stat
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from companion.errors import InputError
from companion.files.yaml import dump_yaml
from companion.mission.model import load_mission
from companion.mission.resolve import resolve
from companion.onboard.config import Config, config_for_agent, load_config
from companion.protocol.keys import load_mavlink_key, load_public
from groundstation.cli import cli
from groundstation.input_keys import vehicle_key, write_keys

MISSION = resolve(load_mission("copter-field"), 1)
ALL: dict[str, Any] = {
    "kind": "arducopter",
    "autopilot_link": "serial:/dev/ttyACM0:115200",
    "broadcast_link": "mcast:239.255.145.50:14600@10.0.0.{id}",
}
VEHICLES: list[dict[str, Any]] = [
    {
        "id": 1,
        "home": {"lat_deg": 47.39771, "lon_deg": 8.546},
        "speed_m_s": 5,
        "n_max": 0.17,
        "range_m": 6000,
        "height_m": 30,
    },
    {"id": 2, "kind": "px4-copter", "system_id": 7, "config": {"health": {"battery_return_percent": 40}}},
    {"id": 3, "config": {"limits": {"height_max_m": 90, "position_error_m": 2.5}}},
]


def run(folder: Path, *arguments: str, mission: str = "copter-field") -> Result:
    return CliRunner().invoke(cli, ["fleet", mission, "--out", str(folder / "out"), *arguments], standalone_mode=False)


def written(folder: Path, vehicle: int) -> Config:
    return load_config(str(folder / "out" / f"vehicle-{vehicle}" / f"{vehicle}.yaml"))


def with_file(folder: Path, data: object, *arguments: str) -> Result:
    (folder / "fleet.yaml").write_text(dump_yaml(data))
    return run(folder, "--fleet", str(folder / "fleet.yaml"), *(arguments or ("--unsigned",)))


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keys") / "keys"
    write_keys(folder, [])
    return folder


def test_whatever_the_mission_says_stands_in_each_configuration_as_the_simulator_flies_it(tmp_path: Path) -> None:
    assert with_file(tmp_path, {"all": ALL, "vehicles": VEHICLES}).exception is None
    for agent in MISSION.agents:
        implied = config_for_agent(MISSION, agent.id, "routed")
        config = written(tmp_path, agent.id)
        from_mission = implied.model_fields_set - {"limits"}
        assert config.model_dump(include=from_mission) == implied.model_dump(include=from_mission)
        limits = implied.limits.model_fields_set - {"height_max_m"}
        assert config.limits.model_dump(include=limits) == implied.limits.model_dump(include=limits)


def test_what_a_vehicle_says_of_itself_comes_before_what_all_have(tmp_path: Path) -> None:
    with_file(tmp_path, {"all": ALL, "vehicles": VEHICLES})
    first, second, third = (written(tmp_path, identity) for identity in (1, 2, 3))
    assert first.autopilot is not None and second.autopilot is not None and second.broadcast is not None
    assert (first.autopilot.kind, first.autopilot.system_id) == ("arducopter", 1)
    assert (second.autopilot.kind, second.autopilot.system_id) == ("px4-copter", 7)
    assert second.autopilot.state_file == "/var/lib/oneway-guidance/autopilot-2.json"
    assert second.broadcast.link == "mcast:239.255.145.50:14600@10.0.0.2"
    assert second.health.battery_return_percent == 40.0
    assert (third.limits.height_max_m, third.limits.position_error_m) == (90.0, 2.5)


def test_without_a_fleet_file_all_vehicles_are_alike(tmp_path: Path) -> None:
    given = (
        "--unsigned",
        "--autopilot",
        "arducopter",
        "--link",
        "udpin:0.0.0.0:14600",
        "--autopilot-link",
        "udpin:127.0.0.1:1454{id}",
    )
    assert run(tmp_path, *given).exception is None
    links = [config.autopilot.link for config in (written(tmp_path, one) for one in (1, 2, 3)) if config.autopilot]
    assert links == ["udpin:127.0.0.1:14541", "udpin:127.0.0.1:14542", "udpin:127.0.0.1:14543"]


def test_each_vehicle_gets_its_keys_and_never_the_ground_stations(tmp_path: Path, keys: Path) -> None:
    with_file(tmp_path, {"all": ALL, "vehicles": VEHICLES}, "--keys", str(keys))
    folder = tmp_path / "out" / "vehicle-2" / "keys"
    assert sorted(path.name for path in folder.iterdir()) == ["broadcast.mavlink", "broadcast.public"]
    assert load_public(folder / "broadcast.public") == load_public(keys / "broadcast.public")
    assert load_mavlink_key(folder / "broadcast.mavlink") == load_mavlink_key(keys / "broadcast.mavlink")
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    config = written(tmp_path, 2)
    assert config.broadcast is not None and config.broadcast.trust == "both"
    assert config.broadcast.mavlink_key == "/etc/oneway-guidance/keys/broadcast.mavlink"


def test_in_case_ii_each_vehicle_signs_its_reports_with_a_key_of_its_own(tmp_path: Path, keys: Path) -> None:
    mission = tmp_path / "unseen.yaml"
    mission.write_text(
        "draw: {agents: 2, targets: 1}\narea_m: {north: 3000, east: 3000}\ncase: II\nreport_period_s: 30\n"
        "defaults: {agent: {speed_m_s: 8}}\n"
    )
    given = (
        "--keys",
        str(keys),
        "--autopilot",
        "arducopter",
        "--link",
        "udpin:0.0.0.0:1",
        "--autopilot-link",
        "tcp:10.0.0.{id}:5760",
    )
    refused = run(tmp_path, *given, mission=str(mission)).exception
    assert (
        str(refused)
        == f"{mission}: vehicles[0].uplink: missing; allowed: a link, there, under `all`, or as --uplink URL"
    )
    run(tmp_path, *given, "--uplink", "udpout:10.0.0.100:14700", mission=str(mission))
    key = load_mavlink_key(tmp_path / "out" / "vehicle-2" / "keys" / "uplink-2.mavlink")
    assert key == vehicle_key(load_mavlink_key(keys / "uplink.mavlink"), 2)
    config = written(tmp_path, 2)
    assert config.uplink is not None and config.uplink.key == "/etc/oneway-guidance/keys/uplink-2.mavlink"


def test_written_again_configurations_are_replaced_and_keys_are_not(tmp_path: Path, keys: Path) -> None:
    with_file(tmp_path, {"all": ALL, "vehicles": VEHICLES}, "--keys", str(keys))
    changed = {**ALL, "logs": "/mnt/logs"}
    assert with_file(tmp_path, {"all": changed, "vehicles": VEHICLES}, "--keys", str(keys)).exception is None
    assert written(tmp_path, 1).log_dir == "/mnt/logs"
    write_keys(tmp_path / "others", [])
    refused = with_file(tmp_path, {"all": ALL, "vehicles": VEHICLES}, "--keys", str(tmp_path / "others")).exception
    assert "broadcast.public: is there already, with another key; a key is never overwritten" in str(refused)


def test_the_list_names_each_vehicle_its_files_and_what_to_type(tmp_path: Path, keys: Path) -> None:
    with_file(tmp_path, {"all": ALL, "vehicles": VEHICLES}, "--keys", str(keys))
    text = (tmp_path / "out" / "README.md").read_text()
    assert "| 2 | px4-copter | `serial:/dev/ttyACM0:115200` | `mcast:239.255.145.50:14600@10.0.0.2` | 5 m/s, " in text
    assert "install -o oneway -m 600 keys/broadcast.mavlink keys/broadcast.public /etc/oneway-guidance/keys/" in text
    assert "companion check /etc/oneway-guidance/3.yaml" in text


def changed(index: int, **values: object) -> list[dict[str, Any]]:
    return [{**vehicle, **values} if place == index else vehicle for place, vehicle in enumerate(VEHICLES)]


REFUSED: dict[str, tuple[Any, str]] = {
    "a missing id": (
        {"all": ALL, "vehicles": VEHICLES[:2]},
        "vehicles: none for agent 3, which the mission has; allowed: one",
    ),
    "a doubled id": (
        {"all": ALL, "vehicles": [*VEHICLES, VEHICLES[0]]},
        "vehicles[3].id: 1 is given twice, first as vehicles[0]; allowed: each id once",
    ),
    "a stranger": (
        {"all": ALL, "vehicles": changed(1, id=9)},
        "vehicles[1].id: 9 is no agent of the mission; allowed: 1, 2, 3",
    ),
    "another speed": (
        {"all": ALL, "vehicles": changed(0, speed_m_s=6)},
        "vehicles[0].speed_m_s: 6 for agent 1, of which the mission says 5; ",
    ),
    "another turn": (
        {"all": ALL, "vehicles": changed(1, n_max=0.2)},
        "vehicles[1].n_max: 0.2 for agent 2, of which the mission says 0.17; ",
    ),
    "another height": (
        {"all": ALL, "vehicles": changed(2, height_m=40)},
        "vehicles[2].height_m: 40 for agent 3, of which the mission says 30",
    ),
    "another home": (
        {"all": ALL, "vehicles": changed(0, home={"lat_deg": 47.3987, "lon_deg": 8.546})},
        "vehicles[0].home: 111 m from where the mission has agent 1 start",
    ),
    "half a home": (
        {"all": ALL, "vehicles": changed(0, home={"lat_deg": 47.3987})},
        "vehicles[0].home: lat_deg given; allowed: lat_deg and",
    ),
    "a home turned round": (
        {"all": ALL, "vehicles": changed(0, home={"lat_deg": 8.546, "lon_deg": 47.3977})},
        "were latitude and longitude exchanged?",
    ),
    "a kind that does not fly so": (
        {"all": ALL, "vehicles": changed(0, kind="px4-plane")},
        "vehicles[0].kind: 'px4-plane' flies 15 m/s, but the mission has agent 1 fly speed_m_s 5 m/s; allowed: a kind",
    ),
    "an unknown kind": (
        {"all": {**ALL, "kind": "arducoptor"}, "vehicles": VEHICLES},
        "all: kind: 'arducoptor'; did you mean 'arducopter'?",
    ),
    "no kind": (
        {"all": {**ALL, "kind": None}, "vehicles": VEHICLES},
        "vehicles[0].kind: missing; allowed: arducopter, ",
    ),
    "no autopilot": (
        {"all": {**ALL, "autopilot_link": None}, "vehicles": VEHICLES},
        "vehicles[0].autopilot_link: missing; allowed: a link",
    ),
    "a bad link": (
        {"all": {**ALL, "autopilot_link": "udp"}, "vehicles": VEHICLES},
        "vehicles[0], as a configuration: autopilot: ",
    ),
    "reports that nobody asks for": (
        {"all": {**ALL, "uplink": "udpout:10.0.0.1:1"}, "vehicles": VEHICLES},
        "vehicles[0].uplink: 'udpout:10.0.0.1:1', but the mission has nobody report (case I",
    ),
    "the mission's keys": (
        {"all": {**ALL, "config": {"separation_m": 3}}, "vehicles": VEHICLES},
        "vehicles[0].config.separation_m: 3, which the mission says; allowed: change it there",
    ),
    "the mission's limits": (
        {"all": ALL, "vehicles": changed(1, config={"limits": {"speed_m_s": 3}})},
        "vehicles[1].config.limits.speed_m_s: 3, which the mission says",
    ),
    "the file's own keys": (
        {"all": ALL, "vehicles": changed(1, config={"broadcast": {"trust": "both"}})},
        "vehicles[1].config.broadcast.trust: 'both', which the fleet file says",
    ),
    "an unknown key of a configuration": (
        {"all": ALL, "vehicles": changed(1, config={"healt": {}})},
        "vehicles[1], as a configuration: unknown key 'healt'; did you mean 'health'?",
    ),
    "nobody": ({"all": ALL, "vehicles": []}, "vehicles: 0 given; allowed: at least 1"),
    "an unknown key": ({"all": ALL, "vehicles": [{"id": 1, "link": "x"}]}, "vehicles[0]: unknown key 'link'"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_fleet_that_contradicts_the_mission_or_lacks_something_is_refused_on_one_line(
    name: str, tmp_path: Path
) -> None:
    data, said = REFUSED[name]
    refused = with_file(tmp_path, data).exception
    assert isinstance(refused, InputError), refused
    assert said in str(refused) and "\n" not in str(refused)
    assert str(refused).startswith(f"{tmp_path / 'fleet.yaml'}: ")


def test_a_configuration_that_contains_itself_is_refused(tmp_path: Path) -> None:
    (tmp_path / "fleet.yaml").write_text("all: {config: &a {health: *a}}\nvehicles: [{id: 1}, {id: 2}, {id: 3}]\n")
    refused = run(tmp_path, "--fleet", str(tmp_path / "fleet.yaml"), "--unsigned").exception
    assert str(refused).endswith("config: an alias that contains itself; allowed: keys of a configuration")


def test_the_id_stands_for_itself_in_every_text(tmp_path: Path) -> None:
    all_have = {**ALL, "logs": "/logs/{id}", "config": {"status": {"period_s": 7}, "logs": {"most_mb": 30}}}
    with_file(tmp_path, {"all": all_have, "vehicles": VEHICLES})
    assert (written(tmp_path, 3).log_dir, written(tmp_path, 3).status.period_s) == ("/logs/3", 7.0)


def test_keys_or_the_word_unsigned_must_be_given(tmp_path: Path) -> None:
    assert "neither --keys nor --unsigned given" in str(run(tmp_path, "--autopilot", "arducopter").exception)
