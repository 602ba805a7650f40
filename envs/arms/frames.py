"""Arrays as the frames of bodies hold them."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from mcpilco.bodies import Matrix, Vector


def vector(array: Float[np.ndarray, " 3"]) -> Vector:
    """Three numbers."""
    x, y, z = map(float, array)
    return x, y, z


def matrix(array: Float[np.ndarray, "3 3"]) -> Matrix:
    """Three rows."""
    x, y, z = map(vector, array)
    return x, y, z
