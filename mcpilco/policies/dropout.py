"""Dropout whose mask is a function of its position, not of a random generator's history.

The same mask comes out in torch, in numpy and inside a compiled loop, in any order of evaluation;
it costs a few integer operations for four bases.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, UInt32
from torch import Tensor

from mcpilco.typing import InputError

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
    """Inverted dropout: a factor 0 with probability `rate`, else 1 / (1 - rate)."""

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
