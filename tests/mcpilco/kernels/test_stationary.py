from __future__ import annotations

import pytest
import torch

from mcpilco.kernels import RBF


def test_rbf_is_its_formula():
    kernel = RBF(2, lengthscale=torch.tensor([2.0, 0.5]), variance=3.0)
    x, y = torch.tensor([[1.0, 2.0]]).double(), torch.tensor([[0.0, 1.5]]).double()
    expected = 3.0 * torch.exp(torch.tensor(-0.5 * ((1 / 2) ** 2 + (0.5 / 0.5) ** 2)).double())
    torch.testing.assert_close(kernel(x, y)[0, 0], expected)


def test_rbf_equals_scikit_learn():
    gaussian_process = pytest.importorskip("sklearn.gaussian_process")
    X = torch.randn(20, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    scales = [0.5, 1.0, 2.0]
    oracle = 1.7 * gaussian_process.kernels.RBF(scales)
    kernel = RBF(3, lengthscale=torch.tensor(scales), variance=1.7)
    torch.testing.assert_close(kernel(X, X).detach(), torch.from_numpy(oracle(X.numpy())))


def test_rbf_keeps_its_digits_far_from_the_origin():
    kernel = RBF(1, lengthscale=0.01)
    X = torch.linspace(0, 0.05, 6, dtype=torch.float64)[:, None]
    torch.testing.assert_close(kernel(X + 1e4, X + 1e4), kernel(X, X), rtol=1e-6, atol=1e-9)
