"""The commands of `groundstation` that work on a mission at the desk, before anything is broadcast.

Each command imports what it needs itself, so that `--help` prints at once.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Unpack

import click

from companion.autopilot.kinds import KINDS
from companion.errors import EXIT_DONE, EXIT_FAILED, printable, tell
from groundstation.choices import SIGNED

if TYPE_CHECKING:
    from groundstation.check.command import CheckArguments
    from groundstation.fleet.command import FleetArguments
    from groundstation.imports.command import ImportArguments


@click.command("fleet")
@click.argument("mission")
@click.option(
    "--out", required=True, metavar="DIR", help="Folder for configurations, keys and the list of what goes where."
)
@click.option("--fleet", metavar="FILE", help="The fleet file: docs/fleet.md. Without it all vehicles are alike.")
@click.option("--keys", metavar="DIR", help="Trust the keys in DIR, and put each vehicle's beside its configuration.")
@click.option("--unsigned", is_flag=True, help="Trust anybody: the broadcast is not signed.")
@click.option("--auth", metavar="WORD", help=f"With --keys: {', '.join(SIGNED)}; both unless said otherwise.")
@click.option("--link", metavar="URL", help="Where a vehicle hears the broadcast, if FILE does not say.")
@click.option("--autopilot", metavar="KIND", help=f"Its kind, if FILE does not say: {', '.join(KINDS)}.")
@click.option("--autopilot-link", metavar="URL", help="Its autopilot, if FILE does not say; {id} is the vehicle's id.")
@click.option("--uplink", metavar="URL", help="Case II: where its reports go, if FILE does not say.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=1, show_default=True, help="For what is drawn.")
def fleet_command(**given: Unpack[FleetArguments]) -> None:
    """Write each vehicle's configuration and keys.

    MISSION is a YAML file or a packaged name. What vehicles and ground station must agree on comes from the
    mission; a fleet file that says otherwise is refused.

    Example: groundstation fleet copter-field --fleet fleet.yaml --keys keys --out fleet

    Example: groundstation fleet copter-demo --unsigned --autopilot arducopter --link udpin:0.0.0.0:14600
    --autopilot-link serial:/dev/ttyACM0:115200 --out fleet
    """
    from groundstation.fleet.command import write

    for path in write(given):
        click.echo(str(path))


@click.command("import")
@click.argument("file")
@click.option("--out", metavar="FILE", help="Write the mission there instead of printing it.")
@click.option("--home", metavar="LAT,LON[,ALT]", help="Where the vehicles start; else the file's home.")
@click.option("--autopilot", metavar="KIND", help="What flies, if not what the file says.")
@click.option("--agents", type=click.IntRange(1, 1_000), default=1, show_default=True, help="How many start at home.")
def import_command(**given: Unpack[ImportArguments]) -> None:
    """Make a mission of another program's FILE.

    It is a plan of QGroundControl, KML or GeoJSON. The fence comes from the inclusion, exclusions and threats
    from what is to be kept out of, targets from way points.
    What was left out is said on standard error. docs/mission.md has the rules.

    Example: groundstation import survey.plan > mission.yaml
    """
    from groundstation.imports.command import imported

    text, notes = imported(given)
    for note in notes:
        click.echo(printable(f"groundstation: {given['file']}: {note}"), err=True)
    if given["out"] is None:
        click.echo(text, nl=False)


@click.command("check")
@click.argument("mission")
@click.option("--autopilot", metavar="KIND", help=f"What flies it: {', '.join(KINDS)}; else only what holds for all.")
@click.option("--out", metavar="FILE", help="Also a picture, FILE.png or FILE.svg (needs pip install '.[sim]').")
@click.option("--json", "as_json", is_flag=True, help="Print it as JSON.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=1, show_default=True, help="For what is drawn.")
def check_command(**given: Unpack[CheckArguments]) -> int:
    """Show a mission and what is doubtful about it.

    All places of MISSION, a YAML file or a packaged name, are shown in metres and in degrees, with every
    warning. Exit status 0 if there is no warning, 1 if there is one, 2 for a mission that cannot be flown.

    Example: groundstation check copter-field --autopilot arducopter --out field.png
    """
    from groundstation.check.command import checked
    from groundstation.check.text import overview_text

    found = checked(given)
    tell(json.dumps(found.to_dict(), allow_nan=False) if given["as_json"] else overview_text(found))
    return EXIT_FAILED if found.warnings else EXIT_DONE


MISSION_COMMANDS: tuple[click.Command, ...] = (check_command, fleet_command, import_command)
