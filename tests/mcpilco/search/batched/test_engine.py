"""The batched rollout computes what the plain one computes, values and gradients, seed by seed."""

from __future__ import annotations

import dataclasses
import gc

import pytest
import torch
from torch import Tensor

from mcpilco.dynamics import AngleAugmentation, full_state, speed_integration
from mcpilco.kernels import MPK, RBF, ActiveDims, Kernel, Linear, Scaled
from mcpilco.policies import Dropout, QuadraticCost, SumOfGaussians
from mcpilco.search import batched
from mcpilco.search.batched import MaskBatch, ModelBatch, PolicyBatch, rollout_batch
from mcpilco.search.batched.sweeps import Trace
from mcpilco.search.particles import rollout
from mcpilco.task import TaskSpec
from tests.mcpilco.conftest import make_dynamics, make_policy

STEPS, PARTICLES = 12, 23


def numbers(outputs: int, width: int = 4, seed: int = 1) -> tuple[Tensor, Tensor]:
    """A start and noise."""
    generator = torch.Generator().manual_seed(seed)
    noise = torch.randn(STEPS, PARTICLES, outputs, generator=generator, dtype=torch.float64)
    return 0.3 * torch.randn(PARTICLES, width, generator=generator, dtype=torch.float64), noise


def value_and_gradients(function, dynamics, policy, cost, dropout=None, seed=1):
    start, noise = numbers(dynamics.noise_dim, len(dynamics.A), seed)
    particles = function(dynamics, policy, start, noise, dropout)
    value = cost(particles.states[1:], particles.inputs).mean(1).sum()
    return particles, value, torch.autograd.grad(value, list(policy.parameters()))


def assert_close(found, expected, tolerance: float = 1e-10) -> None:
    scale = max(float(expected.detach().abs().max()), 1e-300)
    torch.testing.assert_close(found, expected, rtol=tolerance, atol=tolerance * scale)


def assert_equal(dynamics, policy, cost, dropout=None, tolerance: float = 1e-10) -> None:
    plain = value_and_gradients(rollout, dynamics, policy, cost, dropout)
    fast = value_and_gradients(batched.rollout, dynamics, policy, cost, dropout)
    assert_close(fast[0].states, plain[0].states, tolerance)
    assert_close(fast[0].inputs, plain[0].inputs, tolerance)
    assert_close(fast[1], plain[1], tolerance)
    for mine, its in zip(fast[2], plain[2], strict=True):
        assert_close(mine, its, tolerance)


def kernels(width: int, outputs: int) -> dict[str, Kernel]:
    def rbf() -> Kernel:
        return RBF(width, (outputs,))

    return {
        "rbf": rbf(),
        "linear": Linear(width, (outputs,)),
        "linear without bias": Linear(width, (outputs,), bias=False),
        "mpk1": MPK(width, 1, (outputs,)),
        "mpk3": MPK(width, 3, (outputs,)),
        "rbf+mpk2": rbf() + MPK(width, 2, (outputs,)),
        "rbf*linear": rbf() * Linear(width, (outputs,)),
        "rbf*rbf+rbf": rbf() * rbf() + rbf(),
        "rbf*mpk2+scaled": rbf() * MPK(width, 2, (outputs,)) + Scaled(rbf(), 0.3),
        "scaled linear": Scaled(Linear(width, (outputs,)), 0.3),
        "active": ActiveDims(RBF(2, (outputs,)), (0, 3), width)
        + ActiveDims(Linear(2, (outputs,)), (1, 5), width),
    }


@pytest.mark.parametrize("name", sorted(kernels(6, 2)))
def test_equals_plain_rollout_for_any_kernel(task: TaskSpec, name: str) -> None:
    assert_equal(make_dynamics(task, kernels(6, 2)[name]), make_policy(task), task.cost)


@pytest.mark.parametrize("increment", [speed_integration, full_state])
@pytest.mark.parametrize("rate", [0.0, 0.25])
def test_equals_plain_rollout_with_dropout(task: TaskSpec, increment, rate: float) -> None:
    dropout = Dropout(rate, seed=5) if rate else None
    assert_equal(make_dynamics(task, increment=increment), make_policy(task), task.cost, dropout)


@pytest.mark.parametrize("bases", [1, 33])
@pytest.mark.parametrize("samples", [1, 2, 40])
def test_equals_plain_rollout_for_any_size(task: TaskSpec, bases: int, samples: int) -> None:
    assert_equal(make_dynamics(task, samples=samples), make_policy(task, bases=bases), task.cost)


def test_equals_plain_rollout_with_two_inputs_and_a_cost_of_inputs(task: TaskSpec) -> None:
    task = dataclasses.replace(task, input_names=("left", "right"), input_units=("N", "N"))
    cost = QuadraticCost((0.0,) * 4, (1.0, 0.1, 2.0, 0.1), (0.02, 0.03))
    assert_equal(make_dynamics(task), make_policy(task, inputs=2), cost)


@pytest.mark.parametrize(
    ("names", "angles", "pairs"), [(2, (), ((0, 1),)), (3, (2, 0), ()), (5, (1,), ((0, 3), (1, 4)))]
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
    states = batched.rollout(dynamics, make_policy(task), *numbers(2)).states
    stayed = (states[1:] == states[:-1]).all(-1)
    assert 0 < stayed.float().mean() < 1
    assert_equal(dynamics, make_policy(task), task.cost)


def test_a_particle_that_leaves_all_bounds_leaves_no_trace_in_the_gradient(task: TaskSpec) -> None:
    """Its next state is infinite; where the plain form's gradient is NaN, this one's is not."""
    dynamics, policy = make_dynamics(task, MPK(6, 3, (2,)), bounds=1e3), make_policy(task)
    start, noise = numbers(2)
    start[0, 1] = 1e120  # whose cube is infinite

    def gradients(start: Tensor, noise: Tensor) -> tuple[Tensor, ...]:
        particles = batched.rollout(dynamics, policy, start, noise)
        value = task.cost(particles.states[1:], particles.inputs).sum()
        return torch.autograd.grad(value, list(policy.parameters()))

    for mine, others in zip(
        gradients(start, noise), gradients(start[1:], noise[:, 1:]), strict=True
    ):
        assert_close(mine, others)


def test_equals_plain_rollout_where_the_covariance_is_ill_conditioned(task: TaskSpec) -> None:
    """As far as it can: the plain form, its start moved by a rounding, moves by 3e-8 too."""
    few_functions = MPK(6, 2, (2,))  # 28 monomials for 60 samples
    dynamics = make_dynamics(task, few_functions, samples=60, noise_floor=5e-4)
    assert float(torch.linalg.cond(dynamics.posterior.L[0]) ** 2) > 1e6
    assert_equal(dynamics, make_policy(task), task.cost, tolerance=1e-6)


def test_refuses_what_it_does_not_know(task: TaskSpec) -> None:
    dynamics, policy = make_dynamics(task), make_policy(task)
    assert batched.supports(dynamics, policy)
    assert not batched.supports(dynamics, lambda states, dropout=None, step=0: states[..., :1])
    blind = SumOfGaussians(AngleAugmentation(4, ()), [-1.0], [1.0])
    assert not batched.supports(dynamics, blind)


# --- many seeds -----------------------------------------------------------------------------------

SAMPLES = (25, 1, 40)
DROPOUTS = (Dropout(0.25, seed=5), None, Dropout(0.125, seed=6))


def batch_of(task: TaskSpec):
    """Dynamics, policies, starts and noise of seeds that differ in all they may differ in."""
    dynamics = [make_dynamics(task, samples=n, seed=n, bounds=2.0 + n) for n in SAMPLES]
    policies = [make_policy(task, seed=seed) for seed in range(3)]
    starts, noises = zip(*(numbers(2, seed=seed) for seed in range(3)), strict=True)
    return dynamics, policies, torch.stack(starts), torch.stack(noises)


@pytest.mark.parametrize("dropouts", [DROPOUTS, (None, None, None)])
def test_each_seed_of_a_batch_is_as_if_alone(task: TaskSpec, dropouts) -> None:
    dynamics, policies, start, noise = batch_of(task)
    together = PolicyBatch.of(policies)
    masks = MaskBatch.of(dropouts, STEPS)
    states, inputs = rollout_batch(ModelBatch.of(dynamics), together, start, noise, masks)
    values = task.cost(states[:, 1:], inputs).mean(2).sum(1)
    gradients = torch.autograd.grad(values.sum(), together.parameters)
    for seed in range(3):
        alone = value_and_gradients(
            rollout, dynamics[seed], policies[seed], task.cost, dropouts[seed], seed
        )
        assert_close(states[seed], alone[0].states)
        assert_close(inputs[seed], alone[0].inputs)
        assert_close(values[seed], alone[1])
        for mine, its in zip(gradients, alone[2], strict=True):
            assert_close(mine[seed], its)


def test_samples_filled_in_contribute_nothing(task: TaskSpec) -> None:
    """Whatever their kernel is."""
    dynamics, policies, start, noise = batch_of(task)
    models = ModelBatch.of(dynamics)
    policy = PolicyBatch.of(policies)
    expected, _ = rollout_batch(models, policy, start, noise)
    missing = torch.arange(max(SAMPLES)) >= torch.tensor(SAMPLES)[:, None]
    expand = torch.where(missing[None, :, None, None], 0.1, models.kernel.expand)
    models = dataclasses.replace(models, kernel=dataclasses.replace(models.kernel, expand=expand))
    found, _ = rollout_batch(models, policy, start, noise)
    assert torch.equal(found, expected)


def test_single_precision_through_a_factor_of_double_precision_is_close(task: TaskSpec) -> None:
    dynamics, policies, start, noise = batch_of(task)
    exact, models = PolicyBatch.of(policies), ModelBatch.of(dynamics)
    found = []
    for dtype in (torch.float64, torch.float32):
        states, inputs = rollout_batch(models.to("cpu", dtype), exact, start, noise)
        assert states.dtype == dtype
        value = task.cost(states[:, 1:], inputs).mean(2).sum()
        found.append((states, torch.autograd.grad(value, exact.parameters, retain_graph=True)))
    (states, gradients), (rough_states, rough_gradients) = found
    assert_close(rough_states.double(), states, 1e-2)
    for rough, gradient in zip(rough_gradients, gradients, strict=True):
        assert rough.dtype == torch.float64
        assert_close(rough, gradient, 3e-2)


def test_all_arrays_stay_on_their_device_and_none_is_looked_at(task: TaskSpec) -> None:
    """On the meta device arrays have no values: a branch on one, or another device, raises."""
    dynamics, policies, start, noise = batch_of(task)
    models = ModelBatch.of(dynamics).to("meta")
    policy = PolicyBatch.of(policies).to("meta")
    masks = MaskBatch.of(DROPOUTS, STEPS).to("meta")
    states, inputs = rollout_batch(models, policy, start.to("meta"), noise.to("meta"), masks)
    gradients = torch.autograd.grad(
        task.cost(states, states).sum() + inputs.sum(), policy.parameters
    )
    assert {gradient.device.type for gradient in gradients} == {"meta"}
    assert [g.shape for g in gradients] == [p.shape for p in policy.parameters]


def test_a_rollout_is_freed_when_it_is_dropped(task: TaskSpec) -> None:
    """At once, not when the garbage collector comes round: its arrays are large."""
    dynamics, policy = make_dynamics(task), make_policy(task)
    gc.disable()
    try:
        particles = batched.rollout(dynamics, policy, *numbers(2))
        assert sum(type(thing) is Trace for thing in gc.get_objects()) == 1
        del particles
        assert not any(type(thing) is Trace for thing in gc.get_objects())
    finally:
        gc.enable()
