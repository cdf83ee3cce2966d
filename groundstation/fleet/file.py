"""The fleet file: the vehicles that fly a mission, each with its kind, its links and where its files lie.

What the mission says of a vehicle may stand here again, so that a file about the hangar is a whole one, but then it
must be the same: a vehicle that flies by other numbers than the centre reckons with is found before the flight.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pydantic import Field, model_validator

from companion.autopilot.kinds import KINDS
from companion.errors import InputError, nearest_hint, some_of
from companion.files.yaml import ListOf, Section, parse_yaml, read_text_file, validated
from companion.mission.places import FORMS, IN_DEGREES, IN_METRES, Latitude, Longitude
from companion.mission.values import MAX_ITEMS, Coordinate, Height, Identity, Positive, Speed

Text = Annotated[str, Field(min_length=1)]
ID_WORD = "{id}"
"""Word in a link or a folder for which the vehicle's id is put."""
MOST_NAMED = 10
"""Greatest number of ids that a refusal names."""


class Home(Section):
    """Where a vehicle starts: in degrees, or in metres on the mission's plane."""

    lat_deg: Latitude | None = None
    lon_deg: Longitude | None = None
    north_m: Coordinate | None = None
    east_m: Coordinate | None = None

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        given = {key for key in (*IN_DEGREES, *IN_METRES) if getattr(self, key) is not None}
        if given not in (set(IN_DEGREES), set(IN_METRES)):
            raise ValueError(f"{', '.join(sorted(given)) or 'nothing'} given; allowed: {FORMS}")
        return self


class Installation(Section):
    """What a vehicle's own computer needs; `{id}` in a text stands for the vehicle's id."""

    kind: str | None = None
    """Kind of its autopilot."""
    autopilot_link: Text | None = None
    system_id: Annotated[int, Field(ge=1, le=255)] | None = None
    """MAVLink system id of its autopilot; None: its agent id, where that is at most 255."""
    broadcast_link: Text | None = None
    """Where it hears the broadcast."""
    uplink: Text | None = None
    """Case II: where its position reports go."""
    keys: Text | None = None
    """Folder of the keys on its computer."""
    state: Text | None = None
    """Folder of the state files on its computer."""
    logs: Text | None = None
    """Folder of the logs on its computer."""
    config: dict[str, Any] = {}
    """Further keys of its configuration, of those that the mission does not say."""

    @model_validator(mode="after")
    def _known(self) -> Self:
        if self.kind is not None and self.kind not in KINDS:
            raise ValueError(f"kind: '{self.kind}'{nearest_hint(self.kind, KINDS)}; allowed: {', '.join(KINDS)}")
        return self


class Vehicle(Installation):
    """One vehicle: its id in the mission, what it is told beside that, and what the mission says of it again."""

    FROM_MISSION: ClassVar[tuple[str, ...]] = ("speed_m_s", "n_max", "range_m")

    id: Identity
    home: Home | None = None
    speed_m_s: Speed | None = None
    n_max: Annotated[float, Field(gt=0, le=100)] | None = None
    range_m: Positive | None = None
    height_m: Height | None = None


class Fleet(Section):
    """A whole fleet file."""

    all: Installation = Installation()
    """What holds for each vehicle that does not say otherwise."""
    vehicles: Annotated[ListOf[Vehicle], Field(min_length=1, max_length=MAX_ITEMS)]


def load_fleet(path: str) -> Fleet:
    """Load a fleet file.

    Raises:
        InputError: it cannot be read, is not YAML, or breaks a rule of the fleet file.

    """
    return validated(Fleet, parse_yaml(read_text_file(Path(path)), path), path)


def filled(vehicle: Vehicle, others: Installation) -> Vehicle:
    """Return a vehicle with what it leaves out taken from `others`, and its id in the place of `{id}`."""
    given: dict[str, Any] = {key: getattr(others, key) for key in Installation.model_fields}
    given |= {key: getattr(vehicle, key) for key in vehicle.model_fields_set}
    given["config"] = merged(others.config, vehicle.config)
    return vehicle.model_copy(update={key: _with_id(value, str(vehicle.id)) for key, value in given.items()})


def _with_id(value: object, number: str) -> object:
    """Return a value of a vehicle with its id in the place of `{id}`, in all texts of it."""
    if isinstance(value, str):
        return value.replace(ID_WORD, number)
    if isinstance(value, Mapping):
        return {key: _with_id(part, number) for key, part in value.items()}
    return [_with_id(part, number) for part in value] if isinstance(value, list) else value


def merged(first: Mapping[str, Any], second: Mapping[str, Any]) -> dict[str, Any]:
    """Return two mappings as one, at all depths; where both have a value, the second's counts."""
    both = dict(first)
    for key, value in second.items():
        earlier = both.get(key)
        both[key] = merged(earlier, value) if isinstance(earlier, Mapping) and isinstance(value, Mapping) else value
    return both


def vehicles_of(fleet: Fleet, ids: Mapping[int, object], source: str) -> list[Vehicle]:
    """Return the vehicles of a fleet, filled in, in the order of the mission's agents `ids`; errors name `source`.

    Raises:
        InputError: a vehicle is there twice, is no agent of the mission, or an agent has no vehicle.

    """
    seen: dict[int, int] = {}
    for index, vehicle in enumerate(fleet.vehicles):
        where = f"{source}: vehicles[{index}].id: {vehicle.id}"
        if vehicle.id in seen:
            raise InputError(f"{where} is given twice, first as vehicles[{seen[vehicle.id]}]; allowed: each id once")
        if vehicle.id not in ids:
            raise InputError(f"{where} is no agent of the mission; allowed: {some_of(ids, MOST_NAMED)}")
        seen[vehicle.id] = index
    missing = [identity for identity in ids if identity not in seen]
    if missing:
        raise InputError(
            f"{source}: vehicles: none for agent {some_of(missing, MOST_NAMED)}, which the mission has; allowed: one "
            "vehicle for each of its agents"
        )
    try:
        return [filled(fleet.vehicles[seen[identity]], fleet.all) for identity in ids]
    except RecursionError as error:
        raise InputError(
            f"{source}: config: an alias that contains itself; allowed: keys of a configuration"
        ) from error
