"""The models of S seeds in one set of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from mcpilco.dynamics import GPDynamics
from mcpilco.search.batched.kernel import KernelBatch, kernel_batch
from mcpilco.search.batched.transfer import Movable


@dataclass(frozen=True)
class ModelBatch(Movable):
    """S posteriors of E outputs, and the law of motion that the seeds share.

    Seeds of fewer than N samples are filled up with zeros in `alpha` and `L_inv`: what stands in
    for their missing samples has no weight in any sum.
    """

    kernel: KernelBatch
    """prior covariances, and the samples"""
    L_inv: Float[Tensor, "S E N N"]
    """K + s^2 I = L L^T, factorised in float64 whatever the precision here"""
    alpha: Float[Tensor, "S E N 1"]
    """(K + s^2 I)^-1 y"""
    floor: Float[Tensor, "S E 1"]
    """smallest variance, in the squared unit of each output"""
    A: Float[Tensor, "X X"]
    """from the state to the next one"""
    B: Float[Tensor, "X E"]
    """from the changes to the next state"""
    predicted: Int[Tensor, " E"]
    """which states the changes belong to"""
    bounds: Float[Tensor, "S 1 E"]
    """largest plausible magnitude of those states, in their unit"""

    @classmethod
    def of(cls, dynamics: Sequence[GPDynamics]) -> ModelBatch:
        """The models of seeds that learn the same task with kernels of one structure."""
        posteriors = [model.posterior for model in dynamics]
        first, N = dynamics[0], max(len(posterior.X) for posterior in posteriors)
        known = torch.stack([torch.arange(N) < len(posterior.X) for posterior in posteriors])
        X = torch.stack([_filled(posterior.X, 0, N) for posterior in posteriors])
        L_inv = [_filled(_filled(posterior.L_inv, 1, N), 2, N) for posterior in posteriors]
        alpha = torch.stack([_filled(posterior.alpha, 1, N) for posterior in posteriors])
        floor = torch.stack([posterior.smallest_variance for posterior in posteriors])
        return cls(
            kernel=kernel_batch([posterior.kernel for posterior in posteriors], X, known),
            L_inv=torch.stack(L_inv),
            alpha=alpha[..., None],
            floor=floor[..., None],
            A=first.A,
            B=first.B,
            predicted=torch.tensor(first.predicted),
            bounds=torch.stack([model.bounds for model in dynamics])[:, None],
        )

    def change(
        self, x: Float[Tensor, "S P D"], noise: Float[Tensor, "S P E"]
    ) -> tuple[Float[Tensor, "S P E"], Float[Tensor, "S P E D"]]:
        """Sampled changes at regressors x, and their derivatives.

        The noise of a step is known when the step is taken, so both come out of the same pass:

            delta = k . alpha + sd eps,    sd^2 = k** - |L^-1 k|^2,    u = L^-T L^-1 k
            d delta / dx = sum_j g_j dk_j/dx + (eps / 2 sd) dk**/dx,    g = alpha - (eps / sd) u

        The variance is a small difference of large numbers: through K^-1 it would suffer from the
        condition number of K, through L^-1 only from its square root.

        Reference: thesis eqs. (5.3) and (5.4).
        """
        eps = noise.mT
        groups = self.kernel.groups(x)
        k = self.kernel.row(groups)
        half = k @ self.L_inv.mT
        prior, prior_slope = self.kernel.prior(x)
        variance = prior - half.square().sum(-1)
        sampled = variance > self.floor
        sd = torch.where(sampled, variance, self.floor).sqrt()
        ratio = torch.where(sampled, eps / sd, 0.0)[..., None]
        delta = (k @ self.alpha).squeeze(-1) + sd * eps
        g = torch.addcmul(self.alpha.mT, ratio, half @ self.L_inv, value=-1)
        slope = self.kernel.slope(x, groups, g) + 0.5 * ratio * prior_slope
        return delta.mT, slope.transpose(1, 2)

    def follow(
        self, states: Float[Tensor, "S P X"], delta: Float[Tensor, "S P E"]
    ) -> tuple[Float[Tensor, "S P X"], Bool[Tensor, "S P"]]:
        """x' = A x + B delta, or x where that is implausible; and where it is."""
        following = states @ self.A.T + delta @ self.B.T
        frozen = ~(following[..., self.predicted].abs() <= self.bounds).all(-1)
        return torch.where(frozen[..., None], states, following), frozen


def _filled(array: Tensor, axis: int, length: int) -> Tensor:
    """The array with zeros behind its end along an axis."""
    shape = list(array.shape)
    shape[axis] = length - shape[axis]
    return torch.cat([array, array.new_zeros(shape)], axis)
