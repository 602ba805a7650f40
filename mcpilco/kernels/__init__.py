"""Covariance functions and their algebra."""

from mcpilco.kernels.base import (
    ActiveDims,
    Canonical,
    Kernel,
    NoCanonicalFormError,
    Product,
    Scaled,
    Sum,
    Term,
)
from mcpilco.kernels.decaying_lags import SEDMPK
from mcpilco.kernels.geometric import GIP
from mcpilco.kernels.kinematic import Kinematic, NestedKinematic
from mcpilco.kernels.polynomial import MPK, Linear
from mcpilco.kernels.rescaled import Gate, HardGate, Rescaled, SmoothGate
from mcpilco.kernels.stationary import RBF
from mcpilco.kernels.volterra import VolterraKernel
from mcpilco.kernels.weighted_lags import IPK, PK, VolterraMPK

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
    "Kinematic",
    "Linear",
    "NestedKinematic",
    "NoCanonicalFormError",
    "Product",
    "Rescaled",
    "Scaled",
    "SmoothGate",
    "Sum",
    "Term",
    "VolterraKernel",
    "VolterraMPK",
]
