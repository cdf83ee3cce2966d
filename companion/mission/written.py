"""The mission file as people write it, turned into what the model holds before that checks it.

Places in degrees become metres, one radius of a threat two, and what an entry leaves out comes from `defaults`. What is
unlike anything described here is left as it is, for the model to refuse under its full name.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping

from companion.mission.places import IN_DEGREES, Origin, Plane, as_list, in_metres
from companion.mission.values import MAX_ITEMS, RADII

ATTACK_SHARE = 0.5
"""R_a of a threat that has one radius, as a share of that radius, which is its R_d (the paper's: 5 of 10 km)."""


def radii_m(radius_m: float) -> tuple[float, float]:
    """Return R_d and R_a, in metres, of a threat that has one radius.

    Vehicles keep outside R_d, so that it is the radius that is meant. R_a only says where nobody may start, what the
    paper's own laws keep out of, and how bad an entry was.
    """
    return radius_m, ATTACK_SHARE * radius_m


def as_modelled(data: Mapping[str, object]) -> dict[str, object]:
    """Return the data of a mission file with all places in metres and two radii for each threat.

    Raises:
        ValueError: a place or a radius cannot be used; the message begins with its key.
        ValidationError: the origin is none.

    """
    plane = _plane(data.get("origin"))
    changed = dict(data)
    if "fence" in data:
        changed["fence"] = _polygon(data["fence"], plane, "fence")
    if "exclusions" in data:
        changed["exclusions"] = _each(data["exclusions"], "exclusions", lambda one, at: _polygon(one, plane, at))
    defaults = data.get("defaults")
    if isinstance(defaults, Mapping):
        parts = {kind: _thing(part, plane, f"defaults.{kind}") for kind, part in defaults.items()}
        changed["defaults"] = {**parts, "threat": _with_radii(parts.get("threat", {}), "defaults.threat")}
    for key in ("agents", "targets", "threats"):
        if key in data:
            changed[key] = _each(data[key], key, lambda item, at: _thing(_in_plane(item, plane, at), plane, at))
    if "threats" in data:
        changed["threats"] = _each(changed["threats"], "threats", _with_radii)
    return changed


def with_defaults(item: object, given: Mapping[str, object]) -> object:
    """Return an entry of a list of things with what it leaves out filled in; what is no mapping as it is.

    What stands still by its own word has no bound on its speed but its own.
    """
    if not isinstance(item, Mapping):
        return item
    if item.get("motion") == "static":
        given = {key: value for key, value in given.items() if key != "speed_bound_m_s"}
    return {**given, **item}


def _plane(origin: object) -> Plane | None:
    """Return the mission's plane; None unless the file says where its origin is."""
    if origin is None:
        return None
    found = Origin.model_validate(origin)
    return Plane(found) if set(IN_DEGREES) <= found.model_fields_set else None


def _in_plane(item: object, plane: Plane | None, where: str) -> object:
    return in_metres(item, plane, where) if isinstance(item, Mapping) else item


def _thing(item: object, plane: Plane | None, where: str) -> object:
    """Return an agent, a target, a threat or the defaults of one with the points of its path as lists in metres."""
    if not isinstance(item, Mapping):
        return item
    changed = dict(item)
    motion = item.get("motion")
    if isinstance(motion, Mapping) and "path" in motion:
        at = f"{where}.motion.path"
        path = _each(motion["path"], at, lambda point, place: as_list(point, plane, place, ("t_s",)))
        changed["motion"] = {**motion, "path": path}
    return changed


def _with_radii(threat: object, where: str) -> object:
    """Return a threat, or the defaults of one, with two radii in place of `radius_m`."""
    if not isinstance(threat, Mapping) or "radius_m" not in threat:
        return threat
    others = {key: value for key, value in threat.items() if key != "radius_m"}
    return {**others, **dict(zip(RADII, radii_m(_radius_m(threat, where)), strict=True))}


def _radius_m(item: Mapping[str, object], where: str) -> float:
    radius_m = item["radius_m"]
    beside = next((key for key in RADII if key in item), None)
    if beside is not None:
        raise ValueError(f"{where}.radius_m: given beside {beside}; allowed: radius_m alone, or {' and '.join(RADII)}")
    if isinstance(radius_m, bool) or not isinstance(radius_m, int | float) or not 0.0 < radius_m <= sys.float_info.max:
        raise ValueError(f"{where}.radius_m: {str(radius_m)[:40]!r}; allowed: a number of metres greater than 0")
    return float(radius_m)


def _each(items: object, where: str, change: Callable[[object, str], object]) -> object:
    """Return a list with each of its items changed; anything else, or a list that is too long, as it is."""
    if not isinstance(items, list | tuple) or len(items) > MAX_ITEMS:
        return items
    return [change(item, f"{where}[{index}]") for index, item in enumerate(items)]


def _polygon(corners: object, plane: Plane | None, where: str) -> object:
    return _each(corners, where, lambda corner, at: as_list(corner, plane, at))
