"""Random Gaussian processes and random Gaussian inputs, as plain arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Case(NamedTuple):
    """The arguments of `gaussian_through_gp`."""

    x: np.ndarray
    y: np.ndarray
    lengthscale: np.ndarray
    signal_std: np.ndarray
    noise_std: np.ndarray
    mean: np.ndarray
    cov: np.ndarray


def random_case(
    rng: np.random.Generator, samples: int = 10, width: int = 3, outputs: int = 2, rank: int = 3
) -> Case:
    """GPs with samples of themselves, and an input of which some directions may be certain."""
    x = rng.standard_normal((samples, width))
    lengthscale = rng.uniform(0.6, 2.0, (outputs, width))
    signal, noise = rng.uniform(0.5, 2.0, outputs), rng.uniform(0.05, 0.3, outputs)
    y = np.stack(
        [
            rng.multivariate_normal(
                np.zeros(samples),
                kernel(x, x, length, std) + noise_std**2 * np.eye(samples),
                method="cholesky",
            )
            for length, std, noise_std in zip(lengthscale, signal, noise, strict=True)
        ],
        1,
    )
    root = rng.uniform(0.2, 1.0) * rng.standard_normal((width, rank))
    mean = 0.5 * rng.standard_normal(width)
    return Case(x, y, lengthscale, signal, noise, mean, root @ root.T)


def kernel(a: np.ndarray, b: np.ndarray, lengthscale: np.ndarray, std: float) -> np.ndarray:
    """The squared exponential, by its definition."""
    distance = (a[:, None, :] - b[None, :, :]) / lengthscale
    return std**2 * np.exp(-0.5 * np.square(distance).sum(-1))
