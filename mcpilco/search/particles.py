"""Particles: the policy in the model, in plain torch.

This is the algorithm as it reads in the thesis (section 5.4.1); `mcpilco.search.fused` computes
the same numbers faster.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.policies import Dropout
from mcpilco.search.limits import Limits
from mcpilco.sensing import Observer
from mcpilco.typing import Cost, Dynamics, Policy, UncertainDynamics, WidenableCost


@dataclass(frozen=True)
class Particles:
    """P sampled trajectories of T steps."""

    states: Float[Tensor, "T_plus_1 P X"]
    """the start, and the state after each step"""
    inputs: Float[Tensor, "T P U"]
    """what the policy answered before each step"""


@dataclass(frozen=True)
class Sensing:
    """The measurements of a rollout, where the policy does not see the particles' states."""

    observer: Observer
    """a sensor, and the estimator behind it"""
    noise: Float[Tensor, "T P Y"]
    """standard normal numbers of the measurements"""


def rollout(
    dynamics: Dynamics,
    policy: Policy,
    start: Float[Tensor, "P X"],
    noise: Float[Tensor, "T P E"],
    dropout: Dropout | None = None,
    sensing: Sensing | None = None,
) -> Particles:
    """The particles' trajectories; gradients flow to the policy's parameters.

    Noise is standard normal, one row a step: its length is the horizon. `dropout` is a mask of the
    policy's bases, which sees the particles' states. With `sensing` it acts on state estimates, as
    it will on the system: each particle is measured with noise, and carries the estimator's memory
    with its state. So a policy learns to live with noise and delay.

    Reference: thesis section 5.4.1; with `sensing`, Amadio et al., IEEE Transactions on Robotics
    38 (6), 2022 (MC-PILCO4PMS).
    """
    states, inputs = [start], []
    observer = None if sensing is None else sensing.observer
    memory = None if observer is None else observer.estimator.begin(start)
    for step, normal in enumerate(noise):
        seen = states[-1]
        if observer is not None and sensing is not None:
            measured = observer.measured(seen, sensing.noise[step])
            seen, memory = observer.estimator.observe(measured, memory)
        inputs.append(policy(seen, dropout, step))
        if observer is not None:
            memory = observer.estimator.after(memory, inputs[-1])
        states.append(dynamics.step(states[-1], inputs[-1], normal))
    return Particles(torch.stack(states), torch.stack(inputs))


RolloutFunction = Callable[..., Particles]
"""`rollout`, or anything that computes the same of the same arguments"""


@dataclass(frozen=True)
class Problem:
    """The expected cost over the horizon of particles in a model, as a function of the policy."""

    dynamics: Dynamics | UncertainDynamics
    """the model, or the distribution that a model is drawn from for each rollout"""
    cost: Cost
    """of a state and the input before it"""
    start_mean: Float[Tensor, " X"]
    """where particles start, in each state's unit"""
    start_std: Float[Tensor, " X"]
    """spread of their starts, in each state's unit"""
    horizon: int
    """T [steps]"""
    reference_cost: float
    """mean cost of a step without a policy, the measure of failure [-]"""
    rollout: RolloutFunction
    """how particles are rolled out"""
    observer: Observer | None = None
    """measures the particles for the policy; None: it sees their states"""
    correlation: float = 0.0
    """of a particle's noise in successive steps, in [0, 1) [-]"""
    judged: int | None = None
    """how many entries of a particle's state are the system's; past inputs are behind them"""
    limits: Limits | None = None
    """that a policy must be predicted to keep; None: there are none"""
    easier: Callable[[float], Dynamics | UncertainDynamics] | None = None
    """dynamics on the way to these, of the share of the way, where there are some that are easier;
    see `mcpilco.search.search`"""

    def particles(
        self, policy: Policy, count: int, generator: torch.Generator, dropout: Dropout | None = None
    ) -> Particles:
        """`count` particles from fresh random numbers."""
        normal, noise = self.normals(count, generator)
        dynamics = self.dynamics
        if (uncertain := self._uncertain) is not None:
            dynamics = uncertain.draw(count, generator)
        start = self.start_mean + self.start_std * normal
        if self.observer is None:
            return self.rollout(dynamics, policy, start, noise, dropout)
        errors = _normal(generator, self.horizon, count, self.observer.noise_dim)
        sensing = Sensing(self.observer, errors)
        return self.rollout(dynamics, policy, start, noise, dropout, sensing)

    def normals(
        self, count: int, generator: torch.Generator
    ) -> tuple[Float[Tensor, "P X"], Float[Tensor, "T P E"]]:
        """Fresh standard normal numbers for the starts and for the steps of `count` particles.

        Those of a particle's steps are correlated, as a model's errors are at neighbouring states:
        drawn anew they would cancel along the way, and a policy that lives on that fails.
        """
        start = _normal(generator, count, len(self.start_mean))
        noise = _normal(generator, self.horizon, count, self.dynamics.noise_dim)
        return start, _correlated(noise, self.correlation)

    def on_the_way(self, share: float) -> Problem:
        """The same in dynamics that are on the way to these; at the share 1, in these."""
        assert self.easier is not None, "there is no way"
        dynamics = self.easier(share) if share < 1.0 else self.dynamics
        return dataclasses.replace(self, dynamics=dynamics, easier=None)

    def widened(self, factor: float) -> Problem:
        """The same with a wider cost, where the cost knows what that is."""
        if factor == 1.0 or (cost := self._widenable) is None:
            return self
        return dataclasses.replace(self, cost=cost.widened(factor))

    @cached_property  # a protocol is asked once, for the question takes 0.1 ms
    def _uncertain(self) -> UncertainDynamics | None:
        return self.dynamics if isinstance(self.dynamics, UncertainDynamics) else None

    @cached_property
    def _widenable(self) -> WidenableCost | None:
        return self.cost if isinstance(self.cost, WidenableCost) else None

    def costs(self, particles: Particles) -> Float[Tensor, "T P"]:
        """Cost of each particle at the end of each step [-]; no policy can change the start's."""
        return self.cost(particles.states[1:, :, : self.judged], particles.inputs)


def _correlated(white: Float[Tensor, "T P E"], correlation: float) -> Float[Tensor, "T P E"]:
    """Noise of the same variance in which each step resembles the one before, from white noise.

    e_t = r e_(t-1) + sqrt(1 - r^2) w_t: an autoregressive process of first order.
    """
    if correlation == 0.0:
        return white
    fresh = math.sqrt(1 - correlation**2)
    steps = [white[0]]
    for w in white[1:]:
        steps.append(correlation * steps[-1] + fresh * w)
    return torch.stack(steps)


def _normal(generator: torch.Generator, *shape: int) -> Tensor:
    """Standard normal numbers, on the generator's device."""
    device = generator.device
    return torch.randn(*shape, generator=generator, dtype=torch.float64, device=device)
