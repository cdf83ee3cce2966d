"""Keys of the ground station's inputs: one that all sensors share, and one of each vehicle for its reports.

A vehicle's key is made from the uplink's, which never leaves the ground station, and the vehicle's agent id. So whoever
takes a vehicle can report for that one alone.
"""

from __future__ import annotations

import hmac
import os
from collections.abc import Iterable
from pathlib import Path

from companion.errors import InputError
from companion.mission.model import Mission
from companion.protocol.keys import PRIVATE_NAME, add_mavlink_keys, keygen, load_mavlink_key
from companion.protocol.mavlink_signing import KEY_BYTES
from companion.transport.endpoints import Link
from groundstation.inputs import InputTrust, sensor_trust, uplink_trust
from groundstation.options import Options

SENSOR_NAME = "sensor.mavlink"
"""Name of the key of all sensors."""
UPLINK_NAME = "uplink.mavlink"
"""Name of the key that the vehicles' keys are made from."""
_GREATEST_ID = 65_535
"""Greatest id of an agent."""
_MOST_AGENTS = 1_000
"""Greatest number of keys that one call makes."""


def vehicle_name(agent_id: int) -> str:
    """Return the name of the key with which a vehicle signs its reports."""
    return f"uplink-{agent_id}.mavlink"


def vehicle_key(uplink_key: bytes, agent_id: int) -> bytes:
    """Return the 32 bytes of the key with which a vehicle signs its reports."""
    return hmac.digest(uplink_key, f"oneway report of agent {agent_id}".encode(), "sha256")


def write_keys(folder: Path, agents: Iterable[int]) -> list[Path]:
    """Make the keys of a fleet, or add what a folder of keys lacks for `agents`; return the paths that were written.

    Raises:
        InputError: keys are there and `agents` is empty, or a key cannot be read or written.

    """
    wanted = list(agents)
    is_new = not wanted or not (folder / PRIVATE_NAME).exists()
    written = keygen(folder) if is_new else []
    written += add_mavlink_keys(folder, {name: os.urandom(KEY_BYTES) for name in (SENSOR_NAME, UPLINK_NAME)})
    if wanted:
        uplink_key = load_mavlink_key(folder / UPLINK_NAME)
        written += add_mavlink_keys(folder, {vehicle_name(one): vehicle_key(uplink_key, one) for one in wanted})
    return written


def agents_from(text: str) -> list[int]:
    """Return the agent ids in a text such as `1-10,12`.

    Raises:
        InputError: the text names no agents.

    """
    agents: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        ends = (first, last) if dash else (first, first)
        if not all(end.isascii() and end.isdecimal() and len(end) <= 5 for end in ends):
            raise _no_agents(text)
        agents += range(int(ends[0]), min(int(ends[1]), int(ends[0]) + _MOST_AGENTS) + 1)
    if not agents or len(agents) > _MOST_AGENTS or min(agents) < 1 or max(agents) > _GREATEST_ID:
        raise _no_agents(text)
    return agents


def input_trusts(options: Options, mission: Mission) -> tuple[InputTrust, InputTrust]:
    """Return whom the sensor's and the uplink's link believe.

    Raises:
        InputError: a key that is needed is missing or cannot be used.

    """
    sensor_key = _key(options, options.sensor, SENSOR_NAME)
    uplink_key = _key(options, options.uplink, UPLINK_NAME)
    agents = {} if uplink_key is None else {one.id: vehicle_key(uplink_key, one.id) for one in mission.agents}
    return (
        sensor_trust(sensor_key, options.believes_unsigned(options.sensor)),
        uplink_trust(agents, options.believes_unsigned(options.uplink)),
    )


def _key(options: Options, link: Link | None, name: str) -> bytes | None:
    """Return the key of an input; None if it has none and needs none."""
    if link is None or options.keys is None:
        return None
    path = options.keys / name
    if options.believes_unsigned(link) and not path.exists():
        return None
    if not path.exists():
        raise InputError(
            f"{path}: is not there, so that nothing on '{link}' could be believed; allowed: the key that "
            f"`groundstation keygen {options.keys} --agents IDS` adds, or --unsigned-inputs"
        )
    return load_mavlink_key(path)


def _no_agents(text: str) -> InputError:
    return InputError(f"--agents: '{text[:40]}'; allowed: ids from 1 to {_GREATEST_ID} such as 1-10,12")
