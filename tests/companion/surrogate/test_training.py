"""Training: reproducible, honest about its errors, and refusing what it cannot do in one line."""

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import companion.surrogate
from companion.cli import main
from companion.files.weights import content_digest
from companion.surrogate.cost import Scene, Weights, collision_penalty, threat_penalty, unit_disc_indicator
from companion.surrogate.networks import load_monolithic, scaled_inputs
from companion.surrogate.profiles import HALF_WIDTH, PairwiseNetwork, load_pairwise

SMALL = ["--samples", "2000", "--epochs", "5"]
BOTH = ["pairwise", "monolithic"]
SHIPPED = Path(companion.__file__).parent / "surrogate" / "weights"


def run_train(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    """Run `companion train` in this process and return its exit status."""
    monkeypatch.setattr(sys, "argv", ["companion", "train", *arguments])
    with pytest.raises(SystemExit) as stopped:
        main()
    status = stopped.value.code
    assert isinstance(status, int)
    return status


def train(
    surrogate: str, seed: int, samples: int, epochs: int, on_epoch: Callable[[int, float], None] = lambda *_: None
) -> tuple[Any, Any]:
    """Train in this process and return the network and its record."""
    from companion.surrogate.training_monolithic import train_monolithic
    from companion.surrogate.training_pairwise import train_pairwise

    trainings: dict[str, Any] = {"pairwise": train_pairwise, "monolithic": train_monolithic}
    network, record = trainings[surrogate](seed, samples, epochs, on_epoch)
    return network, record


def set_learning_rate(monkeypatch: pytest.MonkeyPatch, rate: float) -> None:
    from companion.surrogate import training_monolithic, training_pairwise

    for module in (training_pairwise, training_monolithic):
        monkeypatch.setattr(module, "LEARNING_RATE", rate)


def shipped_record(name: str) -> dict[str, Any]:
    record = json.loads((SHIPPED / name).read_text())["training"]
    assert isinstance(record, dict)
    return record


@pytest.fixture
def _torch() -> None:
    pytest.importorskip("torch")


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
@pytest.mark.parametrize("surrogate", BOTH)
def test_the_same_seed_writes_the_same_bytes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, surrogate: str) -> None:
    for name in ("a.json", "b.json"):
        arguments = ["--surrogate", surrogate, *SMALL, "--seed", "3", "--out", str(tmp_path / name)]
        assert run_train(monkeypatch, *arguments) == 0
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
@pytest.mark.parametrize("surrogate", BOTH)
def test_another_seed_gives_another_network(surrogate: str) -> None:
    three, four = (train(surrogate, seed, samples=2000, epochs=2)[0] for seed in (3, 4))
    assert not np.array_equal(three.input_bias, four.input_bias)


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
@pytest.mark.parametrize("surrogate", BOTH)
def test_what_is_written_loads_as_what_was_trained(tmp_path: Path, surrogate: str) -> None:
    from companion.surrogate.training import write_weights

    network, record = train(surrogate, 0, samples=200, epochs=1)
    write_weights(tmp_path / "w.json", network, record)
    loaded: Any = {"pairwise": load_pairwise, "monolithic": load_monolithic}[surrogate](tmp_path / "w.json")
    for key, value in vars(network).items():
        np.testing.assert_array_equal(getattr(loaded, key), value)


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
def test_a_short_training_already_beats_the_mean_a_hundredfold(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    out = tmp_path / "w.json"
    run_train(monkeypatch, "--samples", "2000", "--epochs", "50", "--out", str(out))
    record = json.loads(out.read_text())["training"]
    assert record["test_mse"] < 0.01 * record["test_target_variance"]


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
def test_training_improves_on_its_start(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    out = tmp_path / "w.json"
    run_train(monkeypatch, "--samples", "2000", "--epochs", "50", "--out", str(out))
    curve = json.loads(out.read_text())["training"]["learning_curve"]
    assert curve[-1][2] < 0.8 * curve[0][2]


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_monotone_and_exponentially_small_far_away_before_any_fit(seed: int) -> None:
    network, record = train("pairwise", seed, samples=200, epochs=1)
    r = np.linspace(0.0, 3.0, 20_001)
    assert np.max(network.slope(r)) <= 0.0
    assert np.max(np.abs(network.slope(r[r > 1.5]))) < 1e-12
    assert network.value(np.zeros(1)) == pytest.approx(1.0, abs=1e-12)
    assert (record.wrong_sign_slope_max, record.epochs_run) == (0.0, 1)


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
@pytest.mark.parametrize("surrogate", BOTH)
def test_the_network_returned_is_the_best_on_validation(monkeypatch: pytest.MonkeyPatch, surrogate: str) -> None:
    set_learning_rate(monkeypatch, 0.1)  # so large that the error goes up and down
    seen: list[float] = []
    _, record = train(surrogate, 0, 1000, 30, lambda epoch, mse: seen.append(mse))
    assert record.best_epoch == 1 + int(np.argmin(seen)) != len(seen)
    assert record.validation_mse == pytest.approx(min(seen), rel=1e-9)


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
@pytest.mark.parametrize("surrogate", BOTH)
def test_training_stops_when_validation_no_longer_improves(monkeypatch: pytest.MonkeyPatch, surrogate: str) -> None:
    from companion.surrogate import training

    set_learning_rate(monkeypatch, 0.0)
    monkeypatch.setattr(training, "PATIENCE_EPOCHS", 4)
    _, record = train(surrogate, 0, 1000, 30)
    assert (record.best_epoch, record.epochs_run) == (1, 5)


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
def test_batches_hold_every_sample_once_with_its_own_target_in_a_new_order_each_time() -> None:
    import torch

    from companion.surrogate.training import _batches

    samples, generator = torch.arange(10), torch.Generator().manual_seed(0)
    first, second = (_batches(samples, 2 * samples, 4, generator) for _ in range(2))
    assert [len(inputs) for inputs, _ in first] == [4, 4, 2]
    assert sorted(torch.cat([inputs for inputs, _ in first]).tolist()) == list(range(10))
    assert all(torch.equal(targets, 2 * inputs) for inputs, targets in first)
    assert not torch.equal(first[0][0], second[0][0])


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
def test_half_of_the_samples_lie_at_the_edge() -> None:
    import torch

    from companion.surrogate.training_pairwise import EDGE_REACH, SAMPLED_RANGE, draw_samples

    r = draw_samples(10_000, torch.Generator().manual_seed(0))
    assert np.mean(np.abs(r - 1.0) <= EDGE_REACH) == pytest.approx(0.5 + 0.5 * 2 * EDGE_REACH / SAMPLED_RANGE, abs=0.02)
    assert (r.min() >= 0.0, r.max() <= SAMPLED_RANGE) == (True, True)


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
def test_train_reports_its_figures_and_is_quiet_on_stderr_in_a_pipe(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "w.json"
    run_train(monkeypatch, *SMALL, "--seed", "7", "--out", str(out))
    printed = capsys.readouterr()
    figures = dict(line.split(": ", 1) for line in printed.out.splitlines())
    content = json.loads(out.read_text())
    assert printed.err == ""
    assert figures["digest"] == content["sha256"] == content_digest(content)
    assert float(figures["test MSE"]) == pytest.approx(content["training"]["test_mse"], rel=1e-3)
    assert figures["seed"] == "7"
    assert figures["epochs run"].startswith("5 of 5, best ")


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
def test_a_long_learning_curve_is_thinned() -> None:
    from companion.surrogate.training import CURVE_POINTS

    _, record = train("pairwise", 0, samples=100, epochs=CURVE_POINTS + 50)
    assert 0 < len(record.learning_curve) <= CURVE_POINTS


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
@pytest.mark.parametrize("place", ["missing/w.json", "."])
def test_a_place_that_cannot_be_written_is_refused_in_one_line_before_training(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str], place: str
) -> None:
    from companion.surrogate import training_pairwise

    monkeypatch.setattr(training_pairwise, "train_pairwise", lambda *arguments: pytest.fail("trained first"))
    assert run_train(monkeypatch, *SMALL, "--out", str(tmp_path / place)) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("companion: --out ")
    assert printed.err.count("\n") == 1


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
def test_a_write_that_fails_after_training_is_refused_in_one_line(tmp_path: Path) -> None:
    from companion.errors import InputError
    from companion.surrogate.training import write_weights

    network, record = train("pairwise", 0, samples=100, epochs=1)
    with pytest.raises(InputError, match="cannot write"):
        write_weights(tmp_path, network, record)


@pytest.mark.parametrize("arguments", [["--samples", "10"], ["--epochs", "0"], ["--seed", "-1"], ["--seed", "x"]])
def test_senseless_numbers_are_refused_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str]
) -> None:
    assert run_train(monkeypatch, *arguments) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_without_torch_the_user_is_told_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    for module in ("training", "training_pairwise", "training_monolithic"):
        monkeypatch.delitem(sys.modules, f"companion.surrogate.{module}", raising=False)
        monkeypatch.delattr(companion.surrogate, module, raising=False)
    assert run_train(monkeypatch, "--out", str(tmp_path / "w.json")) == 2
    assert "pip install '.[train]'" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
@pytest.mark.parametrize("surrogate", BOTH)
def test_the_weights_are_named_after_the_surrogate_unless_told_otherwise(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, surrogate: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run_train(monkeypatch, "--surrogate", surrogate, *SMALL) == 0
    assert [path.name for path in tmp_path.iterdir()] == [f"{surrogate}.json"]


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
def test_train_says_what_the_errors_of_the_papers_network_mean(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "w.json"
    run_train(monkeypatch, "--surrogate", "monolithic", *SMALL, "--out", str(out))
    figures = dict(line.split(": ", 1) for line in capsys.readouterr().out.splitlines())
    content = json.loads(out.read_text())
    record = content["training"]
    ratio = record["test_mse"] / record["test_target_variance"]
    assert float(figures["test MSE / variance"]) == pytest.approx(ratio, abs=1e-4)
    assert figures["scaling"] == f"output -1 to 1 is 0 to {content['network']['target_high_m2']:g} m^2"
    assert figures["meaning"].startswith("it predicts the mean")


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
def test_a_network_that_had_learnt_something_would_be_told_of_differently() -> None:
    _, record = train("monolithic", 0, samples=200, epochs=1)
    better = replace(record, test_mse=0.25 * record.test_target_variance)
    assert better.findings()["meaning"] == "it explains 75.0% of its target's variance"


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
def test_the_target_of_the_papers_network_is_the_polygon_of_the_penalties() -> None:
    import torch

    from companion.surrogate import training_monolithic as case

    agents, threats = case.draw_positions(200, torch.Generator().manual_seed(1))
    agents[:, 0] = threats[:, 0] + np.linspace(0.0, 11_000.0, 200)[:, np.newaxis] / np.sqrt(2.0)
    agents[:, 2] = agents[:, 1] + np.linspace(0.0, 110.0, 200)[:, np.newaxis] / np.sqrt(2.0)
    expected = []
    for agents_ned_m, threats_ned_m in zip(agents, threats, strict=True):
        scene = Scene(
            agents_ned_m=agents_ned_m,
            targets_ned_m=agents_ned_m,
            threats_ned_m=threats_ned_m,
            detection_radius_m=np.full(4, 10_000.0),
            attack_radius_m=np.full(4, 5_000.0),
            separation_m=100.0,
            flown_m=np.zeros(10),
            range_m=np.full(10, np.inf),
        )
        weights = Weights(k_d=1e11, k_a=1e11, k_c=1e10)
        penalties = threat_penalty(scene, weights, HALF_WIDTH) + collision_penalty(scene, weights, HALF_WIDTH)
        expected.append(np.sum(penalties))
    np.testing.assert_allclose(case.continuous_penalties(agents, threats), expected, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
def test_the_positions_that_the_papers_network_learns_from_fill_its_area() -> None:
    import torch

    from companion.surrogate.training_monolithic import AREA_M, draw_positions

    positions = np.concatenate(draw_positions(1000, torch.Generator().manual_seed(0)), axis=1)
    assert positions.shape == (1000, 14, 2)
    assert (positions.min() >= 0.0, positions.max() <= AREA_M) == (True, True)
    shares = np.array([0.25, 0.5, 0.75])
    np.testing.assert_allclose(np.quantile(positions, shares), AREA_M * shares, rtol=0.02)


# --- the shipped weights


@pytest.mark.parametrize("surrogate", BOTH)
def test_the_shipped_weights_come_from_the_default_arguments(surrogate: str) -> None:
    record = shipped_record(f"{surrogate}.json")
    assert (record["seed"], record["samples"], record["epochs_allowed"]) == (0, 100_000, 1000)


def test_the_shipped_record_agrees_with_the_shipped_network() -> None:
    record = shipped_record("pairwise.json")
    network: PairwiseNetwork = load_pairwise()
    grid = np.linspace(0.0, 3.0, 300_001)
    worst = np.max(np.abs(network.value(grid) - unit_disc_indicator(grid, HALF_WIDTH)))
    assert worst == pytest.approx(record["worst_error"], rel=1e-9)
    assert record["test_mse"] < 5e-5
    assert record["wrong_sign_slope_max"] == 0.0


def scaled_targets(agents_ned_m: np.ndarray, threats_ned_m: np.ndarray) -> np.ndarray:
    """Return F~ in the units of the packaged network's output, (S,)."""
    from companion.surrogate.training_monolithic import continuous_penalties

    network = load_monolithic()
    span_m2 = network.target_high_m2 - network.target_low_m2
    target_m2 = continuous_penalties(agents_ned_m, threats_ned_m)
    return 2.0 * (target_m2 - network.target_low_m2) / span_m2 - 1.0


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
def test_the_recorded_errors_of_the_papers_network_are_those_of_its_recorded_samples() -> None:
    from companion.surrogate.training import seeded
    from companion.surrogate.training_monolithic import draw_positions

    record, network = shipped_record("monolithic.json"), load_monolithic()
    agents, threats = draw_positions(record["samples"], seeded(record["seed"]))
    target = scaled_targets(agents, threats)
    assert (target[:70_000].min(), target[:70_000].max()) == (-1.0, 1.0)
    squares = (network.scaled_value(scaled_inputs(agents, threats, network.area_m)) - target) ** 2
    parts = np.split(squares, [70_000, 85_000])
    recorded = [record[key] for key in ("train_mse", "validation_mse", "test_mse")]
    np.testing.assert_allclose([np.mean(part) for part in parts], recorded, rtol=1e-9)
    assert np.var(target[85_000:]) == pytest.approx(record["test_target_variance"], rel=1e-9)


@pytest.mark.slow
@pytest.mark.usefixtures("_torch")
def test_on_fresh_samples_the_papers_network_is_hardly_better_than_the_mean() -> None:
    import torch

    from companion.surrogate.training_monolithic import draw_positions

    network = load_monolithic()
    agents, threats = draw_positions(50_000, torch.Generator().manual_seed(12_345))
    target = scaled_targets(agents, threats)
    output = network.scaled_value(scaled_inputs(agents, threats, network.area_m))
    assert np.mean((output - target) ** 2) / np.var(target) == pytest.approx(0.9915, abs=0.003)


def test_the_record_of_the_papers_network_holds_the_scaling_that_its_network_uses() -> None:
    record, network = shipped_record("monolithic.json"), load_monolithic()
    for key in ("agents", "threats", "area_m", "target_low_m2", "target_high_m2"):
        assert record[key] == getattr(network, key)


def test_only_the_network_that_flies_explains_its_target() -> None:
    explained = {}
    for surrogate in BOTH:
        record = shipped_record(f"{surrogate}.json")
        explained[surrogate] = 1.0 - record["test_mse"] / record["test_target_variance"]
    assert explained["pairwise"] > 0.999
    assert explained["monolithic"] < 0.02
