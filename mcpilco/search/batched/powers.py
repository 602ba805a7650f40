"""The columns that every exponent and factor of a batch is linear in."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor


def powers(x: Float[Tensor, "*b D"]) -> Float[Tensor, "*b one_plus_two_D"]:
    """[1, x, x^2]: -|x - c|^2_w is a row of these times [-|c|^2_w, 2 w c, -w]."""
    return torch.cat([torch.ones_like(x[..., :1]), x, x.square()], -1)
