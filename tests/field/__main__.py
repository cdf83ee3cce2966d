"""Plays every field situation: `python -m tests.field` prints their tables, with `--write` into docs/field.md."""

from __future__ import annotations

import argparse
from pathlib import Path

from tests.field.table import markdown

PAGE = Path(__file__).parents[2] / "docs" / "field.md"
MARK = "<!-- situations -->"


def main() -> None:
    """Print the tables, or write them between the marks of the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true", help="into docs/field.md instead of printing")
    write = parser.parse_args().write
    tables = "\n".join(markdown())
    if not write:
        print(tables)
        return
    before, _, after = PAGE.read_text(encoding="utf-8").split(MARK)
    PAGE.write_text(f"{before}{MARK}\n{tables}\n{MARK}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
