"""The search of `mcpilco.identification.bayesian`: EM, with leaps along its path.

EM creeps where the likelihood is nearly flat, and here it is: after 3000 iterations in a hundred
dimensions the inputs that are pruned at the end are still there. Two steps of EM tell where its
path leads; a leap along it that does not raise the bound is taken back.

Reference: Varadhan, Roland, Simple and globally convergent methods for accelerating the convergence
    of any EM algorithm, Scandinavian Journal of Statistics 35 (2), 2008: SQUAREM, step length S3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from mcpilco.identification.evidence_bound import bound
from mcpilco.identification.latent import Weights, expect
from mcpilco.identification.maximisation import maximise
from mcpilco.identification.moments import Moments

_LONGEST = 64.0  # a leap, in steps of EM
_LEAST = 1e-9  # of a variance after a leap, relative to its data's: below, rounding makes the bound


@dataclass(frozen=True)
class Point:
    """Where a search is."""

    weights: Weights
    alpha: Float[np.ndarray, " D"]
    """mean precision of the weights; 0 without priors"""
    bound: float = -np.inf
    """on the evidence [nats]"""


@dataclass(frozen=True)
class Ascent:
    """Where a search ended."""

    end: Point
    bounds: Float[np.ndarray, " K"]
    """after each iteration that was not taken back"""
    converged: bool
    """whether an iteration of EM raised the bound by less than the tolerance at last"""


def ascend(
    moments: Moments,
    start: Weights,
    a0: float | None,
    b0: float,
    tolerance: float,
    max_iterations: int,
) -> Ascent:
    """The search from a start.

    Args:
        moments: of the data.
        start: weights before the first iteration.
        a0: shape of the prior of alpha; None without priors.
        b0: its rate.
        tolerance: relative change of the bound in an iteration of EM at which it ends.
        max_iterations: of EM, those that are taken back too.
    """
    em = _EM(moments, a0, b0)
    here = em(Point(start, np.full_like(start.w_z, 0.0 if a0 is None else 1.0)))
    bounds, used = [here.bound], 1
    while used < max_iterations:
        first = em(here)
        second = em(first)
        bounds += [first.bound, second.bound]
        if second.bound - first.bound < tolerance * abs(second.bound):
            return Ascent(second, np.array(bounds), True)
        leapt = em.leap(here, first, second)
        here = second if leapt is None else leapt
        bounds += [] if leapt is None else [leapt.bound]
        used += 3
    return Ascent(here, np.array(bounds), False)


class _EM:
    """An iteration of EM, and leaps along its path."""

    def __init__(self, moments: Moments, a0: float | None, b0: float) -> None:
        self._moments, self._a0, self._b0 = moments, a0, b0
        self._x = np.sqrt(np.maximum(np.diag(moments.xx) / moments.N, 1e-300))
        self._y = np.sqrt(max(moments.yy / moments.N, 1e-300))

    def __call__(self, at: Point) -> Point:
        a0, b0 = self._a0, self._b0
        latent = expect(self._moments, at.weights)
        weights, alpha, rate = maximise(self._moments, latent, at.weights, at.alpha, a0, b0)
        reached = bound(self._moments, latent, weights, alpha, rate, a0, b0)
        return Point(weights, alpha, reached)

    def leap(self, here: Point, first: Point, second: Point) -> Point | None:
        """A point ahead of three, or None where that is not above them."""
        p, q, r = (self._coordinates(point) for point in (here, first, second))
        step, bend = q - p, r - 2.0 * q + p
        length = float(np.linalg.norm(step)) / max(float(np.linalg.norm(bend)), 1e-300)
        if length <= 1.0:
            return None
        length = _LONGEST if length > _LONGEST else length
        with np.errstate(all="ignore"):  # a leap may go too far: then the bound says so
            found = self(self._point(p + 2.0 * length * step + length**2 * bend))
        return found if found.bound >= second.bound and self._noisy(found.weights) else None

    def _noisy(self, w: Weights) -> bool:
        of_x = (w.psi_x > _LEAST * self._x**2).all()
        return bool(of_x and (np.append(w.psi_z, w.psi_y) > _LEAST * self._y**2).all())

    def _coordinates(self, point: Point) -> Float[np.ndarray, " C"]:
        """Weights in the units of the data; logarithms of what is positive."""
        w = point.weights
        positive = [w.psi_z, w.psi_x, np.array([w.psi_y])]
        if self._a0 is not None:
            positive += [w.var_z, w.var_x, point.alpha]
        return np.concatenate([w.w_z / self._y, w.w_x / self._x, np.log(np.concatenate(positive))])

    def _point(self, at: Float[np.ndarray, " C"]) -> Point:
        D = len(self._x)
        positive = np.exp(at[2 * D :])
        psi_z, psi_x, psi_y = positive[:D], positive[D : 2 * D], float(positive[2 * D])
        rest = positive[2 * D + 1 :] if self._a0 is not None else np.zeros(3 * D)
        var_z, var_x, alpha = rest.reshape(3, D)
        w_z, w_x = at[:D] * self._y, at[D : 2 * D] * self._x
        return Point(Weights(w_z, w_x, var_z, var_x, psi_z, psi_x, psi_y), alpha)
