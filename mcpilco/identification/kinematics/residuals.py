"""How far samples are from the three motions that a joint can give to a marker, at its best fit.

Each function takes weights of the samples, fits the constants of its model to them, and returns a
residual of every sample: the root mean square of its coordinates.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

_TURNS = 4
"""steps of the alternation between signs and rotation"""


def slide(
    weights: Float[np.ndarray, "pairs J N"],
    p: Float[np.ndarray, "pairs N 3"],
    q: Float[np.ndarray, "J N"],
) -> Float[np.ndarray, "pairs J N"]:
    """P1: u is the direction of sum (q - mean q)(p - mean p)."""
    p, q = p[:, None], q[:, :, None]
    p, q = p - weighted_mean(weights, p), q - weighted_mean(weights, q)
    s = (weights[..., None] * q * p).sum(-2, keepdims=True)
    u = s / np.maximum(np.linalg.norm(s, axis=-1, keepdims=True), np.finfo(float).tiny)
    return root_mean_square(p - q * u)


def hinge(
    weights: Float[np.ndarray, "pairs N"],
    p: Float[np.ndarray, "pairs N 3"],
    r: Float[np.ndarray, "pairs N 4"],
) -> Float[np.ndarray, "pairs N"]:
    """P2: d of least norm from the normal equations, c the mean of the rest."""
    R = np.stack([rotated(r, axis) for axis in np.eye(3)], -1)
    flat = R.reshape(*R.shape[:2], 9)
    R = (flat - weighted_mean(weights, flat)).reshape(R.shape)
    p = p - weighted_mean(weights, p)
    A = np.einsum("bn,bnki,bnkj->bij", weights, R, R)
    b = np.einsum("bn,bnki,bnk->bi", weights, R, p)
    d = (np.linalg.pinv(A, rcond=1e-9, hermitian=True) @ b[..., None])[..., 0]
    return root_mean_square(p - (R @ d[:, None, :, None])[..., 0])


def turn(
    weights: Float[np.ndarray, "pairs J N"],
    r: Float[np.ndarray, "pairs N 4"],
    q: Float[np.ndarray, "J N"],
) -> Float[np.ndarray, "pairs J N"]:
    """P3: the quaternions are +-W h, h = (cos q/2, sin q/2), with orthonormal columns in W.

    A Rz(q) B has the quaternion a (cos q/2 + k sin q/2) b = cos q/2 (a b) + sin q/2 (a k b), and
    all pairs of orthonormal quaternions are such. The start is the W of most alignment,
    sum (r . W h)^2 / sum |W h|^2, an eigenvector; from there signs and W take turns.
    """
    h = np.stack([np.cos(q / 2), np.sin(q / 2)], -1)
    best, least = np.zeros(weights.shape), np.full(weights.shape[:-1], np.inf)
    for W in _starts(weights, r, h):
        for _ in range(_TURNS):
            sign = np.sign(np.einsum("bni,bjic,jnc->bjn", r, W, h))
            W = _orthonormal(np.einsum("bjn,bni,jnc->bjic", weights * sign, r, h))
        Wh = np.einsum("bjic,jnc->bjni", W, h)
        r_ = r[:, None] * np.sign((r[:, None] * Wh).sum(-1, keepdims=True))
        chord = np.linalg.norm(r_ - Wh, axis=-1)
        angles = 4 * np.arcsin(np.minimum(chord / 2, 1.0)) / np.sqrt(3)
        cost = (weights * angles**2).sum(-1)
        best = np.where((cost < least)[..., None], angles, best)
        least = np.minimum(cost, least)
    return best


def _starts(
    weights: Float[np.ndarray, "pairs J N"],
    r: Float[np.ndarray, "pairs N 4"],
    h: Float[np.ndarray, "J N 2"],
) -> list[Float[np.ndarray, "pairs J 4 2"]]:
    """The best W, and its mixtures with the second best, for joints with few positions.

    With two positions of a joint, two W fit alike, and only one mixture has orthonormal columns.
    """
    H = np.einsum("bjn,jnc,jnd->bjcd", weights, h, h)
    values, vectors = np.linalg.eigh(H)
    root = 1 / np.sqrt(np.maximum(values, 1e-12 * values[..., -1:] + np.finfo(float).tiny))
    whiten = (vectors * root[..., None, :]) @ vectors.mT
    shape = weights.shape[:2]
    rh = np.einsum("bni,jnc->bjnic", r, h).reshape(*shape, -1, 8)
    raw = ((weights[..., None] * rh).mT @ rh).reshape(*shape, 4, 2, 4, 2)
    moment = np.einsum("bjicke,bjcd,bjef->bjidkf", raw, whiten, whiten).reshape(*shape, 8, 8)
    top = np.linalg.eigh(moment)[1].mT[..., ::-1, :].reshape(*shape, 8, 4, 2) @ whiten[:, :, None]
    first, second = top[:, :, 0], top[:, :, 1]
    return [_orthonormal(W) for W in (first, first + second, first - second)]


def _orthonormal(W: Float[np.ndarray, "*b 4 2"]) -> Float[np.ndarray, "*b 4 2"]:
    """The nearest W with orthonormal columns."""
    U, _, Vt = np.linalg.svd(W, full_matrices=False)
    return U @ Vt


def weighted_mean(
    weights: Float[np.ndarray, "*#b N"], values: Float[np.ndarray, "*#b N D"]
) -> Float[np.ndarray, "*#b 1 D"]:
    """The mean over samples, of each problem."""
    total = (weights[..., None] * values).sum(-2, keepdims=True)
    return total / np.maximum(weights.sum(-1), np.finfo(float).tiny)[..., None, None]


def root_mean_square(residuals: Float[np.ndarray, "*b N 3"]) -> Float[np.ndarray, "*b N"]:
    """Root mean square over the coordinates of each sample."""
    return np.sqrt((residuals**2).mean(-1))


def product(
    a: Float[np.ndarray, "*#b 4"], b: Float[np.ndarray, "*#b 4"]
) -> Float[np.ndarray, "*#b 4"]:
    """The product of quaternions."""
    u, v = a[..., 1:], b[..., 1:]
    w = a[..., :1] * b[..., :1] - (u * v).sum(-1, keepdims=True)
    return np.concatenate([w, a[..., :1] * v + b[..., :1] * u + np.cross(u, v)], -1)


def rotated(
    r: Float[np.ndarray, "*#b 4"], v: Float[np.ndarray, "*#b 3"]
) -> Float[np.ndarray, "*#b 3"]:
    """Vectors turned by quaternions."""
    u = r[..., 1:]
    t = 2 * np.cross(u, v)
    return v + r[..., :1] * t + np.cross(u, t)
