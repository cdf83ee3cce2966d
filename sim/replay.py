"""The command `sim replay`: plays a folder of `sim fly --out` on the page."""

from __future__ import annotations

from pathlib import Path

import click

from groundstation.web.address import DEFAULT_ADDRESS


@click.command("replay")
@click.argument("folder", metavar="DIR", type=click.Path(path_type=Path))
@click.option("--ui", default=DEFAULT_ADDRESS, show_default=True, metavar="HOST:PORT", help="Where the page is served.")
def replay_command(folder: Path, ui: str) -> None:
    """Play DIR, a folder that `sim fly --out DIR` wrote, on the page: what was true, and what each vehicle knew.

    Example: sim replay runs/1
    """
    from groundstation.store.playback_page import serve_playback
    from sim.replayed import FlownFolder

    serve_playback(FlownFolder(folder), ui, "sim")
