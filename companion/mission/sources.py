"""The mission's live sources: where sightings of agents, targets and threats come from, and what becomes of them.

The companion and the simulator only carry this section; the ground station reads it (docs/sources.md).
"""

from __future__ import annotations

from collections import Counter
from typing import Annotated, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from companion.files.yaml import ListOf, Section
from companion.mission.values import (
    MAX_KEY,
    MAX_NAME,
    MAX_THREAT_SPEED_M_S,
    RADII,
    Identity,
    Level,
    Speed,
    TypedName,
    refuse_no_band,
    refuse_not_nested,
)

MAX_SOURCES = 32
"""Greatest number of sources of a mission."""
MOST_THINGS = 2_000
"""Greatest number of things that one source may have taken in at once, as many as a mission lists."""

SourceKind = Literal["telemetry", "adsb", "basestation", "ais", "cot", "csv", "jsonl", "sensor"]
Role = Literal["agents", "targets", "threats"]
ROLE_OF: dict[SourceKind, Role] = {
    "telemetry": "agents",
    "adsb": "threats",
    "basestation": "threats",
    "ais": "threats",
    "cot": "threats",
    "csv": "threats",
    "jsonl": "threats",
}
"""What a source's things are taken for unless it says otherwise; a sensor's frames say it themselves."""
RECORDED = ("csv", "jsonl")
"""Kinds that are files and never links."""
FILED = ("basestation", "ais", "cot", "csv", "jsonl")
"""Kinds that can be played back from a file of their text; a telemetry log is the link file:PATH.tlog."""
GIVEN_RADII = ("radius_m", *RADII)
"""Keys of the radii of a source's threats: the first, or both others."""

_Key = Annotated[str, Field(min_length=1, max_length=MAX_KEY), TypedName]
_Radius = Annotated[float, Field(gt=0, le=1.0e6)]
_Time = Annotated[float, Field(gt=0, le=86_400)]


class SourceSpec(Section):
    """One source of sightings."""

    model_config = ConfigDict(serialize_by_alias=True)

    name: Annotated[str, Field(min_length=1, max_length=MAX_NAME), TypedName]
    kind: SourceKind
    url: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    """Link on which it is heard (docs/links.md)."""
    file: Annotated[str, Field(min_length=1, max_length=1_000)] | None = None
    """Recording that is played back instead."""
    play_speed: Annotated[float, Field(gt=0, le=1_000)] | None = 1.0
    """How many seconds of a recording pass in one second, from its beginning on; None: its times are Unix times."""
    role: Annotated[Role | None, Field(alias="as")] = None
    """What its things are; None: what things of its kind are."""
    radius_m: _Radius | None = None
    detection_radius_m: _Radius | None = None
    attack_radius_m: _Radius | None = None
    speed_bound_m_s: Speed | None = None
    """Greatest speed of its things; None: that of their category."""
    floor_m: Level | None = None
    ceiling_m: Level | None = None
    """Height above sea level from which, and up to which, its things count; None: at all heights."""
    ids: dict[_Key, Identity] = Field(default_factory=dict)
    """Id of an agent, target or threat by the source's key for it."""
    ignore: Annotated[ListOf[_Key], Field(max_length=MOST_THINGS)] = ()
    """Keys that are never taken in, such as the addresses of one's own aircraft."""
    timeout_s: _Time | None = None
    """Time without a sighting after which a thing is retired; None: by its category."""
    within_m: Annotated[float, Field(ge=0, le=1.0e6)] = 20_000.0
    """Distance from the mission up to which things are taken in."""
    error_m: Annotated[float, Field(gt=0, le=10_000)] | None = None
    """Greatest error of a sighting; None: by the source's kind."""
    most: Annotated[int, Field(ge=1, le=MOST_THINGS)] = 200
    """Greatest number of its things that are in the picture at once."""
    unsigned: bool = False
    """Whether what anybody on the network may have sent is believed."""

    @property
    def takes_in(self) -> bool:
        """Whether its things come into the picture that the mission does not have."""
        return self.kind != "sensor" or self.radius_m is not None or self.detection_radius_m is not None

    @property
    def things(self) -> Role:
        """What its things are."""
        return self.role or ROLE_OF.get(self.kind, "threats")

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if (self.url is None) == (self.file is None):
            raise ValueError("url: allowed: either url or file")
        if self.file is not None and self.kind not in FILED:
            raise ValueError(f"file: '{self.file}' with kind {self.kind}; allowed: url file:PATH.tlog for MAVLink")
        if self.url is not None and self.kind in RECORDED:
            raise ValueError(f"url: '{self.url}' with kind {self.kind}; allowed: file")
        return self

    @model_validator(mode="after")
    def _radii(self) -> Self:
        given = [key for key in GIVEN_RADII if getattr(self, key) is not None]
        if self.kind == "sensor":
            # Its frames name the mission's things; with radii, others are taken in as threats.
            if self.role is not None:
                raise ValueError("as: given for a sensor; allowed: radii, with which unknown things become threats")
            if not given:
                return self
        if self.things != "threats":
            if given:
                raise ValueError(f"{given[0]}: given for {self.things}; allowed: for threats only")
        elif given not in (["radius_m"], [*RADII]):
            raise ValueError(
                f"radius_m: {', '.join(given) or 'no radius'} given for threats; allowed: radius_m, or "
                "detection_radius_m and attack_radius_m"
            )
        return self

    @model_validator(mode="after")
    def _sensible(self) -> Self:
        refuse_no_band(self.floor_m, self.ceiling_m)
        if self.attack_radius_m is not None and self.detection_radius_m is not None:
            refuse_not_nested(self.attack_radius_m, self.detection_radius_m)
        bound_m_s = self.speed_bound_m_s
        if bound_m_s is not None and bound_m_s > MAX_THREAT_SPEED_M_S and self.things == "threats":
            raise ValueError(
                f"speed_bound_m_s: {bound_m_s:g} m/s for threats; allowed: at most {MAX_THREAT_SPEED_M_S:g} m/s"
            )
        given = Counter(self.ids.values())
        for key, identity in self.ids.items():
            if given[identity] > 1:
                raise ValueError(f"ids: {identity} is given to '{key}' and to another key; allowed: each id once")
            if key in self.ignore:
                raise ValueError(f"ignore: '{key}' has an id; allowed: either")
        return self


def refuse_same_names(sources: tuple[SourceSpec, ...]) -> None:
    """Raise ValueError if two sources have the same name."""
    for index, source in enumerate(sources):
        if source.name in [other.name for other in sources[:index]]:
            raise ValueError(f"sources[{index}]: name '{source.name}' is given twice; allowed: each name once")
