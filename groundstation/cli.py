"""The `groundstation` command line."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Column, Table

from companion.autopilot.kinds import KINDS
from companion.autopilot.missions import load_mission_to_fly
from companion.errors import InputError, nearest_hint, run_program, tell
from companion.mission.lint import lint
from companion.mission.model import Mission
from companion.mission.resolve import resolve
from companion.protocol.keys import MAVLINK_NAME, PUBLIC_NAME
from companion.protocol.keys import keygen as write_keys
from companion.runtime.clock import run_until_signal
from companion.transport.endpoints import Link, parse_link
from groundstation.ground_station import check_runnable
from groundstation.plan import AUTHENTICATIONS, BURSTS, Authentication, Plan
from groundstation.plan import plan as make_plan
from groundstation.radio import RADIOS_BYTES_PER_S, Radio, parse_radio
from groundstation.service import STATE_NAME, Options, run_groundstation

RADIO_HELP = f"{', '.join(RADIOS_BYTES_PER_S)}, or bytes per second; /v2ext after it: through an autopilot."
WordT = TypeVar("WordT", bound=str)
_TABLE_COLUMNS = 200
_SIGNED: tuple[Authentication, ...] = ("both", "ed25519", "mavlink")


@click.group()
@click.version_option(package_name="oneway-guidance")
def cli() -> None:
    """Broadcast who goes where and where the threats are, and never be answered: the command centre.

    Example: groundstation run copter-demo --link udpout:127.0.0.1:14600 --unsigned
    """


@cli.command()
@click.argument("mission")
@click.option(
    "--link", required=True, metavar="URL", help="Where to broadcast: udpout:HOST:PORT and others, docs/links.md."
)
@click.option("--keys", metavar="DIR", help="Sign with the keys in DIR, which `groundstation keygen DIR` makes.")
@click.option("--unsigned", is_flag=True, help="Sign nothing: anybody can then speak for the centre.")
@click.option("--auth", metavar="WORD", help=f"With --keys: {', '.join(_SIGNED)}; both unless said otherwise.")
@click.option("--radio", "radio_name", metavar="NAME", help=f"Keep to a radio's budget: {RADIO_HELP}")
@click.option("--share", type=float, help="Of the radio's bytes, for the broadcast; all unless said otherwise.")
@click.option(
    "--state",
    metavar="FILE",
    help=f"What a restart needs of this run is kept there; {STATE_NAME} beside the keys if not given.",
)
@click.option("--log", metavar="FILE.tlog", help="Keep what is sent and heard; FILE-2.tlog if there is one.")
@click.option("--mirror", metavar="URL", help="Show threats and reckoned agents as ADSB_VEHICLE there, once a second.")
@click.option(
    "--sensor", metavar="URL", help="Where detections come in: udpin:HOST:PORT. Without it nobody is tracked."
)
@click.option("--uplink", metavar="URL", help="Case II: where agents' reports come in: udpin:HOST:PORT.")
@click.option(
    "--autopilot", default="kinematic", show_default=True, help=f"Case II: what is reckoned: {', '.join(KINDS)}."
)
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=1, show_default=True, help="For what is drawn.")
def run(
    mission: str,
    link: str,
    keys: str | None,
    unsigned: bool,
    auth: str | None,
    radio_name: str | None,
    share: float | None,
    state: str | None,
    log: str | None,
    mirror: str | None,
    sensor: str | None,
    uplink: str | None,
    autopilot: str,
    seed: int,
) -> None:
    """Broadcast MISSION, a YAML file or a packaged name, until interrupted.

    A line on standard input sets the directive to every vehicle: hold, return, or normal again.

    Example: groundstation run copter-demo --link udpout:127.0.0.1:14600 --unsigned

    Example: groundstation run copter-demo --link serial:/dev/ttyUSB0:57600 --radio sik-57600 --share 0.5 --keys keys
    """
    _one_of("--autopilot", autopilot, tuple(KINDS))
    given = {"MISSION": mission, "--link": link, "--keys": keys, "--state": state, "--log": log}
    _without_null(given | {"--mirror": mirror, "--sensor": sensor, "--uplink": uplink})
    resolved = _broadcastable(mission, seed, uplink)
    to = parse_link(link)
    seen_on, heard_on, shown_on = (None if url is None else parse_link(url) for url in (sensor, uplink, mirror))
    if shown_on is not None and shown_on == to:
        raise InputError(f"--mirror: '{mirror}' is the broadcast's own link; allowed: another port")
    if log is not None and not log.endswith(".tlog"):
        raise InputError(f"--log: '{log}'; allowed: a name that ends in .tlog")
    if state is None and keys is not None:
        state = str(Path(keys) / STATE_NAME)
    options = Options(
        link=to,
        authentication=_authentication(keys, unsigned, auth),
        keys=None if keys is None else Path(keys),
        radio=_radio(to, radio_name, share),
        sensor=seen_on,
        uplink=heard_on,
        mirror=shown_on,
        log=None if log is None else Path(log),
        state=None if state is None else Path(state),
        can_stop=KINDS[autopilot].can_stop,
    )
    for warning in lint(resolved):
        click.echo(f"groundstation: warning: {mission}: {warning}", err=True)
    run_until_signal(lambda stop: run_groundstation(resolved, options, stop))


@cli.command()
@click.argument("folder", metavar="DIR")
def keygen(folder: str) -> None:
    """Make the keys of a fleet in DIR, which only its owner can read; never overwrites one.

    Example: groundstation keygen keys
    """
    _without_null({"DIR": folder})
    for path in write_keys(Path(folder)):
        click.echo(str(path))
    click.echo(
        f"{PUBLIC_NAME} goes to every vehicle, {MAVLINK_NAME} too where MAVLink signing is used; nothing else does"
    )


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
    _without_null({"MISSION": mission})
    authentication = _one_of("--auth", auth, AUTHENTICATIONS)
    radio = parse_radio(radio_name, share)
    resolved = resolve(load_mission_to_fly(mission), seed, mission)
    check_runnable(resolved, mission)
    columns = (TextColumn("planning"), BarColumn(), TimeElapsedColumn())
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task("", total=1.0)
        found = make_plan(resolved, radio, authentication, lambda share: bar.update(task, completed=share))
    tell(json.dumps(found.to_dict(), allow_nan=False) if as_json else _plan_text(found))


def main() -> None:
    """Run the `groundstation` program."""
    run_program(cli, "groundstation")


def _broadcastable(mission: str, seed: int, uplink: str | None) -> Mission:
    resolved = resolve(load_mission_to_fly(mission), seed, mission)
    check_runnable(resolved, mission)
    if resolved.case == "I" and uplink is not None:
        raise InputError(f"{mission}: case: 'I' with --uplink; allowed: II, Case I has no use for reports")
    if resolved.case == "II" and resolved.report_period_s > 0.0 and uplink is None:
        raise InputError(
            f"{mission}: report_period_s: {resolved.report_period_s:g} without --uplink, so that everybody would count "
            "as lost; allowed: --uplink URL, or report_period_s 0"
        )
    if resolved.surrogate == "monolithic":
        raise InputError(f"{mission}: surrogate: 'monolithic' flies only in the simulator; allowed: pairwise, analytic")
    return resolved


def _authentication(keys: str | None, unsigned: bool, auth: str | None) -> Authentication:
    if keys is not None and unsigned:
        raise InputError("--unsigned: given together with --keys; allowed: one of them")
    if keys is None and not unsigned:
        raise InputError(
            "neither --keys nor --unsigned given; allowed: --keys DIR to sign, or --unsigned to sign nothing"
        )
    if unsigned:
        if auth is not None:
            raise InputError(f"--auth: '{auth}' with --unsigned; allowed: only with --keys")
        return "unsigned"
    return _one_of("--auth", auth or "both", _SIGNED)


def _without_null(given: Mapping[str, str | None]) -> None:
    """Refuse arguments that hold a null character, which no name of a file can."""
    for name, text in given.items():
        if text is not None and "\0" in text:
            raise InputError(f"{name}: {text!r} holds a null character; allowed: names without one")


def _radio(link: Link, name: str | None, share: float | None) -> Radio | None:
    if name is None:
        if share is not None:
            raise InputError(f"--share: {share:g} without --radio; allowed: --radio NAME with it")
        if link.scheme == "serial":
            raise InputError(f"--link: '{link}' without --radio, so that nothing would pace it; allowed: --radio NAME")
        return None
    if link.others:
        raise InputError(
            f"--link: '{link}' sends every frame {1 + len(link.others)} times, which --radio {name} does not count; "
            "allowed: one address behind a radio"
        )
    radio = parse_radio(name, 1.0 if share is None else share)
    # Whatever it is, it may listen for a heartbeat before it reports its buffer.
    return replace(radio, heartbeats=True) if link.scheme == "serial" and not radio.wrapped else radio


def _one_of(option: str, word: str, allowed: Sequence[WordT]) -> WordT:
    for known in allowed:
        if word == known:
            return known
    raise InputError(f"{option}: '{word}'{nearest_hint(word, allowed)}; allowed: {', '.join(allowed)}")


def _plan_text(found: Plan) -> str:
    console = Console(soft_wrap=True, highlight=False, markup=False, width=_TABLE_COLUMNS)
    with console.capture() as capture:
        console.print(
            f"{found.mission} over {found.radio}, share {found.share:g}: {found.budget_bytes_per_s:.0f} B/s, "
            f"{found.authentication}; longest frame {found.largest_frame_bytes} bytes on the air\n"
        )
        items = Table("item", *(Column(title, justify="right") for title in ("frames", "every (s)", "copies", "B/s")))
        for item in found.items:
            every = "-" if item.interval_s is None else f"{item.interval_s:.2f}"
            items.add_row(item.name, str(item.frames), every, f"{item.copies:.1f}", f"{item.bytes_per_s:.0f}")
        items.add_row("together", "", "", "", f"{found.bytes_per_s:.0f}")
        console.print(items)
        console.print(f"used: {found.utilisation:.1%} of the budget\n")
        losses = Table("frames lost", Column("99.9 % of agents current after (s)", justify="right"))
        for loss, after_s in found.current_after_s.items():
            losses.add_row(loss, "longer than planned for" if after_s is None else f"{after_s:.1f}")
        console.print(losses)
        console.print(
            f"bursts: {BURSTS.bad_loss:.0%} lost for {BURSTS.bad_s:g} s after {BURSTS.good_s:g} s with "
            f"{BURSTS.good_loss:.0%} lost, on average\n"
        )
        outage = found.outage
        limit = "no limit" if outage.limit_s is None else f"{outage.limit_s:.0f} s"
        console.print(f"outage without an entry: {limit}: {outage.why}")
        for line in found.left_out:
            console.print(f"does not fit: {line}")
    return capture.get().rstrip("\n")
