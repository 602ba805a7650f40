"""Equations of motion of a plant, written once: evaluated in torch, or by the compiled loops."""

from mcpilco.equations.features import features_of, friction_features, physics_features
from mcpilco.equations.program import Program
from mcpilco.equations.step import Step, numbers_of, step_of

__all__ = [
    "Program",
    "Step",
    "features_of",
    "friction_features",
    "numbers_of",
    "physics_features",
    "step_of",
]
