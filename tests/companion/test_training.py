"""Training: reproducible, honest about its errors, and refusing what it cannot do in one line."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

import companion
from companion.cli import main
from companion.cost import unit_disc_indicator
from companion.surrogate import HALF_WIDTH, PairwiseNetwork, content_digest, load_pairwise

SMALL = ["--samples", "2000", "--epochs", "5"]


def run_train(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    """Run `companion train` in this process and return its exit status."""
    monkeypatch.setattr(sys, "argv", ["companion", "train", *arguments])
    with pytest.raises(SystemExit) as stopped:
        main()
    status = stopped.value.code
    assert isinstance(status, int)
    return status


@pytest.fixture
def _torch() -> None:
    pytest.importorskip("torch")


@pytest.mark.usefixtures("_torch")
def test_the_same_seed_writes_the_same_bytes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name in ("a.json", "b.json"):
        assert run_train(monkeypatch, *SMALL, "--seed", "3", "--out", str(tmp_path / name)) == 0
    assert (tmp_path / "a.json").read_bytes() == (tmp_path / "b.json").read_bytes()


@pytest.mark.usefixtures("_torch")
def test_another_seed_gives_another_network(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for seed in ("3", "4"):
        run_train(monkeypatch, *SMALL, "--seed", seed, "--out", str(tmp_path / seed))
    three, four = (load_pairwise(tmp_path / seed) for seed in ("3", "4"))
    assert not np.array_equal(three.input_bias, four.input_bias)


@pytest.mark.usefixtures("_torch")
def test_a_short_training_already_beats_the_mean_a_hundredfold(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    out = tmp_path / "w.json"
    run_train(monkeypatch, "--samples", "2000", "--epochs", "50", "--out", str(out))
    record = json.loads(out.read_text())["training"]
    assert record["test_mse"] < 0.01 * record["test_target_variance"]


@pytest.mark.usefixtures("_torch")
def test_training_improves_on_its_start(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    out = tmp_path / "w.json"
    run_train(monkeypatch, "--samples", "2000", "--epochs", "50", "--out", str(out))
    curve = json.loads(out.read_text())["training"]["learning_curve"]
    assert curve[-1][2] < 0.8 * curve[0][2]


@pytest.mark.usefixtures("_torch")
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_monotone_and_exponentially_small_far_away_before_any_fit(seed: int) -> None:
    from companion.training import train_pairwise

    network, record = train_pairwise(seed, samples=200, epochs=1)
    r = np.linspace(0.0, 3.0, 20_001)
    assert np.max(network.slope(r)) <= 0.0
    assert np.max(np.abs(network.slope(r[r > 1.5]))) < 1e-12
    assert network.value(np.zeros(1)) == pytest.approx(1.0, abs=1e-12)
    assert (record.wrong_sign_slope_max, record.epochs_run) == (0.0, 1)


@pytest.mark.usefixtures("_torch")
def test_the_network_returned_is_the_best_on_validation(monkeypatch: pytest.MonkeyPatch) -> None:
    from companion import training

    monkeypatch.setattr(training, "LEARNING_RATE", 1.0)  # so large that the error goes up and down
    seen: list[float] = []
    _, record = training.train_pairwise(0, 1000, 30, lambda epoch, mse: seen.append(mse))
    assert record.best_epoch == 1 + int(np.argmin(seen)) != len(seen)
    assert record.validation_mse == pytest.approx(min(seen), rel=1e-9)


@pytest.mark.usefixtures("_torch")
def test_training_stops_when_validation_no_longer_improves(monkeypatch: pytest.MonkeyPatch) -> None:
    from companion import training

    monkeypatch.setattr(training, "LEARNING_RATE", 0.0)
    monkeypatch.setattr(training, "PATIENCE_EPOCHS", 4)
    _, record = training.train_pairwise(0, 1000, 30)
    assert (record.best_epoch, record.epochs_run) == (1, 5)


@pytest.mark.usefixtures("_torch")
def test_half_of_the_samples_lie_at_the_edge() -> None:
    import torch

    from companion.training import EDGE_REACH, SAMPLED_RANGE, draw_samples

    r = draw_samples(10_000, torch.Generator().manual_seed(0))
    assert np.mean(np.abs(r - 1.0) <= EDGE_REACH) == pytest.approx(0.5 + 0.5 * 2 * EDGE_REACH / SAMPLED_RANGE, abs=0.02)
    assert (r.min() >= 0.0, r.max() <= SAMPLED_RANGE) == (True, True)


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


@pytest.mark.usefixtures("_torch")
def test_a_long_learning_curve_is_thinned() -> None:
    from companion.training import CURVE_POINTS, train_pairwise

    _, record = train_pairwise(0, samples=100, epochs=CURVE_POINTS + 50)
    assert 0 < len(record.learning_curve) <= CURVE_POINTS


@pytest.mark.usefixtures("_torch")
@pytest.mark.parametrize("place", ["missing/w.json", "."])
def test_a_place_that_cannot_be_written_is_refused_in_one_line_before_training(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str], place: str
) -> None:
    from companion import training

    monkeypatch.setattr(training, "train_pairwise", lambda *arguments: pytest.fail("trained first"))
    assert run_train(monkeypatch, *SMALL, "--out", str(tmp_path / place)) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.startswith("companion: --out ")
    assert printed.err.count("\n") == 1


@pytest.mark.usefixtures("_torch")
def test_a_write_that_fails_after_training_is_refused_in_one_line(tmp_path: Path) -> None:
    from companion.errors import InputError
    from companion.training import train_pairwise, write_weights

    network, record = train_pairwise(0, samples=100, epochs=1)
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
    monkeypatch.delitem(sys.modules, "companion.training", raising=False)
    monkeypatch.delattr(companion, "training", raising=False)
    assert run_train(monkeypatch, "--out", str(tmp_path / "w.json")) == 2
    assert "pip install '.[train]'" in capsys.readouterr().err


def test_the_shipped_weights_come_from_the_default_arguments() -> None:
    record = json.loads((Path(companion.__file__).parent / "weights" / "pairwise.json").read_text())["training"]
    assert (record["seed"], record["samples"], record["epochs_allowed"]) == (0, 100_000, 1000)


def test_the_shipped_record_agrees_with_the_shipped_network() -> None:
    record = json.loads((Path(companion.__file__).parent / "weights" / "pairwise.json").read_text())["training"]
    network: PairwiseNetwork = load_pairwise()
    grid = np.linspace(0.0, 3.0, 300_001)
    worst = np.max(np.abs(network.value(grid) - unit_disc_indicator(grid, HALF_WIDTH)))
    assert worst == pytest.approx(record["worst_error"], rel=1e-9)
    assert record["test_mse"] < 5e-5
    assert record["wrong_sign_slope_max"] == 0.0
