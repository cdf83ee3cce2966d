"""The command `sim fly`: flies one mission in lockstep and writes its results to a folder."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np
from rich.table import Table

from companion.autopilot.missions import load_mission_to_fly
from companion.errors import EXIT_DONE, EXIT_FAILED, InputError, nearest_hint, tell
from companion.guidance.settings import DEFAULT_LAW, LAWS, LawName
from companion.mission.model import Mission, dump_mission
from companion.mission.resolve import resolve
from companion.mission.sources import SourceSpec
from companion.onboard.lint.fleet import abilities_of
from companion.onboard.lint.warnings import lint_flight
from groundstation.choices import RADIOS_BYTES_PER_S
from groundstation.radio import Radio, parse_radio
from groundstation.web.ui_option import ui_option
from sim.changes import with_all_things
from sim.flight_files import EVENTS_NAME, MISSION_NAME
from sim.flown import KINEMATIC, FlownMission
from sim.lockstep import AUTOPILOTS, WHY_NOT_MONOLITHIC, Flight, FlightOptions, check_flyable, fly
from sim.outcome import AgentResult, agent_results, first_reason
from sim.pace import FASTEST, SLOWEST, Pace
from sim.parameter_option import parameter_option
from sim.scaling import check_speeds, scaled
from sim.score import score
from sim.stop import Stop, stop_at_signals
from sim.terminal import flight_progress, rendered, writable_folder

MAX_SEED = 2**63 - 1
if TYPE_CHECKING:
    from sim.ui import SimScreen

MOST_AGENTS = 20
"""Number of agents, the first of the mission, in the printed table; `result.json` and report have all."""


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
    parameters: tuple[tuple[str, float], ...]
    scale: bool
    realtime: bool
    allow_monolithic: bool
    speed: float | None = None
    """Virtual seconds in one of the wall clock; None: as many as the computer manages, or with `realtime` one."""
    ui: str | None = None
    """Address of the page; None: there is none."""
    tracks: tuple[str, ...] = ()
    """Recorded tracks that are heard as live sources, FILE[,KEY=VALUE...]."""

    @property
    def pace(self) -> float | None:
        """Virtual seconds in one of the wall clock; None: as many as the computer manages."""
        return self.speed or (1.0 if self.realtime else None)

    def command_line(self, radio: Radio | None) -> str:
        """Return the command line that repeats the flight; `radio` is the parsed `--radio`, None if there is none."""
        again = f"sim fly {self.mission} --seed {self.seed} --law {self.law} --autopilot {self.autopilot}"
        again += "" if self.vehicles is None else f" --vehicles {self.vehicles}"
        again += "" if radio is None else f" --radio '{self.radio}' --share {radio.share:g}"
        again += "".join(f" --param {name}={value:g}" for name, value in self.parameters)
        again += "".join(f" --tracks '{tracks}'" for tracks in self.tracks)
        return again + " --one-radio" * self.one_radio + " --scale" * self.scale


@dataclass(frozen=True)
class FlownResult:
    """A flight that is over, and its figures."""

    flown: FlownMission
    agents: tuple[AgentResult, ...]
    """What became of each agent, in file order."""
    result: dict[str, Any]
    """The content of `result.json`."""
    stop: Stop | None
    """Why the flight was ended early; None if it flew to its end."""

    @property
    def failure(self) -> str | None:
        """The first reason why not every target was reached, as one line; None if all were."""
        if self.flown.score.targets_reached == self.flown.score.targets:
            return None
        return first_reason(self.flown, self.agents)


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
@click.option(
    "--scale/--no-scale",
    default=False,
    help="Multiply every length and speed by the autopilot's cruise speed over 60 m/s; as written unless asked for.",
)
@parameter_option()
@click.option("--realtime", is_flag=True, help="Pace the virtual clock by the wall clock.")
@click.option("--speed", type=click.FloatRange(SLOWEST, FASTEST), help="Pace it by so many times the wall clock.")
@ui_option("Serve the page on the flight")
@click.option(
    "--tracks",
    multiple=True,
    metavar="FILE[,KEY=VALUE...]",
    help="Play recorded tracks (CSV, or .jsonl) as a live source, docs/sources.md; such as aircraft.csv,radius_m=500.",
)
@click.option("--allow-monolithic", is_flag=True, help="Fly `surrogate: monolithic` all the same, to see it fail.")
def fly_command(as_json: bool, **options: Any) -> int:  # noqa: ANN401 click gives each option its type
    """Fly MISSION, a YAML file or a packaged name, over real frames on a virtual clock.

    It is flown as it is written, as `groundstation run` broadcasts it. One that was written for the paper's 60 m/s is
    flown by an autopilot's stand-in with --scale: every length and speed is then multiplied by the stand-in's cruise
    speed over that, and mission.yaml says by how much.

    Exit status 0 if every target was reached, 1 if not, and then the last line says why, 2 for unusable input or a
    folder that cannot be written. Ctrl-C (130), SIGTERM (143) and SIGHUP (129) end the flight early, and so does a full
    disk (2): what was flown until then is scored, drawn and kept.

    With --ui what is done on the page is done in the flight, and kept in DIR/events.jsonl; the page stays after the
    flight, until Ctrl-C, unless --out writes a folder from a pipe.

    Example: sim fly paper-dynamic --seed 1 --out runs/1

    Example: sim fly paper-dynamic --realtime --ui

    Example: sim fly paper-dynamic --autopilot arduplane --scale --seed 1 --out runs/2
    """
    chosen = FlyOptions(**options)
    with _screen(chosen) as screen:
        done = fly_mission(chosen, screen)
        tell(json.dumps(done.result) if as_json else _table(done, chosen.out))
        if screen is not None and done.stop is None and (chosen.out is None or sys.stdout.isatty()):
            _linger(screen)
    return _status(done, as_json)


def _status(done: FlownResult, as_json: bool) -> int:
    """Return the exit status, after saying what went wrong."""
    if done.stop is not None:
        click.echo(f"sim: ended early, after {done.flown.score.flight_time_s:g} s of flight: {done.stop.why}", err=True)
        return done.stop.status
    if done.failure is None:
        return EXIT_DONE
    if as_json:
        click.echo(f"sim: {done.failure}", err=True)
    return EXIT_FAILED


def _tracks(mission: Mission, options: FlyOptions) -> tuple[SourceSpec, ...]:
    """Return the live sources that the options name; raises InputError."""
    if not options.tracks:
        return ()
    # The libraries of live sources are loaded only where there are some.
    from sim.tracks import track_specs

    return track_specs(mission, options.tracks, options.mission)


@contextmanager
def _screen(options: FlyOptions) -> Iterator[SimScreen | None]:
    """Open the page if one is asked for, say where it is, and close it in the end.

    Raises:
        InputError: nothing can be served at that address.

    """
    if options.ui is None:
        yield None
        return
    # The page's libraries are loaded only for who looks.
    from sim.ui import open_screen

    screen, url = open_screen(options.ui, Pace(options.pace, wall_s=time.monotonic()))
    click.echo(f"sim: page: {url}", err=True)
    try:
        yield screen
    finally:
        screen.close()


def _linger(screen: SimScreen) -> None:
    from sim.ui import linger

    click.echo("sim: the flight is over; the page stays until Ctrl-C", err=True)
    with stop_at_signals() as stop:
        linger(screen, stop)


def fly_mission(options: FlyOptions, screen: SimScreen | None = None) -> FlownResult:
    """Fly a mission as the options say; with `out`, write the folder of its results; with a `screen`, show it there.

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
        from sim.fly_folder import clear_folder, write_folder

        # Written first, so that a flight that is killed leaves its mission, and no results of an earlier one.
        (folder / MISSION_NAME).write_text(dump_mission(mission), encoding="utf-8")
        clear_folder(folder)
    with stop_at_signals() as stop, flight_progress(len(mission.targets)) as progress:
        flight = fly(
            mission,
            options.seed,
            FlightOptions(
                law=law,
                autopilot=options.autopilot,
                out=folder,
                speed=options.pace,
                screen=screen,
                tracks=_tracks(mission, options),
                progress=progress,
                allow_monolithic=options.allow_monolithic,
                radio=radio,
                one_radio=options.one_radio,
                parameters=options.parameters,
                stop=stop,
            ),
        )
        if screen is not None:
            screen.end()
        flown = _flown(mission, flight, options, law)
        agents = agent_results(flown, flight.logs)
        result = result_of(flown, flight, agents)
        if folder is not None:
            write_folder(folder, flown, result, flight.logs, options.command_line(radio))
    return FlownResult(flown, agents, result, flight.stop)


def _flown(mission: Mission, flight: Flight, options: FlyOptions, law: LawName) -> FlownMission:
    mission = with_all_things(flight.changes) if flight.changes else mission
    return FlownMission(
        mission,
        flight.trajectory,
        score(flight.trajectory, mission, flight.changes),
        options.seed,
        law,
        _stand_in(mission, options.autopilot),
        None if flight.stop is None else flight.stop.why,
        flight.changes,
    )


def result_of(flown: FlownMission, flight: Flight, agents: Sequence[AgentResult]) -> dict[str, Any]:
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
        "ended_early": flown.ended_early,
        "agents": [agent.to_dict() for agent in agents],
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
    """Return the mission to fly, resolved from the seed, scaled if asked for, after printing the warnings about it."""
    source = options.mission
    mission = load_mission_to_fly(source)
    if options.vehicles is not None:
        mission = _with_vehicles(mission, options.vehicles, source)
    resolved = resolve(mission, options.seed, source)
    if options.scale:
        resolved = scaled(resolved, options.autopilot, source)
    else:
        check_speeds(resolved, options.autopilot, abilities_of(options.autopilot, options.parameters), source)
    check_flyable(resolved, source, options.allow_monolithic)
    if resolved.surrogate == "monolithic":
        click.echo(f"sim: warning: {source}: surrogate: 'monolithic' should not fly: {WHY_NOT_MONOLITHIC}", err=True)
    if resolved.sources:
        click.echo(f"sim: warning: {source}: sources: not heard in the simulator; allowed: --tracks FILE", err=True)
    for warning in lint_flight(resolved, law, (options.autopilot,), source, options.parameters):
        click.echo(f"sim: warning: {source}: {warning}", err=True)
    return resolved


def _with_vehicles(mission: Mission, count: int, source: str) -> Mission:
    listed = mission.agents[:count]
    draw = mission.draw.model_copy(update={"agents": count - len(listed)})
    targets = len(mission.targets) + mission.draw.targets
    if count < targets and not mission.queue:
        raise InputError(
            f"{source}: --vehicles: {count}; allowed: at least as many as its {targets} targets, or `queue: true` in it"
        )
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
    text = rendered([f"{flown.mission.name}, seed {flown.seed}, law {flown.law}; {flown.stand_in}"], table, [])
    shown = done.agents[:MOST_AGENTS]
    left = len(done.agents) - len(shown)
    after = [f"and {left} more: see result.json (--out or --json)"] if left else []
    if folder is not None:
        files += f", {EVENTS_NAME}" if (folder / EVENTS_NAME).exists() else ""
        after.append(f"written to {folder}: {files}")
    # The reason that decided comes last, where a script or a hurried reader looks for it.
    after += [] if done.failure is None else [done.failure]
    return text + "\n" + rendered([], _agent_table(shown), after)


def _agent_table(agents: Sequence[AgentResult]) -> Table:
    table = Table()
    table.add_column("agent", justify="right")
    table.add_column("what became of it", overflow="fold")
    for agent in agents:
        table.add_row(str(agent.score.id), "\n".join(_became(agent)))
    return table


def _became(agent: AgentResult) -> list[str]:
    """Return what became of an agent, in lines of a table."""
    scored, log = agent.score, agent.log
    certified = f"certified at the start: {agent.certificate_at_start}"
    if log.loss is not None:
        certified += f"; from {log.loss.t_s:g} s on: {log.loss.certificate} ({log.loss.why})"
    broken = ", ".join(f"{name} {broken.times} x from {broken.first_t_s:g} s" for name, broken in log.broken.items())
    nearest = [
        f"{what} {near.distance_m:.1f} m at {near.t_s:.0f} s ({whose} {near.id})"
        for what, near, whose in (
            ("R_d", scored.nearest_detection, "threat"),
            ("R_a", scored.nearest_attack, "threat"),
            ("another", scored.nearest_agent, "agent"),
        )
        if near is not None
    ]
    entries = f"entries {scored.threat_entries_detection} / {scored.threat_entries_attack}"
    lines = [f"{agent.outcome}: {agent.reason}", certified, f"broken: {broken}" if broken else ""]
    lines.append("; ".join((f"nearest: {', '.join(nearest)}", entries)) if nearest else "")
    return [line for line in lines if line]


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
