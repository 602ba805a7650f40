"""From measurements to inputs: a policy, and the estimator whose estimates it acts on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mcpilco.typing import Estimator, InputError

Act = Callable[[Float[np.ndarray, "*b Y"]], Float[np.ndarray, "*b U"]]
"""acts for one episode, or for a batch that begins together"""


@dataclass(frozen=True)
class Controller:
    """A policy with its estimator, as it acts on the system."""

    policy: Any
    """from states to inputs"""
    estimator: Estimator | None = None
    """makes the states of measurements; None: states are measured"""

    def answer(
        self,
        observation: Float[np.ndarray, "*b Y"],
        state: Any = None,
        restart: Bool[np.ndarray, "*b"] | None = None,
    ) -> tuple[Float[np.ndarray, "*b U"], Any]:
        """The input, in the env's unit, and the state to be handed back with the next observation.

        The state was returned by the call before; without it an episode begins, as for those of a
        batch that `restart`, whatever the state says.

        Raises:
            InputError: the state belongs to other observations.
        """
        measured = torch.as_tensor(observation, dtype=torch.float64)
        if self.estimator is None:
            with torch.no_grad():
                return self.policy(measured).numpy(), state
        first, begun = self.estimator.begin(measured), None
        if restart is not None:
            begun = torch.tensor(np.broadcast_to(restart, measured.shape[:-1]), dtype=torch.bool)
        memory = first if state is None else _memory(state, first)
        with torch.no_grad():
            estimate, memory = self.estimator.observe(measured, memory, begun)
            inputs = self.policy(estimate)
        return inputs.numpy(), (self.estimator.after(memory, inputs),)


def _memory(state: Any, first: Any) -> Any:
    """The memory that a state holds, which must be like that of an episode's beginning.

    Raises:
        InputError: `predict` did not return such a state for such observations.
    """
    if not isinstance(state, tuple) or len(state) != 1:
        raise InputError(
            f"predict expects the state that it returned before, a tuple of 1 entry, got "
            f"{state!r}; pass None to begin an episode."
        )
    memory = state[0]
    if isinstance(first, Tensor) and isinstance(memory, np.ndarray):
        memory = torch.from_numpy(memory)
    if _shape(memory) != _shape(first):
        raise InputError(
            f"predict expects the state that it returned before, of {_shape(first)}, got "
            f"{_shape(memory)}; pass None to begin an episode."
        )
    return memory


def _shape(memory: Any) -> Any:
    """The shapes of an estimator's memory, but for what grows with the episode."""
    if isinstance(memory, Tensor):
        return f"shape {tuple(memory.shape)}"
    if isinstance(memory, tuple):
        return tuple(map(_shape, memory))
    arrays = getattr(memory, "__dict__", {}).values()
    return type(memory).__name__, *(_shape(a) for a in arrays if isinstance(a, Tensor))


def remembering(answer: Callable[[np.ndarray, Any], tuple[np.ndarray, Any]]) -> Act:
    """Acts for one episode: the state of each answer goes to the next."""
    state = None

    def act(observation: Float[np.ndarray, "*b Y"]) -> Float[np.ndarray, "*b U"]:
        nonlocal state
        action, state = answer(observation, state)
        return action

    return act
