"""States without most of their noise, and velocities that were not measured."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from mcpilco.recordings.local_fit import local_fit
from mcpilco.recordings.noise import noise_std
from mcpilco.recordings.recording import Recording

WINDOW_S = 0.12
"""length of the windows [s]; at least 7 samples"""
_ORDER = 3
_FEWEST = 7


def smoothed(
    recording: Recording, window: float = WINDOW_S
) -> tuple[Float[np.ndarray, "T X"], Float[np.ndarray, "T X"]]:
    """States by local cubics, and their standard deviations: where to start a simulation from.

    A velocity without a column is the slope of its position's cubic. No window reaches across a
    gap; at the ends of a segment it lies to one side, and the deviation grows. Where the cubic
    misses the samples by more than their noise, the deviation grows by as much.

    Args:
        recording: whose states; a masked value is filled in where its neighbours allow.
        window: length of the windows [s].

    Returns:
        States and standard deviations, in each state's unit; NaN within gaps, and where a state has
        neither a column nor a position.
    """
    states = np.full_like(recording.states, np.nan)
    std = np.full_like(recording.states, np.nan)
    noise = noise_std(recording)
    position_of = {velocity: position for position, velocity in recording.velocities}
    width = max(_FEWEST, round(window / recording.dt) // 2 * 2 + 1)
    for segment in recording.segments():
        for k, measured in enumerate(recording.measured):
            source, derivative = (k, 0) if measured else (position_of.get(k, k), 1)
            value, error = _local(recording.states[segment, source], width, noise[source])
            per_step = recording.dt**derivative
            states[segment, k] = value[:, derivative] / per_step
            std[segment, k] = error[:, derivative] / per_step
    return states, std


def _local(
    values: Float[np.ndarray, " T"], width: int, noise: float
) -> tuple[Float[np.ndarray, "T C"], Float[np.ndarray, "T C"]]:
    """Coefficients at each sample and their standard deviations [unit a step^c]."""
    width = min(width, len(values))
    here = np.arange(len(values))
    first = np.clip(here - width // 2, 0, len(values) - width)
    rows = first[:, None] + np.arange(width)
    order = min(_ORDER, width - 1)
    value, spread, mean_square = local_fit((rows - here[:, None]) * 1.0, values[rows], order)
    scale = np.fmax(noise, np.sqrt(mean_square))
    return value, spread * scale[:, None]
