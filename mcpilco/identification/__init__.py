"""Physical parameters of a robot from its recordings."""

from mcpilco.identification.base_parameters import BaseParameters, base_parameters
from mcpilco.identification.bayesian import (
    NoisyInputConfig,
    NoisyInputFit,
    UnidentifiedWarning,
    fit_noisy_inputs,
)
from mcpilco.identification.consistency import LinkCheck, check
from mcpilco.identification.errors_in_variables import errors_in_variables
from mcpilco.identification.identified_mjcf import write_identified_mjcf
from mcpilco.identification.identify import Identified, identify
from mcpilco.identification.input_noise import noise_above, noise_of_repetitions
from mcpilco.identification.instruments import instrumental_variables, refine
from mcpilco.identification.joint_motion import (
    JointMotion,
    encoder_noise,
    local_cubics,
    motion_cutoff,
    zero_phase,
)
from mcpilco.identification.methods import METHODS
from mcpilco.identification.moments import Moments
from mcpilco.identification.projection import Projection, project
from mcpilco.identification.recipe import (
    ALL_METHODS,
    PROJECTIONS,
    Estimate,
    Recipe,
    estimate,
    solve,
)
from mcpilco.identification.rigid_body import TERMS, RigidBody, motions, rigid_body
from mcpilco.identification.rows import Rows, force_errors
from mcpilco.identification.solution import Solution
from mcpilco.identification.virtual import from_virtual, project_virtual, to_virtual
from mcpilco.identification.volterra import VolterraModel, fit_volterra
from mcpilco.identification.volterra_file import load_volterra, save_volterra
from mcpilco.identification.volterra_prior import VolterraConfig
from mcpilco.identification.volterra_systems import fit_percent, third_order, wiener
from mcpilco.recordings import Segment, Series, load_robot, read_robot, read_series

__all__ = [
    "ALL_METHODS",
    "METHODS",
    "PROJECTIONS",
    "TERMS",
    "BaseParameters",
    "Estimate",
    "Identified",
    "JointMotion",
    "LinkCheck",
    "Moments",
    "NoisyInputConfig",
    "NoisyInputFit",
    "Projection",
    "Recipe",
    "RigidBody",
    "Rows",
    "Segment",
    "Series",
    "Solution",
    "UnidentifiedWarning",
    "VolterraConfig",
    "VolterraModel",
    "base_parameters",
    "check",
    "encoder_noise",
    "errors_in_variables",
    "estimate",
    "fit_noisy_inputs",
    "fit_percent",
    "fit_volterra",
    "force_errors",
    "from_virtual",
    "identify",
    "instrumental_variables",
    "load_robot",
    "load_volterra",
    "local_cubics",
    "motion_cutoff",
    "motions",
    "noise_above",
    "noise_of_repetitions",
    "project",
    "project_virtual",
    "read_robot",
    "read_series",
    "refine",
    "rigid_body",
    "save_volterra",
    "solve",
    "third_order",
    "to_virtual",
    "wiener",
    "write_identified_mjcf",
    "zero_phase",
]
