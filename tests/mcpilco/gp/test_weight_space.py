"""Laws of computing with the features of a kernel: all is as with the kernel, but for rounding."""

from __future__ import annotations

import pytest
import torch

from mcpilco.gp.gp import GP
from mcpilco.gp.weight_space import WeightSpaceGP
from mcpilco.kernels import IPK, PK, SEDMPK, VolterraMPK
from tests.mcpilco.kernels.test_kernels import points, shake

KERNELS = {
    "PK": lambda: PK(3, 3, (2,)),
    "IPK": lambda: IPK(3, 3, (2,)),
    "MPK": lambda: VolterraMPK(3, 3, (2,)),
    "SED-MPK": lambda: SEDMPK(3, 3, (2,)),
    "SED-MPK, hierarchical": lambda: SEDMPK(3, 2, (2,), hierarchical=True),
}


@pytest.fixture(params=KERNELS)
def both(request):
    """The same prior twice: in weight space, and with the kernel."""
    kernel = shake(KERNELS[request.param]())
    return (kind(kernel, noise_std=0.2) for kind in (WeightSpaceGP, GP))


def data(samples: int) -> tuple[torch.Tensor, torch.Tensor]:
    X = points(samples, 3)
    return X, torch.stack([X[:, 0] * X[:, 1] + X[:, 2] ** 3, X[:, 0]], 1) + points(samples, 2)


@pytest.mark.parametrize("samples", [200, 10])
def test_evidence_and_its_gradient_are_those_of_the_kernel(both, samples: int) -> None:
    found = []
    for gp in both:
        nlml = gp.nlml(*data(samples))
        gradients = torch.autograd.grad(nlml.sum(), list(gp.parameters()))
        found.append((nlml.detach(), torch.cat([gradient.flatten() for gradient in gradients])))
    for here, there in zip(*found, strict=True):
        size = there.abs().max()
        torch.testing.assert_close(here / size, there / size, rtol=0, atol=1e-10)


@pytest.mark.parametrize("samples", [200, 10])
def test_posterior_is_that_of_the_kernel(both, samples: int) -> None:
    queries = points(2, 7, 3, seed=5)
    here, there = (gp.condition(*data(samples)).mean_and_variance(queries) for gp in both)
    for one, other in zip(here, there, strict=True):
        assert one.shape == (2, 7, 2)
        torch.testing.assert_close(one, other, rtol=1e-10, atol=1e-10)


def test_fit_finds_what_a_fit_of_the_kernel_finds() -> None:
    X, Y = data(100)
    fits = [kind(PK(3, 3, (2,))).fit(X, Y, tolerance=1e-9) for kind in (WeightSpaceGP, GP)]
    assert fits[0].report.nlml == pytest.approx(fits[1].report.nlml, abs=1e-3)


def test_nearly_no_noise_needs_no_jitter(caplog) -> None:
    """Where the kernel's matrix is singular to rounding: the residuals are told nonetheless."""
    X = points(300, 3)
    Y = X[:, :1] ** 3 + X[:, 1:2]
    gp = WeightSpaceGP(PK(3, 3, (1,)), noise_std=1e-6, noise_floor=0.0)
    with caplog.at_level("DEBUG"):
        mean, variance = gp.condition(X, Y).mean_and_variance(X)
        assert gp.nlml(X, Y).isfinite().all()
    assert not caplog.records
    torch.testing.assert_close(mean, Y, rtol=0, atol=1e-6)
    assert (variance < 1e-12).all()


def test_new_data_are_not_mistaken_for_old() -> None:
    gp = WeightSpaceGP(PK(3, 2, (2,)), noise_std=0.2)
    first, second = data(50), data(60)
    once = gp.nlml(*first)
    assert (gp.nlml(*second) != once).all()
    torch.testing.assert_close(gp.nlml(*first), once, rtol=0, atol=0)
