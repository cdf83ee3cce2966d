"""The arena's figures: rates, quantiles, who is behind, and what is written down."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binomtest

from companion.mission.model import load_mission
from sim.arena.plots import PLOT_NAMES, draw_plots
from sim.arena.report import (
    JSON_NAME,
    MARKDOWN_NAME,
    ArenaOutcome,
    broken_promise,
    failures,
    summaries,
    worst,
    write_arena,
    write_worst,
)
from sim.arena.run import TIME_BINS_US, Feasibility, Run, jobs_of
from sim.arena.statistics import behind, binned_quantile_us, quantile, summarise, wilson


def a_run(**changes: object) -> Run:
    given = {
        "family": "dense",
        "index": 0,
        "law": "routed",
        "feasibility": Feasibility(True, gap=0.01),
        "certified": True,
        "agents": 1,
        "targets": 1,
        "reached": 1,
        "entries": 0,
        "entries_attack": 0,
        "worst_depth_m": 0.0,
        "breaches": 0,
        "min_separation_m": None,
        "path_ratios": (1.01,),
        "flight_time_s": 100.0,
        "decision_counts": tuple(np.histogram([100.0] * 9 + [1000.0], TIME_BINS_US)[0].tolist()),
        "decision_max_us": 1000.0,
    }
    return Run(**{**given, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize(("successes", "trials"), [(0, 20), (20, 20), (7, 20), (499, 500)])
def test_the_interval_of_a_rate_is_wilsons(successes: int, trials: int) -> None:
    expected = binomtest(successes, trials).proportion_ci(0.95, method="wilson")
    found = wilson(successes, trials)
    assert found.value == successes / trials
    assert found.low == pytest.approx(expected.low, abs=1e-6)
    assert found.high == pytest.approx(expected.high, abs=1e-6)


def test_a_rate_of_nothing_is_not_a_number() -> None:
    assert math.isnan(wilson(0, 0).value)


def test_the_interval_of_a_median_covers_it_in_about_95_of_100_samples() -> None:
    generator = np.random.default_rng(1)
    covered = 0
    for _ in range(400):
        found = quantile(generator.exponential(size=41), 0.5)
        covered += found.low <= math.log(2.0) <= found.high
    assert 0.93 <= covered / 400 <= 0.995


def test_a_quantile_of_decision_times_is_right_to_a_bin() -> None:
    times_us = np.random.default_rng(2).lognormal(5.0, 1.0, 10_000)
    counts = np.histogram(times_us, TIME_BINS_US)[0]
    for share in (0.5, 0.99):
        assert binned_quantile_us(counts, share) == pytest.approx(np.quantile(times_us, share), rel=0.07)


def test_only_feasible_missions_from_certified_starts_count_for_arrivals() -> None:
    runs = [
        a_run(),
        a_run(index=1, reached=0, path_ratios=()),
        a_run(index=2, reached=0, feasibility=Feasibility(False, "no way to target 1")),
        a_run(index=3, reached=0, certified=False),
    ]
    found = summarise(runs)
    assert (found.flights, found.feasible, found.arrivals.value) == (4, 2, 0.5)


def test_entries_from_starts_that_were_not_certified_are_counted_apart() -> None:
    until_t = a_run(index=2, entries=3, certified=False, until_s=30.0)
    found = summarise([a_run(entries=2), a_run(index=1, entries=5, certified=False), until_t])
    assert (found.entries, found.entries_until, found.entries_uncertified) == (2, 3, 5)


def test_a_law_is_behind_another_only_beyond_both_intervals() -> None:
    good = summarise([a_run(index=k) for k in range(100)])
    bad = summarise([a_run(index=k, reached=k % 2, entries=1, path_ratios=(1.3,)) for k in range(100)])
    slightly = summarise([a_run(index=k, reached=int(k > 0)) for k in range(100)])
    assert behind(bad, good) == ["arrivals", "entries", "median path ratio"]
    assert behind(slightly, good) == []


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"entries": 1, "worst_depth_m": 3.0}, "entries"),
        ({"breaches": 1, "min_separation_m": 20.0}, "breaches"),
        ({"reached": 0}, "targets reached"),
    ],
)
def test_a_failure_of_routed_is_named(changes: dict[str, object], word: str) -> None:
    ((_, why),) = failures([a_run(**changes)])
    assert word in why


def test_what_nobody_could_have_flown_is_no_failure() -> None:
    assert failures([a_run(reached=0, feasibility=Feasibility(False, "no way to target 1"))]) == []
    assert failures([a_run(law="seed", reached=0)]) == []


def test_an_entry_from_an_uncertified_start_breaks_no_promise() -> None:
    assert not broken_promise(a_run(entries=1, certified=False))
    assert broken_promise(a_run(entries=1))
    assert broken_promise(a_run(breaches=1))


def test_every_failure_and_the_longest_ways_are_the_worst_runs() -> None:
    runs = [a_run(index=k, path_ratios=(1.0 + k / 100.0,)) for k in range(6)] + [
        a_run(index=9, reached=0, path_ratios=())
    ]
    assert [run.index for run, _ in worst(runs)] == [9, 5, 4, 3]


def test_the_worst_runs_are_missions_that_can_be_flown_again(tmp_path: Path) -> None:
    ((_, _, call),) = write_worst(tmp_path, [a_run()], seed=1)
    path = tmp_path / call.split()[2]
    assert load_mission(path).resolved
    assert call.endswith("--seed 100000")


def test_the_page_and_the_figures_are_written(tmp_path: Path) -> None:
    runs = [a_run(), a_run(law="seed", reached=0, entries=1, path_ratios=()), a_run(law="apf")]
    write_arena(tmp_path, ArenaOutcome(runs, 1, 60.0, []), ["plot.png"])
    content = json.loads((tmp_path / JSON_NAME).read_text(encoding="utf-8"))
    assert [row["law"] for row in content["summaries"]] == ["routed", "seed", "apf"]
    assert len(content["runs"]) == 3
    page = (tmp_path / MARKDOWN_NAME).read_text(encoding="utf-8")
    assert "| `seed` | 1 of 1 | 0.0 %" in page
    assert "1 of 1 missions are feasible" in page


def test_the_page_says_where_routed_is_behind() -> None:
    runs = [a_run(index=k, path_ratios=(1.2,)) for k in range(50)]
    runs += [a_run(index=k, law="apf", path_ratios=(1.01,)) for k in range(50)]
    ours, other = summaries(runs)
    assert behind(ours, other) == ["median path ratio"]


def test_slow_methods_fly_only_the_first_missions_of_single_agents() -> None:
    jobs = jobs_of(1, 25, ["dense", "swarm"], ["routed", "horizon"])
    assert sum("horizon" in job.laws for job in jobs if job.family == "dense") == 20
    assert not any("horizon" in job.laws for job in jobs if job.family == "swarm")


@pytest.mark.parametrize("trials", range(1, 600, 7))
def test_the_interval_of_a_rate_holds_the_rate(trials: int) -> None:
    for successes in (0, trials // 3, trials):
        found = wilson(successes, trials)
        assert found.low <= found.value <= found.high


def test_the_plots_are_drawn_whatever_the_laws_reached(tmp_path: Path) -> None:
    runs = [a_run(index=k) for k in range(193)]
    runs += [a_run(index=k, law="seed", reached=0, entries=1, path_ratios=()) for k in range(193)]
    runs += [a_run(family="swarm", index=k, feasibility=Feasibility(False, "no way to target 1")) for k in range(3)]
    draw_plots(tmp_path, summaries(runs), runs)
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in PLOT_NAMES)
