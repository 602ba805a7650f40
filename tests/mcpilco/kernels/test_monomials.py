from __future__ import annotations

from math import comb

import pytest
import torch

from mcpilco.kernels import MPK, RBF, ActiveDims, Linear, Scaled
from mcpilco.kernels.monomials import Monomials
from tests.mcpilco.kernels.test_kernels import points, shake

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
    kernel, X1, X2 = shake(POLYNOMIALS[name]()), points(5, 3), points(4, 3, seed=2)
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
    feature = Monomials.of(kernel.terms())(points(7, 1, 5, 3))
    torch.testing.assert_close(feature.detach(), torch.tensor([[[2.0]], [[3.0]]]).double())
