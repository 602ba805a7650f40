"""Equations of motion written out by hand: M(q) q'' = forces; an independent check of plants."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import fields
from typing import ClassVar, Self

import numpy as np
from jaxtyping import Float

from mcpilco.plant import Plant
from tests.reference.collocation import integrate

Input = float | np.ndarray
"""one input for all states, or an array that broadcasts with them"""


class EquationsOfMotion(ABC):
    """A system of J joints that one input moves; a state is [q1, q1', q2, q2', ...]."""

    plant: ClassVar[Callable[[], Plant]]
    """the same system as a plant, which has the numbers"""

    @classmethod
    def nominal(cls, **constants: float) -> Self:
        """The system with the constants of its plant, but for those given."""
        values = cls.plant().values
        return cls(**{f.name: values[f.name] for f in fields(cls)} | constants)

    @property
    def width(self) -> int:
        """X, how many states there are."""
        return len(type(self).plant().layout.states)

    @abstractmethod
    def mass_matrix(self, q: Float[np.ndarray, "*b J"]) -> Float[np.ndarray, "*b J J"]:
        """M(q)."""

    @abstractmethod
    def forces(
        self, q: Float[np.ndarray, "*b J"], dq: Float[np.ndarray, "*b J"], force: Input
    ) -> Float[np.ndarray, "*b J"]:
        """The right-hand side of M(q) q'' = forces [N or N m]."""

    @abstractmethod
    def potential(self, q: Float[np.ndarray, "*b J"]) -> Float[np.ndarray, "*b"]:
        """Potential energy, 0 with every pole level [J]."""

    def accelerations(
        self, q: Float[np.ndarray, "*b J"], dq: Float[np.ndarray, "*b J"], force: Input
    ) -> Float[np.ndarray, "*b J"]:
        """q'' = M(q)^-1 forces [m/s^2 or rad/s^2]."""
        return _solve(self.mass_matrix(q), self.forces(q, dq, force))

    def derivative(
        self, states: Float[np.ndarray, "*b X"], force: Input
    ) -> Float[np.ndarray, "*b X"]:
        """The time derivative of each state.

        Args:
            states: [q1, q1', q2, q2', ...] [m or rad, m/s or rad/s].
            force: the input, in its unit.
        """
        q, dq = states[..., 0::2], states[..., 1::2]
        return _interleave(dq, self.accelerations(q, dq, force))

    def advance(
        self, states: Float[np.ndarray, "*b X"], force: Input, duration: float, samples: int = 1
    ) -> Float[np.ndarray, "T *b X"]:
        """The motion under a held input at T equally spaced times, exact to rounding.

        Raises:
            EnvError: the motion is too fast or too stiff to follow.
        """

        def accelerations(q: np.ndarray, dq: np.ndarray) -> np.ndarray:
            return self.accelerations(q, dq, force)

        return _interleave(
            *integrate(accelerations, states[..., 0::2], states[..., 1::2], duration, samples)
        )

    def energy(self, states: Float[np.ndarray, "*b X"]) -> Float[np.ndarray, "*b"]:
        """Kinetic and potential energy [J]."""
        q, dq = states[..., 0::2], states[..., 1::2]
        kinetic = 0.5 * np.einsum("...i,...ij,...j->...", dq, self.mass_matrix(q), dq)
        return kinetic + self.potential(q)


def _solve(
    M: Float[np.ndarray, "*b J J"], tau: Float[np.ndarray, "*b J"]
) -> Float[np.ndarray, "*b J"]:
    """M^-1 tau; by Cramer's rule for two joints, where a general solver takes far longer."""
    joints = tau.shape[-1]
    if joints == 1:
        return tau / M[..., 0]
    if joints > 2:
        return np.linalg.solve(M, tau[..., None])[..., 0]
    (m11, m12, m22), (t1, t2) = (
        (M[..., 0, 0], M[..., 0, 1], M[..., 1, 1]),
        (tau[..., 0], tau[..., 1]),
    )
    ddq = np.empty_like(tau)
    ddq[..., 0] = m22 * t1 - m12 * t2
    ddq[..., 1] = m11 * t2 - m12 * t1
    return ddq / (m11 * m22 - m12**2)[..., None]


def _interleave(
    positions: Float[np.ndarray, "*b J"], velocities: Float[np.ndarray, "*b J"]
) -> Float[np.ndarray, "*b X"]:
    """[q1, q1', q2, q2', ...] from [q1, q2, ...] and [q1', q2', ...]."""
    states = np.empty((*positions.shape[:-1], 2 * positions.shape[-1]))
    states[..., 0::2], states[..., 1::2] = positions, velocities
    return states
