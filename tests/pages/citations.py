"""Finds the places in the project's pages that code and pages cite, such as `docs/method.md section 2, point 4`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
SUFFIXES = frozenset({".py", ".md", ".yaml", ".yml", ".toml", ".service", ".html", ".xml", ".j2", ".jinja", ".txt"})
NAMES = frozenset({"Containerfile", "run"})
NUMBERS = r"\d+(?:(?:, \d+)*,? (?:and|to) \d+)?"
PLACE = re.compile(
    rf"[,:;]? ?(?:and |or )?"
    rf"(?:sections? (?P<sections>{NUMBERS})(?:[,;:] ?points? (?P<points>{NUMBERS}))?|rules? (?P<rules>{NUMBERS}))"
)
"""Pattern of one cited place after a page's name; several may follow one another."""
PAGE = re.compile(r"(?:\bdocs/|(?<=[\s(\"'`\[]))(?P<page>[A-Za-z][A-Za-z0-9_-]*\.md)\b(?:\]\([^)]*\))?")
"""Pattern of a page's name, with or without its folder or the target of a Markdown link."""


@dataclass(frozen=True)
class Citation:
    """A place in a page that a file cites; section, point or rule 0 where none is named."""

    source: str
    page: str
    section: int = 0
    point: int = 0
    rule: int = 0


def cited_files() -> list[Path]:
    """Return every file of the project that may cite a page."""
    folders = ("companion", "groundstation", "sim", "tests", "docs", ".ci")
    found = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file()]
    found += [path for path in ROOT.iterdir() if path.is_file()]
    return sorted(path for path in found if path.suffix in SUFFIXES or path.name in NAMES)


def running_text(text: str) -> str:
    """Return a file's text on one line, without comment signs at the beginnings of lines."""
    return " ".join(re.sub(r"^(#:?|//|--) ", "", line.strip()) for line in text.splitlines())


def numbers(text: str | None) -> list[int]:
    """Return the numbers of `2`, `1 and 3`, `3 to 5`; 0 alone where there are none."""
    if not text:
        return [0]
    found = [int(number) for number in re.findall(r"\d+", text)]
    return list(range(found[0], found[-1] + 1)) if " to " in text else found


def citations(source: str, text: str) -> list[Citation]:
    """Return the citations in a text.

    Args:
        source: Where the text stands, for messages.
        text: The text, its lines as they are.

    """
    found: list[Citation] = []
    line = running_text(text)
    for match in PAGE.finditer(line):
        page, end = match["page"], match.end()
        found.append(Citation(source, page))
        while place := PLACE.match(line, end):
            end = place.end()
            found += [
                Citation(source, page, section, point, rule)
                for section in numbers(place["sections"])
                for point in numbers(place["points"])
                for rule in numbers(place["rules"])
            ]
    return found


def places(page: str) -> set[tuple[int, int]]:
    """Return the sections of a page and the numbered points within them, as (section, point), point 0 for the section.

    Args:
        page: The page's text. A section is a heading `## 2. Title`, a point a line that begins with `4. `.

    """
    found: set[tuple[int, int]] = set()
    section = 0
    for line in page.splitlines():
        if heading := re.match(r"## (?:(\d+)\. )?", line):
            section = int(heading[1] or 0)
            found |= {(section, 0)} if section else set()
        elif section and (point := re.match(r"(\d+)\. ", line)):
            found.add((section, int(point[1])))
    return found


def rules(page: str) -> set[int]:
    """Return the numbers of the rules under the heading `## Rules of the air`."""
    _, _, behind = page.partition("## Rules of the air\n")
    return {int(number) for number in re.findall(r"^(\d+)\. ", behind.partition("\n## ")[0], re.MULTILINE)}
