"""The tables of docs/parameters.md, made from companion/autopilot/firmware.py and the adapters.

`python -m tests.pages.parameters` prints them, `--write` puts them into the page.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from pathlib import Path

from companion.autopilot.firmware import ENDINGS, FAMILIES, TABLE, Known, versions
from companion.autopilot.registry import ADAPTERS

PAGE = Path(__file__).parents[2] / "docs" / "parameters.md"
MARK = "<!-- parameters: written by `python -m tests.pages.parameters --write` -->"


def uses() -> dict[tuple[str, str], str]:
    """Return what each parameter is for, by firmware and name: reckoned with, demanded or told."""
    found: dict[tuple[str, str], str] = {}
    for kind, family in FAMILIES.items():
        adapter = ADAPTERS[kind]()
        demanded = {demand.name for demand in adapter.parameter_checks}
        for wanted in adapter.wanted:
            use = "demanded" if wanted.name in demanded else "reckoned with"
            found |= {(family, name): use for name in wanted.names}
        for name in ENDINGS[family]:
            found.setdefault((family, name), "ends the steering")
    return found


def number(value: float) -> str:
    """Return a number as a table shows it; nothing for one without an end."""
    return "" if math.isinf(value) else f"{value:g}"


def row_of(row: Known, use: str) -> str:
    """Return a parameter's line of a table, in which each version has a column."""
    cells = ["x" if row.since <= version <= row.until else "" for version in versions(row.family)]
    bounds = f"{number(row.least)} to {number(row.greatest)}".strip() if number(row.least) else ""
    return f"| {row.name} | {row.unit} | {row.default:g} | {bounds} | {use} | {' | '.join(cells)} |"


def tables() -> Iterator[str]:
    """Yield the lines of the tables, one table for each firmware."""
    use = uses()
    for family in dict.fromkeys(FAMILIES.values()):
        columns = [".".join(map(str, version)) for version in versions(family)]
        yield from (f"## {family}", "")
        yield f"| parameter | unit | as it comes | range | use | {' | '.join(columns)} |"
        yield "|---" * (5 + len(columns)) + "|"
        for row in TABLE:
            if row.family == family:
                yield row_of(row, use.get((family, row.name), "named in remedies"))
        yield ""


def page_with_tables(page: str) -> str:
    """Return the page with the tables as they are now; everything behind the mark is replaced."""
    head, mark, _ = page.partition(MARK)
    if not mark:
        raise ValueError(f"{PAGE.name} has no line {MARK}")
    return f"{head}{MARK}\n\n" + "\n".join(tables())


def main() -> None:
    """Print the tables, or write them into the page."""
    if sys.argv[1:] == ["--write"]:
        PAGE.write_text(page_with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    else:
        print("\n".join(tables()))


if __name__ == "__main__":
    main()
