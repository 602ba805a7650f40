from . import known_plants
from .corrected_mjcf import (
    FAR,
    RIGID,
    SUDDEN,
    CorrectedModel,
    move_assets,
    put,
    write_corrected_mjcf,
)
from .correction import (
    Addition,
    Correction,
    corrected,
    correction_from,
    correction_of,
    read_correction,
    write_correction,
)
from .effects import CATALOGUE
from .effects.base import Probe, Scale, Symbol
from .effects.joint import TURN, DryFriction
from .effects.learned import Axis, LearnedForce, design
from .equations.chain import mass_matrix
from .equations.features import friction_features, physics_features
from .equations.number import (
    ABS,
    ADD,
    COSINE,
    DIVIDE,
    EXP,
    MAXIMUM,
    MINIMUM,
    MULTIPLY,
    SINE,
    SQRT,
    SUBTRACT,
    TANH,
    Real,
    cos,
    sin,
)
from .equations.polynomial_force import PolynomialForces
from .equations.program import Program, Rows, features_of
from .equations.step import (
    PlantStep,
    free_parameters,
    numbers_of,
    order_of,
    step_of,
    system_of,
    true_state,
)
from .known_plants import plant_for
from .mjcf import chain_of, plant_of
from .mjcf_inertials import Inertials
from .plant import Base, EffectInstance, Parameter, Plant
from .simulation.layout import Layout
from .simulation.motion import simulate
from .simulation.tables import GAIN, IDEAL_ACTUATOR, OFFSET, SCALE, Tables

__all__ = [
    "ABS",
    "ADD",
    "CATALOGUE",
    "COSINE",
    "DIVIDE",
    "EXP",
    "FAR",
    "GAIN",
    "IDEAL_ACTUATOR",
    "MAXIMUM",
    "MINIMUM",
    "MULTIPLY",
    "OFFSET",
    "RIGID",
    "SCALE",
    "SINE",
    "SQRT",
    "SUBTRACT",
    "SUDDEN",
    "TANH",
    "TURN",
    "Addition",
    "Axis",
    "Base",
    "CorrectedModel",
    "Correction",
    "DryFriction",
    "EffectInstance",
    "Inertials",
    "Layout",
    "LearnedForce",
    "Parameter",
    "Plant",
    "PlantStep",
    "PolynomialForces",
    "Probe",
    "Program",
    "Real",
    "Rows",
    "Scale",
    "Symbol",
    "Tables",
    "chain_of",
    "corrected",
    "correction_from",
    "correction_of",
    "cos",
    "design",
    "features_of",
    "free_parameters",
    "friction_features",
    "known_plants",
    "mass_matrix",
    "move_assets",
    "numbers_of",
    "order_of",
    "physics_features",
    "plant_for",
    "plant_of",
    "put",
    "read_correction",
    "simulate",
    "sin",
    "step_of",
    "system_of",
    "true_state",
    "write_corrected_mjcf",
    "write_correction",
]
