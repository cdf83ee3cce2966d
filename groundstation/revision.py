"""The revision of the broadcast's picture: which threats it has, and on which grid everything is told.

A grid is fixed by where everything stands and can get to, so that the same standing thing is always told by the same
bytes. A revision ends when a threat that should stand has moved, or something moving has left the grid; the grid of the
next one is then at least twice as wide, so that grids change a few times at most.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from companion.mission.extent import Extent, Point, mission_extent
from companion.mission.model import Mission
from companion.protocol.codec import Grid, Kind, frame_resolution_cm
from companion.protocol.fleet_codec import finest_grid, finest_radii_cm
from companion.protocol.messages import REVISIONS
from groundstation.tracks import TrackTable


@dataclass(frozen=True)
class Revision:
    """One revision of the picture."""

    number: int
    mission: Mission
    """The mission whose threats it has."""
    extent: Extent
    moved: Mapping[int, Point]
    """Places of the threats that should stand but do not stand where the mission says, by id."""
    jumps: int
    """How often threats had jumped farther than their bounds allow (Origins.jumps)."""
    state_cm: int
    """Unit of positions and radii in state frames."""
    grid: Grid
    """Grid of fleet frames."""
    radii_cm: int
    """Unit of radii frames."""


def first_revision(mission: Mission, tracks: TrackTable, number: int, radii_m: Iterable[float] = ()) -> Revision:
    """Return the revision with which a broadcast begins; `radii_m` as in `next_revision`.

    Raises:
        WireError: a position or radius of the mission does not fit any grid.

    """
    extent = mission_extent(mission).widened((), max(radii_m, default=0.0))
    return _revision(number, mission, extent, tracks)


def next_revision(revision: Revision, mission: Mission, tracks: TrackTable, radii_m: Iterable[float]) -> Revision:
    """Return the revision in force, or the next one if threats have changed or the grid is too small.

    A threat has changed that was added, retired or given another radius, speed bound or place, that should stand but
    has moved, or that was seen where its bound does not allow. `radii_m` are the threats' radii as they are to be told.

    Raises:
        WireError: a position or radius does not fit any grid.

    """
    moved = moved_threats(mission, tracks)
    points = [
        tracks.tracks[kind, thing.id].position_ned_m
        for kind, things in ((Kind.TARGET, mission.targets), (Kind.THREAT, mission.threats))
        for thing in things
    ]
    radius_m = max(radii_m, default=0.0)
    if mission is not revision.mission:
        # What was added needs room to move, and for the agents that it draws there.
        extent = mission_extent(mission)
        points += [extent.low_ned_m, extent.high_ned_m]
        radius_m = max(radius_m, extent.radius_m)
    following = (revision.number + 1) % REVISIONS
    if radius_m > revision.extent.radius_m or not all(map(revision.extent.holds, points)):
        return _revision(following, mission, revision.extent.widened(points, radius_m), tracks)
    told = (revision.moved, revision.jumps, revision.mission.threats)
    if (moved, tracks.origins.jumps, mission.threats) != told:
        return replace(revision, number=following, mission=mission, moved=moved, jumps=tracks.origins.jumps)
    return revision if mission is revision.mission else replace(revision, mission=mission)


def moved_threats(mission: Mission, tracks: TrackTable) -> dict[int, Point]:
    """Return by id the places of the threats that should stand but do not stand where the mission says."""
    standing = [threat for threat in mission.threats if threat.speed_bound_m_s == 0.0]
    places = [(threat, tracks.tracks[Kind.THREAT, threat.id].position_ned_m) for threat in standing]
    return {threat.id: place for threat, place in places if place != threat.position_ned_m}


def _revision(number: int, mission: Mission, extent: Extent, tracks: TrackTable) -> Revision:
    corners = [extent.low_ned_m, extent.high_ned_m]
    return Revision(
        number=number,
        mission=mission,
        extent=extent,
        moved=moved_threats(mission, tracks),
        jumps=tracks.origins.jumps,
        state_cm=frame_resolution_cm(corners, [extent.radius_m]),
        grid=finest_grid(corners),
        radii_cm=finest_radii_cm(extent.radius_m),
    )
