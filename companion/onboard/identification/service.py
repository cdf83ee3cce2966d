"""Shell of `companion identify`: flies the pattern or reads a flight log, prints the table, and writes the limits."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path

import click

from companion.autopilot.kinds import KINDS
from companion.errors import EXIT_DONE, EXIT_FAILED, InputError
from companion.files.state import write_state_file
from companion.files.tlog import Tlog
from companion.files.yaml import read_text_file, with_numbers
from companion.onboard.authority import State
from companion.onboard.config import Config, packaged_configs, parse_config, read_config
from companion.onboard.identification.estimators import identify
from companion.onboard.identification.identifier import End, Identifier
from companion.onboard.identification.table import HEADING, Row, obedience_shown, remedies, rows
from companion.onboard.identification.track import Track, track_of
from companion.onboard.limits import within
from companion.onboard.log_files import LogFiles, files_of
from companion.onboard.log_folder import VehicleLog
from companion.onboard.service import run_companion
from companion.protocol.authenticator import Authenticator

NOT_FLOWN = End("it was stopped before the pattern was flown", complete=False)


async def fly_pattern(config: Config, stop: asyncio.Event) -> tuple[End, list[Row]]:
    """Fly the pattern once the vehicle is handed over; return how it ended and the table of what its log says.

    Raises:
        InputError: a link cannot be opened, or a key or state file cannot be used.

    """
    flown: list[Identifier] = []

    def build(configured: Config, authenticator: Authenticator, was: State) -> Identifier:
        flown.append(Identifier(configured, authenticator, was, stop.set))
        return flown[0]

    # What was flown is measured from a copy in memory: the disk may take no logs, or there may be none.
    copy = BytesIO()
    # By another name than a log of `companion run`: a replay decides as that does.
    log = VehicleLog("identify", copy)
    folder = await run_companion(config, stop, build, log)
    if folder is not None and (path := folder / f"identify-{config.agent_id}.tlog").exists():
        click.echo(f"log: {path}")
    copy.seek(0)
    return flown[0].end or NOT_FLOWN, table_of(Tlog(copy, "the pattern's log"), config)


def table_of(records: Iterable[tuple[float, bytes]], config: Config) -> list[Row]:
    """Return the table of what a log's records (t_unix_s, frame) say of the vehicle of a configuration."""
    return _table(track_of(records, config), config)


def table_of_log(log: str, name: str) -> list[Row]:
    """Return the table of what the log of a flight says of the vehicle of a configuration, read without its links.

    Raises:
        InputError: the configuration or the log cannot be read, it names no autopilot, or the log is of another one.

    """
    config = read_config(name)
    if config.autopilot is None:
        raise InputError(f"{name}: autopilot: missing; a log is read as that of its kind, so give autopilot.kind")
    records = LogFiles(files_of(log))
    track = track_of(records, config)
    records.tell()
    if track.refusal is not None:
        raise InputError(f"{log}: {track.refusal}")
    return _table(track, config)


def _table(track: Track, config: Config) -> list[Row]:
    assert config.autopilot is not None
    can_stop = KINDS[config.autopilot.kind].can_stop
    limits = within(config.limits, track.abilities)
    return rows(identify(track, limits, can_stop), limits, can_stop, config.arrival_radius_m)


def report(end: End | None, table: list[Row]) -> int:
    """Print the table, and how the pattern ended if it was flown; return the exit status."""
    click.echo(HEADING.rstrip())
    for row in table:
        click.echo(row.text)
    if end is not None:
        click.echo(f"ended: {end.words}")
    worse = sum(row.worse for row in table)
    shown = obedience_shown(table)
    if shown:
        measured = sum(row.shown for row in table)
        click.echo(f"{measured} of {len(table)} measured, {worse or 'none'} worse than reckoned with")
    else:
        click.echo(f"the {'log' if end is None else 'flight'} shows nothing of how the vehicle obeys")
    failed = worse or not shown or (end is not None and not end.complete)
    return EXIT_FAILED if failed else EXIT_DONE


def check_writable(name: str) -> None:
    """Raise InputError if a configuration is a packaged one, which cannot be written."""
    if name in packaged_configs():
        raise InputError(f"--write: '{name}' is a packaged configuration; allowed: a file of your own")


def write_limits(name: str, end: End | None, table: list[Row]) -> None:
    """Write the values that the table asks for into the `limits` of a configuration's file.

    What a pattern shows that was not flown to its end (`end`, None for a log) is not written.

    Raises:
        InputError: the file cannot be read, rewritten or written, or would break a rule.

    """
    if end is not None and not end.complete:
        click.echo("nothing is written: the pattern was not flown to its end")
        return
    path, values = Path(name), remedies(table)
    if not values:
        click.echo("nothing to write")
        return
    text = read_text_file(path)
    before = parse_config(text, name)
    written = with_numbers(text, "limits", values, name)
    after = parse_config(written, name)
    if after != before.model_copy(update={"limits": before.limits.model_copy(update=values)}):
        raise InputError(f"{name}: limits: cannot be rewritten as they stand; set them by hand: {_words(values)}")
    # Where the name is a link, the file that it stands for is written.
    write_state_file(path.resolve(), written)
    click.echo(f"written into {name}: {_words(values)}")


def _words(values: dict[str, float]) -> str:
    return ", ".join(f"limits.{key} {value:g}" for key, value in values.items())
