"""The policies of S seeds in one set of arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from mcpilco.policies import SumOfGaussians
from mcpilco.search.batched.powers import powers
from mcpilco.search.batched.transfer import Movable


@dataclass(frozen=True)
class Frame(Movable):
    """What policies of one task share: their view of a state, and the bounds of their inputs."""

    plain: Int[Tensor, " plain"]
    """components of the state that are no angle"""
    angles: Int[Tensor, " angles"]
    """components that are"""
    order: Int[Tensor, " X"]
    """where each component stands in [plain, angles]"""
    centre: Float[Tensor, " U"]
    """middle of the bounds, in the env's unit"""
    half_range: Float[Tensor, " U"]
    """half their distance, in the env's unit"""
    scale: Float[Tensor, ""]
    """of the tanh's argument [-]"""

    @classmethod
    def of(cls, policy: SumOfGaussians) -> Frame:
        """The frame of a policy."""
        plain = torch.tensor(policy.augmentation.plain, dtype=torch.int64)
        angles = torch.tensor(policy.augmentation.angles, dtype=torch.int64)
        return cls(
            plain=plain,
            angles=angles,
            order=torch.cat([plain, angles]).argsort(),
            centre=policy.squash.centre,
            half_range=policy.squash.half_range,
            scale=torch.tensor(policy.squash.scale, dtype=torch.float64),
        )

    def augmented(self, states: Float[Tensor, "*b X"]) -> Float[Tensor, "*b Z"]:
        """z = [components that are no angle, cosines, sines]."""
        angles = states[..., self.angles]
        return torch.cat([states[..., self.plain], angles.cos(), angles.sin()], -1)

    def chained(
        self, rows: Float[Tensor, "*b R Z"], states: Float[Tensor, "*b X"]
    ) -> Float[Tensor, "*b R X"]:
        """Rows times dz/dx."""
        angles = states[..., None, self.angles]
        sizes = [len(self.plain), len(self.angles), len(self.angles)]
        plain, cosines, sines = rows.split(sizes, -1)
        turned = sines * angles.cos() - cosines * angles.sin()
        return torch.cat([plain, turned], -1)[..., self.order]

    def squash(self, a: Float[Tensor, "*b U"]) -> Float[Tensor, "*b U"]:
        """u = centre + half_range tanh(a / scale)."""
        return self.centre + self.half_range * torch.tanh(a / self.scale)

    def squash_slope(self, inputs: Float[Tensor, "*b U"]) -> Float[Tensor, "*b U"]:
        """du/da, from u."""
        tangent = (inputs - self.centre) / self.half_range
        return self.half_range / self.scale * (1.0 - tangent.square())


@dataclass(frozen=True)
class PolicyBatch(Movable):
    """S policies; their parameters are learned, all else is constant."""

    frame: Frame
    """what they share"""
    centres: Float[Tensor, "S B Z"]
    """c, in the units of z"""
    log_lengthscale: Float[Tensor, "S Z"]
    """log l"""
    weights: Float[Tensor, "S B U"]
    """w"""

    @classmethod
    def of(cls, policies: Sequence[SumOfGaussians]) -> PolicyBatch:
        """The policies of seeds that learn the same task; gradients flow to their parameters."""
        return cls(
            frame=Frame.of(policies[0]),
            centres=torch.stack([policy.centres for policy in policies]),
            log_lengthscale=torch.stack([policy.log_lengthscale for policy in policies]),
            weights=torch.stack([policy.weights for policy in policies]),
        )

    @property
    def parameters(self) -> tuple[Tensor, Tensor, Tensor]:
        """What is learned."""
        return self.centres, self.log_lengthscale, self.weights

    def flat(self) -> Float[Tensor, "S numbers"]:
        """All that is learned, a row for each seed; a copy."""
        return torch.cat([part.detach().flatten(1) for part in self.parameters], 1)

    def holding(self, flat: Float[Tensor, "S numbers"]) -> PolicyBatch:
        """Policies like these with the numbers of `flat`; gradients flow to their parameters."""
        shapes = [part.shape[1:] for part in self.parameters]
        rows = flat.detach().split([shape.numel() for shape in shapes], 1)
        views = (row.unflatten(1, shape) for row, shape in zip(rows, shapes, strict=True))
        return PolicyBatch(self.frame, *(view.requires_grad_() for view in views))

    def arrays(self) -> PolicyArrays:
        """What a time step needs of the parameters."""
        inv_square = torch.exp(-2 * self.log_lengthscale)[:, None]
        tilt = 2 * inv_square * self.centres
        constant = -(inv_square * self.centres.square()).sum(-1, keepdim=True)
        columns = torch.cat([constant, tilt, -inv_square.expand_as(tilt)], -1)
        pulling = (
            self.weights[..., None] * torch.cat([torch.ones_like(constant), tilt], -1)[:, :, None]
        )
        return PolicyArrays(
            self.frame, columns.mT.contiguous(), pulling.flatten(-2), 2 * inv_square[:, None]
        )


@dataclass(frozen=True)
class PolicyArrays:
    """Policies as two products with a squashing between them."""

    frame: Frame
    exponents: Float[Tensor, "S one_plus_two_Z B"]
    """from the powers of z to the exponents of the bases"""
    pulling: Float[Tensor, "S B U_times_one_plus_Z"]
    """from activations to sum_b w_b phi_b [1, 2 c_b / l^2]"""
    curvature: Float[Tensor, "S 1 1 Z"]
    """2 / l^2"""

    def activations(self, z: Float[Tensor, "S P Z"]) -> Float[Tensor, "S P B"]:
        """phi, in (0, 1] but for rounding."""
        return (powers(z) @ self.exponents).exp_()

    def inputs(
        self, z: Float[Tensor, "S P Z"], phi: Float[Tensor, "S P B"]
    ) -> tuple[Float[Tensor, "S P U"], Float[Tensor, "S P U Z"]]:
        """u, and du/dz.

        da/dz_d = sum_b w_b phi_b 2 c_bd / l_d^2 - 2 z_d / l_d^2 a,    a = sum_b w_b phi_b
        """
        pulls = (phi @ self.pulling).unflatten(-1, (-1, 1 + z.shape[-1]))
        a, pull = pulls[..., :1], pulls[..., 1:]
        u = self.frame.squash(a[..., 0])
        slope = self.frame.squash_slope(u)[..., None]
        return u, slope * (pull - self.curvature * z[..., None, :] * a)


def parameter_gradients(
    policies: PolicyBatch, moments: Float[Tensor, "S B U one_plus_two_Z"]
) -> tuple[Tensor, Tensor, Tensor]:
    """Gradients of centres, log-lengthscales and weights, from the moments sum phi da [1, z, z^2].

    dphi_b/dc_bd = 2 phi_b (z_d - c_bd) / l_d^2,   dphi_b/dlog l_d = 2 phi_b (z_d - c_bd)^2 / l_d^2
    """
    c, log_lengthscale, weights = policies.parameters
    width = c.shape[-1]
    mass, first, second = (weights[..., None] * moments).sum(-2).split([1, width, width], -1)
    factor = 2 * torch.exp(-2 * log_lengthscale)
    centres = factor[:, None] * (first - c * mass)
    scales = factor * (second - 2 * c * first + c.square() * mass).sum(1)
    return centres, scales, moments[..., 0]
