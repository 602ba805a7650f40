"""Canonical terms of kernels, evaluated by their formula."""

from __future__ import annotations

import torch
from torch import Tensor

from mcpilco.kernels import Term


def matrix(term: Term, X1: Tensor, X2: Tensor) -> Tensor:
    """v exp(-1/2 sum_d w_d (x_d - x'_d)^2) prod_r (c_r + sum_d s_rd x_d x'_d)."""
    differences = X1[..., :, None, :] - X2[..., None, :, :]
    quadratic = (term.w[..., None, None, :] * differences.square()).sum(-1)
    linear = torch.einsum("...rd,...nd,...md->...rnm", term.s, X1, X2)
    factors = term.c[..., None, None] + linear
    return term.v[..., None, None] * torch.exp(-0.5 * quadratic) * factors.prod(-3)
