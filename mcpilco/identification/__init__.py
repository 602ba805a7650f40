"""Physical parameters of a robot from its recordings."""

from mcpilco.identification.base_parameters import BaseParameters, base_parameters
from mcpilco.identification.rigid_body import TERMS, RigidBody, motions, rigid_body

__all__ = [
    "TERMS",
    "BaseParameters",
    "RigidBody",
    "base_parameters",
    "motions",
    "rigid_body",
]
