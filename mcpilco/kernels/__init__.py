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
from mcpilco.kernels.kinematic import Kinematic, NestedKinematic
from mcpilco.kernels.polynomial import MPK, Linear
from mcpilco.kernels.stationary import RBF

__all__ = [
    "MPK",
    "RBF",
    "ActiveDims",
    "Kernel",
    "Kinematic",
    "Linear",
    "NestedKinematic",
    "NoCanonicalFormError",
    "Product",
    "Scaled",
    "Sum",
    "Term",
]
