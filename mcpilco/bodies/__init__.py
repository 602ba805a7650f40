"""Rigid bodies on joints: open chains of hinges and slides, and their equations of motion."""

from mcpilco.bodies.chain import HINGE, SLIDE, Body, Chain, Chains, Matrix, Vector, stack
from mcpilco.bodies.motion import accelerations, generalised_forces, mass_matrix
from mcpilco.bodies.regressor import INERTIAL, inertial_parameters, regressor

__all__ = [
    "HINGE",
    "INERTIAL",
    "SLIDE",
    "Body",
    "Chain",
    "Chains",
    "Matrix",
    "Vector",
    "accelerations",
    "generalised_forces",
    "inertial_parameters",
    "mass_matrix",
    "regressor",
    "stack",
]
