"""The prediction of PILCO: the same in plain torch, and what it is of."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from baselines.moments import Gaussian, through_bases, through_squash
from baselines.pilco.rollout import predicted
from baselines.pilco.search import Problem
from mcpilco.policies import cart_pole_cost
from tests.baselines.differences import slope_along
from tests.baselines.pilco.models import narrow_start, random_dynamics, random_policy
from tests.reference import pilco as plain

pytestmark = pytest.mark.xdist_group(
    "compiled moments"
)  # one process compiles what all of them need

SYSTEMS = {
    "cart-pole": {},
    "no angle": {"angles": ()},
    "two angles, two inputs": {"states": 3, "angles": (0, 2), "inputs": 2, "outputs": 3},
    "fewer outputs than states": {"outputs": 2},
}


def parts(states: Gaussian, inputs: Gaussian) -> list[torch.Tensor]:
    return [states.mean, states.cov, inputs.mean, inputs.cov]


@pytest.mark.slow
@pytest.mark.parametrize("name", SYSTEMS)
def test_compiled_loops_compute_the_same_with_the_same_gradient(name):
    system = SYSTEMS[name]
    dynamics = random_dynamics(**system)
    policy = random_policy(dynamics, system.get("inputs", 1))
    start, rng = narrow_start(len(dynamics.A)), np.random.default_rng(0)
    results, gradients, weights = [], [], None
    for predict in (plain.predicted, predicted):
        found = parts(*predict(dynamics, policy, start, 4))
        weights = weights or [torch.from_numpy(rng.standard_normal(p.shape)) for p in found]
        total = sum((p * w).sum() for p, w in zip(found, weights, strict=True))
        gradients.append(torch.autograd.grad(total, list(policy.parameters())))
        results.append([part.detach() for part in found])
    for slow, fast in zip(*results, strict=True):
        assert torch.allclose(slow, fast, rtol=1e-10, atol=1e-12)
    for slow, fast in zip(*gradients, strict=True):
        assert torch.allclose(slow, fast, rtol=1e-8, atol=1e-9)


@pytest.mark.slow  # compiles the loops of moments
def test_the_gradient_of_the_expected_cost_is_that_of_central_differences():
    dynamics = random_dynamics()
    policy = random_policy(dynamics)
    problem = Problem(dynamics, cart_pole_cost(), narrow_start(), 5)
    total = problem.prediction(policy)[2].sum()
    gradient = parameters_to_vector(torch.autograd.grad(total, list(policy.parameters())))
    at = parameters_to_vector(policy.parameters()).detach()
    way = torch.from_numpy(np.random.default_rng(1).standard_normal(len(at)))

    def cost(h: float) -> torch.Tensor:
        vector_to_parameters(at + h * way, policy.parameters())
        return problem.prediction(policy)[2].sum()

    assert float(gradient @ way) == pytest.approx(slope_along(cost), rel=1e-7, abs=1e-7)


def test_a_step_from_a_certain_state_is_the_posterior_at_it():
    dynamics = random_dynamics()
    policy = random_policy(dynamics)
    mean = narrow_start().mean
    states, inputs = predicted(dynamics, policy, Gaussian(mean, torch.zeros(4, 4).double()), 1)
    with torch.no_grad():
        u = policy(mean)
        x = dynamics.augmentation.regressors(mean, u)
    bases = dynamics.bases
    distance = (x - bases.centres) / bases.lengthscale[:, None, :]
    k = bases.variance[:, None] * torch.exp(-0.5 * distance.square().sum(-1))
    change = (k * bases.weights).sum(-1)
    left = bases.variance - torch.einsum("ei,eij,ej->e", k, bases.inverse, k)
    assert torch.allclose(inputs.mean[0], u, atol=1e-12)
    assert torch.allclose(states.mean[1], dynamics.A @ mean + dynamics.B @ change, atol=1e-12)
    assert torch.allclose(states.cov[1], torch.diag(left), atol=1e-12)


@pytest.mark.parametrize("scale", [0.01, 0.1])
def test_one_step_has_nearly_the_moments_of_particles(scale):
    """Matched stage by stage: the error falls with the spread, where that of samples would not."""
    dynamics = random_dynamics()
    policy = random_policy(dynamics)
    mean, count = narrow_start().mean, 100_000
    cov = scale**2 * torch.eye(4, dtype=torch.float64)
    states, _ = predicted(dynamics, policy, Gaussian(mean, cov), 1)
    rng = np.random.default_rng(2)
    with torch.no_grad():
        x = mean + scale * torch.from_numpy(rng.standard_normal((count, 4)))
        z = dynamics.augmentation.regressors(x, policy(x))
        bases, changes = dynamics.bases, []
        for e in range(4):
            distance = (z[:, None, :] - bases.centres) / bases.lengthscale[e]
            k = bases.variance[e] * torch.exp(-0.5 * distance.square().sum(-1))
            variance = bases.variance[e] - ((k @ bases.inverse[e]) * k).sum(-1)
            noise = torch.from_numpy(rng.standard_normal(count))
            changes.append(k @ bases.weights[e] + variance.clamp_min(0).sqrt() * noise)
        following = x @ dynamics.A.T + torch.stack(changes, 1) @ dynamics.B.T
    std = following.std(0)
    assert (((following.mean(0) - states.mean[1]) / std).abs() < 0.015).all()
    correlation = (following.T.cov() - states.cov[1]) / (std[:, None] * std)
    assert (correlation.abs() < 0.02).all()


def test_covariances_stay_symmetric_and_positive():
    dynamics = random_dynamics()
    states, _ = predicted(dynamics, random_policy(dynamics), narrow_start(), 20)
    assert torch.equal(states.cov, states.cov.mT)
    assert float(torch.linalg.eigvalsh(states.cov.detach()).min()) > -1e-12


def test_a_covariance_that_is_none_ends_the_prediction():
    dynamics = random_dynamics()
    start = Gaussian(torch.zeros(4).double(), -100.0 * torch.eye(4).double())
    with pytest.raises(torch.linalg.LinAlgError):
        predicted(dynamics, random_policy(dynamics), start, 3)


def test_inputs_stay_within_their_bounds():
    policy = random_policy(random_dynamics(inputs=2), inputs=2)
    states = 10 * torch.randn(500, 4, generator=torch.Generator().manual_seed(0)).double()
    with torch.no_grad():
        policy.targets.mul_(100.0)
        inputs = policy(states)
    assert inputs.shape == (500, 2)
    assert bool(((inputs >= -1.0) & (inputs <= 3.0)).all())


def test_at_its_centres_the_mean_is_nearly_the_target():
    policy = random_policy(random_dynamics())
    bases = policy.bases()
    with torch.no_grad():
        at = through_bases(bases, policy.centres, torch.zeros(6, 5, 5).double())
    assert torch.allclose(at.mean, policy.targets, atol=1e-2)


def test_moments_of_a_certain_state_are_the_answer():
    policy = random_policy(random_dynamics())
    state = torch.tensor([0.3, -0.2, 2.0, 1.0]).double()
    z, nothing = policy.augmentation(state), torch.zeros(5, 5).double()
    with torch.no_grad():
        a = through_bases(policy.bases(), z, nothing)
        u = through_squash(a.mean, a.cov, policy.squash.half_range)
        assert torch.allclose(policy.squash.centre + u.mean, policy(state), atol=1e-12)


def test_ten_centres_of_a_cart_pole_are_sixty_five_numbers():
    policy = random_policy(random_dynamics(), centres=10)
    assert sum(parameter.numel() for parameter in policy.parameters()) == 65
