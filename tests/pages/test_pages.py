"""The project's pages are right: what they and the code cite exists, links work, the list of modules is up to date."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from tests.pages.citations import DOCS, ROOT, Citation, citations, cited_files, places, rules
from tests.pages.modules import PAGE, module_paths, page_with_list

PAGES = sorted(DOCS.glob("*.md"))
AT_THE_ROOT = sorted(ROOT.glob("*.md"))
NUMBERED = {"method.md": 5}
"""Number of sections of each page whose sections are numbered."""


def cited() -> list[Citation]:
    """Return every citation in the project's files."""
    return [each for path in cited_files() for each in citations(str(path.relative_to(ROOT)), path.read_text())]


def anchor(heading: str) -> str:
    """Return the anchor that Markdown viewers give a heading."""
    plain = re.sub(r"[^\w\- ]", "", heading.replace("`", "").lower())
    return plain.strip().replace(" ", "-")


def anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings."""
    return {anchor(line.lstrip("#")) for line in page.read_text().splitlines() if re.match(r"#+ ", line)}


def test_every_page_that_is_cited_exists() -> None:
    known = {path.name for path in (*PAGES, *AT_THE_ROOT)} | {"arena.md", "reproduce.md"}
    lost = {(each.source, each.page) for each in cited() if each.page not in known}
    assert not lost, f"no such page: {sorted(lost)}"


def test_every_section_and_point_that_is_cited_exists() -> None:
    found = {path.name: places(path.read_text()) for path in PAGES}
    lost = [each for each in cited() if each.section and (each.section, each.point) not in found[each.page]]
    assert not lost


def test_every_rule_that_is_cited_exists() -> None:
    found = {path.name: rules(path.read_text()) for path in PAGES}
    lost = [each for each in cited() if each.rule and each.rule not in found[each.page]]
    assert not lost


@pytest.mark.parametrize(("page", "count"), NUMBERED.items())
def test_sections_and_their_points_are_numbered_without_a_gap(page: str, count: int) -> None:
    found = places((DOCS / page).read_text())
    assert {section for section, _ in found} == set(range(1, count + 1))
    for section in range(1, count + 1):
        points = sorted(point for each, point in found if each == section)
        assert points == list(range(len(points)))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("see docs/method.md section 2, point 4.", [(2, 4, 0)]),
        ("(docs/method.md sections 1 and 3)", [(1, 0, 0), (3, 0, 0)]),
        ("(docs/method.md section 1, points 3 to 5)", [(1, 3, 0), (1, 4, 0), (1, 5, 0)]),
        ("# docs/method.md section 2,\n# point 1 and section 4;", [(2, 1, 0), (4, 0, 0)]),
        ("(docs/method.md section 1, point 2 and section 2, point 2;", [(1, 2, 0), (2, 2, 0)]),
        ("[method.md](method.md) section 3", [(3, 0, 0)]),
        ("docs/design.md, rule 6)", [(0, 0, 6)]),
    ],
)
def test_a_citation_is_read_in_every_form_that_is_used(text: str, expected: list[tuple[int, int, int]]) -> None:
    found = [(each.section, each.point, each.rule) for each in citations("here", text)]
    assert found == [(0, 0, 0), *expected]


def test_links_between_the_documents_lead_somewhere() -> None:
    for page in (*PAGES, *AT_THE_ROOT):
        for target, _, heading in re.findall(r"\]\(([^)#:]*)(#([^)]*))?\)", page.read_text()):
            path = page.parent / target if target else page
            assert path.exists(), f"{page.name} links to {target}"
            assert not heading or heading in anchors(path), f"{page.name} links to {target}#{heading}"


def test_the_architecture_page_names_every_module() -> None:
    page = PAGE.read_text()
    assert page == page_with_list(page), "run: python -m tests.pages.modules --write"


def test_every_page_stands_in_the_navigation_once() -> None:
    navigation = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]
    named = re.findall(r"[a-z0-9_-]+\.md", yaml.safe_dump(navigation))
    assert sorted(named) == [path.name for path in PAGES]


@pytest.mark.parametrize("page", [*PAGES, *AT_THE_ROOT], ids=lambda path: path.name)
def test_modules_and_tests_that_a_page_names_by_their_path_exist(page: Path) -> None:
    named = set(
        re.findall(r"\b(?:companion|groundstation|sim|tests)/[A-Za-z0-9_/]+\.(?:py|txt|yaml)\b", page.read_text())
    )
    assert [path for path in sorted(named) if not (ROOT / path).exists()] == []


@pytest.mark.parametrize("page", [*PAGES, *AT_THE_ROOT], ids=lambda path: path.name)
def test_modules_that_a_page_calls_with_python_m_exist(page: Path) -> None:
    for dotted in re.findall(r"python -m ((?:companion|groundstation|sim|tests)[a-z_.]*[a-z_])", page.read_text()):
        path = ROOT / dotted.replace(".", "/")
        assert path.with_suffix(".py").exists() or (path / "__main__.py").exists(), f"{page.name} calls {dotted}"


def test_todays_words_of_the_glossary_are_the_codes() -> None:
    table = (DOCS / "glossary.md").read_text().split("<!-- renamed -->")[1]
    named = {name for row in table.splitlines() for name in re.findall(r"`([^`]+)`", row.rpartition(" | ")[2])}
    classes = {name for path in module_paths() for name in re.findall(r"^class (\w+)", path.read_text(), re.MULTILINE)}
    lost = [name for name in sorted(named) if name not in classes and not (ROOT / name).exists()]
    assert not lost
