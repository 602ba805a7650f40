from .chain import HINGE, SLIDE, Body, Chain, Chains, Matrix, Vector, distinct_rows, stack
from .compiled import INLINED, INNER, factorise, scratch, solve
from .differentiable import torch_regressor
from .motion import (
    INERTIAL,
    accelerations,
    generalised_forces,
    inertial_parameters,
    mass_matrix,
    regressor,
)
from .pack_arrays import as_packs
from .packs import (
    LANES,
    anywhere,
    count,
    everywhere,
    lane,
    lanes_of,
    where,
    with_lane,
)
from .planar import accelerate, assemble

__all__ = [
    "HINGE",
    "INERTIAL",
    "INLINED",
    "INNER",
    "LANES",
    "SLIDE",
    "Body",
    "Chain",
    "Chains",
    "Matrix",
    "Vector",
    "accelerate",
    "accelerations",
    "anywhere",
    "as_packs",
    "assemble",
    "count",
    "distinct_rows",
    "everywhere",
    "factorise",
    "generalised_forces",
    "inertial_parameters",
    "lane",
    "lanes_of",
    "mass_matrix",
    "regressor",
    "scratch",
    "solve",
    "stack",
    "torch_regressor",
    "where",
    "with_lane",
]
