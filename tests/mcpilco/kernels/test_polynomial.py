from __future__ import annotations

import math
from math import comb

import pytest
import torch

from mcpilco.gp import GP
from mcpilco.kernels import MPK, RBF, ActiveDims, Linear, Scaled
from mcpilco.kernels.polynomial import Monomials
from mcpilco.typing import InputError
from tests.mcpilco.kernels.test_kernels import points as spread_points
from tests.mcpilco.kernels.test_kernels import shake


def points(n: int, width: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(n, width, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_mpk_is_a_product_of_linear_kernels():
    X = points(6, 2)
    kernel = MPK(2, 3)
    with torch.no_grad():
        kernel.log_weight_steps += points(3, 2, seed=1)
        kernel.log_offset_steps += points(3, 1, seed=2)[:, 0]
    expected = torch.ones(6, 6, dtype=torch.float64)
    for p in range(3):
        factor = Linear(2)
        factor.weights, factor.bias = kernel.weights[p], kernel.offsets[p]
        expected = expected * factor(X, X)
    torch.testing.assert_close(kernel(X, X), expected)


def test_mpk_sums_its_steps_backwards():
    """Thesis eq. (6.28)."""
    kernel = MPK(1, 3)
    kernel.weight_steps = torch.tensor([[1.0], [10.0], [100.0]])
    kernel.offset_steps = torch.tensor([1.0, 2.0, 4.0])
    torch.testing.assert_close(kernel.weights[:, 0], torch.tensor([111.0, 110.0, 100.0]).double())
    torch.testing.assert_close(kernel.offsets, torch.tensor([7.0, 6.0, 4.0]).double())


def test_mpk_of_degree_two_reproduces_a_quadratic_function():
    """More than six samples fix its six coefficients, so it is known even far from the data."""

    def quadratic(X):
        x, y = X.T
        return (1 + 2 * x - y + 0.5 * x * y - 3 * x**2 + y**2)[:, None]

    X, Xq = points(30, 2), 10 * points(50, 2, seed=1)
    gp = GP(MPK(2, 2, (1,)), noise_std=1e-5, noise_floor=0.0)
    mean, variance = gp.condition(X, quadratic(X)).mean_and_variance(Xq)
    torch.testing.assert_close(mean, quadratic(Xq), rtol=1e-5, atol=1e-5)
    assert (variance < 1e-4).all()


def test_mpk_of_degree_one_does_not_reproduce_a_quadratic_function():
    X = points(30, 2)
    gp = GP(MPK(2, 1, (1,)), noise_std=1e-5, noise_floor=0.0)
    mean, _ = gp.condition(X, X[:, :1].square()).mean_and_variance(X)
    assert (mean - X[:, :1].square()).abs().max() > 0.1


def test_mpk_expands_into_monomials():
    """One regressor: k = sum of coefficients of (c1 + s1 t)(c2 + s2 t), t = x x'."""
    kernel, x = MPK(1, 2), torch.tensor([[2.0]]).double()
    (c1, c2), (s1, s2) = kernel.offsets.tolist(), kernel.weights[:, 0].tolist()
    expected = c1 * c2 + (c1 * s2 + c2 * s1) * 6.0 + s1 * s2 * 36.0
    assert math.isclose(kernel(x, torch.tensor([[3.0]]).double()).item(), expected)


def test_linear_without_bias_is_zero_at_the_origin():
    zero = torch.zeros(1, 2).double()
    assert Linear(2, bias=False)(zero, points(3, 2)).abs().max() == 0
    assert Linear(2, bias=True)(zero, points(3, 2)).abs().min() > 0


def test_degree_below_one_is_refused():
    with pytest.raises(InputError, match="degree of at least 1, got 0"):
        MPK(2, 0)


BATCH = (2,)

POLYNOMIALS = {
    "Linear": lambda: Linear(3, BATCH),
    "Linear without bias": lambda: Linear(3, BATCH, bias=False),
    "MPK": lambda: MPK(3, 3, BATCH),
    "sum": lambda: MPK(3, 2, BATCH) + Linear(3, BATCH),
    "product": lambda: Scaled(MPK(3, 2, BATCH), 2.0) * Linear(3, BATCH, bias=False),
    "ActiveDims": lambda: ActiveDims(MPK(2, 2, BATCH), (2, 0), 3),
}


@pytest.mark.parametrize("name", POLYNOMIALS)
def test_features_multiply_to_the_kernel(name: str) -> None:
    kernel, X1, X2 = shake(POLYNOMIALS[name]()), spread_points(5, 3), spread_points(4, 3, seed=2)
    monomials = Monomials.of(kernel.terms())
    product = monomials(X1[None]) @ monomials(X2[None]).mT
    torch.testing.assert_close(product, kernel(X1, X2), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("width", "degree"), [(1, 1), (3, 2), (6, 3)])
def test_each_monomial_is_there_once(width: int, degree: int) -> None:
    monomials = Monomials.of(MPK(width, degree, BATCH).terms())
    assert monomials.entries.shape == (degree, comb(width + degree, degree))
    assert len(set(map(tuple, monomials.entries.T.tolist()))) == comb(width + degree, degree)


def test_monomials_that_no_term_has_are_left_out() -> None:
    without_bias = Monomials.of(Linear(3, BATCH, bias=False).terms())
    assert without_bias.entries.tolist() == [[1, 2, 3]]
    narrow = Monomials.of(ActiveDims(Linear(1, BATCH), (2,), 4).terms())
    assert narrow.entries.tolist() == [[0, 3]]


def test_an_exponential_alone_has_a_constant_feature() -> None:
    kernel = RBF(3, BATCH, variance=torch.tensor([4.0, 9.0]))
    feature = Monomials.of(kernel.terms())(spread_points(7, 1, 5, 3))
    torch.testing.assert_close(feature.detach(), torch.tensor([[[2.0]], [[3.0]]]).double())
