"""Runs the paper's static contrast and dynamic run, less agile vehicles, the training, and flights over the wire.

Every experiment is a list of jobs that share nothing, so they run in any order on as many processes as there are cores;
the results depend on the settings alone, except for the times. A flight on the pure core (`core_flight`) computes the
decisions only; one over the wire (`sim.lockstep`) exchanges encoded frames between the programs.
"""

from __future__ import annotations

import functools
import importlib.util
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from companion.errors import InputError
from companion.mission.model import Mission, load_mission
from companion.mission.resolve import resolve
from sim.lockstep import fly
from sim.reproduction.core_flight import PERFECT_LINK, CoreFlight, CoreLaw, fly_core
from sim.score import Score, score
from sim.trajectory import Trajectory
from sim.worker_pool import outcomes

PAPER_STEP_S = 5.0
"""Time of one iteration (paper, section Simulation: "each iteration is chosen to be 5 s")."""
SAMPLE_S = 1.0
"""Integration step and sampling period of flights at the paper's step: the sensor's period. Arcs are exact, so it
limits only what the samples show."""
FINE_STEP_S = 0.5
"""Guidance and integration step of the packaged missions, for the flights at a fine step."""
N_MAX = (10.0, 2.0, 1.0, 0.5)
"""Load factors of the sweep: the paper's, and those that fixed wings have (docs/method.md section 2, point 6)."""
MIN_SEEDS = 5
"""Least number of flights of an experiment, and how many dynamic flights are flown over the wire too."""
STATIC_SEED, STATIC_STEP, DYNAMIC = "static-seed", "static-step", "dynamic-10"
"""Keys of the series that the paper has: the static contrast under F* and under F, and the dynamic run."""


@dataclass(frozen=True)
class Settings:
    """How much is run; the defaults are the paper's where it states them."""

    seeds: int = 200
    """Flights of each experiment at the paper's step; their seeds count from 1."""
    wire_seeds: int = MIN_SEEDS
    """Number of dynamic flights, those of the first seeds, that are flown over the wire too."""
    fine_seeds: int = 40
    """Flights of each experiment at the fine step, which take ten times as long to compute; never more than `seeds`."""
    samples: int = 100_000
    epochs: int = 1_000
    training_seed: int = 0
    time_limit_s: float | None = None
    """Time limit of a flight where it is shorter than the agents' range allows; None for no other limit."""


@dataclass(frozen=True)
class Series:
    """Flights of one mission and law that differ in their seed alone."""

    key: str
    mission: str
    """Name of the packaged mission."""
    law: CoreLaw
    n_max: float
    guidance_step_s: float
    integration_step_s: float
    seeds: tuple[int, ...]


@dataclass(frozen=True)
class FlightFigures:
    """Figures of one flight on the pure core."""

    seed: int
    steps: int
    time_s: float
    targets_reached: int
    targets: int
    arrived: int
    entries_detection: int
    entries_attack: int
    entered: tuple[int, ...]
    """Ids of the agents that entered a detection radius."""
    worst_depth_m: float
    breaches: int
    """Breaches of the separation, with positions interpolated between the samples."""
    breaches_at_steps: int
    """Breaches that are seen when looking at the guidance steps alone, as the paper does."""
    min_separation_m: float | None
    """Least distance between two agents; None for fewer than two agents."""
    turn_limited: int
    """Number of decisions in which the turn limit was active."""
    decisions: int


@dataclass(frozen=True)
class Training:
    """Figures of a training run that both networks have."""

    neurons: int
    samples: int
    epochs_allowed: int
    epochs_run: int
    train_mse: float
    validation_mse: float
    test_mse: float
    test_target_variance: float
    learning_curve: list[tuple[int, float, float]]  # (epoch, train MSE, validation MSE)


@dataclass(frozen=True)
class Flown:
    """A flight with its trajectory, for figures."""

    mission: Mission
    seed: int
    trajectory: Trajectory
    score: Score
    steps: int


@dataclass(frozen=True)
class WireComparison:
    """The same flight on the pure core and over the wire."""

    seed: int
    targets_core: tuple[int, ...]
    """Ids of the targets reached on the pure core."""
    targets_wire: tuple[int, ...]
    entries_core: tuple[int, int]
    """Entries into detection radii and into attack radii on the pure core."""
    entries_wire: tuple[int, int]
    steps_core: int
    steps_wire: int
    apart_m: float
    """Greatest distance between the two positions of an agent at the same time, until it arrived or a flight ended."""
    apart_agent: int
    apart_t_s: float
    typical_apart_m: float
    """Median over the agents of the greatest distance of each."""
    guard_interventions: int
    """Decisions over the wire that the guard changed; the pure core has no guard."""
    core_us: np.ndarray  # (steps_core,) us, each step's decisions, the centre's included
    wire_us: np.ndarray  # (steps_wire,) us, each step's decisions of all companions, frames included

    @property
    def agrees(self) -> bool:
        """Whether both reached the same targets with the same entries, in numbers of steps that differ by at most 1."""
        return (
            self.targets_core == self.targets_wire
            and self.entries_core == self.entries_wire
            and abs(self.steps_core - self.steps_wire) <= 1
        )


@dataclass(frozen=True)
class Results:
    """Everything that was measured in a reproduction."""

    settings: Settings
    torch_version: str
    monolithic: Training
    pairwise: Training
    series: tuple[Series, ...]
    flights: dict[str, tuple[FlightFigures, ...]]
    """Flights of each series, by its key, in the order of its seeds."""
    wire: tuple[WireComparison, ...]
    static_pair: tuple[Flown, Flown]
    """The same static scene flown with F* and with F."""
    dynamic: Flown
    """The dynamic flight of median length."""

    @property
    def core_step_us(self) -> np.ndarray:
        """Return the time of each step of the compared flights on the pure core, (C,), us."""
        return np.concatenate([comparison.core_us for comparison in self.wire])

    @property
    def wire_step_us(self) -> np.ndarray:
        """Return the time of each step of the compared flights over the wire, (W,), us."""
        return np.concatenate([comparison.wire_us for comparison in self.wire])

    def of(self, key: str) -> tuple[FlightFigures, ...]:
        """Return the flights of the series with a key, in the order of its seeds."""
        return self.flights[key]


@dataclass(frozen=True)
class _FlightJob:
    series: Series
    seed: int
    limit_s: float | None

    def run(self) -> FlightFigures:
        mission = paper_mission(self.series, self.seed, self.limit_s)
        return _figures(mission, self.seed, fly_core(mission, self.seed, self.series.law))


@dataclass(frozen=True)
class _TrainingJob:
    monolithic: bool
    seed: int
    samples: int
    epochs: int

    def run(self) -> tuple[Training, str]:
        # Only here: they need torch, which flights do without.
        from companion.surrogate.training_monolithic import train_monolithic
        from companion.surrogate.training_pairwise import train_pairwise

        train = train_monolithic if self.monolithic else train_pairwise
        _, record = train(self.seed, self.samples, self.epochs)
        figures = Training(
            neurons=record.neurons,
            samples=record.samples,
            epochs_allowed=record.epochs_allowed,
            epochs_run=record.epochs_run,
            train_mse=record.train_mse,
            validation_mse=record.validation_mse,
            test_mse=record.test_mse,
            test_target_variance=record.test_target_variance,
            learning_curve=record.learning_curve,
        )
        return figures, record.torch_version


_Job = _FlightJob | _TrainingJob
_Outcome = FlightFigures | tuple[Training, str]
Progress = Callable[[int, int], None]
"""Function that is called with the number of flights and trainings done and the number of all."""


def all_series(settings: Settings) -> tuple[Series, ...]:
    """Return every experiment on the pure core; the sweep of load factors begins with the paper's dynamic run."""
    seeds = tuple(range(1, settings.seeds + 1))
    fine = seeds[: settings.fine_seeds]
    paper, finer = (PAPER_STEP_S, SAMPLE_S), (FINE_STEP_S, FINE_STEP_S)
    return (
        Series(STATIC_SEED, "paper-static", "seed", N_MAX[0], *paper, seeds),
        Series(STATIC_STEP, "paper-static", "step", N_MAX[0], *paper, seeds),
        *(Series(f"dynamic-{n:g}", "paper-dynamic", "seed", n, *paper, seeds) for n in N_MAX),
        *(Series(f"dynamic-{n:g}-fine", "paper-dynamic", "seed", n, *finer, fine) for n in N_MAX),
    )


def paper_mission(series: Series, seed: int, limit_s: float | None = None) -> Mission:
    """Return a series' mission as drawn from the seed.

    It ends when the agents' range is flown, if not earlier: beyond it the paper's f4 forbids everything. The link is
    perfect, and no agent turns back because of its range.
    """
    drawn = resolve(_packaged(series.mission), seed)
    range_s = min(agent.range_m / agent.speed_m_s for agent in drawn.agents)
    time_s = min(drawn.max_time_s, range_s, np.inf if limit_s is None else limit_s)
    return drawn.model_copy(
        update={
            "agents": tuple(agent.model_copy(update={"n_max": series.n_max}) for agent in drawn.agents),
            "guidance_step_s": series.guidance_step_s,
            "integration_step_s": series.integration_step_s,
            "link": PERFECT_LINK,
            "range_policy": "arrive",
            "max_time_s": float(time_s // series.guidance_step_s * series.guidance_step_s),
        }
    )


@functools.cache
def _packaged(name: str) -> Mission:
    """Return a packaged mission, cached, because parsing it anew would cost each flight a tenth of its time."""
    return load_mission(name)


def check_trainable() -> None:
    """Raise InputError if torch is not installed, before minutes are spent on flights."""
    if importlib.util.find_spec("torch") is None:
        raise InputError("training needs torch, which is not installed: pip install '.[train]'")


def run_all(settings: Settings, workers: int, progress: Progress = lambda done, total: None) -> Results:
    """Run every experiment on `workers` processes, or within this one if `workers` is 0.

    Raises:
        InputError: torch is missing.

    """
    check_trainable()
    series = all_series(settings)
    dynamic = next(each for each in series if each.key == DYNAMIC)
    wire_seeds = dynamic.seeds[: settings.wire_seeds]
    limit_s = settings.time_limit_s
    jobs: list[_Job] = [
        # The longest jobs first, so that no process is left with one at the end.
        _TrainingJob(True, settings.training_seed, settings.samples, settings.epochs),
        _TrainingJob(False, settings.training_seed, settings.samples, settings.epochs),
        *(_FlightJob(each, seed, limit_s) for each in reversed(series) for seed in each.seeds),
    ]
    trainings: dict[bool, Training] = {}
    flights: dict[str, dict[int, FlightFigures]] = defaultdict(dict)
    torch_version = ""
    for done, (job, outcome) in enumerate(outcomes(_run, jobs, workers), start=1):
        if isinstance(job, _TrainingJob) and isinstance(outcome, tuple):
            trainings[job.monolithic], torch_version = outcome
        elif isinstance(job, _FlightJob) and isinstance(outcome, FlightFigures):
            flights[job.series.key][job.seed] = outcome
        progress(done, len(jobs) + len(wire_seeds))
    ordered = {each.key: tuple(flights[each.key][seed] for seed in each.seeds) for each in series}
    # Alone, now that the other processes are done: they would disturb the times that are measured here.
    wire = []
    for seed in wire_seeds:
        wire.append(compare_with_wire(paper_mission(dynamic, seed, limit_s), seed))
        progress(len(jobs) + len(wire), len(jobs) + len(wire_seeds))
    static_seed = illustrative_seed(ordered[STATIC_STEP])
    by_key = {each.key: each for each in series}
    return Results(
        settings=settings,
        torch_version=torch_version,
        monolithic=trainings[True],
        pairwise=trainings[False],
        series=series,
        flights=ordered,
        wire=tuple(wire),
        static_pair=(
            _flown(by_key[STATIC_SEED], static_seed, limit_s),
            _flown(by_key[STATIC_STEP], static_seed, limit_s),
        ),
        dynamic=_flown(dynamic, median_seed(ordered[DYNAMIC]), limit_s),
    )


def illustrative_seed(flights: Sequence[FlightFigures], agents: int = 3) -> int:
    """Return the first seed in which as many agents entered as in the paper's figure, else the first with the most."""
    enough = [flight.seed for flight in flights if len(flight.entered) >= agents]
    return enough[0] if enough else max(flights, key=lambda flight: len(flight.entered)).seed


def median_seed(flights: Sequence[FlightFigures]) -> int:
    """Return the seed of the flight of median length: of an even number the shorter, of equal ones the first."""
    return sorted(flights, key=lambda flight: flight.steps)[(len(flights) - 1) // 2].seed


def _run(job: _Job) -> _Outcome:
    return job.run()


def _flown(series: Series, seed: int, limit_s: float | None) -> Flown:
    mission = paper_mission(series, seed, limit_s)
    flight = fly_core(mission, seed, series.law)
    return Flown(mission, seed, flight.trajectory, score(flight.trajectory, mission), flight.steps)


def _figures(mission: Mission, seed: int, flight: CoreFlight) -> FlightFigures:
    scored = score(flight.trajectory, mission)
    every = round(mission.guidance_step_s / mission.integration_step_s)
    return FlightFigures(
        seed=seed,
        steps=flight.steps,
        time_s=scored.flight_time_s,
        targets_reached=scored.targets_reached,
        targets=scored.targets,
        arrived=scored.arrived,
        entries_detection=scored.threat_entries_detection,
        entries_attack=scored.threat_entries_attack,
        entered=tuple(agent.id for agent in scored.per_agent if agent.threat_entries_detection),
        worst_depth_m=scored.worst_depth_m,
        breaches=scored.separation_breaches,
        breaches_at_steps=_breaches_at(flight.trajectory.agents_ned_m[::every], mission.separation_m),
        min_separation_m=scored.min_separation_m,
        turn_limited=flight.turn_limited_steps,
        decisions=flight.steps * len(mission.agents),
    )


def _breaches_at(agents_ned_m: np.ndarray, separation_m: float) -> int:
    """Return how many runs of consecutive samples (S, N, 2) have a pair of agents closer than the separation."""
    first, second = np.triu_indices(agents_ned_m.shape[1], k=1)
    offset_m = agents_ned_m[:, first] - agents_ned_m[:, second]
    below = np.hypot(offset_m[..., 0], offset_m[..., 1]) < separation_m  # (S, P)
    return int(below[0].sum() + (below[1:] & ~below[:-1]).sum())


def compare_with_wire(mission: Mission, seed: int) -> WireComparison:
    """Fly a mission with the law `seed` on the pure core and over the wire, and compare the two flights."""
    core, wire = fly_core(mission, seed), fly(mission, seed)
    scores = score(core.trajectory, mission), score(wire.trajectory, mission)
    samples = min(len(core.trajectory.t_s), len(wire.trajectory.t_s))
    offset_m = core.trajectory.agents_ned_m[:samples] - wire.trajectory.agents_ned_m[:samples]
    apart_m = np.hypot(offset_m[..., 0], offset_m[..., 1])  # (S, N)
    for index, agent in enumerate(scores[0].per_agent):
        if agent.arrived_t_s is not None:
            apart_m[core.trajectory.t_s[:samples] > agent.arrived_t_s, index] = 0.0
    sample, agent_index = np.unravel_index(apart_m.argmax(), apart_m.shape)
    reached = [tuple(t.id for t in scored.per_target if t.reached_t_s is not None) for scored in scores]
    entries = [(scored.threat_entries_detection, scored.threat_entries_attack) for scored in scores]
    return WireComparison(
        seed=seed,
        targets_core=reached[0],
        targets_wire=reached[1],
        entries_core=entries[0],
        entries_wire=entries[1],
        steps_core=core.steps,
        steps_wire=wire.steps,
        apart_m=float(apart_m[sample, agent_index]),
        apart_agent=core.trajectory.agent_ids[agent_index],
        apart_t_s=float(core.trajectory.t_s[sample]),
        typical_apart_m=float(np.median(apart_m.max(axis=0))),
        guard_interventions=wire.guard_interventions,
        core_us=core.step_us,
        wire_us=wire.decision_us.reshape(wire.steps, -1).sum(axis=1),
    )
