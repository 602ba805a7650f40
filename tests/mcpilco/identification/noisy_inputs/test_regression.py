"""Laws of estimates that know, estimate or evade the noise of inputs: no attenuation is left."""

from __future__ import annotations

import numpy as np
import pytest

from mcpilco.identification import (
    Moments,
    UnidentifiedWarning,
    errors_in_variables,
    instrumental_variables,
    noise_above,
    noise_of_repetitions,
    refine,
)
from mcpilco.typing import InputError

N, D, DT = 20000, 10, 0.002
B = np.arange(1.0, D + 1.0)


def motion(rng) -> np.ndarray:
    """Inputs (N, D) without noise: sums of sinusoids below 5 Hz, of variance 1."""
    time = DT * np.arange(N)[:, None, None]
    frequency, phase = rng.uniform(0.1, 5.0, (D, 8)), rng.uniform(0.0, 6.0, (D, 8))
    return 0.5 * np.sin(2.0 * np.pi * frequency * time + phase).sum(-1)


def recorded(rng, T: np.ndarray, snr: float) -> tuple[np.ndarray, np.ndarray]:
    y = T @ B
    y = y + rng.normal(size=len(T)) * np.sqrt(y.var() / 5.0)
    return T + rng.normal(size=T.shape) / np.sqrt(snr), y


def attenuation(b: np.ndarray) -> float:
    return float(b @ B / (B @ B))


def error(b: np.ndarray) -> float:
    return float(np.linalg.norm(b - B) / np.linalg.norm(B))


@pytest.mark.parametrize(("snr", "shrunk"), [(2.0, 2 / 3), (5.0, 5 / 6)])
def test_with_known_or_estimated_noise_nothing_is_shrunk(snr, shrunk):
    rng = np.random.default_rng(int(snr))
    T = motion(rng)
    first, second = recorded(rng, T, snr), recorded(rng, T, snr)
    moments = Moments.of(*first)
    assert attenuation(moments.least_squares()) == pytest.approx(shrunk, abs=0.02)
    known = np.full(D, 1.0 / snr)
    repeated = noise_of_repetitions(np.stack([first[0], second[0]]))
    for noise in (known, np.diag(known), noise_above(first[0], DT, 20.0), repeated):
        assert error(errors_in_variables(moments, noise)) < 0.05
    assert error(instrumental_variables(*first, second[0])) < 0.05


def test_noise_is_estimated_with_its_correlations():
    rng = np.random.default_rng(0)
    L = np.tril(rng.normal(size=(D, D)))
    T = motion(rng)
    noisy = [T + rng.normal(size=T.shape) @ L.T for _ in range(3)]
    for found in (noise_above(noisy[0], DT, 20.0), noise_of_repetitions(np.stack(noisy))):
        np.testing.assert_allclose(found, L @ L.T, atol=0.04 * np.trace(L @ L.T))


def test_without_noise_least_squares_stays():
    rng = np.random.default_rng(1)
    moments = Moments.of(*recorded(rng, motion(rng), 5.0))
    found = errors_in_variables(moments, np.zeros(D), regularisation=0.0)
    np.testing.assert_allclose(found, moments.least_squares(), rtol=1e-9)


def test_what_noise_hides_is_left_out_and_told():
    """Two inputs that move together but for a hundredth: their difference is all noise."""
    rng = np.random.default_rng(2)
    T = rng.normal(size=(N, 2))
    T[:, 1] = T[:, 0] + 0.01 * T[:, 1]
    X, y = T + 0.3 * rng.normal(size=T.shape), T @ np.array([1.0, 1.0])
    with pytest.warns(UnidentifiedWarning, match="1 of 2 directions"):
        b = errors_in_variables(Moments.of(X, y), np.full(2, 0.09))
    np.testing.assert_allclose(b, [1.0, 1.0], atol=0.05)


def test_redundant_inputs_share_their_coefficient():
    rng = np.random.default_rng(3)
    T = rng.normal(size=(N, 2))
    noise = 0.5 * rng.normal(size=T.shape)
    X, y = np.repeat(T + noise, 2, axis=1), T @ np.array([2.0, 4.0])
    b = errors_in_variables(Moments.of(X, y), 0.25 * np.kron(np.eye(2), np.ones((2, 2))))
    np.testing.assert_allclose(b, [1.0, 1.0, 2.0, 2.0], rtol=0.05)


def test_instruments_from_a_simulation_come_to_rest_at_the_truth():
    """A spring and a damper under a proportional controller, simulated with what was found."""
    rng = np.random.default_rng(4)
    time = 0.01 * np.arange(8000)
    reference = np.sin(time) + 0.5 * np.sin(2.7 * time)

    def simulate(b: np.ndarray) -> np.ndarray:
        """x'' = f - b0 x - b1 x', f = 40 (r - x) - 4 x'; columns of f - x'' = b0 x + b1 x'."""
        state, rows = np.zeros(2), []
        for r in reference:
            force = 40.0 * (r - state[0]) - 4.0 * state[1]
            rows.append(state)
            acceleration = force - b[0] * state[0] - b[1] * state[1]
            state = state + 0.01 * np.array([state[1] + 0.005 * acceleration, acceleration])
        return np.array(rows)

    truth = np.array([3.0, 0.7])
    clean = simulate(truth)
    X = clean + rng.normal(size=clean.shape) * 0.5 * clean.std(axis=0)
    y = clean @ truth + 0.3 * rng.normal(size=len(clean))
    shrunk = Moments.of(X, y).least_squares()
    found = refine(X, y, simulate, start=np.zeros(2))
    assert found.converged
    assert np.linalg.norm(shrunk - truth) > 0.15 * np.linalg.norm(truth)
    np.testing.assert_allclose(found.b, truth, rtol=0.05)


@pytest.mark.usefixtures("unchecked_shapes")
def test_what_is_no_noise_or_no_recording_is_refused():
    moments = Moments.of(np.eye(3), np.ones(3))
    with pytest.raises(InputError, match="noise must be 3 variances"):
        errors_in_variables(moments, -np.ones(3))
    with pytest.raises(InputError, match="at least 2 repetitions"):
        noise_of_repetitions(np.zeros((1, 5, 3)))
    with pytest.raises(InputError, match="cutoff"):
        noise_above(np.zeros((100, 3)), 0.01, 49.9)
    with pytest.raises(InputError, match="an instrument for each input"):
        instrumental_variables(np.eye(3), np.ones(3), np.ones((3, 2)))
    with pytest.raises(InputError, match="finite"):
        Moments.of(np.full((2, 2), np.nan), np.ones(2))
    with pytest.raises(InputError, match="a row of X for each y"):
        Moments.of(np.zeros((0, 2)), np.zeros(0))
