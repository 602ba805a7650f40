"""Equations of motion of a double pendulum with one motor: pendubot and acrobot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from envs.plants import acrobot, pendubot
from tests.reference.equations import EquationsOfMotion, Input

UPPER, LOWER = 0, 1
"""the links, and the joints that they hang from: shoulder and elbow"""


@dataclass(frozen=True, kw_only=True)
class DoublePendulumDynamics(EquationsOfMotion):
    """A link that hangs from a shoulder, another from its end, the elbow; one joint has a motor.

    With q1 the angle of the shoulder (0 hanging, pi upright) and q2 that of the elbow, relative to
    the upper link (0 stretched), with r the distances of the centers of mass from the joints and I
    the inertias about the centers:

        [a + c + 2 h cos q2, c + h cos q2]  [q1'']   [s (2 q1' q2' + q2'^2) - g1 - b1 q1' + tau1]
        [c + h cos q2,       c           ]  [q2''] = [-s q1'^2              - g2 - b2 q2' + tau2]

        a = I1 + m1 r1^2 + m2 l1^2,    c = I2 + m2 r2^2,    h = m2 l1 r2,    s = h sin q2
        g1 = (m1 r1 + m2 l1) g sin q1 + g2,    g2 = m2 r2 g sin(q1 + q2)

    A state is [q1, q1', q2, q2'] in [rad, rad/s]. The numbers are those of the DFKI's double
    pendulum, design C.1, as its authors publish them (models 1.0 and 1.1), rounded.

    Reference: Spong and Block, The Pendubot, CDC 1995; github
    dfki-ric-underactuated-lab/double_pendulum.
    """

    motor: ClassVar[int]
    """the joint that the input drives"""

    upper_mass: float
    """m1 [kg]"""
    upper_length: float
    """l1, from shoulder to elbow [m]"""
    lower_mass: float
    """m2 [kg]"""
    lower_length: float
    """l2, from the elbow to the tip [m]"""
    shoulder_friction: float
    """b1, viscous [N m s/rad]"""
    elbow_friction: float
    """b2, viscous [N m s/rad]"""
    gravity: float
    """g [m/s^2]"""
    upper_center: float
    """r1 / l1 [-]; the elbow's motor sits at the end"""
    upper_inertia: float
    """I1 / (m1 l1^2), about the center of mass [-]"""
    lower_center: float
    """r2 / l2 [-]"""
    lower_inertia: float
    """I2 / (m2 l2^2), about the center of mass [-]"""

    def mass_matrix(self, q: Float[np.ndarray, "*b 2"]) -> Float[np.ndarray, "*b 2 2"]:
        """M(q), which the elbow's angle alone changes [kg m^2]."""
        upper, lower = self.inertias
        bent = self.coupling * np.cos(q[..., LOWER])
        M = np.empty((*q.shape, 2))
        M[..., 0, 0] = upper + lower + 2.0 * bent
        M[..., 0, 1] = M[..., 1, 0] = lower + bent
        M[..., 1, 1] = lower
        return M

    def forces(
        self, q: Float[np.ndarray, "*b 2"], dq: Float[np.ndarray, "*b 2"], force: Input
    ) -> Float[np.ndarray, "*b 2"]:
        """The right-hand side of M(q) q'' = forces [N m]."""
        upper_weight, lower_weight = self.weights
        shoulder, elbow = dq[..., UPPER], dq[..., LOWER]
        spin = self.coupling * np.sin(q[..., LOWER])
        lower_torque = lower_weight * np.sin(q[..., UPPER] + q[..., LOWER])
        upper_torque = upper_weight * np.sin(q[..., UPPER]) + lower_torque
        tau = np.empty_like(q)
        tau[..., UPPER] = spin * elbow * (2.0 * shoulder + elbow) - upper_torque
        tau[..., LOWER] = -spin * shoulder**2 - lower_torque
        tau -= np.array([self.shoulder_friction, self.elbow_friction]) * dq
        tau[..., self.motor] += force
        return tau

    def potential(self, q: Float[np.ndarray, "*b 2"]) -> Float[np.ndarray, "*b"]:
        """Potential energy, 0 with both links level [J]."""
        upper, lower = self.weights
        return -upper * np.cos(q[..., UPPER]) - lower * np.cos(q[..., UPPER] + q[..., LOWER])

    def elbow(self, states: Float[np.ndarray, "*b 4"]) -> Float[np.ndarray, "*b 3"]:
        """Where the elbow is: x to the right, z up from the shoulder [m]."""
        return _hanging(self.upper_length, states[..., 0])

    def tip(self, states: Float[np.ndarray, "*b 4"]) -> Float[np.ndarray, "*b 3"]:
        """Where the lower link ends: x to the right, z up from the shoulder [m]."""
        angle = np.asarray(states[..., 0] + states[..., 2])
        return self.elbow(states) + _hanging(self.lower_length, angle)

    @property
    def reach(self) -> float:
        """l1 + l2, how high the tip is when both links stand [m]."""
        return self.upper_length + self.lower_length

    @property
    def inertias(self) -> tuple[float, float]:
        """a and c: of all about the shoulder but the lower link's own, of it about the elbow."""
        m1, l1, m2, l2 = self.upper_mass, self.upper_length, self.lower_mass, self.lower_length
        upper = m1 * l1**2 * (self.upper_inertia + self.upper_center**2) + m2 * l1**2
        return upper, m2 * l2**2 * (self.lower_inertia + self.lower_center**2)

    @property
    def coupling(self) -> float:
        """h = m2 l1 r2 [kg m^2]."""
        return self.lower_mass * self.upper_length * self.lower_center * self.lower_length

    @property
    def weights(self) -> tuple[float, float]:
        """(m1 r1 + m2 l1) g and m2 r2 g, the torques that hold the links level [N m]."""
        upper = (self.upper_mass * self.upper_center + self.lower_mass) * self.upper_length
        lower = self.lower_mass * self.lower_center * self.lower_length
        return upper * self.gravity, lower * self.gravity


class PendubotDynamics(DoublePendulumDynamics):
    """A double pendulum with a motor in its shoulder; the elbow is free."""

    plant: ClassVar = staticmethod(pendubot)
    motor: ClassVar = UPPER


class AcrobotDynamics(DoublePendulumDynamics):
    """A double pendulum with a motor in its elbow; the shoulder is free."""

    plant: ClassVar = staticmethod(acrobot)
    motor: ClassVar = LOWER


def _hanging(length: float, angle: Float[np.ndarray, "*b"]) -> Float[np.ndarray, "*b 3"]:
    """The end of a link of this length, 0 hanging, relative to its joint [m]."""
    return length * np.stack([np.sin(angle), np.zeros_like(angle), -np.cos(angle)], axis=-1)
