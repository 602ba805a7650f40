"""Windows of recordings, and parts of them."""

from __future__ import annotations

import numpy as np

import envs
from mcpilco.gap.fit import run
from mcpilco.gap.given import Given
from tests.mcpilco.gap.pendulum import record


def test_the_beginning_of_windows_is_simulated_like_the_whole() -> None:
    recordings = [record(np.random.default_rng(0), lambda q, v: 0.0, 0)]
    given = Given.of(envs.PLANTS["mcpilco/Pendulum-v0"](), recordings, 0.01, (), {})
    windows = given.windows()[:3]
    model, first = given.model(windows), windows.beginning(12)
    theta, starts = np.zeros((1, model.nuisances)), windows.guess[None]
    assert first.y.shape[2] == 12
    np.testing.assert_array_equal(first.y, windows.y[:, :, :12])
    whole = run(model, windows, theta, starts)
    np.testing.assert_array_equal(run(model, first, theta, starts), whole[..., :12])
