"""The page's files keep to what makes it safe: text goes in as text, nothing is inline or comes from elsewhere."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import groundstation.web

PAGE = Path(groundstation.web.__file__).parent / "page"
SCRIPTS = sorted(PAGE.glob("*.js"))


@pytest.mark.parametrize("path", SCRIPTS, ids=lambda path: path.name)
def test_no_script_puts_text_in_as_html_or_code(path: Path) -> None:
    ways_in = (
        r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|createContextualFragment|DOMParser|\beval\b|Function\("
    )
    assert re.findall(ways_in, path.read_text(encoding="utf-8")) == []


def test_the_page_has_no_inline_script_or_style_and_asks_only_its_own_server() -> None:
    text = (PAGE / "index.html").read_text(encoding="utf-8")
    assert re.findall(r"<script(?![^>]*\bsrc=)|<style|\sstyle=|\son[a-z]+=", text) == []
    addresses = re.findall(r"""(?:src|href)="([^"]*)\"""", text)
    assert [address for address in addresses if not address.startswith(("/", "#", "data:,"))] == []


def test_every_script_is_loaded_by_another_or_by_the_page() -> None:
    text = "".join(path.read_text(encoding="utf-8") for path in (*SCRIPTS, PAGE / "index.html"))
    assert [path.name for path in SCRIPTS if f"/{path.name}" not in text] == []


def test_no_line_of_a_script_is_longer_than_elsewhere() -> None:
    long = [
        f"{path.name}:{number}"
        for path in SCRIPTS
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if len(line) > 120
    ]
    assert long == []
