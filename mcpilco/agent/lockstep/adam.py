"""Adam for a batch of seeds, each with a learning rate and a history of its own."""

from __future__ import annotations

import torch
from jaxtyping import Bool, Float
from torch import Tensor

FIRST, SECOND, SMALLEST = 0.9, 0.999, 1e-8
"""decay of the averages of gradient and squared gradient, and what is added to the root [-]"""


class AdamBatch:
    """Adam (Kingma & Ba 2015) on one row of numbers a seed; `torch.optim.Adam` has one history."""

    def __init__(self, numbers: Float[Tensor, "S numbers"]) -> None:
        """An optimiser that has seen no gradient yet.

        Args:
            numbers: what is learned; changed in place by each step.
        """
        self.numbers = numbers
        self._mean = torch.zeros_like(numbers)
        self._square = torch.zeros_like(numbers)
        self._count = torch.zeros_like(numbers[:, :1])

    def step(
        self,
        gradient: Float[Tensor, "S numbers"],
        rate: Float[Tensor, " S"],
        usable: Bool[Tensor, " S"],
    ) -> None:
        """Take a step in the seeds whose gradient is usable; the others stay as they are."""
        usable = usable[:, None]
        mean = self._mean.lerp(gradient, 1 - FIRST)
        square = SECOND * self._square + (1 - SECOND) * gradient.square()
        count = self._count + 1
        size = rate[:, None] / (1 - FIRST**count)
        root = square.sqrt() / (1 - SECOND**count).sqrt() + SMALLEST
        self._mean = torch.where(usable, mean, self._mean)
        self._square = torch.where(usable, square, self._square)
        self._count = torch.where(usable, count, self._count)
        self.numbers = torch.where(usable, self.numbers - size * mean / root, self.numbers)

    def keep(self, rows: list[int]) -> None:
        """Forget all other seeds."""
        for name in ("numbers", "_mean", "_square", "_count"):
            setattr(self, name, getattr(self, name)[rows])


def clipped(
    gradient: Float[Tensor, "S numbers"], limit: float | None
) -> tuple[Float[Tensor, "S numbers"], Float[Tensor, " S"]]:
    """Each seed's gradient scaled down to a norm, and its norm before [-].

    As `torch.nn.utils.clip_grad_norm_` does.
    """
    norm = gradient.norm(dim=1)
    if limit is None:
        return gradient, norm
    return gradient * (limit / (norm + 1e-6)).clamp_max(1.0)[:, None], norm
