"""The image of a Gaussian under a function, and how such functions follow one another.

    x ~ N(m, s),   y = f(x):   M = E[y],   S = cov(y),   V = s^-1 cov(x, y)

V is defined for singular s too: by Stein's lemma it is E[df/dx].

Reference: Deisenroth, Fox & Rasmussen, IEEE Transactions on Pattern Analysis and Machine
Intelligence 37 (2), 2015 (PILCO; here: DFR), on exact moment matching.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor


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
