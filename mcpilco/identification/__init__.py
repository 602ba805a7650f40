"""Physical parameters of a robot from its recordings."""

from mcpilco.identification.base_parameters import BaseParameters, base_parameters
from mcpilco.identification.consistency import LinkCheck, check
from mcpilco.identification.projection import Projection, project
from mcpilco.identification.rigid_body import TERMS, RigidBody, motions, rigid_body
from mcpilco.identification.virtual import from_virtual, project_virtual, to_virtual

__all__ = [
    "TERMS",
    "BaseParameters",
    "LinkCheck",
    "Projection",
    "RigidBody",
    "base_parameters",
    "check",
    "from_virtual",
    "motions",
    "project",
    "project_virtual",
    "rigid_body",
    "to_virtual",
]
