"""The option `--ui` of the commands that may serve a page, with or without an address."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click

from groundstation.web.address import DEFAULT_ADDRESS


def ui_option(what: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the decorator that adds the option as the argument `ui`; `what` it does is the help's first words."""
    return click.option(
        "--ui",
        is_flag=False,
        flag_value=DEFAULT_ADDRESS,
        metavar="[HOST:PORT]",
        help=f"{what}; on {DEFAULT_ADDRESS} if no address follows.",
    )
