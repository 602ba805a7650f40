"""Equations of motion of a plant as a program that torch and compiled loops can follow.

`chain` has the equations of rigid bodies for numbers of any kind, `program` makes arrays of what
they leave on a tape, `step` writes one sampling interval of a plant, and `features` writes
regressors that physics and friction suggest. `step` and `features` know plants and so load numba,
which a `Program` does not need.
"""

__all__: list[str] = []
