"""One step of the policy search, written plainly in eager torch: the engines are timed beside it.

It follows the equations line by line (thesis sections 5.2 to 5.4): one Gaussian process at a time,
with the inverse of its covariance formed once; autograd through particles, dropout and cost; Adam.
It imports nothing of mcpilco. Any file with the same two functions takes its place (`--yardstick`).
"""

from __future__ import annotations

import math

import torch
from torch import Tensor, nn

DT = 0.05
"""time for which a force is held [s]"""
NOISE = 1e-3
"""std of the measured changes of speed"""
MAX_FORCE = 10.0
"""[N]"""
DROPOUT = 0.25


def squared_distance(A: Tensor, B: Tensor) -> Tensor:
    """|a - b|^2 of the rows, as |a|^2 + |b|^2 - 2 a'b."""
    return A.square().sum(-1)[:, None] + B.square().sum(-1) - 2.0 * A @ B.T


class PlainGP:
    """A Gaussian process with an RBF kernel plus a polynomial of degree 2."""

    def __init__(self, X: Tensor, y: Tensor) -> None:
        D = X.shape[1]
        self.X = X
        self.lengthscale = torch.full((D,), 2.0, dtype=X.dtype)
        self.weights = [torch.full((D,), 10.0 ** -(2 + n), dtype=X.dtype) for n in range(2)]
        K = self.kernel(X, X) + NOISE**2 * torch.eye(len(X), dtype=X.dtype)
        self.inverse = torch.linalg.inv(K)
        self.alpha = self.inverse @ y

    def kernel(self, A: Tensor, B: Tensor) -> Tensor:
        """exp(-|(a - b) / l|^2 / 2) + prod_d (w_d + a' W_d b)."""
        distance = squared_distance(A / self.lengthscale, B / self.lengthscale)
        first, second = (weights[0] + (A * weights) @ B.T for weights in self.weights)
        return torch.exp(-0.5 * distance) + first * second

    def prior(self, A: Tensor) -> Tensor:
        """The kernel of each point with itself."""
        first, second = (weights[0] + A.square() @ weights for weights in self.weights)
        return 1.0 + first * second

    def sample(self, A: Tensor) -> Tensor:
        """One draw of the change of speed at each point."""
        k = self.kernel(A, self.X)
        variance = self.prior(A) - ((k @ self.inverse) * k).sum(-1)
        return k @ self.alpha + variance.clamp_min(1e-12).sqrt() * torch.randn_like(variance)


class PlainPolicy(nn.Module):
    """A squashed sum of Gaussians of position, speeds and the pole's direction."""

    def __init__(self, bases: int) -> None:
        super().__init__()
        double = {"dtype": torch.float64}
        self.centres = nn.Parameter(torch.randn(bases, 5, **double))
        self.log_lengthscale = nn.Parameter(torch.zeros(5, **double))
        self.weights = nn.Parameter(MAX_FORCE * (torch.rand(bases, 1, **double) - 0.5))

    def forward(self, z: Tensor) -> Tensor:
        lengthscale = self.log_lengthscale.exp()
        active = torch.exp(-squared_distance(z / lengthscale, self.centres / lengthscale))
        kept = nn.functional.dropout(active, DROPOUT)
        return MAX_FORCE * torch.tanh(kept @ self.weights / MAX_FORCE)


def make(samples: int, bases: int) -> tuple[list[PlainGP], PlainPolicy, torch.Generator]:
    """Models of the two changes of speed, of random data, and a random policy."""
    generator = torch.Generator().manual_seed(0)
    X = torch.randn(samples, 6, generator=generator, dtype=torch.float64)
    Y = 0.003 * torch.randn(samples, 2, generator=generator, dtype=torch.float64)
    return [PlainGP(X, y) for y in Y.T], PlainPolicy(bases), generator


def augmented(x: Tensor) -> Tensor:
    """Position, both speeds, cosine and sine of the angle, of states [p, dp, q, dq]."""
    p, dp, q, dq = x.T
    return torch.stack([p, dp, dq, q.cos(), q.sin()], -1)


def policy_step(
    gps: list[PlainGP],
    policy: PlainPolicy,
    optimiser: torch.optim.Optimizer,
    particles: int,
    steps: int,
) -> float:
    """The expected cost of a rollout, whose gradient is followed once."""
    optimiser.zero_grad()
    x = 0.01 * torch.randn(particles, 4, dtype=torch.float64)
    total = torch.zeros((), dtype=torch.float64)
    for _ in range(steps):
        z = augmented(x)
        change = torch.stack([gp.sample(torch.cat([z, policy(z)], -1)) for gp in gps], -1)
        q, dq = x[:, 0::2], x[:, 1::2]
        x = torch.stack([q + DT * (dq + 0.5 * change), dq + change], -1).flatten(1)
        away = x[:, 0].square() + ((x[:, 2].abs() - math.pi) / 3.0).square()
        total = total + (1.0 - torch.exp(-away)).mean()
    total.backward()
    optimiser.step()
    return total.item()
