"""Which sense of the others a vehicle has, in words."""

from __future__ import annotations

from typing import NamedTuple

from companion.onboard.config import Config


class Sense(NamedTuple):
    """The sense of the others that a vehicle has: whether it is one at all, and in words."""

    exists: bool
    words: str


def sense_of_others(config: Config, told: tuple[int, int], sees_others: bool | None, asked: bool) -> Sense:
    """Return by what a vehicle knows where the others are.

    Args:
        config: The configuration.
        told: Of how many other agents the broadcast tells, and of how many the place.
        sees_others: Whether its own detector shows others; None if it is not known whether there is one.
        asked: Whether the autopilot sends what its detector shows only when it is asked.

    """
    if config.detector == "none":
        return Sense(False, f"no sense of others is configured: separation_m {config.separation_m:g} is not kept")
    known, placed = told
    if config.detector == "broadcast":
        own = "no receiver configured"
    elif sees_others:
        own = "own receiver (ADSB_VEHICLE)"
    elif sees_others is None:
        own = f"ADSB_VEHICLE {'asked for, none came' if asked else 'none came'}"
    else:
        own = "no receiver (ADSB_TYPE 0)"
    if placed:
        return Sense(True, f"others: {own}; places of the broadcast, grown with their age")
    if known == 0:
        return Sense(True, f"others: {own}; none in the broadcast")
    if sees_others or (sees_others is None and config.detector == "adsb"):
        return Sense(True, f"others: {own}; no places in the broadcast")
    return Sense(False, f"no sense of others: {own}, no places in the broadcast: separation_m is not kept")


def without_a_sense(config: Config, told: tuple[int, int], sees_others: bool | None) -> str | None:
    """Return what is to be said of a vehicle that nothing tells where the others are; None if something may.

    `told` and `sees_others` are as in `sense_of_others`.
    """
    sense = sense_of_others(config, told, sees_others, asked=False)
    return None if sense.exists or config.law != "routed" else sense.words
