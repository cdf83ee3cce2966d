"""The configuration of each vehicle of a fleet, made from mission and fleet file, so that nothing is copied by hand.

Speed, turn, range, height, separation, radii, weights, fence, exclusions and all else that the vehicles must share with
the ground station comes from the mission alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Any

from companion.autopilot.kinds import KINDS
from companion.errors import InputError
from companion.files.yaml import validated
from companion.guidance.settings import DEFAULT_LAW
from companion.mission.model import AgentSpec, Mission, agent_height_m
from companion.mission.places import Plane, Position
from companion.onboard.config import Config, TrustWord, config_for_agent
from companion.onboard.lint.fleet import abilities_of, speeds_instead
from companion.protocol.keys import MAVLINK_NAME, PUBLIC_NAME
from groundstation.fleet.file import Fleet, Vehicle, merged, vehicles_of
from groundstation.input_keys import vehicle_name

DEFAULTS = {
    "keys": "/etc/oneway-guidance/keys",
    "state": "/var/lib/oneway-guidance",
    "logs": "/var/log/oneway-guidance",
}
"""Folders on a vehicle's computer unless the fleet file names others: those of the service (docs/deploy.md)."""
MOST_SYSTEM_ID = 255
OWN_LIMITS = ("height_min_m", "height_max_m")
"""Limits that a vehicle may have of its own though a configuration made from a mission has them, too."""


@dataclass(frozen=True)
class Equipped:
    """A vehicle with its configuration."""

    vehicle: Vehicle
    config: Config
    keys: tuple[str, ...]
    """Names of the keys that its computer needs."""


def configs_of(mission: Mission, fleet: Fleet, trust: TrustWord, source: str) -> list[Equipped]:
    """Return the vehicles of a resolved mission with their configurations, in its order; errors name `source`.

    Raises:
        InputError: the fleet contradicts the mission, or a vehicle lacks what its configuration needs.

    """
    agents = {agent.id: agent for agent in mission.agents}
    vehicles = vehicles_of(fleet, agents, source)
    places = {vehicle.id: index for index, vehicle in enumerate(fleet.vehicles)}
    equipped = []
    for vehicle in vehicles:
        where = f"{source}: vehicles[{places[vehicle.id]}]"
        _check_same(vehicle, agents[vehicle.id], mission, where)
        _check_kind(vehicle, agents[vehicle.id], where)
        equipped.append(_equipped(vehicle, mission, trust, where))
    return equipped


def _check_same(vehicle: Vehicle, agent: AgentSpec, mission: Mission, where: str) -> None:
    """Raise InputError if a vehicle has other numbers, or another home, than the mission says."""
    said = {key: getattr(agent, key) for key in Vehicle.FROM_MISSION}
    said["height_m"] = agent_height_m(mission, agent.id)
    for key, value in said.items():
        given = getattr(vehicle, key)
        if given is not None and not math.isclose(given, value, rel_tol=1e-9):
            raise InputError(
                f"{where}.{key}: {given:g} for agent {agent.id}, of which the mission says {value:g}; allowed: the "
                "same, or nothing"
            )
    if vehicle.home is None:
        return
    home, start_m = vehicle.home, agent.position_ned_m
    if home.lat_deg is not None and home.lon_deg is not None:
        try:
            home_m = Plane(mission.origin).place_m(Position(home.lat_deg, home.lon_deg), f"{where}.home")
        except ValueError as error:
            raise InputError(str(error)) from error
    else:
        assert home.north_m is not None and home.east_m is not None
        home_m = (home.north_m, home.east_m)
    apart_m, most_m = math.dist(home_m, start_m), mission.separation_m / 2.0
    if apart_m > most_m:
        raise InputError(
            f"{where}.home: {apart_m:.0f} m from where the mission has agent {agent.id} start ({start_m[0]:.7g} m "
            f"north, {start_m[1]:.7g} m east); allowed: at most half of separation_m, {most_m:g} m"
        )


def _check_kind(vehicle: Vehicle, agent: AgentSpec, where: str) -> None:
    """Raise InputError if the vehicle's kind is not given, or does not fly the agent's speed."""
    if vehicle.kind is None:
        raise InputError(f"{where}.kind: missing; allowed: {', '.join(KINDS)}, there, under `all`, or as --autopilot")
    allowed = speeds_instead(agent.speed_m_s, abilities_of(vehicle.kind, ()))
    if allowed is not None:
        raise InputError(
            f"{where}.kind: '{vehicle.kind}' flies {allowed}, but the mission has agent {agent.id} fly speed_m_s "
            f"{agent.speed_m_s:g} m/s; allowed: a kind that flies it, or another speed in the mission"
        )


def _equipped(vehicle: Vehicle, mission: Mission, trust: TrustWord, where: str) -> Equipped:
    reports = mission.case == "II" and mission.report_period_s > 0.0
    needed = {"autopilot_link": "--autopilot-link URL", "broadcast_link": "--link URL"}
    if reports:
        needed["uplink"] = "--uplink URL"
    for key, option in needed.items():
        if getattr(vehicle, key) is None:
            raise InputError(f"{where}.{key}: missing; allowed: a link, there, under `all`, or as {option}")
    if vehicle.uplink is not None and not reports:
        raise InputError(
            f"{where}.uplink: '{vehicle.uplink}', but the mission has nobody report (case {mission.case}, "
            f"report_period_s {mission.report_period_s:g} s); allowed: none"
        )
    implied = config_for_agent(mission, vehicle.id, DEFAULT_LAW)
    own = _own_keys(vehicle, trust)
    _refuse_missions_keys(vehicle.config, implied, own, where)
    data = merged(merged(implied.model_dump(mode="json", exclude_none=True), own), vehicle.config)
    names = _key_names(vehicle, trust)
    return Equipped(vehicle, validated(Config, data, f"{where}, as a configuration"), names)


def _own_keys(vehicle: Vehicle, trust: TrustWord) -> dict[str, Any]:
    """Return the part of the configuration that the mission does not say."""
    keys, state, logs = (getattr(vehicle, key) or folder for key, folder in DEFAULTS.items())
    names = _key_names(vehicle, trust)
    autopilot: dict[str, Any] = {"kind": vehicle.kind, "link": vehicle.autopilot_link}
    system_id = vehicle.system_id or (vehicle.id if vehicle.id <= MOST_SYSTEM_ID else None)
    if system_id is not None:
        autopilot["system_id"] = system_id
    if vehicle.kind is not None and KINDS[vehicle.kind].resumes_on_stream:
        autopilot["state_file"] = _path(state, f"autopilot-{vehicle.id}.json")
    broadcast: dict[str, Any] = {"link": vehicle.broadcast_link, "trust": trust}
    for key, name in (("mavlink_key", MAVLINK_NAME), ("public_key", PUBLIC_NAME)):
        if name in names:
            broadcast[key] = _path(keys, name)
    if trust != "unsigned":
        broadcast["state_file"] = _path(state, f"broadcast-{vehicle.id}.json")
    data: dict[str, Any] = {"autopilot": autopilot, "broadcast": broadcast, "log_dir": logs}
    if vehicle.uplink is not None:
        signs = {} if trust == "unsigned" else {"key": _path(keys, vehicle_name(vehicle.id))}
        data["uplink"] = {"link": vehicle.uplink, **signs}
    return data


def _key_names(vehicle: Vehicle, trust: TrustWord) -> tuple[str, ...]:
    names = [MAVLINK_NAME] if trust in ("mavlink", "both") else []
    names += [PUBLIC_NAME] if trust in ("ed25519", "both") else []
    return tuple(names + ([vehicle_name(vehicle.id)] if vehicle.uplink is not None and trust != "unsigned" else []))


def _refuse_missions_keys(given: Mapping[str, Any], implied: Config, own: Mapping[str, Any], where: str) -> None:
    """Raise InputError if further keys of a configuration would change what mission or fleet file say."""
    for key, value in given.items():
        if key == "limits" and isinstance(value, Mapping):
            taken = set(implied.limits.model_fields_set) - set(OWN_LIMITS)
            _refuse_taken(value, taken, f"{where}.config.limits", "mission")
        elif isinstance(own.get(key), Mapping) and isinstance(value, Mapping):
            _refuse_taken(value, set(own[key]), f"{where}.config.{key}", "fleet file")
        else:
            _refuse_taken({key: value}, set(implied.model_fields_set), f"{where}.config", "mission")


def _refuse_taken(given: Mapping[str, Any], taken: Sequence[str] | set[str], where: str, by: str) -> None:
    for key in given:
        if key in taken:
            raise InputError(f"{where}.{key}: {given[key]!r:.60}, which the {by} says; allowed: change it there")


def _path(folder: str, name: str) -> str:
    return str(PurePosixPath(folder) / name)
