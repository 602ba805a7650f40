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
from mcpilco.kernels.geometric import GIP
from mcpilco.kernels.polynomial import MPK, Linear
from mcpilco.kernels.stationary import RBF

__all__ = [
    "GIP",
    "MPK",
    "RBF",
    "ActiveDims",
    "Kernel",
    "Linear",
    "NoCanonicalFormError",
    "Product",
    "Scaled",
    "Sum",
    "Term",
]
