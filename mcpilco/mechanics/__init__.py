"""Rigid bodies on joints: open chains of hinges and slides, and their equations of motion."""

from mcpilco.mechanics.chain import HINGE, SLIDE, Body, Chain, Chains, stack
from mcpilco.mechanics.motion import accelerations, generalised_forces, mass_matrix

__all__ = [
    "HINGE",
    "SLIDE",
    "Body",
    "Chain",
    "Chains",
    "accelerations",
    "generalised_forces",
    "mass_matrix",
    "stack",
]
