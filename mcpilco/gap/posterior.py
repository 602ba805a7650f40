"""The joint errors of a fit's numbers: their covariance, and intervals and distributions of it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy import stats

from mcpilco.gap.data import Windows
from mcpilco.gap.disturbance import Disturbance
from mcpilco.gap.fit import Fit
from mcpilco.gap.plant_model import Theta
from mcpilco.gap.sensitivities import motion_midway
from mcpilco.plant import Member, name_of

CONFIDENCE = 0.95
"""of intervals"""


@dataclass(frozen=True)
class Posterior:
    """The joint errors of a fit's numbers theta."""

    fit: Fit
    windows: Windows
    """to which it was fitted"""
    considered: Float[np.ndarray, "W n k"]
    """what k forces that no model has do to the measurements, each at one std [noise std]"""

    @cached_property
    def covariance(self) -> Float[np.ndarray, "p p"]:
        """Of the errors: the jackknife, and what forces do that no model has.

        Of few windows, some with far more influence than others, White's sandwich is too narrow.
        What is alike in all windows shows in none that is left out, and is `considered` by its std.

        Reference: MacKinnon & White, Some heteroskedasticity-consistent covariance matrix
            estimators, Journal of Econometrics 29 (1985), HC3, with windows as clusters; Tapley,
            Schutz & Born, Statistical Orbit Determination (2004), chapter 6, on what is considered.
        """
        lin, prior = self.fit.linearised(self.windows), np.diag(self.fit.model.precision)
        P = lin.cleaned(lin.Jp)
        by_window = np.einsum("wni,wnj->wij", P, P)
        H = by_window.sum(axis=0) + prior
        others = np.linalg.pinv(H - by_window, hermitian=True)
        moved = np.einsum("wij,wnj,wn->wi", others, P, lin.r)
        overlap, independent, inverse = self.windows.overlap, self._independent, np.linalg.pinv(H)
        spread = overlap * moved.T @ moved * max(independent - 1.0, 1.0) / independent
        response = inverse @ np.einsum("wni,wnk->ik", P, self.considered)
        return spread + inverse @ prior @ inverse + response @ response.T

    @property
    def _independent(self) -> float:
        """Windows, not samples, count as independent."""
        return len(self.windows) / self.windows.overlap

    def intervals(self) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " p"]]:
        """Ends of the 95 % intervals of theta."""
        best, std = self.fit, np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        far = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, max(self._independent - 1.0, 1.0))) * std
        low, high = np.clip(np.stack([best.theta - far, best.theta + far]), *best.model.bounds)
        return low, high

    def confidence(self, some: list[int]) -> float:
        """At which some numbers of theta are not all 0: Hotelling's T^2."""
        at, spread = self.fit.theta[some], self.covariance[np.ix_(some, some)]
        others = max(self._independent - len(some), 1.0)
        far = float(at @ np.linalg.pinv(spread, hermitian=True) @ at) / len(some)
        return float(stats.f.cdf(far * others / (others + len(some) - 1.0), len(some), others))

    def member(self, probability: float, theta: Theta) -> Member:
        """The distribution around theta of the numbers without learned forces, in their units."""
        fit, model = self.fit, self.fit.model
        names, nuisances = list(model.priors), model.nuisances
        parameters, values = model.decode(theta[None, : len(fit.theta)])
        columns = [list(model.plant.values).index(name) for name in names]
        expected, units = list(parameters[0, columns]), list(model.plant.nominal[columns])
        for instance, found in zip(model.added, values, strict=True):
            # what only smooths a formula has no name here
            symbols = instance.effect.symbols
            names += [name_of(instance, s) if s.reported else "" for s in symbols]
            expected += list(found[0])
        units += [1.0] * (len(names) - nuisances)
        numbers = len(names)
        scale = np.where(model.logarithmic[:numbers], expected, units)
        spread = self.covariance[:numbers, :numbers] * scale * scale[:, None]
        std = np.sqrt(np.maximum(np.diag(spread), 0.0))
        told = [n for n, name in enumerate(names) if name]
        wide = [n for n in told if std[n] > 0.0]
        correlation = (spread[wide] / std[wide, None])[:, wide] / std[wide]
        return Member(
            float(probability),
            {names[n]: float(expected[n]) for n in told},
            {names[n]: float(std[n]) for n in wide},
            tuple(map(tuple, correlation.round(4).tolist())),
        )


def lasting(
    disturbance: Disturbance, fit: Fit, windows: Windows, std: Float[np.ndarray, " J"]
) -> Float[np.ndarray, "W n k"]:
    """The response to forces that are alike in all windows, weighed as these are.

    In each joint one that is constant, and some in proportion to position, speed and its sign.
    `std` is that of each over all windows [usual forces], `disturbance` the response to forces
    along the motions of the fit.
    """
    at, columns = motion_midway(fit.model, fit.theta, windows), []
    for j, size in enumerate(std):
        q, v = at[:, :, 2 * j], at[:, :, 2 * j + 1]
        forces = np.stack([np.ones_like(q), q - q.mean(), v, np.sign(v)])
        rms = np.sqrt(np.square(forces).mean(axis=(1, 2), keepdims=True))
        columns.append(disturbance.response(j, size * forces / np.maximum(rms, 1e-12), windows))
    return np.concatenate(columns, axis=2)
