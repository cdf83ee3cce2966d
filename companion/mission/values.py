"""The values that a mission file holds: how large they may be, and the types that check it.

The vehicle's configuration has some of the same keys and shares the types.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field

from companion.errors import printable
from companion.files.yaml import AsList, ListOf
from companion.geo.polygon import polygon_fault

MAX_ID = 65_535
"""Greatest id of an agent, target or threat: ids travel as 16 bits on the wire."""
MAX_COORDINATE_M = 1.0e6
"""Greatest distance of a place from the origin, north or east; a larger plane would be too distorted to steer by."""
MAX_SPEED_M_S = 1.0e3
MAX_THREAT_SPEED_M_S = 855.0
"""Greatest speed bound of a threat that a frame can tell (companion/protocol/fields.py); less would be unsafe."""
MIN_PERIOD_S = 1.0e-3
MAX_STEP_S = 10.0
MAX_STEPS = 20_000_000
"""Most integration steps of one flight: the default `max_time_s` at the smallest step, which takes days to compute."""
MAX_ITEMS = 2_000
"""Most entries of a list in the mission file; also the greatest count under `draw` and the most layers."""
MAX_HEIGHT_M = 20_000.0
"""Greatest height of an agent above the origin; a companion's own limits are narrower."""
MOVING_SPEED_BOUND_M_S = 10.0
"""Speed bound of a target or threat that moves, where none is given (the paper's); one that stands still has 0."""
RANGE_RESERVE = 1.1
"""Factor on the straight line home when `range_policy: return` keeps range for the way back."""
MIN_LEVEL_M, MAX_LEVEL_M = -1_000.0, 30_000.0
"""Least and greatest floor or ceiling of a threat above sea level; the wire has 16 bits of metres for them."""

RADII = ("detection_radius_m", "attack_radius_m")
"""Keys of R_d and R_a of a threat, in whose place one `radius_m` may stand."""

MAX_NAME = 40
"""Greatest length of the name of a target, threat or source."""
MAX_KEY = 80
"""Greatest length of a mission's name, and of what a source calls a thing."""


def _shown_as_typed(name: str) -> str:
    if not name.isprintable() or not name.strip():
        raise ValueError(f"{name!r}; allowed: a name of characters that can be printed, not blank")
    return name


TypedName = AfterValidator(_shown_as_typed)
"""Of a name that somebody types: what a terminal would not show as it is typed is refused."""
SentName = AfterValidator(lambda name: printable(name) if name.strip() else "?")
"""Of a name that was taken before, or that another program sends: what cannot be printed becomes a question mark."""


def refuse_no_band(floor_m: float | None, ceiling_m: float | None) -> None:
    """Raise ValueError if a floor, in m, is not below a ceiling; None is no limit."""
    if floor_m is not None and ceiling_m is not None and floor_m >= ceiling_m:
        raise ValueError(f"floor_m: {floor_m:g} m; allowed: less than ceiling_m {ceiling_m:g} m")


def refuse_not_nested(attack_radius_m: float, detection_radius_m: float) -> None:
    """Raise ValueError if R_a is not less than R_d, both in m."""
    if attack_radius_m >= detection_radius_m:
        raise ValueError(
            f"attack_radius_m: {attack_radius_m:g} m; allowed: less than detection_radius_m {detection_radius_m:g} m"
        )


Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Period = Annotated[float, Field(ge=MIN_PERIOD_S)]
Step = Annotated[float, Field(ge=MIN_PERIOD_S, le=MAX_STEP_S)]
Probability = Annotated[float, Field(ge=0, le=1)]
Coordinate = Annotated[float, Field(ge=-MAX_COORDINATE_M, le=MAX_COORDINATE_M)]
Vertex = Annotated[tuple[Coordinate, Coordinate], AsList]


def _simple(corners: tuple[tuple[float, float], ...]) -> tuple[tuple[float, float], ...]:
    fault = polygon_fault(corners)
    if fault is not None:
        raise ValueError(f"{fault}; allowed: a simple polygon, each corner given once and the edges without a crossing")
    return corners


Polygon = Annotated[ListOf[Vertex], Field(min_length=3, max_length=MAX_ITEMS), AfterValidator(_simple)]
PathPoint = Annotated[tuple[NotNegative, Coordinate, Coordinate], AsList]
Degrees = Annotated[float, Field(ge=-360, le=360)]
Speed = Annotated[float, Field(gt=0, le=MAX_SPEED_M_S)]
ThreatSpeedBound = Annotated[float, Field(ge=0, le=MAX_THREAT_SPEED_M_S)]
SpeedBound = Annotated[float, Field(ge=0, le=MAX_SPEED_M_S)]
Height = Annotated[float, Field(ge=0, le=MAX_HEIGHT_M)]
Level = Annotated[float, Field(ge=MIN_LEVEL_M, le=MAX_LEVEL_M)]
SwitchingShare = Annotated[float, Field(ge=0, lt=1)]
DetectorName = Literal["adsb", "broadcast", "none"]
"""Senses of other vehicles: an ADS-B receiver beside the broadcast, the broadcast alone, none."""
Identity = Annotated[int, Field(ge=1, le=MAX_ID)]
Count = Annotated[int, Field(ge=0, le=MAX_ITEMS)]
