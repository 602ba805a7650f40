"""Moments of arrays: the public entries, which check what comes in.

Arrays in, arrays out. Where an argument is a torch tensor the results are tensors, and gradients
flow to every argument that asks for them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from baselines.moments.image import Bases, Image, through_bases, through_squash, through_trig
from mcpilco.gp import add_to_diagonal, cholesky
from mcpilco.typing import InputError

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
