"""From an observation to the state: columns chosen, angles made of their cosine and sine."""

from __future__ import annotations

from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from jaxtyping import Float

from mcpilco.task import TaskSpec

TURN = 2 * np.pi
"""a full turn [rad]"""


def state_of(task: TaskSpec, observation: Float[np.ndarray, "*b O"]) -> Float[np.ndarray, "*b X"]:
    """The state that an observation tells, angles of cosines and sines within +-pi.

    Args:
        task: says where each state is observed.
        observation: in the env's units.
    """
    if not task.observed:
        return observation
    columns = [
        np.arctan2(observation[..., where[1]], observation[..., where[0]])
        if isinstance(where, tuple)
        else observation[..., where]
        for where in task.observed
    ]
    return np.stack(columns, axis=-1)


def unwrapped(
    task: TaskSpec, before: Float[np.ndarray, " X"], state: Float[np.ndarray, " X"]
) -> Float[np.ndarray, " X"]:
    """The state with as many full turns on each angle as bring it nearest to the one before."""
    state, angles = state.copy(), list(task.angles)
    state[angles] -= TURN * np.round((state[angles] - before[angles]) / TURN)
    return state


class StateView(gym.Wrapper[np.ndarray, np.ndarray, np.ndarray, np.ndarray]):
    """The env with its states as observations; angles count turns, so they never jump.

    Needs steps short enough for an angle to change by less than half a turn.
    """

    def __init__(self, env: gym.Env[np.ndarray, np.ndarray], task: TaskSpec) -> None:
        """A view of an env whose task has `observed`."""
        super().__init__(env)
        self._task = task
        self._last = np.zeros(len(task.state_names))
        self.observation_space = Box(-np.inf, np.inf, self._last.shape, np.float64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options)
        self._last = self._state(observation)
        return self._last, info

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, SupportsFloat, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._last = unwrapped(self._task, self._last, self._state(observation))
        return self._last, reward, terminated, truncated, info

    def _state(self, observation: Any) -> Float[np.ndarray, " X"]:
        return state_of(self._task, np.asarray(observation, dtype=np.float64))


def state_view(env: gym.Env, task: TaskSpec) -> gym.Env:
    """The env as the agent learns from it: itself, where its observation is the state."""
    return StateView(env, task) if task.observed else env
