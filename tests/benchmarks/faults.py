"""Flies every fault and every death of a companion with every kind of autopilot, for the tables of docs/faults.md.

python tests/benchmarks/faults.py [--write]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path

from sim.faults.scene import DEMANDED, KINDS
from sim.faults.table import DEAD_PARAMETERS, FAULTS, RESTART_S, Dead, Row, dies, fly

PAGE = Path(__file__).parents[2] / "docs" / "faults.md"
HEAD_ROWS = 2
"""Rows at the head of a Markdown table: the titles, and the line under them."""
MOST_EVENTS = 6
"""Greatest number of events that are printed for one flight."""
_LOCKED = "; nothing is sent until it is disarmed or cleared by a signal"


def main() -> None:
    """Print both tables as Markdown, or put them between their marks in the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="into docs/faults.md instead of printing")
    parser.add_argument("--first", type=int, help="only this many rows of each table, printed")
    options = parser.parse_args()
    rows = None if options.first is None else HEAD_ROWS + options.first
    tables = {"faults": "\n".join(islice(_faults(), rows)), "dead": "\n".join(islice(_deaths(), rows))}
    if not options.write or rows is not None:
        print("\n\n".join(tables.values()))
        return
    text = PAGE.read_text(encoding="utf-8")
    for name, table in tables.items():
        mark = f"<!-- {name} -->"
        before, _, after = text.split(mark)
        text = f"{before}{mark}\n{table}\n{mark}{after}"
    PAGE.write_text(text, encoding="utf-8")


def _faults() -> Iterator[str]:
    yield "| fault | kind | what the companion does, and after how many seconds | to disc, m | to fence, m | back, s |"
    yield "|---|---|---|---|---|---|"
    for fault in FAULTS:
        title = fault.title
        for kind in fault.kinds:
            row = fly(fault, kind)
            cells = (title, kind, _events(row), _metres(row.disc_m), _metres(row.fence_m), _back(row))
            yield f"| {' | '.join(cells)} |"
            title = ""


def _events(row: Row) -> str:
    events = [f"{t_s:.1f} {_short(words)}" for t_s, words in row.events]
    return "; ".join(events[:MOST_EVENTS]) + ("; ..." if len(events) > MOST_EVENTS else "")


def _short(words: str) -> str:
    locked = " (locked)" if _LOCKED in words else ""
    return ": ".join(words.replace(_LOCKED, "").split(": ")[:2]) + locked


def _metres(length_m: float) -> str:
    return "" if math.isinf(length_m) else f"{length_m:.1f}"


def _back(row: Row) -> str:
    return "no" if row.normal_after_s is None else f"{row.normal_after_s:.1f}"


def _deaths() -> Iterator[str]:
    yield (
        "| kind | parameters | companion | last setpoint, s | mode left, s | stopped or turned, s | farthest, m "
        "| height lost, m | at the end, m/s |"
    )
    yield "|---|---|---|---|---|---|---|---|---|"
    for kind in KINDS:
        for parameters in DEAD_PARAMETERS[kind]:
            yield _death(kind, parameters, "killed, or its machine dead", dies(kind, parameters))
            if kind.endswith("plane"):
                yield _death(kind, parameters, "the same in a turn", dies(kind, parameters, turning=True))
        demanded = DEMANDED[kind]
        yield _death(kind, demanded, "hung", dies(kind, hangs=True))
        if kind == "px4-copter":
            yield _death(kind, demanded, "hung, setpoints through MAVSDK's child", dies(kind, hangs=True, child=True))
        again = dies(kind, restarts=True)
        told = "waits for a person" if again.resumed_s is None else f"steers again after {again.resumed_s:.1f} s"
        yield _death(kind, demanded, f"killed, started again after {RESTART_S:g} s: {told}", again)


def _death(kind: str, parameters: Mapping[str, float], how: str, dead: Dead) -> str:
    values = ", ".join(f"{name} {value:g}" for name, value in parameters.items()) or "as it comes"
    cells = (
        *(kind, values, how),
        f"{max(dead.last_setpoint_s, 0.0):.1f}",
        "" if dead.off_mode_s is None else f"{dead.off_mode_s:.1f}",
        "never" if dead.turned_off_s is None else f"{dead.turned_off_s:.1f}",
        f"{dead.farthest_m:.0f}",
        f"{dead.lost_height_m:.0f}",
        f"{dead.speed_m_s:.1f}",
    )
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
