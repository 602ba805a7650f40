"""What a policy of a late actuator will be told: states that a model expects from noisy ones.

Particles are rolled out in the model of an actuator that answers at once: their states are those in
which inputs act. On the system these states are not measured in time. A policy is told what the
model expects of them from a measurement that is as old as the delay, and that differs from them by
what happened since and was not expected, and by what the way has made of the measurement's noise.
Policies that were searched as if they were told the states themselves answer such differences too
strongly.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.delay import Delay
from mcpilco.dynamics import GPDynamics


@dataclass(frozen=True, eq=False)
class Foresight:
    """A sensor with noise, and the prediction behind it of the states in which inputs will act.

    With x~_k what is expected of a state by the measurement of k steps before,

        x~_0 = x + noise,    x~_k of the next step = f(x~_(k-1), u),    f the mean of the model,

    a policy is told x~_d, which for a delay of d = w + p steps is (1 - p) x~_w + p x~_(w+1).

    It remembers x~_0, x~_1, ... in one row. What is expected when an episode begins are the states
    where it does.
    """

    dynamics: GPDynamics
    """the model of an actuator that answers at once"""
    delay: Delay
    noise_std: Float[Tensor, " X"]
    """of each state's measurement, in its unit"""

    @property
    def noise_dim(self) -> int:
        """X: one standard normal number for each measurement."""
        return len(self.noise_std)

    @property
    def shares(self) -> Float[Tensor, " M"]:
        """Of x~_0, x~_1, ... in what a policy is told [-]."""
        shares = self.noise_std.new_zeros(self.delay.memory + 1)
        shares[self.delay.whole] = 1.0 - self.delay.part
        if self.delay.part:
            shares[self.delay.whole + 1] = self.delay.part
        return shares

    def begin(self, states: Float[Tensor, "*b X"]) -> Float[Tensor, "*b M"]:
        """What is remembered before the first measurement of an episode that starts there."""
        return states.repeat(*[1] * (states.ndim - 1), self.delay.memory + 1)

    def observe(
        self,
        states: Float[Tensor, "*b X"],
        noise: Float[Tensor, "*b X"],
        memory: Float[Tensor, "*b M"],
    ) -> tuple[Float[Tensor, "*b X"], Float[Tensor, "*b M"]]:
        """What a policy is told of the states, and what to remember.

        Args:
            states: those in which the next inputs will act.
            noise: standard normal numbers of their measurement.
            memory: of `begin`, or of the step before.
        """
        X = states.shape[-1]
        memory = torch.cat([states + self.noise_std * noise, memory[..., X:]], -1)
        expected = memory.unflatten(-1, (-1, X))
        return (self.shares[:, None] * expected).sum(-2), memory

    def after(
        self, memory: Float[Tensor, "*b M"], inputs: Float[Tensor, "*b U"]
    ) -> Float[Tensor, "*b M"]:
        """What is expected of the next states, behind a place for their measurement."""
        X = len(self.noise_std)
        expected = memory.unflatten(-1, (-1, X))
        asked = expected[..., :-1, :]
        told = inputs[..., None, :].expand(*asked.shape[:-1], -1)
        following = self.dynamics.expected(asked, told).flatten(-2)
        return torch.cat([memory[..., :X], following], -1)
