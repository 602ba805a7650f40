"""How the compiled loops see a model, a policy and their own memory: padded, contiguous arrays.

Rows of training samples and of policy bases are padded with zeros to whole vectors, so that no
loop has a remainder.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from mcpilco.dynamics import GPDynamics
from mcpilco.kernels.base import Term
from mcpilco.policies import SumOfGaussians

BLOCK = 32
"""particles that go through one matrix product together"""
CHUNK = 1024
"""numbers that pass through all operations before the next do, to stay in the fastest cache"""
WELL_CONDITIONED = 3e6
"""below this condition number of K a product with K^-1, half the work, is exact enough [-]"""
PAD = 8
"""rows are padded to a multiple of this"""


class ModelArrays(NamedTuple):
    """A posterior and the law of motion, constant for a whole search.

    A kernel is a sum of K terms v exp(-1/2 |x - x_j|^2_w) prod_f (c_f + <x, x_j>_s_f). Each of
    the exponents and of the F factors is linear in [x, 1] but for a part that depends on x alone:
    it is a "group", one product of [x, 1, shifts] with a constant matrix.
    """

    alpha: np.ndarray
    """(E, N)"""
    solve: np.ndarray
    """(1, E, N, N), K^-1; or (2, E, N, N), L^-T and L^-1, where K is ill-conditioned"""
    expand: np.ndarray
    """(E, G, D + 1 + exponents, N), from [x, 1, shifts] to each group; exponents come first"""
    collect: np.ndarray
    """(E, G, N, D + 1 padded), from a weighted group to its moments and its mass"""
    middle: np.ndarray
    """(D,), where exponents are expanded"""
    v: np.ndarray
    """(E, K)"""
    w: np.ndarray
    """(E, K, D)"""
    c: np.ndarray
    """(E, F)"""
    s: np.ndarray
    """(E, F, D)"""
    exponent: np.ndarray
    """(K,), the group of each term's exponent, or -1"""
    owner: np.ndarray
    """(F,), the term that each factor belongs to; factors are the last groups"""
    floor: np.ndarray
    """(E,), smallest variance"""
    A: np.ndarray
    """(X, X), from the state to the next one"""
    B: np.ndarray
    """(X, E), from the changes to the next state"""
    predicted: np.ndarray
    """(E,), which states the changes belong to"""
    bounds: np.ndarray
    """(E,), largest plausible magnitude of those states"""


class PolicyArrays(NamedTuple):
    """A policy: two products with a squashing between them."""

    plain: np.ndarray
    """components of the state that are no angle"""
    angles: np.ndarray
    """components that are"""
    centres: np.ndarray
    """(Z + 2, B), from [z / l, 1, -|z / l|^2] to the exponents of the bases"""
    inv_scale: np.ndarray
    """(Z,), 1 / l"""
    pulling: np.ndarray
    """(B, U (Z + 1) padded), from activations to sum_b w_b phi_b [c_b / l, 1]"""
    squash: np.ndarray
    """(3, U): centre, half range, scale"""


class Mask(NamedTuple):
    """Dropout of the policy's bases."""

    keys: np.ndarray
    """(T,), of the hash"""
    threshold: int
    """bytes below it drop their basis"""
    scale: float
    """factor of the bases that stay"""


class Trace(NamedTuple):
    """What the forward sweep writes and the backward sweep reads."""

    states: np.ndarray
    """(T + 1, P, X), the first row given"""
    inputs: np.ndarray
    """(T, P, U)"""
    activations: np.ndarray
    """(T, P, B), dropout included"""
    delta_jacobians: np.ndarray
    """(T, P, E, D), d delta / d [z, u]"""
    input_jacobians: np.ndarray
    """(T, P, U, Z), du / dz"""
    frozen: np.ndarray
    """(T, P), 1 where the particle stayed"""


class Memory(NamedTuple):
    """What one block of particles needs on its way through a time step."""

    x: np.ndarray
    """(BLOCK, D + 1 + exponents), [z, u, 1, shifts]"""
    scaled: np.ndarray
    """(BLOCK, Z + 2), [z / l, 1, -|z / l|^2]"""
    pulls: np.ndarray
    groups: np.ndarray
    """(G, BLOCK * N)"""
    weighted: np.ndarray
    """(G, BLOCK * N)"""
    rows: np.ndarray
    """(BLOCK * N,), k(x, X)"""
    term: np.ndarray
    g: np.ndarray
    """(BLOCK * N,), alpha - (eps / sd) u"""
    half: np.ndarray
    """(BLOCK, N), L^-1 k where K^-1 is applied in two steps"""
    solved: np.ndarray
    """(BLOCK, N), u = K^-1 k"""
    quadratic: np.ndarray
    """(BLOCK,), k . u"""
    moments: np.ndarray
    delta: np.ndarray
    ratio: np.ndarray
    """(BLOCK,), eps / sd"""
    slope: np.ndarray
    """(BLOCK, D), derivative of the prior variance"""


def padded(length: int) -> int:
    """The next multiple of PAD."""
    return -(-length // PAD) * PAD


def _pad(array: Tensor, *axes: int) -> np.ndarray:
    """The array with zeros behind these axes."""
    widths = [(0, padded(n) - n if i in axes else 0) for i, n in enumerate(array.shape)]
    return np.ascontiguousarray(np.pad(array.detach().numpy(), widths))


@torch.no_grad()
def model_arrays(dynamics: GPDynamics) -> ModelArrays:
    """The arrays of a model.

    Raises:
        NoCanonicalFormError: its kernel is no sum of canonical terms.
    """
    posterior = dynamics.posterior
    terms = posterior.kernel.terms()
    middle = posterior.X.mean(0)
    expand, collect = _groups(posterior.X, middle, terms)
    has_exponent = np.array([_has_exponent(term) for term in terms])
    owner = [k for k, term in enumerate(terms) for _ in range(term.c.shape[-1])]
    return ModelArrays(
        alpha=_pad(posterior.alpha, 1),
        solve=_pad(_solve(posterior.L, posterior.L_inv), 2, 3),
        expand=expand,
        collect=collect,
        middle=middle.numpy(),
        v=_pad(torch.stack([term.v for term in terms], -1)),
        w=_pad(torch.stack([term.w for term in terms], -2)),
        c=_pad(torch.cat([term.c for term in terms], -1)),
        s=_pad(torch.cat([term.s for term in terms], -2)),
        exponent=np.where(has_exponent, np.cumsum(has_exponent) - 1, -1),
        owner=np.array(owner, dtype=np.int64),
        floor=posterior.smallest_variance.numpy(),
        A=np.ascontiguousarray(dynamics.increment.A),
        B=np.ascontiguousarray(dynamics.increment.B),
        predicted=np.array(dynamics.predicted, dtype=np.int64),
        bounds=dynamics.bounds.numpy(),
    )


def _solve(L: Tensor, L_inv: Tensor) -> Tensor:
    """What applies K^-1 to a row.

    The variance k** - k . K^-1 k is a small difference of large numbers: through K^-1 it suffers
    from the condition number of K, through L^-1 only from its square root.
    """
    K, inverse = L @ L.mT, L_inv.mT @ L_inv
    conditions = torch.linalg.matrix_norm(K, 1) * torch.linalg.matrix_norm(inverse, 1)
    if float(conditions.max()) < WELL_CONDITIONED:
        return inverse[None]
    return torch.stack([L_inv.mT, L_inv])


def _has_exponent(term: Term) -> bool:
    return bool((term.w != 0).any())


def _groups(X: Tensor, middle: Tensor, terms: list[Term]) -> tuple[np.ndarray, np.ndarray]:
    """The matrices `expand` and `collect`.

        -1/2 |x - x_j|^2_w = <x, m_j>_w - 1/2 <m_j + 2 middle, m_j>_w - 1/2 |x - middle|^2_w

    with m_j = x_j - middle; the last part is the shift, which depends on x alone.
    """
    shifted = X - middle
    slopes, offsets = [], []
    for term in filter(_has_exponent, terms):
        slopes.append(term.w[:, :, None] * shifted.T)
        offsets.append(-(term.w[:, :, None] * (shifted * (shifted / 2 + middle)).T).sum(1))
    exponents = len(slopes)
    for term in terms:
        for c, s in zip(term.c.unbind(-1), term.s.unbind(-2), strict=True):
            slopes.append(s[:, :, None] * X.T)
            offsets.append(c[:, None].expand(-1, len(X)))
    slope, offset = torch.stack(slopes, 1), torch.stack(offsets, 1)[:, :, None]
    outputs, groups, _, n = slope.shape
    shifts = torch.zeros(outputs, groups, exponents, n, dtype=X.dtype)
    for k in range(exponents):
        shifts[:, k, k] = 1.0
    expand = _pad(torch.cat([slope, offset, shifts], 2), 3)
    collect = _pad(torch.cat([slope, torch.ones_like(offset)], 2).mT, 2, 3)
    return expand, collect


@torch.no_grad()
def policy_arrays(policy: SumOfGaussians) -> PolicyArrays:
    """The arrays of a policy.

    -|z / l - c / l|^2 = 2 <z / l, c / l> - |c / l|^2 - |z / l|^2
    """
    augmentation, squash = policy.augmentation, policy.squash
    inv_scale = torch.exp(-policy.log_lengthscale)
    c = (policy.centres * inv_scale).T
    one = torch.ones_like(c[:1])
    pulling = policy.weights.T[:, None] * torch.cat([c, one])
    scale = torch.full_like(squash.centre, squash.scale)
    return PolicyArrays(
        plain=np.array(augmentation.plain, dtype=np.int64),
        angles=np.array(augmentation.angles, dtype=np.int64),
        centres=_pad(torch.cat([2 * c, -(c**2).sum(0, keepdim=True), one]), 1),
        inv_scale=inv_scale.numpy(),
        pulling=_pad(pulling.flatten(0, 1).T, 0, 1),
        squash=torch.stack([squash.centre, squash.half_range, scale]).numpy(),
    )


def make_memory(model: ModelArrays, policy: PolicyArrays) -> Memory:
    """Fresh memory; the columns of ones are set here once."""
    outputs, groups, columns, n = model.expand.shape
    regressors = len(model.middle)
    return Memory(
        x=np.ones((BLOCK, columns)),
        scaled=np.ones((BLOCK, len(policy.inv_scale) + 2)),
        pulls=np.empty((BLOCK, policy.pulling.shape[1])),
        groups=np.empty((groups, BLOCK * n)),
        weighted=np.empty((groups, BLOCK * n)),
        rows=np.empty(BLOCK * n),
        term=np.empty(CHUNK),
        g=np.empty(BLOCK * n),
        half=np.empty((BLOCK, n)),
        solved=np.empty((BLOCK, n)),
        quadratic=np.empty(BLOCK),
        moments=np.empty((groups, BLOCK, padded(regressors + 1))),
        delta=np.empty((BLOCK, outputs)),
        ratio=np.empty(BLOCK),
        slope=np.empty((BLOCK, regressors)),
    )
