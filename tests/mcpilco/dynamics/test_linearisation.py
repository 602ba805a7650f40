"""Laws of linearised models: slopes are those of autograd, draws are of the posterior."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mcpilco.dynamics import linearised, linearised_along
from mcpilco.kernels import MPK, RBF
from mcpilco.task import TaskSpec
from tests.mcpilco.conftest import make_dynamics

STATE = torch.tensor([0.2, -0.3, 0.7, 0.4], dtype=torch.float64)
INPUT = torch.tensor([0.5], dtype=torch.float64)


@pytest.mark.parametrize("kernel", [RBF(6, (2,)), RBF(6, (2,)) + MPK(6, 2, (2,))])
def test_slopes_of_the_mean_are_those_of_autograd(task: TaskSpec, kernel) -> None:
    dynamics = make_dynamics(task, kernel)

    def following(x: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
        return dynamics.expected(x[None], u[None])[0]

    A, B = torch.autograd.functional.jacobian(following, (STATE, INPUT))
    found = linearised(dynamics, STATE, INPUT)
    np.testing.assert_allclose(found.after[0], following(STATE, INPUT), rtol=1e-10)
    np.testing.assert_allclose(found.A[0], A, atol=1e-5)
    np.testing.assert_allclose(found.B[0], B, atol=1e-5)


def test_along_a_motion_each_point_is_linearised_as_alone(task: TaskSpec) -> None:
    dynamics = make_dynamics(task, RBF(6, (2,)))
    states = STATE.numpy() + 0.1 * np.arange(5.0)[:, None]
    inputs = INPUT.numpy() * np.arange(5.0)[:, None]
    course = linearised_along(dynamics, states, inputs)
    x, u = torch.from_numpy(states), torch.from_numpy(inputs)
    for t in range(5):
        alone = linearised(dynamics, x[t], u[t])
        np.testing.assert_allclose(course.after[t], alone.after[0], rtol=1e-10)
        np.testing.assert_allclose(course.A[t], alone.A[0], atol=1e-8)
    _, variance = dynamics.posterior.mean_and_variance(dynamics.regressors(x, u))
    spread = variance + dynamics.posterior.noise_std.square()
    wanted = torch.einsum("xe,ne,ye->nxy", dynamics.B, spread, dynamics.B)
    np.testing.assert_allclose(course.W, wanted.numpy(), rtol=1e-10)


def test_draws_have_the_variance_of_the_posterior_and_of_its_slopes(task: TaskSpec) -> None:
    dynamics = make_dynamics(task, RBF(6, (2,)))
    draws, posterior = 4000, dynamics.posterior
    found = linearised(dynamics, STATE, INPUT, draws)
    at = dynamics.regressors(STATE[None], INPUT[None])
    _, variance = posterior.mean_and_variance(at)
    speeds = found.after[1:, [1, 3]]
    np.testing.assert_allclose(speeds.std(0), variance[0].sqrt(), rtol=0.06)

    def covariance(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        x, y = (dynamics.regressors(STATE[None], u[None]) for u in (a, b))
        V, W = (posterior.L_inv @ posterior.kernel(posterior.X, z) for z in (x, y))
        return (posterior.kernel(x, y) - V.mT @ W)[:, 0, 0]

    h = 1e-2 * torch.ones(1, dtype=torch.float64)
    corners = [covariance(INPUT + a * h, INPUT + b * h) * a * b for a in (1, -1) for b in (1, -1)]
    expected = (sum(corners) / (4 * h**2)).sqrt()
    np.testing.assert_allclose(found.B[1:, [1, 3], 0].std(0), expected, rtol=0.06)


def test_equal_seeds_give_equal_draws(task: TaskSpec) -> None:
    dynamics = make_dynamics(task)
    one, same, other = (linearised(dynamics, STATE, INPUT, 3, seed).A for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, same)
    assert not np.array_equal(one[1:], other[1:])
    np.testing.assert_array_equal(one[0], other[0])
