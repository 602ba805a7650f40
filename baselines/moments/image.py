"""The image of a Gaussian under a function, and how such functions follow one another.

    x ~ N(m, s),   y = f(x):   M = E[y],   S = cov(y),   V = s^-1 cov(x, y)

V is defined for singular s too: by Stein's lemma it is E[df/dx].

`gaussian_through_gp`, `_trig` and `_squash` are the public entries, which check what comes in:
arrays in, arrays out. Where an argument is a torch tensor the results are tensors, and gradients
flow to every argument that asks for them.

Reference: Deisenroth, Fox & Rasmussen, IEEE Transactions on Pattern Analysis and Machine
Intelligence 37 (2), 2015 (PILCO; here: DFR), on exact moment matching.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from mcpilco.gp import add_to_diagonal, cholesky
from mcpilco.typing import InputError


@dataclass(frozen=True)
class Image:
    """The first two moments of y = f(x) for a Gaussian x."""

    mean: Float[Tensor, "*b E"]
    """M"""
    cov: Float[Tensor, "*b E E"]
    """S, all outputs against all"""
    slope: Float[Tensor, "*b D E"]
    """V = s^-1 cov(x, y), the mean slope of f"""

    def mapped(self, W: Float[Tensor, "F E"]) -> Image:
        """The moments of W y."""
        return Image(self.mean @ W.mT, W @ self.cov @ W.mT, self.slope @ W.mT)


@dataclass(frozen=True)
class Gaussian:
    """A Gaussian over a growing vector: a state, then what functions make of parts of it."""

    mean: Float[Tensor, "*b J"]
    """of each entry, in its unit"""
    cov: Float[Tensor, "*b J J"]
    """of all entries"""

    @property
    def width(self) -> int:
        """J."""
        return self.mean.shape[-1]

    def part(self, entries: Sequence[int]) -> tuple[Float[Tensor, "*b D"], Float[Tensor, "*b D D"]]:
        """Mean and covariance of some entries."""
        chosen = list(entries)
        return self.mean[..., chosen], self.cov[..., chosen, :][..., chosen]

    def joined(self, entries: Sequence[int], image: Image) -> Gaussian:
        """The vector with the function's outputs behind it, as if all were Gaussian together.

        An entry z is correlated with y through the function's inputs x: cov(z, y) = cov(z, x) V.

        Reference: DFR on trajectory prediction: the chain of cross-covariances.
        """
        cross = self.cov[..., list(entries)] @ image.slope
        upper = torch.cat([self.cov, cross], -1)
        lower = torch.cat([cross.mT, image.cov], -1)
        return Gaussian(torch.cat([self.mean, image.mean], -1), torch.cat([upper, lower], -2))

    def mapped(self, A: Float[Tensor, "F J"]) -> Gaussian:
        """The distribution of A z; its covariance is symmetric to the last digit."""
        cov = A @ self.cov @ A.mT
        return Gaussian(self.mean @ A.mT, 0.5 * (cov + cov.mT))


def through_sine(mean: Float[Tensor, "*b K"], cov: Float[Tensor, "*b K K"]) -> Image:
    """The moments of sin(x), entry by entry.

    With A_kl = (s_kk + s_ll) / 2,

        M_k  = exp(-s_kk / 2) sin m_k,    V_kk = exp(-s_kk / 2) cos m_k
        S_kl = 1/2 exp(-A_kl) [(exp(s_kl) - 1) cos(m_k - m_l) - (exp(-s_kl) - 1) cos(m_k + m_l)]

    The covariance s [rad^2] of the mean m [rad] may be singular or zero.

    By the moment generating function of a Gaussian at imaginary arguments.

    Reference: DFR on squashing.
    """
    variance = cov.diagonal(dim1=-2, dim2=-1)
    shrink = torch.exp(-0.5 * variance)
    A = 0.5 * (variance[..., :, None] + variance[..., None, :])
    same = _shrunk_growth(cov, A) * torch.cos(mean[..., :, None] - mean[..., None, :])
    opposite = _shrunk_growth(-cov, A) * torch.cos(mean[..., :, None] + mean[..., None, :])
    slope = torch.diag_embed(shrink * mean.cos())
    return Image(shrink * mean.sin(), 0.5 * (same - opposite), slope)


def _shrunk_growth(x: Float[Tensor, "*b"], A: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """exp(-A) (exp(x) - 1) for |x| <= A: exact for small x, and no overflow for large."""
    falling = torch.exp(-A) * torch.expm1(x.clamp(max=0.0))
    rising = -torch.exp(x - A) * torch.expm1(-x.clamp(min=0.0))
    return torch.where(x > 0, rising, falling)


def through_waves(
    mean: Float[Tensor, "*b D"],
    cov: Float[Tensor, "*b D D"],
    L: Float[Tensor, "K D"],
    shift: Float[Tensor, " K"],
    W: Float[Tensor, "E K"],
) -> Image:
    """The moments of W sin(L x + shift)."""
    inner = through_sine(mean @ L.mT + shift, L @ cov @ L.mT)
    image = Image(inner.mean, inner.cov, L.mT @ inner.slope)
    return image.mapped(W)


def through_trig(
    mean: Float[Tensor, "*b D"], cov: Float[Tensor, "*b D D"], angles: Sequence[int]
) -> Image:
    """The moments of (sin q_1, cos q_1, sin q_2, cos q_2, ...) of some entries q of x [rad].

    As cos q = sin(q + pi / 2), all are sines.
    """
    twice = [angle for angle in angles for _ in range(2)]
    L = torch.eye(mean.shape[-1], dtype=mean.dtype)[twice]
    shift = mean.new_tensor([0.0, math.pi / 2] * len(angles))
    return through_waves(mean, cov, L, shift, torch.eye(len(twice), dtype=mean.dtype))


def through_squash(
    mean: Float[Tensor, "*b U"], cov: Float[Tensor, "*b U U"], limit: Float[Tensor, " U"]
) -> Image:
    """The moments of limit (9 sin a + sin 3a) / 8, which stays within +-limit.

    Reference: DFR on squashing.
    """
    eye = torch.eye(mean.shape[-1], dtype=mean.dtype)
    L = torch.cat([eye, 3.0 * eye])
    W = torch.cat([9.0 / 8.0 * torch.diag(limit), 1.0 / 8.0 * torch.diag(limit)], 1)
    return through_waves(mean, cov, L, L.new_zeros(len(L)), W)


_LARGEST = 700.0
"""of an exponent; where one is larger, what it multiplies is below exp(-700)"""


@dataclass(frozen=True)
class Bases:
    """E functions that are sums of Gaussians: the posterior of GPs, and policies made like one.

        f_e(x) = sum_i beta_ei k_e(x, x_i)
        k_e(x, x') = v_e exp(-1/2 |x - x'|^2_W_e),    W_e = 1 / l_e^2

    With K_e^-1 beside beta = K^-1 y this is a GP's posterior: f_e then is uncertain at each x.
    """

    centres: Float[Tensor, "*b N D"]
    """x_i"""
    lengthscale: Float[Tensor, "*b E D"]
    """l, standard deviation of each bell, in the unit of the inputs"""
    variance: Float[Tensor, "*b E"]
    """v, in the squared unit of each output"""
    weights: Float[Tensor, "*b E N"]
    """beta"""
    inverse: Float[Tensor, "*b E N N"] | None = None
    """K^-1, with the noise in K; None: the functions are known"""

    @property
    def outputs(self) -> int:
        """E."""
        return self.variance.shape[-1]

    @cached_property
    def pairs(self) -> tuple[Int[Tensor, " Q"], Int[Tensor, " Q"]]:
        """All pairs of outputs a <= b."""
        first, second = torch.triu_indices(self.outputs, self.outputs)
        return first, second

    @cached_property
    def widths(self) -> Float[Tensor, "*b K D"]:
        """D_k of each output, and then of each pair."""
        a, b = self.pairs
        w = self.lengthscale.pow(-2)
        return torch.cat([1 / w, 1 / (w[..., a, :] + w[..., b, :])], -2)


def through_bases(bases: Bases, mean: Float[Tensor, "*b D"], cov: Float[Tensor, "*b D D"]) -> Image:
    """The moments of the functions at a Gaussian input; exact, but for rounding.

    All is written with the matrices

        F_k = (s + D_k)^-1,    T_k = (s^-1 + D_k^-1)^-1 = D_k F_k s

    of D_k = W_e^-1 for each output, and D_k = (W_a + W_b)^-1 for each pair of outputs: neither
    needs the inverse of s, which may be singular or zero. The noise of measurements is not added to
    S. Differentiable in all arguments.

    Raises:
        torch.linalg.LinAlgError: s is no covariance: s + D_k is not positive definite.

    Reference: DFR on exact moment matching, with q, Q and beta as there.
    Differs: S is summed as sum_ij w_ai w_bj (Q_ij / (q_ai q_bj) - 1) with the parenthesis as
        expm1, so that nothing cancels where s is small.
    """
    E, (a, b), D = bases.outputs, bases.pairs, bases.widths
    cov = 0.5 * (cov + cov.mT)  # so that its gradient is symmetric too
    L = torch.linalg.cholesky(cov[..., None, :, :] + torch.diag_embed(D))
    F = torch.cholesky_inverse(L)
    T = D[..., None] * (F @ cov[..., None, :, :])
    # log |I + s D^-1|
    log_det = 2 * L.diagonal(dim1=-2, dim2=-1).log().sum(-1) - D.log().sum(-1)

    # q_ei = E[k_e(x, x_i)] = v_e |I + s W_e|^-1/2 exp(-1/2 nu_i^T F_e nu_i),  nu_i = x_i - m
    nu = (bases.centres - mean[..., None, :])[..., None, :, :]
    r = nu @ F[..., :E, :, :]
    exponent = (r * nu).sum(-1) + log_det[..., :E, None]
    q = bases.variance[..., None] * torch.exp(-0.5 * exponent)
    w = bases.weights * q

    # delta_ij = log(E[k_a(x, x_i) k_b(x, x_j)] / (q_ai q_bj)), with z = W nu:
    #     1/2 z_ai^T (T_ab - T_a) z_ai + 1/2 z_bj^T (T_ab - T_b) z_bj + z_ai^T T_ab z_bj
    #     + 1/2 (log |.|_a + log |.|_b - log |.|_ab)
    z = nu / D[..., :E, None, :]
    own = (z @ T[..., :E, :, :] * z).sum(-1)
    za, zb = z[..., a, :, :], z[..., b, :, :]
    zaT, zbT = za @ T[..., E:, :, :], zb @ T[..., E:, :, :]
    constant = log_det[..., a] + log_det[..., b] - log_det[..., E:]
    column = 0.5 * ((zaT * za).sum(-1) - own[..., a, :] + constant[..., None])
    row = 0.5 * ((zbT * zb).sum(-1) - own[..., b, :])
    delta = zaT @ zb.mT + column[..., :, None] + row[..., None, :]

    # S_ab = cov of the means, and on the diagonal E[v - k^T K^-1 k]
    mass = w[..., a, :, None] * w[..., b, None, :]
    left = torch.zeros_like(log_det[..., E:])
    if bases.inverse is not None:
        (same,) = torch.where(a == b)
        known = bases.inverse * (q[..., :, None] * q[..., None, :])
        mass = mass.index_add(-3, same, known, alpha=-1.0)
        left = left.index_add(-1, same, bases.variance - known.sum((-2, -1)))
    S = (mass * torch.expm1(delta.clamp(max=_LARGEST))).sum((-2, -1)) + left
    where = torch.empty(E, E, dtype=torch.long)
    where[a, b] = where[b, a] = torch.arange(len(a))
    return Image(w.sum(-1), S[..., where], (w[..., None, :] @ r).squeeze(-2).mT)


Array: TypeAlias = np.ndarray | Tensor
Moments: TypeAlias = tuple[Float[Array, "*b E"], Float[Array, "*b E E"], Float[Array, "*b D E"]]
"""M, S and V: mean and covariance of the output, cov^-1 times the input-output covariance"""


def gaussian_through_gp(
    x: Float[Array, "N D"],
    y: Float[Array, "N E"],
    lengthscale: Float[Array, "E D"],
    signal_std: Float[Array, " E"],
    noise_std: Float[Array, " E"],
    mean: Float[Array, "*b D"],
    cov: Float[Array, "*b D D"],
) -> Moments:
    """The moments of E Gaussian processes, conditioned on N samples, at a Gaussian input.

        k_e(x, x') = signal_std_e^2 exp(-1/2 sum_d ((x_d - x'_d) / lengthscale_ed)^2)

    Args:
        x: inputs of the samples.
        y: their outputs, noise included.
        lengthscale: in the units of the inputs.
        signal_std: in the units of the outputs.
        noise_std: of the samples; not added to S.
        mean: of the input; may have batch axes in front.
        cov: of the input, with as many; may be singular or zero.

    Returns:
        M (E,), S (E, E) and V (D, E), behind the batch axes.

    Raises:
        InputError: shapes do not fit one another, values are not finite, or scales not positive.
        NotPositiveDefiniteError: the samples' covariance has no Cholesky factor.

    Reference: `baselines.moments.through_bases`.
    """
    scales = {"lengthscale": lengthscale, "signal_std": signal_std, "noise_std": noise_std}
    given = _tensors(x=x, y=y, **scales, mean=mean, cov=cov)
    (N, D), E = _sizes(given["x"], "x"), _sizes(given["y"], "y")[-1]
    shapes = {"y": (N, E), "lengthscale": (E, D), "signal_std": (E,), "noise_std": (E,)}
    for name, shape in shapes.items():
        if given[name].shape != shape:
            raise InputError(
                f"{name} must have shape {shape} as the samples say, "
                f"got {tuple(given[name].shape)}."
            )
    _check_gaussian(given["mean"], given["cov"], D)
    for name in scales:
        if not bool((given[name] > 0).all()):
            raise InputError(f"{name} must be positive, got {given[name].tolist()}.")
    bases = _posterior(*(given[name] for name in ("x", *shapes)))
    return _as_given(through_bases(bases, given["mean"], given["cov"]), x, y, mean, cov)


def gaussian_through_trig(
    mean: Float[Array, "*b D"], cov: Float[Array, "*b D D"], angle_indices: Sequence[int]
) -> Moments:
    """The moments of the sine and the cosine of each of some angles, at a Gaussian input.

    Args:
        mean: of the input; angles in rad.
        cov: of the input; may be singular or zero.
        angle_indices: which of its entries are angles.

    Returns:
        M, S and V of (sin q_1, cos q_1, sin q_2, cos q_2, ...), behind the batch axes.

    Raises:
        InputError: shapes do not fit one another, values are not finite, or no such entry.
    """
    given = _tensors(mean=mean, cov=cov)
    width = _check_gaussian(given["mean"], given["cov"])
    angles = [int(index) for index in angle_indices]
    if any(not 0 <= index < width for index in angles):
        raise InputError(f"angle_indices must be within 0..{width - 1}, got {angles}.")
    return _as_given(through_trig(given["mean"], given["cov"], angles), mean, cov)


def gaussian_through_squash(
    mean: Float[Array, "*b U"], cov: Float[Array, "*b U U"], limit: float | Float[Array, " U"]
) -> Moments:
    """The moments of limit (9 sin a + sin 3a) / 8, entry by entry, at a Gaussian input.

    Args:
        mean: of a [-].
        cov: of a [-]; may be singular or zero.
        limit: largest magnitude of each entry, or of all, in the unit of the output.

    Returns:
        M, S and V, behind the batch axes.

    Raises:
        InputError: shapes do not fit one another, or values are not finite.
    """
    given = _tensors(mean=mean, cov=cov, limit=limit)
    width = _check_gaussian(given["mean"], given["cov"])
    if given["limit"].shape not in ((), (width,)):
        raise InputError(
            f"limit must be one number or {width}, got shape {tuple(given['limit'].shape)}."
        )
    limits = given["limit"].expand(width)
    return _as_given(through_squash(given["mean"], given["cov"], limits), mean, cov, limit)


def _posterior(X: Tensor, Y: Tensor, lengthscale: Tensor, signal: Tensor, noise: Tensor) -> Bases:
    """The posterior of GPs, differentiable in all of it."""
    scaled = X / lengthscale[:, None, :]
    distance = scaled[:, :, None, :] - scaled[:, None, :, :]
    K = signal.square()[:, None, None] * torch.exp(-0.5 * distance.square().sum(-1))
    names = [f"output {e}" for e in range(len(signal))]
    inverse = torch.cholesky_inverse(cholesky(add_to_diagonal(K, noise.square()), names))
    weights = (inverse @ Y.mT[..., None]).squeeze(-1)
    return Bases(X, lengthscale, signal.square(), weights, inverse)


def _tensors(**arguments: Any) -> dict[str, Tensor]:
    """Each argument in float64; raises InputError where one is not finite numbers."""
    found = {}
    for name, value in arguments.items():
        try:
            tensor = torch.as_tensor(value, dtype=torch.float64)
        except (TypeError, ValueError, RuntimeError) as error:
            raise InputError(f"{name} must be an array of numbers, got {value!r}.") from error
        if not bool(tensor.isfinite().all()):
            raise InputError(f"{name} must be finite, got {tensor.tolist()}.")
        found[name] = tensor
    return found


def _sizes(array: Tensor, name: str) -> tuple[int, ...]:
    if array.ndim != 2 or 0 in array.shape:
        raise InputError(f"{name} must have 2 axes, none empty, got {tuple(array.shape)}.")
    return tuple(array.shape)


def _check_gaussian(mean: Tensor, cov: Tensor, width: int | None = None) -> int:
    """The width of a Gaussian; raises InputError where mean and covariance do not fit."""
    found = mean.shape[-1] if mean.ndim else 0
    if found == 0 or cov.shape != (*mean.shape, found) or found != (width or found):
        raise InputError(
            f"mean and cov must have shapes (..., {width or 'D'}) and (..., {width or 'D'}, "
            f"{width or 'D'}), got {tuple(mean.shape)} and {tuple(cov.shape)}."
        )
    return found


def _as_given(image: Image, *arguments: Any) -> Any:
    """M, S and V as tensors where an argument was one, else as arrays."""
    moments = image.mean, image.cov, image.slope
    if any(isinstance(argument, Tensor) for argument in arguments):
        return moments
    return tuple(part.numpy() for part in moments)
