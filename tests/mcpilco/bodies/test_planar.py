"""Sine and cosine as chains in a plane take them; their motions are in `test_motion`."""

from __future__ import annotations

import numpy as np
from numba import njit

from mcpilco.bodies.planar import sine_and_cosine


def test_sine_and_cosine_are_those_of_the_library_to_rounding():
    both = njit(lambda x: sine_and_cosine(x))  # noqa: PLW0108  numba compiles its source
    x = np.concatenate([np.random.default_rng(0).uniform(-100, 100, 20000), [0.0, 9e4, 2e5, -7e4]])
    x = np.append(x, np.pi / 4.0 * np.arange(-40, 41))
    found = np.array([both(each) for each in x])
    np.testing.assert_allclose(found, np.stack([np.sin(x), np.cos(x)], axis=1), rtol=0, atol=3e-16)
    assert np.isnan(both(np.inf)).all()
    assert np.isnan(both(np.nan)).all()
