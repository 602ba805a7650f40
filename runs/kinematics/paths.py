"""The arm of the thesis' experiments, and paths through random configurations."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import pi

import numpy as np
from jaxtyping import Float, Int

from envs.arms.marked import Kind, Link
from envs.arms.motions import RANGES

UR10 = (
    Link("hinge", d=0.1273, alpha=pi / 2),
    Link("hinge", a=-0.612),
    Link("hinge", a=-0.5723),
    Link("hinge", d=0.1639, alpha=pi / 2),
    Link("hinge", d=0.1157, alpha=-pi / 2),
    Link("hinge", d=0.0922),
)
"""by its maker's table"""


def random_way_points(
    count: int, kinds: Sequence[Kind], rng: np.random.Generator, share: float = 1.0
) -> Float[np.ndarray, "count J"]:
    """Configurations, uniform over the joints' ranges, or over a share of them."""
    half = np.array([RANGES[kind] for kind in kinds])
    return rng.uniform(-share, share, (count, len(kinds))) * half


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
