"""Expectation maximisation with leaps, for linear regression whose inputs are noisy.

    t_m ~ N(0, 1)    x_m ~ N(w_xm t_m, psi_xm)    z_m ~ N(w_zm t_m, psi_zm)    y ~ N(sum z_m, psi_y)

with w_zm, w_xm ~ N(0, 1 / alpha_m), alpha_m ~ Gamma(a0, b0): inputs that do not matter are pruned.
Without these priors the model is joint factor analysis. `expect` is the E-step, `maximise` the
M-step, `bound` the bound on the evidence that both raise, and `ascend` the search.

EM creeps where the likelihood is nearly flat, and here it is: after 3000 iterations in a hundred
dimensions the inputs that are pruned at the end are still there. Two steps of EM show where its
path leads; a leap along it that does not raise the bound is taken back.

Reference: Ting, Mistry, Peters, Schaal, Nakanishi, A Bayesian approach to nonlinear parameter
    identification for rigid body dynamics, Robotics: Science and Systems 2006; its equations and
    appendix are cited below. Leaps: Varadhan, Roland, Simple and globally convergent methods for
    accelerating the convergence of any EM algorithm, Scandinavian Journal of Statistics 35 (2),
    2008: SQUAREM, step length S3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import digamma, gammaln

from mcpilco.identification.noisy_inputs.regression import Moments

PerInput = Float[np.ndarray, " D"]
"""a number an input"""


@dataclass(frozen=True)
class Weights:
    """Means and variances of w, and variances of the noise, in the units of x and y."""

    w_z: PerInput
    w_x: PerInput
    var_z: PerInput
    """of w_z; 0 in joint factor analysis"""
    var_x: PerInput
    """of w_x"""
    psi_z: PerInput
    psi_x: PerInput
    psi_y: float


@dataclass(frozen=True)
class Latent:
    """Means over samples of posterior moments of z and t."""

    zz: PerInput
    """of z_m^2"""
    zt: PerInput
    """of z_m t_m"""
    tt: PerInput
    """of t_m^2"""
    xt: PerInput
    """of x_m t_m"""
    yz: float
    """of y 1^T z"""
    total: float
    """of (1^T z)^2"""
    log_det: float
    """log det Sigma, the covariance of (z, t) in each sample"""


def expect(moments: Moments, weights: Weights) -> Latent:
    """The moments of z and t under their posterior, for O(D^2) operations.

    With the precision of (z, t), its blocks and what they act on,

        P_zz = 1 1^T / psi_y + Psi_z^-1    P_zt = -W_z Psi_z^-1    P_tt = K
        h_z = 1 y / psi_y                  h_t = W_x Psi_x^-1 x

    the appendix's Sigma_zz = M - M 1 1^T M / k, k = psi_y + 1^T M 1, is diagonal but for a part of
    rank one, so that with D = W_z Psi_z^-1 K^-1 and g = 1 y / psi_y + D h_t

        <z> = Sigma_zz g = M (g - 1 s / k),  s = 1^T M g        <t> = K^-1 h_t + D <z>

    are linear in y, x and the one number s, whose moments with x are one product with X^T X.

    `Differs:` from the appendix, which prints Sigma_zt = -Sigma_zz W_z Psi_z^-1 K^-1; its sign is
    plus, as the inverse of P has it. And from its <z_i>, which multiplies by Sigma_zt where the
    row form takes Sigma_tz.
    """
    w, N = weights, moments.N
    xx, xy, yy = np.diag(moments.xx) / N, moments.xy / N, moments.yy / N
    K = 1.0 + (w.w_x**2 + w.var_x) / w.psi_x + (w.w_z**2 + w.var_z) / w.psi_z
    M = w.psi_z + w.w_z**2 / (1.0 + (w.w_x**2 + w.var_x) / w.psi_x + w.var_z / w.psi_z)
    k = w.psi_y + M.sum()
    D = w.w_z / (w.psi_z * K)
    c = w.w_x / w.psi_x  # h_t = c x
    e = D * c  # g = y / psi_y + e x
    # s = a_y y + a_x^T x and its moments with y, x, itself
    a_y, a_x = M.sum() / w.psi_y, M * e
    sx = a_y * xy + moments.xx @ a_x / N
    sy = a_y * yy + a_x @ xy
    ss = a_y * sy + a_x @ sx
    gg = yy / w.psi_y**2 + 2.0 * e * xy / w.psi_y + e**2 * xx
    gs = sy / w.psi_y + e * sx
    gx = xy / w.psi_y + e * xx
    zz = M**2 * (gg - 2.0 * gs / k + ss / k**2)  # of the means, so far
    zx = M * (gx - sx / k)
    cov_zz = M - M**2 / k
    tx = c / K * xx + D * zx
    return Latent(
        zz=zz + cov_zz,
        zt=c / K * zx + D * zz + D * cov_zz,
        tt=c / K * tx + D * (c / K * zx + D * zz) + 1.0 / K + D**2 * cov_zz,
        xt=tx,
        yz=float(sy * w.psi_y / k),
        total=float(ss * (w.psi_y / k) ** 2 + w.psi_y * M.sum() / k),
        log_det=float(np.log(M).sum() - np.log(K).sum() - np.log(k / w.psi_y)),
    )


FLOOR = 1e-12
"""of a variance, relative to that of what it is a part of"""


def maximise(
    moments: Moments, latent: Latent, weights: Weights, alpha: PerInput, a0: float | None, b0: float
) -> tuple[Weights, PerInput, PerInput | None]:
    """The weights' posterior, then their mean precision and its rate, then the noise: appendix A.

    Sums over samples in the print are means times N here. `Differs:` from the print's psi_y, whose
    `2 1 y <z>` is 2 y 1^T <z>.

    Without priors alpha is 0, a0 and the rate are None.
    """
    N = moments.N
    xx, yy = np.diag(moments.xx) / N, moments.yy / N
    var_z = 1.0 / (N * latent.tt / weights.psi_z + alpha)
    var_x = 1.0 / (N * latent.tt / weights.psi_x + alpha)
    w_z = var_z * N * latent.zt / weights.psi_z
    w_x = var_x * N * latent.xt / weights.psi_x
    rate = None
    if a0 is None:
        var_z, var_x = np.zeros_like(var_z), np.zeros_like(var_x)
    else:
        rate = b0 + 0.5 * (w_z**2 + var_z + w_x**2 + var_x)
        alpha = (a0 + 1.0) / rate
    psi_y = yy - 2.0 * latent.yz + latent.total
    psi_z = latent.zz - 2.0 * w_z * latent.zt + (w_z**2 + var_z) * latent.tt
    psi_x = xx - 2.0 * w_x * latent.xt + (w_x**2 + var_x) * latent.tt
    found = Weights(
        w_z=w_z,
        w_x=w_x,
        var_z=var_z,
        var_x=var_x,
        psi_z=np.maximum(psi_z, FLOOR * yy),
        psi_x=np.maximum(psi_x, np.maximum(FLOOR * xx, 1e-300)),
        psi_y=max(psi_y, FLOOR * yy),
    )
    return found, alpha, rate


_LOG_2PI = float(np.log(2.0 * np.pi))


def bound(
    moments: Moments,
    latent: Latent,
    weights: Weights,
    alpha: PerInput,
    rate: PerInput | None,
    a0: float | None,
    b0: float,
) -> float:
    """A lower bound on log p(y, X): expected complete log likelihood plus entropies [nats].

    `Differs:` from the print's complete log likelihood, in which p(alpha_m) stands twice; once is
    right.

    The posterior of alpha is Gamma(a0 + 1, rate); without priors a0 and rate are None.
    """
    w, N, D = weights, moments.N, len(weights.w_z)
    xx, yy = np.diag(moments.xx) / N, moments.yy / N
    r_y = yy - 2.0 * latent.yz + latent.total
    r_z = latent.zz - 2.0 * w.w_z * latent.zt + (w.w_z**2 + w.var_z) * latent.tt
    r_x = xx - 2.0 * w.w_x * latent.xt + (w.w_x**2 + w.var_x) * latent.tt
    data = (
        _normal(w.psi_y, r_y)
        + _normal(w.psi_z, r_z).sum()
        + _normal(w.psi_x, r_x).sum()
        + _normal(np.ones(D), latent.tt).sum()
        + 0.5 * (2 * D * (1.0 + _LOG_2PI) + latent.log_det)
    )
    if rate is None or a0 is None:
        return float(N * data)
    a = a0 + 1.0
    log_alpha = digamma(a) - np.log(rate)
    squares = w.w_z**2 + w.var_z + w.w_x**2 + w.var_x
    weights_term = log_alpha - 0.5 * alpha * squares - _LOG_2PI
    weights_entropy = 0.5 * (2.0 * (1.0 + _LOG_2PI) + np.log(w.var_z) + np.log(w.var_x))
    prior = a0 * np.log(b0) - gammaln(a0) + (a0 - 1.0) * log_alpha - b0 * alpha
    entropy = a - np.log(rate) + gammaln(a) + (1.0 - a) * digamma(a)
    return float(N * data + (weights_term + weights_entropy + prior + entropy).sum())


def _normal(variance, square):
    """Expected log density of a normal variable, of its variance and mean squared deviation."""
    return -0.5 * (_LOG_2PI + np.log(variance) + square / variance)


_LONGEST = 64.0  # a leap, in steps of EM
_LEAST = 1e-9  # of a variance after a leap, relative to its data's: below, rounding makes the bound


@dataclass(frozen=True)
class Point:
    """Weights and precisions that a search has reached, with their bound."""

    weights: Weights
    alpha: PerInput
    """mean precision of the weights; 0 without priors"""
    bound: float = -np.inf
    """on the evidence [nats]"""


@dataclass(frozen=True)
class Ascent:
    """The end of a search, and its way."""

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
    """Maximise the bound from a start, by EM with leaps.

    The search ends once an iteration of EM changes the bound by less than `tolerance`, relative to
    it, or after `max_iterations`, those that are taken back too.
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
        length = min(length, _LONGEST)
        with np.errstate(all="ignore"):  # a leap may go too far: then the bound says so
            found = self(self._point(p + 2.0 * length * step + length**2 * bend))
        w = found.weights
        good = found.bound >= second.bound and (w.psi_x > _LEAST * self._x**2).all()
        good = good and (np.append(w.psi_z, w.psi_y) > _LEAST * self._y**2).all()
        return found if good else None

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
