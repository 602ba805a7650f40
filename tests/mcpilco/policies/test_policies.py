from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from mcpilco.config import PolicyConfig
from mcpilco.dynamics import AngleAugmentation
from mcpilco.policies.policies import (
    LEVELS,
    Dropout,
    Squash,
    SumOfGaussians,
    blank_policy,
    mix,
    random_policy,
)
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError
from tests.mcpilco.conftest import make_policy

LOW, HIGH = [-3.0, 1.0], [5.0, 2.0]


def some_policy(bases: int = 7, seed: int = 0) -> SumOfGaussians:
    """Two inputs with different bounds, four states with one angle."""
    policy = SumOfGaussians(AngleAugmentation(4, (2,)), LOW, HIGH, bases, squash=2.0)
    generator = torch.Generator().manual_seed(seed)
    plain = torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)
    policy.randomise(plain, plain / 2, 0.7, 5.0, generator)
    return policy


def some_states(*batch: int) -> Tensor:
    return torch.randn(*batch, 4, generator=torch.Generator().manual_seed(1), dtype=torch.float64)


@given(st.lists(st.floats(-1e100, 1e100), min_size=4, max_size=4))
def test_inputs_are_within_their_bounds_in_any_state(state: list[float]) -> None:
    with torch.no_grad():
        inputs = some_policy()(torch.tensor(state, dtype=torch.float64))
    slack = 1e-15 * torch.tensor(HIGH, dtype=torch.float64)
    assert (inputs >= torch.tensor(LOW) - slack).all()
    assert (inputs <= torch.tensor(HIGH) + slack).all()


@given(
    a=st.floats(allow_nan=False),
    low=st.floats(-1e3, 1e3),
    width=st.floats(1e-3, 1e3),
    scale=st.floats(0.1, 100),
)
def test_squash_stays_within_its_bounds(a: float, low: float, width: float, scale: float) -> None:
    squash = Squash([low], [low + width], scale)
    u = float(squash(torch.tensor([a], dtype=torch.float64)))
    slack = 1e-12 * (abs(low) + width)
    assert low - slack <= u <= low + width + slack


def test_squash_is_the_scaled_tanh() -> None:
    squash = Squash([-10.0], [10.0], 10.0)
    a = torch.tensor([[-20.0], [0.0], [3.0]], dtype=torch.float64)
    torch.testing.assert_close(squash(a), 10 * torch.tanh(a / 10))
    assert squash(torch.tensor([math.inf])).tolist() == [10.0]
    assert Squash([0.0], [4.0], 1.0)(torch.tensor([0.0])).tolist() == [2.0]


@pytest.mark.parametrize(
    ("low", "high"), [([0.0], [0.0]), ([1.0], [0.0]), ([-math.inf], [1.0]), ([0.0], [math.nan])]
)
def test_bounds_that_are_none_are_answered_with_a_sentence(low: list, high: list) -> None:
    with pytest.raises(InputError, match="finite bounds low < high"):
        Squash(low, high, 1.0)


def test_the_policy_is_the_formula_of_its_docstring() -> None:
    policy, states = some_policy(), some_states(6)
    x, dx, angle, omega = states.T
    z = torch.stack([x, dx, omega, angle.cos(), angle.sin()], -1)
    distance = ((z[:, None] - policy.centres) / policy.lengthscale).square().sum(-1)
    phi = torch.exp(-distance)
    a = sum(phi[:, b, None] * policy.weights[b] for b in range(policy.bases))
    low, high = torch.tensor(LOW), torch.tensor(HIGH)
    expected = (low + high) / 2 + (high - low) / 2 * torch.tanh(a / 2.0)
    torch.testing.assert_close(policy.activations(states), phi)
    torch.testing.assert_close(policy(states), expected)


@pytest.mark.parametrize("dropout", [None, Dropout(0.3, 4)])
def test_gradients_equal_finite_differences(dropout: Dropout | None) -> None:
    policy, states = some_policy(), some_states(3).requires_grad_()
    names = [name for name, _ in policy.named_parameters()]

    def value(x: Tensor, *parameters: Tensor) -> Tensor:
        values = dict(zip(names, parameters, strict=True))
        return torch.func.functional_call(policy, values, (x, dropout, 2))

    assert names == ["centres", "log_lengthscale", "weights"]
    assert torch.autograd.gradcheck(value, (states, *policy.parameters()))


def test_a_full_turn_changes_nothing() -> None:
    policy, states = some_policy(), some_states(5)
    turn = 2 * math.pi
    turned = states + torch.tensor([0.0, 0.0, turn, 0.0], dtype=torch.float64)
    torch.testing.assert_close(policy(turned), policy(states))
    moved = states + torch.tensor([0.0, 0.0, 0.0, turn], dtype=torch.float64)
    assert not torch.allclose(policy(moved), policy(states))


def test_batch_equals_loop() -> None:
    policy, states = some_policy(), some_states(2, 3)
    for i in range(2):
        for j in range(3):
            torch.testing.assert_close(policy(states)[i, j], policy(states[i, j]))


def test_dropout_multiplies_the_activations_by_its_factors() -> None:
    policy, states, dropout = some_policy(40), some_states(10), Dropout(0.5, 3)
    phi = policy.activations(states) * dropout.factors(6, 10, 40)
    torch.testing.assert_close(policy(states, dropout, 6), policy.squash(phi @ policy.weights))
    assert not torch.allclose(policy(states, dropout, 6), policy(states, dropout, 7))
    assert not torch.allclose(policy(states, dropout, 6), policy(states))


def test_a_blank_policy_answers_the_middle(task: TaskSpec) -> None:
    policy = blank_policy(PolicyConfig(bases=9), task, [-1.0], [3.0])
    assert (policy.bases, policy.input_dim) == (9, 1)
    assert torch.equal(policy(some_states(4)), torch.ones(4, 1, dtype=torch.float64))


def random_start(task: TaskSpec, states: np.ndarray, seed: int = 0, **numbers) -> SumOfGaussians:
    config = PolicyConfig(bases=200, weight=3.0, **numbers)
    generator = torch.Generator().manual_seed(seed)
    return random_policy(config, task, [-1.0], [1.0], states, generator)


def test_a_random_start_fills_the_range_asked_for(task: TaskSpec) -> None:
    policy = random_start(task, np.zeros((1, 4)), span=2.0, lengthscale=0.5, angle_lengthscale=0.7)
    plain, circle = policy.centres.detach().split([3, 2], -1)
    assert 0.9 * 2.0 < float(plain.abs().max()) <= 2.0
    torch.testing.assert_close(circle.square().sum(-1), torch.ones(200, dtype=torch.float64))
    assert 0.9 * 3.0 < float(policy.weights.detach().abs().max()) <= 3.0
    scales = torch.tensor([0.5, 0.5, 0.5, 0.7, 0.7], dtype=torch.float64)
    torch.testing.assert_close(policy.lengthscale, scales, rtol=1e-14, atol=0)


def test_a_random_start_spreads_over_the_states_seen(task: TaskSpec) -> None:
    """In proportion to each state's own range, and at least over the starts."""
    seen = np.array([[1.0, -2.0, 9.0, 0.0], [0.0, 1.0, 9.0, -8.0]])
    for span, ranges in ("data", [1.0, 2.0, 8.0]), ("rms", [1.0, 5.0**0.5, 8.0]):
        scales = random_start(task, seen, span=span).lengthscale
        np.testing.assert_allclose(scales[:3].detach() / scales[0].detach(), ranges)
        doubled = random_start(task, 2 * seen, span=span).lengthscale
        torch.testing.assert_close(doubled[:3], 2 * scales[:3])
    at_rest = random_start(task, np.zeros((1, 4))).lengthscale
    wider = dataclasses.replace(task, start_std=(0.2,) * 4)
    torch.testing.assert_close(
        random_start(wider, np.zeros((1, 4))).lengthscale[:3], 2 * at_rest[:3]
    )


def test_a_state_that_never_moved_leaves_the_policy_finite(task: TaskSpec) -> None:
    still = dataclasses.replace(task, start_std=(0.0,) * 4)
    policy = random_start(still, np.zeros((3, 4)))
    assert policy(some_states(5)).isfinite().all()


def test_equal_generators_give_equal_starts_and_others_differ(task: TaskSpec) -> None:
    first, again, other = (make_policy(task, seed=seed) for seed in (1, 1, 2))
    for mine, same in zip(first.parameters(), again.parameters(), strict=True):
        assert torch.equal(mine, same)
    assert not torch.equal(first.centres, other.centres)
    assert not torch.equal(first.weights, other.weights)


P, B = 400, 200
SEEDS = range(5)


@pytest.mark.parametrize("rate", [0.05, 0.125, 0.25, 0.5, 0.9])
@pytest.mark.parametrize("seed", SEEDS)
def test_rate_of_zeros_is_binomial(rate: float, seed: int) -> None:
    dropout = Dropout(rate, seed)
    factors = torch.stack([dropout.factors(step, P, B) for step in range(4)])
    p = dropout.threshold / LEVELS
    assert p == pytest.approx(rate, abs=0.5 / LEVELS)
    deviation = math.sqrt(p * (1 - p))
    zeros = (factors == 0).double()
    assert float(zeros.mean()) == pytest.approx(p, abs=5 * deviation / math.sqrt(zeros.numel()))
    for axis in (1, 2):  # no particle and no basis is favoured
        rates = zeros.mean(dim=[d for d in range(3) if d != axis])
        error = deviation / math.sqrt(zeros.numel() / zeros.shape[axis])
        assert float((rates - p).abs().max()) < 5 * error


def test_neighbours_are_independent() -> None:
    zeros = (Dropout(0.5, 3).factors(0, 1000, B) == 0).double() - 0.5
    for shifted in (
        zeros.roll(1, 0),
        zeros.roll(1, 1),
        zeros.roll(4, 1),
        zeros.roll((1, 4), (0, 1)),
    ):
        correlation = 4 * float((zeros * shifted).mean())
        assert abs(correlation) < 5 / math.sqrt(zeros.numel())


def test_equal_seeds_give_equal_masks_and_others_differ() -> None:
    first = Dropout(0.25, 7).factors(3, P, B)
    assert torch.equal(first, Dropout(0.25, 7).factors(3, P, B))
    agreement = (first == Dropout(0.25, 8).factors(3, P, B)).double().mean()
    assert float(agreement) == pytest.approx(0.25**2 + 0.75**2, abs=0.02)


def test_masks_stay_what_they_were() -> None:
    """Seeds of old runs keep their meaning, and compiled loops compute the same."""
    kept = Dropout(0.5, seed=1).factors(3, 3, 9) != 0
    assert Dropout(0.5, seed=1).keys(3).tolist() == [1492470133, 3529208806, 3405767568]
    assert kept.int().tolist() == [
        [0, 1, 0, 0, 0, 1, 0, 0, 1],
        [1, 0, 1, 0, 0, 1, 1, 1, 1],
        [1, 0, 0, 0, 0, 0, 1, 1, 0],
    ]


def test_each_step_and_particle_has_its_own_mask() -> None:
    dropout = Dropout(0.5, 1)
    masks = torch.cat([dropout.factors(step, P, B) for step in range(3)])
    assert len(masks.unique(dim=0)) == 3 * P


@given(
    seed=st.integers(0, 2**40),
    step=st.integers(0, 100),
    particles=st.integers(1, 20),
    bases=st.integers(1, 20),
)
def test_an_entry_depends_on_its_position_alone(
    seed: int, step: int, particles: int, bases: int
) -> None:
    dropout = Dropout(0.3, seed)
    part = dropout.factors(step, particles, bases)
    assert part.shape == (particles, bases)
    assert torch.equal(part, dropout.factors(step, 20, 20)[:particles, :bases])
    assert np.array_equal(dropout.keys(101)[: step + 1], dropout.keys(step + 1))


@pytest.mark.parametrize("rate", [0.0, 0.125, 0.25, 0.7])
def test_the_mean_is_kept(rate: float) -> None:
    dropout = Dropout(rate, 5)
    p = dropout.threshold / LEVELS
    assert (1 - p) * dropout.scale == pytest.approx(1.0, rel=1e-15)
    factors = dropout.factors(0, P, B)
    assert set(factors.unique().tolist()) <= {0.0, dropout.scale}
    error = 5 * math.sqrt(p / (1 - p) / factors.numel())
    assert float(factors.mean()) == pytest.approx(1.0, abs=error + 1e-15)


def test_without_a_rate_nothing_is_dropped() -> None:
    assert torch.equal(Dropout(0.0, 1).factors(2, 5, 7), torch.ones(5, 7, dtype=torch.float64))


def test_the_hash_is_a_permutation_of_what_it_is_given() -> None:
    numbers = np.arange(2**16, dtype=np.uint32)
    assert len(np.unique(mix(numbers))) == len(numbers)


@pytest.mark.parametrize("rate", [-0.1, 1.0, math.nan])
def test_a_wrong_rate_is_answered_with_a_sentence(rate: float) -> None:
    with pytest.raises(InputError, match="must be in"):
        Dropout(rate, 0)
