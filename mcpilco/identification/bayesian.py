"""Linear regression whose inputs are noisy, by variational EM.

    t_m ~ N(0, 1)    x_m ~ N(w_xm t_m, psi_xm)    z_m ~ N(w_zm t_m, psi_zm)    y ~ N(sum z_m, psi_y)

with w_zm, w_xm ~ N(0, 1 / alpha_m), alpha_m ~ Gamma(a0, b0): inputs that do not matter are pruned.
Without these priors the model is joint factor analysis.

What it cannot tell. The t_m are independent and each is seen by one x_m alone, so the reliability
of an input, r_m = w_xm^2 / (w_xm^2 + psi_xm), is not in the likelihood: any r_m that explains no
more of y than there is to explain fits as well, with b_true,m = b_noise,m / r_m. Where the search
starts decides it, and the priors. `NoisyInputFit.least_reliability` says how far it could be
off, and `UnidentifiedWarning` that it is. Where the noise of the inputs is known, use
`mcpilco.identification.errors_in_variables`.

Reference: Ting, Mistry, Peters, Schaal, Nakanishi, A Bayesian approach to nonlinear parameter
    identification for rigid body dynamics, Robotics: Science and Systems 2006; its equations and
    appendix are cited below.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from mcpilco.identification.evidence_bound import bound
from mcpilco.identification.latent import Latent, Weights, expect
from mcpilco.identification.moments import Moments
from mcpilco.typing import InputError

PRUNED = 1e-3
"""reliability below which an input is taken as noise, and its coefficient as 0"""
TOLD = 0.95
"""least reliability from which on an input's coefficient is told well enough not to warn"""
_FLOOR = 1e-12  # of a variance, relative to that of what it is a part of


class UnidentifiedWarning(UserWarning):
    """An estimate rests on an assumption that the data do not test."""


@dataclass(frozen=True)
class NoisyInputConfig:
    """Numbers of the variational EM."""

    reliability: float = 0.5
    """r_m that the search starts from; the data do not tell it"""
    a0: float | None = 1e-6
    """shape of the prior of alpha; None for joint factor analysis, without priors"""
    b0: float = 1e-6
    """rate of the prior of alpha"""
    tolerance: float = 1e-9
    """relative change of the bound in an iteration at which the search has converged"""
    max_iterations: int = 3000
    """after which it ends in any case"""

    def __post_init__(self) -> None:
        if not 0.0 < self.reliability < 1.0:
            raise InputError(f"reliability must be between 0 and 1, got {self.reliability}.")
        if self.max_iterations < 1:
            raise InputError(f"max_iterations must be at least 1, got {self.max_iterations}.")


@dataclass(frozen=True)
class NoisyInputFit:
    """What was found."""

    weights: Weights
    """w_z, w_x, their variances, and the noise variances psi"""
    alpha: Float[np.ndarray, " D"]
    """mean precision of w_zm and w_xm; large where an input does not matter"""
    b_noise: Float[np.ndarray, " D"]
    """regression of y on noisy inputs: eq. (3)"""
    b_true: Float[np.ndarray, " D"]
    """regression of y on inputs without noise: eq. (4); 0 for pruned inputs"""
    active: Bool[np.ndarray, " D"]
    """which inputs were not pruned"""
    least_reliability: Float[np.ndarray, " D"]
    """the r_m down to which the data would be explained as well, had no other input noise"""
    bounds: Float[np.ndarray, " K"]
    """lower bound on the evidence, after each iteration; it never falls"""
    converged: bool
    """whether the bound came to rest"""


def fit_noisy_inputs(
    moments: Moments, config: NoisyInputConfig | None = None, *, warn: bool = True
) -> NoisyInputFit:
    """Regression coefficients behind noisy inputs, and what of them is a guess.

    Args:
        moments: of the data; an iteration takes O(D^2), however many samples there were.
        config: numbers of the search.
        warn: whether to warn of coefficients that the data do not tell.

    Warns:
        UnidentifiedWarning: an active input could be less reliable than `TOLD`.
    """
    config = config or NoisyInputConfig()
    weights, alpha, bounds, converged = _start(moments, config), None, [], False
    for iteration in range(config.max_iterations):
        latent = expect(moments, weights)
        weights, alpha, rate = _maximise(moments, latent, weights, alpha, config)
        bounds.append(bound(moments, latent, weights, alpha, rate, config.a0, config.b0))
        if iteration and abs(bounds[-1] - bounds[-2]) <= config.tolerance * abs(bounds[-1]):
            converged = True
            break
    assert alpha is not None
    fit = _result(moments, weights, alpha, np.array(bounds), converged)
    if warn:
        _warn(fit)
    return fit


def _start(moments: Moments, config: NoisyInputConfig) -> Weights:
    """Inputs of the given reliability, each explaining its share of the output by itself."""
    xx = np.maximum(np.diag(moments.xx) / moments.N, 1e-300)
    yy, D = max(moments.yy / moments.N, 1e-300), len(xx)
    w_x = np.sqrt(config.reliability * xx)
    slope = moments.xy / moments.N / xx / D
    return Weights(
        w_z=slope * w_x,
        w_x=w_x,
        var_z=np.zeros(D),
        var_x=np.zeros(D),
        psi_z=np.full(D, 0.5 * yy / D),
        psi_x=(1.0 - config.reliability) * xx,
        psi_y=0.5 * yy,
    )


def _maximise(
    moments: Moments,
    latent: Latent,
    weights: Weights,
    alpha: Float[np.ndarray, " D"] | None,
    config: NoisyInputConfig,
) -> tuple[Weights, Float[np.ndarray, " D"], Float[np.ndarray, " D"] | None]:
    """The weights' posterior, then their precision, then the noise: appendix A.

    Sums over samples in the print are means times N here. `Differs:` from the print's psi_y, whose
    `2 1 y <z>` is 2 y 1^T <z>.
    """
    N = moments.N
    xx, yy = np.diag(moments.xx) / N, moments.yy / N
    if config.a0 is None:
        precision = np.zeros_like(xx)
    else:
        precision = np.ones_like(xx) if alpha is None else alpha
    var_z = 1.0 / (N * latent.tt / weights.psi_z + precision)
    var_x = 1.0 / (N * latent.tt / weights.psi_x + precision)
    w_z = var_z * N * latent.zt / weights.psi_z
    w_x = var_x * N * latent.xt / weights.psi_x
    rate = None
    if config.a0 is None:
        var_z, var_x = np.zeros_like(var_z), np.zeros_like(var_x)
    else:
        rate = config.b0 + 0.5 * (w_z**2 + var_z + w_x**2 + var_x)
        precision = (config.a0 + 1.0) / rate
    psi_y = yy - 2.0 * latent.yz + latent.total
    psi_z = latent.zz - 2.0 * w_z * latent.zt + (w_z**2 + var_z) * latent.tt
    psi_x = xx - 2.0 * w_x * latent.xt + (w_x**2 + var_x) * latent.tt
    found = Weights(
        w_z=w_z,
        w_x=w_x,
        var_z=var_z,
        var_x=var_x,
        psi_z=np.maximum(psi_z, _FLOOR * yy),
        psi_x=np.maximum(psi_x, np.maximum(_FLOOR * xx, 1e-300)),
        psi_y=max(psi_y, _FLOOR * yy),
    )
    return found, precision, rate


def b_noise(weights: Weights) -> Float[np.ndarray, " D"]:
    """The regression of y on noisy inputs, eq. (3).

    The print's matrices come to w_z w_x / (<w_x^2> + psi_x (1 + Var(w_z) / psi_z)), entry by entry.
    """
    w = weights
    spread = w.psi_x * (1.0 + w.var_z / w.psi_z)
    return w.w_z * w.w_x / (w.w_x**2 + w.var_x + spread)


def b_true(weights: Weights) -> Float[np.ndarray, " D"]:
    """The regression of y on inputs without noise, eq. (4).

    The print's matrices come to w_z / w_x, entry by entry. `Differs:` where an input is pruned: 0,
    for both weights are.
    """
    used = reliability(weights) >= PRUNED
    return np.where(used, weights.w_z / np.where(used, weights.w_x, 1.0), 0.0)


def reliability(weights: Weights) -> Float[np.ndarray, " D"]:
    """r_m, the share of an input's variance that is not noise."""
    return weights.w_x**2 / (weights.w_x**2 + weights.psi_x)


def _result(
    moments: Moments,
    weights: Weights,
    alpha: Float[np.ndarray, " D"],
    bounds: Float[np.ndarray, " K"],
    converged: bool,
) -> NoisyInputFit:
    b = b_noise(weights)
    # noise of input m can explain b_m^2 D_m (1 - r_m) / r_m of y's variance, and not more than is
    # left of it when b explains what it can
    left = moments.residual_variance(b)
    explained = b**2 * np.diag(moments.xx) / moments.N
    total = explained + left
    return NoisyInputFit(
        weights,
        alpha,
        b,
        b_true(weights),
        reliability(weights) >= PRUNED,
        np.divide(explained, total, out=np.ones_like(total), where=total > 0.0),
        bounds,
        converged,
    )


def _warn(fit: NoisyInputFit) -> None:
    doubtful = np.flatnonzero(fit.active & (fit.least_reliability < TOLD))
    if len(doubtful):
        worst = doubtful[np.argmin(fit.least_reliability[doubtful])]
        warnings.warn(
            f"the noise of {len(doubtful)} of {len(fit.active)} inputs is not told by the data: "
            f"the reliability of input {worst} may be anything from "
            f"{fit.least_reliability[worst]:.2g} to 1, and b_true with it; give the noise of the "
            "inputs to errors_in_variables, if it is known.",
            UnidentifiedWarning,
            stacklevel=3,
        )
