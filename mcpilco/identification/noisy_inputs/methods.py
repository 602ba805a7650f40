"""Methods of linear regression behind one signature, to be compared in a loop.

Each is a function of X (N, D), y (N,) and a seed that returns a `Solution`, b (D,) and whether the
search for it converged, for data without intercept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.stats import f as f_distribution

from mcpilco.identification.noisy_inputs.bayesian import (
    NoisyInputConfig,
    fit_noisy_inputs,
    middle_reliability,
)
from mcpilco.identification.noisy_inputs.regression import Moments, Solution
from mcpilco.typing import McPilcoError

Inputs = Float[np.ndarray, "N D"]
Outputs = Float[np.ndarray, " N"]
Method = Callable[[np.ndarray, np.ndarray, int], Solution]

FOLDS = 5
"""of cross validations"""
RIDGES = 10.0 ** np.arange(-8.0, 2.1, 0.5)
"""tried, relative to the mean eigenvalue of X^T X"""
MOST_ITERATIONS = 5000
"""of the LASSO's descent"""


def least_squares(X: Inputs, y: Outputs, seed: int = 0) -> Solution:
    """The least of all b that fit best: the pseudo-inverse."""
    return Solution(Moments.of(X, y).least_squares())


def ridge(X: Inputs, y: Outputs, seed: int = 0) -> Solution:
    """Least squares with a penalty on |b|^2, chosen by generalised cross validation.

    Reference: Golub, Heath, Wahba, Generalized cross-validation as a method for choosing a good
    ridge parameter, Technometrics 21 (2), 1979.
    """
    U, values, Vt = np.linalg.svd(X, full_matrices=False)
    penalties = RIDGES * (values**2).mean()
    projected = U.T @ y
    rest = max(float(y @ y - projected @ projected), 0.0)
    kept = values**2 / (values**2 + penalties[:, None])
    errors = ((1.0 - kept) ** 2 * projected**2).sum(axis=1) + rest
    best = int(np.argmin(errors / (len(y) - kept.sum(axis=1)) ** 2))
    return Solution(Vt.T @ (values / (values**2 + penalties[best]) * projected))


def stepwise(
    X: Inputs, y: Outputs, seed: int = 0, enter: float = 0.05, leave: float = 0.10
) -> Solution:
    """Inputs enter by the F test of the best next one, and leave by that of the worst.

    They do so at a p value below `enter` and above `leave`.

    Reference: Draper, Smith, Applied regression analysis, 1981, chapter 6.
    """
    moments, D = Moments.of(X, y), X.shape[1]
    chosen: list[int] = []
    entered, converged = 0, False
    while entered < 4 * D:  # an input that enters and leaves again and again ends it
        entering = _best_to_enter(moments, chosen)
        if entering is None or entering[1] > enter:
            converged = True
            break
        entered += 1
        chosen.append(entering[0])
        while len(chosen) > 1:
            at, p = _worst_within(moments, chosen)
            if p <= leave:
                break
            chosen.pop(at)
    b = np.zeros(D)
    if chosen:
        b[chosen] = np.linalg.solve(moments.xx[np.ix_(chosen, chosen)], moments.xy[chosen])
    return Solution(b, converged, entered)


def _best_to_enter(moments: Moments, chosen: list[int]) -> tuple[int, float] | None:
    """The input that would lower the squared error most, and the p value of its F."""
    others = np.setdiff1d(np.arange(len(moments.xy)), chosen)
    if len(others) == 0 or len(chosen) + 1 >= moments.N:
        return None
    taken = np.array(chosen, dtype=int)
    A, C = moments.xx[np.ix_(taken, taken)], moments.xx[np.ix_(taken, others)]
    W = np.linalg.solve(A, C)
    b = np.linalg.solve(A, moments.xy[taken])
    left = np.diag(moments.xx)[others] - (C * W).sum(axis=0)  # of each input, without the chosen
    gain = moments.xy[others] - C.T @ b
    fresh = left > 1e-9 * np.diag(moments.xx)[others]
    if not fresh.any():
        return None
    drop = np.where(fresh, gain**2 / np.where(fresh, left, 1.0), 0.0)
    best = int(np.argmax(drop))
    error = moments.yy - b @ moments.xy[taken] - drop[best]
    freedom = moments.N - len(chosen) - 1
    F = drop[best] / max(error / freedom, 1e-300)
    return int(others[best]), float(f_distribution.sf(F, 1, freedom))


def _worst_within(moments: Moments, chosen: list[int]) -> tuple[int, float]:
    """Which of the chosen inputs matters least, and the p value of its F."""
    inverse = np.linalg.inv(moments.xx[np.ix_(chosen, chosen)])
    b = inverse @ moments.xy[chosen]
    freedom = max(moments.N - len(chosen), 1)
    error = max((moments.yy - b @ moments.xy[chosen]) / freedom, 1e-300)
    F = b**2 / np.diag(inverse) / error
    worst = int(np.argmin(F))
    return worst, float(f_distribution.sf(F[worst], 1, freedom))


def partial_least_squares(X: Inputs, y: Outputs, seed: int = 0) -> Solution:
    """Regression on a few directions of covariance with y, as many as cross validation chooses.

    Components are added while the error falls, 20 at most.

    Reference: Wold, Soft modeling by latent variables, 1975.
    """
    PLSRegression = _sklearn("cross_decomposition").PLSRegression
    order = np.random.default_rng(seed).permutation(len(y))
    folds = np.array_split(order, FOLDS)
    best, least = 1, np.inf
    for components in range(1, min(20, X.shape[1]) + 1):
        error = 0.0
        for fold in folds:
            train = np.setdiff1d(order, fold)
            fit = PLSRegression(components).fit(X[train], y[train])
            error += float(((y[fold] - fit.predict(X[fold]).ravel()) ** 2).sum())
        if error >= 0.999 * least:
            break
        best, least = components, error
    return Solution(PLSRegression(best).fit(X, y).coef_.ravel())  # one output: a step a component


def lasso(X: Inputs, y: Outputs, seed: int = 0) -> Solution:
    """Least squares with a penalty on |b|_1 of columns of equal length, chosen by cross validation.

    Reference: Tibshirani, Regression shrinkage and selection via the lasso, 1996.
    """
    LassoCV = _sklearn("linear_model").LassoCV
    scale = np.sqrt((X**2).mean(axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    size = max(float(np.sqrt((y**2).mean())), 1e-300)
    order = np.random.default_rng(seed).permutation(len(y))
    fit = LassoCV(cv=FOLDS, fit_intercept=False, precompute=True, max_iter=MOST_ITERATIONS)
    fit.fit((X / scale)[order], y[order] / size)
    steps = int(fit.n_iter_)
    return Solution(fit.coef_ * size / scale, steps < MOST_ITERATIONS, steps)


FACTOR_ANALYSIS = NoisyInputConfig(starts=(0.5,), reliability="search", a0=None)
"""the model without priors: eqs. (1) and (4), of its start, for nothing moves it"""


def behind_noise(
    what: Literal["b_noise", "b_true"], config: NoisyInputConfig | None = None
) -> Method:
    """b_noise, eq. (3), to predict from noisy inputs; or b_true, from inputs without noise."""

    def method(X: Inputs, y: Outputs, seed: int = 0) -> Solution:
        moments = Moments.of(X, y)
        fit = fit_noisy_inputs(moments, config, warn=False)
        common = 0.0
        if what == "b_true" and config is None:  # r is anywhere from R^2 to 1, as likely
            middle = middle_reliability(moments, np.where(fit.active, fit.b_noise, 0.0))
            common = 2.0 * (1.0 - middle) / math.sqrt(12.0) / middle
        return Solution(getattr(fit, what), fit.converged, len(fit.bounds), common)

    return method


METHODS: Mapping[str, Method] = {
    "OLS": least_squares,
    "ridge": ridge,
    "stepwise": stepwise,
    "PLS": partial_least_squares,
    "LASSO": lasso,
    "JFA b_true": behind_noise("b_true", FACTOR_ANALYSIS),
    "VB b_noise": behind_noise("b_noise"),
    "VB b_true": behind_noise("b_true"),
}
"""by the names that tables have"""


def _sklearn(module: str):
    from importlib import import_module

    try:
        return import_module(f"sklearn.{module}")
    except ImportError:
        raise McPilcoError(
            "PLS and LASSO need scikit-learn, which is not installed; pip install 'mcpilco[sysid]'."
        ) from None
