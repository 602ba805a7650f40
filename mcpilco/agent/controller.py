"""From observations to inputs: a policy, behind an estimator where states are measured in part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mcpilco.sensing import Perception, StateTracker, foreign_state

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
    tracker: StateTracker | None = None
    """of a late actuator: tells of the episode so far what the policy sees instead of the state"""

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
        if self.tracker is not None:
            return self._answer_ahead(self.tracker, observation, state, restart)
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
        """The input, of a state and the last inputs."""
        past, _ = self._past(self.memory, states, state, restart)
        with torch.no_grad():
            inputs = self.policy(torch.cat([torch.as_tensor(states).double(), past], -1)).numpy()
        return inputs, (_newer(inputs, past),)

    def _answer_ahead(
        self, tracker: StateTracker, states: Float[np.ndarray, "*b X"], state: Any, restart: Any
    ) -> tuple[Float[np.ndarray, "*b U"], Any]:
        """The input, of the state in which it will act."""
        past, begun = self._past(self.memory + 1, states, state, restart)
        commands = past.reshape(*begun.shape, self.memory + 1, -1)
        measured = torch.as_tensor(states).double()
        track = tracker.begin(measured)
        if state is not None and track is not None:
            if len(state) != 2:
                raise foreign_state("2 entries", len(state))
            track = tracker.follow(state[1] or track, commands, measured, begun)
        with torch.no_grad():
            inputs = self.policy(tracker.ahead(track, measured, commands[..., :-1, :])).numpy()
        return inputs, (_newer(inputs, past), track)

    def _past(
        self, count: int, states: Float[np.ndarray, "*b X"], state: Any, restart: Any
    ) -> tuple[Float[Tensor, "*b M"], Bool[Tensor, "*b"]]:
        """The last inputs, newest first, and where an episode begins: before it they were 0."""
        batch = states.shape[:-1]
        shape = (*batch, self.policy.input_dim * count)
        past = np.zeros(shape) if state is None else np.asarray(state[0], dtype=np.float64)
        if past.shape != shape:
            raise foreign_state(f"shape {shape}", past.shape)
        begun = np.broadcast_to(False if restart is None else restart, batch)
        past = np.where(begun[..., None], 0.0, past)
        return torch.from_numpy(past), torch.tensor(begun)


def _newer(
    inputs: Float[np.ndarray, "*b U"], past: Float[Tensor, "*b M"]
) -> Float[np.ndarray, "*b M"]:
    """The last inputs, of which the oldest gives way to a new one."""
    return np.concatenate([inputs, past.numpy()], -1)[..., : past.shape[-1]]


def remembering(answer: Callable[[np.ndarray, Any], tuple[np.ndarray, Any]]) -> Act:
    """What hands the state of each answer to the next, for one episode."""
    state = None

    def act(observation: Float[np.ndarray, "*b Y"]) -> Float[np.ndarray, "*b U"]:
        nonlocal state
        action, state = answer(observation, state)
        return action

    return act
