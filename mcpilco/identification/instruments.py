"""Linear regression by instrumental variables: columns that go with the inputs, not their noise.

Where z is correlated with t and not with the noise of x = t + g and y, (Z^T X)^-1 Z^T y finds b
without any size of noise being known.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from mcpilco.identification.solution import Solution
from mcpilco.typing import InputError


def instrumental_variables(
    X: Float[np.ndarray, "N D"],
    y: Float[np.ndarray, " N"],
    Z: Float[np.ndarray, "N D"],
    rank: float = 1e-6,
) -> Float[np.ndarray, " D"]:
    """b of Z^T (y - X b) = 0; of least size where Z and X leave several.

    Args:
        X: inputs with noise.
        y: output.
        Z: instruments, a column for each input: X of a simulation, or of another repetition of the
            same motion.
        rank: singular value, relative to the largest in columns of equal length, below which a
            direction is not used.
    """
    if X.shape != Z.shape or len(X) != len(y):
        raise InputError(
            f"an instrument for each input and a row for each y were expected, got X {X.shape}, "
            f"Z {Z.shape} and {len(y)} rows."
        )
    x, z = (np.maximum(np.linalg.norm(A, axis=0), 1e-300) for A in (X, Z))
    U, values, Vt = np.linalg.svd((Z / z).T @ (X / x))
    used = values > rank * values[0]
    return Vt[used].T @ (U[:, used].T @ ((Z / z).T @ y) / values[used]) / x


def refine(
    X: Float[np.ndarray, "N D"],
    y: Float[np.ndarray, " N"],
    simulate: Callable[[Float[np.ndarray, " D"]], Float[np.ndarray, "N D"]],
    start: Float[np.ndarray, " D"],
    steps: int = 20,
    tolerance: float = 1e-4,
) -> Solution:
    """Instruments from a simulation with the parameters found so far, until they come to rest.

    Args:
        X: regressor of the recording's rows.
        y: measured forces [N or N m].
        simulate: the regressor of a simulated motion under the same controller and references,
            with given parameters: a motion without noise.
        start: parameters of the first simulation.
        steps: most simulations.
        tolerance: change of the forces X b, relative to their size, at which it ends.

    Reference: Janot, Vandanjon, Gautier, A generic instrumental variable approach for industrial
        robot identification (IDIM-IV), IEEE Transactions on Control Systems Technology 22 (1),
        2014.
    """
    b = start
    for step in range(1, steps + 1):
        found = instrumental_variables(X, y, simulate(b))
        change = np.linalg.norm(X @ (found - b))
        b = found
        if change <= tolerance * np.linalg.norm(X @ b):
            return Solution(b, True, step)
    return Solution(b, False, steps)
