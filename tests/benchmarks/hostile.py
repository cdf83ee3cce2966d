"""The hostile-traffic bench at length: `python -m tests.benchmarks.hostile 10000000` from the root.

A third of the datagrams is sent under each kind of trust: MAVLink signing, Ed25519, both. Prints progress, what was
sent and why it was refused. The exit status is 1 if anything that is not genuine was accepted, if a genuine frame sent
in its order was not, or if memory grew by more than GROWTH_MB; an exception ends the run with a traceback.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections import Counter

from tests.companion.protocol.hostile import AUTHENTICATIONS, run

GROWTH_MB = 8.0
"""Growth of the resident memory that is allowed after the first WARM datagrams of a kind of trust."""
WARM = 50_000
PROGRESS_S = 10.0


def main() -> int:
    """Run the bench; return the exit status."""
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("count", type=int, nargs="?", default=300_000, help="datagrams in all")
    arguments.add_argument("--seed", type=int, default=1)
    options = arguments.parse_args()
    began_s = time.monotonic()
    each = options.count // len(AUTHENTICATIONS)
    sent: Counter[str] = Counter()
    totals: Counter[str] = Counter()
    grown_mb = 0.0
    for place, authentication in enumerate(AUTHENTICATIONS):
        grown_mb = max(grown_mb, _one(authentication, each, options.seed + place, sent, totals, began_s))
    passed_s = time.monotonic() - began_s
    print("hostile datagrams by kind: " + ", ".join(f"{kind} {count}" for kind, count in sent.most_common()))
    lost = totals["genuine"] - totals["accepted"]
    is_good = totals["forged"] == 0 and lost == 0 and grown_mb < GROWTH_MB
    each_us = time.process_time() / options.count * 1e6
    print(
        f"{'passed' if is_good else 'FAILED'}: {sent.total()} hostile datagrams and {totals['genuine']} genuine frames "
        f"in {passed_s:.0f} s ({each_us:.1f} us of processor each, with their making): "
        f"{totals['forged']} forged accepted, {lost} genuine lost, no exception, memory grew by {grown_mb:.1f} MB; "
        f"besides, {totals['late']} genuine frames came late and {totals['twice']} twice, which are refused"
    )
    return 0 if is_good else 1


def _one(authentication: str, count: int, seed: int, sent: Counter[str], totals: Counter[str], began_s: float) -> float:
    """Run one kind of trust, add to the counts, and return by how many MB memory grew."""
    warm_mb: float | None = None
    said_s = time.monotonic()
    for outcome in run(count, authentication, seed):
        passed = outcome.sent.total() + outcome.genuine
        if warm_mb is None and passed >= min(WARM, count // 2):
            warm_mb = resident_mb()
        if time.monotonic() - said_s > PROGRESS_S:
            said_s = time.monotonic()
            print(
                f"{authentication}: {passed} of {count}, {said_s - began_s:.0f} s, forged {outcome.forged}, "
                f"genuine {outcome.accepted} of {outcome.genuine}, {resident_mb():.1f} MB",
                flush=True,
            )
    sent.update(outcome.sent)
    for name in ("genuine", "accepted", "forged", "late", "twice"):
        totals[name] += getattr(outcome, name)
    reasons = ", ".join(f"{reason} {number}" for reason, number in outcome.rejected.most_common())
    print(f"{authentication}: refused: {reasons}", flush=True)
    return resident_mb() - (warm_mb or 0.0)


def resident_mb() -> float:
    """Return the memory of this process that is in use, MB."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


if __name__ == "__main__":
    sys.exit(main())
