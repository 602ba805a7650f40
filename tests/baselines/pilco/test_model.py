"""PILCO's GPs: penalised where hyperparameters are extreme, and else the marginal likelihood."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from baselines.pilco import PilcoConfig
from baselines.pilco.model import CurbedGP, PilcoModel
from mcpilco.data import Transitions
from mcpilco.gp import GP
from mcpilco.kernels import RBF, typical_size
from tests.mcpilco.point import TASK


def curbed(**numbers) -> CurbedGP:
    return CurbedGP(RBF(2, (1,)), PilcoConfig(**numbers), ("y",))


def smooth(count: int = 40, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    """Samples of a function of the first regressor, without noise."""
    X = torch.from_numpy(np.random.default_rng(seed).standard_normal((count, 2)))
    return X, torch.sin(X[:, :1])


def penalty(gp: CurbedGP, X: torch.Tensor, Y: torch.Tensor) -> float:
    return float((gp.nlml(X, Y) - GP.nlml(gp, X, Y)).detach())


def test_ordinary_hyperparameters_cost_nothing():
    gp, (X, Y) = curbed(), smooth()
    gp._start_from(X, Y)
    assert penalty(gp, X, Y) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("entry", ["lengthscale", "signal"])
def test_at_a_curb_the_penalty_is_one(entry):
    gp, (X, Y) = curbed(), smooth()
    gp._start_from(X, Y)
    if entry == "lengthscale":
        gp.kernel.lengthscale = typical_size(X)[None] * torch.tensor([[100.0, 1.0]])
    else:
        gp.noise_excess = gp.kernel.variance.sqrt() / 1000.0
    assert penalty(gp, X, Y) == pytest.approx(1.0, rel=1e-6)


def test_a_fit_stays_within_the_curbs():
    """Without noise, and with an input that does not matter: both would grow without bound."""
    (X, Y), ratios, lengths = smooth(), [], []
    for gp in (curbed(), GP(RBF(2, (1,)), noise_floor=0.0)):
        gp.fit(X, Y)
        ratios.append(float((gp.kernel.variance.sqrt() / gp.noise_std).detach()))
        lengths.append(float((gp.kernel.lengthscale / typical_size(X)).max().detach()))
    assert ratios[0] < 2000 < ratios[1]
    assert lengths[0] < 120 < lengths[1]


def rows(seed: int, count: int = 30) -> Transitions:
    rng = np.random.default_rng(seed)
    x, u = rng.standard_normal((count, 2)), rng.uniform(-2, 2, (count, 1))
    change = np.stack([0.2 * x[:, 1], 0.2 * u[:, 0]], 1)
    return Transitions(x, u, x + change + 0.01 * rng.standard_normal((count, 2)))


def test_the_noise_of_the_changes_is_found():
    model = PilcoModel(PilcoConfig(), TASK)
    model.fit(rows(1))
    assert model.names == TASK.state_names
    assert np.array(model.noise_std) == pytest.approx(0.01, rel=0.35)


def test_the_moments_at_a_point_are_the_posterior():
    model, data = PilcoModel(PilcoConfig(), TASK), rows(2)
    model.fit(data)
    bases = model.moments(data).bases
    posterior = model.gp.condition(*model.rows(data))
    at = torch.tensor([[0.1, -0.2, 0.5]]).double()
    with torch.no_grad():
        mean, variance = posterior.mean_and_variance(at)
    distance = (at - bases.centres) / bases.lengthscale[:, None, :]
    k = bases.variance[:, None] * torch.exp(-0.5 * distance.square().sum(-1))
    left = bases.variance - torch.einsum("ei,eij,ej->e", k, bases.inverse, k)
    assert torch.allclose((k * bases.weights).sum(-1), mean[0], atol=1e-9)
    assert torch.allclose(left, variance[0], atol=1e-8)


def test_a_constant_input_has_a_scale_all_the_same():
    X = torch.tensor([[0.0, 3.0, 1.0], [0.0, 3.0, 2.0]]).double()
    assert typical_size(X).tolist() == [1.0, 3.0, 0.5]
