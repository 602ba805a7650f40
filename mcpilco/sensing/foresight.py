"""What a policy of a late actuator will be told: states that a model expects from noisy ones.

Particles are rolled out in the model of an actuator that answers at once: their states are those in
which inputs act. On the system these states are not measured in time. A policy is told what the
model expects of them from a measurement that is as old as the delay, and that differs from them by
what happened since and was not expected, and by what the way has made of the measurement's noise.
Policies that were searched as if they were told the states themselves answer such differences too
strongly.

On the system predictions are better than here, for they begin at what all measurements say of a
state, the model learns in the episode, and part of a step is not a whole one: a policy is searched
for more errors than it will meet.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.dynamics import Delay, GPDynamics
from mcpilco.sensing.state_predictor import for_each


@dataclass(frozen=True, eq=False)
class Foresight:
    """A sensor with noise, and the prediction behind it of the states in which inputs will act.

    With x~_k what is expected of a state by the measurement of k steps before,

        x~_0 = x + noise,    x~_k of the next step = f(x~_(k-1), u),    f the mean of the model,

    a policy is told x~_d, the delay d rounded up to whole steps.

    It remembers x~_0, ... x~_d in one row. What is expected when an episode begins are the states
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
        return memory[..., -X:], memory

    def after(
        self, memory: Float[Tensor, "*b M"], inputs: Float[Tensor, "*b U"]
    ) -> Float[Tensor, "*b M"]:
        """What is expected of the next states, behind a place for their measurement."""
        X = len(self.noise_std)
        asked = memory.unflatten(-1, (-1, X))[..., :-1, :]
        following = self.dynamics.expected(asked, for_each(asked, inputs)).flatten(-2)
        return torch.cat([memory[..., :X], following], -1)
