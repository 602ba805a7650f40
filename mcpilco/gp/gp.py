"""Gaussian process regression: zero mean, all E outputs in one batch, exact.

    y_e = h_e(x) + noise_e,    h_e ~ GP(0, k_e),    noise_e ~ N(0, s_e^2)

Reference: thesis section 5.3.1; Rasmussen & Williams 2006, chapters 2 and 5 (below: R&W).
"""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import log
from typing import Literal

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from mcpilco.gp.evidence import OPTIMISERS, Evidence, NegativeLogEvidence, add_to_diagonal, cholesky
from mcpilco.kernels import Kernel, Positive, mean_square
from mcpilco.typing import InputError

logger = logging.getLogger(__name__)

_LOG_RANGE = log(1e4)
"""A fitted hyperparameter stays within this log distance of its data-dependent start."""

RECENT = 100
"""Samples, at most, that a posterior learns of besides its own."""

_ROUNDING = 1e-10
"""The least noise variance of a further sample, in parts of its prior variance [-]."""

_SMALLEST_VARIANCE = 1e-9
"""The least posterior variance, in parts of the noise variance [-]."""


@dataclass(frozen=True)
class FitReport:
    """How a fit went."""

    nlml: tuple[float, ...]
    """negative log marginal likelihood of each output [-]"""
    iterations: int
    """optimiser steps, all starts together"""
    evaluations: int
    """evaluations of the marginal likelihood and its gradient"""
    converged: bool
    """the optimiser stopped by its own tolerance, in every start"""


@dataclass(frozen=True)
class Samples:
    """Samples that come after those a posterior was conditioned on, for each of a batch."""

    X: Float[Tensor, "*b T D"]
    """regressors"""
    Y: Float[Tensor, "*b T E"]
    """outputs, with their noise"""
    told: Bool[Tensor, "*b T"]
    """which of them are known"""

    def then(
        self, X: Float[Tensor, "*b D"], Y: Float[Tensor, "*b E"], begun: Bool[Tensor, "*b"]
    ) -> Samples:
        """These and one more, the latest `RECENT` of them.

        Those of the batch that have `begun` anew know nothing any more, nor this one.
        """
        fresh = ~begun[..., None]
        return Samples(
            torch.cat([self.X, X[..., None, :]], -2)[..., -RECENT:, :],
            torch.cat([self.Y, Y[..., None, :]], -2)[..., -RECENT:, :],
            torch.cat([self.told & fresh, fresh], -1)[..., -RECENT:],
        )


@dataclass(frozen=True, eq=False)
class Posterior:
    """E Gaussian processes, conditioned on N samples, with their factorisation cached.

    Hyperparameters are constants here: gradients flow to the queries only.
    """

    kernel: Kernel
    """prior covariance, a frozen copy"""
    noise_std: Float[Tensor, " E"]
    """noise standard deviation, in the unit of each output"""
    X: Float[Tensor, "N D"]
    """training regressors"""
    L: Float[Tensor, "E N N"]
    """K + s^2 I = L L^T"""
    L_inv: Float[Tensor, "E N N"]
    """L^-1"""
    alpha: Float[Tensor, "E N"]
    """(K + s^2 I)^-1 y"""

    def mean_and_variance(
        self, Xq: Float[Tensor, "*b M D"]
    ) -> tuple[Float[Tensor, "*b M E"], Float[Tensor, "*b M E"]]:
        """Mean and variance of the latent function, without the noise, at the queries.

        Reference: thesis eqs. (5.3) and (5.4); R&W eqs. (2.25) and (2.26).
        """
        Xq = Xq[..., None, :, :]
        Kq = self.kernel(self.X, Xq)  # *b E N M
        mean = (self.alpha[:, None, :] @ Kq).squeeze(-2)
        # k** - k*^T (K + s^2 I)^-1 k* = k** - |L^-1 k*|^2
        variance = self.kernel.diag(Xq) - (self.L_inv @ Kq).square().sum(-2)
        return mean.mT, torch.maximum(variance, self.smallest_variance[:, None]).mT

    def mean(self, Xq: Float[Tensor, "*b M D"]) -> Float[Tensor, "*b M E"]:
        """Mean of the latent function at the queries."""
        return (self.alpha[:, None, :] @ self.kernel(self.X, Xq[..., None, :, :])).squeeze(-2).mT

    def after(self, steps: Samples) -> Further:
        """The posterior given further samples as well.

        A further sample has as much more noise as rounding makes of a large prior variance. Where
        their covariance has no Cholesky factor all the same, they are left out.

        Reference: R&W eq. (2.25), the posterior in the place of the prior.
        """
        told, X = steps.told[..., None, :], steps.X[..., None, :, :]  # *b 1 T, *b 1 T D
        K = self.kernel(self.X, X)  # *b E N T
        V = self.L_inv @ K
        left = steps.Y.mT - (self.alpha[:, None, :] @ K).squeeze(-2)  # *b E T
        both = told[..., :, None] & told[..., None, :]
        S = (self.kernel(X, X) - V.mT @ V) * both
        noise = self.noise_std.square()[:, None] + _ROUNDING * self.kernel.diag(X)
        S = S + torch.diag_embed(torch.where(told, noise, 1.0))
        L, info = torch.linalg.cholesky_ex(S)
        weights = torch.cholesky_solve((left * told)[..., None], L)
        return Further(self, X, V, told[..., None], weights, (info == 0)[..., None, None])

    @property
    def smallest_variance(self) -> Float[Tensor, " E"]:
        """The smallest variance that rounding leaves, in the squared unit of each output."""
        return _SMALLEST_VARIANCE * self.noise_std.square()


@dataclass(frozen=True, eq=False)
class Further:
    """A posterior that has learned of further samples, for each of a batch."""

    posterior: Posterior
    X: Float[Tensor, "*b 1 T D"]
    """their regressors"""
    V: Float[Tensor, "*b E N T"]
    """L^-1 times their covariance with the posterior's samples"""
    told: Bool[Tensor, "*b 1 T 1"]
    """which of them are known"""
    weights: Float[Tensor, "*b E T 1"]
    """of their covariances with a query"""
    solved: Bool[Tensor, "*b E 1 1"]
    """whether the weights could be found"""

    def mean(self, Xq: Float[Tensor, "*b M D"]) -> Float[Tensor, "*b M E"]:
        """Mean of the latent function at the queries."""
        known, Xq = self.posterior, Xq[..., None, :, :]
        Kq = known.kernel(known.X, Xq)  # *b E N M
        c = (known.kernel(self.X, Xq) - self.V.mT @ (known.L_inv @ Kq)) * self.told  # *b E T M
        more = self.weights.mT @ c
        more = torch.where(self.solved & more.isfinite(), more, 0.0)
        return (known.alpha[:, None, :] @ Kq + more).squeeze(-2).mT


class GP(nn.Module):
    """A zero-mean Gaussian process prior and noise level for each of E outputs.

    Args:
        kernel: with batch `(E,)`, for example `RBF(D, (E,)) + MPK(D, 2, (E,))`.
        noise_std: where fits start, in the unit of the outputs; broadcasts to (E,). By default a
            tenth of the targets' root mean square, above the floor.
        noise_floor: the noise never falls below this standard deviation; broadcasts to (E,).
        names: what the outputs are called in errors and reports.
    """

    noise_excess = Positive()
    """noise_std - noise_floor"""
    noise_floor: Tensor
    on_iteration: Callable[[int, int], object] | None = None
    """called after each iteration of a fit, with how many are done and how many there may be"""

    def __init__(
        self,
        kernel: Kernel,
        noise_std: float | Sequence[float] | Tensor | None = None,
        noise_floor: float | Sequence[float] | Tensor = 0.01,
        names: Sequence[str] = (),
    ) -> None:
        super().__init__()
        if len(kernel.batch) != 1:
            raise InputError(
                f"A GP needs a kernel with one batch axis, the outputs, got batch {kernel.batch}; "
                "for example RBF(width, batch=(1,))."
            )
        (self.outputs,) = kernel.batch
        self.names = tuple(names) or tuple(f"output_{e}" for e in range(self.outputs))
        if len(self.names) != self.outputs:
            raise InputError(
                f"GP.names must name each of the {self.outputs} outputs, got {self.names}."
            )
        self.kernel = kernel
        self.register_buffer("noise_floor", kernel.spread(noise_floor).clone())
        if bool((self.noise_floor < 0).any()):
            raise InputError(f"GP.noise_floor must not be negative, got {noise_floor}.")
        start = None if noise_std is None else kernel.spread(noise_std) - self.noise_floor
        if start is not None and bool((start <= 0).any()):
            raise InputError(
                f"GP.noise_std must start above the noise_floor {noise_floor}, got {noise_std}; "
                "raise the one or lower the other."
            )
        self.noise_excess = kernel.spread(0.1) if start is None else start
        self._excess_start = start
        self.report: FitReport | None = None

    @property
    def noise_std(self) -> Float[Tensor, " E"]:
        """Standard deviation of the noise, in the unit of each output."""
        return self.noise_floor + self.noise_excess

    def covariance(self, X: Float[Tensor, "N D"]) -> Float[Tensor, "E N N"]:
        """K + s^2 I, the prior covariance of noisy samples."""
        return add_to_diagonal(self.kernel(X, X), self.noise_std.square())

    def nlml(self, X: Float[Tensor, "N D"], Y: Float[Tensor, "N E"]) -> Float[Tensor, " E"]:
        """Negative log marginal likelihood of each output, differentiable in the hyperparameters.

        Raises:
            NotPositiveDefiniteError: K + s^2 I has no Cholesky factor.

        Reference: R&W Alg. 2.1 and eq. (5.9).
        """
        return self._nlml(self.kernel(X, X), Y)

    def _nlml(self, K: Float[Tensor, "E N N"], Y: Float[Tensor, "N E"]) -> Float[Tensor, " E"]:
        return NegativeLogEvidence.apply(K, self.noise_std.square(), Y, self.names)

    def odd_nlml(
        self, X: Float[Tensor, "N D"], images: Float[Tensor, "N D"], Y: Float[Tensor, "N E"]
    ) -> Float[Tensor, " E"]:
        """Negative log marginal likelihood of functions whose sign turns at the samples' images.

        For any h of the prior, g(x) = (h(x) - h(image of x)) / sqrt(2) is such a function.

        Raises:
            NotPositiveDefiniteError: the covariance of the samples has no Cholesky factor.
        """
        both = torch.cat([X, images])
        K = self.kernel(both, both).unflatten(-1, (2, len(X))).unflatten(-3, (2, len(X)))
        same, across = K[:, 0, :, 0] + K[:, 1, :, 1], K[:, 0, :, 1] + K[:, 1, :, 0]
        return self._nlml(0.5 * (same - across), Y)

    def fit(
        self,
        X: Float[Tensor, "N D"],
        Y: Float[Tensor, "N E"],
        *,
        optimiser: Literal["lbfgs", "adam"] = "lbfgs",
        warm: bool = False,
        restarts: int = 0,
        max_iterations: int = 200,
        tolerance: float = 1e-5,
        seed: int = 0,
        prior_std: float | None = None,
    ) -> GP:
        """This GP, with the hyperparameters of the highest marginal likelihood found.

        With `prior_std` their logarithms have a normal prior, whose mean is the data-dependent
        start, and the posterior density is the highest found.

        `report` tells how it went.

        Args:
            X: regressors.
            Y: targets.
            optimiser: L-BFGS, or Adam at learning rate 0.01, both on the logarithms.
            warm: start from the present hyperparameters instead of the data-dependent ones.
            restarts: how many more starts, each a log-normal perturbation of the first; the best of
                all counts, output by output.
            max_iterations: of each start; Adam needs 1500 or so.
            tolerance: stop once a step improves the summed nlml by less than this part of it [-].
            seed: of the perturbations.
            prior_std: standard deviation of the logarithms' prior [-]; None: it is flat.

        Raises:
            InputError: the data do not fit the GP, or are not finite.
            NotPositiveDefiniteError: not even the first covariance matrix has a Cholesky factor.
        """
        if optimiser not in OPTIMISERS:
            raise InputError(f"optimiser must be one of {sorted(OPTIMISERS)}, got {optimiser!r}.")
        minimise = OPTIMISERS[optimiser]
        X, Y = self.check(X, Y)
        present = self.get_logs()
        self._start_from(X, Y)
        centre = self.get_logs()
        bounds = centre - _LOG_RANGE, centre + _LOG_RANGE
        first = present if warm else centre
        rng = np.random.default_rng(seed)
        perturbed = [first + rng.standard_normal(first.shape) for _ in range(restarts)]

        evidence = Evidence(self, X, Y, prior=None if prior_std is None else (centre, prior_std))
        runs = [
            minimise(evidence, np.clip(start, *bounds), bounds, max_iterations, tolerance)
            for start in (first, *perturbed)
        ]
        self.set_logs(evidence.best_logs)
        self.report = FitReport(
            nlml=tuple(evidence.best_nlml.tolist()),
            iterations=sum(iterations for iterations, _ in runs),
            evaluations=evidence.evaluations,
            converged=all(converged for _, converged in runs),
        )
        return self

    @torch.no_grad()
    def condition(self, X: Float[Tensor, "N D"], Y: Float[Tensor, "N E"]) -> Posterior:
        """The posterior given these samples, with the present hyperparameters.

        Raises:
            InputError: the data do not fit the GP, or are not finite.
            NotPositiveDefiniteError: K + s^2 I has no Cholesky factor.

        Reference: R&W Alg. 2.1.
        """
        X, Y = self.check(X, Y)
        L = cholesky(self.covariance(X), self.names)
        return Posterior(
            kernel=copy.deepcopy(self.kernel).requires_grad_(False),
            noise_std=self.noise_std,
            X=X,
            L=L,
            L_inv=torch.linalg.solve_triangular(L, torch.eye(len(X), dtype=L.dtype), upper=False),
            alpha=torch.cholesky_solve(Y.mT[..., None], L).squeeze(-1),
        )

    def to_arrays(self) -> dict[str, np.ndarray]:
        """Everything learned, as named arrays: what `load_arrays` reads."""
        return {name: value.numpy().copy() for name, value in self.state_dict().items()}

    def load_arrays(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Take the hyperparameters of `to_arrays`.

        Raises:
            InputError: a name is missing or unknown, a shape differs, or a value is not finite.
        """
        own = self.state_dict()
        if set(arrays) != set(own):
            raise InputError(
                f"Saved GP does not fit this kernel: missing {sorted(set(own) - set(arrays))}, "
                f"unknown {sorted(set(arrays) - set(own))}; build the GP as it was saved."
            )
        for name, value in own.items():
            array = np.asarray(arrays[name])
            if array.shape != tuple(value.shape) or not np.isfinite(array).all():
                raise InputError(
                    f"Saved GP: {name} must be finite with shape {tuple(value.shape)}, got shape "
                    f"{array.shape}; build the GP with the width and outputs it was saved with."
                )
        self.load_state_dict({name: torch.as_tensor(arrays[name]) for name in own})

    def check(self, X: Tensor, Y: Tensor) -> tuple[Tensor, Tensor]:
        """The data in float64, or an error that says what is wrong with them."""
        X, Y = torch.as_tensor(X, dtype=torch.float64), torch.as_tensor(Y, dtype=torch.float64)
        samples = len(X) if X.ndim else 0
        expected = (samples, self.kernel.width), (samples, self.outputs)
        if (X.shape, Y.shape) != expected or samples == 0:
            raise InputError(
                f"GP needs regressors (N, {self.kernel.width}) and targets (N, {self.outputs}), "
                f"N >= 1, got shapes {tuple(X.shape)} and {tuple(Y.shape)}."
            )
        for name, data in (("regressors", X), ("targets", Y)):
            if not bool(data.isfinite().all()):
                row = int((~data.isfinite()).any(-1).nonzero()[0])
                raise InputError(
                    f"GP {name} must be finite, row {row} is {data[row].tolist()}; remove it."
                )
        return X, Y

    @torch.no_grad()
    def _start_from(self, X: Tensor, Y: Tensor) -> None:
        self.kernel.start_from(X, Y)
        start = self._excess_start
        self.noise_excess = 0.1 * mean_square(Y).sqrt() if start is None else start

    def get_logs(self) -> Float[np.ndarray, "E H"]:
        """The logarithms of all hyperparameters, a row for each output."""
        logs = [parameter.detach().reshape(self.outputs, -1) for parameter in self.parameters()]
        return torch.cat(logs, 1).numpy()

    @torch.no_grad()
    def set_logs(self, logs: Float[np.ndarray, "E H"]) -> None:
        parameters = list(self.parameters())
        widths = [parameter.numel() // self.outputs for parameter in parameters]
        for parameter, part in zip(parameters, torch.as_tensor(logs).split(widths, 1), strict=True):
            parameter.copy_(part.view_as(parameter))
