"""The swing-up task for a batch of cart-poles: everything but the bookkeeping of episodes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from gymnasium.spaces import Box
from jaxtyping import Float

from envs.cartpole_dynamics import CartPoleDynamics
from envs.checks import require_positive
from envs.judge import SAMPLE_S
from mcpilco.task import TaskSpec
from mcpilco.typing import Cost, InputError


@dataclass(frozen=True, kw_only=True)
class SwingUp:
    """What the cart-pole envs, single and vector, have in common."""

    dynamics: CartPoleDynamics
    """equations of motion"""
    force_limit: float
    """largest force on the cart, in either direction [N]"""
    dt: float
    """time for which a force is held [s]"""
    start_std: tuple[float, ...]
    """standard deviation of the four states at the start [m, m/s, rad, rad/s]"""
    noise_std: tuple[float, ...]
    """standard deviation of the measurement noise of the four states [m, m/s, rad, rad/s]"""
    cost: Cost
    """of (states, inputs); the reward is 1 - cost"""

    def __post_init__(self) -> None:
        require_positive("force_limit", self.force_limit, "N")
        require_positive("dt", self.dt, "s")
        if not callable(self.cost):
            raise InputError(
                "cost must be callable on (states, inputs), as mcpilco.costs.cart_pole_cost() is, "
                f"got {self.cost!r}."
            )

    @cached_property
    def task(self) -> TaskSpec:
        """What an agent must know."""
        return TaskSpec(
            state_names=("cart_position", "cart_velocity", "pole_angle", "pole_velocity"),
            state_units=("m", "m/s", "rad", "rad/s"),
            input_names=("force",),
            input_units=("N",),
            dt=self.dt,
            angles=(2,),
            velocities=((0, 1), (2, 3)),
            start_mean=(0.0, 0.0, 0.0, 0.0),
            start_std=self.start_std,
            cost=self.cost,
        )

    @cached_property
    def observation_space(self) -> Box:
        """Any finite measurement."""
        bound = float(np.finfo(np.float32).max)
        return Box(-bound, bound, (4,), np.float64)

    @cached_property
    def action_space(self) -> Box:
        """The force [N]."""
        return Box(-self.force_limit, self.force_limit, (1,), np.float32)

    @property
    def samples(self) -> int:
        """How many times the true state is looked at in one step."""
        return math.ceil(self.dt / SAMPLE_S - 1e-9)

    @property
    def sample_s(self) -> float:
        """Time between two looks at the true state [s]."""
        return self.dt / self.samples

    def start(self, rng: np.random.Generator, *batch: int) -> Float[np.ndarray, "*b 4"]:
        """States drawn from the distribution at the start of an episode."""
        return np.asarray(self.start_std) * rng.standard_normal((*batch, 4))

    def observe(
        self, states: Float[np.ndarray, "*b 4"], rng: np.random.Generator
    ) -> Float[np.ndarray, "*b 4"]:
        """The states as measured, with noise."""
        return states + np.asarray(self.noise_std) * rng.standard_normal(states.shape)

    def forces(self, actions: Float[np.ndarray, "*b 1"], *batch: int) -> Float[np.ndarray, "*b"]:
        """The forces that actions stand for, clipped to the limit [N].

        Raises:
            InputError: another shape than (*batch, 1), or NaN.
        """
        forces = np.asarray(actions, dtype=np.float64)
        if forces.shape != (*batch, 1) or np.isnan(forces).any():
            raise InputError(
                f"An action must hold forces [N] in the shape {(*batch, 1)} and no NaN, "
                f"got {actions!r}."
            )
        return np.asarray(np.clip(forces[..., 0], -self.force_limit, self.force_limit))

    def advance(
        self, states: Float[np.ndarray, "*b 4"], forces: Float[np.ndarray, "*b"]
    ) -> Float[np.ndarray, "T *b 4"]:
        """One step of dt: the true states at the times at which they are looked at."""
        return self.dynamics.advance(states, forces, self.dt, self.samples)

    def reward(
        self, states: Float[np.ndarray, "*b 4"], forces: Float[np.ndarray, "*b"]
    ) -> Float[np.ndarray, "*b"]:
        """1 - cost of the true states after a step and of the forces held in it [-]."""
        with torch.no_grad():
            cost = self.cost(torch.as_tensor(states), torch.as_tensor(forces[..., None]))
        return np.asarray(1.0 - cost.numpy())
