"""Gaussians through functions, in closed form: what moment-matching PILCO predicts with.

from baselines.moments import gaussian_through_gp, gaussian_through_trig, gaussian_through_squash
"""

from __future__ import annotations

from baselines.moments.bases import Bases, through_bases
from baselines.moments.costs import expected_cost
from baselines.moments.image import (
    Gaussian,
    Image,
    through_sine,
    through_squash,
    through_trig,
    through_waves,
)
from baselines.moments.plain import (
    gaussian_through_gp,
    gaussian_through_squash,
    gaussian_through_trig,
)

__all__ = [
    "Bases",
    "Gaussian",
    "Image",
    "expected_cost",
    "gaussian_through_gp",
    "gaussian_through_squash",
    "gaussian_through_trig",
    "through_bases",
    "through_sine",
    "through_squash",
    "through_trig",
    "through_waves",
]
