"""Laws of the dynamics: thesis eq. (5.9), and a GP step with its noise."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from mcpilco.data import Transitions
from mcpilco.dynamics.dynamics import full_state, speed_integration
from mcpilco.task import TaskSpec
from tests.mcpilco.conftest import make_dynamics

INCREMENTS = [speed_integration, full_state]


def some(*shape: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.randn(*shape, generator=generator, dtype=torch.float64)


def six_states(task: TaskSpec) -> TaskSpec:
    """Pairs in odd order, and two states without one."""
    names = tuple("abcdef")
    return dataclasses.replace(
        task,
        state_names=names,
        state_units=names,
        angles=(),
        velocities=((4, 1), (0, 5)),
        start_mean=(0.0,) * 6,
        start_std=(0.1,) * 6,
    )


def test_speed_integration_is_equation_5_9(task: TaskSpec) -> None:
    law = speed_integration(task)
    states, speed_changes = some(20, 4).numpy(), some(20, 2, seed=1).numpy()
    following = states @ law.A.T + speed_changes @ law.B.T
    for q, dq, change in ((0, 1, speed_changes[:, 0]), (2, 3, speed_changes[:, 1])):
        faster = states[:, dq] + change
        expected = states[:, q] + task.dt * states[:, dq] + task.dt / 2 * (faster - states[:, dq])
        np.testing.assert_allclose(following[:, q], expected, rtol=0, atol=1e-15)
        np.testing.assert_allclose(following[:, dq], faster, rtol=0, atol=1e-15)
    assert law.predicted == (1, 3)


def test_full_state_is_the_identity(task: TaskSpec) -> None:
    law = full_state(task)
    np.testing.assert_array_equal(law.A, np.eye(4))
    np.testing.assert_array_equal(law.B, np.eye(4))
    assert law.predicted == (0, 1, 2, 3)


def test_a_state_without_a_pair_keeps_a_gp_of_its_own(task: TaskSpec) -> None:
    law = speed_integration(six_states(task))
    assert law.predicted == (1, 2, 3, 5)
    states, changes = some(6).numpy(), some(4, seed=1).numpy()
    following = law.A @ states + law.B @ changes
    for e, i in enumerate(law.predicted):
        assert following[i] == pytest.approx(states[i] + changes[e])
    dt = task.dt
    assert following[4] == pytest.approx(states[4] + dt * states[1] + dt / 2 * changes[0])
    assert following[0] == pytest.approx(states[0] + dt * states[5] + dt / 2 * changes[3])


@pytest.mark.parametrize("increment", INCREMENTS)
@given(seed=st.integers(0, 1000))
def test_the_law_turns_targets_back_into_the_predicted_states(increment, seed: int) -> None:
    task = make_task()
    law = increment(task)
    rows = Transitions(*(some(5, n, seed=seed + n).numpy() for n in (4, 1)), some(5, 4).numpy())
    following = rows.states @ law.A.T + law.targets(rows) @ law.B.T
    predicted = list(law.predicted)
    np.testing.assert_allclose(following[:, predicted], rows.next_states[:, predicted], atol=1e-12)


def make_task() -> TaskSpec:
    """The cart-pole, outside of a fixture."""
    names = ("q1", "dq1", "q2", "dq2")
    pairs = ((0, 1), (2, 3))
    zero = (0.0,) * 4
    return TaskSpec(
        names, names, ("u",), ("N",), 0.1, (2,), pairs, zero, zero, lambda states, inputs: states
    )


@pytest.mark.parametrize("increment", INCREMENTS)
def test_a_step_is_mean_and_deviation_of_the_posterior_through_the_law(
    task: TaskSpec, increment
) -> None:
    dynamics = make_dynamics(task, increment=increment)
    states, inputs, noise = some(9, 4), some(9, 1, seed=1), some(9, dynamics.noise_dim, seed=2)
    x, dx, angle, omega = states.T
    regressors = torch.stack([x, dx, omega, angle.cos(), angle.sin(), inputs[:, 0]], -1)
    mean, variance = dynamics.posterior.mean_and_variance(regressors)
    delta = mean + variance.sqrt() * noise
    law = increment(task)
    expected = states @ torch.from_numpy(law.A).T + delta @ torch.from_numpy(law.B).T
    torch.testing.assert_close(dynamics.step(states, inputs, noise), expected)


def test_a_particle_that_would_leave_the_plausible_range_stays(task: TaskSpec) -> None:
    free, held = make_dynamics(task, bounds=1e9), make_dynamics(task, bounds=1.0)
    states, inputs, noise = some(200, 4), some(200, 1, seed=1), some(200, 2, seed=2)
    moved = free.step(states, inputs, noise)
    leaves = (moved[:, [1, 3]].abs() > 1.0).any(-1)
    assert 0 < leaves.sum() < 200
    expected = torch.where(leaves[:, None], states, moved)
    assert torch.equal(held.step(states, inputs, noise), expected)


def test_gradients_of_a_step_equal_finite_differences(task: TaskSpec) -> None:
    dynamics = make_dynamics(task)
    states, inputs = some(3, 4).requires_grad_(), some(3, 1, seed=1).requires_grad_()
    noise = some(3, 2, seed=2)
    assert torch.autograd.gradcheck(lambda x, u: dynamics.step(x, u, noise), (states, inputs))
