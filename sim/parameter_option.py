"""The option `--param NAME=VALUE` of `sim vehicle` and `sim fly`: parameters of the stand-ins' autopilot."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import click


def parameter_option() -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return the decorator that adds the option as the argument `parameters`, pairs of a name and a value."""
    return click.option(
        "--param",
        "parameters",
        multiple=True,
        callback=_parsed,
        metavar="NAME=VALUE",
        help="A parameter of the autopilot's that shall be other than it comes; may be given several times.",
    )


def _parsed(
    _context: click.Context, parameter: click.Parameter, values: tuple[str, ...]
) -> tuple[tuple[str, float], ...]:
    parsed = []
    for text in values:
        name, _, value = text.partition("=")
        try:
            parsed.append((name, float(value)))
        except ValueError as error:
            raise click.BadParameter(f"'{text}' is not NAME=VALUE", param=parameter) from error
    return tuple(parsed)
