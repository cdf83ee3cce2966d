"""The companion's configuration in a flight: the packaged one of its kind, with the flight's links and mission."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from companion.mission.model import Mission
from tests.real.kinds import Kind

DEPLOYED = Path(__file__).parents[2] / "companion" / "onboard" / "deploy"
BROADCAST_PORT = 14600
"""Port of agent 0's broadcast; each agent has the next one."""


def deployed(kind: Kind) -> dict[str, Any]:
    """Return the packaged configuration of a kind of autopilot."""
    content: dict[str, Any] = yaml.safe_load((DEPLOYED / f"{kind.name}.yaml").read_text(encoding="utf-8"))
    return content


def autopilot_link(kind: Kind, instance: int) -> str:
    """Return the companion's link to a program that runs as this instance."""
    if kind.firmware == "PX4":
        return f"udpin:127.0.0.1:{14540 + instance}"
    return f"tcp:127.0.0.1:{5760 + 10 * instance}"


def write_config(path: Path, kind: Kind, mission: Mission, ids: tuple[int, int], more: Mapping[str, Any]) -> None:
    """Write the configuration of an agent; `ids` are its own and its program's instance.

    `more` has keys that replace those of the packaged one, section by section.
    """
    agent_id, instance = ids
    folder = path.parent
    content = deployed(kind)
    content["agent_id"] = agent_id
    content["autopilot"] |= {"link": autopilot_link(kind, instance), "system_id": instance + 1}
    if "state_file" in content["autopilot"]:
        content["autopilot"]["state_file"] = str(folder / f"autopilot-{agent_id}.json")
    content["broadcast"] = {
        "link": f"udpin:127.0.0.1:{BROADCAST_PORT + agent_id}",
        "trust": "both",
        "mavlink_key": str(folder / "keys" / "broadcast.mavlink"),
        "public_key": str(folder / "keys" / "broadcast.public"),
        "state_file": str(folder / f"broadcast-{agent_id}.json"),
    }
    content["limits"] |= {"speed_m_s": mission.agents[0].speed_m_s, "wind_m_s": mission.wind.speed_m_s}
    content |= {
        "height_m": kind.height_m,
        "separation_m": mission.separation_m,
        "arrival_radius_m": mission.arrival_radius_m,
        "detector_range_m": mission.detector_range_m,
        "weights": mission.weights.model_dump(),
        "log_dir": str(folder / f"logs-{agent_id}"),
    }
    for key, value in more.items():
        content[key] = content[key] | value if isinstance(value, Mapping) and key in content else value
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
