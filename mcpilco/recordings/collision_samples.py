"""What is known of an arm at each sample: the inputs and the target of the currents' models."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float

WINDOW = 3
"""samples over which a derivative is taken"""


@dataclass(frozen=True)
class ArmSamples:
    """N samples of J joints; those of several recordings stand one behind the other."""

    time: Float[np.ndarray, " N"]
    """since the start of its recording [s]"""
    q: Float[np.ndarray, "N J"]
    """position [rad or m]"""
    dq: Float[np.ndarray, "N J"]
    """velocity"""
    ddq: Float[np.ndarray, "N J"]
    """acceleration, of velocities up to this sample"""
    eq: Float[np.ndarray, "N J"]
    """error of position: target less measurement"""
    deq: Float[np.ndarray, "N J"]
    """error of velocity"""
    ic: Float[np.ndarray, "N J"]
    """current that the controller asks for [A]"""
    i: Float[np.ndarray, "N J"]
    """current measured [A]"""

    def __len__(self) -> int:
        return len(self.time)

    @property
    def standard(self) -> Float[np.ndarray, "N D"]:
        """x = [q, q', q''], thesis section 4.4.1."""
        return np.hstack([self.q, self.dq, self.ddq])

    @property
    def augmented(self) -> Float[np.ndarray, "N D"]:
        """[q, q', q'', e_q, e_q', i_c], thesis eq. (4.8)."""
        return np.hstack([self.standard, self.eq, self.deq, self.ic])

    def __getitem__(self, rows: slice | np.ndarray) -> ArmSamples:
        return ArmSamples(*(getattr(self, field.name)[rows] for field in fields(self)))

    def every(self, count: int) -> ArmSamples:
        """About so many of the samples, at a constant step, thesis section 4.6.1."""
        return self[np.linspace(0, len(self) - 1, min(count, len(self))).round().astype(int)]

    @classmethod
    def joined(cls, parts: Sequence[ArmSamples]) -> ArmSamples:
        """One behind the other."""
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))


def slopes(x: Float[np.ndarray, "N J"], dt: float, window: int) -> Float[np.ndarray, "N J"]:
    """Slope of the straight line through the last `window` samples of x; NaN at the first ones."""
    found = np.full_like(x, np.nan)
    if len(x) >= window:
        seen = np.lib.stride_tricks.sliding_window_view(x, window, axis=0)
        found[window - 1 :] = seen @ _slope_weights(dt, window)
    return found


def _slope_weights(dt: float, window: int) -> Float[np.ndarray, " W"]:
    """Least squares: sum_k (k - mean) x_k / sum_k (k - mean)^2 / dt."""
    k = np.arange(window) - 0.5 * (window - 1)
    return k / (k @ k) / dt


class RunningSlope:
    """`slopes`, one sample at a time.

    Args:
        dt: sampling time [s].
        window: samples.
    """

    def __init__(self, dt: float, window: int) -> None:
        self._weights = _slope_weights(dt, window)
        self._last: deque[np.ndarray] = deque(maxlen=window)

    def __call__(self, x: Float[np.ndarray, " J"]) -> Float[np.ndarray, " J"]:
        """The slope up to this sample; NaN as long as there are too few."""
        self._last.append(x)
        if len(self._last) < len(self._weights):
            return np.full_like(x, np.nan)
        return self._weights @ np.stack(self._last)

    def reset(self) -> None:
        """Forgets all samples."""
        self._last.clear()
