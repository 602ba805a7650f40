"""What a machine does in windows: positions, speeds and commands, on which a force may depend."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from mcpilco.gap.model import Model
from mcpilco.gap.windows import Windows
from mcpilco.plant import GAIN

MOST_TURNED = 8.0
"""turn of a hinge beyond which its angle and its place in a turn are two things [rad]"""


def motion(windows: Windows) -> Float[np.ndarray, "W T D"]:
    """Positions and speeds, as [q1, q1', q2, ...] by what was measured, and then the commands."""
    found = []
    for j in range(windows.y.shape[1] // 2):
        q = _filled(windows.y[:, 2 * j])
        v = np.gradient(q, windows.dt, axis=1)
        kernel = np.ones(3) / 3.0
        found += [q, np.apply_along_axis(np.convolve, 1, v, kernel, mode="same")]
    used = windows.commands[:, windows.lead :]
    return np.concatenate([np.stack(found, axis=2), used], axis=2)


def moves_of(
    model: Model, theta: Float[np.ndarray, " p"], windows: Windows
) -> Float[np.ndarray, "W m D"]:
    """What a force may depend on, in the middle of each interval: states and actuator forces."""
    moves = motion(windows)
    U = windows.commands.shape[2]
    gains = model.tables(theta[None]).actuators[0, :, GAIN]
    middle = 0.5 * (moves[:, :-1] + moves[:, 1:])
    middle[:, :, -U:] = gains * moves[:, :-1, -U:]  # a command is held
    return middle


def _filled(q: Float[np.ndarray, "W T"]) -> Float[np.ndarray, "W T"]:
    """Positions, the missing ones interpolated."""
    filled, t = q.copy(), np.arange(q.shape[1])
    for row in filled:
        known = np.isfinite(row)
        row[:] = np.interp(t, t[known], row[known]) if known.any() else 0.0
    return filled
