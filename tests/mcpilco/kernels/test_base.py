from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from mcpilco.kernels import (
    MPK,
    RBF,
    ActiveDims,
    Kernel,
    Linear,
    NoCanonicalFormError,
    Product,
    Scaled,
    Sum,
)
from mcpilco.typing import InputError
from tests.reference.terms import matrix

BATCH = (2,)


def leaves(width: int) -> st.SearchStrategy[Kernel]:
    return st.one_of(
        st.builds(RBF, st.just(width), st.just(BATCH), lengthscale=st.floats(0.5, 3)),
        st.builds(Linear, st.just(width), st.just(BATCH), bias=st.booleans()),
        st.builds(MPK, st.just(width), st.integers(1, 3), st.just(BATCH)),
    )


def nodes(kernels: st.SearchStrategy[Kernel]) -> st.SearchStrategy[Kernel]:
    return st.one_of(
        st.builds(Sum, kernels, kernels),
        st.builds(Product, kernels, kernels),
        st.builds(Scaled, kernels, st.floats(0.1, 5)),
    )


def narrow(width: int) -> st.SearchStrategy[Kernel]:
    """Kernels of two of the regressors, shown as kernels of all."""
    dims = st.lists(st.integers(0, width - 1), min_size=2, max_size=2, unique=True)
    inner = st.recursive(leaves(2), nodes, max_leaves=3)
    return st.builds(ActiveDims, inner, dims, st.just(width))


KERNELS = st.recursive(leaves(3) | narrow(3), nodes, max_leaves=5)


@settings(deadline=None, max_examples=60)
@given(kernel=KERNELS, seed=st.integers(0, 1000))
def test_terms_of_nested_algebra_sum_to_the_kernel(kernel: Kernel, seed: int):
    generator = torch.Generator().manual_seed(seed)
    X1, X2 = torch.randn(2, 4, 3, generator=generator, dtype=torch.float64)
    with torch.no_grad():
        for log in kernel.parameters():
            log += 0.3 * torch.randn(log.shape, generator=generator, dtype=log.dtype)
    K = kernel(X1, X2)
    total = sum(matrix(term, X1, X2) for term in kernel.terms())
    size = K.abs().amax().clamp_min(1.0)
    torch.testing.assert_close(total / size, K / size, rtol=0, atol=1e-12)
    assert all(t.v.shape == BATCH and t.w.shape == (*BATCH, 3) for t in kernel.terms())
    assert all(t.s.shape == (*t.c.shape, 3) for t in kernel.terms())


def test_kernel_without_canonical_form_says_so():
    class Cosine(RBF):
        terms = Kernel.terms

    for kernel in (Cosine(2), Cosine(2) + RBF(2), Scaled(Cosine(2)), RBF(2) * Cosine(2)):
        with pytest.raises(NoCanonicalFormError, match="Cosine has no canonical form"):
            kernel.terms()
    assert issubclass(NoCanonicalFormError, InputError)
    assert issubclass(NoCanonicalFormError, NotImplementedError)


def test_positive_hyperparameter_is_stored_as_its_log():
    kernel = RBF(2, (2,), lengthscale=torch.tensor([1.0, 4.0]), variance=2.0)
    torch.testing.assert_close(kernel.log_lengthscale[0].exp(), kernel.lengthscale[0])
    torch.testing.assert_close(kernel.lengthscale[1], torch.tensor([1.0, 4.0]).double())
    parameter = kernel.log_variance
    kernel.variance = 5.0
    assert kernel.log_variance is parameter
    torch.testing.assert_close(kernel.variance, torch.tensor([5.0, 5.0]).double())


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_value_that_is_not_positive_is_refused(value: float):
    kernel = RBF(2)
    with pytest.raises(InputError, match="RBF.variance must be positive and finite"):
        kernel.variance = value


def test_composites_refuse_parts_that_do_not_fit():
    with pytest.raises(InputError, match="one width and batch"):
        RBF(2) + RBF(3)
    with pytest.raises(InputError, match="one width and batch"):
        RBF(2, (2,)) * RBF(2)
    with pytest.raises(InputError, match="2 different dims"):
        ActiveDims(RBF(2), (0, 0), 3)
    with pytest.raises(InputError, match=r"within 0\.\.2"):
        ActiveDims(RBF(2), (0, 3), 3)
    with pytest.raises(InputError, match="broadcasts to"):
        RBF(2, lengthscale=torch.ones(3))
