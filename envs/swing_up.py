"""The task of a swing-up, for a batch of systems: everything but the bookkeeping of episodes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from jaxtyping import Float

from envs.checks import read_array, require_positive
from envs.judge import UprightJudge, looks
from envs.motion import CorrectedMotion, Motion, NominalMotion
from envs.system import System
from mcpilco.plant import Plant
from mcpilco.task import TaskSpec
from mcpilco.typing import Cost, InputError


@dataclass(frozen=True, kw_only=True)
class SwingUp:
    """What the envs of a system, single and vector, have in common."""

    dynamics: System
    """what is simulated"""
    input_limit: float
    """largest input in either direction, in its unit"""
    dt: float
    """time for which an input is held [s]"""
    start_std: tuple[float, ...]
    """standard deviation of each state at the start, in its unit"""
    noise_std: tuple[float, ...]
    """standard deviation of each state's measurement noise, in its unit"""
    cost: Cost
    """of (states, inputs); the reward is 1 - cost"""
    links: tuple[int, ...]
    """which states are the angles of the links, each relative to the one before it, that must be
    upright: the first at pi, the others at 0 [rad]"""
    cart: int | None = None
    """which state is the position of a cart [m]; None where there is none"""
    plant: Plant | None = None
    """the system with the effects that it is corrected by; None follows the equations of motion"""
    measured: tuple[int, ...] | None = None
    """which states are observed; None: all"""

    def __post_init__(self) -> None:
        name, unit = self.dynamics.input_name, self.dynamics.input_unit
        require_positive(f"{name}_limit", self.input_limit, unit)
        require_positive("dt", self.dt, "s")
        if not callable(self.cost):
            raise InputError(
                "cost must be callable on (states, inputs), as a "
                f"mcpilco.policies.costs.SaturatingCost is, got {self.cost!r}."
            )

    @property
    def width(self) -> int:
        """X, how many states there are."""
        return len(self.dynamics.state_names)

    @cached_property
    def task(self) -> TaskSpec:
        """What an agent must know."""
        return TaskSpec(
            state_names=self.dynamics.state_names,
            state_units=self.dynamics.state_units,
            input_names=(self.dynamics.input_name,),
            input_units=(self.dynamics.input_unit,),
            dt=self.dt,
            angles=self.dynamics.angles,
            velocities=tuple((q, q + 1) for q in range(0, self.width, 2)),
            start_mean=(0.0,) * self.width,
            start_std=self.start_std,
            cost=self.cost,
            measured=self.measured,
            measurement_std=self._measurement_std,
        )

    @property
    def _measurement_std(self) -> tuple[float, ...] | None:
        """Noise of the states observed, where these are a part and all have some."""
        stds = tuple(self.noise_std[i] for i in self.measured or ())
        return stds if stds and min(stds) > 0 else None

    @cached_property
    def observation_space(self) -> Box:
        """Any finite measurement."""
        bound = float(np.finfo(np.float32).max)
        return Box(-bound, bound, (len(self.task.measured_states),), np.float64)

    @cached_property
    def action_space(self) -> Box:
        """The input, in its unit."""
        return Box(-self.input_limit, self.input_limit, (1,), np.float32)

    @property
    def samples(self) -> int:
        """How many times the true state is looked at in one step."""
        return looks(self.dt)

    @property
    def sample_s(self) -> float:
        """Time between two looks at the true state [s]."""
        return self.dt / self.samples

    def start(self, rng: np.random.Generator, *batch: int) -> Float[np.ndarray, "*b X"]:
        """States drawn from the distribution at the start of an episode."""
        return np.asarray(self.start_std) * rng.standard_normal((*batch, self.width))

    def motion(self, *batch: int) -> Motion:
        """So many systems, in the state 0."""
        if self.plant is None:
            return NominalMotion(self.dynamics, self.dt, self.samples, batch)
        return CorrectedMotion(self.plant, self.dt, self.samples, batch)

    def observe(self, motion: Motion, rng: np.random.Generator) -> Float[np.ndarray, "*b Y"]:
        """The states as measured, with noise: all, or those observed."""
        seen = motion.measured
        noisy = seen + np.asarray(self.noise_std) * rng.standard_normal(seen.shape)
        return noisy if self.measured is None else noisy[..., list(self.measured)]

    def inputs(self, actions: Float[np.ndarray, "*b 1"], *batch: int) -> Float[np.ndarray, "*b"]:
        """The inputs that actions stand for, clipped to the limit, in the input's unit.

        Raises:
            InputError: another shape than (*batch, 1), or NaN.
        """
        inputs = np.asarray(actions, dtype=np.float64)
        if inputs.shape != (*batch, 1) or np.isnan(inputs).any():
            name, unit = self.dynamics.input_name, self.dynamics.input_unit
            raise InputError(
                f"An action must hold the {name} [{unit}] in the shape {(*batch, 1)} and no NaN, "
                f"got {actions!r}."
            )
        return np.asarray(np.clip(inputs[..., 0], -self.input_limit, self.input_limit))

    def reward(
        self, states: Float[np.ndarray, "*b X"], inputs: Float[np.ndarray, "*b"]
    ) -> Float[np.ndarray, "*b"]:
        """1 - cost of the true states after a step and of the inputs held in it [-]."""
        with torch.no_grad():
            cost = self.cost(torch.as_tensor(states), torch.as_tensor(inputs[..., None]))
        return np.asarray(1.0 - cost.numpy())

    def judge(self, *batch: int) -> UprightJudge:
        """A judge of so many systems that has seen nothing yet."""
        return UprightJudge(self.sample_s, batch, links=self.links, cart=self.cart)


def read_start(
    options: dict[str, Any] | None, *shapes: tuple[int, ...]
) -> Float[np.ndarray, "*b X"] | None:
    """The state that the options of `reset` ask for, or None.

    Raises:
        InputError: an unknown option, or a state that is not finite numbers in one of the shapes.
    """
    unknown = set(options or ()) - {"state"}
    if unknown:
        raise InputError(f'reset knows the option "state", got {sorted(unknown)}.')
    if not options:
        return None
    return read_array('the option "state"', options["state"], *shapes)
