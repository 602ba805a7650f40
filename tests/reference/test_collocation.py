"""Laws of the integrator."""

from __future__ import annotations

import numpy as np
import pytest

from mcpilco.typing import EnvError
from tests.reference.collocation import integrate


def spring(rate: float):
    """Accelerations of an undamped oscillator of `rate` [rad/s]."""
    return lambda q, dq: -(rate**2) * q


@pytest.mark.parametrize("rate", [1.0, 20.0, 300.0])
def test_oscillator_follows_its_closed_form_at_any_rate(rate):
    times = np.arange(1, 11) / 10
    q, dq = integrate(spring(rate), np.array([1.0]), np.array([0.0]), 1.0, samples=10)
    np.testing.assert_allclose(q[:, 0], np.cos(rate * times), atol=1e-10)
    np.testing.assert_allclose(dq[:, 0] / rate, -np.sin(rate * times), atol=1e-10)


def test_stiff_damping_follows_its_closed_form():
    rate = 2000.0
    _, dq = integrate(lambda q, dq: -rate * dq, np.zeros(1), np.ones(1), 0.01, samples=5)
    np.testing.assert_allclose(dq[:, 0], np.exp(-rate * 0.002 * np.arange(1, 6)), atol=1e-11)


@pytest.mark.parametrize("samples", [1, 2, 7])
def test_end_does_not_depend_on_how_many_samples_are_asked_for(samples):
    start = np.array([0.3]), np.array([-1.0])
    many = integrate(lambda q, dq: -50.0 * np.sin(q), *start, 0.8, samples=24)
    few = integrate(lambda q, dq: -50.0 * np.sin(q), *start, 0.8, samples=samples)
    assert len(few[0]) == len(few[1]) == samples
    np.testing.assert_allclose(few[0][-1], many[0][-1], rtol=1e-11)
    np.testing.assert_allclose(few[1][-1], many[1][-1], rtol=1e-11)


def test_motion_that_cannot_be_followed_is_an_error():
    with pytest.raises(EnvError, match="could not be integrated"):
        integrate(lambda q, dq: -1e9 * dq, np.zeros(1), np.ones(1), 0.1)
