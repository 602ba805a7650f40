"""The noise of measurements, found in recordings whose noise is known."""

from __future__ import annotations

import numpy as np
import pytest

from mcpilco.agent import Model
from mcpilco.config import ModelConfig
from mcpilco.data import Transitions
from tests.mcpilco.oscillators import moved, oscillator

DT = 0.1


def found(noise: np.ndarray, seed: int, steps: int = 150) -> np.ndarray:
    """What is found of a recorded oscillator that is pushed at random."""
    rng = np.random.default_rng(seed)
    commands, states = rng.uniform(-3, 3, steps), [np.array([0.3, -0.1])]
    for acting in (0.0, *commands[:-1]):
        states.append(moved(states[-1], acting, DT, 3.0))
    measured = np.array(states) + noise * rng.normal(size=(steps + 1, 2))
    rows = Transitions(measured[:-1], commands[:, None], measured[1:]).after_inputs(1)
    model = Model(ModelConfig(delay=DT, noise_floor=0.001), oscillator(DT))
    model.fit(rows)
    return model.tracker(rows).noise_std.numpy()


@pytest.mark.parametrize("noise", [(0.01, 0.03), (0.03, 0.01)])
@pytest.mark.parametrize("seed", range(4))
def test_noise_is_found_in_each_state(noise: tuple[float, float], seed: int) -> None:
    # what noise in the one state does to the change of the other is counted with the other's
    expected = np.hypot(noise, np.array([DT / np.sqrt(2), 9 * DT]) * noise[::-1] / np.sqrt(2))
    np.testing.assert_allclose(found(np.array(noise), seed), expected, rtol=0.25)


def test_of_positions_it_is_found_in_few_steps() -> None:
    assert found(np.array([0.03, 0.01]), seed=0, steps=30)[0] == pytest.approx(0.03, rel=0.3)


def test_exact_states_have_next_to_none() -> None:
    q, v = found(np.zeros(2), seed=0)
    assert v == pytest.approx(0.001 / np.sqrt(2), rel=0.01)  # the floor
    assert q < 2e-4  # 5e-4, were positions taken to follow at constant acceleration
