"""Equations of motion of a pendulum with a motor in its hinge."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from envs.plants import pendulum
from tests.reference.equations import EquationsOfMotion, Input


@dataclass(frozen=True, kw_only=True)
class PendulumDynamics(EquationsOfMotion):
    """A mass on a rod without weight, friction in its hinge, and a motor's torque there.

    With q the angle (0 hanging, pi upright) and tau the torque:

        m l^2 q'' = tau - b q' - m g l sin q

    A state is [q, q'] in [rad, rad/s].
    """

    plant: ClassVar = staticmethod(pendulum)

    mass: float
    """m [kg]"""
    length: float
    """l, from the hinge to the mass [m]"""
    friction: float
    """b, viscous, in the hinge [N m s/rad]"""
    gravity: float
    """g [m/s^2]"""

    def mass_matrix(self, q: Float[np.ndarray, "*b 1"]) -> Float[np.ndarray, "*b 1 1"]:
        """M(q) = m l^2, the same at every angle [kg m^2]."""
        return np.full((*q.shape, 1), self.mass * self.length**2)

    def forces(
        self, q: Float[np.ndarray, "*b 1"], dq: Float[np.ndarray, "*b 1"], force: Input
    ) -> Float[np.ndarray, "*b 1"]:
        """The right-hand side of M(q) q'' = forces [N m]."""
        tau = np.empty_like(q)
        tau[..., 0] = force - self.friction * dq[..., 0] - self.weight * np.sin(q[..., 0])
        return tau

    def potential(self, q: Float[np.ndarray, "*b 1"]) -> Float[np.ndarray, "*b"]:
        """Potential energy, 0 with the pole level [J]."""
        return -self.weight * np.cos(q[..., 0])

    def tip(self, states: Float[np.ndarray, "*b 2"]) -> Float[np.ndarray, "*b 3"]:
        """Where the mass is: x to the right, z up from the hinge [m]."""
        angle = states[..., 0]
        zero = np.zeros_like(angle)
        return self.length * np.stack([np.sin(angle), zero, -np.cos(angle)], axis=-1)

    @property
    def weight(self) -> float:
        """m g l, the torque that holds the pole level [N m]."""
        return self.mass * self.gravity * self.length
