"""PILCO's policy: the mean of a Gaussian process through a few points, squashed by sines."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

from baselines.moments.image import Bases
from mcpilco.dynamics import AngleAugmentation
from mcpilco.policies import Bounds, Dropout, Squash

POINT_STD = 0.01
"""noise of the points that the mean goes through, in parts of the prior's standard deviation [-]"""


class SineSquash(Squash):
    """u = centre + half_range (9 sin a + sin 3a) / 8: any number becomes an input within bounds.

    Reference: DFR (see `baselines.moments.image`). Differs: PILCO's bounds are symmetric.
    """

    def __init__(self, low: Bounds, high: Bounds) -> None:
        super().__init__(low, high, scale=1.0)

    def forward(self, a: Float[Tensor, "*b U"]) -> Float[Tensor, "*b U"]:
        return self.centre + self.half_range * (9.0 * a.sin() + (3.0 * a).sin()) / 8.0


class GPMean(nn.Module):
    """The mean of a Gaussian process on the augmented state z, squashed into the input's bounds.

        a(z) = k(z, C) (k(C, C) + s^2 I)^-1 t,    k(z, z') = exp(-1/2 |(z - z') / l|^2)

    Centres C, targets t and lengthscales l are trained: of 10 centres for the cart-pole 65 numbers.

    Reference: DFR on nonlinear controllers, a deterministic Gaussian process.
    """

    def __init__(
        self, augmentation: AngleAugmentation, low: Bounds, high: Bounds, centres: int
    ) -> None:
        """A policy that always answers the middle of its bounds; `randomise` gives it a start.

        Inputs go from `low` to `high`, in the env's unit; `centres` is B, the number of points.

        Raises:
            InputError: the bounds are not finite or not ordered.
        """
        super().__init__()
        self.augmentation = augmentation
        self.squash = SineSquash(low, high)
        inputs, width = len(low), augmentation.width
        self.centres = nn.Parameter(torch.zeros(centres, width, dtype=torch.float64))
        self.targets = nn.Parameter(torch.zeros(centres, inputs, dtype=torch.float64))
        self.log_lengthscale = nn.Parameter(torch.zeros(inputs, width, dtype=torch.float64))

    @torch.no_grad()
    def randomise(
        self,
        states: Float[Tensor, "B X"],
        lengthscale: Float[Tensor, " Z"],
        target_std: float,
        generator: torch.Generator,
    ) -> None:
        """Draw a new start in place."""
        self.centres.copy_(self.augmentation(states))
        normal = torch.randn(self.targets.shape, generator=generator, dtype=torch.float64)
        self.targets.copy_(target_std * normal)
        self.log_lengthscale.copy_(lengthscale.log().expand_as(self.log_lengthscale))

    def bases(self) -> Bases:
        """a as a sum of Gaussians around the centres, differentiable in the parameters."""
        lengthscale = self.log_lengthscale.exp()
        scaled = self.centres / lengthscale[:, None, :]
        K = torch.exp(-0.5 * (scaled[:, :, None, :] - scaled[:, None, :, :]).square().sum(-1))
        noise = POINT_STD**2 * torch.eye(len(self.centres), dtype=K.dtype)
        weights = torch.linalg.solve(K + noise, self.targets.mT)
        return Bases(self.centres, lengthscale, K.new_ones(len(K)), weights)

    def forward(
        self, states: Float[Tensor, "*b X"], dropout: Dropout | None = None, step: int = 0
    ) -> Float[Tensor, "*b U"]:
        """The inputs for a set of states, in the env's unit; there is no dropout."""
        bases = self.bases()
        z = self.augmentation(states)[..., None, None, :]
        distance = (z - bases.centres) / bases.lengthscale[:, None, :]
        k = torch.exp(-0.5 * distance.square().sum(-1))
        return self.squash((k * bases.weights).sum(-1))
