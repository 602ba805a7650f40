"""Kernels that act in a part of the space only: a(x) k(x, x') a(x')."""

from __future__ import annotations

from abc import ABC, abstractmethod

import torch
from jaxtyping import Float
from torch import Tensor, nn

from mcpilco.kernels.base import Columns, Kernel, Matrix, Rows, mean_square
from mcpilco.typing import InputError


class Gate(nn.Module, ABC):
    """A scale a(x) in [0, 1] that is 1 where one of the regressors is 0, and falls as it grows.

    Args:
        column: which regressor.
        size: where it falls, in the unit of the regressor.
    """

    def __init__(self, column: int, size: float) -> None:
        super().__init__()
        if not size > 0.0:
            raise InputError(f"{type(self).__name__}.size must be positive, got {size}.")
        self.column, self.size = column, size

    def forward(self, X: Float[Tensor, "*b N D"]) -> Float[Tensor, "*b N"]:
        return self.shape(X[..., self.column] / self.size)

    @staticmethod
    @abstractmethod
    def shape(ratio: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        """The gate, as a function of the regressor in units of `size`."""

    def extra_repr(self) -> str:
        return f"column={self.column}, size={self.size}"


class HardGate(Gate):
    """a = 1 where |x_column| < size, else 0; its gradient is 0 wherever it has one.

    Reference: thesis eq. (4.9).
    """

    @staticmethod
    def shape(ratio: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        return (ratio.abs() < 1.0).to(ratio.dtype)


class SmoothGate(Gate):
    """a = exp(-(x_column / size)^2), for policies that are improved along gradients through it.

    Differs: thesis eq. (4.9) has the hard gate, through which no gradient of the velocity flows.
    """

    @staticmethod
    def shape(ratio: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
        return torch.exp(-ratio.square())


class Rescaled(Kernel):
    """k(x, x') = a(x) k_1(x, x') a(x'): the covariance of a(x) f(x), with f of covariance k_1.

    Args:
        kernel: k_1.
        scale: a, a module without hyperparameters of its own.

    Reference: thesis section 1.3 (vertical rescaling) and section 4.5.2.
    """

    def __init__(self, kernel: Kernel, scale: Gate) -> None:
        super().__init__(kernel.width, kernel.batch)
        self.kernel, self.scale = kernel, scale

    def forward(self, X1: Rows, X2: Columns) -> Matrix:
        return self.scale(X1)[..., :, None] * self.kernel(X1, X2) * self.scale(X2)[..., None, :]

    def diag(self, X: Rows) -> Float[Tensor, "*#b N"]:
        return self.scale(X).square() * self.kernel.diag(X)

    def start_from(self, X: Float[Tensor, "N D"], Y: Float[Tensor, " N *b"]) -> None:
        """k_1 starts from the samples at which it acts; where there are none, from all of them."""
        a = self.scale(X)
        power = a.square().mean()
        seen = a > 0.5
        if not bool(seen.any()):
            self.kernel.start_from(X, Y)
            return
        self.kernel.start_from(X[seen], (mean_square(Y) / power).sqrt().expand_as(Y[seen]))
