"""Gaussian process regression: zero mean, all E outputs in one batch, exact.

    y_e = h_e(x) + noise_e,    h_e ~ GP(0, k_e),    noise_e ~ N(0, s_e^2)

Reference: thesis section 5.3.1; Rasmussen & Williams 2006, chapters 2 and 5 (below: R&W).
"""

from __future__ import annotations

import copy
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import log, pi
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import minimize
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from mcpilco.kernels.base import Kernel, Positive, mean_square
from mcpilco.typing import InputError, NotPositiveDefiniteError

logger = logging.getLogger(__name__)

JITTERS = (0.0, 1e-10, 1e-8, 1e-6, 1e-4)
"""Added to the diagonal, in parts of its mean, until the factorisation succeeds [-]."""

_LOG_RANGE = log(1e4)
"""A fitted hyperparameter stays within this log distance of its data-dependent start."""

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

    @property
    def smallest_variance(self) -> Float[Tensor, " E"]:
        """What rounding cannot push a variance below, in the squared unit of each output."""
        return _SMALLEST_VARIANCE * self.noise_std.square()


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
        return _add_to_diagonal(self.kernel(X, X), self.noise_std.square())

    def nlml(self, X: Float[Tensor, "N D"], Y: Float[Tensor, "N E"]) -> Float[Tensor, " E"]:
        """Negative log marginal likelihood of each output, differentiable in the hyperparameters.

        Raises:
            NotPositiveDefiniteError: K + s^2 I has no Cholesky factor.

        Reference: R&W Alg. 2.1 and eq. (5.9).
        """
        return _NegativeLogEvidence.apply(self.kernel(X, X), self.noise_std.square(), Y, self.names)

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
    ) -> GP:
        """This GP, with the hyperparameters of the highest marginal likelihood found.

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

        Raises:
            InputError: the data do not fit the GP, or are not finite.
            NotPositiveDefiniteError: not even the first covariance matrix has a Cholesky factor.
        """
        if optimiser not in _OPTIMISERS:
            raise InputError(f"optimiser must be one of {sorted(_OPTIMISERS)}, got {optimiser!r}.")
        minimise = _OPTIMISERS[optimiser]
        X, Y = self.check(X, Y)
        present = self._get_logs()
        self._start_from(X, Y)
        centre = self._get_logs()
        bounds = centre - _LOG_RANGE, centre + _LOG_RANGE
        first = present if warm else centre
        rng = np.random.default_rng(seed)
        perturbed = [first + rng.standard_normal(first.shape) for _ in range(restarts)]

        evidence = _Evidence(self, X, Y)
        runs = [
            minimise(evidence, np.clip(start, *bounds), bounds, max_iterations, tolerance)
            for start in (first, *perturbed)
        ]
        self._set_logs(evidence.best_logs)
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

    def _get_logs(self) -> Float[np.ndarray, "E H"]:
        """The logarithms of all hyperparameters, a row for each output."""
        logs = [parameter.detach().reshape(self.outputs, -1) for parameter in self.parameters()]
        return torch.cat(logs, 1).numpy()

    @torch.no_grad()
    def _set_logs(self, logs: Float[np.ndarray, "E H"]) -> None:
        parameters = list(self.parameters())
        widths = [parameter.numel() // self.outputs for parameter in parameters]
        for parameter, part in zip(parameters, torch.as_tensor(logs).split(widths, 1), strict=True):
            parameter.copy_(part.view_as(parameter))


def cholesky(K: Float[Tensor, "E N N"], names: Sequence[str]) -> Float[Tensor, "E N N"]:
    """The lower Cholesky factors; an output that has none gets the least of `JITTERS` that helps.

    Raises:
        NotPositiveDefiniteError: the largest jitter did not help; the message names the outputs.
    """
    L, info = torch.linalg.cholesky_ex(K)
    if not info.any():
        return L
    scale = K.diagonal(dim1=-2, dim2=-1).mean(-1)
    added = torch.zeros_like(scale)
    for jitter in JITTERS[1:]:
        added = torch.where(info > 0, jitter * scale, added)
        L, info = torch.linalg.cholesky_ex(_add_to_diagonal(K, added))
        if not info.any():
            logger.debug("Added %s to the diagonals of %s.", added.tolist(), names)
            return L
    failures = [
        f"{names[e]} ({_condition_number(K[e])})" for e in info.nonzero().flatten().tolist()
    ]
    raise NotPositiveDefiniteError(
        f"The covariance matrix of {', '.join(failures)} has no Cholesky factor, with jitters "
        f"{JITTERS} of its mean diagonal; raise noise_floor, or drop repeated or extreme samples."
    )


def _add_to_diagonal(
    K: Float[Tensor, "E N N"], values: Float[Tensor, " E"]
) -> Float[Tensor, "E N N"]:
    K = K.clone()
    K.diagonal(dim1=-2, dim2=-1).add_(values[:, None])
    return K


def _condition_number(K: Float[Tensor, "N N"]) -> str:
    if not bool(K.isfinite().all()):
        return "not finite"
    eigenvalues = torch.linalg.eigvalsh(K)
    magnitudes = eigenvalues.abs()
    condition = float(magnitudes.max() / magnitudes.min())
    return (
        f"condition number about {condition:.0e}, smallest eigenvalue {float(eigenvalues[0]):.1e}"
    )


class _NegativeLogEvidence(torch.autograd.Function):
    """-log N(y; 0, K + s^2 I); the gradient is closed, not back through the Cholesky factor."""

    @staticmethod
    def forward(ctx, K, noise_variance, Y, names):
        # 1/2 y^T (K + s^2 I)^-1 y + sum_i log L_ii + N/2 log 2 pi   (R&W Alg. 2.1)
        L = cholesky(_add_to_diagonal(K, noise_variance), names)
        y = Y.mT[..., None]
        alpha = torch.cholesky_solve(y, L)
        ctx.save_for_backward(L, alpha)
        log_det = L.diagonal(dim1=-2, dim2=-1).log().sum(-1)
        return 0.5 * (y * alpha).sum((-2, -1)) + log_det + 0.5 * len(Y) * log(2 * pi)

    @staticmethod
    @once_differentiable
    def backward(ctx, gradient):
        # G = d nlml / dK = 1/2 ((K + s^2 I)^-1 - alpha alpha^T)   (R&W eq. 5.9)
        L, alpha = ctx.saved_tensors
        G = torch.cholesky_inverse(L).mT.baddbmm(alpha, alpha.mT, alpha=-1.0)
        G *= 0.5 * gradient[:, None, None]
        return G, G.diagonal(dim1=-2, dim2=-1).sum(-1), None, None


_FORBIDDEN = 1e20
"""Stands for the nlml where a covariance matrix has no factor: a line search turns back from it."""


class _Evidence:
    """The marginal likelihood as an optimiser sees it; keeps the best point of each output."""

    def __init__(self, gp: GP, X: Tensor, Y: Tensor) -> None:
        self._gp, self._X, self._Y = gp, X, Y
        self._parameters = list(gp.parameters())
        self.evaluations = 0
        self.best_logs = gp._get_logs()
        self.best_nlml = np.full(gp.outputs, np.inf)

    def __call__(self, logs: Float[np.ndarray, "E H"]) -> tuple[float, Float[np.ndarray, "E H"]]:
        """The nlml, summed over the outputs, and its gradient."""
        self.evaluations += 1
        gp = self._gp
        gp._set_logs(logs)
        try:
            nlml = gp.nlml(self._X, self._Y)
        except NotPositiveDefiniteError:
            if not np.isfinite(self.best_nlml).all():
                raise
            return _FORBIDDEN, np.zeros_like(logs)
        gradients = torch.autograd.grad(nlml.sum(), self._parameters)
        values = nlml.detach().numpy()
        better = values < self.best_nlml
        self.best_nlml = np.where(better, values, self.best_nlml)
        self.best_logs = np.where(better[:, None], logs, self.best_logs)
        gradient = torch.cat([g.reshape(gp.outputs, -1) for g in gradients], 1).numpy()
        return float(values.sum()), gradient


def _lbfgs(evidence, start, bounds, max_iterations, tolerance) -> tuple[int, bool]:
    """Minimise by L-BFGS-B; return the iterations and whether they sufficed."""

    def flat(logs: np.ndarray) -> tuple[float, np.ndarray]:
        value, gradient = evidence(logs.reshape(start.shape))
        return value, gradient.ravel()

    result = minimize(
        flat,
        start.ravel(),
        jac=True,
        method="L-BFGS-B",
        bounds=np.stack([bound.ravel() for bound in bounds], 1),
        # several problems in one: remembering 40 steps instead of 10 halves the iterations
        options={"maxiter": max_iterations, "ftol": tolerance, "gtol": 1e-3, "maxcor": 40},
    )
    return result.nit, bool(result.success)


def _adam(evidence, start, bounds, max_iterations, tolerance) -> tuple[int, bool]:
    """Minimise by Adam on the logarithms; return the iterations and whether they sufficed."""
    logs = torch.tensor(start, requires_grad=True)
    adam = torch.optim.Adam([logs], lr=0.01)
    low, high = map(torch.as_tensor, bounds)
    values: list[float] = []
    for iteration in range(max_iterations):
        value, gradient = evidence(logs.detach().numpy().copy())
        values.append(value)
        # single steps may go up, so the gain of the last hundred counts
        if iteration >= 100 and values[-101] - value < tolerance * max(abs(value), 1.0):
            return iteration, True
        logs.grad = torch.as_tensor(gradient)
        adam.step()
        logs.data.clamp_(low, high)
    return max_iterations, False


_OPTIMISERS = {"lbfgs": _lbfgs, "adam": _adam}
