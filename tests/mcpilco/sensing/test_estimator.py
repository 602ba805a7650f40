"""Estimators: what a policy acts on where a state is measured in part."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from mcpilco.sensing.estimator import LinearEstimator, LinearObserver, differences, kalman
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
    memory, estimates = estimator.begin(*measured.shape[1:-1]), []
    for now in measured:
        estimate, memory = estimator.update(memory, now)
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
    observer = LinearObserver(make_estimator(task, kind), torch.tensor([0.01, 0.02]).double())
    noise = torch.randn(4, 3, 2, dtype=torch.float64)

    def last(states: torch.Tensor) -> torch.Tensor:
        memory = observer.begin(states[0])
        for now, errors in zip(states, noise, strict=True):
            estimate, memory = observer.observe(now, errors, memory)
        return estimate

    states = torch.randn(4, 3, 4, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(last, (states,))


def test_observer_measures_with_its_noise(task: TaskSpec) -> None:
    observer = LinearObserver(
        make_estimator(task, "differences"), torch.tensor([0.1, 0.5]).double()
    )
    states = torch.tensor([[1.0, 2.0, 3.0, 4.0]], dtype=torch.float64)
    noise = torch.tensor([[1.0, -2.0]], dtype=torch.float64)
    estimate, _ = observer.observe(states, noise, observer.begin(states))
    torch.testing.assert_close(estimate, torch.tensor([[1.1, 0.0, 2.0, 0.0]]).double())
