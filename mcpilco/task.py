"""The description of an environment beyond its spaces."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from mcpilco.typing import Cost, InputError

if TYPE_CHECKING:
    from jaxtyping import Float
    from torch import Tensor


def unknown_cost(
    states: Float[Tensor, "*b X"], inputs: Float[Tensor, "*b U"]
) -> Float[Tensor, "*b"]:
    """Stands for the cost of a task that was read from a file.

    Raises:
        InputError: always.
    """
    raise InputError(
        "A task that was read from a file has no cost; pass the env, or a TaskSpec with a cost."
    )


@dataclass(frozen=True)
class TaskSpec:
    """Names, units and structure of the observed state, and the cost to minimise.

    An environment shows it as the attribute `task`; an agent reads `env.unwrapped.task`.
    `observed` says how the state is made of an observation that is not the state itself,
    `measured` which states it holds where it is a part of the state.
    """

    state_names: tuple[str, ...]
    """one name for each state, for example `cart_position`"""
    state_units: tuple[str, ...]
    """one unit for each state, for example `m/s`"""
    input_names: tuple[str, ...]
    """one name for each action"""
    input_units: tuple[str, ...]
    """one unit for each action"""
    dt: float
    """sampling time [s]"""
    angles: tuple[int, ...]
    """which states are angles [rad]; model and policy see their cosine and sine"""
    velocities: tuple[tuple[int, int], ...]
    """pairs (position, velocity) of states: the second is the time derivative of the first"""
    start_mean: tuple[float, ...]
    """mean of the state at reset, in each state's unit"""
    start_std: tuple[float, ...]
    """standard deviation of the state at reset, in each state's unit"""
    cost: Cost | None = None
    """differentiable cost of (states, inputs), in torch; None: learned from the rewards"""
    observed: tuple[int | tuple[int, int], ...] = ()
    """where each state is found in the observation: an index, or the pair (cosine, sine) of
    indices of an angle; (): the observation is the state. See `mcpilco.sensing.perception`"""
    measured: tuple[int, ...] | None = None
    """which states are observed, in this order; None: all. One that is not must be the velocity of
    one that is, and is estimated"""
    measurement_std: tuple[float, ...] | None = None
    """noise standard deviation of each of `measured`, in its unit; None: estimated from the first
    recording"""
    goal: tuple[float, ...] | None = None
    """state to come to and to rest in, in each state's unit, for a regulator; None: not told"""

    def __post_init__(self) -> None:
        try:
            self._check_numbers()
            self._check_structure()
            self._check_measured()
        except TypeError as error:
            raise InputError(
                f"TaskSpec has an entry of another type ({error}): dt is a number, names and units "
                "are tuples of text, angles a tuple of indices, velocities a tuple of pairs of "
                "indices, start_mean and start_std tuples of numbers."
            ) from error

    def _check_numbers(self) -> None:
        width = len(self.state_names)
        for field in ("state_units", "start_mean", "start_std"):
            if len(getattr(self, field)) != width:
                raise InputError(
                    f"TaskSpec.{field} must have one entry for each of the {width} states "
                    f"{self.state_names}, got {len(getattr(self, field))}."
                )
        if len(self.input_units) != len(self.input_names):
            raise InputError(
                "TaskSpec.input_units must have one entry for each of the inputs "
                f"{self.input_names}, got {len(self.input_units)}."
            )
        if not (self.dt > 0 and math.isfinite(self.dt)):
            raise InputError(f"TaskSpec.dt must be positive [s], got {self.dt}.")
        if not all(math.isfinite(mean) for mean in self.start_mean):
            raise InputError(f"TaskSpec.start_mean must be finite, got {self.start_mean}.")
        if not all(std >= 0 and math.isfinite(std) for std in self.start_std):
            raise InputError(
                f"TaskSpec.start_std must be finite and not negative, got {self.start_std}."
            )
        if self.goal is not None and not (
            len(self.goal) == width and all(math.isfinite(x) for x in self.goal)
        ):
            raise InputError(
                f"TaskSpec.goal must have one finite entry for each of the {width} states "
                f"{self.state_names}, got {self.goal}."
            )

    def _check_structure(self) -> None:
        width = len(self.state_names)
        self._check_observed()
        indices = [*self.angles, *(i for pair in self.velocities for i in pair)]
        outside = [i for i in indices if not 0 <= i < width]
        if outside:
            raise InputError(
                f"TaskSpec.angles and .velocities index the {width} states from 0, got {outside}."
            )
        positions = [position for position, _ in self.velocities]
        if len(set(positions)) < len(positions) or any(v in positions for _, v in self.velocities):
            raise InputError(
                "TaskSpec.velocities must give each position one velocity, which is the position "
                f"of no other pair, got {self.velocities}; leave the pair of an acceleration out."
            )
        moving = [self.state_names[v] for _, v in self.velocities if self.goal and self.goal[v]]
        if moving:
            raise InputError(
                f"TaskSpec.goal must be a state of rest, got a velocity in {', '.join(moving)}: "
                f"{self.goal}; set it to 0."
            )

    def _check_measured(self) -> None:
        if self.measured is None:
            if self.measurement_std is not None:
                raise InputError(
                    "TaskSpec.measurement_std belongs to states measured in part; "
                    "name them in TaskSpec.measured, or leave it out."
                )
            return
        known = {*self.measured, *(v for q, v in self.velocities if q in self.measured)}
        hidden = [name for i, name in enumerate(self.state_names) if i not in known]
        outside = [i for i in self.measured if not 0 <= i < len(self.state_names)]
        if outside or len(set(self.measured)) < len(self.measured) or hidden:
            raise InputError(
                "TaskSpec.measured must index different states, among them the position of each "
                f"that is not measured, got {self.measured}"
                + (f", which tells nothing of {', '.join(hidden)}." if hidden else ".")
            )
        stds = self.measurement_std
        if stds is not None and not (
            len(stds) == len(self.measured) and all(s > 0 and math.isfinite(s) for s in stds)
        ):
            raise InputError(
                "TaskSpec.measurement_std must be positive and finite, one for each of the "
                f"{len(self.measured)} measured states, got {stds}; None estimates it."
            )

    @property
    def measured_states(self) -> tuple[int, ...]:
        """Which states are measured, in order."""
        return tuple(range(len(self.state_names))) if self.measured is None else self.measured

    def _check_observed(self) -> None:
        if self.observed and self.measured is not None:
            raise InputError(
                "TaskSpec.observed says where every state is found in the observation, and "
                "TaskSpec.measured that some are not in it; give one of them. Where both hold, "
                "wrap the env so that it shows the measured states themselves."
            )
        if self.observed and len(self.observed) != len(self.state_names):
            raise InputError(
                "TaskSpec.observed must say for each of the states "
                f"{self.state_names} where it is observed, got {self.observed}."
            )
        pairs = [(i, where) for i, where in enumerate(self.observed) if isinstance(where, tuple)]
        indices = [index for where in self.observed for index in np.atleast_1d(where).tolist()]
        whole = all(isinstance(index, int) and index >= 0 for index in indices)
        if not whole or any(len(where) != 2 for _, where in pairs):
            raise InputError(
                "TaskSpec.observed must hold indices of observations, or pairs of them for the "
                f"cosine and the sine of an angle, got {self.observed}."
            )
        plain = [self.state_names[i] for i, _ in pairs if i not in self.angles]
        if plain:
            raise InputError(
                f"TaskSpec.observed makes angles of cosines and sines, {plain}, which "
                f"TaskSpec.angles must name too, got {self.angles}."
            )

    def after_inputs(self, memory: int) -> TaskSpec:
        """The same of states behind which the last inputs stand, newest first; they start at 0.

        Raises:
            InputError: the states are measured in part.
        """
        if memory == 0:
            return self
        if self.measured is not None:
            raise InputError(
                f"model.memory must be 0 where states are measured in part, got {memory}."
            )
        ago = [(name, k) for k in range(1, memory + 1) for name in self.input_names]
        zeros = (0.0,) * len(ago)
        return replace(
            self,
            state_names=self.state_names + tuple(f"{name}_{k}_ago" for name, k in ago),
            state_units=self.state_units + self.input_units * memory,
            start_mean=self.start_mean + zeros,
            start_std=self.start_std + zeros,
            goal=None,  # a regulator finds the inputs that hold it
        )

    def to_json(self) -> dict[str, Any]:
        """Everything but the cost, which is a function."""
        return {f.name: _as_list(getattr(self, f.name)) for f in fields(self) if f.name != "cost"}

    @classmethod
    def from_json(cls, values: Mapping[str, Any], cost: Cost | None = unknown_cost) -> TaskSpec:
        """The task of `to_json`, with a cost that says that it is not known, or the one given.

        Raises:
            InputError: an entry is of another type, or does not fit the others.
            TypeError: an entry is missing or unknown.
        """
        entries = {name: _as_tuple(value) for name, value in values.items()}
        return cls(**entries, cost=cost)


def _as_list(value: Any) -> Any:
    if hasattr(value, "tolist"):  # numpy's numbers are no JSON
        value = value.tolist()
    return list(map(_as_list, value)) if isinstance(value, tuple | list) else value


def _as_tuple(value: Any) -> Any:
    return tuple(map(_as_tuple, value)) if isinstance(value, list) else value
