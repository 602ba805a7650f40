"""The exponential of the compiled loops is as good as numpy's."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from mcpilco.search.fused.arithmetic import exp


@njit
def exponentials(x):
    return np.array([exp(value) for value in x])


@pytest.mark.parametrize(("dtype", "lowest"), [(np.float64, -199.9), (np.float32, -39.9)])
def test_exponential_errs_by_some_units_in_the_last_place(dtype: type, lowest: float) -> None:
    x = np.linspace(lowest, 0.0, 100_001).astype(dtype)
    true = np.exp(x.astype(np.float64))
    error = np.abs(exponentials(x).astype(np.float64) - true) / true
    assert error.max() < 4 * np.finfo(dtype).eps


@pytest.mark.parametrize(("dtype", "lowest"), [(np.float64, -200.0), (np.float32, -40.0)])
def test_exponential_is_bounded_and_passes_nan_on(dtype: type, lowest: float) -> None:
    x = np.array([1.0, 0.0, -1e30, -np.inf, np.nan], dtype=dtype)
    low = np.exp(lowest)
    np.testing.assert_allclose(exponentials(x), [1.0, 1.0, low, low, np.nan], rtol=1e-5)
