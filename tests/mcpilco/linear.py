"""A linear model with a linear policy: everything about its particles is known in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from mcpilco.policies import Dropout

A = torch.tensor([[1.0, 0.1], [-0.3, 0.9]], dtype=torch.float64)
B = torch.tensor([[0.0], [0.2]], dtype=torch.float64)
K = torch.tensor([[-0.8, -0.5]], dtype=torch.float64)


@dataclass(frozen=True)
class LinearDynamics:
    """x' = A x + B u + scale * noise."""

    scale: float = 0.0
    noise_dim: int = 2

    def step(self, states: Tensor, inputs: Tensor, noise: Tensor) -> Tensor:
        return states @ A.T + inputs @ B.T + self.scale * noise


class LinearPolicy(torch.nn.Module):
    """u = K x, with the factors of a dropout's first basis."""

    def __init__(self) -> None:
        super().__init__()
        self.gain = torch.nn.Parameter(K.clone())

    def forward(self, states: Tensor, dropout: Dropout | None = None, step: int = 0) -> Tensor:
        factor = 1.0 if dropout is None else dropout.factors(step, len(states), 1)
        return factor * (states @ self.gain.T)
