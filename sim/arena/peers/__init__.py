"""Published methods that the arena flies beside our laws: each sees the same picture and commands a heading.

The same turn limit applies to all. See docs/peers.md for what was implemented, with which parameters, and where each
method is at a disadvantage here.
"""

from __future__ import annotations

from collections.abc import Callable

from companion.guidance.laws import SteeringLaw
from companion.guidance.settings import LawSettings
from sim.arena.peers.apf import PotentialField
from sim.arena.peers.bendyruler import BendyRuler
from sim.arena.peers.horizon import RecedingHorizon
from sim.arena.peers.orca import ReciprocalAvoidance
from sim.arena.peers.vfhplus import VectorFieldHistogram

PEERS: dict[str, Callable[[LawSettings], SteeringLaw]] = {
    "apf": PotentialField,
    "vfhplus": VectorFieldHistogram,
    "bendyruler": BendyRuler,
    "orca": ReciprocalAvoidance,
    "horizon": RecedingHorizon,
}
SLOW: frozenset[str] = frozenset({"horizon"})
"""Methods that take tens of milliseconds for some decisions; they fly fewer missions."""
