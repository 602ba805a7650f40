"""Laws of particles, seen on a linear model whose trajectories are known."""

from __future__ import annotations

import dataclasses
import math

import pytest
import torch
from torch import Tensor

from mcpilco.policies import Dropout, QuadraticCost, SaturatingCost
from mcpilco.search.particles import Particles, Problem, Sensing, rollout
from mcpilco.sensing import Observer
from mcpilco.sensing.estimator import LinearEstimator
from tests.mcpilco.linear import A, B, K, LinearDynamics, LinearPolicy

T = 12
START = torch.tensor([1.0, -0.5], dtype=torch.float64)
COST = QuadraticCost((0.0, 0.0), (1.0, 0.5), (0.1,))


def zeros(*shape: int) -> Tensor:
    return torch.zeros(*shape, dtype=torch.float64)


def make_problem(scale: float, cost=COST) -> Problem:
    return Problem(
        dynamics=LinearDynamics(scale),
        cost=cost,
        start_mean=START,
        start_std=torch.tensor([0.3, 0.1], dtype=torch.float64),
        horizon=T,
        reference_cost=1.0,
        rollout=rollout,
    )


def test_without_noise_the_particles_follow_the_closed_form() -> None:
    start = torch.stack([START, 2 * START, zeros(2)])
    particles = rollout(LinearDynamics(), LinearPolicy(), start, zeros(T, 3, 2))
    closed_loop = A + B @ K
    for t in range(T + 1):
        expected = start @ torch.linalg.matrix_power(closed_loop, t).T
        torch.testing.assert_close(particles.states[t], expected)
        if t < T:
            torch.testing.assert_close(particles.inputs[t], expected @ K.T)


def test_a_step_takes_its_own_row_of_noise() -> None:
    noise = zeros(T, 2, 2)
    noise[3, 1, 0] = 1.0
    still = rollout(LinearDynamics(0.5), LinearPolicy(), zeros(2, 2), zeros(T, 2, 2)).states
    pushed = rollout(LinearDynamics(0.5), LinearPolicy(), zeros(2, 2), noise).states
    changed = (pushed != still).any(-1)
    assert changed[:, 0].tolist() == [False] * (T + 1)
    assert changed[:, 1].tolist() == [False] * 4 + [True] * (T - 3)
    torch.testing.assert_close(pushed[4, 1], torch.tensor([0.5, 0.0], dtype=torch.float64))


def test_the_mask_of_a_step_is_the_dropouts() -> None:
    dropout, start = Dropout(0.5, 1), START.expand(50, 2)
    inputs = rollout(LinearDynamics(), LinearPolicy(), start, zeros(T, 50, 2), dropout).inputs
    for step in range(T):
        dropped = dropout.factors(step, 50, 1) == 0
        assert torch.equal(inputs[step] == 0, dropped)


def test_gradients_flow_through_all_steps() -> None:
    policy, start = LinearPolicy(), torch.stack([START, -2 * START])

    def value(gain: Tensor) -> Tensor:
        particles = torch.func.functional_call(_Rollout(policy), {"policy.gain": gain}, (start,))
        return COST(particles.states[1:], particles.inputs)

    assert torch.autograd.gradcheck(value, (policy.gain,))


class _Rollout(torch.nn.Module):
    def __init__(self, policy: LinearPolicy) -> None:
        super().__init__()
        self.policy = policy

    def forward(self, start: Tensor) -> Particles:
        return rollout(LinearDynamics(), self.policy, start, zeros(T, len(start), 2))


def expected_cost(scale: float) -> float:
    """E[sum of x' Q x + r u^2] of the closed loop, by its mean and covariance."""
    Q, r, closed_loop = torch.diag(torch.tensor([1.0, 0.5]).double()), 0.1, A + B @ K
    mean, covariance = START, torch.diag(torch.tensor([0.3, 0.1]).double() ** 2)
    total = 0.0
    for _ in range(T):
        before = covariance + torch.outer(mean, mean)
        mean = closed_loop @ mean
        covariance = closed_loop @ covariance @ closed_loop.T + scale**2 * torch.eye(2)
        total += float((Q * (covariance + torch.outer(mean, mean))).sum())
        total += float(r * (K @ before @ K.T))
    return total


def test_the_error_of_the_expected_cost_falls_as_one_over_the_root_of_the_particles() -> None:
    scale, repeats = 0.2, 60
    problem, exact = make_problem(scale), expected_cost(scale)
    generator = torch.Generator().manual_seed(0)
    policy = LinearPolicy().requires_grad_(False)
    counts = [16, 64, 256, 1024]
    errors = []
    for count in counts:
        estimates = torch.stack(
            [
                problem.costs(problem.particles(policy, count, generator)).mean(1).sum()
                for _ in range(repeats)
            ]
        )
        errors.append(float((estimates - exact).square().mean().sqrt()))
        bias = float(estimates.mean()) - exact
        assert abs(bias) < 4 * float(estimates.std()) / math.sqrt(repeats)
    slope = math.log(errors[-1] / errors[0]) / math.log(counts[-1] / counts[0])
    assert slope == pytest.approx(-0.5, abs=0.1)


def test_particles_start_as_the_task_says() -> None:
    problem, count = make_problem(0.0), 4000
    generator = torch.Generator().manual_seed(2)
    start = problem.particles(LinearPolicy(), count, generator).states[0].detach()
    error = 5 * problem.start_std / math.sqrt(count)
    assert ((start.mean(0) - problem.start_mean).abs() < error).all()
    assert ((start.std(0) - problem.start_std).abs() < error).all()


def test_equal_generators_give_equal_particles_and_later_ones_differ() -> None:
    problem, generator = make_problem(0.1), torch.Generator().manual_seed(3)
    first, second = (problem.particles(LinearPolicy(), 5, generator) for _ in range(2))
    again = problem.particles(LinearPolicy(), 5, torch.Generator().manual_seed(3))
    assert torch.equal(first.states, again.states)
    assert not torch.equal(first.states[0], second.states[0])
    assert not torch.equal(first.states[1:], second.states[1:])


def test_costs_are_of_the_state_after_each_step_and_the_input_before() -> None:
    problem = make_problem(0.1)
    particles = problem.particles(LinearPolicy(), 3, torch.Generator().manual_seed(0))
    costs = problem.costs(particles)
    assert costs.shape == (T, 3)
    torch.testing.assert_close(costs[4, 1], COST(particles.states[5, 1], particles.inputs[4, 1]))


def test_a_problem_is_widened_where_its_cost_can_be() -> None:
    cost = SaturatingCost((0,), (0.0,), (1.0,), (False,))
    problem = make_problem(0.1, cost)
    assert problem.widened(3.0).cost == cost.widened(3.0)
    assert problem.widened(3.0).dynamics is problem.dynamics
    assert problem.widened(1.0) is problem
    other = make_problem(0.1)
    assert other.widened(3.0) is other  # a quadratic cost is felt everywhere


def exact_observer() -> Observer:
    """Measures all without noise, and takes the measurement as the estimate."""
    eye = torch.eye(2, dtype=torch.float64)
    estimator = LinearEstimator(A=A, C=eye, gains=eye[None], start=zeros(2))
    return Observer(estimator, noise_std=zeros(2), C=eye)


def test_with_an_exact_estimator_the_rollout_is_the_plain_one() -> None:
    generator = torch.Generator().manual_seed(0)
    start, noise, errors = (
        torch.randn(*shape, generator=generator, dtype=torch.float64)
        for shape in ((5, 2), (T, 5, 2), (T, 5, 2))
    )
    arguments = LinearDynamics(0.1), LinearPolicy(), start, noise
    plain = rollout(*arguments)
    behind = rollout(*arguments, sensing=Sensing(exact_observer(), errors))
    torch.testing.assert_close(behind.states, plain.states, rtol=0, atol=1e-14)
    torch.testing.assert_close(behind.inputs, plain.inputs, rtol=0, atol=1e-14)


def test_measurement_noise_reaches_the_inputs_and_not_the_states_before() -> None:
    observer = dataclasses.replace(exact_observer(), noise_std=zeros(2) + 0.5)
    errors = zeros(T, 1, 2)
    errors[3, 0, 0] = 1.0
    arguments = LinearDynamics(), LinearPolicy(), START[None], zeros(T, 1, 2)
    still, disturbed = (
        rollout(*arguments, sensing=Sensing(observer, e)) for e in (zeros(T, 1, 2), errors)
    )
    assert torch.equal(disturbed.states[:4], still.states[:4])
    moved = disturbed.inputs[3, 0] - still.inputs[3, 0]
    torch.testing.assert_close(moved, K @ torch.tensor([0.5, 0.0], dtype=torch.float64))


def test_problem_draws_the_noise_of_its_sensor_after_all_else() -> None:
    problem = make_problem(0.2)
    seen = dataclasses.replace(problem, observer=exact_observer())
    first, second = (
        p.particles(LinearPolicy(), 7, torch.Generator().manual_seed(3)) for p in (problem, seen)
    )
    torch.testing.assert_close(second.states, first.states, rtol=0, atol=1e-13)


def test_noise_of_successive_steps_has_the_asked_correlation_and_unit_variance() -> None:
    problem = dataclasses.replace(make_problem(1.0), horizon=40, correlation=0.8)
    _, noise = problem.normals(4000, torch.Generator().manual_seed(0))
    error = 4 / math.sqrt(4000 * 2)  # four standard errors of a mean over particles and outputs
    torch.testing.assert_close(
        noise.var((1, 2)), torch.ones(40, dtype=noise.dtype), atol=1.5 * error, rtol=0
    )
    for lag in (1, 2, 5):
        products = (noise[lag:] * noise[:-lag]).mean((1, 2))
        expected = torch.full_like(products, 0.8**lag)
        torch.testing.assert_close(products, expected, atol=1.5 * error, rtol=0)


def test_without_correlation_the_noise_is_the_generators_own() -> None:
    problem = make_problem(1.0)
    start, noise = problem.normals(5, torch.Generator().manual_seed(3))
    own = torch.Generator().manual_seed(3)
    assert torch.equal(start, torch.randn(5, 2, dtype=torch.float64, generator=own))
    assert torch.equal(noise, torch.randn(T, 5, 2, dtype=torch.float64, generator=own))
