"""The `groundstation` command line."""

from __future__ import annotations

import click

from companion.adapters import ADAPTERS
from companion.doubts import doubts
from companion.drawing import resolve
from companion.errors import InputError, nearest_hint, run_program
from companion.mission import load_mission
from companion.process import run_until_signal
from companion.transport import parse_link
from groundstation.core import check_runnable
from groundstation.service import run_groundstation


@click.group()
@click.version_option(package_name="oneway-guidance")
def cli() -> None:
    """Broadcast who goes where and where the threats are, and never be answered: the command centre.

    Example: groundstation run copter-demo --link udpout:127.0.0.1:14600
    """


@cli.command()
@click.argument("mission")
@click.option("--link", required=True, metavar="URL", help="Where to broadcast: udpout:HOST:PORT.")
@click.option(
    "--sensor", metavar="URL", help="Where detections come in: udpin:HOST:PORT. Without it nobody is tracked."
)
@click.option("--uplink", metavar="URL", help="Case II: where agents' reports come in: udpin:HOST:PORT.")
@click.option(
    "--autopilot", default="kinematic", show_default=True, help=f"Case II: what is reckoned: {', '.join(ADAPTERS)}."
)
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=1, show_default=True, help="For what is drawn.")
def run(mission: str, link: str, sensor: str | None, uplink: str | None, autopilot: str, seed: int) -> None:
    """Broadcast MISSION, a YAML file or a packaged name, until interrupted.

    Example: groundstation run copter-demo --link udpout:127.0.0.1:14600
    """
    if autopilot not in ADAPTERS:
        hint = nearest_hint(autopilot, ADAPTERS)
        raise InputError(f"--autopilot: '{autopilot}'{hint}; allowed: {', '.join(ADAPTERS)}")
    resolved = resolve(load_mission(mission), seed, mission)
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
    for doubt in doubts(resolved):
        click.echo(f"groundstation: warning: {mission}: {doubt}", err=True)
    to = parse_link(link)
    seen_on, heard_on = (None if url is None else parse_link(url) for url in (sensor, uplink))
    can_stop = ADAPTERS[autopilot]().can_stop
    run_until_signal(lambda stop: run_groundstation(resolved, to, seen_on, heard_on, can_stop, stop))


def main() -> None:
    """Run the `groundstation` program."""
    run_program(cli, "groundstation")
