"""Laws of the noise that goes over from one reading to the next."""

from __future__ import annotations

import numpy as np
from scipy.linalg import toeplitz

from mcpilco.recordings import NoiseFilter, following

STD, CORRELATION = np.array([0.5, 2.0]), np.array([0.6, 0.0])


def seen(rng: np.random.Generator) -> np.ndarray:
    """Three windows of two states; of the first state some readings are missing."""
    measured = np.ones((3, 2, 12), dtype=bool)
    measured[:, 0] = rng.random((3, 12)) > 0.3
    return measured


def test_the_filter_is_the_inverse_root_of_the_covariance() -> None:
    """Between two gaps, before which nothing goes over."""
    whole = np.ones((1, 2, 12), dtype=bool)
    F = NoiseFilter.of(whole, STD, CORRELATION)
    root = F.columns(np.eye(24)[None])[0]
    for x, own in enumerate((slice(0, 12), slice(12, 24))):
        covariance = STD[x] ** 2 * toeplitz(CORRELATION[x] ** np.arange(12))
        np.testing.assert_allclose(
            root[own, own] @ covariance @ root[own, own].T, np.eye(12), atol=1e-12
        )
    assert not root[:12, 12:].any()
    assert not root[12:, :12].any()


def test_a_reading_behind_a_gap_begins_anew() -> None:
    measured = seen(np.random.default_rng(0))
    F = NoiseFilter.of(measured, STD, CORRELATION)
    first = measured & ~following(measured)
    np.testing.assert_array_equal(F.f.reshape(measured.shape)[first], 0.0)
    assert (F.f.reshape(measured.shape)[:, 0][following(measured)[:, 0]] == CORRELATION[0]).all()
    assert following(measured).sum() == (measured[..., 1:] & measured[..., :-1]).sum()


def test_columns_are_filtered_as_residuals_are() -> None:
    rng = np.random.default_rng(1)
    F = NoiseFilter.of(seen(rng), STD, CORRELATION)
    A = rng.standard_normal((3, 24, 4))
    for k in range(4):
        np.testing.assert_allclose(F.columns(A)[:, :, k], F(A[:, :, k]))
