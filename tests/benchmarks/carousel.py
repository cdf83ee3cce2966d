"""Whether an erasure code would bring the static parts of the broadcast to everybody sooner than sending them in turn.

Prints, for K parts and independent losses, the expected number of carousel frames until a receiver that begins to
listen at any moment knows all parts, and the number after which 99.9 % of receivers do: for parts sent in turn, and for
an ideal code of which any K frames suffice (no real code needs fewer). Because the parts are useful alone, it also
prints the expected number until a given part is known. All numbers are computed exactly, none is drawn at random.

Run: python tests/benchmarks/carousel.py
"""

from __future__ import annotations

import math
from collections.abc import Callable

from companion.mission.model import Mission, ThreatSpec, load_mission
from companion.protocol.codec import Stamp
from companion.protocol.fleet_codec import MISSION_HEAD_BYTES, RADII_HEAD_BYTES, data_bytes
from groundstation.broadcast import mission_frame, radii_frames
from groundstation.revision import first_revision
from groundstation.tracks import TrackTable

LOSSES = (0.0, 0.1, 0.3, 0.5)
PATH_BYTES = 252
"""Greatest frame on the link."""
OVERHEADS_BYTES = {"MAVLink signing": 13, "Ed25519": 64, "both": 77}
"""Bytes that signatures add to a frame, by kind of signature."""
CURRENT_SHARE = 0.999
"""Share of the receivers whose number of frames is printed as a quantile."""
NEGLIGIBLE = 1.0e-12
"""Probability below which the sums end."""


def in_turn(sent: int, parts: int, loss: float) -> float:
    """Return the probability that all parts are known after `sent` frames."""
    rounds, more = divmod(sent, parts)
    return float((1.0 - loss ** (rounds + 1)) ** more * (1.0 - loss**rounds) ** (parts - more))


def coded(sent: int, parts: int, loss: float) -> float:
    """Return the probability that at least `parts` of `sent` frames have arrived."""
    return 1.0 - sum(
        math.comb(sent, heard) * (1.0 - loss) ** heard * loss ** (sent - heard) for heard in range(min(parts, sent + 1))
    )


def expected(complete: Callable[[int], float]) -> float:
    """Return the expected number of frames until complete, given the probability of it after a number of frames."""
    total, sent = 0.0, 0
    while (missing := 1.0 - complete(sent)) > NEGLIGIBLE:
        total, sent = total + missing, sent + 1
    return total


def quantile(complete: Callable[[int], float]) -> int:
    """Return the number of frames after which CURRENT_SHARE of the receivers are complete."""
    sent = 0
    while complete(sent) < CURRENT_SHARE - NEGLIGIBLE:
        sent += 1
    return sent


def until_one(parts: int, loss: float) -> float:
    """Return the expected number of frames until a given part is known, if the parts are sent in turn.

    It is half a round, and the rounds in which the part is lost.
    """
    return (parts + 1) / 2.0 + parts * loss / (1.0 - loss)


def needed_parts() -> dict[str, int]:
    """Return the number of parts of the mission frame and of the radii of 50 threats together, by kind of signature."""
    threats = tuple(
        ThreatSpec(id=k, north_m=0.0, east_m=0.0, detection_radius_m=10_000.0, attack_radius_m=5_000.0)
        for k in range(1, 51)
    )
    mission = Mission.model_construct(**{**dict(load_mission("paper-static")), "threats": threats})
    stamp = Stamp(1_790_000_000, 0, 1)
    revision = first_revision(mission, TrackTable(mission, stamp.unix_s, None), 1)
    parts = {}
    for name, overhead_bytes in OVERHEADS_BYTES.items():
        radii = radii_frames(mission, revision, stamp, data_bytes(RADII_HEAD_BYTES, PATH_BYTES, overhead_bytes))
        mission_frame(mission, revision, bytes(8), stamp, data_bytes(MISSION_HEAD_BYTES, PATH_BYTES, overhead_bytes))
        parts[name] = 1 + len(radii)
    return parts


def main() -> None:
    """Print the comparison."""
    needed = needed_parts()
    print("parts of a mission with 50 threats:", ", ".join(f"{parts} with {name}" for name, parts in needed.items()))
    print("frames until known          all: expected      all: 99.9 %     one: expected")
    print(" K  loss                 in turn     coded  in turn  coded     in turn")
    for parts in sorted({1, 2, 4, *needed.values()}):
        for loss in LOSSES:
            turn = lambda sent, k=parts, p=loss: in_turn(sent, k, p)  # noqa: E731
            code = lambda sent, k=parts, p=loss: coded(sent, k, p)  # noqa: E731
            print(
                f"{parts:2d}  {loss:4.0%}  {'':12s} {expected(turn):9.2f} {expected(code):9.2f} {quantile(turn):8d} "
                f"{quantile(code):6d} {until_one(parts, loss):11.2f}"
            )


if __name__ == "__main__":
    main()
