"""The `groundstation` command line.

Each command imports what it needs itself, so that `--help` prints at once.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import click

from companion.autopilot.kinds import ARDUCOPTER, KINDS
from companion.errors import InputError, run_program, tell
from groundstation.choices import AUTHENTICATIONS, RADIOS_BYTES_PER_S, SIGNED, STATE_NAME, one_of, without_null
from groundstation.mission_commands import MISSION_COMMANDS
from groundstation.web.ui_option import ui_option

if TYPE_CHECKING:
    from groundstation.options import RunArguments

RADIO_HELP = f"{', '.join(RADIOS_BYTES_PER_S)}, or bytes per second; /v2ext after it: through an autopilot."


@click.group()
@click.version_option(package_name="oneway-guidance")
def cli() -> None:
    """Broadcast who goes where and where the threats are, and never be answered: the command centre.

    Example: groundstation run copter-demo --link udpout:127.0.0.1:14600 --unsigned
    """


for command in MISSION_COMMANDS:
    cli.add_command(command)


@cli.command()
@click.argument("mission")
@click.option(
    "--link", required=True, metavar="URL", help="Where to broadcast: udpout:HOST:PORT and others, docs/links.md."
)
@click.option("--keys", metavar="DIR", help="Sign with the keys in DIR, which `groundstation keygen DIR` makes.")
@click.option("--unsigned", is_flag=True, help="Sign nothing: anybody can then speak for the centre.")
@click.option("--auth", metavar="WORD", help=f"With --keys: {', '.join(SIGNED)}; both unless said otherwise.")
@click.option("--radio", metavar="NAME", help=f"Keep to a radio's budget: {RADIO_HELP}")
@click.option("--share", type=float, help="Of the radio's bytes, for the broadcast; all unless said otherwise.")
@click.option(
    "--state",
    metavar="FILE",
    help=f"The store: events, and what a restart needs; {STATE_NAME} beside the keys if not given (docs/store.md).",
)
@click.option(
    "--store-mb",
    type=click.FloatRange(1, 1_000_000),
    default=1_000.0,
    show_default=True,
    metavar="MB",
    help="For pictures and frames in the store: the oldest are removed; events never are.",
)
@click.option(
    "--new-flight",
    is_flag=True,
    help="Begin MISSION anew: of the last run only epoch and signing time go on, its events stay in the store.",
)
@click.option("--log", metavar="FILE.tlog", help="Keep what is sent and heard; FILE-2.tlog if there is one.")
@click.option(
    "--log-mb",
    type=click.FloatRange(20, 1_000_000),
    default=1_000.0,
    show_default=True,
    metavar="MB",
    help="For all logs of that name together: the oldest are removed.",
)
@click.option("--mirror", metavar="URL", help="Show threats and reckoned agents as ADSB_VEHICLE there, once a second.")
@click.option(
    "--sensor", metavar="URL", help="Where detections come in: udpin:HOST:PORT. Without it nobody is tracked."
)
@click.option(
    "--source",
    multiple=True,
    metavar="KIND=URL[,KEY=VALUE...]",
    help="A live source beside the mission's, docs/sources.md: basestation=tcp:127.0.0.1:30003,radius_m=800.",
)
@click.option("--uplink", metavar="URL", help="Case II: where agents' reports come in: udpin:HOST:PORT.")
@click.option(
    "--listen",
    metavar="URL",
    help="Where the broadcast itself is heard, to notice another ground station; its own group or subnet if not given.",
)
@click.option("--sensor-error", type=float, default=30.0, show_default=True, help="Greatest error of a detection, m.")
@click.option(
    "--unsigned-inputs",
    is_flag=True,
    help="Believe sensors and reports from other computers unsigned: anybody can then say where things are.",
)
@click.option(
    "--autopilot", default="kinematic", show_default=True, help=f"Case II: what is reckoned: {', '.join(KINDS)}."
)
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=1, show_default=True, help="For what is drawn.")
@ui_option("Serve the page and the API")
@click.option("--ui-tokens", metavar="FILE", help="Let in whoever has a token of `groundstation token --file FILE`.")
@click.option(
    "--ui-cert", metavar="FILE", help="Certificate of the page, PEM: TLS, without which only loopback serves."
)
@click.option("--ui-key", metavar="FILE", help="Private key of that certificate, PEM.")
@click.option("--ui-client-ca", metavar="FILE", help="Let in whoever has a client certificate of this authority, PEM.")
@click.option("--ui-tiles", metavar="DIR", help="Map tiles for the page: DIR/Z/X/Y.png.")
@click.option(
    "--log-format",
    type=click.Choice(["text", "json"]),
    default="text",
    show_default=True,
    help="Of the messages on the terminal: json is one object a line.",
)
def run(**given: Unpack[RunArguments]) -> None:
    """Broadcast MISSION, a YAML file or a packaged name, until interrupted.

    A line on standard input sets the directive to every vehicle: hold, return, or normal again.

    Example: groundstation run copter-demo --link udpout:127.0.0.1:14600 --unsigned

    Example: groundstation run copter-demo --link serial:/dev/ttyUSB0:57600 --radio sik-57600 --share 0.5 --keys keys
    """
    from companion.guidance.settings import DEFAULT_LAW
    from companion.onboard.lint.warnings import lint_flight
    from companion.runtime.clock import run_until_signal
    from companion.runtime.console import messages_as_json, program_logger
    from groundstation.options import run_of
    from groundstation.service import run_groundstation

    mission, options = run_of(given)
    if options.log_format == "json":
        messages_as_json("groundstation")
    # In Case I nobody is reckoned, so what flies is known only to the vehicles.
    kinds = (given["autopilot"],) if mission.case == "II" else (given["autopilot"], ARDUCOPTER.name)
    for warning in lint_flight(mission, DEFAULT_LAW, kinds, given["mission"]):
        program_logger("groundstation").warning("%s: %s", given["mission"], warning)
    run_until_signal(lambda stop: run_groundstation(mission, options, stop))


@cli.command()
@click.argument("folder", metavar="DIR")
@click.option("--agents", metavar="IDS", help="Also a key for the reports of each of these agents: 1-10,12.")
def keygen(folder: str, agents: str | None) -> None:
    """Make the keys of a fleet in DIR, which only its owner can read; never overwrites one.

    With --agents it adds to a folder of keys what these agents' reports need.

    Example: groundstation keygen keys --agents 1-10
    """
    from companion.protocol.keys import MAVLINK_NAME, PUBLIC_NAME
    from groundstation.input_keys import SENSOR_NAME, agents_from, write_keys

    without_null({"DIR": folder})
    for path in write_keys(Path(folder), [] if agents is None else agents_from(agents)):
        click.echo(str(path))
    click.echo(
        f"{PUBLIC_NAME} goes to every vehicle, {MAVLINK_NAME} too where MAVLink signing is used, uplink-N.mavlink to "
        f"agent N, {SENSOR_NAME} to every sensor; nothing else does"
    )


@cli.command()
@click.argument("name")
@click.option("--file", "path", required=True, metavar="FILE", help="Where the tokens' hashes are kept.")
@click.option("--role", default="observer", show_default=True, metavar="WORD", help="observer (looks) or operator.")
@click.option("--revoke", is_flag=True, help="Take NAME's token away; a running ground station follows at once.")
def token(name: str, path: str, role: str, revoke: bool) -> None:
    """Make a token with which NAME may use the page and the API; it is printed once and kept nowhere.

    Example: groundstation token anna --file tokens.json --role operator
    """
    from groundstation.web.pipe import Who
    from groundstation.web.tokens import add_token, revoke_token

    without_null({"NAME": name, "--file": path})
    if revoke:
        revoke_token(Path(path), name)
        click.echo(f"{name}: revoked", err=True)
        return
    secret = add_token(Path(path), Who(name, role))
    click.echo(f"{name}: {role}; the token is shown this once:", err=True)
    tell(secret)


@cli.command("plan")
@click.argument("mission")
@click.option("--link", "radio_name", required=True, metavar="NAME", help=f"The radio: {RADIO_HELP}")
@click.option("--share", type=float, default=1.0, show_default=True, help="Of the radio's bytes, for the broadcast.")
@click.option("--auth", default="both", show_default=True, metavar="WORD", help=f"{', '.join(AUTHENTICATIONS)}.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=1, show_default=True, help="For what is drawn.")
@click.option("--json", "as_json", is_flag=True, help="Print the plan as JSON.")
def plan_command(mission: str, radio_name: str, share: float, auth: str, seed: int, as_json: bool) -> None:
    """Say how often MISSION, a YAML file or a packaged name, can be told over a radio, and how soon everybody knows.

    docs/radio-budget.md explains each figure.

    Example: groundstation plan paper-dynamic --link sik-57600 --share 0.5
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from companion.autopilot.missions import load_mission_to_fly
    from companion.mission.resolve import resolve
    from groundstation.agents import VehicleModel, check_reckonable
    from groundstation.ground_station import check_runnable
    from groundstation.plan import plan
    from groundstation.plan_text import plan_text
    from groundstation.radio import parse_radio

    without_null({"MISSION": mission})
    authentication = one_of("--auth", auth, AUTHENTICATIONS)
    radio = parse_radio(radio_name, share)
    resolved = resolve(load_mission_to_fly(mission), seed, mission)
    check_runnable(resolved, mission)
    if resolved.case == "II":
        check_reckonable(resolved, VehicleModel(), mission)
    columns = (TextColumn("planning"), BarColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("", total=1.0)
        found = plan(resolved, radio, authentication, lambda share: bar.update(task, completed=share))
    tell(json.dumps(found.to_dict(), allow_nan=False) if as_json else plan_text(found))


@cli.command("log")
@click.argument("store", metavar="STORE")
@click.option("--out", metavar="FILE", help="Export to FILE.csv, .json, .tlog or .mcap instead of printing events.")
@click.option("--places", is_flag=True, help="With .csv or .json: where everything was, instead of the events.")
@click.option("--from", "from_time", metavar="TIME", help="Not before: 2026-11-30T08:15:00Z, or Unix seconds.")
@click.option("--to", "to_time", metavar="TIME", help="Not after.")
@ui_option("Play it on the page instead")
def log_command(
    store: str, out: str | None, places: bool, from_time: str | None, to_time: str | None, ui: str | None
) -> None:
    """Print, export or play what STORE, the file of --state, holds; also while a ground station writes to it.

    docs/store.md explains each form.

    Example: groundstation log keys/groundstation.state --out day.mcap
    """
    from groundstation.store.export import Slice
    from groundstation.store.log_command import log_store, play_store, time_of

    without_null({"STORE": store, "--out": out})
    if ui is not None:
        if out is not None or places:
            raise InputError("--ui: with --out or --places; allowed: one of them")
        if from_time is not None or to_time is not None:
            raise InputError("--ui: with --from or --to; allowed: without them: the page goes to any time")
        play_store(Path(store), ui)
        return
    if places and out is None:
        raise InputError("--places: without --out; allowed: with --out FILE.csv or FILE.json")
    time = Slice(time_of(from_time, "--from", 0.0), time_of(to_time, "--to", 1e12))
    log_store(Path(store), time, None if out is None else Path(out), places)


def main() -> None:
    """Run the `groundstation` program."""
    run_program(cli, "groundstation")
