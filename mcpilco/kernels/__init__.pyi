from .base import (
    ActiveDims,
    Canonical,
    Kernel,
    NoCanonicalFormError,
    Positive,
    Product,
    Scaled,
    Sum,
    Term,
    mean_square,
    typical_size,
)
from .decaying_lags import SEDMPK
from .mechanical import GIP, Kind, Kinematic, NestedKinematic
from .monomials import MonomialBasis, Monomials
from .polynomial import MPK, Linear
from .rescaled import Gate, HardGate, Rescaled, SmoothGate
from .stationary import RBF
from .volterra import VolterraKernel, symmetric
from .weighted_lags import IPK, PK, VolterraMPK

__all__ = [
    "GIP",
    "IPK",
    "MPK",
    "PK",
    "RBF",
    "SEDMPK",
    "ActiveDims",
    "Canonical",
    "Gate",
    "HardGate",
    "Kernel",
    "Kind",
    "Kinematic",
    "Linear",
    "MonomialBasis",
    "Monomials",
    "NestedKinematic",
    "NoCanonicalFormError",
    "Positive",
    "Product",
    "Rescaled",
    "Scaled",
    "SmoothGate",
    "Sum",
    "Term",
    "VolterraKernel",
    "VolterraMPK",
    "mean_square",
    "symmetric",
    "typical_size",
]
