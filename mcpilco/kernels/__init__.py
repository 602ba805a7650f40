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
from mcpilco.kernels.kinematic import Kinematic, NestedKinematic
from mcpilco.kernels.polynomial import MPK, Linear
from mcpilco.kernels.rescaled import Gate, HardGate, Rescaled, SmoothGate
from mcpilco.kernels.stationary import RBF

__all__ = [
    "GIP",
    "MPK",
    "RBF",
    "ActiveDims",
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
]
