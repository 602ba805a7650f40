"""From observations to inputs: a policy, behind an estimator where states are measured in part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mcpilco.delay import StatePredictor
from mcpilco.perception import Perception
from mcpilco.typing import InputError

Act = Callable[[Float[np.ndarray, "*b Y"]], Float[np.ndarray, "*b U"]]
"""what acts for one episode, or a batch that begins together"""


@dataclass(frozen=True)
class Controller:
    """A policy, and the perception behind which it was learned."""

    policy: Any
    """from states to inputs; it tells its `input_dim` where inputs are remembered"""
    perception: Perception | None
    """None where states are measured"""
    memory: int = 0
    """how many of the last inputs are remembered; the policy sees them behind the state, newest
    first"""
    predictor: StatePredictor | None = None
    """of a late actuator: tells of the state and the last inputs what the policy sees instead"""

    def answer(
        self,
        observation: Float[np.ndarray, "*b Y"],
        state: Any = None,
        restart: Bool[np.ndarray, "*b"] | None = None,
    ) -> tuple[Float[np.ndarray, "*b U"], Any]:
        """The input, in the env's unit, and the state to be handed back with the next observation.

        Args:
            observation: what is measured now.
            state: returned by the call before; None begins an episode.
            restart: which of a batch begin an episode, whatever the state says.

        Raises:
            InputError: the state belongs to other observations.
        """
        if self.memory:
            return self._answer_after_inputs(observation, state, restart)
        if self.perception is not None:
            memory = None if state is None else state[0]
            observation, memory = self.perception.see(observation, memory, restart)
            state = (memory,)
        with torch.no_grad():
            return self.policy(torch.as_tensor(observation, dtype=torch.float64)).numpy(), state

    def _answer_after_inputs(
        self, states: Float[np.ndarray, "*b X"], state: Any, restart: Any
    ) -> tuple[Float[np.ndarray, "*b U"], Any]:
        """The input, of what the last ones tell; before an episode they were 0."""
        U = self.policy.input_dim
        shape = (*states.shape[:-1], U * self.memory)
        past = np.zeros(shape) if state is None else np.asarray(state[0], dtype=np.float64)
        if past.shape != shape:
            raise InputError(
                f"predict expects the state that it returned for the observations before, of shape "
                f"{shape}, got {past.shape}; pass None to begin an episode."
            )
        if restart is not None:
            past = np.where(np.broadcast_to(restart, shape[:-1])[..., None], 0.0, past)
        with torch.no_grad():
            inputs = self.policy(self._seen(torch.as_tensor(states).double(), past)).numpy()
        return inputs, (np.concatenate([inputs, past[..., : shape[-1] - U]], -1),)

    def _seen(
        self, states: Float[Tensor, "*b X"], past: Float[np.ndarray, "*b M"]
    ) -> Float[Tensor, "*b S"]:
        """What the policy sees of a state and the last inputs."""
        known = torch.from_numpy(past)
        if self.predictor is None:
            return torch.cat([states, known], -1)
        return self.predictor(states, known.reshape(*states.shape[:-1], self.memory, -1))


def remembering(answer: Callable[[np.ndarray, Any], tuple[np.ndarray, Any]]) -> Act:
    """What hands the state of each answer to the next, for one episode."""
    state = None

    def act(observation: Float[np.ndarray, "*b Y"]) -> Float[np.ndarray, "*b U"]:
        nonlocal state
        action, state = answer(observation, state)
        return action

    return act
