"""Three tests of a triplet (marker, marker, joint): does the joint connect the markers' links?

For markers i and j, p is the position of j in the frame of i and R its orientation. Where the
triplet is connected, for some constants,

    P1  slide:  p = c + q u, |u| = 1, and R is constant      (thesis eq. 2.9)
    P2  hinge:  p = c + R d: a point stands still in both    (thesis eq. 2.12)
    P3  hinge:  R = A Rz(q) B                                (thesis eq. 2.13)

Each residual is a root mean square over samples and coordinates, so that it compares with the
standard deviation of the measurement: [m] for positions, [rad] for the components of a rotation
vector. Tests are for all pairs and joints at once.

Differs: P1 in closed form (the thesis minimises under a constraint); P2 by least squares of least
norm, since its matrix has rank 5 without noise, never 6 (the point may lie anywhere on the axis);
P3 by quaternions, whose residual has no singularity, in place of yaw, pitch and roll; R is constant
where its rotation from the mean is small, in place of a variance. The worst samples, by share,
count as outliers: in the thesis they have been removed before.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float, Int

from mcpilco.recordings import MarkerRecording, rotation

Weights = Float[np.ndarray, "pairs J N"]
"""of the samples of each pair and joint; residuals likewise"""
Places = Float[np.ndarray, "pairs N 3"]
"""positions p of one marker in the frame of the other [m]"""
Turns = Float[np.ndarray, "pairs N 4"]
"""its orientations R, as quaternions"""
Joints = Float[np.ndarray, "J N"]
"""positions q [rad or m]"""

_TURNS = 4
"""steps of the alternation between signs and rotation"""


def slide(weights: Weights, p: Places, q: Joints) -> Weights:
    """P1: u is the direction of sum (q - mean q)(p - mean p)."""
    p, q = p[:, None], q[:, :, None]
    p, q = p - weighted_mean(weights, p), q - weighted_mean(weights, q)
    s = (weights[..., None] * q * p).sum(-2, keepdims=True)
    u = s / np.maximum(np.linalg.norm(s, axis=-1, keepdims=True), np.finfo(float).tiny)
    return root_mean_square(p - q * u)


def hinge(
    weights: Float[np.ndarray, "pairs N"], p: Places, r: Turns
) -> Float[np.ndarray, "pairs N"]:
    """P2: d of least norm from the normal equations, c the mean of the rest."""
    flat = rotation(r.reshape(-1, 4)).as_matrix().reshape(*r.shape[:2], 9)
    R = (flat - weighted_mean(weights, flat)).reshape(*r.shape[:2], 3, 3)
    p = p - weighted_mean(weights, p)
    A = np.einsum("bn,bnki,bnkj->bij", weights, R, R)
    b = np.einsum("bn,bnki,bnk->bi", weights, R, p)
    d = (np.linalg.pinv(A, rcond=1e-9, hermitian=True) @ b[..., None])[..., 0]
    return root_mean_square(p - (R @ d[:, None, :, None])[..., 0])


def turn(weights: Weights, r: Turns, q: Joints) -> Weights:
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
    weights: Weights, r: Turns, h: Float[np.ndarray, "J N 2"]
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


_FLOOR = 1e-9
"""least residual that the weights of the first fits distinguish, in the unit of the residuals"""
_ABSOLUTE_FITS, _TRIMMED_FITS = 4, 6
_FEWEST = 4
"""samples"""

Fit = Callable[[Float[np.ndarray, "*b N"]], Float[np.ndarray, "*b N"]]
"""from the weights of samples to their residuals, for a batch of problems"""


def trimmed(fit: Fit, seen: Float[np.ndarray, "*b N"], outliers: float) -> Float[np.ndarray, "*b"]:
    """Root mean square of the residuals that are left when the largest are not counted.

    Infinite where there are too few samples.

    Least squares without outliers; otherwise least absolute residuals, then least trimmed squares
    by concentration from there (Rousseeuw & Van Driessen 2006).
    """
    kept = seen.astype(float)
    residuals = fit(kept)
    if outliers > 0:
        for _ in range(_ABSOLUTE_FITS):
            residuals = fit(seen / np.maximum(residuals, _FLOOR))
        for _ in range(_TRIMMED_FITS):
            # the smallest residuals, so many as are no outliers
            order = np.where(seen > 0, residuals, np.inf).argsort(-1).argsort(-1)
            most = np.ceil((1 - outliers) * seen.sum(-1, keepdims=True))
            before, kept = kept, (order < most).astype(float)
            residuals = fit(kept)
            if np.array_equal(kept, before):
                break
    squares = (kept * residuals**2).sum(-1)
    rms = np.sqrt(squares / np.maximum(kept.sum(-1), 1.0))
    return np.where(seen.sum(-1) < _FEWEST, np.inf, rms)


@dataclass(frozen=True, eq=False)
class TripletTests:
    """Residuals of the tests for each pair of markers and each joint."""

    pairs: Int[np.ndarray, "pairs 2"]
    """numbers of the markers, the smaller first; who passes does not depend on the order"""
    slide: Float[np.ndarray, "pairs J"]
    """P1, position [m]"""
    rigid: Float[np.ndarray, " pairs"]
    """P1, orientation [rad]"""
    hinge: Float[np.ndarray, " pairs"]
    """P2 [m]"""
    turn: Float[np.ndarray, "pairs J"]
    """P3 [rad]"""


def triplet_tests(recording: MarkerRecording, outliers: float = 0.0) -> TripletTests:
    """All three tests for all triplets.

    A pair is tested on those of the N samples that show both markers; `outliers` is the share of
    these that may be wrong [-]: the worst are not counted.
    """
    count = len(recording.marker_names)
    pairs = np.array(list(combinations(range(count), 2)))
    p, r, seen = relative(recording, pairs)
    q = recording.q.T
    each = np.broadcast_to(seen[:, None], (len(pairs), *q.shape))
    constant = np.zeros((1, recording.q.shape[0]))
    return TripletTests(
        pairs=pairs,
        slide=trimmed(lambda w: slide(w, p, q), each, outliers),
        rigid=trimmed(lambda w: turn(w, r, constant), seen[:, None], outliers)[:, 0],
        hinge=trimmed(lambda w: hinge(w, p, r), seen, outliers),
        turn=trimmed(lambda w: turn(w, r, q), each, outliers),
    )


def standstill(
    recording: MarkerRecording, outliers: float = 0.0
) -> tuple[Float[np.ndarray, " markers"], Float[np.ndarray, " markers"]]:
    """How far each marker moves in the camera's frame: residuals [m] and [rad] of a constant."""
    p, seen = np.nan_to_num(recording.positions).swapaxes(0, 1), recording.seen.T.astype(float)
    r = np.nan_to_num(recording.quaternions, nan=0.5).swapaxes(0, 1)
    constant = np.zeros((1, len(recording)))
    position = trimmed(lambda w: root_mean_square(p - weighted_mean(w, p)), seen, outliers)
    orientation = trimmed(lambda w: turn(w, r, constant), seen[:, None], outliers)
    return position, orientation[:, 0]


def relative(
    recording: MarkerRecording, pairs: Int[np.ndarray, "pairs 2"]
) -> tuple[Places, Turns, Float[np.ndarray, "pairs N"]]:
    """Relative positions and quaternions of all pairs, and 1 where both are seen, 0 elsewhere."""
    first, second = pairs.T
    seen = (recording.seen[:, first] & recording.seen[:, second]).T
    p = np.nan_to_num(recording.positions).swapaxes(0, 1)
    r = np.nan_to_num(recording.quaternions, nan=0.5).swapaxes(0, 1)
    back = rotation(r[first].reshape(-1, 4)).inv()
    turns = (back * rotation(r[second].reshape(-1, 4))).as_quat(scalar_first=True)
    places = back.apply((p[second] - p[first]).reshape(-1, 3))
    shape = seen.shape
    return places.reshape(*shape, 3), turns.reshape(*shape, 4), seen.astype(float)
