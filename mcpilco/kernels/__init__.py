"""Covariance functions and their algebra."""

from mcpilco.kernels.base import (
    ActiveDims,
    Kernel,
    NoCanonicalFormError,
    Product,
    Scaled,
    Sum,
    Term,
)
from mcpilco.kernels.decaying import SEDMPK
from mcpilco.kernels.polynomial import MPK, Linear
from mcpilco.kernels.stationary import RBF
from mcpilco.kernels.volterra import IPK, PK, VolterraKernel, VolterraMPK

__all__ = [
    "IPK",
    "MPK",
    "PK",
    "RBF",
    "SEDMPK",
    "ActiveDims",
    "Kernel",
    "Linear",
    "NoCanonicalFormError",
    "Product",
    "Scaled",
    "Sum",
    "Term",
    "VolterraKernel",
    "VolterraMPK",
]
