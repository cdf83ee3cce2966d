"""The pictures of the page in the documents, taken by Chromium.

`python -m tests.web.screenshots` takes them into a new folder below the temporary one, `--write` into docs/images. A
person looks at them: no test can tell whether a page is ugly.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from playwright.sync_api import Browser, Page, ViewportSize, expect

from groundstation.web.pipe import Message
from tests.web.pictures import moves, valley, valley_events, valley_routes
from tests.web.rig import NARROW, WIDE, Stage, Tab, chromium, served

IMAGES = Path(__file__).parents[2] / "docs" / "images"
TABLET: ViewportSize = {"width": 820, "height": 1180}
_SETTLED_S = 0.4
"""Time for which the page may draw before it is photographed."""


class Shot(NamedTuple):
    """A picture: its name, the size and theme of the screen, and what is pressed before."""

    name: str
    size: ViewportSize = WIDE
    theme: str = "light"
    press: tuple[str, ...] = ()


_FIRST_AGENT = "#agents-table .pick >> nth=0"
_GHOST = "#agents-table .pick >> nth=1"
SHOTS = (
    Shot("wide", press=(_FIRST_AGENT,)),
    Shot("ghost", press=(_GHOST,)),
    Shot("dark", theme="dark", press=("#tab-threats", "#threats-table .pick >> nth=1")),
    Shot("contrast", theme="contrast", press=(_FIRST_AGENT,)),
    Shot("broadcast", press=("#tab-broadcast",)),
    Shot("sources", press=("#tab-sources",)),
    Shot("events", press=("#tab-events",)),
    Shot("warnings", press=("#tab-warnings",)),
    Shot("add-threat", press=("#tab-threats", "#form-threat")),
    Shot("signs", press=("details:has-text('Signs') summary",)),
    Shot("tablet", size=TABLET, press=("#tab-agents", _FIRST_AGENT)),
    Shot("narrow-map", size=NARROW),
    Shot("narrow-agents", size=NARROW, press=("#tab-agents",)),
    Shot("narrow-agent", size=NARROW, press=("#tab-agents", _GHOST)),
    Shot("narrow-events", size=NARROW, press=("#tab-events",)),
    Shot("narrow-form", size=NARROW, press=("#tab-threats", "#form-threat")),
    Shot("narrow-contrast", size=NARROW, theme="contrast", press=("#tab-agents", _FIRST_AGENT, "#tab-map")),
)
PRINTED = ("wide", "ghost", "contrast", "events", "add-threat", "narrow-map", "narrow-agents")
"""Names of the pictures that the documents show."""


@contextmanager
def _shown(browser: Browser, url: str, shot: Shot) -> Iterator[Page]:
    tab = Tab(browser, url, shot.size)
    try:
        expect(tab.page.locator("#mission")).to_have_text("valley")
        tab.page.select_option("#theme", shot.theme)
        for selector in shot.press:
            tab.page.click(selector)
        time.sleep(_SETTLED_S)
        yield tab.page
    finally:
        tab.close()


def take(folder: Path, shots: tuple[Shot, ...] = SHOTS) -> list[Path]:
    """Take pictures into a folder and return their paths."""
    shown = valley()
    stage = Stage(lambda command: command)
    messages: list[Message] = [shown, *valley_events(), valley_routes(), moves(shown, shown["t_s"] + 0.2)]
    stage.show(*messages)
    paths = []
    with served(stage) as url, chromium() as browser:
        for shot in shots:
            stage.show(shown)
            with _shown(browser, url, shot) as page:
                paths.append(folder / f"page-{shot.name}.png")
                page.screenshot(path=paths[-1])
    return paths


def main() -> None:
    """Take all pictures, or write those that the documents show."""
    if sys.argv[1:] == ["--write"]:
        taken = take(IMAGES, tuple(shot for shot in SHOTS if shot.name in PRINTED))
    else:
        taken = take(Path(tempfile.mkdtemp(prefix="page-")))
    print(*taken, sep="\n")


if __name__ == "__main__":
    main()
