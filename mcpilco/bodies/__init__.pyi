from .chain import HINGE, SLIDE, Body, Chain, Chains, Matrix, Vector, distinct_rows, stack
from .compiled import INLINED, INNER, scratch
from .differentiable import torch_regressor
from .motion import (
    INERTIAL,
    accelerations,
    generalised_forces,
    inertial_parameters,
    mass_matrix,
    regressor,
)
from .planar import accelerate

__all__ = [
    "HINGE",
    "INERTIAL",
    "INLINED",
    "INNER",
    "SLIDE",
    "Body",
    "Chain",
    "Chains",
    "Matrix",
    "Vector",
    "accelerate",
    "accelerations",
    "distinct_rows",
    "generalised_forces",
    "inertial_parameters",
    "mass_matrix",
    "regressor",
    "scratch",
    "stack",
    "torch_regressor",
]
