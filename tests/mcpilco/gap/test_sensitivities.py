"""Simulations of windows, and how they answer to parameters and forces."""

from __future__ import annotations

import numpy as np

import envs
from mcpilco.gap.data import GapProblem
from mcpilco.gap.sensitivities import run
from tests.mcpilco.gap.pendulum import record


def test_the_beginning_of_windows_is_simulated_like_the_whole() -> None:
    recordings = [record(np.random.default_rng(0), lambda q, v: 0.0, 0)]
    problem = GapProblem.of(envs.PLANTS["mcpilco/Pendulum-v0"](), recordings, 0.01, (), {})
    windows = problem.windows()[:3]
    model, first = problem.model(windows), windows.beginning(12)
    theta, x0 = np.zeros((1, model.nuisances)), windows.guess[None]
    assert first.y.shape[2] == 12
    np.testing.assert_array_equal(first.y, windows.y[:, :, :12])
    whole = run(model, windows, theta, x0)
    np.testing.assert_array_equal(run(model, first, theta, x0), whole[..., :12])
