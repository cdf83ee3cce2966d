"""Where everything was when a run ended, as its last stored picture tells: a restart goes on from there.

Without it threats would grow from where the mission or a command has them, and agents that nobody sees would be
reckoned from their starts.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from companion.protocol.codec import Kind
from groundstation.origins import LAST_RUN, MISSION
from groundstation.sightings import Key
from groundstation.track import Track


@dataclass(frozen=True)
class Places:
    """Tracks, and what is known of agents beside them, at a time."""

    at_s: float
    """Time of the picture, Unix seconds."""
    tracks: Mapping[Key, Track] = field(default_factory=dict)
    known_at_s: Mapping[int, float] = field(default_factory=dict)
    """Time at which an agent's place was last known, by its id."""
    range_left_m: Mapping[int, float] = field(default_factory=dict)
    """Distance that an agent can still fly, by its id."""
    sources: Mapping[Key, str] = field(default_factory=dict)
    """Whose word the place of a target or threat is; of an agent, the mission's or that of the last run."""


def kept_places(picture: Mapping[str, Any]) -> Places:
    """Return the places in a picture that `view.picture` has made.

    Raises:
        KeyError, TypeError: it is no such picture.

    """
    at_s = float(picture["t_s"])
    tracks: dict[Key, Track] = {}
    sources: dict[Key, str] = {}
    for kind, things in ((Kind.TARGET, picture["targets"]), (Kind.THREAT, picture["threats"])):
        for thing in things:
            velocity = thing["velocity_north_m_s"], thing["velocity_east_m_s"]
            seen_at_s = at_s - thing["age_s"]
            sources[kind, thing["id"]] = thing["source"]
            tracks[kind, thing["id"]] = Track(thing["north_m"], thing["east_m"], *velocity, seen_at_s)
    for agent in picture["agents"]:
        heading_rad = math.radians(agent["heading_deg"] or 0.0)
        north_m_s, east_m_s = agent["speed_m_s"] * math.cos(heading_rad), agent["speed_m_s"] * math.sin(heading_rad)
        # A picture shows an agent where it is by then.
        tracks[Kind.AGENT, agent["id"]] = Track(agent["north_m"], agent["east_m"], north_m_s, east_m_s, at_s)
        sources[Kind.AGENT, agent["id"]] = MISSION if agent.get("source") == MISSION else LAST_RUN
    agents = picture["agents"]
    return Places(
        at_s=at_s,
        tracks=tracks,
        known_at_s={agent["id"]: at_s - agent["age_s"] for agent in agents},
        range_left_m={agent["id"]: agent["range_left_m"] for agent in agents},
        sources=sources,
    )
