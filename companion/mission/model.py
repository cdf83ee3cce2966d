"""The mission file: one YAML document that all three programs read, check, resolve and write back.

A mission is validated as a whole when it is loaded. Whatever it leaves to chance (counts under `draw`, positions or
headings left out) is drawn from a seed by `resolve`, after which everything is listed and the start is checked for
legality. Every fault is an InputError on one line naming file, key, value and what is allowed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Discriminator, Field, Tag, ValidationError, model_validator

from companion.errors import InputError, nearest_hint
from companion.files.yaml import ListOf, Section, dump_yaml, is_there, parse_yaml, read_text_file, validated
from companion.mission.places import IN_DEGREES, Origin
from companion.mission.sources import MAX_SOURCES, SourceSpec, refuse_same_names
from companion.mission.values import (
    MAX_COORDINATE_M,
    MAX_HEIGHT_M,
    MAX_ITEMS,
    MAX_KEY,
    MAX_STEPS,
    MOVING_SPEED_BOUND_M_S,
    Coordinate,
    Count,
    Degrees,
    DetectorName,
    Height,
    Identity,
    Level,
    NotNegative,
    PathPoint,
    Period,
    Polygon,
    Positive,
    Probability,
    Speed,
    SpeedBound,
    Step,
    SwitchingShare,
    ThreatSpeedBound,
    TypedName,
    refuse_no_band,
    refuse_not_nested,
)
from companion.mission.written import as_modelled, with_defaults


class Area(Section):
    """Size in metres of the box in which places are drawn; the origin is its south-west corner."""

    north: Annotated[float, Field(gt=0, le=MAX_COORDINATE_M)] = 200_000.0
    east: Annotated[float, Field(gt=0, le=MAX_COORDINATE_M)] = 200_000.0


class SteadyMotion(Section):
    """Motion along a straight line at constant speed."""

    heading_deg: Degrees
    speed_m_s: SpeedBound


class PathMotion(Section):
    """Motion along way points [t_s, north_m, east_m], in order of time, with straight lines between them."""

    path: Annotated[ListOf[PathPoint], Field(min_length=1, max_length=MAX_ITEMS)]

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        times_s = [point[0] for point in self.path]
        if any(later <= earlier for earlier, later in zip(times_s, times_s[1:], strict=False)):
            raise ValueError("path: times must increase from point to point")
        return self


def _motion_kind(value: object) -> str:
    if isinstance(value, PathMotion) or (isinstance(value, Mapping) and "path" in value):
        return "kind:path"
    return "kind:steady" if isinstance(value, Mapping | SteadyMotion) else "kind:word"


Motion = Annotated[
    Annotated[Literal["static", "random"], Tag("kind:word")]
    | Annotated[SteadyMotion, Tag("kind:steady")]
    | Annotated[PathMotion, Tag("kind:path")],
    Discriminator(_motion_kind),
]


ThreatMotion = Annotated[
    Annotated[Literal["static", "random", "chase"], Tag("kind:word")]
    | Annotated[SteadyMotion, Tag("kind:steady")]
    | Annotated[PathMotion, Tag("kind:path")],
    Discriminator(_motion_kind),
]


class AgentSpec(Section):
    """A vehicle under guidance; a position or heading that is left out is drawn."""

    converted: ClassVar[tuple[str, ...]] = IN_DEGREES

    id: Identity
    north_m: Coordinate | None = None
    east_m: Coordinate | None = None
    heading_deg: Degrees | None = None
    speed_m_s: Speed = 60.0
    n_max: Annotated[float, Field(gt=0, le=100)] = 10.0
    range_m: Positive = 500_000.0
    height_m: Height = 30.0
    only_target: Identity | None = None
    """Id of the only target that the ground station may assign to the agent; None: it may assign any."""

    @property
    def position_ned_m(self) -> tuple[float, float]:
        """Position (north, east) of a resolved agent."""
        return _located(self.north_m, self.east_m)

    @model_validator(mode="after")
    def _wholly_placed(self) -> Self:
        _refuse_half_a_place(self.north_m, self.east_m)
        return self


class _Moving(Section):
    converted: ClassVar[tuple[str, ...]] = IN_DEGREES

    id: Identity
    north_m: Coordinate | None = None
    east_m: Coordinate | None = None
    speed_bound_m_s: SpeedBound = 0.0
    motion: ThreatMotion = "static"

    @model_validator(mode="before")
    @classmethod
    def _bounded(cls, data: object) -> object:
        if not isinstance(data, Mapping) or "speed_bound_m_s" in data or data.get("motion", "static") == "static":
            return data
        return {**data, "speed_bound_m_s": MOVING_SPEED_BOUND_M_S}

    @property
    def position_ned_m(self) -> tuple[float, float]:
        """Position (north, east) of a resolved target or threat."""
        return _located(self.north_m, self.east_m)

    @model_validator(mode="after")
    def _within_bound(self) -> Self:
        _refuse_half_a_place(self.north_m, self.east_m)
        if isinstance(self.motion, PathMotion) and self.north_m is not None and self.motion.path[0][0] == 0:
            if (self.north_m, self.east_m) != self.motion.path[0][1:]:
                raise ValueError("motion.path: starts elsewhere than north_m, east_m; allowed: the same point")
        speed_m_s = _greatest_speed_m_s(self.motion, self.north_m, self.east_m)
        if speed_m_s > self.speed_bound_m_s + 1e-9:
            raise ValueError(
                f"motion: {speed_m_s:g} m/s is faster than speed_bound_m_s {self.speed_bound_m_s:g} m/s; "
                "allowed: at most the bound"
            )
        return self


class TargetSpec(_Moving):
    """A place to reach, which may move; the broadcast says where it is, never where it will be."""

    motion: Motion = "static"


class ThreatSpec(_Moving):
    """A keep-out disc, which may move; with the motion `chase` the simulator flies it at the nearest agent."""

    converted: ClassVar[tuple[str, ...]] = (*IN_DEGREES, "radius_m")

    detection_radius_m: Positive
    attack_radius_m: Positive
    speed_bound_m_s: ThreatSpeedBound = 0.0
    motion: ThreatMotion = "static"
    floor_m: Level | None = None
    ceiling_m: Level | None = None

    @model_validator(mode="after")
    def _a_band(self) -> Self:
        refuse_no_band(self.floor_m, self.ceiling_m)
        return self

    @model_validator(mode="after")
    def _nested(self) -> Self:
        refuse_not_nested(self.attack_radius_m, self.detection_radius_m)
        return self


class Draw(Section):
    """How many agents, targets and threats are drawn in addition to the listed ones."""

    agents: Count = 0
    targets: Count = 0
    threats: Count = 0


class AgentDefaults(Section):
    """Values of the keys that an agent leaves out."""

    heading_deg: Degrees | None = None
    speed_m_s: Speed | None = None
    n_max: Annotated[float, Field(gt=0, le=100)] | None = None
    range_m: Positive | None = None
    height_m: Height | None = None


class TargetDefaults(Section):
    """Values of the keys that a target leaves out."""

    speed_bound_m_s: SpeedBound | None = None
    motion: Motion | None = None


class ThreatDefaults(Section):
    """Values of the keys that a threat leaves out."""

    converted: ClassVar[tuple[str, ...]] = ("radius_m",)

    detection_radius_m: Positive | None = None
    attack_radius_m: Positive | None = None
    speed_bound_m_s: ThreatSpeedBound | None = None
    motion: ThreatMotion | None = None
    floor_m: Level | None = None
    ceiling_m: Level | None = None


class Defaults(Section):
    """Default values of agents, targets and threats, for drawn and listed ones alike."""

    agent: AgentDefaults = AgentDefaults()
    target: TargetDefaults = TargetDefaults()
    threat: ThreatDefaults = ThreatDefaults()


class CostWeights(Section):
    """Penalties k_d, k_a, k_c and k_l of the paper's cost, in m^2 (paper: 1e5 and 1e4 km^2)."""

    k_d: NotNegative = 1.0e11
    k_a: NotNegative = 1.0e11
    k_c: NotNegative = 1.0e10
    k_l: NotNegative = 1.0e10


class Burst(Section):
    """Bursts of lost frames (Gilbert-Elliott): chances per frame to go bad and good again, and of loss while bad."""

    enter: Probability
    leave: Annotated[float, Field(gt=0, le=1)]
    loss: Probability = 1.0


class LinkSpec(Section):
    """What the simulated broadcast link does to each frame on its way to each vehicle."""

    loss: Probability = 0.0
    burst: Burst | None = None
    delay_s: NotNegative = 0.1
    jitter_s: NotNegative = 0.0
    duplicate: Probability = 0.0
    reorder: Probability = 0.0


class Wind(Section):
    """Mean wind, from a direction clockwise from north, and the greatest speed that gusts add to it."""

    from_deg: Degrees = 270.0
    speed_m_s: NotNegative = 0.0
    gust_m_s: NotNegative = 0.0


class Loss(Section):
    """An agent that breaks down at a given time."""

    agent: Identity
    t_s: NotNegative


class Scale(Section):
    """The factor by which lengths and speeds of a mission were multiplied so that a kind of autopilot can fly it."""

    autopilot: str
    """Name of the kind; the programs that fly the mission check that they know it."""
    factor: Annotated[float, Field(gt=0, le=100)]


class Mission(Section):
    """A whole mission, as in the file. Units are in the names; metres and seconds where a name has none."""

    name: Annotated[str, Field(min_length=1, max_length=MAX_KEY), TypedName] = "mission"
    origin: Origin = Origin()
    area_m: Area = Area()
    fence: Polygon | None = None
    """Polygon, of corners (north, east), that agents stay inside."""
    exclusions: Annotated[ListOf[Polygon], Field(max_length=MAX_ITEMS)] = ()
    """Polygons that agents stay outside of, at all heights."""
    agents: Annotated[ListOf[AgentSpec], Field(max_length=MAX_ITEMS)] = ()
    targets: Annotated[ListOf[TargetSpec], Field(max_length=MAX_ITEMS)] = ()
    threats: Annotated[ListOf[ThreatSpec], Field(max_length=MAX_ITEMS)] = ()
    draw: Draw = Draw()
    defaults: Defaults = Defaults()
    weights: CostWeights = CostWeights()
    guidance_step_s: Step = 0.5
    integration_step_s: Step = 0.5
    broadcast_period_s: Period = 5.0
    assignment_period_s: Period = 25.0
    arrival_radius_m: Positive = 300.0
    separation_m: Positive = 100.0
    detector: DetectorName = "adsb"
    """Which sense of one another the agents have: an ADS-B receiver each, the broadcast's word alone, or none."""
    detector_range_m: NotNegative = 2_000.0
    heading_hold_s: Period = 5.0
    lost_after_s: Positive = 30.0
    report_period_s: NotNegative = 0.0
    case: Literal["I", "II"] = "I"
    range_policy: Literal["return", "arrive"] = "return"
    objective: Literal["distance", "inverse-distance", "route", "latest"] = "distance"
    switching_share: SwitchingShare | None = None
    """Share of the cost that agents must save to change targets; None: the ground station's default for `objective`."""
    layers: Annotated[int, Field(ge=1, le=MAX_ITEMS)] = 1
    layer_spacing_m: Annotated[float, Field(ge=0, le=MAX_HEIGHT_M)] = 0.0
    surrogate: Literal["pairwise", "analytic", "monolithic"] = "pairwise"
    link: LinkSpec = LinkSpec()
    wind: Wind = Wind()
    queue: bool = False
    """Whether there may be more targets than agents: who has arrived then takes the next one."""
    losses: Annotated[ListOf[Loss], Field(max_length=MAX_ITEMS)] = ()
    max_time_s: Positive = 20_000.0
    sources: Annotated[ListOf[SourceSpec], Field(max_length=MAX_SOURCES)] = ()
    """Live sources of sightings, which only the ground station hears."""
    scale: Scale | None = None
    """How the mission was scaled for a kind of autopilot; None: it is as it was written."""

    @model_validator(mode="before")
    @classmethod
    def _as_modelled(cls, data: object) -> object:
        if not isinstance(data, Mapping) or not data.keys() <= cls.model_fields.keys():
            return data
        changed = data
        try:
            changed = as_modelled(data)
            defaults = Defaults.model_validate(changed.get("defaults", {}))
        except ValidationError:
            return changed  # the field's own validation reports it, under its full name
        for key, part in (("agents", defaults.agent), ("targets", defaults.target), ("threats", defaults.threat)):
            given = part.model_dump(exclude_none=True)
            items = changed.get(key)
            if isinstance(items, Sequence) and not isinstance(items, str):
                changed[key] = [with_defaults(item, given) for item in items]
        return changed

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for key, items in (("agents", self.agents), ("targets", self.targets), ("threats", self.threats)):
            _refuse_duplicates(key, [item.id for item in items])
        _refuse_duplicates("losses", [loss.agent for loss in self.losses])
        refuse_same_names(self.sources)
        number_of_agents = len(self.agents) + self.draw.agents
        number_of_targets = len(self.targets) + self.draw.targets
        if number_of_agents < 1:
            raise ValueError("agents: none; allowed: at least one, listed or under draw")
        if number_of_targets < 1:
            raise ValueError("targets: none; allowed: at least one, listed or under draw")
        if number_of_targets > number_of_agents and not self.queue:
            raise ValueError(
                f"targets: {number_of_targets} with agents: {number_of_agents}; allowed: no more targets than agents, "
                "or `queue: true`"
            )
        listed = {target.id for target in self.targets}
        for index, agent in enumerate(self.agents):
            if agent.only_target is not None and agent.only_target not in listed:
                raise ValueError(
                    f"agents[{index}].only_target: {agent.only_target}; allowed: the id of a listed target"
                )
        if self.draw.threats:
            for radius in ("detection_radius_m", "attack_radius_m"):
                if getattr(self.defaults.threat, radius) is None:
                    raise ValueError(f"draw.threats: {self.draw.threats}; allowed: only with defaults.threat.{radius}")
        self._refuse_bad_defaults()
        self._refuse_bad_layers()
        if self.max_time_s / self.integration_step_s > MAX_STEPS:
            raise ValueError(
                f"max_time_s: {self.max_time_s:g} s; allowed: at most {MAX_STEPS} times integration_step_s "
                f"{self.integration_step_s:g} s"
            )
        ratio = self.guidance_step_s / self.integration_step_s
        if round(ratio) < 1 or not math.isclose(ratio, round(ratio), rel_tol=1e-9):
            raise ValueError(
                f"guidance_step_s: {self.guidance_step_s:g} s; allowed: a whole multiple of integration_step_s "
                f"{self.integration_step_s:g} s"
            )
        return self

    def _refuse_bad_layers(self) -> None:
        if (self.layers > 1) != (self.layer_spacing_m > 0.0):
            raise ValueError(
                f"layers: {self.layers} with layer_spacing_m {self.layer_spacing_m:g} m; allowed: neither, or at least "
                "2 layers with a spacing"
            )
        given = self.defaults.agent.model_dump(include={"height_m"}, exclude_none=True)
        drawn = [AgentSpec(id=1, **given)] if self.draw.agents else []
        top_m = max(agent.height_m for agent in (*self.agents, *drawn)) + (self.layers - 1) * self.layer_spacing_m
        if top_m > MAX_HEIGHT_M:
            raise ValueError(
                f"layer_spacing_m: {self.layer_spacing_m:g} m puts an agent at {top_m:g} m; allowed: at most "
                f"{MAX_HEIGHT_M:g}"
            )

    def _refuse_bad_defaults(self) -> None:
        """Raise ValueError if the defaults, each legal by itself, together make a target or threat that is illegal."""
        drawn: tuple[tuple[str, int, type[_Moving], Section], ...] = (
            ("target", self.draw.targets, TargetSpec, self.defaults.target),
            ("threat", self.draw.threats, ThreatSpec, self.defaults.threat),
        )
        for kind, count, spec, defaults in drawn:
            if count:
                try:
                    spec(id=1, **defaults.model_dump(exclude_none=True))
                except ValidationError as error:
                    message = error.errors()[0]["msg"].removeprefix("Value error, ")
                    raise ValueError(f"defaults.{kind}.{message}") from error

    @property
    def resolved(self) -> bool:
        """Whether nothing is left to draw: all items are listed with their places, and agents with their headings."""
        return (
            self.draw == Draw()
            and all(agent.heading_deg is not None for agent in self.agents)
            and all(item.north_m is not None and item.east_m is not None for item in self._placed())
        )

    def _placed(self) -> tuple[AgentSpec | TargetSpec | ThreatSpec, ...]:
        return (*self.agents, *self.targets, *self.threats)


def agent_height_m(mission: Mission, agent_id: int) -> float:
    """Return the height above the origin's altitude at which an agent flies: its `height_m` and its layer's on top.

    Agents are assigned to the layers in turn, in file order.

    Raises:
        ValueError: the mission lists no such agent.

    """
    for index, agent in enumerate(mission.agents):
        if agent.id == agent_id:
            return agent.height_m + mission.layer_spacing_m * (index % mission.layers)
    raise ValueError(f"agent {agent_id} is not in mission {mission.name}")


def packaged_missions() -> tuple[str, ...]:
    """Return the names of the missions that ship with the project."""
    folder = resources.files("companion.mission") / "missions"
    return tuple(sorted(entry.name.removesuffix(".yaml") for entry in folder.iterdir() if entry.name.endswith(".yaml")))


def load_mission(name_or_path: str | Path) -> Mission:
    """Load a mission by its packaged name or from a YAML file.

    Raises:
        InputError: the file cannot be read, is not YAML, or breaks a rule of the mission file.

    """
    text = str(name_or_path)
    if text in packaged_missions():
        source = resources.files("companion.mission") / "missions" / f"{text}.yaml"
        return parse_mission(source.read_text(encoding="utf-8"), text)
    path = Path(name_or_path)
    if not text or not is_there(path):
        hint = nearest_hint(text, packaged_missions())
        raise InputError(
            f"{text}: no such mission file or packaged mission{hint}; packaged: {', '.join(packaged_missions())}"
        )
    return parse_mission(read_text_file(path), text)


def is_obstacle(mission: Mission, agent_id: int, threat: ThreatSpec) -> bool:
    """Return whether an agent must avoid a threat: whether the threat reaches the height at which the agent flies.

    Raises:
        ValueError: the mission lists no such agent.

    """
    return reaches(threat, mission.origin.alt_m + agent_height_m(mission, agent_id))


def reaches(threat: ThreatSpec, altitude_m: float) -> bool:
    """Return whether a threat reaches an altitude above sea level."""
    above = threat.floor_m is None or threat.floor_m <= altitude_m
    return above and (threat.ceiling_m is None or altitude_m <= threat.ceiling_m)


def parse_mission(text: str, source: str) -> Mission:
    """Parse and validate the YAML text of a mission; `source` names it in errors.

    Raises:
        InputError: not YAML, empty, or against a rule of the mission file.

    """
    return validated(Mission, parse_yaml(text, source), source)


def _refuse_duplicates(key: str, ids: Sequence[int]) -> None:
    for index, identity in enumerate(ids):
        if identity in ids[:index]:
            raise ValueError(f"{key}[{index}]: id {identity} is given twice; allowed: each id once")


def _located(north_m: float | None, east_m: float | None) -> tuple[float, float]:
    if north_m is None or east_m is None:
        raise ValueError("the mission is not resolved: a position is still to be drawn")
    return north_m, east_m


def _refuse_half_a_place(north_m: float | None, east_m: float | None) -> None:
    if (north_m is None) != (east_m is None):
        given, missing = ("north_m", "east_m") if east_m is None else ("east_m", "north_m")
        raise ValueError(f"{missing}: missing beside {given}; allowed: both, or neither (then the place is drawn)")


def _greatest_speed_m_s(motion: ThreatMotion, north_m: float | None, east_m: float | None) -> float:
    if isinstance(motion, SteadyMotion):
        return motion.speed_m_s
    if not isinstance(motion, PathMotion):
        return 0.0
    points = list(motion.path)
    if points[0][0] > 0 and north_m is not None and east_m is not None:
        points.insert(0, (0.0, north_m, east_m))
    legs = zip(points, points[1:], strict=False)
    return max((math.hypot(b[1] - a[1], b[2] - a[2]) / (b[0] - a[0]) for a, b in legs), default=0.0)


def dump_mission(mission: Mission) -> str:
    """Return the mission as YAML text that `parse_mission` reads back to an equal mission."""
    data = mission.model_dump(mode="json", exclude_defaults=False)
    for key in ("draw", "defaults"):
        if getattr(mission, key) == type(getattr(mission, key))():
            del data[key]
    if mission.scale is None:
        del data["scale"]
    if not mission.sources:
        del data["sources"]
    return dump_yaml(data)
