"""A Gaussian process on the knots of a grid: the prior of a force before it is learned."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from mcpilco.plant.effects.learned import Axis


@dataclass(frozen=True)
class GridPrior:
    """The weights of a grid's splines as a Gaussian process of variance 1 on its knots.

    Its covariance is a product over the axes, as are its principal directions; R of them are kept.

    Reference: Wilson & Nickisch, Kernel interpolation for scalable structured Gaussian processes,
        ICML (2015). Differs: splines interpolate, so that the force is smooth for an integrator.
    """

    axes: tuple[Axis, ...]
    roots: tuple[Float[np.ndarray, "_ _"], ...]
    """principal directions over each axis, by their standard deviation"""
    kept: tuple[Int[np.ndarray, " R"], ...]
    """of which each direction is the product, by axis"""

    @classmethod
    def of(cls, axes: Sequence[Axis], lengthscales: Sequence[float], least: float) -> GridPrior:
        """The squared exponential one, by the lengthscale in each axis's even coordinate.

        Directions of less than the `least` variance are left out.
        """
        roots, variances = [], []
        for axis, lengthscale in zip(axes, lengthscales, strict=True):
            variance, directions = np.linalg.eigh(np.exp(-0.5 * (axis.apart() / lengthscale) ** 2))
            variances.append(np.maximum(variance, 0.0))
            roots.append(directions * np.sqrt(variances[-1]))
        product = functools.reduce(np.multiply, np.ix_(*variances))
        return cls(tuple(axes), tuple(roots), tuple(np.nonzero(product > least)))

    def features(self, x: Sequence[Float[np.ndarray, " N"]]) -> Float[np.ndarray, "N R"]:
        """The force at N places for one unit of each direction."""
        parts = [
            (axis.splines(places) @ root)[:, kept]
            for axis, places, root, kept in zip(self.axes, x, self.roots, self.kept, strict=True)
        ]
        return functools.reduce(np.multiply, parts)

    def weights(self, coordinates: Float[np.ndarray, "R S"]) -> Float[np.ndarray, "M S"]:
        """Weights of the splines at coordinates along the directions."""
        rows = self.roots[0][:, self.kept[0]]
        for root, kept in zip(self.roots[1:], self.kept[1:], strict=True):
            rows = (rows[:, None] * root[:, kept]).reshape(-1, rows.shape[1])
        return rows @ coordinates
