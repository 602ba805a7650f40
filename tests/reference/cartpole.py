"""Equations of motion of a cart with a uniform pole hinged to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from envs.plants import cart_pole
from tests.reference.equations import EquationsOfMotion, Input


@dataclass(frozen=True, kw_only=True)
class CartPoleDynamics(EquationsOfMotion):
    """A cart on a rail, a uniform pole hinged to it, and a horizontal force on the cart.

    With q1 the cart's position, q2 the pole's angle (0 hanging, pi upright), u the force, and
    a = m_p l / 2:

        [ m_c + m_p    a cos q2    ] [ q1'' ]   [ u - b q1' + a sin(q2) q2'^2 ]
        [ a cos q2     m_p l^2 / 3 ] [ q2'' ] = [ - a g sin q2                ]

    A state is [q1, q1', q2, q2'] in [m, m/s, rad, rad/s].

    Reference: Deisenroth, Efficient Reinforcement Learning using Gaussian Processes (2010),
        appendix C.2, the cart-pole of the PILCO package.
    """

    plant: ClassVar = staticmethod(cart_pole)

    cart_mass: float
    """m_c [kg]"""
    pole_mass: float
    """m_p [kg]"""
    pole_length: float
    """l, from the hinge to the tip [m]"""
    cart_friction: float
    """b, viscous, between cart and rail [N s/m]"""
    gravity: float
    """g [m/s^2]"""

    def mass_matrix(self, q: Float[np.ndarray, "*b 2"]) -> Float[np.ndarray, "*b 2 2"]:
        """M(q) [kg, kg m, kg m^2]."""
        M = np.empty((*q.shape, 2))
        M[..., 0, 0] = self.cart_mass + self.pole_mass
        M[..., 0, 1] = M[..., 1, 0] = self._moment * np.cos(q[..., 1])
        M[..., 1, 1] = self.pole_mass * self.pole_length**2 / 3.0
        return M

    def forces(
        self, q: Float[np.ndarray, "*b 2"], dq: Float[np.ndarray, "*b 2"], force: Input
    ) -> Float[np.ndarray, "*b 2"]:
        """The right-hand side of M(q) q'' = forces [N, N m]."""
        sin = np.sin(q[..., 1])
        tau = np.empty_like(q)
        tau[..., 0] = force - self.cart_friction * dq[..., 0] + self._moment * sin * dq[..., 1] ** 2
        tau[..., 1] = -self._moment * self.gravity * sin
        return tau

    def potential(self, q: Float[np.ndarray, "*b 2"]) -> Float[np.ndarray, "*b"]:
        """Potential energy, 0 with the pole level [J]."""
        return -self._moment * self.gravity * np.cos(q[..., 1])

    def tip(self, states: Float[np.ndarray, "*b 4"]) -> Float[np.ndarray, "*b 3"]:
        """Where the tip of the pole is: x along the rail, z up from the hinge [m]."""
        angle = states[..., 2]
        x = states[..., 0] + self.pole_length * np.sin(angle)
        return np.stack([x, np.zeros_like(x), -self.pole_length * np.cos(angle)], axis=-1)

    @property
    def _moment(self) -> float:
        """a = m_p l / 2, the pole's first moment of mass about the hinge [kg m]."""
        return 0.5 * self.pole_mass * self.pole_length
