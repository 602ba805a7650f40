"""A system is what an env simulates: named states, one named input, and how they move."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import ClassVar

import numpy as np
from jaxtyping import Float

Input = float | Float[np.ndarray, "..."]
"""one input for all states, or an array that broadcasts with them"""


class System(ABC):
    """A system of J joints that one input moves; a state is [q1, q1', q2, q2', ...].

    Every method takes any batch of states.
    """

    state_names: ClassVar[tuple[str, ...]]
    """of q1, q1', q2, q2', ..."""
    state_units: ClassVar[tuple[str, ...]]
    """one for each state"""
    input_name: ClassVar[str]
    """of the input"""
    input_unit: ClassVar[str]
    """of the input"""
    angles: ClassVar[tuple[int, ...]]
    """which states are angles [rad]"""

    @abstractmethod
    def advance(
        self, states: Float[np.ndarray, "*b X"], force: Input, duration: float, samples: int = 1
    ) -> Float[np.ndarray, "T *b X"]:
        """The motion under a constant input, at T = `samples` equally spaced times up to the end.

        Args:
            states: where the motion starts [m or rad, m/s or rad/s].
            force: the input, held all the time, in its unit.
            duration: how long [s].
            samples: T, how many intermediate states to return.

        Raises:
            EnvError: the motion cannot be followed.
        """

    @abstractmethod
    def tip(self, states: Float[np.ndarray, "*b X"]) -> Float[np.ndarray, "*b 3"]:
        """Where the point is that has to go up: x to the right, z up from the hinge [m]."""
