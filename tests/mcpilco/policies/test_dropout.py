"""Laws of the dropout masks: their statistics, and that each entry knows only its position."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from mcpilco.policies.dropout import LEVELS, Dropout, mix
from mcpilco.typing import InputError

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
