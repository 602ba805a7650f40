"""Estimators: what a policy acts on where a state is measured in part."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from mcpilco.sensing.estimator import (
    Chain,
    LinearEstimator,
    Observer,
    PastInputs,
    differences,
    kalman,
)
from mcpilco.sensing.motion import Motion
from mcpilco.task import TaskSpec
from tests.mcpilco.sensing.test_motion import CHANGES, NOISE, simulate

KINDS = ["kalman", "differences", "filtered differences"]


def positions_of(task: TaskSpec) -> TaskSpec:
    return dataclasses.replace(task, measured=(0, 2))


def make_estimator(task: TaskSpec, kind: str = "kalman") -> LinearEstimator:
    if kind == "kalman":
        return kalman(Motion.of(positions_of(task), CHANGES, NOISE))
    return differences(positions_of(task), 0.0 if kind == "differences" else 0.4)


def along(estimator: LinearEstimator, measured: torch.Tensor) -> torch.Tensor:
    """The estimates from a series of measurements."""
    memory, estimates = estimator.begin(measured[0]), []
    for now in measured:
        estimate, memory = estimator.observe(now, memory)
        estimates.append(estimate)
    return torch.stack(estimates)


@pytest.mark.parametrize("kind", KINDS)
def test_estimate_converges_to_a_constant_velocity(task: TaskSpec, kind: str) -> None:
    times, velocity = 0.1 * torch.arange(120.0, dtype=torch.float64), torch.tensor([0.7, -2.0])
    start = torch.tensor([0.2, 1.0])
    measured = start + times[:, None] * velocity
    last = along(make_estimator(task, kind), measured)[-1]
    expected = torch.stack([measured[-1], velocity], -1).reshape(-1)
    torch.testing.assert_close(last, expected, atol=1e-9, rtol=0.0)


def test_kalman_estimates_are_the_means_of_the_filter(task: TaskSpec) -> None:
    motion = Motion.of(positions_of(task), CHANGES, NOISE)
    _, measured = simulate(motion, 40, seed=0)
    estimates = along(kalman(motion), torch.from_numpy(measured))
    np.testing.assert_allclose(estimates.numpy(), motion.filter(measured).means, atol=1e-9)


def test_differences_are_those_of_successive_measurements(task: TaskSpec) -> None:
    y = torch.randn(5, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    plain, filtered = (along(make_estimator(task, kind), y) for kind in KINDS[1:])
    torch.testing.assert_close(plain[:, [0, 2]], y)
    assert torch.equal(plain[0, [1, 3]], torch.zeros(2, dtype=torch.float64))
    torch.testing.assert_close(plain[1:, [1, 3]], (y[1:] - y[:-1]) / 0.1)
    kept = 0.4 * filtered[:-1, [1, 3]] + 0.6 * plain[1:, [1, 3]]
    torch.testing.assert_close(filtered[1:, [1, 3]], kept)


def test_a_measured_velocity_is_taken_as_it_is(task: TaskSpec) -> None:
    task = dataclasses.replace(task, measured=(2, 0, 1))
    y = torch.tensor([[1.0, 2.0, 3.0], [1.5, 4.0, 5.0]], dtype=torch.float64)
    expected = torch.tensor([4.0, 5.0, 1.5, 5.0], dtype=torch.float64)
    torch.testing.assert_close(along(differences(task), y)[-1], expected)


@pytest.mark.parametrize("kind", KINDS)
def test_one_of_a_batch_is_estimated_as_if_alone_to_the_last_digit(task: TaskSpec, kind) -> None:
    estimator = make_estimator(task, kind)
    measured = torch.randn(25, 33, 2, dtype=torch.float64)
    together = along(estimator, measured)
    for one in (0, 7, 32):
        assert torch.equal(along(estimator, measured[:, one]), together[:, one])


@pytest.mark.parametrize("kind", KINDS)
def test_gradients_flow_through_sensor_and_estimator(task: TaskSpec, kind: str) -> None:
    estimator = make_estimator(task, kind)
    observer = Observer(estimator, torch.tensor([0.01, 0.02]).double(), estimator.C)
    noise = torch.randn(4, 3, 2, dtype=torch.float64)

    def last(states: torch.Tensor) -> torch.Tensor:
        memory = estimator.begin(states[0])
        for now, errors in zip(states, noise, strict=True):
            estimate, memory = estimator.observe(observer.measured(now, errors), memory)
        return estimate

    states = torch.randn(4, 3, 4, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(last, (states,))


def test_observer_measures_with_its_noise(task: TaskSpec) -> None:
    estimator = make_estimator(task, "differences")
    observer = Observer(estimator, torch.tensor([0.1, 0.5]).double(), estimator.C)
    states = torch.tensor([[1.0, 2.0, 3.0, 4.0]], dtype=torch.float64)
    noise = torch.tensor([[1.0, -2.0]], dtype=torch.float64)
    measured = observer.measured(states, noise)
    torch.testing.assert_close(measured, torch.tensor([[1.1, 2.0]]).double())
    every = Observer(estimator, torch.ones(4).double())
    torch.testing.assert_close(every.measured(states, torch.ones(1, 4).double()), states + 1.0)


def test_past_inputs_stand_behind_the_state_newest_first() -> None:
    estimator, states = PastInputs(inputs=2, count=2), torch.ones(3, 1).double()
    memory = estimator.begin(states)
    for number in (1.0, 2.0, 3.0):
        seen, memory = estimator.observe(states, memory)
        memory = estimator.after(memory, torch.full((3, 2), number).double())
    torch.testing.assert_close(seen[0], torch.tensor([1.0, 2, 2, 1, 1]).double())
    seen, _ = estimator.observe(states, memory, torch.tensor([True, False, False]))
    torch.testing.assert_close(seen[0], torch.tensor([1.0, 0, 0, 0, 0]).double())
    torch.testing.assert_close(seen[1], torch.tensor([1.0, 3, 3, 2, 2]).double())


@pytest.mark.parametrize("kind", KINDS)
def test_a_chain_hands_the_estimates_of_the_first_to_the_second(task: TaskSpec, kind: str) -> None:
    first, second = make_estimator(task, kind), PastInputs(1, 3)
    chain, series = Chain(first, second), torch.randn(5, 7, 2, dtype=torch.float64)
    memory, apart = chain.begin(series[0]), (first.begin(series[0]), second.begin(series[0]))
    begun = torch.arange(7) == 3
    for now in series:
        seen, memory = chain.observe(now, memory, begun)
        estimate, one = first.observe(now, apart[0], begun)
        expected, two = second.observe(estimate, apart[1], begun)
        assert torch.equal(seen, expected)
        memory = chain.after(memory, estimate[:, :1])
        apart = first.after(one, estimate[:, :1]), second.after(two, estimate[:, :1])
