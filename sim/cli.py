"""The `sim` command line.

A command is imported only when it is called, because most commands load libraries for plots and statistics, which
`sim --help` does not need.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import click

from companion.errors import InputError, run_program


@dataclass(frozen=True)
class CommandEntry:
    """The place where a command of `sim` is defined, and the first sentence of its help."""

    module: str
    name: str
    """Name of the click command in the module."""
    summary: str


COMMANDS = {
    "arena": CommandEntry(
        "sim.arena.command",
        "arena_command",
        "Fly our laws and published methods side by side over families of scenes (needs the extra `arena`).",
    ),
    "fly": CommandEntry(
        "sim.fly", "fly_command", "Fly MISSION, a YAML file or a packaged name, over real frames on a virtual clock."
    ),
    "replay": CommandEntry(
        "sim.replay",
        "replay_command",
        "Play DIR, a folder that `sim fly --out DIR` wrote, on the page: what was true, and what each vehicle knew.",
    ),
    "reproduce": CommandEntry(
        "sim.reproduction.command",
        "reproduce_command",
        "Run the paper's experiments again and set what is measured beside what it claims (needs the extra `train`).",
    ),
    "vehicle": CommandEntry("sim.vehicle_service", "vehicle", "One stand-in autopilot in real time."),
}
"""The commands by the name that calls them, in the order of the help."""


class LazyGroup(click.Group):
    """A click group that imports a command only when it is called, and lists all of them without importing any."""

    def __init__(self, **attributes: Any) -> None:  # noqa: ANN401 click's own
        """Name the commands to click, which suggests the nearest of them for a name that is none."""
        summaries = {name: click.Command(name, help=entry.summary) for name, entry in COMMANDS.items()}
        super().__init__(commands=summaries, **attributes)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import and return a command; return None if there is none of that name."""
        entry = COMMANDS.get(cmd_name)
        if entry is None:
            return None
        command: click.Command = getattr(importlib.import_module(entry.module), entry.name)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the list of commands, each with its summary, cut to the width as click does."""
        limit = formatter.width - 6 - max(map(len, COMMANDS))
        rows = [(name, command.get_short_help_str(limit)) for name, command in self.commands.items()]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def invoke(self, ctx: click.Context) -> Any:  # noqa: ANN401 click's own type
        """Call a command.

        Raises:
            InputError: a library that it needs is not installed.

        """
        try:
            return super().invoke(ctx)
        except ModuleNotFoundError as error:
            raise InputError(f"needs {error.name}, which is not installed: pip install '.[sim]'") from error


@click.group(cls=LazyGroup)
@click.version_option(package_name="oneway-guidance")
def cli() -> None:
    """Fly missions in lockstep, or be one autopilot in real time: the stand-in world.

    Example: sim fly paper-dynamic --seed 1 --out runs/1
    """


def main() -> None:
    """Run the `sim` program."""
    run_program(cli, "sim")
