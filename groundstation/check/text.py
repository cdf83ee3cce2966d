"""A mission in view as tables for the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.table import Column, Table

from groundstation.check.overview import Corner, Overview, Place

_TABLE_COLUMNS = 200


def overview_text(found: Overview) -> str:
    """Return a mission in view as tables, with the warnings last, where a hurried reader looks for them."""
    mission = found.mission
    console = Console(soft_wrap=True, highlight=False, markup=False, width=_TABLE_COLUMNS)
    with console.capture() as capture:
        origin = mission.origin
        console.print(
            f"{mission.name}, seed {found.seed}, Case {mission.case}; origin {origin.lat_deg:.7f}, "
            f"{origin.lon_deg:.7f}, {origin.alt_m:g} m above sea level"
        )
        console.print(
            f"arrival radius {mission.arrival_radius_m:g} m, separation {mission.separation_m:g} m; broadcast every "
            f"{mission.broadcast_period_s:g} s, assigned every {mission.assignment_period_s:g} s\n"
        )
        places = _table("thing", "details")
        for place in found.places:
            places.add_row(f"{place.what} {place.id}", *_cells(place), place.details)
        console.print(places)
        if found.corners:
            corners = _table("corner")
            for corner in found.corners:
                corners.add_row(f"{corner.what}, {corner.index}", *_cells(corner))
            console.print(corners)
        for warning in found.warnings:
            console.print(f"warning: {warning}")
        seen = "vehicles that can stop and others" if len(found.kinds) > 1 else found.kinds[0]
        count = len(found.warnings)
        console.print(f"{count or 'no'} warning{'' if count == 1 else 's'}, for {seen}")
    return capture.get().rstrip("\n")


def _table(first: str, *last: str) -> Table:
    numbers = ("north (m)", "east (m)", "latitude (deg)", "longitude (deg)")
    return Table(first, *(Column(title, justify="right") for title in numbers), *last)


def _cells(place: Place | Corner) -> tuple[str, ...]:
    return f"{place.north_m:.1f}", f"{place.east_m:.1f}", f"{place.lat_deg:.7f}", f"{place.lon_deg:.7f}"
