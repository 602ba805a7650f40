"""The task of a swing-up, for a batch of systems: everything but the bookkeeping of episodes."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from jaxtyping import Float

from envs.checks import read_array, read_stds, require_positive
from envs.judge import UprightJudge, looks
from envs.motion import Motion
from mcpilco.plant import ChainPlant, Correction, corrected, correction_from, read_correction
from mcpilco.task import TaskSpec
from mcpilco.typing import Cost, InputError

Effects = str | os.PathLike[str] | Mapping[str, Any] | Correction
"""a correction, its file, or what that file holds"""
Stds = float | tuple[float, ...]
"""one standard deviation for all states, or one for each"""
OWN = "dt", "start_std", "noise_std", "cost", "measured"
"""keywords of an env that are no parameters of its plant"""


@dataclass(frozen=True, kw_only=True)
class SwingUp:
    """A plant and a task for it: what the single and the vector env of a system share."""

    plant: ChainPlant
    """what moves, with the effects that it has; its state is [q1, q1', q2, q2', ...]"""
    input_limit: float
    """largest input in either direction, in its unit"""
    dt: float
    """time for which an input is held [s]"""
    start_std: Stds
    """standard deviation of each state at the start, around 0, in its unit"""
    noise_std: Stds
    """standard deviation of each state's measurement noise, in its unit"""
    cost: Cost
    """of (states, inputs); the reward is 1 - cost"""
    links: tuple[int, ...] = ()
    """which states are the angles of the links, each relative to the one before it, that must be
    upright: the first at pi, the others at 0 [rad]; without any, success is not judged"""
    cart: int | None = None
    """which state is the position of a cart [m]; None where there is none"""
    measured: tuple[int, ...] | None = None
    """which states are observed; None: all"""
    engine: Callable[[float, int, tuple[int, ...]], Motion] | None = None
    """what simulates in the plant's place: of dt [s], samples and batch; None: the plant itself"""

    def __post_init__(self) -> None:
        require_positive(self.limit_name, self.input_limit, self.input_unit)
        require_positive("dt", self.dt, "s")
        for name in ("start_std", "noise_std"):
            object.__setattr__(self, name, read_stds(name, getattr(self, name), self.width))
        if not callable(self.cost):
            raise InputError(
                "cost must be callable on (states, inputs), as a "
                f"mcpilco.policies.costs.SaturatingCost is, got {self.cost!r}."
            )

    def where(self, effects: Effects | None = None, **keywords: Any) -> SwingUp:
        """This task with other numbers, as the keywords of an env have them.

        Args:
            effects: a correction of the plant; its numbers go before those of the keywords.
            **keywords: parameters of the plant, `dt`, `start_std`, `noise_std`, `cost`, `measured`,
                and the limit of the input, `force_limit` or `torque_limit`.

        Raises:
            InputError: another keyword, a value that does not fit, or effects that the plant
                cannot have.
        """
        if self.limit_name in keywords:
            keywords["input_limit"] = keywords.pop(self.limit_name)
        own = {"input_limit", *OWN}
        constants = {name: value for name, value in keywords.items() if name not in own}
        if unknown := constants.keys() - self.plant.values.keys():
            raise InputError(
                f"{self.plant.name} has no keyword {', '.join(sorted(unknown))}; it has "
                f"{', '.join((*self.plant.values, self.limit_name, *OWN))} and effects."
            )
        plant = self.plant.where(**constants)
        if effects is not None:
            plant = corrected(plant, read_effects(effects))
        return replace(self, plant=plant, **{n: v for n, v in keywords.items() if n in own})

    @property
    def width(self) -> int:
        """X, how many states there are."""
        return len(self.plant.layout.states)

    @property
    def input_unit(self) -> str:
        """N or N m."""
        return self.plant.layout.unit_of(self.plant.layout.actuators[0])[1]

    @property
    def limit_name(self) -> str:
        """The keyword of the largest input: `force_limit` or `torque_limit`."""
        return "force_limit" if self.input_unit == "N" else "torque_limit"

    @cached_property
    def task(self) -> TaskSpec:
        """The description of the task that an agent gets."""
        layout = self.plant.layout
        return TaskSpec(
            state_names=layout.states,
            state_units=layout.units,
            input_names=layout.inputs,
            input_units=tuple(layout.unit_of(actuator)[1] for actuator in layout.actuators),
            dt=self.dt,
            angles=self.plant.angles,
            velocities=tuple((q, q + 1) for q in range(0, self.width, 2)),
            start_mean=(0.0,) * self.width,
            start_std=read_stds("start_std", self.start_std, self.width),
            cost=self.cost,
            measured=self.measured,
            measurement_std=self._measurement_std,
            goal=self._goal,
        )

    @property
    def _goal(self) -> tuple[float, ...] | None:
        """At rest with all links upright, a cart in the middle."""
        up = self.links[:1]
        return tuple(math.pi if i in up else 0.0 for i in range(self.width)) if up else None

    @property
    def _measurement_std(self) -> tuple[float, ...] | None:
        """Noise of the states observed, where these are a part and all have some."""
        every = read_stds("noise_std", self.noise_std, self.width)
        stds = tuple(every[i] for i in self.measured or ())
        return stds if stds and min(stds) > 0 else None

    @cached_property
    def observation_space(self) -> Box:
        """Any finite measurement."""
        bound = float(np.finfo(np.float32).max)
        return Box(-bound, bound, (len(self.task.measured_states),), np.float64)

    @cached_property
    def action_space(self) -> Box:
        """The inputs, in their unit."""
        inputs = len(self.plant.layout.inputs)
        return Box(-self.input_limit, self.input_limit, (inputs,), np.float32)

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
        """A batch of motions, in the state 0."""
        if self.engine is None:
            return Motion(self.plant, self.dt, self.samples, batch)
        return self.engine(self.dt, self.samples, batch)

    def observe(self, motion: Motion, rng: np.random.Generator) -> Float[np.ndarray, "*b Y"]:
        """The states as measured, with noise: all, or those observed."""
        seen = motion.measured
        noisy = seen + np.asarray(self.noise_std) * rng.standard_normal(seen.shape)
        return noisy if self.measured is None else noisy[..., list(self.measured)]

    def inputs(self, actions: Float[np.ndarray, "*b U"], *batch: int) -> Float[np.ndarray, "*b U"]:
        """The inputs that actions stand for, clipped to the limit, in the input's unit.

        Raises:
            InputError: another shape than (*batch, U), or NaN.
        """
        inputs, names = np.asarray(actions, dtype=np.float64), self.plant.layout.inputs
        if inputs.shape != (*batch, len(names)) or np.isnan(inputs).any():
            raise InputError(
                f"An action must hold the {', '.join(names)} [{self.input_unit}] in the shape "
                f"{(*batch, len(names))} and no NaN, got {actions!r}."
            )
        return np.clip(inputs, -self.input_limit, self.input_limit)

    def reward(
        self, states: Float[np.ndarray, "*b X"], inputs: Float[np.ndarray, "*b U"]
    ) -> Float[np.ndarray, "*b"]:
        """1 - cost of the true states after a step and of the inputs held in it [-]."""
        with torch.no_grad():
            cost = self.cost(torch.as_tensor(states), torch.as_tensor(inputs))
        return np.asarray(1.0 - cost.numpy())

    def judge(self, *batch: int) -> UprightJudge:
        """A judge of a batch of systems that has seen nothing yet."""
        return UprightJudge(self.sample_s, batch, links=self.links, cart=self.cart)


def read_start(
    options: dict[str, Any] | None, *shapes: tuple[int, ...]
) -> Float[np.ndarray, "*b X"] | None:
    """The state that the options of `reset` ask for, or None."""
    unknown = set(options or ()) - {"state"}
    if unknown:
        raise InputError(f'reset knows the option "state", got {sorted(unknown)}.')
    if not options:
        return None
    return read_array('the option "state"', options["state"], *shapes)


def read_effects(effects: Effects) -> Correction:
    """The correction that a user gives.

    Raises:
        InputError: it is none, no file, or no content of one.
    """
    if isinstance(effects, Correction):
        return effects
    if isinstance(effects, Mapping):
        return correction_from(dict(effects))
    if isinstance(effects, str | os.PathLike):
        return read_correction(os.fspath(effects))
    raise InputError(
        "effects must be a file such as gap/corrected.json, what such a file holds, or a "
        f"mcpilco.plant.correction.Correction, got {effects!r}."
    )
