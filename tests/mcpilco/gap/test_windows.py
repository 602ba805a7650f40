"""Windows of recordings, and parts of them."""

from __future__ import annotations

import numpy as np

import envs
from mcpilco.gap.fit import misfits, run, settle
from mcpilco.gap.given import Given
from mcpilco.plant import CATALOGUE, EffectInstance
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


def test_starts_are_sought_where_a_sensor_that_is_off_would_have_measured_them() -> None:
    """An angle of ten turns that is read 10 % short is a whole turn away from what is read."""
    turned = record(np.random.default_rng(0), lambda q, v: 0.0, 0)
    turned.states[:, 0] = 0.9 * (turned.states[:, 0] + 20.0 * np.pi) + 0.5
    plant = envs.PLANTS["mcpilco/Pendulum-v0"]()
    given = Given.of(plant, [turned], 0.01, (), {"angle": 2e-3})
    windows = given.windows()
    nominal = given.model(windows)
    model, theta = nominal, np.zeros(nominal.nuisances)
    for name, value in (("sensor_scale", 0.9), ("sensor_offset", 0.5)):
        model, theta = model.grown(theta, EffectInstance(CATALOGUE[name], "angle"), [value])
    misfit = misfits(model, windows, theta, settle(model, windows, theta)) / windows.samples
    assert misfit.max() < 2.0
    from_readings = settle(model, windows, theta, windows.guess)
    assert np.median(misfits(model, windows, theta, from_readings) / windows.samples) > 100.0
