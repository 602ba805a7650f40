"""The compiled rollout computes what the plain one computes, values and gradients."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest
import torch

from mcpilco.config import Limit, PolicyConfig
from mcpilco.dynamics import AngleAugmentation, Delay, full_state, speed_integration
from mcpilco.kernels import MPK, RBF, ActiveDims, Kernel, Linear, Scaled
from mcpilco.policies import (
    Brake,
    Dropout,
    QuadraticCost,
    Regulator,
    SumOfGaussians,
    cart_pole_cost,
)
from mcpilco.search import fused
from mcpilco.search.particles import Sensing, rollout
from mcpilco.sensing import Chain, DelayModel, Observer
from mcpilco.sensing.estimator import differences, kalman
from mcpilco.sensing.motion import Motion
from mcpilco.task import TaskSpec
from tests.mcpilco.conftest import make_dynamics, make_policy

pytestmark = pytest.mark.xdist_group("compiled")  # one process compiles what all of them need

STEPS, PARTICLES = 12, 37


def noise_and_start(outputs: int, width: int = 4, particles: int = PARTICLES):
    generator = torch.Generator().manual_seed(1)
    noise = torch.randn(STEPS, particles, outputs, generator=generator, dtype=torch.float64)
    return 0.3 * torch.randn(particles, width, generator=generator, dtype=torch.float64), noise


def value_and_gradients(
    function, dynamics, policy, cost, dropout, particles=PARTICLES, sensing=None
):
    start, noise = noise_and_start(dynamics.noise_dim, len(dynamics.A), particles)
    particles = function(dynamics, policy, start, noise, dropout, sensing)
    value = cost(particles.states[1:], particles.inputs).mean(1).sum()
    gradients = torch.autograd.grad(value, list(policy.parameters()))
    return particles, value, gradients


def assert_equal(dynamics, policy, cost, dropout=None, particles=PARTICLES, sensing=None):
    arguments = dynamics, policy, cost, dropout, particles, sensing
    plain = value_and_gradients(rollout, *arguments)
    fast = value_and_gradients(fused.rollout, *arguments)
    torch.testing.assert_close(fast[0].states, plain[0].states, rtol=1e-8, atol=1e-8)
    torch.testing.assert_close(fast[0].inputs, plain[0].inputs, rtol=1e-8, atol=1e-8)
    torch.testing.assert_close(fast[1], plain[1], rtol=1e-8, atol=1e-8)
    for a, b in zip(fast[2], plain[2], strict=True):
        torch.testing.assert_close(a, b, rtol=1e-8, atol=1e-8 * float(b.abs().max()))


def kernels(width: int, outputs: int) -> dict[str, Kernel]:
    def rbf() -> Kernel:
        return RBF(width, (outputs,))

    return {
        "rbf": rbf(),
        "linear": Linear(width, (outputs,)),
        "mpk1": MPK(width, 1, (outputs,)),
        "mpk3": MPK(width, 3, (outputs,)),
        "rbf+mpk2": rbf() + MPK(width, 2, (outputs,)),
        "rbf*linear": rbf() * Linear(width, (outputs,)),
        "rbf*mpk2+scaled": rbf() * MPK(width, 2, (outputs,)) + Scaled(rbf(), 0.3),
        "active": ActiveDims(RBF(2, (outputs,)), (0, 3), width)
        + ActiveDims(Linear(2, (outputs,)), (1, 5), width),
    }


@pytest.mark.one_in(2)
@pytest.mark.parametrize("name", sorted(kernels(6, 2)))
def test_equals_plain_rollout_for_any_kernel(task: TaskSpec, name: str) -> None:
    dynamics = make_dynamics(task, kernels(6, 2)[name])
    assert_equal(dynamics, make_policy(task), task.cost)


@pytest.mark.parametrize("increment", [speed_integration, full_state])
@pytest.mark.parametrize("rate", [0.0, 0.25])
def test_equals_plain_rollout_with_dropout(task: TaskSpec, increment, rate: float) -> None:
    dynamics = make_dynamics(task, increment=increment)
    dropout = Dropout(rate, seed=5) if rate else None
    assert_equal(dynamics, make_policy(task), task.cost, dropout)


@pytest.mark.parametrize("bases", [1, 16, 33])
@pytest.mark.parametrize("samples", [1, 16, 40])
def test_equals_plain_rollout_for_any_size(task: TaskSpec, bases: int, samples: int) -> None:
    assert_equal(make_dynamics(task, samples=samples), make_policy(task, bases=bases), task.cost)


@pytest.mark.parametrize("particles", [1, 16, 64, 130])
def test_equals_plain_rollout_for_any_number_of_particles(task: TaskSpec, particles: int) -> None:
    dropout = Dropout(0.25, seed=5)
    assert_equal(make_dynamics(task), make_policy(task), task.cost, dropout, particles)


def seen(observer: Observer, particles: int) -> Sensing:
    """The measurements of a rollout, with noise of their own."""
    generator = torch.Generator().manual_seed(2)
    shape = STEPS, particles, observer.noise_dim
    return Sensing(observer, torch.randn(*shape, generator=generator, dtype=torch.float64))


@pytest.mark.slow  # compiles what no other test needs
@pytest.mark.parametrize("kind", ["kalman", "differences"])
@pytest.mark.parametrize("delay", [None, Delay(1), Delay(1, 0.5)])
@pytest.mark.parametrize("particles", [1, 37, 130])
def test_equals_plain_rollout_behind_an_estimator(
    task: TaskSpec, kind: str, delay: Delay | None, particles: int
) -> None:
    """Also where the actuator is late as well."""
    positions = dataclasses.replace(task, measured=(2, 0))
    noise_std = np.array([0.05, 0.1])
    estimator = differences(positions, 0.3)
    if kind == "kalman":
        estimator = kalman(Motion.of(positions, np.array([0.5, 1.0]), noise_std))
    dynamics, policy = make_dynamics(task, bounds=4.0), make_policy(task)
    whole = estimator if delay is None else Chain(estimator, DelayModel(dynamics, delay))
    sensing = seen(Observer(whole, torch.from_numpy(noise_std), estimator.C), particles)
    assert_equal(dynamics, policy, task.cost, Dropout(0.25, 5), particles, sensing)


@pytest.mark.slow  # compiles what no other test needs
@pytest.mark.parametrize("delay", [Delay(0, 0.5), Delay(1), Delay(1, 0.5), Delay(3)])
@pytest.mark.parametrize("particles", [1, 37, 130])
def test_equals_plain_rollout_behind_a_delay_model(
    task: TaskSpec, delay: Delay, particles: int
) -> None:
    dynamics = make_dynamics(task, bounds=4.0)
    noise_std = torch.tensor([0.05, 0.1, 0.02, 0.2], dtype=torch.float64)
    sensing = seen(Observer(DelayModel(dynamics, delay), noise_std), particles)
    assert_equal(dynamics, make_policy(task), task.cost, Dropout(0.25, 5), particles, sensing)


@pytest.mark.slow  # compiles what no other test needs
def test_single_precision_errs_by_its_rounding(task: TaskSpec) -> None:
    dynamics, policy, dropout = make_dynamics(task), make_policy(task), Dropout(0.25, seed=5)
    single = functools.partial(fused.rollout, single=True)
    exact = value_and_gradients(fused.rollout, dynamics, policy, task.cost, dropout)
    rounded = value_and_gradients(single, dynamics, policy, task.cost, dropout)
    assert rounded[0].states.dtype == torch.float64
    assert not torch.equal(rounded[0].states, exact[0].states)
    torch.testing.assert_close(rounded[0].states, exact[0].states, rtol=1e-3, atol=1e-3)
    for a, b in zip(rounded[2], exact[2], strict=True):
        torch.testing.assert_close(a, b, rtol=1e-2, atol=1e-3 * float(b.abs().max()))


def test_backward_may_be_asked_twice(task: TaskSpec) -> None:
    policy = make_policy(task)
    start, noise = noise_and_start(2)
    value = fused.rollout(make_dynamics(task), policy, start, noise).states.square().sum()
    first = torch.autograd.grad(value, list(policy.parameters()), retain_graph=True)
    again = torch.autograd.grad(value, list(policy.parameters()))
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))


def test_equals_plain_rollout_with_two_inputs_and_a_cost_of_inputs(task: TaskSpec) -> None:
    task = dataclasses.replace(task, input_names=("left", "right"), input_units=("N", "N"))
    cost = QuadraticCost((0.0,) * 4, (1.0, 0.1, 2.0, 0.1), (0.02, 0.03))
    assert_equal(make_dynamics(task), make_policy(task, inputs=2), cost)


@pytest.mark.parametrize(
    ("names", "angles", "pairs"), [(2, (), ((0, 1),)), (3, (0, 2), ()), (5, (1,), ((0, 3), (1, 4)))]
)
def test_equals_plain_rollout_for_other_states(names: int, angles: tuple, pairs: tuple) -> None:
    cost = QuadraticCost((0.1,) * names, (1.0,) * names, (0.01,))
    state = tuple(f"x{i}" for i in range(names))
    task = TaskSpec(
        state, state, ("u",), ("N",), 0.05, angles, pairs, (0.0,) * names, (0.1,) * names, cost
    )
    assert_equal(make_dynamics(task), make_policy(task), cost)


def test_particles_that_leave_the_plausible_range_stay_in_both(task: TaskSpec) -> None:
    dynamics = make_dynamics(task, bounds=1.0)
    start, noise = noise_and_start(2)
    states = fused.rollout(dynamics, make_policy(task), start, noise).states
    stayed = (states[1:] == states[:-1]).all(-1)
    assert 0 < stayed.float().mean() < 1
    assert_equal(dynamics, make_policy(task), task.cost)


def test_equals_plain_rollout_where_the_covariance_is_ill_conditioned(task: TaskSpec) -> None:
    few_functions = MPK(6, 2, (2,))  # 28 monomials for 60 samples
    dynamics = make_dynamics(task, few_functions, samples=60, noise_floor=5e-4)
    condition = float(torch.linalg.cond(dynamics.posterior.L[0]) ** 2)
    assert condition > 1e6
    assert_equal(dynamics, make_policy(task), task.cost)


def test_gradient_equals_finite_differences(task: TaskSpec) -> None:
    dynamics, policy, cost = make_dynamics(task), make_policy(task, bases=5), cart_pole_cost()
    start, noise = noise_and_start(2)

    def value() -> torch.Tensor:
        particles = fused.rollout(dynamics, policy, start, noise)
        return cost(particles.states[1:], particles.inputs).mean(1).sum()

    gradients = torch.autograd.grad(value(), list(policy.parameters()))
    step = 1e-6
    for parameter, gradient in zip(policy.parameters(), gradients, strict=True):
        with torch.no_grad():
            flat = parameter.view(-1)
            for i in range(len(flat)):
                middle = float(flat[i])
                flat[i] = middle + step
                above = float(value())
                flat[i] = middle - step
                below = float(value())
                flat[i] = middle
                expected = (above - below) / (2 * step)
                assert float(gradient.view(-1)[i]) == pytest.approx(expected, rel=1e-5, abs=1e-7)


def test_refuses_what_it_does_not_know(task: TaskSpec) -> None:
    dynamics = make_dynamics(task)
    assert fused.unknown(dynamics, make_policy(task)) is None
    assert "policy" in fused.unknown(dynamics, lambda states, dropout=None, step=0: states[..., :1])
    blind = SumOfGaussians(AngleAugmentation(4, ()), [-1.0], [1.0])
    assert "sees other states" in fused.unknown(dynamics, blind)


# --- a brake --------------------------------------------------------------------------------------


def braked(task: TaskSpec, inputs: int = 1) -> SumOfGaussians:
    """A policy whose brake is often at work."""
    policy = make_policy(task, inputs=inputs)
    bounds = [-10.0] * inputs, [10.0] * inputs
    limit = Limit("cart_position", -0.4, 0.5)
    policy.brake = Brake([limit], task, *bounds, len(task.state_names))
    numbers = {"lever": [0.1, 0.02], "push": [1.0, -0.4][:inputs], "braking": [8.0, 7.0]}
    for name, values in (numbers | {"reach": 0.15}).items():
        getattr(policy.brake, name)[0] = torch.tensor(values, dtype=torch.float64)
    return policy


@pytest.mark.one_in(3)
@pytest.mark.parametrize("rate", [0.0, 0.25])
@pytest.mark.parametrize("particles", [1, 37])
def test_equals_plain_rollout_with_a_brake(task: TaskSpec, rate: float, particles: int) -> None:
    policy, dropout = braked(task), Dropout(rate, seed=5) if rate else None
    assert_equal(make_dynamics(task), policy, task.cost, dropout, particles)
    start, noise = noise_and_start(2, particles=particles)
    free = make_policy(task)
    inputs = (fused.rollout(make_dynamics(task), p, start, noise).inputs for p in (policy, free))
    assert not torch.equal(*inputs)


def test_equals_plain_rollout_with_a_brake_of_two_inputs(task: TaskSpec) -> None:
    task = dataclasses.replace(task, input_names=("left", "right"), input_units=("N", "N"))
    cost = QuadraticCost((0.0,) * 4, (1.0, 0.1, 2.0, 0.1), (0.02, 0.03))
    assert_equal(make_dynamics(task), braked(task, inputs=2), cost)


@pytest.mark.parametrize("limited", [False, True])
def test_equals_plain_rollout_with_a_regulator(task: TaskSpec, limited: bool) -> None:
    policy = braked(task) if limited else make_policy(task)
    aimed = dataclasses.replace(task, goal=(0.1, 0.0, 0.2, 0.0))
    policy.regulator = Regulator(PolicyConfig(regulator=100.0), aimed, [-10.0], [10.0])
    A = np.eye(4) + np.diag([0.1, 0.0, 0.1], 1) + np.diag([0.0, 0.0, 0.2], -1)
    policy.regulator.hold(A, np.array([[0.0], [0.2], [0.0], [-0.1]]), np.array([0.5]))
    assert_equal(make_dynamics(task), policy, task.cost, Dropout(0.25, seed=5))
    start, noise = noise_and_start(2)
    free = make_policy(task)
    inputs = (fused.rollout(make_dynamics(task), p, start, noise).inputs for p in (policy, free))
    assert not torch.equal(*inputs)


@pytest.mark.slow  # compiles what no other test needs
def test_equals_plain_rollout_with_a_brake_behind_an_estimator(task: TaskSpec) -> None:
    positions = dataclasses.replace(task, measured=(2, 0))
    noise_std = np.array([0.05, 0.1])
    estimator = kalman(Motion.of(positions, np.array([0.5, 1.0]), noise_std))
    sensing = seen(Observer(estimator, torch.from_numpy(noise_std), estimator.C), PARTICLES)
    dynamics = make_dynamics(task, bounds=4.0)
    assert_equal(dynamics, braked(task), task.cost, Dropout(0.25, 5), PARTICLES, sensing)


def test_a_brake_that_holds_nothing_changes_no_bit(task: TaskSpec) -> None:
    policy, dynamics = braked(task), make_dynamics(task)
    policy.brake.braking.zero_()
    start, noise = noise_and_start(2)
    ours, plain = (fused.rollout(dynamics, p, start, noise) for p in (policy, make_policy(task)))
    assert torch.equal(ours.states, plain.states)
