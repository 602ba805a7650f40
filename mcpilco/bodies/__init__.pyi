from .chain import HINGE, SLIDE, Body, Chain, Chains, Matrix, Vector, stack
from .compiled import INLINED, factorise, linearise, scratch, solve
from .differentiable import torch_regressor
from .motion import accelerations, generalised_forces, mass_matrix
from .planar import linearise_in_plane
from .regressors import INERTIAL, inertial_parameters, regressor

__all__ = [
    "HINGE",
    "INERTIAL",
    "INLINED",
    "SLIDE",
    "Body",
    "Chain",
    "Chains",
    "Matrix",
    "Vector",
    "accelerations",
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
