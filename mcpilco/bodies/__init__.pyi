from .chain import HINGE, SLIDE, Body, Chain, Chains, Matrix, Vector, distinct_rows, stack
from .compiled import INLINED, INNER, factorise, linearise, linearise_in_plane, scratch, solve
from .differentiable import torch_regressor
from .motion import (
    INERTIAL,
    accelerations,
    generalised_forces,
    inertial_parameters,
    mass_matrix,
    regressor,
)

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
    "accelerations",
    "distinct_rows",
    "factorise",
    "generalised_forces",
    "inertial_parameters",
    "linearise",
    "linearise_in_plane",
    "mass_matrix",
    "regressor",
    "scratch",
    "solve",
    "stack",
    "torch_regressor",
]
