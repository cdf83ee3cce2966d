"""The command `sim fly`: flies one mission in lockstep and writes its results to a folder."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.table import Table

from companion.autopilot.missions import load_mission_to_fly
from companion.errors import EXIT_DONE, EXIT_FAILED, InputError, nearest_hint, tell
from companion.guidance.settings import DEFAULT_LAW, LAWS, LawName
from companion.mission.model import Mission, dump_mission
from companion.mission.resolve import resolve
from companion.onboard.lint.warnings import lint_flight
from groundstation.choices import RADIOS_BYTES_PER_S
from groundstation.radio import Radio, parse_radio
from sim.flown import KINEMATIC, FlownMission
from sim.lockstep import AUTOPILOTS, WHY_NOT_MONOLITHIC, Flight, FlightOptions, check_flyable, fly
from sim.scaling import scaled
from sim.score import score
from sim.terminal import flight_progress, rendered, writable_folder

MAX_SEED = 2**63 - 1


@dataclass(frozen=True)
class FlyOptions:
    """The options of `sim fly`, as given."""

    mission: str
    seed: int
    law: str
    autopilot: str
    vehicles: int | None
    out: Path | None
    radio: str | None
    share: float | None
    one_radio: bool
    no_scale: bool
    realtime: bool
    allow_monolithic: bool

    def command_line(self, radio: Radio | None) -> str:
        """Return the command line that repeats the flight; `radio` is the parsed `--radio`, None if there is none."""
        again = f"sim fly {self.mission} --seed {self.seed} --law {self.law} --autopilot {self.autopilot}"
        again += "" if self.vehicles is None else f" --vehicles {self.vehicles}"
        again += "" if radio is None else f" --radio '{self.radio}' --share {radio.share:g}"
        return again + " --one-radio" * self.one_radio + " --no-scale" * self.no_scale


@dataclass(frozen=True)
class FlownResult:
    """A flight that is over, and its figures."""

    flown: FlownMission
    result: dict[str, Any]
    """The content of `result.json`."""


@click.command("fly")
@click.argument("mission")
@click.option(
    "--seed", type=click.IntRange(0, MAX_SEED), default=1, show_default=True, help="What is drawn, and moves."
)
@click.option("--law", default=DEFAULT_LAW, show_default=True, help=f"Guidance law: {', '.join(LAWS)}.")
@click.option("--autopilot", default="kinematic", show_default=True, help=f"Stand-in: {', '.join(AUTOPILOTS)}.")
@click.option("--vehicles", type=click.IntRange(1, 2_000), help="Fly this many agents instead of the mission's number.")
@click.option("--out", type=click.Path(path_type=Path), help="Folder for trajectory, logs, pictures and report.")
@click.option("--json", "as_json", is_flag=True, help="Print result.json instead of the table.")
@click.option(
    "--radio", metavar="NAME", help=f"Broadcast over a radio's budget: {', '.join(RADIOS_BYTES_PER_S)}, or B/s."
)
@click.option("--share", type=float, help="Of the radio's bytes, for the broadcast; all unless said otherwise.")
@click.option("--one-radio", is_flag=True, help="The broadcast reaches each companion through its autopilot.")
@click.option("--no-scale", is_flag=True, help="Fly the mission as it is: it was made for the autopilot's vehicle.")
@click.option("--realtime", is_flag=True, help="Pace the virtual clock by the wall clock.")
@click.option("--allow-monolithic", is_flag=True, help="Fly `surrogate: monolithic` all the same, to see it fail.")
def fly_command(as_json: bool, **options: Any) -> int:  # noqa: ANN401 click gives each option its type
    """Fly MISSION, a YAML file or a packaged name, over real frames on a virtual clock.

    Missions are written for the paper's 60 m/s: for an autopilot's stand-in every length and speed is multiplied by
    its cruise speed over that, and mission.yaml says by how much.

    Exit status 0 if every target was reached, 1 if not, 2 for unusable input or a folder that cannot be written.

    Example: sim fly paper-dynamic --seed 1 --out runs/1

    Example: sim fly paper-dynamic --autopilot arduplane --seed 1 --out runs/2
    """
    chosen = FlyOptions(**options)
    done = fly_mission(chosen)
    tell(json.dumps(done.result) if as_json else _table(done, chosen.out))
    scored = done.flown.score
    return EXIT_DONE if scored.targets_reached == scored.targets else EXIT_FAILED


def fly_mission(options: FlyOptions) -> FlownResult:
    """Fly a mission as the options say; with `out`, write the folder of its results.

    Raises:
        InputError: an option or the mission is unusable, or the folder cannot be written.

    """
    law = _law(options.law)
    radio = _radio(options)
    if options.autopilot not in AUTOPILOTS:
        hint = nearest_hint(options.autopilot, AUTOPILOTS)
        raise InputError(f"--autopilot: '{options.autopilot}'{hint}; allowed: {', '.join(AUTOPILOTS)}")
    mission = _resolved(options, law)
    folder = None if options.out is None else writable_folder(options.out)
    if folder is not None:
        # The plots' library is loaded only if needed, but before the flight, so that a missing one is reported at once.
        from sim.fly_folder import write_folder

        # Written first, so that an interrupted flight leaves its mission.
        (folder / "mission.yaml").write_text(dump_mission(mission), encoding="utf-8")
    with flight_progress(len(mission.targets)) as progress:
        flight = fly(
            mission,
            options.seed,
            FlightOptions(
                law=law,
                autopilot=options.autopilot,
                out=folder,
                realtime=options.realtime,
                progress=progress,
                allow_monolithic=options.allow_monolithic,
                radio=radio,
                one_radio=options.one_radio,
            ),
        )
    scored = score(flight.trajectory, mission)
    flown = FlownMission(mission, flight.trajectory, scored, options.seed, law, _stand_in(mission, options.autopilot))
    result = result_of(flown, flight)
    if folder is not None:
        write_folder(folder, flown, result, options.command_line(radio))
    return FlownResult(flown, result)


def result_of(flown: FlownMission, flight: Flight) -> dict[str, Any]:
    """Return the content of `result.json` (docs/outputs.md explains each figure)."""
    figures: dict[str, Any] = flown.score.to_dict()
    quantiles = np.percentile(flight.decision_us, [50, 99, 99.9, 100]) if flight.decision_us.size else [0.0] * 4
    return {
        "seed": flown.seed,
        "law": flown.law,
        **figures,
        "steps": flight.steps,
        "guard_interventions": flight.guard_interventions,
        "turn_limited_steps": flight.turn_limited_steps,
        "decision_us": {
            name: round(float(value), 1)
            for name, value in zip(("median", "p99", "p999", "max"), quantiles, strict=True)
        },
        "broadcast_bytes": flight.broadcast_bytes,
        "broadcast_frames": flight.broadcast_frames,
        "frames_lost": flight.frames_lost,
        "speedup": round(flight.speedup, 1),
    }


def _law(name: str) -> LawName:
    chosen = next((law for law in LAWS if law == name), None)
    if chosen is not None:
        return chosen
    raise InputError(f"--law: '{name}'{nearest_hint(name, LAWS)}; allowed: {', '.join(LAWS)}")


def _radio(options: FlyOptions) -> Radio | None:
    """Return the radio that the options name, None if they name none."""
    if options.radio is None:
        if options.share is not None:
            raise InputError(f"--share: {options.share:g} without --radio; allowed: with --radio NAME")
        return None
    radio = parse_radio(options.radio, 1.0 if options.share is None else options.share)
    if options.one_radio and not radio.wrapped:
        raise InputError(
            f"--one-radio: with --radio {options.radio}; allowed: --radio {options.radio}/v2ext, as the autopilot needs"
        )
    return radio


def _resolved(options: FlyOptions, law: LawName) -> Mission:
    """Return the mission to fly, resolved from the seed and scaled, after printing the warnings about it."""
    source = options.mission
    mission = load_mission_to_fly(source)
    if options.vehicles is not None:
        mission = _with_vehicles(mission, options.vehicles, source)
    resolved = resolve(mission, options.seed, source)
    resolved = resolved if options.no_scale else scaled(resolved, options.autopilot, source)
    check_flyable(resolved, source, options.allow_monolithic)
    if resolved.surrogate == "monolithic":
        click.echo(f"sim: warning: {source}: surrogate: 'monolithic' should not fly: {WHY_NOT_MONOLITHIC}", err=True)
    for warning in lint_flight(resolved, law, (options.autopilot,), source):
        click.echo(f"sim: warning: {source}: {warning}", err=True)
    return resolved


def _with_vehicles(mission: Mission, count: int, source: str) -> Mission:
    listed = mission.agents[:count]
    draw = mission.draw.model_copy(update={"agents": count - len(listed)})
    targets = len(mission.targets) + mission.draw.targets
    if count < targets:
        raise InputError(f"{source}: --vehicles: {count}; allowed: at least as many as its {targets} targets")
    return mission.model_copy(update={"agents": listed, "draw": draw})


def _stand_in(mission: Mission, autopilot: str) -> str:
    """Return which vehicles flew, in words for reports and figures."""
    if autopilot == "kinematic":
        return KINEMATIC
    return f"{autopilot} stand-ins" + ("" if mission.scale is None else f", scale {mission.scale.factor:.4g}")


def _table(done: FlownResult, folder: Path | None) -> str:
    table = Table()
    table.add_column("figure")
    table.add_column("value", justify="right")
    for name, value in _summary(done.result):
        table.add_row(name, value)
    flown = done.flown
    files = "report.html, paths.png, result.json, trajectory.csv, mission.yaml, *.tlog, companion-*.yaml"
    return rendered(
        [f"{flown.mission.name}, seed {flown.seed}, law {flown.law}; {flown.stand_in}"],
        table,
        [] if folder is None else [f"written to {folder}: {files}"],
    )


def _summary(result: dict[str, Any]) -> list[tuple[str, str]]:
    separation_m = result["min_separation_m"]
    return [
        ("targets reached", f"{result['targets_reached']} of {result['targets']}"),
        ("agents arrived", str(result["arrived"])),
        ("flight time", f"{result['flight_time_s']:.1f} s"),
        ("entries into R_d / R_a", f"{result['threat_entries_detection']} / {result['threat_entries_attack']}"),
        ("worst depth in R_d", f"{result['worst_depth_m']:.1f} m"),
        ("separation breaches", str(result["separation_breaches"])),
        ("least separation", "-" if separation_m is None else f"{separation_m:.1f} m"),
        ("turn-limited steps", str(result["turn_limited_steps"])),
        ("guard interventions", str(result["guard_interventions"])),
        ("decision median / p99", f"{result['decision_us']['median']:.0f} / {result['decision_us']['p99']:.0f} us"),
        ("broadcast", f"{result['broadcast_frames']} frames, {result['broadcast_bytes']} bytes"),
        ("frames lost, over all agents", str(result["frames_lost"])),
        ("speed", f"{result['speedup']:.0f} x real time"),
    ]
