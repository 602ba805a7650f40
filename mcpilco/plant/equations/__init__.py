"""Equations of motion of a plant, written once: evaluated in torch, or by the compiled loops.

`step` and `features` write them; they know plants, and so need numba, where a `Program` does not.
"""

from mcpilco.plant.equations.program import Program

__all__ = ["Program"]
