"""The marginal likelihood: its factorisation, its closed gradient, and its optimisers.

Reference: Rasmussen & Williams 2006, chapters 2 and 5 (below: R&W).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from math import log, pi
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import minimize
from torch import Tensor
from torch.autograd.function import once_differentiable

from mcpilco.typing import NotPositiveDefiniteError

if TYPE_CHECKING:
    from mcpilco.gp.gp import GP

logger = logging.getLogger(__name__)

JITTERS = (0.0, 1e-10, 1e-8, 1e-6, 1e-4)
"""Added to the diagonal, in parts of its mean, until the factorisation succeeds [-]."""


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
        L, info = torch.linalg.cholesky_ex(add_to_diagonal(K, added))
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


def add_to_diagonal(
    K: Float[Tensor, "E N N"], values: Float[Tensor, " E"]
) -> Float[Tensor, "E N N"]:
    """K with one value for each output added to its diagonal."""
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


class NegativeLogEvidence(torch.autograd.Function):
    """-log N(y; 0, K + s^2 I); the gradient is closed, not back through the Cholesky factor."""

    @staticmethod
    def forward(ctx, K, noise_variance, Y, names):
        # 1/2 y^T (K + s^2 I)^-1 y + sum_i log L_ii + N/2 log 2 pi   (R&W Alg. 2.1)
        L = cholesky(add_to_diagonal(K, noise_variance), names)
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


class Evidence:
    """The marginal likelihood as an optimiser sees it; keeps the best point of each output.

    With a prior of the logarithms, mean and standard deviation, it is the posterior density.
    """

    def __init__(
        self,
        gp: GP,
        X: Tensor,
        Y: Tensor,
        prior: tuple[Float[np.ndarray, "E H"], float] | None = None,
    ) -> None:
        self._gp, self._X, self._Y = gp, X, Y
        self._prior = prior
        self._parameters = list(gp.parameters())
        self.evaluations = self.iterations = 0
        self.best_logs = gp.get_logs()
        self.best_nlml = np.full(gp.outputs, np.inf)

    def count(self, most: int) -> None:
        """Says that an iteration is done, of at most so many of this start."""
        self.iterations += 1
        if self._gp.on_iteration is not None:
            self._gp.on_iteration(self.iterations, max(most, self.iterations))

    def __call__(self, logs: Float[np.ndarray, "E H"]) -> tuple[float, Float[np.ndarray, "E H"]]:
        """The nlml less the log prior, summed over the outputs, and its gradient."""
        self.evaluations += 1
        gp = self._gp
        gp.set_logs(logs)
        try:
            nlml = gp.nlml(self._X, self._Y)
        except NotPositiveDefiniteError:
            if not np.isfinite(self.best_nlml).all():
                raise
            return _FORBIDDEN, np.zeros_like(logs)
        gradients = torch.autograd.grad(nlml.sum(), self._parameters)
        values = nlml.detach().numpy()
        gradient = torch.cat([g.reshape(gp.outputs, -1) for g in gradients], 1).numpy()
        if self._prior is not None:
            mean, std = self._prior
            distance = (logs - mean) / std
            values = values + 0.5 * np.square(distance).sum(1)
            gradient = gradient + distance / std
        better = values < self.best_nlml
        self.best_nlml = np.where(better, values, self.best_nlml)
        self.best_logs = np.where(better[:, None], logs, self.best_logs)
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
        callback=lambda _: evidence.count(max_iterations),
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
        evidence.count(max_iterations)
    return max_iterations, False


OPTIMISERS = {"lbfgs": _lbfgs, "adam": _adam}
