from .body import TERMS, BaseParameters, RigidBody, base_parameters, chain_of_json, random_motions
from .consistency import LinkCheck, check_links, inertia_of, pseudo_inertia
from .identified import (
    ALL_METHODS,
    PROJECTIONS,
    Estimate,
    Identified,
    Recipe,
    estimate,
    identify,
    solve,
)
from .motion import JointMotion, encoder_noise, local_cubics, motion_cutoff, zero_phase
from .projection import Projection, from_virtual, project, project_virtual, to_virtual
from .robot_model import Feedback, write_identified_mjcf
from .rows import Rows, force_errors, simulated_regressor

__all__ = [
    "ALL_METHODS",
    "PROJECTIONS",
    "TERMS",
    "BaseParameters",
    "Estimate",
    "Feedback",
    "Identified",
    "JointMotion",
    "LinkCheck",
    "Projection",
    "Recipe",
    "RigidBody",
    "Rows",
    "base_parameters",
    "chain_of_json",
    "check_links",
    "encoder_noise",
    "estimate",
    "force_errors",
    "from_virtual",
    "identify",
    "inertia_of",
    "local_cubics",
    "motion_cutoff",
    "project",
    "project_virtual",
    "pseudo_inertia",
    "random_motions",
    "simulated_regressor",
    "solve",
    "to_virtual",
    "write_identified_mjcf",
    "zero_phase",
]
