from .body import (
    TERMS,
    BaseParameters,
    LinkCheck,
    RigidBody,
    base_parameters,
    check_links,
    inertia_of,
    pseudo_inertia,
    random_motions,
)
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
from .plant_fit import correction_of_identified, theta_of
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
    "LinkCheck",
    "Projection",
    "Recipe",
    "RigidBody",
    "Rows",
    "base_parameters",
    "check_links",
    "correction_of_identified",
    "estimate",
    "force_errors",
    "from_virtual",
    "identify",
    "inertia_of",
    "project",
    "project_virtual",
    "pseudo_inertia",
    "random_motions",
    "simulated_regressor",
    "solve",
    "theta_of",
    "to_virtual",
    "write_identified_mjcf",
]
