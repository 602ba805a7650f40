"""Laws of kernels that act where a gate is open."""

from __future__ import annotations

import pytest
import torch

from mcpilco.gp import GP
from mcpilco.kernels import RBF, HardGate, NoCanonicalFormError, Rescaled, SmoothGate
from mcpilco.typing import InputError

GATES = (HardGate, SmoothGate)


def points(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.fixture(params=GATES)
def kernel(request) -> Rescaled:
    return Rescaled(RBF(3, (2,), variance=torch.tensor([1.0, 4.0])), request.param(1, 0.7))


def test_it_is_the_covariance_of_a_scaled_function(kernel):
    X1, X2 = points(6, 3), points(5, 3, seed=1)
    expected = torch.einsum(
        "n,enm,m->enm", kernel.scale(X1), kernel.kernel(X1, X2), kernel.scale(X2)
    )
    torch.testing.assert_close(kernel(X1, X2), expected)


def test_it_is_symmetric_and_positive_semidefinite(kernel):
    X = points(40, 3)
    K = kernel(X, X)
    torch.testing.assert_close(K, K.mT, rtol=0, atol=1e-14)
    assert (torch.linalg.eigvalsh(K) > -1e-12).all()
    torch.testing.assert_close(kernel.diag(X), K.diagonal(dim1=-2, dim2=-1))


def test_leading_axes_of_the_data_broadcast(kernel):
    X1, X2 = points(5, 3), points(7, 1, 4, 3, seed=2)
    assert kernel(X1, X2).shape == (7, 2, 5, 4)
    torch.testing.assert_close(kernel(X1, X2)[3], kernel(X1, X2[3]))


def test_gates_are_open_at_rest_and_closed_far_from_it():
    X = torch.tensor([[0.0], [0.0699], [0.0701], [1.0]], dtype=torch.float64)
    assert HardGate(0, 0.07)(X).tolist() == [1.0, 1.0, 0.0, 0.0]
    smooth = SmoothGate(0, 0.07)(X)
    assert smooth[0] == 1.0
    assert smooth[2] == pytest.approx(torch.exp(torch.tensor(-1.0)).item(), rel=0.01)
    assert smooth[3] < 1e-80


def test_gradients_flow_through_the_smooth_gate_alone():
    smooth = Rescaled(RBF(3), SmoothGate(1, 0.7))
    X1, X2 = points(4, 3).requires_grad_(), points(3, 3, seed=1).requires_grad_()
    assert torch.autograd.gradcheck(smooth, (X1, X2))
    assert torch.autograd.gradcheck(smooth.diag, (X1,))
    hard = HardGate(1, 0.7)(X1)
    assert not hard.requires_grad


def test_a_fit_starts_with_the_power_of_the_targets(kernel):
    X, Y = points(50, 3), 3.0 * points(50, 2, seed=3)
    kernel.start_from(X, Y)
    torch.testing.assert_close(kernel.diag(X).mean(-1), Y.square().mean(0))


def test_a_gate_that_no_sample_opens_does_not_hinder_a_start():
    kernel = Rescaled(RBF(3, (1,)), HardGate(1, 1e-9))
    kernel.start_from(points(20, 3), points(20, 1))
    assert kernel.kernel.lengthscale.isfinite().all()


def test_a_gaussian_process_knows_nothing_where_the_gate_is_closed():
    X = torch.linspace(-1.0, 1.0, 41, dtype=torch.float64)[:, None]
    Y = torch.where(X.abs() < 0.5, X.cos(), torch.zeros_like(X))
    gp = GP(Rescaled(RBF(1, (1,)), HardGate(0, 0.5)), noise_std=0.02)
    mean, variance = gp.condition(X, Y).mean_and_variance(X)
    inside = X[:, 0].abs() < 0.5
    assert (mean[inside] - Y[inside]).abs().max() < 0.02
    assert not mean[~inside].any()
    assert variance[~inside].max() < 1e-6


def test_it_says_that_it_has_no_canonical_form(kernel):
    with pytest.raises(NoCanonicalFormError, match="Rescaled"):
        kernel.terms()


def test_a_gate_needs_a_size():
    with pytest.raises(InputError, match="HardGate.size must be positive"):
        HardGate(0, 0.0)
