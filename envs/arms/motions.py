"""Joint motions that excite an arm."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from envs.arms.dh import Kind

RANGES = {"hinge": 2.0, "slide": 0.3}
"""half the range of a joint [rad or m]"""
_SINES = 10


def sinusoids(
    time: Float[np.ndarray, " N"], kinds: Sequence[Kind], rng: np.random.Generator
) -> Float[np.ndarray, "N J"]:
    """Each joint moves by a sum of ten sinusoids of random amplitudes, frequencies and phases.

    Args:
        time: of the samples [s]; the slowest sinusoid has a period of as long as it spans.
        kinds: of the joints; a joint's largest deflection is its range.
        rng: draws all else.

    Reference: thesis section 2.6.1.
    """
    shape = _SINES, len(kinds)
    amplitudes = rng.uniform(0.0, 1.0, shape)
    cycles = rng.uniform(1.0, 15.0, shape) / np.ptp(time)
    phases = rng.uniform(0.0, 2 * np.pi, shape)
    q = (amplitudes * np.sin(2 * np.pi * cycles * time[:, None, None] + phases)).sum(1)
    return q / np.abs(q).max(0) * _halves(kinds)


def random_way_points(
    count: int, kinds: Sequence[Kind], rng: np.random.Generator, share: float = 1.0
) -> Float[np.ndarray, "count J"]:
    """Configurations, uniform over the joints' ranges, or over a share of them."""
    return rng.uniform(-share, share, (count, len(kinds))) * _halves(kinds)


def through(
    way_points: Float[np.ndarray, "count J"], order: Int[np.ndarray, " stops"], samples: int
) -> Float[np.ndarray, "N J"]:
    """N = (stops - 1) * `samples` + 1 samples from one way-point to the next, at rest at each.

    Between two, position follows the polynomial of least jerk.
    """
    s = np.arange(samples) / samples
    rise = (10 * s**3 - 15 * s**4 + 6 * s**5)[:, None]
    stops = way_points[order]
    legs = [start + rise * (end - start) for start, end in pairwise(stops)]
    return np.concatenate([*legs, stops[-1:]])


def _halves(kinds: Sequence[Kind]) -> Float[np.ndarray, " J"]:
    return np.array([RANGES[kind] for kind in kinds])
