"""The cost of a swing-up of the boards' double pendulum."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from realaigym.equations import Row
from realaigym.regulator import Regulator
from torch import Tensor


@dataclass(frozen=True)
class SwingCost:
    """c = (1 - n - k) (1 - exp(-d)) + n (1 - exp(-V / l)) + k (1 - exp(-2 e^2)) + efforts.

    d grows from upright with the angles, V / l = 1 is the edge of a region of the regulator, and e
    is the energy that upright lacks or exceeds, to that between hanging and upright.
    """

    plant: Row
    """the boards' pendulum"""
    regulator: Regulator
    joint: int
    """which has the motor"""
    lengthscales: tuple[float, float, float]
    """of shoulder, elbow and the lower link's angle to the vertical, in d [rad]"""
    near: float = 0.0
    """n [-]"""
    energy: float = 0.0
    """k [-]"""
    torque: float = 0.0
    """weight of u^2 [1/(N m)^2]"""
    velocity: float = 0.0
    """weight of q1'^2 + q2'^2 [s^2/rad^2]"""
    power: float = 0.0
    """weight of |u q'| of the joint with the motor [1/W]"""
    jumps: float = 0.0
    """weight of the square of u's change in a step [1/(N m)^2]"""
    anneals: bool = True
    """felt from further away in the first half of a search"""
    wide: float = 1.0
    """times the lengthscales [-]"""

    def widened(self, factor: float) -> SwingCost:
        """The same cost, felt from further away."""
        return replace(self, wide=factor) if self.anneals else self

    def __call__(
        self, states: Float[Tensor, "*b 4"], inputs: Float[Tensor, "*b 1"]
    ) -> Float[Tensor, "*b"]:
        """The cost of each state and torque [-]."""
        q1, q2 = states[..., 0], states[..., 2]
        away = (1.0 + q1.cos(), 1.0 - q2.cos(), 1.0 + (q1 + q2).cos())
        scales = (self.wide * scale for scale in self.lengthscales)
        d = torch.stack([2.0 * a / s**2 for a, s in zip(away, scales, strict=True)]).sum(0)
        cost = (1.0 - self.near - self.energy) * (1.0 - torch.exp(-d))
        if self.near:
            cost = cost + self.near * (1.0 - torch.exp(-self._squared(states) / self.wide**2))
        if self.energy:
            cost = cost + self.energy * (1.0 - torch.exp(-2.0 * self._lacking(states) ** 2))
        return cost + self._effort(states, inputs[..., 0])

    def _squared(self, states: Float[Tensor, "*b 4"]) -> Float[Tensor, "*b"]:
        """V / l = x' P x / l of the error from upright."""
        q1, v1, q2, v2 = states.unbind(-1)
        x = torch.stack(
            [torch.atan2(-q1.sin(), -q1.cos()), v1, torch.atan2(q2.sin(), q2.cos()), v2], -1
        )
        return ((x @ torch.from_numpy(self.regulator.P)) * x).sum(-1) / self.regulator.level

    def _lacking(self, states: Float[Tensor, "*b 4"]) -> Float[Tensor, "*b"]:
        """e = (energy - that of upright) / what is between hanging and upright [-]."""
        m1r1, m2r2, m2, l1, I1, I2, gravity = map(float, self.plant[:7])
        q1, v1, q2, v2 = states.unbind(-1)
        h = l1 * m2r2
        M11, M12 = I1 + I2 + m2 * l1**2 + 2.0 * h * q2.cos(), I2 + h * q2.cos()
        kinetic = 0.5 * M11 * v1**2 + M12 * v1 * v2 + 0.5 * I2 * v2**2
        upper, lower = (m1r1 + m2 * l1) * gravity, m2r2 * gravity
        height = -upper * q1.cos() - lower * (q1 + q2).cos()
        return (kinetic + height - upper - lower) / (2.0 * (upper + lower))

    def _effort(
        self, states: Float[Tensor, "*b 4"], torques: Float[Tensor, "*b"]
    ) -> Float[Tensor, "*b"]:
        speeds = states[..., 1::2]
        effort = self.torque * torques**2 + self.velocity * (speeds**2).sum(-1)
        if self.power:
            effort = effort + self.power * torch.sqrt(
                (torques * speeds[..., self.joint]) ** 2 + 0.01
            )
        if self.jumps and torques.dim() == 2:  # steps x particles
            jumps = torch.diff(torques, dim=0, prepend=torques[:1]) ** 2
            effort = effort + self.jumps * jumps
        return effort


@dataclass
class Replaceable:
    """The cost of the present stage: an env keeps the one that it is made with."""

    now: SwingCost

    def widened(self, factor: float) -> SwingCost:
        return self.now.widened(factor)

    def __call__(
        self, states: Float[Tensor, "*b 4"], inputs: Float[Tensor, "*b 1"]
    ) -> Float[Tensor, "*b"]:
        return self.now(states, inputs)
