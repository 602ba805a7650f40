"""What a correction is worth: errors of free runs on recordings that no fit has seen."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from mcpilco.gap.fit import Fit, remembered, residual, run, settle
from mcpilco.gap.model import Model
from mcpilco.gap.windows import Windows

KNOWN_S = 0.3
"""of each window from which its start is estimated [s]"""
FEWEST = 5
"""windows that must be left"""
RESAMPLES, BLOCK = 500, 8
"""of the bootstrap over blocks of neighbouring windows, which overlap"""


@dataclass(frozen=True)
class Closed:
    """Part of the gap that the correction closes."""

    value: float
    low: float
    """of the 95 % interval"""
    high: float
    """of the 95 % interval"""


@dataclass(frozen=True)
class Comparison:
    """Root-mean-square errors of position at the end of held-out windows."""

    horizon_s: float
    """time after the start of a window [s]"""
    nominal: float
    """mean over the joints, each in its noise std [-]"""
    refit: float
    """of the plant with its uncertain parameters refitted"""
    corrected: float
    """of the plant with the effects that were found"""
    noise_floor: float
    """of a model without error: noise, and what it does to the estimated start"""
    closed: Closed
    """(nominal - corrected) / (nominal - noise floor); with refit where parameters were freed"""
    channels: dict[str, dict[str, float]]
    """the same by state, in its unit"""
    over_time: dict[str, Float[np.ndarray, " T"]]
    """the errors over the time since the start, by model [noise std]"""


def compare(nominal: Model, refit: Fit, corrected: Fit, windows: Windows) -> Comparison:
    """Errors of the nominal, refitted and corrected plant on held-out windows.

    Windows whose motion forgets its start before their end are left out: there no model, not even
    the true one, can be told from another.
    """
    T = windows.y.shape[2]
    kept = remembered(corrected.model, windows, corrected.theta, windows.guess)
    whole = np.any(kept.measured[:, 0::2, -1], axis=1)
    if whole.sum() >= FEWEST:
        windows = windows[np.flatnonzero(whole)]
    plants = {
        "nominal": (nominal, np.zeros(nominal.nuisances)),
        "refit": (refit.model, refit.theta),
        "corrected": (corrected.model, corrected.theta),
    }
    errors = {name: free_run(model, theta, windows) for name, (model, theta) in plants.items()}
    errors["noise_floor"] = noise_floor(corrected.model, corrected.theta, windows)
    end = slice(T - max(1, T // 10), T)
    positions = slice(0, None, 2)
    by_window = {  # mean squared error at the end, of each window and joint
        name: np.nanmean(np.square(e[:, positions, end]), axis=2) for name, e in errors.items()
    }
    rms = {name: _rms(parts) for name, parts in by_window.items()}
    states = nominal.plant.layout.states
    freed = any(np.isinf(std) for std in nominal.priors.values())
    baseline = "refit" if freed else "nominal"
    channels = {
        states[2 * j]: {
            name: float(np.sqrt(np.nanmean(parts[:, j])) * windows.std[2 * j])
            for name, parts in by_window.items()
        }
        for j in range(len(states) // 2)
    }
    seen = windows.measured[:, positions].any(axis=(0, 1))
    over_time = {
        name: np.sqrt(np.nanmean(np.square(e[:, positions][:, :, seen]), axis=(0, 1)))
        for name, e in errors.items()
    }
    return Comparison(
        horizon_s=round((T - 1) * windows.dt, 6),
        **rms,
        closed=_closed(by_window, baseline),
        channels=channels,
        over_time=over_time,
    )


def free_run(
    model: Model, theta: Float[np.ndarray, " p"], windows: Windows
) -> Float[np.ndarray, "W X T"]:
    """(measured - simulated) / noise std, from starts fitted to the first part of each window."""
    y = windows.y.copy()
    y[:, :, round(KNOWN_S / windows.dt) :] = np.nan
    starts = settle(model, replace(windows, y=y), theta, windows.guess)
    simulated = run(model, windows, theta[None], starts[None])[0]
    r = residual(windows, simulated).reshape(windows.y.shape)
    return np.where(windows.measured, r, np.nan)


def noise_floor(
    model: Model, theta: Float[np.ndarray, " p"], windows: Windows
) -> Float[np.ndarray, "W X T"]:
    """`free_run` of a model on its own motions with noise: what no model can do better."""
    starts = settle(model, windows, theta, windows.guess)
    truth = run(model, windows, theta[None], starts[None])[0]
    noise = np.random.default_rng(0).standard_normal(truth.shape) * windows.std[:, None]
    own = np.where(windows.measured, truth + noise, np.nan)
    return free_run(model, theta, replace(windows, y=own))


def _rms(parts: Float[np.ndarray, "W J"]) -> float:
    return float(np.mean(np.sqrt(np.nanmean(parts, axis=0))))


def _closed(by_window: dict[str, Float[np.ndarray, "W J"]], baseline: str) -> Closed:
    """The part of the gap that is closed, with an interval by the block bootstrap."""
    W = len(by_window["nominal"])
    rng = np.random.default_rng(0)
    blocks = [np.arange(first, min(first + BLOCK, W)) for first in range(0, W, BLOCK)]

    def share(chosen: np.ndarray) -> float:
        rms = {name: _rms(parts[chosen]) for name, parts in by_window.items()}
        gap = rms[baseline] - rms["noise_floor"]
        return (rms[baseline] - rms["corrected"]) / gap if gap > 0.0 else 0.0

    draws = [
        share(np.concatenate([blocks[n] for n in rng.integers(len(blocks), size=len(blocks))]))
        for _ in range(RESAMPLES)
    ]
    low, high = np.percentile(draws, [2.5, 97.5])
    return Closed(share(np.arange(W)), float(low), float(high))
