"""Policies: from observed states to bounded inputs; and the dropout of their bases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, cast

import numpy as np
import torch
from jaxtyping import Float, UInt32
from torch import Tensor, nn

from mcpilco.config import PolicyConfig
from mcpilco.dynamics import AngleAugmentation
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from mcpilco.policies.brake import Brake
    from mcpilco.policies.regulator import Regulator
    from mcpilco.policies.stage import Stage

Bounds = Sequence[float] | Float[np.ndarray, " U"]
"""one number for each input, in the env's unit"""


class Squash(nn.Module):
    """u = centre + half_range tanh(a / scale): any number becomes an input within its bounds."""

    centre: Tensor
    half_range: Tensor

    def __init__(self, low: Bounds, high: Bounds, scale: float) -> None:
        super().__init__()
        smallest = torch.as_tensor(low, dtype=torch.float64)
        largest = torch.as_tensor(high, dtype=torch.float64)
        ordered = smallest.shape == largest.shape and bool((smallest < largest).all())
        if not (ordered and bool((smallest.isfinite() & largest.isfinite()).all())):
            raise InputError(
                "A policy needs finite bounds low < high for each input, "
                f"got low {list(low)}, high {list(high)}; bound the env's action space."
            )
        self.register_buffer("centre", (smallest + largest) / 2)
        self.register_buffer("half_range", (largest - smallest) / 2)
        self.scale = scale

    def forward(self, a: Float[Tensor, "*b U"]) -> Float[Tensor, "*b U"]:
        """Inputs in the env's unit."""
        return self.centre + self.half_range * torch.tanh(a / self.scale)


class SumOfGaussians(nn.Module):
    """A network of Gaussian bases on the augmented state z, squashed into the input's bounds.

        phi_b(z) = exp(-sum_d ((z_d - c_bd) / l_d)^2),    u = squash(sum_b w_b phi_b)

    Centres, lengthscales and weights are all trained. With dropout, each particle, step and basis
    has its own mask.

    Reference: thesis section 5.5.1.
    """

    def __init__(
        self,
        augmentation: AngleAugmentation,
        low: Bounds,
        high: Bounds,
        bases: int = 100,
        squash: float = 10.0,
    ) -> None:
        """A policy with all weights zero; `randomise` gives it a start.

        Inputs go from `low` to `high`, in the env's unit; there are B `bases`, and `squash` is the
        scale of the tanh's argument [-].

        Raises:
            InputError: the bounds are not finite or not ordered.
        """
        super().__init__()
        self.augmentation = augmentation
        self.squash = Squash(low, high, squash)
        self.centres = nn.Parameter(torch.zeros(bases, augmentation.width, dtype=torch.float64))
        self.log_lengthscale = nn.Parameter(torch.zeros(augmentation.width, dtype=torch.float64))
        self.weights = nn.Parameter(torch.zeros(bases, len(low), dtype=torch.float64))
        self.regulator: Regulator | None = None
        """acts in the policy's place near the goal, `mcpilco.policies.regulator`; None: never"""
        self.brake: Brake | None = None
        """from commands to inputs that keep limits, `mcpilco.policies.brake`; None: no limits"""

    @property
    def lengthscale(self) -> Float[Tensor, " Z"]:
        """l, one for each component of z, in its unit."""
        return self.log_lengthscale.exp()

    @property
    def bases(self) -> int:
        """B."""
        return len(self.centres)

    @property
    def input_dim(self) -> int:
        """U."""
        return self.weights.shape[1]

    @property
    def behind(self) -> list[Stage]:
        """The formulas that change its commands, in order: of a regulator, then of a brake."""
        return [stage for stage in (self.regulator, self.brake) if stage is not None and stage.acts]

    def randomise(
        self,
        span: Float[Tensor, " plain"],
        lengthscale: Float[Tensor, " plain"],
        angle_lengthscale: float,
        weight: float,
        generator: torch.Generator,
    ) -> None:
        """Draw a new start in place: centres over the state space, weights around zero.

        `span` is the half range of the centres for the components that are no angle, in their
        units; `lengthscale` is for these, `angle_lengthscale` for cosines and sines [-]; `weight`
        is the half range of the weights [-].
        """

        def uniform(*shape: int) -> Tensor:
            return 2 * torch.rand(*shape, generator=generator, dtype=torch.float64) - 1

        angles = torch.pi * uniform(self.bases, len(self.augmentation.angles))
        plain = uniform(self.bases, len(span)) * span
        with torch.no_grad():
            self.centres.copy_(torch.cat([plain, angles.cos(), angles.sin()], -1))
            circular = lengthscale.new_full((2 * angles.shape[1],), angle_lengthscale)
            scales = torch.cat([lengthscale, circular])
            self.log_lengthscale.copy_(scales.log())
            self.weights.copy_(weight * uniform(self.bases, self.input_dim))

    def activations(self, states: Float[Tensor, "*b X"]) -> Float[Tensor, "*b B"]:
        """phi, in (0, 1]."""
        z = self.augmentation(states) / self.lengthscale
        c = self.centres / self.lengthscale
        squared_distance = (z**2).sum(-1, keepdim=True) + (c**2).sum(-1) - 2 * z @ c.T
        return torch.exp(-squared_distance.clamp_min(0.0))

    def forward(
        self, states: Float[Tensor, "*b X"], dropout: Dropout | None = None, step: int = 0
    ) -> Float[Tensor, "*b U"]:
        """The inputs for a set of states, in the env's unit."""
        phi = self.activations(states)
        if dropout is not None:
            phi = phi * dropout.factors(step, *cast(tuple[int, int], phi.shape))
        commands = self.squash(phi @ self.weights)
        for stage in self.behind:
            commands = stage(states, commands)
        return commands


def blank_policy(config: PolicyConfig, task: TaskSpec, low: Bounds, high: Bounds) -> SumOfGaussians:
    """A policy for this task that always answers the middle of its bounds."""
    augmentation = AngleAugmentation(len(task.state_names), task.angles)
    return SumOfGaussians(augmentation, low, high, config.bases, config.squash)


def random_policy(
    config: PolicyConfig,
    task: TaskSpec,
    low: Bounds,
    high: Bounds,
    states: Float[np.ndarray, "N X"],
    generator: torch.Generator,
) -> SumOfGaussians:
    """A random start for a search, its centres spread over the states seen so far."""
    policy = blank_policy(config, task, low, high)
    plain = list(policy.augmentation.plain)
    if isinstance(config.span, str):
        sizes = torch.from_numpy(states).abs()
        size = sizes.amax(0) if config.span == "data" else sizes.square().mean(0).sqrt()
        span = torch.maximum(size, size.new_tensor(task.start_std))[plain]
        span[span == 0] = 1.0  # a state that never moved needs a lengthscale all the same
    else:
        span = torch.full((len(plain),), config.span, dtype=torch.float64)
    if config.lengthscale == "span":
        lengthscale = span
    else:
        lengthscale = torch.full_like(span, config.lengthscale)
    policy.randomise(span, lengthscale, config.angle_lengthscale, config.weight, generator)
    return policy


LEVELS = 256
"""Rates are multiples of 1 / LEVELS: one byte of a hash decides for one basis."""
BASES_PER_HASH = 4
"""A hash has 32 bits."""
GOLDEN = np.uint32(0x9E3779B9)
"""2^32 over the golden ratio: its multiples keep the hashed numbers of a particle apart."""


def mix(x: UInt32[np.ndarray, "*b"]) -> UInt32[np.ndarray, "*b"]:
    """A well-mixed 32-bit hash of 32-bit integers (two multiply-xorshift rounds).

    Reference: C. Wellons, "Prospecting for hash functions", 2018, constants of lowbias32.
    """
    x = x ^ (x >> np.uint32(16))
    x = x * np.uint32(0x7FEB352D)
    x = x ^ (x >> np.uint32(15))
    x = x * np.uint32(0x846CA68B)
    return x ^ (x >> np.uint32(16))


@dataclass(frozen=True)
class Dropout:
    """Inverted dropout: a factor 0 with probability `rate`, else 1 / (1 - rate).

    The mask is a function of its position, not of a random generator's history: the same one comes
    out in torch, in numpy and inside a compiled loop, in any order of evaluation.
    """

    rate: float
    """probability of a zero [-], rounded to a multiple of 1 / 256"""
    seed: int
    """equal seeds give equal masks"""

    def __post_init__(self) -> None:
        if not 0.0 <= self.rate < 1.0:
            raise InputError(f"The dropout rate must be in [0, 1), got {self.rate}.")

    @property
    def threshold(self) -> int:
        """A byte below this number drops its basis."""
        return min(round(self.rate * LEVELS), LEVELS - 1)

    @property
    def scale(self) -> float:
        """The factor of the bases that stay [-]."""
        return 1.0 / (1.0 - self.threshold / LEVELS)

    def keys(self, steps: int) -> UInt32[np.ndarray, " T"]:
        """One 32-bit key for each time step, independent of how many there are."""
        seed = mix(np.array([self.seed & 0xFFFFFFFF], dtype=np.uint32))
        return mix(seed + np.arange(steps, dtype=np.uint32))

    def factors(self, step: int, particles: int, bases: int) -> Float[Tensor, "P B"]:
        """The factor of each basis and particle at one time step [-]."""
        key = self.keys(step + 1)[step]
        rows = mix(np.arange(particles, dtype=np.uint32) + key)
        groups = np.arange(-(-bases // BASES_PER_HASH), dtype=np.uint32)
        words = mix(rows[:, None] + groups[None, :] * GOLDEN)
        bytes_ = words.astype("<u4").view(np.uint8).reshape(particles, -1)[:, :bases]
        return torch.from_numpy(np.where(bytes_ < self.threshold, 0.0, self.scale))
