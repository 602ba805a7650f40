"""The state that a late command meets, as a model expects it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from mcpilco.dynamics import AngleAugmentation, Delay, GPDynamics, speed_integration
from mcpilco.sensing.state_predictor import StatePredictor
from tests.mcpilco.oscillators import known_dynamics, late, oscillator

FREQUENCY = 3.0
"""of an oscillator without friction [rad/s]"""


def predicted(state: np.ndarray, commands: list[float], samples: float, dt: float, frequency):
    """Where a state is after the delay, by a predictor whose model knows the velocity."""
    delay = Delay.of(samples * dt, dt)
    past = torch.tensor(commands[: delay.memory]).double()[:, None]
    predictor = StatePredictor(delay, known_dynamics(delay, dt, frequency))
    return predictor(torch.from_numpy(state), past).numpy()


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
    dynamics = GPDynamics(
        SimpleNamespace(mean=lambda asked: asked[..., 2:].sin()),
        AngleAugmentation(2, ()),
        speed_integration(oscillator(0.1)),
        np.array([np.inf]),
    )
    predictor = StatePredictor(Delay(1), dynamics)
    together = predictor(states.double(), past.double())
    for i, j in np.ndindex(3, 2):
        alone = predictor(states[i, j].double(), past[i, j].double())
        torch.testing.assert_close(together[i, j], alone)
