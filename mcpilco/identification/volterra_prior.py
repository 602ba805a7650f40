"""Which Volterra series is looked for, and with which prior."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from mcpilco.gp import GP, WeightSpaceGP
from mcpilco.kernels import IPK, PK, SEDMPK, MonomialBasis, VolterraKernel, VolterraMPK
from mcpilco.typing import InputError

KERNELS: Mapping[str, Callable[[int, int, Sequence[int], int], VolterraKernel]] = {
    "pk": lambda width, degree, batch, channels: PK(width, degree, batch),
    "ipk": lambda width, degree, batch, channels: IPK(width, degree, batch),
    "mpk": lambda width, degree, batch, channels: VolterraMPK(width, degree, batch),
    "sed-mpk": lambda width, degree, batch, channels: SEDMPK(
        width, degree, batch, channels=channels
    ),
    "sed-mpk-hierarchical": lambda width, degree, batch, channels: SEDMPK(
        width, degree, batch, channels=channels, hierarchical=True
    ),
}
"""priors by name: of width, degree, batch and channels"""

MANY_ORDERS = 10**6
"""entries of a covariance over all orders of the lags, beyond which it is not written out"""


@dataclass(frozen=True)
class VolterraConfig:
    """What series, with which prior, and how it is fitted."""

    lags: int = 20
    """m: outputs depend on the inputs of so many samples before, and of now"""
    degree: int = 3
    """r: of the polynomials"""
    kernel: str = "sed-mpk"
    """a key of `KERNELS`"""
    center: bool = False
    """develop the series about the inputs' means, in place of zero"""
    noise_floor: float = 1e-3
    """least standard deviation of the noise, in parts of the output's root mean square [-]"""
    fit_samples: int = 1000
    """as many samples, drawn at random, determine the hyperparameters; the evidence is theirs"""
    samples: int = 4000
    """as many determine the series where matrices of the monomials would be larger"""
    restarts: int = 0
    """further starts of the optimiser"""
    max_iterations: int = 500
    """of each start"""
    tolerance: float = 1e-7
    """stop once a step improves the evidence by less than this part of it [-]"""
    seed: int = 0
    """of what is drawn"""

    def __post_init__(self) -> None:
        if self.kernel not in KERNELS:
            raise InputError(f"kernel must be one of {', '.join(KERNELS)}, got {self.kernel!r}.")
        for name, least in (("lags", 0), ("degree", 1), ("fit_samples", 1), ("samples", 1)):
            if getattr(self, name) < least:
                raise InputError(f"{name} must be at least {least}, got {getattr(self, name)}.")
        if not 0.0 < self.noise_floor < 1.0:
            raise InputError(f"noise_floor must lie between 0 and 1, got {self.noise_floor}.")


def prior(config: VolterraConfig, outputs: Sequence[str], channels: int, samples: int) -> GP:
    """A GP of the config's kernel, in weight space where that is the smaller one.

    Args:
        config: which series and prior.
        outputs: their names.
        channels: how many inputs.
        samples: how many there are to fit to.
    """
    width = channels * (config.lags + 1)
    kernel = KERNELS[config.kernel](width, config.degree, (len(outputs),), channels)
    full = isinstance(kernel, SEDMPK)
    orders = width ** (config.degree * (2 if full else 1))
    features = MonomialBasis.size(width, config.degree)
    small = features < min(samples, config.fit_samples) and orders <= MANY_ORDERS
    kind = WeightSpaceGP if small else GP
    return kind(kernel, noise_floor=config.noise_floor, names=outputs)
