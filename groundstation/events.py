"""What operators and sources ask of the ground station (commands), and the facts that are kept of a day (events).

A command is a wish and may be refused; an event is an accepted fact with its number, its time and who did it, in which
everything is resolved: ids are given and places are in metres. The events of a run, in order, are all that a restart
needs to go on with it (groundstation/operations.py).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal, Self, get_args

from pydantic import Field, TypeAdapter, model_validator

from companion.errors import InputError, nearest_hint
from companion.files.yaml import ListOf, Section, validated
from companion.mission.model import TargetSpec, ThreatSpec
from companion.mission.places import Latitude, Longitude
from companion.mission.values import (
    MAX_KEY,
    MAX_NAME,
    Coordinate,
    Identity,
    Level,
    Positive,
    SentName,
    SpeedBound,
    ThreatSpeedBound,
    TypedName,
)

MOST_NUMBER = 2**53
"""Greatest number of an event: the greatest whole number that every JSON reader keeps."""
Name = Annotated[str, Field(min_length=1, max_length=MAX_NAME), TypedName]
KeptName = Annotated[str, Field(min_length=1, max_length=MAX_NAME), SentName]
"""Name in an event, which may be of an older store or of a source."""
KeptKey = Annotated[str, Field(min_length=1, max_length=MAX_KEY), SentName]
ThingKind = Literal["target", "threat"]
KindName = Literal["agent", "target", "threat"]
DirectiveName = Literal["normal", "hold", "return"]
Number = Annotated[int, Field(ge=1, le=MOST_NUMBER)]


class _Placed(Section):
    """A place that may be given in metres on the mission's plane or in degrees; one or neither."""

    north_m: Coordinate | None = None
    east_m: Coordinate | None = None
    lat_deg: Latitude | None = None
    lon_deg: Longitude | None = None

    @model_validator(mode="after")
    def _wholly_placed(self) -> Self:
        for first, second in (("north_m", "east_m"), ("lat_deg", "lon_deg")):
            if (getattr(self, first) is None) != (getattr(self, second) is None):
                given, missing = (first, second) if getattr(self, second) is None else (second, first)
                raise ValueError(f"{missing}: missing beside {given}; allowed: both, or neither")
        if self.north_m is not None and self.lat_deg is not None:
            raise ValueError("lat_deg: given beside north_m; allowed: a place in metres or in degrees, not both")
        return self

    @property
    def is_placed(self) -> bool:
        """Whether a place is given."""
        return self.north_m is not None or self.lat_deg is not None


class _NewlyPlaced(_Placed):
    @model_validator(mode="after")
    def _a_place(self) -> Self:
        if not self.is_placed:
            raise ValueError("north_m: missing; allowed: north_m and east_m, or lat_deg and lon_deg")
        return self


class AddTarget(_NewlyPlaced):
    """Add a target."""

    do: Literal["add-target"]
    id: Identity | None = None
    name: Name | None = None
    speed_bound_m_s: SpeedBound = 0.0


class AddThreat(_NewlyPlaced):
    """Add a threat with one radius, `radius_m`, or with two."""

    do: Literal["add-threat"]
    id: Identity | None = None
    name: Name | None = None
    radius_m: Positive | None = None
    detection_radius_m: Positive | None = None
    attack_radius_m: Positive | None = None
    speed_bound_m_s: ThreatSpeedBound = 0.0
    floor_m: Level | None = None
    ceiling_m: Level | None = None

    @model_validator(mode="after")
    def _radii(self) -> Self:
        _refuse_mixed_radii(self.radius_m, self.detection_radius_m, self.attack_radius_m)
        if self.radius_m is None and (self.detection_radius_m is None or self.attack_radius_m is None):
            raise ValueError("radius_m: missing; allowed: radius_m, or detection_radius_m and attack_radius_m")
        return self


class Change(_Placed):
    """Change place, radii, speed bound or name of a target or threat; what is left out stays."""

    do: Literal["change"]
    kind: ThingKind
    id: Identity
    name: Name | None = None
    radius_m: Positive | None = None
    detection_radius_m: Positive | None = None
    attack_radius_m: Positive | None = None
    speed_bound_m_s: SpeedBound | None = None
    floor_m: Level | None = None
    ceiling_m: Level | None = None

    @model_validator(mode="after")
    def _fits(self) -> Self:
        _refuse_mixed_radii(self.radius_m, self.detection_radius_m, self.attack_radius_m)
        only = ("radius_m", "detection_radius_m", "attack_radius_m", "floor_m", "ceiling_m")
        if self.kind == "target":
            for key in only:
                if getattr(self, key) is not None:
                    raise ValueError(f"{key}: given for a target; allowed: for threats only")
        others = (*only, "speed_bound_m_s", "name")
        if not self.is_placed and all(getattr(self, key) is None for key in others):
            raise ValueError("nothing given; allowed: a place, radii, speed_bound_m_s, floor_m or name")
        return self


class Retire(Section):
    """Take a target or threat out of the picture for good."""

    do: Literal["retire"]
    kind: ThingKind
    id: Identity


class Pin(Section):
    """Send an agent to one target whatever the assignment says; None: as the assignment says."""

    do: Literal["pin"]
    agent: Identity
    target: Identity | None


class TakeOut(Section):
    """Take an agent out of the assignment: its target goes to another one."""

    do: Literal["take-out"]
    agent: Identity


class PutBack(Section):
    """Let an agent that was taken out take part in the assignment again."""

    do: Literal["put-back"]
    agent: Identity


class Direct(Section):
    """Give a directive to one agent, or to all (None)."""

    do: Literal["direct"]
    directive: DirectiveName
    agent: Identity | None = None


class Pause(Section):
    """Let all agents hold, and freeze the assignment."""

    do: Literal["pause"]


class Resume(Section):
    """End a pause: directives and assignment are as they were."""

    do: Literal["resume"]


class Undo(Section):
    """Take back what an event of a command did."""

    do: Literal["undo"]
    number: Number


Command = AddTarget | AddThreat | Change | Retire | Pin | TakeOut | PutBack | Direct | Pause | Resume | Undo
AnyCommand = Annotated[Command, Field(discriminator="do")]
"""A command as an API's field: the member of the union is chosen by `do`."""
_COMMANDS: dict[str, type[Command]] = {
    get_args(model.model_fields["do"].annotation)[0]: model for model in get_args(Command)
}
COMMAND_WORDS = tuple(_COMMANDS)


def command_from(data: object) -> Command:
    """Return the command in parsed JSON.

    Raises:
        InputError: it is no command; the message names key, value and what is allowed.

    """
    if not isinstance(data, Mapping):
        raise InputError("command: not an object; allowed: an object with the key `do`")
    word = data.get("do")
    if not isinstance(word, str) or word not in _COMMANDS:
        given = "missing" if word is None else f"'{str(word)[:40]}'"
        raise InputError(f"command: do: {given}{nearest_hint(str(word), _COMMANDS)}; allowed: {', '.join(_COMMANDS)}")
    return validated(_COMMANDS[word], data, f"command {word}")


class Who(Section):
    """Who did something: an operator or a source by its name, or the ground station itself."""

    name: KeptKey
    role: Literal["operator", "source", "station"]


STATION = Who(name="ground station", role="station")


class _Event(Section):
    """What every event has."""

    number: Number
    unix_s: float
    who: Who
    undoes: Number | None = None
    """Number of the event that this one takes back."""


class TargetAdded(_Event):
    """A target was added."""

    event: Literal["target-added"] = "target-added"
    target: TargetSpec
    name: KeptName | None = None


class ThreatAdded(_Event):
    """A threat was added."""

    event: Literal["threat-added"] = "threat-added"
    threat: ThreatSpec
    name: KeptName | None = None


class _Changed(_Event):
    name: KeptName | None = None
    """Its name now; None: it has none."""
    moved: bool
    """Whether it was given another place."""


class TargetChanged(_Changed):
    """A target was changed; `target` is what it is now."""

    event: Literal["target-changed"] = "target-changed"
    target: TargetSpec


class ThreatChanged(_Changed):
    """A threat was changed; `threat` is what it is now."""

    event: Literal["threat-changed"] = "threat-changed"
    threat: ThreatSpec


class ThingState(Section):
    """Everything that commands make of a target or threat; of the two one is given."""

    target: TargetSpec | None = None
    threat: ThreatSpec | None = None
    name: KeptName | None = None
    placed_s: float | None = None
    """Unix time at which it was at its place, if a command gave that; None: when the first run began."""
    pinned: ListOf[Identity] = ()
    """Ids of the agents pinned to it."""
    reached_by: ListOf[Identity] = ()


class Restored(_Event):
    """A target or threat was given back what it was before it was changed or retired."""

    event: Literal["restored"] = "restored"
    state: ThingState


class Retired(_Event):
    """A target or threat was retired."""

    event: Literal["retired"] = "retired"
    kind: ThingKind
    id: Identity
    reason: str | None = None
    """Why a source retired it; None for an operator."""


class Pinned(_Event):
    """An agent was pinned to a target, or (None) is assigned as any other again."""

    event: Literal["pinned"] = "pinned"
    agent: Identity
    target: Identity | None


class TakenOut(_Event):
    """An agent was taken out of the assignment."""

    event: Literal["taken-out"] = "taken-out"
    agent: Identity


class WasPutBack(_Event):
    """An agent takes part in the assignment again."""

    event: Literal["put-back"] = "put-back"
    agent: Identity


class OwnDirective(Section):
    """What a single agent is told."""

    agent: Identity
    directive: DirectiveName


class Directed(_Event):
    """A directive was given to an agent, or to all (None)."""

    event: Literal["directed"] = "directed"
    directive: DirectiveName
    agent: Identity | None = None
    own: ListOf[OwnDirective] | None = None
    """What an undo gives back to single agents that are told nothing else by now; None: a `normal` for all ends what
    single agents are told."""


class Telling(Section):
    """What an undo of a directive tells again."""

    directive: DirectiveName
    agent: Identity | None = None
    own: ListOf[OwnDirective] = ()


class Paused(_Event):
    """A pause began."""

    event: Literal["paused"] = "paused"


class Resumed(_Event):
    """A pause ended."""

    event: Literal["resumed"] = "resumed"


class Arrived(_Event):
    """An agent has arrived at a target."""

    event: Literal["arrived"] = "arrived"
    agent: Identity
    target: Identity


class ArrivalTakenBack(_Event):
    """Later positions showed that an agent was not at a target after all, which is open again if nobody else was."""

    event: Literal["arrival-taken-back"] = "arrival-taken-back"
    agent: Identity
    target: Identity


class Lost(_Event):
    """An agent was not heard or seen for too long."""

    event: Literal["lost"] = "lost"
    agent: Identity


class HeardAgain(_Event):
    """A lost agent was heard or seen again."""

    event: Literal["heard-again"] = "heard-again"
    agent: Identity


class NewTarget(Section):
    """Another target of an agent, and why."""

    agent: Identity
    target: Identity | None
    reason: str


class Assigned(_Event):
    """Agents were given other targets."""

    event: Literal["assigned"] = "assigned"
    changes: ListOf[NewTarget]


class RevisionBegan(_Event):
    """A new revision of the picture is broadcast."""

    event: Literal["revision-began"] = "revision-began"
    revision: Annotated[int, Field(ge=0)]
    threats: Annotated[int, Field(ge=0)]


class Started(_Event):
    """A run of the ground station began."""

    event: Literal["started"] = "started"
    mission: Annotated[str, SentName]
    epoch_s: int


class Stopped(_Event):
    """A run of the ground station ended, told to stop."""

    event: Literal["stopped"] = "stopped"
    reason: str = ""


class TrackBegan(_Event):
    """What a source calls `key` is the target, threat or agent `id` from now on, over restarts of both."""

    event: Literal["track-began"] = "track-began"
    source: KeptName
    key: KeptKey
    kind: KindName
    id: Identity


class TrackEnded(_Event):
    """A source's `key` stands for nothing any more."""

    event: Literal["track-ended"] = "track-ended"
    source: KeptName
    key: KeptKey
    reason: str = ""


class UnknownSeen(_Event):
    """A source saw something that the mission does not have."""

    event: Literal["unknown-seen"] = "unknown-seen"
    source: KeptName
    kind: KindName
    id: Annotated[int, Field(ge=0)]
    north_m: float
    east_m: float


Event = (
    TargetAdded
    | ThreatAdded
    | TargetChanged
    | ThreatChanged
    | Restored
    | Retired
    | Pinned
    | TakenOut
    | WasPutBack
    | Directed
    | Paused
    | Resumed
    | Arrived
    | ArrivalTakenBack
    | Lost
    | HeardAgain
    | Assigned
    | RevisionBegan
    | Started
    | Stopped
    | TrackBegan
    | TrackEnded
    | UnknownSeen
)
AnyEvent = Annotated[Event, Field(discriminator="event")]
_EVENTS: TypeAdapter[Event] = TypeAdapter(AnyEvent)


def event_json(event: Event) -> bytes:
    """Return an event as a line of JSON without its end."""
    return _EVENTS.dump_json(event)


def event_from_json(line: bytes | str) -> Event:
    """Return the event in a line of JSON.

    Raises:
        ValueError: the line holds no event (pydantic's ValidationError).

    """
    return _EVENTS.validate_json(line)


def _refuse_mixed_radii(radius_m: float | None, detection_m: float | None, attack_m: float | None) -> None:
    if radius_m is not None and (detection_m is not None or attack_m is not None):
        raise ValueError("radius_m: given beside other radii; allowed: radius_m, or the two radii")
