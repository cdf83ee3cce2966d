"""The frames of reference that heights and places are told in, as at the hand-over, and how far each has moved since.

An autopilot tells its height above home and above sea level, and its place in a local frame. Anybody on its link can
move home or the local frame's origin in flight, and its own estimate may step. None of that moves the vehicle, so none
of it may move a setpoint: from the hand-over on, what is told is compared with what it was. A height that steps while
the vertical velocity says nothing of it has moved, and the one that went on is held. Where the two part too slowly to
tell which of them it is, the vehicle climbs or descends only as far as both ask for.

What cannot be seen here is a drift of all of them together: that is the estimate itself, by which the autopilot flies.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.autopilot.telemetry import Telemetry
from companion.geo.degrees import metres_between

MOVED_M = 5.0
"""Difference from which a height has moved. Chosen: resets of an estimator's height are a few metres (up to 1 m on
ArduPilot 4.7 and PX4 1.16 in their simulators when GPS is lost and found again), and a vehicle has more than this below
it."""
PLACE_MOVED_M = 25.0
"""Distance from which home, or the local frame, has moved sideways. Chosen: more than two receivers differ by."""
LOCAL_SHARE = 0.02
"""Share of the way from the hand-over by which the local frame may turn and stretch against the degrees: 1 percent is a
convergence of the meridians of half a degree, 50 km from the origin at a latitude of 50 degrees."""
UNDECIDED_M = 1.0
"""Height by which a vehicle whose references have parted may be off before it climbs or descends."""
IGNORED_M = 0.05
"""Difference of two heights that is rounding."""
ACCELERATION_M_S2 = 10.0
"""Greatest acceleration by which two samples of a velocity may not tell what happened between them."""
_HAND_OVER = "hand over again"


class Anchor(NamedTuple):
    """One moment at which the place was told both in degrees and in the local frame."""

    lat_deg: float
    lon_deg: float
    altitude_m: float
    local_ned_m: tuple[float, float, float]


class References(NamedTuple):
    """The references as they were first told since the hand-over, and what is known of their moves."""

    base_m: float
    """Altitude above sea level minus height above home."""
    last: Telemetry
    """The telemetry with the newest position that was looked at."""
    altitude_moved_m: float = 0.0
    """Sum of the steps of the altitude above sea level that no climb explains."""
    height_moved_m: float = 0.0
    """Sum of the steps of the height above home that no climb explains."""
    both_moved_m: float = 0.0
    """What of these sums is steps of both alike, which are the estimate's own; NaN once both stepped differently."""
    home_deg: tuple[float, float] | None = None
    home_altitude_m: float = math.nan
    origin: tuple[float, float, float] | None = None
    anchor: Anchor | None = None
    stepped_ms: int = 0
    """The autopilot's clock at the last step."""
    home_fell_m: float = 0.0
    """Sum of the steps of the height above home alone, since: how far home has come down."""
    fallen_m: float = 0.0
    """How far home had come down, earlier in the flight, before these references were taken: heights go on counting
    from where it was."""


def references_of(told: Telemetry, fallen_m: float = 0.0) -> References:
    """Return the references as they are now, at the hand-over; home has come down by `fallen_m` in this flight."""
    base_m = told.altitude_m - (told.height_m - fallen_m)
    return _first_told(References(base_m, told, fallen_m=fallen_m), told)


def references_after(kept: References, told: Telemetry) -> References:
    """Return the references after new telemetry: every position is compared with the one before it."""
    if told.boot_ms != kept.last.boot_ms:
        kept = _stepped(kept, told)
    return _first_told(_returned(kept, told), told)


def as_handed_over(kept: References, told: Telemetry) -> Telemetry:
    """Return the telemetry by the references of the hand-over; the same object where none has moved.

    The altitude above sea level is NaN, not known, where it cannot be told whether that has moved.
    """
    walked_m = _walked_m(kept, told)
    values: dict[str, object] = {}
    if kept.height_moved_m or kept.altitude_moved_m or kept.fallen_m or walked_m:
        values["height_m"] = _by_altitude_m(kept, told) if walked_m else _by_height_m(kept, told)
    if kept.altitude_moved_m or (abs(walked_m) > MOVED_M and not _is_homes(kept, told, walked_m)):
        values["altitude_m"] = math.nan
    if kept.home_deg != told.home_deg:
        values["home_deg"] = kept.home_deg
    return Telemetry(**(vars(told) | values)) if values else told


def height_to_ask_m(kept: References, told: Telemetry, height_m: float) -> float:
    """Return the height above home, as the autopilot tells it now, that is a height above home of the hand-over.

    Where height and altitude part too slowly to tell which of them has moved, it is the one that changes the vehicle's
    height least: none where one asks to climb and the other to descend.
    """
    walked_m = _walked_m(kept, told)
    if not walked_m:
        return height_m + kept.height_moved_m + kept.fallen_m
    by_altitude_m = height_m - _by_altitude_m(kept, told)
    if _is_homes(kept, told, walked_m):
        return told.height_m + by_altitude_m
    by_height_m = height_m - _by_height_m(kept, told)
    up_m = sorted((by_altitude_m, by_height_m, 0.0))[1]
    # What is less than the two are apart tells nothing, and nothing is what keeps a plane where it is.
    return told.height_m + (0.0 if abs(up_m) <= min(abs(walked_m), UNDECIDED_M) else up_m)


def fallen_m(kept: References, told: Telemetry) -> float:
    """Return how far home has come down in this flight, in metres: the height above home tells as much too much.

    What moved the altitude above sea level alone, or both alike, is a correction of the estimate and no move of home.
    Where they parted slowly and nobody says which of them it was, the lower height counts: it lowers nobody.
    """
    walked_m, stepped_m = _walked_m(kept, told), kept.home_fell_m
    if walked_m < 0.0 or (walked_m and _is_homes(kept, told, walked_m)):
        stepped_m -= walked_m
    return kept.fallen_m + stepped_m


def counted_from(kept: References) -> str | None:
    """Return in words from where heights count, where home has moved in this flight before the hand-over."""
    if abs(kept.fallen_m) <= MOVED_M:
        return None
    return f"home had moved {_up(-kept.fallen_m)} in flight: heights count from where it was"


def moved(kept: References, told: Telemetry, in_local_frame: bool) -> str | None:
    """Return in words what has moved since the hand-over and what is held; None while nothing has.

    `in_local_frame`: whether the vehicle is steered by places in the autopilot's local frame, which are then compared
    with the degrees, beside what the autopilot says of its origin.
    """
    found = (_heights(kept, told), _home(kept, told), _origin(kept, told, in_local_frame))
    said = [words for words in found if words is not None]
    return f"{', '.join(said)}; {_HAND_OVER}" if said else None


def unexplained_m(elapsed_s: float) -> float:
    """Return the way that may lie between what two samples of a velocity tell of a time and what happened in it."""
    return 0.5 * ACCELERATION_M_S2 * elapsed_s**2


def _first_told(kept: References, told: Telemetry) -> References:
    """Return the references with those that were told for the first time."""
    if kept.home_deg is None and told.home_deg is not None:
        kept = kept._replace(home_deg=told.home_deg, home_altitude_m=told.home_altitude_m)
    if kept.origin is None and told.origin is not None:
        kept = kept._replace(origin=told.origin)
    if kept.anchor is None and (local_ned_m := _local_now(told)) is not None:
        kept = kept._replace(anchor=Anchor(told.lat_deg, told.lon_deg, told.altitude_m, local_ned_m))
    return kept


def _stepped(kept: References, told: Telemetry) -> References:
    """Return the references after a newer position: what of its heights no climb explains has moved."""
    last = kept.last
    kept = kept._replace(last=told)
    if told.boot_ms is None or last.boot_ms is None or told.restarts != last.restarts:
        return kept
    elapsed_s = (told.boot_ms - last.boot_ms) / 1000.0
    climbed_m = 0.5 * (last.climb_m_s + told.climb_m_s) * elapsed_s
    bound_m = MOVED_M + unexplained_m(elapsed_s)
    altitude_step_m = told.altitude_m - last.altitude_m - climbed_m
    height_step_m = told.height_m - last.height_m - climbed_m
    if abs(altitude_step_m) <= bound_m and abs(height_step_m) <= bound_m:
        return kept
    # Where only one of the two stepped, the other one says what the climb really was.
    both_step_m = 0.0
    if abs(altitude_step_m) <= bound_m:
        altitude_step_m, height_step_m = 0.0, height_step_m - altitude_step_m
    elif abs(height_step_m) <= bound_m:
        altitude_step_m, height_step_m = altitude_step_m - height_step_m, 0.0
    else:
        both_step_m = altitude_step_m if abs(altitude_step_m - height_step_m) <= IGNORED_M else math.nan
    altitude_moved_m = _sum(kept.altitude_moved_m, altitude_step_m)
    height_moved_m = _sum(kept.height_moved_m, height_step_m)
    return kept._replace(
        altitude_moved_m=altitude_moved_m,
        height_moved_m=height_moved_m,
        stepped_ms=told.boot_ms,
        both_moved_m=_sum(kept.both_moved_m, both_step_m) if altitude_moved_m or height_moved_m else 0.0,
        home_fell_m=_sum(kept.home_fell_m, height_step_m - altitude_step_m) if height_step_m else kept.home_fell_m,
    )


def _returned(kept: References, told: Telemetry) -> References:
    """Return the references without the steps of one of them alone, once both are told as at the hand-over again.

    A home that walks away slowly and comes back by a jump leaves the sum of the jumps behind, though it is back. It is
    where the two heights are as far apart as they were, HOME_POSITION says so too, and one of the sums has nothing but
    steps of both: two sums that step alike one after the other are a step of the estimate, which has not come back.
    """
    altitude_m, height_m, both_m = kept.altitude_moved_m, kept.height_moved_m, kept.both_moved_m
    if altitude_m == height_m == both_m:
        return kept
    apart_m = told.altitude_m - told.height_m - (kept.base_m - kept.fallen_m)
    raised_m = told.home_altitude_m - kept.home_altitude_m
    alone_m = min(abs(altitude_m - both_m), abs(height_m - both_m))
    if abs(apart_m) <= MOVED_M and abs(raised_m) <= MOVED_M and alone_m <= UNDECIDED_M and _told_since(kept, told):
        return kept._replace(altitude_moved_m=both_m, height_moved_m=both_m, home_fell_m=0.0)
    return kept


def _told_since(kept: References, told: Telemetry) -> bool:
    """Return whether HOME_POSITION was told since the last step: PX4 tells it up to its period later (measured)."""
    return told.home_boot_ms is not None and told.home_boot_ms >= kept.stepped_ms


def _sum(moved_m: float, step_m: float) -> float:
    """Return a sum of steps; one that was taken back is none."""
    return 0.0 if abs(moved_m + step_m) <= IGNORED_M else moved_m + step_m


def _by_altitude_m(kept: References, told: Telemetry) -> float:
    """Return the height above home of the hand-over, by the altitude above sea level."""
    return told.altitude_m - kept.altitude_moved_m - kept.base_m


def _by_height_m(kept: References, told: Telemetry) -> float:
    """Return the height above home of the hand-over, or of the flight, by the height above home that is told."""
    return told.height_m - kept.height_moved_m - kept.fallen_m


def _walked_m(kept: References, told: Telemetry) -> float:
    """Return by how much the two heights have parted apart from their steps; 0 for rounding or what is not known."""
    walked_m = _by_altitude_m(kept, told) - _by_height_m(kept, told)
    return walked_m if abs(walked_m) > IGNORED_M else 0.0


def _is_homes(kept: References, told: Telemetry, walked_m: float) -> bool:
    """Return whether the autopilot says of home that it has moved as the heights have parted."""
    raised_m = told.home_altitude_m - kept.home_altitude_m
    return abs(raised_m) > MOVED_M and abs(raised_m - (walked_m - kept.height_moved_m)) <= MOVED_M


def _heights(kept: References, told: Telemetry) -> str | None:
    """Return in words which heights have moved, and by what the height is held."""
    walked_m, altitude_m, height_m = _walked_m(kept, told), kept.altitude_moved_m, kept.height_moved_m
    if abs(walked_m) > MOVED_M:
        if not _is_homes(kept, told, walked_m):
            return f"home and sea level moved {_figure(walked_m)} apart in flight: height held where both agree"
        height_m -= walked_m
    if altitude_m and height_m:
        if abs(altitude_m - height_m) <= MOVED_M:
            return f"the autopilot's height jumped {_up(height_m)} in flight: held as before"
        return f"altitude jumped {_up(altitude_m)} and height {_up(height_m)} in flight: held as before"
    if height_m:
        return f"home moved {_up(-height_m)} in flight: height held by altitude above sea level"
    if altitude_m:
        return f"altitude above sea level jumped {_up(altitude_m)} in flight: height held by height above home"
    raised_m = told.home_altitude_m - kept.home_altitude_m
    if abs(raised_m) > MOVED_M:
        return f"home moved {_up(raised_m)} in flight: height held by altitude above sea level"
    return None


def _home(kept: References, told: Telemetry) -> str | None:
    if kept.home_deg is None or told.home_deg is None or told.home_deg == kept.home_deg:
        return None
    away_m = math.hypot(*metres_between(kept.home_deg, told.home_deg))
    return f"home moved {_figure(away_m)} aside in flight: the old one counts" if away_m > PLACE_MOVED_M else None


def _origin(kept: References, told: Telemetry, in_local_frame: bool) -> str | None:
    """Return in words how far the local frame has moved, as the autopilot says or as its own places tell."""
    away_m = up_m = 0.0
    if kept.origin is not None and told.origin is not None and told.origin != kept.origin:
        away_m = math.hypot(*metres_between(kept.origin[:2], told.origin[:2]))
        up_m = told.origin[2] - kept.origin[2]
    bound_m = PLACE_MOVED_M
    local_ned_m = _local_now(told) if in_local_frame else None
    if kept.anchor is not None and local_ned_m is not None and away_m <= PLACE_MOVED_M and abs(up_m) <= MOVED_M:
        anchor = kept.anchor
        north_m, east_m = metres_between((anchor.lat_deg, anchor.lon_deg), (told.lat_deg, told.lon_deg))
        moved_m = [now - then for now, then in zip(local_ned_m, anchor.local_ned_m, strict=True)]
        away_m = math.hypot(moved_m[0] - north_m, moved_m[1] - east_m)
        up_m = moved_m[2] + told.altitude_m - anchor.altitude_m
        bound_m += LOCAL_SHARE * math.hypot(north_m, east_m)
        if kept.altitude_moved_m:
            up_m = 0.0  # That is sea level's move, which is told as such.
    said = [f"{_figure(away_m)} aside"] if away_m > bound_m else []
    said += [_up(up_m)] if abs(up_m) > MOVED_M else []
    return f"the local frame's origin moved {' and '.join(said)} in flight" if said else None


def _local_now(told: Telemetry) -> tuple[float, float, float] | None:
    """Return the place in the local frame at the time of the position; None where it is not told."""
    if told.local_ned_m is None or told.boot_ms is None:
        return None
    north_m, east_m, down_m = told.local_ned_m
    since_s = (told.boot_ms - told.local_boot_ms) / 1000.0
    return (
        north_m + told.velocity_north_m_s * since_s,
        east_m + told.velocity_east_m_s * since_s,
        down_m - told.climb_m_s * since_s,
    )


def _up(metres: float) -> str:
    return f"{_figure(abs(metres))} {'up' if metres > 0.0 else 'down'}"


def _figure(metres: float) -> str:
    """Return a length in words that do not change with every sample."""
    metres = abs(metres)
    step_m = 1.0 if metres < 20.0 else 5.0 if metres < 100.0 else 10.0
    return f"{step_m * round(metres / step_m):.0f} m"
