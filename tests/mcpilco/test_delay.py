"""Commands that act late: which they are, and the state that they meet."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from mcpilco.delay import Delay, StatePredictor
from mcpilco.dynamics import GPDynamics, speed_integration
from mcpilco.features import AngleAugmentation
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

FREQUENCY = 3.0
"""of an oscillator without friction [rad/s]"""


def oscillator(dt: float, frequency: float = FREQUENCY) -> TaskSpec:
    return TaskSpec(
        dt=dt,
        state_names=("q", "v"),
        state_units=("m", "m/s"),
        input_names=("u",),
        input_units=("N",),
        angles=(),
        start_mean=(0.0, 0.0),
        start_std=(0.1, 0.1),
        velocities=((0, 1),),
    )


def moved(state: np.ndarray, u: float, time: float, frequency: float) -> np.ndarray:
    """The motion of q'' = u - w^2 q under a constant input, in closed form."""
    w, (q, v) = frequency, state
    if w == 0.0:
        return np.array([q + time * v + time**2 / 2 * u, v + time * u])
    c, s, middle = math.cos(w * time), math.sin(w * time), u / w**2
    return np.array([middle + (q - middle) * c + v / w * s, v * c - (q - middle) * w * s])


def late(state: np.ndarray, commands: list[float], samples: float, dt: float, frequency: float):
    """Where a state is after the delay, if these commands came before, newest first."""
    whole, part = math.floor(samples), samples - math.floor(samples)
    for k in range(whole):
        if part:
            state = moved(state, commands[whole - k], part * dt, frequency)
        state = moved(state, commands[whole - k - 1], (1 - part) * dt, frequency)
    return moved(state, commands[0], part * dt, frequency) if part else state


def predicted(state: np.ndarray, commands: list[float], samples: float, dt: float, frequency):
    """The same by the predictor, whose model knows exactly what the velocity does in a step."""
    task = oscillator(dt)
    delay = Delay.of(samples * dt, dt)

    def mean_and_variance(asked):
        q, v, u, *turned = asked.unbind(-1)
        turned, rows = (turned or [torch.zeros_like(u)])[0], []
        for one in zip(q, v, u + delay.part * turned, u - (1 - delay.part) * turned, strict=True):
            now = np.array([float(x) for x in one[:2]])
            half = moved(now, float(one[3]), delay.part * dt, frequency)
            rows.append(moved(half, float(one[2]), (1 - delay.part) * dt, frequency) - now)
        change = torch.tensor(np.array(rows)[:, 1:])
        return change, torch.zeros_like(change)

    def still(given):
        return torch.zeros_like(given[..., -1:])

    dynamics = GPDynamics(
        SimpleNamespace(mean_and_variance=mean_and_variance),
        AngleAugmentation(2, ()),
        speed_integration(task),
        np.array([np.inf]),
        still if delay.part else None,
    )
    past = torch.tensor(commands[: delay.memory]).double()[:, None]
    return StatePredictor(delay, dynamics)(torch.from_numpy(state), past).numpy()


@given(st.integers(0, 40), st.floats(0.0, 0.999), st.floats(0.001, 2.0))
def test_a_delay_is_told_in_sampling_times(whole, part, dt):
    delay = Delay.of((whole + part) * dt, dt)
    assert delay.whole + delay.part == pytest.approx(whole + part, abs=2e-6)
    assert 0 <= delay.part < 1
    assert delay.memory == math.ceil(delay.whole + delay.part)


def test_what_is_nearly_a_whole_number_of_samples_is_one():
    assert Delay.of(0.3, 0.1) == Delay(3, 0.0)
    assert Delay.of(0.1 + 0.2, 0.1) == Delay(3, 0.0)
    with pytest.raises(InputError, match="at most 100 sampling times of 0.01 s, got 2 s"):
        Delay.of(2.0, 0.01)


@given(st.integers(0, 3), st.sampled_from([0.0, 0.25, 0.5, 0.9]))
def test_the_command_that_acts_is_the_one_of_then(whole, part):
    commands = torch.tensor([5.0, -3.0, 2.0, 7.0, 1.0]).double()
    acting, turned = Delay(whole, part).acting(commands[: whole + (part > 0) + 1, None])
    grid = (np.arange(1000) + 0.5) / 1000  # of the step, in which the older one acts first
    ago = np.where(grid < part, whole + 1, whole)
    assert float(acting) == pytest.approx(float(commands[ago].mean()))
    assert float(turned) == (float(commands[whole] - commands[whole + 1]) if part else 0.0)


@pytest.mark.parametrize("samples", [1, 2, 0.5, 1.5, 2.25])
def test_a_mass_without_a_spring_is_predicted_exactly(samples):
    start, commands = np.array([0.3, -0.5]), [2.0, -6.0, 9.0, -1.0]
    found = predicted(start, commands, samples, 0.1, 0.0)
    np.testing.assert_allclose(found, late(start, commands, samples, 0.1, 0.0), atol=1e-12)


@pytest.mark.parametrize("samples", [0.5, 1.5, 2.25])
def test_errors_of_an_oscillator_fall_with_the_third_power_of_a_sample(samples):
    start, commands = np.array([0.3, -0.5]), [2.0, -6.0, 9.0, -1.0]
    errors = [
        np.abs(
            predicted(start, commands, samples, dt, FREQUENCY)
            - late(start, commands, samples, dt, FREQUENCY)
        ).max()
        for dt in (0.02, 0.01)
    ]
    assert 0 < errors[1] < errors[0] / 6


def test_a_batch_is_predicted_as_each_of_it():
    states, past = torch.randn(3, 2, 2), torch.randn(3, 2, 1, 1)
    mean = lambda asked: (asked[:, 2:].sin(), asked[:, 2:])  # noqa: E731
    dynamics = GPDynamics(
        SimpleNamespace(mean_and_variance=mean),
        AngleAugmentation(2, ()),
        speed_integration(oscillator(0.1)),
        np.array([np.inf]),
    )
    predictor = StatePredictor(Delay(1), dynamics)
    together = predictor(states.double(), past.double())
    for i, j in np.ndindex(3, 2):
        alone = predictor(states[i, j].double(), past[i, j].double())
        torch.testing.assert_close(together[i, j], alone)
