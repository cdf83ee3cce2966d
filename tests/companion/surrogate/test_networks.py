"""The paper's network of all positions: its gradient is right, and right about nothing."""

import json
import random
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.errors import InputError
from companion.files.weights import content_digest
from companion.surrogate.networks import MonolithicNetwork, load_monolithic, slots
from companion.surrogate.profiles import load_pairwise

SHIPPED = resources.files("companion.surrogate").joinpath("weights/monolithic.json").read_text(encoding="utf-8")
NETWORK = load_monolithic()
AREA_M = 200_000.0


@dataclass(frozen=True)
class Case:
    network: MonolithicNetwork
    agents_ned_m: np.ndarray  # (N, 2)
    threats_ned_m: np.ndarray  # (M, 2)

    def gradient(self) -> np.ndarray:
        return self.network.gradient(self.agents_ned_m, self.threats_ned_m)


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """Draw a network with random weights, not too saturated to have a gradient, and a scene for it."""
    agents, threats, neurons = draw(st.integers(1, 5)), draw(st.integers(1, 4)), draw(st.integers(1, 12))
    low_m2 = draw(st.floats(-1e11, 1e11))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    network = MonolithicNetwork(
        agents=agents,
        threats=threats,
        area_m=draw(st.floats(1e3, 1e6)),
        target_low_m2=low_m2,
        target_high_m2=low_m2 + draw(st.floats(1e9, 1e12)),
        input_weight=rng.normal(size=(neurons, 2 * (agents + threats))),
        input_bias=rng.normal(size=neurons),
        output_weight=rng.normal(size=neurons),
        output_bias=float(rng.normal()),
    )
    return Case(
        network,
        rng.uniform(0.0, network.area_m, (agents, 2)),
        rng.uniform(0.0, network.area_m, (threats, 2)),
    )


# --- value and gradient


@settings(max_examples=80)
@given(case=cases())
def test_the_gradient_is_the_one_central_differences_find(case: Case) -> None:
    closed, h = case.gradient(), 1e-4 * case.network.area_m
    numeric = np.zeros_like(closed)
    for index in np.ndindex(*closed.shape):
        step = np.zeros_like(closed)
        step[index] = h
        forward, backward = (
            case.network.value(case.agents_ned_m + sign * step, case.threats_ned_m) for sign in (1.0, -1.0)
        )
        numeric[index] = (forward - backward) / (2.0 * h)
    span_m2 = case.network.target_high_m2 - case.network.target_low_m2
    # Of the order of the greatest slope there can be: what is left are the third derivative and rounding.
    np.testing.assert_allclose(closed, numeric, atol=1e-6 * (span_m2 + 1e11) / case.network.area_m)


@pytest.mark.slow
@settings(max_examples=80)
@given(case=cases())
def test_the_gradient_is_the_one_autograd_finds(case: Case) -> None:
    torch = pytest.importorskip("torch")
    network = case.network
    omega, theta, output = (
        torch.from_numpy(vector) for vector in (network.input_weight, network.input_bias, network.output_weight)
    )
    agents = torch.tensor(case.agents_ned_m, requires_grad=True)
    positions = torch.cat((agents, torch.from_numpy(case.threats_ned_m)))
    # x1, y1, x2, y2, ...: an independent statement of the order of the inputs and of both scalings.
    inputs = torch.stack([2.0 * positions[k // 2, k % 2] / network.area_m - 1.0 for k in range(2 * len(positions))])
    scaled = network.output_bias + sum(
        output[j] / (1.0 + torch.exp(-(inputs @ omega[j]) - theta[j])) for j in range(len(theta))
    )
    low_m2, high_m2 = network.target_low_m2, network.target_high_m2
    cost = low_m2 + (high_m2 - low_m2) * (scaled + 1.0) / 2.0
    cost.backward()
    assert network.value(case.agents_ned_m, case.threats_ned_m) == pytest.approx(float(cost.detach()), rel=1e-9)
    expected = agents.grad.numpy()
    np.testing.assert_allclose(case.gradient(), expected, rtol=1e-9, atol=1e-12 * np.max(np.abs(expected)))


@settings(max_examples=80)
@given(case=cases())
def test_no_component_of_the_gradient_exceeds_the_corollarys_bound(case: Case) -> None:
    assert np.max(np.abs(case.gradient())) <= case.network.component_bound_m() * (1.0 + 1e-12)


def test_the_corollarys_bound_is_reached_where_every_sigmoid_is_steepest() -> None:
    network = MonolithicNetwork(1, 1, 2e5, 0.0, 1e12, np.array([[3.0, -1.0, 9.0, 9.0]]), np.zeros(1), np.ones(1), 0.0)
    centre = np.full((1, 2), 1e5)
    assert np.max(np.abs(network.gradient(centre, centre))) == pytest.approx(network.component_bound_m())
    assert network.component_bound_m() == pytest.approx(0.25 * 3.0 * 1e12 / 2e5)


def test_the_ends_of_the_output_scaling_are_the_least_and_greatest_target() -> None:
    centre = np.full((1, 2), 1e5)
    still = MonolithicNetwork(1, 1, 2e5, 3e9, 7e11, np.zeros((1, 4)), np.zeros(1), np.zeros(1), -1.0)
    assert still.value(centre, centre) == pytest.approx(3e9)
    assert replace(still, output_bias=1.0).value(centre, centre) == pytest.approx(7e11)


def test_positions_of_another_number_are_refused() -> None:
    with pytest.raises(ValueError, match=r"shapes \(\(9, 2\), \(4, 2\)\), not \(\(10, 2\), \(4, 2\)\)"):
        NETWORK.gradient(np.zeros((9, 2)), np.zeros((4, 2)))


# --- padding


@given(present=st.sets(st.integers(1, 10)), order=st.randoms(use_true_random=False))
def test_every_present_id_is_in_its_row_and_the_lost_are_zeros(present: set[int], order: random.Random) -> None:
    ids = sorted(present)
    order.shuffle(ids)
    places = np.array([[1000.0 * k, -k] for k in ids]).reshape(-1, 2)
    padded = slots(ids, places, 10)
    for k in range(1, 11):
        np.testing.assert_array_equal(padded[k - 1], [1000.0 * k, -k] if k in present else [0.0, 0.0])


@pytest.mark.parametrize("identity", [0, -1, 5])
def test_an_id_that_has_no_place_is_refused(identity: int) -> None:
    with pytest.raises(ValueError, match="not all within 1 to 4"):
        slots([1, identity], np.ones((2, 2)), 4)


def test_a_lost_agent_counts_as_one_in_the_south_west_corner() -> None:
    rng = np.random.default_rng(5)
    agents, threats = rng.uniform(0.0, AREA_M, (10, 2)), rng.uniform(0.0, AREA_M, (4, 2))
    left = [k for k in range(1, 11) if k != 3]
    agents[2] = 0.0
    assert NETWORK.value(slots(left, np.delete(agents, 2, axis=0), 10), threats) == NETWORK.value(agents, threats)


# --- the weights file


def damaged(tmp_path: Path, **changes: object) -> Path:
    """Return a copy of the shipped weights with changes to its network and a digest that fits them."""
    content = json.loads(SHIPPED)
    content["network"].update(changes)
    content["sha256"] = content_digest(content)
    path = tmp_path / "damaged.json"
    path.write_text(json.dumps(content))
    return path


def test_a_reformatted_copy_of_the_weights_loads_the_same(tmp_path: Path) -> None:
    np.testing.assert_array_equal(load_monolithic(damaged(tmp_path)).input_weight, NETWORK.input_weight)


def test_the_packaged_network_is_the_papers() -> None:
    assert (NETWORK.agents, NETWORK.threats, NETWORK.area_m) == (10, 4, AREA_M)
    assert NETWORK.input_weight.shape == (75, 28)


def test_the_other_networks_weights_are_refused() -> None:
    with resources.as_file(resources.files("companion.surrogate").joinpath("weights/pairwise.json")) as path:
        with pytest.raises(InputError, match="pairwise.json: key 'network.agents' is None, allowed: a whole number"):
            load_monolithic(path)


def test_these_weights_are_refused_as_the_other_networks() -> None:
    with resources.as_file(resources.files("companion.surrogate").joinpath("weights/monolithic.json")) as path:
        with pytest.raises(InputError, match="'network.input_weight' is damaged, allowed: a list of finite numbers"):
            load_pairwise(path)


def test_missing_weights_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="none.json: cannot read the weights"):
        load_monolithic(tmp_path / "none.json")


def test_one_changed_digit_is_refused(tmp_path: Path) -> None:
    content = json.loads(SHIPPED)
    content["network"]["input_weight"][7][3] += 1e-9
    path = tmp_path / "changed.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="changed.json: key 'sha256' is .* damaged or was edited"):
        load_monolithic(path)


@pytest.mark.parametrize("value", [0, -1, 10.0, True, "10", None])
def test_a_number_of_agents_that_is_none_is_refused(tmp_path: Path, value: object) -> None:
    with pytest.raises(InputError, match="'network.agents' is .*, allowed: a whole number, at least 1"):
        load_monolithic(damaged(tmp_path, agents=value))


@pytest.mark.parametrize("key", ["area_m", "target_low_m2", "target_high_m2", "output_bias"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), "1", None])
def test_a_figure_that_is_not_a_finite_number_is_refused(tmp_path: Path, key: str, value: object) -> None:
    with pytest.raises(InputError, match=f"'network.{key}' is .*, allowed: a finite number"):
        load_monolithic(damaged(tmp_path, **{key: value}))


@pytest.mark.parametrize(
    "weights",
    [None, [], [1.0] * 75, [[1.0] * 28] * 74, [[1.0] * 27] * 75, [[1.0] * 28] * 74 + [[1.0] * 27]],
    ids=["absent", "empty", "flat", "a neuron short", "an input short", "ragged"],
)
def test_a_matrix_of_another_shape_is_refused(tmp_path: Path, weights: object) -> None:
    with pytest.raises(InputError, match="'network.input_weight' is damaged, allowed: 75 lists of 28 numbers"):
        load_monolithic(damaged(tmp_path, input_weight=weights))


def test_a_matrix_that_holds_no_number_somewhere_is_refused(tmp_path: Path) -> None:
    weights = NETWORK.input_weight.tolist()
    weights[40][2] = float("nan")
    with pytest.raises(InputError, match="'network.input_weight' is damaged, allowed: a list of finite numbers"):
        load_monolithic(damaged(tmp_path, input_weight=weights))


def test_more_agents_than_the_matrix_has_inputs_for_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="allowed: 75 lists of 30 numbers"):
        load_monolithic(damaged(tmp_path, agents=11))


# --- what it has learnt


def test_at_the_edge_of_a_disc_the_packaged_network_turns_away_no_more_often_than_a_coin() -> None:
    rng = np.random.default_rng(1)
    outward = []
    for _ in range(2000):
        agents, threats = rng.uniform(2e4, 1.8e5, (10, 2)), rng.uniform(2e4, 1.8e5, (4, 2))
        bearing = rng.uniform(0.0, 2.0 * np.pi)
        away = np.array([np.cos(bearing), np.sin(bearing)])
        agents[0] = threats[0] + 10_000.0 * away
        outward.append(-NETWORK.gradient(agents, threats)[0] @ away > 0.0)
    assert np.mean(outward) == pytest.approx(0.5, abs=0.05)


def test_from_the_middle_of_a_disc_to_its_outside_the_packaged_network_hardly_changes() -> None:
    def mean_m2(distance_m: float) -> float:
        rng = np.random.default_rng(2)  # the same scenes at each distance
        values = []
        for _ in range(1000):
            agents, threats = rng.uniform(3e4, 1.7e5, (10, 2)), rng.uniform(3e4, 1.7e5, (4, 2))
            bearing = rng.uniform(0.0, 2.0 * np.pi)
            agents[0] = threats[0] + distance_m * np.array([np.cos(bearing), np.sin(bearing)])
            values.append(NETWORK.value(agents, threats))
        return float(np.mean(values))

    # F~ falls by k_d + k_a = 2e11 m^2.
    assert abs(mean_m2(0.0) - mean_m2(15_000.0)) < 1e-3 * 2e11
