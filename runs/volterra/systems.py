"""Two systems whose Volterra series are known, on which methods are compared."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.signal import lfilter

from mcpilco.recordings import lagged

MEMORY = 6
"""of `third_order` [samples]"""


def third_order(u: Float[np.ndarray, " T"]) -> Float[np.ndarray, " N"]:
    """Noiseless outputs of times 6, ..., T - 1: degree 3 with few of the 119 monomials.

    Reference: thesis eq. (6.36); Spinelli, Piroddi, Lovera, 2005.
    """
    x0, x1, x2, x3, x4, x5, x6 = lagged(u[:, None], MEMORY).T
    linear = x0 + 0.6 * x1 + 0.35 * (x2 + x4) + 0.9 * x3 + 0.2 * (x5 + x6)
    quadratic = 0.25 * x0 * x1 - x1 * x2 - 0.25 * x3**2 + 0.5 * (x0**2 + x0 * x2 + x1 * x3)
    return linear + quadratic + 0.75 * x2**3


def third_order_h2() -> Float[np.ndarray, "7 7"]:
    """Its map h_2, symmetric."""
    h = np.zeros((MEMORY + 1, MEMORY + 1))
    h[0, 1], h[1, 2], h[3, 3], h[0, 0], h[0, 2], h[1, 3] = 0.25, -1.0, -0.25, 0.5, 0.5, 0.5
    return 0.5 * (h + h.T)


def wiener(u: Float[np.ndarray, " T"], degree: int) -> Float[np.ndarray, " T"]:
    """Noiseless outputs x + x^2 + ... + x^degree of a resonant filter's output x, from rest.

        x = 10 q^-1 / (1 - 1.8036 q^-1 + 0.8338 q^-2) u

    Reference: thesis eq. (6.38); Stoddard, Welsh, 2018.
    """
    x = lfilter([0.0, 10.0], [1.0, -1.8036, 0.8338], u)
    return sum(x**i for i in range(1, degree + 1))
