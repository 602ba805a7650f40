"""Regression coefficients behind noisy inputs, by the variational EM of `em`.

What the data cannot determine. The t_m of the model are independent and each is seen by one x_m
alone, so the reliability of an input, r_m = w_xm^2 / (w_xm^2 + psi_xm), is not in the likelihood:
each r_m that explains at most all of y's variance fits equally well, with b_true,m = b_noise,m /
r_m. It is not identifiable: the start of the search and the priors, which know nothing of the
noise, decide it. So it is chosen afterwards, in the middle of what the data allow:
`NoisyInputConfig.reliability`.
`NoisyInputFit.least_reliability` says how far one of them could be off, and `UnidentifiedWarning`
that it is. Where the noise of the inputs is known, use `errors_in_variables`.

Reference: Ting et al. 2006, as in `em`; its equations are cited below.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from mcpilco.identification.noisy_inputs.em import Ascent, Weights, ascend
from mcpilco.identification.noisy_inputs.regression import Moments, UnidentifiedWarning
from mcpilco.typing import InputError

PRUNED = 1e-3
"""reliability below which an input is taken as noise, and its coefficient as 0"""
RELIABLE = 0.95
"""least reliability of an input from which on there is no warning about its coefficient"""


@dataclass(frozen=True)
class NoisyInputConfig:
    """Numbers of the variational EM."""

    starts: tuple[float, ...] = (0.5, 0.8)
    """reliabilities that searches start from; that of the greatest bound is taken"""
    reliability: float | Literal["middle", "search"] = "middle"
    """r_m of all inputs that were not pruned, which the data do not determine; middle: of what they
    allow, see `middle_reliability`; search: where the search ended, as Ting et al. have it"""
    a0: float | None = 1e-6
    """shape of the prior of alpha; None for joint factor analysis, without priors"""
    b0: float = 1e-6
    """rate of the prior of alpha"""
    tolerance: float = 1e-9
    """relative change of the bound in an iteration of EM at which a search has converged"""
    max_iterations: int = 3000
    """of EM in a search, after which it ends in any case"""

    def __post_init__(self) -> None:
        known = self.reliability in ("middle", "search")
        if not (known or (not isinstance(self.reliability, str) and 0.0 < self.reliability <= 1.0)):
            raise InputError(
                "reliability must be middle, search, or a number above 0 and at most 1, got "
                f"{self.reliability}."
            )
        if not self.starts or not all(0.0 < start < 1.0 for start in self.starts):
            raise InputError(f"starts must be between 0 and 1, at least one, got {self.starts}.")
        if self.max_iterations < 1:
            raise InputError(f"max_iterations must be at least 1, got {self.max_iterations}.")


@dataclass(frozen=True)
class NoisyInputFit:
    """Regression coefficients behind noisy inputs, with the model that they come from."""

    weights: Weights
    """w_z, w_x, their variances, and the noise variances psi"""
    alpha: Float[np.ndarray, " D"]
    """mean precision of w_zm and w_xm; large where an input does not matter"""
    b_noise: Float[np.ndarray, " D"]
    """regression of y on noisy inputs: eq. (3)"""
    b_true: Float[np.ndarray, " D"]
    """regression of y on inputs without noise: b_noise over the reliability of the configuration,
    eq. (4) where that is the search's; 0 for pruned inputs"""
    active: Bool[np.ndarray, " D"]
    """which inputs were not pruned"""
    least_reliability: Float[np.ndarray, " D"]
    """the least r_m that fits the data equally well, if no other input is noisy"""
    bounds: Float[np.ndarray, " K"]
    """lower bound on the evidence, after each iteration; it never falls"""
    converged: bool
    """whether the bound came to rest"""


def fit_noisy_inputs(
    moments: Moments, config: NoisyInputConfig | None = None, *, warn: bool = True
) -> NoisyInputFit:
    """Regression coefficients behind noisy inputs, and which of them rest on an assumption.

    An iteration takes O(D^2), however many samples there were.

    Warns:
        UnidentifiedWarning: an active input could be less reliable than `RELIABLE`.
    """
    c = config or NoisyInputConfig()
    searches = [
        ascend(moments, _start(moments, start), c.a0, c.b0, c.tolerance, c.max_iterations)
        for start in c.starts
    ]
    fit = _result(moments, max(searches, key=lambda search: search.end.bound), c)
    if warn:
        _warn(fit)
    return fit


def _start(moments: Moments, reliability: float) -> Weights:
    """Inputs of the given reliability, each explaining its share of the output by itself."""
    xx = np.maximum(np.diag(moments.xx) / moments.N, 1e-300)
    yy, D = max(moments.yy / moments.N, 1e-300), len(xx)
    w_x = np.sqrt(reliability * xx)
    slope = moments.xy / moments.N / xx / D
    return Weights(
        w_z=slope * w_x,
        w_x=w_x,
        var_z=np.zeros(D),
        var_x=np.zeros(D),
        psi_z=np.full(D, 0.5 * yy / D),
        psi_x=(1.0 - reliability) * xx,
        psi_y=0.5 * yy,
    )


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


def middle_reliability(moments: Moments, b: Float[np.ndarray, " D"]) -> float:
    """One reliability for all inputs: (1 + R^2) / 2, with the share R^2 of y that b explains.

    With noise of covariance (1 - r) X^T X / N, b_true = b / r would explain R^2 / r, which is at
    most 1. The data bound r by R^2 <= r <= 1 only; with all of these as likely, b over
    their mean has the least expected squared error from inputs without noise.

    Reference: Frisch, Statistical confluence analysis by means of complete regression systems,
        1934, whose bounds of a slope are b and b / R^2; the middle is ours.
    """
    total = max(moments.yy / moments.N, 1e-300)
    return 1.0 - 0.5 * min(moments.residual_variance(b) / total, 1.0)


def _result(moments: Moments, search: Ascent, config: NoisyInputConfig) -> NoisyInputFit:
    weights = search.end.weights
    b, active = b_noise(weights), reliability(weights) >= PRUNED
    if config.reliability == "search":
        true = b_true(weights)
    else:
        kept, r = np.where(active, b, 0.0), config.reliability
        true = kept / (middle_reliability(moments, kept) if isinstance(r, str) else r)
    # noise of input m can explain b_m^2 D_m (1 - r_m) / r_m of y's variance, and not more than is
    # left of it when b explains what it can
    left = moments.residual_variance(b)
    explained = b**2 * np.diag(moments.xx) / moments.N
    total = explained + left
    return NoisyInputFit(
        weights=weights,
        alpha=search.end.alpha,
        b_noise=b,
        b_true=true,
        active=active,
        least_reliability=np.divide(explained, total, out=np.ones_like(total), where=total > 0.0),
        bounds=search.bounds,
        converged=search.converged,
    )


def _warn(fit: NoisyInputFit) -> None:
    doubtful = np.flatnonzero(fit.active & (fit.least_reliability < RELIABLE))
    if len(doubtful):
        worst = doubtful[np.argmin(fit.least_reliability[doubtful])]
        warnings.warn(
            f"the noise of {len(doubtful)} of {len(fit.active)} inputs is not determined by the "
            f"data: the reliability of input {worst} may be anything from "
            f"{fit.least_reliability[worst]:.2g} to 1, and b_true with it; give the noise of the "
            "inputs to errors_in_variables, if it is known.",
            UnidentifiedWarning,
            stacklevel=3,
        )
