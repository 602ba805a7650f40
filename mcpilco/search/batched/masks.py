"""The masks of `mcpilco.policies.dropout`, for a batch of seeds on any device."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from mcpilco.policies import BASES_PER_HASH, GOLDEN, Dropout
from mcpilco.search.batched.transfer import Movable

_ALL_BITS = 0xFFFFFFFF


def mix(x: Int[Tensor, "*b"]) -> Int[Tensor, "*b"]:
    """`dropout.mix` of 32-bit numbers in 64-bit integers.

    torch has no shift for uint32.
    """
    x = x ^ (x >> 16)
    x = (x * 0x7FEB352D) & _ALL_BITS
    x = x ^ (x >> 15)
    x = (x * (0x846CA68B - 2**32)) & _ALL_BITS  # the same bits; no product leaves 64 of them
    return x ^ (x >> 16)


@dataclass(frozen=True)
class MaskBatch(Movable):
    """Dropout of each of S seeds, at its own rate."""

    keys: Int[Tensor, "S T"]
    """of the hash, one for each time step"""
    threshold: Int[Tensor, "S 1 1"]
    """bytes below it drop their basis; 0 drops none"""
    scale: Float[Tensor, "S 1 1"]
    """factor of the bases that stay [-]"""

    @classmethod
    def of(cls, dropouts: Sequence[Dropout | None], steps: int) -> MaskBatch | None:
        """The masks of `steps` time steps; None where no seed has any."""
        if not any(dropouts):
            return None
        keys = np.zeros((len(dropouts), steps), dtype=np.int64)
        threshold, scale = [0] * len(dropouts), [1.0] * len(dropouts)
        for seed, dropout in enumerate(dropouts):
            if dropout is not None:
                keys[seed] = dropout.keys(steps)
                threshold[seed], scale[seed] = dropout.threshold, dropout.scale
        return cls(
            torch.from_numpy(keys),
            torch.tensor(threshold)[:, None, None],
            torch.tensor(scale, dtype=torch.float64)[:, None, None],
        )

    def factors(self, step: int, particles: int, bases: int) -> Float[Tensor, "S P B"]:
        """The factor of each basis and particle of each seed at one time step [-]."""
        device = self.keys.device
        particle = torch.arange(particles, device=device)
        group = torch.arange(-(-bases // BASES_PER_HASH), device=device) * int(GOLDEN)
        rows = mix((particle + self.keys[:, step, None]) & _ALL_BITS)
        words = mix((rows[..., None] + group) & _ALL_BITS)
        lanes = 8 * torch.arange(BASES_PER_HASH, device=device)
        levels = ((words[..., None] >> lanes) & 0xFF).flatten(-2)[..., :bases]
        return torch.where(levels < self.threshold, 0.0, self.scale)
