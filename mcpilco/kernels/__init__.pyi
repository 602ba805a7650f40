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
from .lags import IPK, PK, SEDMPK, VolterraMPK
from .mechanical import GIP, Kind, Kinematic, NestedKinematic
from .polynomial import MPK, Linear, MonomialBasis, Monomials
from .rescaled import Gate, HardGate, Rescaled, SmoothGate
from .stationary import RBF
from .volterra import VolterraKernel, symmetric

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
