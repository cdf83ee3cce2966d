"""How far each stand-in strays from the path that guidance and guard assume: `python -m tests.benchmarks.lags`.

For each kind of autopilot this flies turns at the greatest rate through its adapter at 10 Hz, with decisions every 0.5
s. It prints the reaction time with which the assumed path is nearest to the one flown, and how far it is off with the
adapter's own reaction time. The adapters' `REACTION_S`, `LEAD_S` and `TRACKING_M` come from here.
"""

from __future__ import annotations

import argparse

from tests.sim.vehicles.tracking import TURNS_RAD, Flight, off, turned

REACTIONS_S = [0.05 * index for index in range(13)]
FLIGHTS = (
    ("arducopter", 4.0),
    ("arducopter", 8.0),
    ("arduplane", 15.0),
    ("arduplane", 22.0),
    ("px4-copter", 5.0),
    ("px4-copter", 10.0),
    ("px4-plane", 15.0),
)
"""Kind of autopilot and speed (m/s) of each flight."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", metavar="KIND", help="only these")
    kinds = parser.parse_args().kinds
    print("kind        speed   n_max  turn    best reaction: off       with reaction_s: off")
    for kind, speed_m_s in (one for one in FLIGHTS if not kinds or one[0] in kinds):
        for name, turns_rad in TURNS_RAD.items():
            flight = Flight(kind, speed_m_s)
            start_s, rate_rad_s = turned(flight, turns_rad)
            found = [(reaction_s, off(flight, start_s, rate_rad_s, reaction_s)) for reaction_s in REACTIONS_S]
            best_s, best = min(found, key=lambda one: one[1].place_m)
            own_s = flight.adapter.abilities.reaction_s
            own = off(flight, start_s, rate_rad_s, own_s)
            print(
                f"{kind:11s} {speed_m_s:4.0f} m/s {flight.adapter.abilities.n_max:.3f} {name:7s} "
                f"{best_s:.2f} s: {best.place_m:5.2f} m {best.course_deg:4.1f} deg   "
                f"{own_s:.2f} s: {own.place_m:5.2f} m {own.course_deg:4.1f} deg"
            )


if __name__ == "__main__":
    main()
