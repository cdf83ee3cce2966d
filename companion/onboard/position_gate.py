"""Positions that jump: one that velocity and time do not explain is not believed before it has stood for a while.

Meanwhile the vehicle counts as where its velocity has brought it, so that no setpoint swings. A position that comes
back within that time was a glitch, and nothing is left of it. One that stays is what the autopilot now flies by: it is
believed, but nobody knows whether it was wrong before or is wrong now, so the vehicle waits to be handed over again, or
for the position to jump back.

A position can also part from the velocity in small steps: it stands still, or goes slower, faster or aside. An
autopilot's position and velocity come of one estimator and agree, so what has parted is not believed until it is again
where the velocity leads. What drifts together with its velocity cannot be seen.
"""

from __future__ import annotations

import math
import time
from typing import NamedTuple

from companion.autopilot.telemetry import Telemetry
from companion.geo.degrees import metres_between
from companion.onboard.references import ACCELERATION_M_S2, unexplained_m

JUMP_M = 15.0
"""Distance from the place where the velocity leads to, beside what accuracy and time explain, from which a position has
jumped. Chosen: an estimator's resets are metres (5 m on PX4 1.16 when GPS is found again after 15 s); a glitch of GPS
that ArduPilot 4.7 gave in to after 10 s was 111 m in one step."""
ACCURACY_SHARE = 3.0
"""How many times the accuracy that is told a position may be wrong."""
ACCURACY_MOST_M = 10.0
"""Greatest accuracy that explains anything: with a worse one it loiters anyway (`health.position_accuracy_m`)."""
DOUBT_S = 2.0
"""Time for which a position that jumped must go on from there before it is believed."""
LOST_S = 5.0
"""Time from which a position that jumps again and again is none: dead reckoning is good for seconds."""
DRIFT_M_S = 1.0
"""Growth of what a dead-reckoned place may be wrong by."""
VELOCITY_STEP_M_S = 5.0
"""Change of the velocity, beside what the vehicle's acceleration explains, from which it is not used to reckon by."""
PARTED_M = 10.0
"""Distance, beside what accuracy explains, by which a position has parted from its velocity within PARTED_MEMORY_S.
Chosen: a position and a velocity of one estimator differ by tenths of m/s, 2 to 3 m in that time (0.2 m in simulated
flights), and one reset adds little more than RESET_M. With an accuracy of 1 m, 3 m/s are noticed
after 6 s, 4 m/s after 4 s."""
PARTED_MEMORY_S = 8.0
"""Time in which a difference between position and velocity is forgotten but for 1/e."""
PARTED_ACCURACY_SHARE = 1.5
"""How many times the accuracy that is told a position may wander within PARTED_MEMORY_S."""
RESET_M, RESET_M_S = 3.0, 3.0
"""What one step adds at most to how far a position has parted, and by its time: a larger one is a reset or a jump."""
GAP_S = 1.2
"""Time between two positions from which the velocity in between is not known well enough to find that they part."""
RETURN_SHARE, RETURN_M_S = 0.6, 0.2
"""Share of the distance for having parted within which a position is back, and growth of what that may be; never more
than for having parted, so that one that stands still where it was does not count as back when the vehicle stops."""
TURN_SHARE = 1.5
"""How many times the acceleration of its turn limit a vehicle may have."""
STILL_M_S = 0.5
"""Speed below which a position stands still, and difference to the velocity below which it goes on from elsewhere."""


class Parted(NamedTuple):
    """A position that parted from its velocity, from when that was noticed until it is back."""

    began_ms: int
    told_deg: tuple[float, float]
    """The position that was told then."""
    place_deg: tuple[float, float]
    """Where the velocity had led to then."""
    away_m: float
    """Distance between the two."""
    words: str | None = None
    """What it does, in words; None: it has been noticed for less than DOUBT_S."""


class Doubt(NamedTuple):
    """A position that jumped, while it is not believed."""

    began_ms: int
    settled_ms: int
    """Since when the told positions go on from one another."""
    told_deg: tuple[float, float]
    """The newest one."""
    jumped_ned_m: tuple[float, float]
    """How far it is from where the velocity leads to."""
    lasted_s: float = 0.0


class Track(NamedTuple):
    """Where the vehicle is taken to be, by positions that follow from one another."""

    place_deg: tuple[float, float]
    """Latitude and longitude."""
    velocity_m_s: tuple[float, float]
    """Velocity along true north and east."""
    boot_ms: int | None
    doubt: Doubt | None = None
    moved_ned_m: tuple[float, float] = (0.0, 0.0)
    """Sum of the jumps that were believed."""
    moved_at_s: float = math.nan
    """When the last of them was first told."""
    jumps: int = 0
    """Number of jumps that were believed."""
    drift_ned_m: tuple[float, float] = (0.0, 0.0)
    """How far the positions that were believed lately have gone beside their velocity."""
    parted: Parted | None = None
    acceleration_m_s2: float = ACCELERATION_M_S2
    """Greatest acceleration that the vehicle may have between two positions."""

    @property
    def is_lost(self) -> bool:
        """Whether positions have jumped about for so long that there is none to steer by."""
        return self.doubt is not None and self.doubt.lasted_s > LOST_S

    @property
    def moved_m(self) -> float:
        """How far the position was moved by jumps that were believed; 0 where it jumped back."""
        away_m = math.hypot(*self.moved_ned_m)
        return away_m if away_m > JUMP_M else 0.0


def track_of(told: Telemetry, turning_m_s2: float = 0.0) -> Track:
    """Return the track that begins with the present position, of a vehicle that may turn by this acceleration."""
    velocity_m_s = told.velocity_north_m_s, told.velocity_east_m_s
    acceleration_m_s2 = max(ACCELERATION_M_S2, TURN_SHARE * turning_m_s2)
    return Track((told.lat_deg, told.lon_deg), velocity_m_s, told.boot_ms, acceleration_m_s2=acceleration_m_s2)


def track_after(track: Track, told: Telemetry, now_s: float) -> Track:
    """Return the track after the newest position, which was received at `now_s`; unchanged without a newer one."""
    if told.boot_ms is None or track.boot_ms is None or told.boot_ms == track.boot_ms:
        return track
    place_deg = told.lat_deg, told.lon_deg
    velocity_m_s = told.velocity_north_m_s, told.velocity_east_m_s
    if told.boot_ms < track.boot_ms:
        return _believed(track, told)
    elapsed_s = (told.boot_ms - track.boot_ms) / 1000.0
    reckoned_m_s = velocity_m_s
    if math.dist(velocity_m_s, track.velocity_m_s) > VELOCITY_STEP_M_S + track.acceleration_m_s2 * elapsed_s:
        # A velocity that jumps with the place tells nothing.
        reckoned_m_s = track.velocity_m_s
    expected_deg = _carried(track.place_deg, track.velocity_m_s, reckoned_m_s, elapsed_s)
    jumped_ned_m = metres_between(expected_deg, place_deg)
    if track.parted is not None:
        reckoned = track._replace(place_deg=expected_deg, velocity_m_s=reckoned_m_s, boot_ms=told.boot_ms)
        return _while_parted(reckoned, track.parted, told, math.hypot(*jumped_ned_m))
    lasted_s = 0.0 if track.doubt is None else (told.boot_ms - track.doubt.began_ms) / 1000.0
    allowed_m = _allowed_m(track, told, elapsed_s)
    if math.hypot(*jumped_ned_m) <= allowed_m + DRIFT_M_S * lasted_s:
        drift_ned_m = _drifted(track, jumped_ned_m, elapsed_s)
        return _unless_parted(_believed(track, told)._replace(drift_ned_m=drift_ned_m), told)
    doubt = Doubt(told.boot_ms, told.boot_ms, place_deg, jumped_ned_m)
    if track.doubt is not None:
        # Compared by what is told alone: the place jumped to goes on as the vehicle flies, whatever was reckoned.
        onward_deg = _carried(track.doubt.told_deg, velocity_m_s, velocity_m_s, elapsed_s)
        goes_on = math.hypot(*metres_between(onward_deg, place_deg)) <= allowed_m
        settled_ms = track.doubt.settled_ms if goes_on else told.boot_ms
        doubt = doubt._replace(began_ms=track.doubt.began_ms, settled_ms=settled_ms, lasted_s=lasted_s)
    if told.boot_ms - doubt.settled_ms < DOUBT_S * 1000.0:
        return track._replace(place_deg=expected_deg, velocity_m_s=reckoned_m_s, boot_ms=told.boot_ms, doubt=doubt)
    moved_ned_m = (track.moved_ned_m[0] + jumped_ned_m[0], track.moved_ned_m[1] + jumped_ned_m[1])
    jumped_at_s = now_s - (told.boot_ms - doubt.began_ms) / 1000.0
    moved = track._replace(moved_ned_m=moved_ned_m, moved_at_s=jumped_at_s, jumps=track.jumps + 1)
    return _believed(moved, told)._replace(drift_ned_m=(0.0, 0.0))


def as_tracked(track: Track, told: Telemetry) -> Telemetry:
    """Return the telemetry with the position that is believed; the same object where that is the one told."""
    if track.doubt is None and track.parted is None:
        return told
    (lat_deg, lon_deg), (north_m_s, east_m_s) = track.place_deg, track.velocity_m_s
    values = {"velocity_north_m_s": north_m_s, "velocity_east_m_s": east_m_s}
    return Telemetry(**(vars(told) | {"lat_deg": lat_deg, "lon_deg": lon_deg} | values))


def doubted(track: Track) -> str | None:
    """Return in words that the position jumped, or parted, and is not believed yet; None if it is believed."""
    if track.parted is not None and track.parted.words is None:
        return f"position {_figure(track.parted.away_m)} m from where its velocity leads: not believed"
    if track.doubt is None:
        return None
    away_m = math.hypot(*track.doubt.jumped_ned_m)
    return f"position jumped {_figure(away_m)} m: not believed before it has stood for {DOUBT_S:g} s"


def jumped(track: Track) -> str | None:
    """Return in words that the position jumped and stayed there, or parted; None if it did not, or came back."""
    if track.parted is not None and track.parted.words is not None:
        return f"{track.parted.words}: not believed before it is back; or hand over again"
    if track.moved_m == 0.0:
        return None
    at = time.strftime("%H:%M:%S UTC", time.gmtime(track.moved_at_s))
    return f"position jumped {_figure(track.moved_m)} m at {at}: where it is nobody knows; hand over again"


def _believed(track: Track, told: Telemetry) -> Track:
    """Return the track that goes on from the position that is told."""
    velocity_m_s = told.velocity_north_m_s, told.velocity_east_m_s
    return track._replace(
        place_deg=(told.lat_deg, told.lon_deg), velocity_m_s=velocity_m_s, boot_ms=told.boot_ms, doubt=None, parted=None
    )


def _drifted(track: Track, step_ned_m: tuple[float, float], elapsed_s: float) -> tuple[float, float]:
    """Return how far positions have gone beside their velocity, after one more step; older ones are forgotten."""
    kept = math.exp(-elapsed_s / PARTED_MEMORY_S)
    north_m, east_m = kept * track.drift_ned_m[0], kept * track.drift_ned_m[1]
    step_m = RESET_M + RESET_M_S * elapsed_s
    if elapsed_s > GAP_S or 0.5 * track.acceleration_m_s2 * elapsed_s**2 > step_m:
        # What it did in between is not known well enough.
        return north_m, east_m
    most_m = math.hypot(north_m, east_m) + step_m
    north_m, east_m = north_m + step_ned_m[0], east_m + step_ned_m[1]
    share = min(1.0, most_m / max(math.hypot(north_m, east_m), 1e-9))
    return share * north_m, share * east_m


def _unless_parted(track: Track, told: Telemetry) -> Track:
    """Return the track that is believed, or where its position has parted, what the velocity makes of it."""
    away_m = math.hypot(*track.drift_ned_m)
    if track.boot_ms is None or away_m <= _parted_m(told):
        return track
    place_deg = _carried(track.place_deg, track.drift_ned_m, track.drift_ned_m, -1.0)
    parted = Parted(track.boot_ms, track.place_deg, place_deg, away_m)
    return track._replace(place_deg=place_deg, drift_ned_m=(0.0, 0.0), parted=parted)


def _while_parted(track: Track, parted: Parted, told: Telemetry, away_m: float) -> Track:
    """Return a reckoned track after one more position, so far away from it: it is back, or what it does is known."""
    assert track.boot_ms is not None
    lasted_s = (track.boot_ms - parted.began_ms) / 1000.0
    most_m = _parted_m(told)
    if away_m <= min(most_m, RETURN_SHARE * most_m + RETURN_M_S * lasted_s):
        return _believed(track, told)
    if parted.words is None and lasted_s >= DOUBT_S:
        told_m = metres_between(parted.told_deg, (told.lat_deg, told.lon_deg))
        led_m = metres_between(parted.place_deg, track.place_deg)
        speed_m_s, led_m_s = math.hypot(*told_m) / lasted_s, math.hypot(*led_m) / lasted_s
        apart_m_s = math.dist(told_m, led_m) / lasted_s
        if apart_m_s < STILL_M_S:
            words = f"position {_figure(away_m)} m from where its velocity leads"
        elif speed_m_s < STILL_M_S:
            words = f"position stands still while the velocity says {led_m_s:.1f} m/s"
        else:
            words = f"position moves {apart_m_s:.1f} m/s otherwise than the velocity, which says {led_m_s:.1f} m/s"
        parted = parted._replace(words=words)
    return track._replace(parted=parted)


def _parted_m(told: Telemetry) -> float:
    return PARTED_M + PARTED_ACCURACY_SHARE * _accuracy_m(told)


def _allowed_m(track: Track, told: Telemetry, elapsed_s: float) -> float:
    """Return how far a position may be from where two velocities lead that were told so long after one another."""
    flown_m = (
        math.hypot(*track.velocity_m_s) + math.hypot(told.velocity_north_m_s, told.velocity_east_m_s)
    ) * elapsed_s
    # However hard it turned meanwhile, it went no farther than by its speed.
    turned_m = min(0.5 * track.acceleration_m_s2 * elapsed_s**2, flown_m)
    return JUMP_M + ACCURACY_SHARE * _accuracy_m(told) + max(turned_m, unexplained_m(elapsed_s))


def _accuracy_m(told: Telemetry) -> float:
    """Return the accuracy that is told, as far as it explains anything."""
    return min(told.position_accuracy_m, ACCURACY_MOST_M) if math.isfinite(told.position_accuracy_m) else 0.0


def _carried(
    place_deg: tuple[float, float], first_m_s: tuple[float, float], last_m_s: tuple[float, float], elapsed_s: float
) -> tuple[float, float]:
    """Return where a velocity that changed steadily has led to."""
    north_m, east_m = (0.5 * (first + last) * elapsed_s for first, last in zip(first_m_s, last_m_s, strict=True))
    north_1_m, east_1_m = metres_between(place_deg, (place_deg[0] + 1e-3, place_deg[1] + 1e-3))
    return place_deg[0] + 1e-3 * north_m / north_1_m, place_deg[1] + 1e-3 * east_m / east_1_m


def _figure(metres: float) -> str:
    """Return a distance that does not change with every sample."""
    return f"{10.0 * round(metres / 10.0):.0f}"
