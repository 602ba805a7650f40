"""What a regression found, and whether it came to an end of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float


@dataclass(frozen=True)
class Solution:
    """Coefficients of y = X b."""

    b: Float[np.ndarray, " D"]
    converged: bool = True
    """whether the search stopped by its own tolerance; a closed form always does"""
    iterations: int = 0
    """of the search; 0 of a closed form"""
