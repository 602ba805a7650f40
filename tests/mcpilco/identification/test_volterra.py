"""Laws of identified Volterra series, on systems whose series are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mcpilco.gp import WeightSpaceGP
from mcpilco.identification import (
    VolterraConfig,
    fit_percent,
    fit_volterra,
    load_volterra,
    save_volterra,
    volterra,
)
from mcpilco.recordings import Series
from mcpilco.typing import InputError, RunFolderError
from runs.volterra.systems import wiener

NOISE = 0.05
SHORT = VolterraConfig(lags=2, degree=2, kernel="mpk")


def short_memory(u: np.ndarray) -> np.ndarray:
    """2 + u_k - 0.5 u_{k-2} + 0.3 u_k u_{k-1} - 0.2 u_{k-1}^2; NaN where a lag is missing."""
    x0, x1, x2 = u[2:], u[1:-1], u[:-2]
    y = 2.0 + x0 - 0.5 * x2 + 0.3 * x0 * x1 - 0.2 * x1**2
    return np.r_[np.nan, np.nan, y]


def recorded(samples: int = 300, seed: int = 0, size: float = 1.0) -> Series:
    rng = np.random.default_rng(seed)
    u = rng.normal(size=samples)
    return Series.of(size * u, short_memory(u) + NOISE * rng.normal(size=samples))


@pytest.fixture(scope="module")
def model():
    return fit_volterra(recorded(), SHORT)


# What is found ------------------------------------------------------------------------------------


def test_known_maps_are_found(model) -> None:
    assert model.coefficients(0) == pytest.approx([2.0], abs=0.02)
    np.testing.assert_allclose(model.coefficients(1), [[1.0, 0.0, -0.5]], atol=0.02)
    expected = [[[0.0, 0.15, 0.0], [0.15, -0.2, 0.0], [0.0, 0.0, 0.0]]]
    np.testing.assert_allclose(model.coefficients(2), expected, atol=0.02)
    assert model.noise_std == pytest.approx([NOISE], rel=0.1)
    assert model.report.converged


def test_maps_give_the_predictions(model) -> None:
    u = np.random.default_rng(1).normal(size=50)
    X = np.stack([u[2:], u[1:-1], u[:-2]], 1)
    h0, h1, h2 = (model.coefficients(i)[0] for i in range(3))
    mean, _ = model.predict(u)
    np.testing.assert_allclose(
        mean[2:, 0], h0 + X @ h1 + np.einsum("ij,ni,nj->n", h2, X, X), rtol=1e-6
    )
    assert np.isnan(mean[:2]).all()


@pytest.mark.parametrize("kernel", volterra.KERNELS)
def test_weight_space_and_kernel_agree(kernel: str, monkeypatch) -> None:
    """The same hyperparameters, conditioned in both ways."""
    config = replace(SHORT, kernel=kernel, max_iterations=10)
    series, u = recorded(), np.random.default_rng(2).normal(size=40)
    small = fit_volterra(series, config)
    assert isinstance(small.gp, WeightSpaceGP)
    monkeypatch.setattr(volterra, "MANY_ORDERS", 0)
    dense = volterra.prior(config, ("y",), 1, 298)
    assert not isinstance(dense, WeightSpaceGP)
    dense.load_arrays(small.gp.to_arrays())
    again = replace(small, gp=dense, posterior=dense.condition(small.X, small.Y))
    for one, other in zip(small.predict(u), again.predict(u), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-10)


def test_intervals_cover_the_truth(model) -> None:
    u = 0.9 * np.random.default_rng(3).normal(size=500)
    mean, std = model.predict(u)
    inside = np.abs(mean[2:, 0] - short_memory(u)[2:]) < 2.58 * std[2:, 0]
    assert inside.mean() > 0.9
    assert std[2:].max() < NOISE


def test_the_unit_of_the_input_does_not_matter(model) -> None:
    other = fit_volterra(recorded(size=1e-3), SHORT)
    u = np.random.default_rng(4).normal(size=50)
    np.testing.assert_allclose(other.predict(1e-3 * u)[0], model.predict(u)[0], rtol=1e-6)
    np.testing.assert_allclose(1e-3 * other.coefficients(1), model.coefficients(1), rtol=1e-6)


def test_two_inputs_and_two_outputs_are_told_apart() -> None:
    rng = np.random.default_rng(5)
    u = rng.normal(size=(400, 2))
    y = np.stack([u[:, 0] * u[:, 1], np.r_[0.0, u[:-1, 1]]], 1) + NOISE * rng.normal(size=(400, 2))
    for kernel in ("mpk", "sed-mpk"):
        found = fit_volterra(Series.of(u, y), VolterraConfig(lags=1, degree=2, kernel=kernel))
        np.testing.assert_allclose(found.coefficients(1)[1], [0.0, 0.0, 0.0, 1.0], atol=0.03)
        np.testing.assert_allclose(found.coefficients(2)[0, 0, 2], 0.5, atol=0.03)
        assert found.coefficients(2).shape == (2, 4, 4)


def test_a_centred_series_is_about_the_mean() -> None:
    series = recorded()
    shifted = Series.of(series.inputs + 10.0, series.outputs)
    found = fit_volterra(shifted, replace(SHORT, center=True))
    np.testing.assert_allclose(found.coefficients(1), [[1.0, 0.0, -0.5]], atol=0.06)
    assert not found.report.warnings
    warned = fit_volterra(shifted, SHORT).report.warnings
    assert any("stands off zero (mean " in warning for warning in warned)


def test_smooth_decay_is_worth_more_than_a_weight_a_lag() -> None:
    """Thesis section 6.5.2: fewer samples than coefficients, a resonant filter behind them."""
    rng = np.random.default_rng(6)
    train, test = rng.normal(size=(2, 500))
    z = wiener(train, 2)
    series = Series.of(train, z + 0.1 * z.std() * rng.normal(size=500))[200:]
    fits = {}
    for kernel in ("sed-mpk", "mpk"):
        config = VolterraConfig(lags=40, degree=2, kernel=kernel, tolerance=1e-5)
        mean, _ = fit_volterra(series, config).predict(test)
        fits[kernel] = fit_percent(wiener(test, 2), mean[:, 0])
    assert fits["sed-mpk"] > 75.0
    assert fits["sed-mpk"] > fits["mpk"] + 10.0


def test_many_samples_are_fitted_in_parts() -> None:
    u = np.random.default_rng(7).normal(size=300)
    y = wiener(u, 1) + 0.1 * np.random.default_rng(8).normal(size=300)
    config = VolterraConfig(lags=20, degree=2, tolerance=1e-4, fit_samples=80, samples=150)
    found = fit_volterra(Series.of(u, y), config)
    assert len(found.X) == 150
    assert found.report.jitter == (0.0,)


def test_evidence_is_of_the_same_samples_in_weight_space_and_with_the_kernel(monkeypatch) -> None:
    config = VolterraConfig(lags=1, degree=1, kernel="pk", fit_samples=60)
    small = fit_volterra(recorded(), config)
    monkeypatch.setattr(volterra, "MANY_ORDERS", 0)
    dense = fit_volterra(recorded(), config)
    assert not isinstance(dense.gp, WeightSpaceGP)
    assert small.report.evidence == pytest.approx(dense.report.evidence, abs=1e-3)
    assert len(small.X) == len(dense.X) == 298


def test_a_model_is_read_as_it_was_written(model, tmp_path) -> None:
    path = save_volterra(model, tmp_path / "model.npz")
    again, u = load_volterra(path), np.random.default_rng(9).normal(size=30)
    assert (again.config, again.report, again.input_names) == (
        model.config,
        model.report,
        model.input_names,
    )
    for one, other in zip(again.predict(u), model.predict(u), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_file_that_is_no_model_says_so(tmp_path) -> None:
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(RunFolderError, match="other.npz"):
        load_volterra(tmp_path / "other.npz")


# What is asked for --------------------------------------------------------------------------------


def test_maps_that_are_not_there_are_refused(model) -> None:
    with pytest.raises(InputError, match=r"within 1\.\.2"):
        model.penalties(0)
    with pytest.raises(InputError, match=r"within 0\.\.2"):
        model.coefficients(3)
    with pytest.raises(InputError, match=r"expected shape \(T, 1\), got \(5, 2\)"):
        model.predict(np.zeros((5, 2)))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"kernel": "rbf"}, "kernel must be one of pk, ipk, mpk"),
        ({"lags": -1}, "lags must be at least 0"),
        ({"degree": 0}, "degree must be at least 1"),
        ({"noise_floor": 0.0}, "noise_floor must lie between 0 and 1"),
    ],
)
def test_a_series_that_cannot_be_is_refused(change, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        replace(SHORT, **change)


def test_fit_is_one_hundred_for_the_truth_and_zero_for_its_mean() -> None:
    z = np.array([1.0, 2.0, 6.0, np.nan])
    assert fit_percent(z, z) == 100.0
    assert fit_percent(z, np.full(4, 3.0)) == pytest.approx(0.0)
    assert fit_percent(z, np.array([1.0, 2.0, 3.0, 0.0])) == pytest.approx(50.0)
