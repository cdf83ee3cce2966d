"""How far the commanded heading leads the vehicle: the turn limit is walked by the command, not by the vehicle's reply.

If each command were one step of the turn limit from the measured course, a vehicle that does not answer so small a
change would be commanded the same heading for ever. So where the vehicle is behind its last command the next one goes
on from there, at the turn limit, until it reaches what is wanted or leads the measured course by MOST_LEAD_RAD.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from companion.guard.arcs import TURN_TOLERANCE_RAD

MOST_LEAD_RAD = math.pi / 2.0
"""Greatest lead of the commanded heading over the measured course. A wind below the airspeed drifts a vehicle by less
than a quarter turn, so a heading that leads by that much turns its course in every such wind; with more lead, a vehicle
that flies velocities would reverse instead of turn. Chosen, not measured."""
LEAST_LEAD_RAD = 1e-6
"""Lead up to which a vehicle counts as being where its last command put it: rounding."""


class Turn(NamedTuple):
    """The turn of one step as predicted, and what is known of the course before it and of the heading after it."""

    tip_rad: float
    """Heading at which the next command begins to act, as predicted."""
    turn_rad: float
    """Turn that the vehicle is predicted to make in the step; positive to the right."""
    most_rad: float
    """Greatest turn of the step."""
    measured_rad: float
    """Course that the vehicle reports."""
    last_rad: float | None
    """Heading that was commanded last; None after a reset."""
    towards_rad: float | None
    """Heading at which the turn is to end in later steps; None if that is not known."""


def commanded_rad(turn: Turn) -> float:
    """Return the heading to command, in [0, 2 pi): where the step ends, or beyond it if the vehicle lags behind.

    A turn leads if it is to go on after the step: towards `towards_rad` or, where that is not known, if it is as great
    as a step allows. To the prediction the lead makes no difference: in a step the vehicle turns by no more than
    `most_rad`.
    """
    tip_rad, turn_rad = turn.tip_rad, turn.turn_rad
    side = math.copysign(1.0, turn_rad)
    if turn.towards_rad is not None:
        beyond_rad = side * math.remainder(turn.towards_rad - tip_rad - turn_rad, math.tau)
        # What is far to the other side is reached by the longer way round, on the side that was begun.
        beyond_rad += math.tau if beyond_rad < -MOST_LEAD_RAD else 0.0
    else:
        beyond_rad = math.inf if abs(turn_rad) >= turn.most_rad - TURN_TOLERANCE_RAD else 0.0
    ahead_rad = 0.0 if turn.last_rad is None else side * math.remainder(turn.last_rad - tip_rad, math.tau)
    lead_rad = abs(turn_rad)
    if ahead_rad > LEAST_LEAD_RAD:
        room_rad = MOST_LEAD_RAD - side * math.remainder(tip_rad - turn.measured_rad, math.tau)
        lead_rad = max(lead_rad, min(ahead_rad + lead_rad, lead_rad + beyond_rad, room_rad))
    return (tip_rad + side * lead_rad) % math.tau
