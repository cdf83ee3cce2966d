"""All warnings before a flight about a mission: those of its file, and those of the vehicles that fly it."""

from __future__ import annotations

from collections.abc import Sequence

from companion.autopilot.adapter import Abilities
from companion.guidance.settings import LawName
from companion.mission.lint import first_of, lint
from companion.mission.model import Mission
from companion.onboard.lint.fleet import abilities_of, beyond_airspeed_in_wind, fleet_of
from companion.onboard.lint.reach import circled_targets, out_of_reach, repelled
from companion.onboard.lint.spacing import mixed_turn_limits, starts_too_near, too_little_known, too_short_a_detector
from companion.onboard.lint.starts import uncertified_starts


def lint_flight(
    mission: Mission,
    law: LawName,
    kinds: Sequence[str],
    source: str,
    parameters: Sequence[tuple[str, float]] = (),
) -> list[str]:
    """Return the warnings about a resolved mission, those of the file alone first; one line for each kind of warning.

    `kinds` are the kinds of autopilot that may fly it: only what holds for all of them is a warning, in the words for
    the first. `parameters` are those of the autopilots, name and value, that differ from their defaults. Errors name
    `source`.

    Raises:
        InputError: the guard cannot hold the limits of an agent.

    """
    found = [_concerns(mission, law, kind, abilities_of(kind, parameters), source) for kind in kinds]
    shared = [topic for topic in found[0] if all(one.get(topic) for one in found)]
    warnings = [first_of(topic.split()[0], found[0][topic]) for topic in shared]
    return lint(mission) + [warning for warning in warnings if warning is not None]


def _concerns(mission: Mission, law: LawName, kind: str, abilities: Abilities, source: str) -> dict[str, list[str]]:
    """Return what one kind of autopilot gives rise to, by topic; its first word is the mission's key."""
    fleet = fleet_of(mission, law, kind, abilities, source)
    found = {
        "agents certificate": uncertified_starts(mission, fleet, kind),
        "agents spacing": starts_too_near(mission, fleet),
        "detector_range_m": too_short_a_detector(mission, fleet),
        "detector": too_little_known(mission, fleet),
        "agents n_max": mixed_turn_limits(mission, fleet),
        "wind": beyond_airspeed_in_wind(fleet, kind, abilities),
    }
    if law == "routed":
        return {**found, "targets reach": out_of_reach(mission, fleet)}
    return {**found, "targets reach": repelled(mission, fleet), "agents turn": circled_targets(mission, fleet, kind)}
