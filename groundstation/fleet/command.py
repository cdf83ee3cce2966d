"""The arguments of `groundstation fleet`: what they add to the fleet file, and the folder that is written by them."""

from __future__ import annotations

from pathlib import Path
from typing import TypedDict

from companion.autopilot.kinds import KINDS
from companion.autopilot.missions import load_mission_to_fly
from companion.mission.resolve import resolve
from groundstation.choices import one_of, without_null
from groundstation.fleet.configs import configs_of
from groundstation.fleet.file import Fleet, Installation, Vehicle, load_fleet
from groundstation.fleet.folder import Sources, write_fleet
from groundstation.ground_station import check_runnable
from groundstation.options import authentication_of, refuse_monolithic


class FleetArguments(TypedDict):
    """Arguments of the command line as they were typed; None for one that was left out."""

    mission: str
    out: str
    fleet: str | None
    keys: str | None
    unsigned: bool
    auth: str | None
    link: str | None
    autopilot: str | None
    autopilot_link: str | None
    uplink: str | None
    seed: int


def write(given: FleetArguments) -> list[Path]:
    """Write the folder of a fleet and return the paths of its files, keys left out.

    Raises:
        InputError: an argument, the mission, the fleet file or a key cannot be used, or they contradict each other.

    """
    without_null(
        {"MISSION": given["mission"], "--out": given["out"], "--fleet": given["fleet"], "--keys": given["keys"]}
    )
    if given["autopilot"] is not None:
        one_of("--autopilot", given["autopilot"], tuple(KINDS))
    trust = authentication_of(given["keys"], given["unsigned"], given["auth"])
    mission = resolve(load_mission_to_fly(given["mission"]), given["seed"], given["mission"])
    check_runnable(mission, given["mission"])
    refuse_monolithic(mission, given["mission"])
    if given["fleet"] is None:
        fleet, source = Fleet(vehicles=tuple(Vehicle(id=agent.id) for agent in mission.agents)), given["mission"]
    else:
        fleet, source = load_fleet(given["fleet"]), given["fleet"]
    said = {
        "kind": given["autopilot"],
        "autopilot_link": given["autopilot_link"],
        "broadcast_link": given["link"],
        "uplink": given["uplink"],
    }
    others = Installation.model_validate({**said, **fleet.all.model_dump(exclude_none=True)})
    equipped = configs_of(mission, fleet.model_copy(update={"all": others}), trust, source)
    sources = Sources(given["mission"], given["fleet"], given["keys"])
    return write_fleet(Path(given["out"]), mission, equipped, sources)
