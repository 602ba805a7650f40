"""PILCO's own cost of the cart-pole, and the expected costs of Gaussian states."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import singledispatch

import torch
from jaxtyping import Float
from torch import Tensor

from baselines.moments.image import Gaussian, through_trig, through_waves
from mcpilco.policies import QuadraticCost, SaturatingCost, TipCost
from mcpilco.typing import InputError


@dataclass(frozen=True)
class TipDistanceCost:
    """c = 1 - exp(-d^2 / (2 width^2)), d from the pole's tip to where it is up, in [0, 1] [-].

    The tip is at (p + l sin q, -l cos q), up is (0, l), with q = 0 hanging.

    Reference: Deisenroth, Efficient Reinforcement Learning using Gaussian Processes (2010),
    on the cart-pole swing-up.
    """

    cart: int
    """which state is the cart's position p [m]"""
    angle: int
    """which state is the pole's angle q [rad]"""
    length: float = 0.5
    """l, from hinge to tip [m]"""
    width: float = 0.25
    """distance at which the cost is 1 - exp(-1/2) [m]"""

    def __post_init__(self) -> None:
        if not (self.length > 0 and self.width > 0):
            raise InputError(
                "TipDistanceCost length and width must be positive [m], "
                f"got {self.length} and {self.width}."
            )

    def widened(self, factor: float) -> TipDistanceCost:
        """The same cost, `factor` times as wide."""
        return dataclasses.replace(self, width=factor * self.width)

    def __call__(
        self, states: Float[Tensor, "*b X"], inputs: Float[Tensor, "*b U"] | None = None
    ) -> Float[Tensor, "*b"]:
        """The cost of each state [-]; inputs are free."""
        q = states[..., self.angle]
        aside = states[..., self.cart] + self.length * q.sin()
        below = self.length * (1.0 + q.cos())
        return 1.0 - torch.exp(-0.5 * (aside**2 + below**2) / self.width**2)


_LEAST_VARIANCE = 1e-30
"""what stands for none where it divides"""


@singledispatch
def expected_cost(cost: object, states: Gaussian, inputs: Gaussian) -> Float[Tensor, "*b"]:
    """E[c(x, u)] for Gaussian states and the inputs before them [-], differentiable.

    Exact for `SaturatingCost` and `QuadraticCost`. `TipCost` and `TipDistanceCost` depend on sines
    and cosines of angles: these are taken as Gaussian together with the states, with the moments
    that they have, as PILCO does.

    Raises:
        InputError: the cost is of another class.
    """
    kinds = [kind.__name__ for kind in expected_cost.registry if kind is not object]
    raise InputError(
        f"An expected cost is known for {', '.join(sorted(kinds))}, got {type(cost).__name__}; "
        "give the task one of these costs."
    )


def bell(
    mean: Float[Tensor, "*b R"], cov: Float[Tensor, "*b R R"]
) -> tuple[Float[Tensor, "*b"], Float[Tensor, "*b R R"]]:
    """E[exp(-|y|^2 / 2)] for a Gaussian y [-], and (I + cov)^-1.

    Reference: DFR on the saturating cost, with the target and the widths in y.
    """
    L = torch.linalg.cholesky(cov + torch.eye(mean.shape[-1], dtype=mean.dtype))
    whitened = torch.linalg.solve_triangular(L, mean[..., None], upper=False).squeeze(-1)
    root_det = L.diagonal(dim1=-2, dim2=-1).prod(-1)
    return torch.exp(-0.5 * whitened.square().sum(-1)) / root_det, torch.cholesky_inverse(L)


@expected_cost.register
def _(cost: SaturatingCost, states: Gaussian, inputs: Gaussian) -> Float[Tensor, "*b"]:
    """1 - E[exp(-|y|^2 / 2)] of the scaled distances y = C (x - target).

    Where a component counts by its magnitude, the bell has two halves: on s > 0 it is that around
    +target, on s < 0 that around -target. Each half is the integral of a Gaussian, times the share
    of the Gaussian that the bell makes of x which lies on the side of the half.
    """
    signed = [i for i, flag in enumerate(cost.magnitude) if flag]
    if len(signed) > 1:
        raise InputError(
            "The expected SaturatingCost is known where at most one component counts by its "
            f"magnitude, got {cost.magnitude}; leave flags out."
        )
    if not signed:
        return 1.0 - _half_bell(cost, states, 1.0, None)
    right, left = (_half_bell(cost, states, side, signed[0]) for side in (1.0, -1.0))
    return 1.0 - right - left


def _half_bell(
    cost: SaturatingCost, states: Gaussian, side: float, folded: int | None
) -> Float[Tensor, "*b"]:
    """The half of the bell on one side of s = 0; the whole where no component is folded there."""
    scale = math.sqrt(2.0) / states.mean.new_tensor(cost.lengthscales)
    target = states.mean.new_tensor(cost.targets)
    if folded is not None:
        target[folded] *= side
    mean, cov = states.part(cost.components)
    y = scale * (mean - target)
    value, inverse = bell(y, scale[:, None] * cov * scale)
    if folded is None:
        return value
    # the bell makes of s a Gaussian of this mean and variance
    shared = scale * cov[..., folded, :]  # cov(y, s)
    pull = (inverse @ shared[..., None]).squeeze(-1)
    middle = mean[..., folded] - (pull * y).sum(-1)
    variance = cov[..., folded, folded] - (pull * shared).sum(-1)
    return value * torch.special.ndtr(side * middle / variance.clamp_min(_LEAST_VARIANCE).sqrt())


@expected_cost.register
def _(cost: QuadraticCost, states: Gaussian, inputs: Gaussian) -> Float[Tensor, "*b"]:
    """(m - target)^T Q (m - target) + tr(Q s), likewise for the inputs."""
    targets, weights = (states.mean.new_tensor(x) for x in (cost.targets, cost.state_weights))
    efforts = states.mean.new_tensor(cost.input_weights)
    second = (states.mean - targets) ** 2 + states.cov.diagonal(dim1=-2, dim2=-1)
    effort = inputs.mean**2 + inputs.cov.diagonal(dim1=-2, dim2=-1)
    return second @ weights + effort @ efforts


@expected_cost.register
def _(cost: TipDistanceCost, states: Gaussian, inputs: Gaussian) -> Float[Tensor, "*b"]:
    """1 - E[exp(-|y|^2 / 2)] of the scaled distances of the tip from where it is up."""
    width = states.mean.shape[-1]
    seen = states.joined(range(width), through_trig(states.mean, states.cov, (cost.angle,)))
    C = states.mean.new_zeros(2, width + 2)
    C[0, cost.cart] = 1.0
    C[0, width] = C[1, width + 1] = cost.length
    offset = C.new_tensor([0.0, cost.length]) / cost.width
    distance = seen.mapped(C / cost.width)
    return 1.0 - bell(distance.mean + offset, distance.cov)[0]


@expected_cost.register
def _(cost: TipCost, states: Gaussian, inputs: Gaussian) -> Float[Tensor, "*b"]:
    """1 - E[exp(-|y|^2 / 2)] of the scaled distances of the tip from its highest point."""
    width, joints = states.mean.shape[-1], len(cost.angles)
    lengths = states.mean.new_tensor(cost.lengths)
    # absolute angles are sums of relative ones; twice, for sines and cosines
    absolute = states.mean.new_zeros(joints, width)
    for row in range(joints):
        absolute[row, list(cost.angles[: row + 1])] = 1.0
    shift = torch.cat([lengths.new_zeros(joints), lengths.new_full((joints,), math.pi / 2)])
    W = torch.block_diag(lengths, lengths)
    image = through_waves(states.mean, states.cov, torch.cat([absolute, absolute]), shift, W)
    seen = states.joined(range(width), image)
    C = lengths.new_zeros(3, width + 2)
    C[0, width] = C[1, width + 1] = math.sqrt(2.0) / cost.lengthscale
    if cost.foot is not None:
        C[2, cost.foot] = math.sqrt(2.0) / cost.foot_lengthscale
    offset = lengths.new_tensor([0.0, math.sqrt(2.0) / cost.lengthscale * float(lengths.sum()), 0])
    distance = seen.mapped(C)
    return 1.0 - bell(distance.mean - offset, distance.cov)[0]
