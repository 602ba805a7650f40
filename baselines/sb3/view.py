"""The observations of networks: cosines and sines of angles, inputs between -1 and 1."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from jaxtyping import Float, Float32

from mcpilco.sensing import state_view
from mcpilco.task import TaskSpec
from mcpilco.typing import EnvError, InputError, McPilcoError


@dataclass(frozen=True)
class View:
    """From states to features, and from actions of a network to inputs, and back.

    Features are those entries of a state that are no angle, in order, then the cosines of the
    angles, then their sines, as the GPs of MC-PILCO see a state.
    """

    task: TaskSpec
    """says which states are angles"""
    low: Float[np.ndarray, " U"]
    """smallest inputs, in the env's unit"""
    high: Float[np.ndarray, " U"]
    """largest inputs, in the env's unit"""

    def __post_init__(self) -> None:
        if self.task.measured is not None:
            raise InputError(
                "Networks without memory learn where all states are measured, got a task that "
                "measures a part of them; let the env show its states, or take the algorithm "
                "mcpilco."
            )

    def features(self, states: Float[np.ndarray, "*b X"]) -> Float32[np.ndarray, "*b F"]:
        """The observation of a network."""
        angles = list(self.task.angles)
        plain = [i for i in range(states.shape[-1]) if i not in angles]
        turned = states[..., angles]
        parts = [states[..., plain], np.cos(turned), np.sin(turned)]
        return np.concatenate(parts, axis=-1).astype(np.float32)

    def inputs(self, actions: Float[np.ndarray, "*b U"]) -> Float[np.ndarray, "*b U"]:
        """The inputs of actions in [-1, 1], in the env's unit."""
        shares = 0.5 * (np.asarray(actions, dtype=np.float64) + 1.0)
        return np.clip(self.low + shares * (self.high - self.low), self.low, self.high)

    def actions(self, inputs: Float[np.ndarray, "*b U"]) -> Float32[np.ndarray, "*b U"]:
        """The actions in [-1, 1] of inputs in the env's unit."""
        return (2.0 * (inputs - self.low) / (self.high - self.low) - 1.0).astype(np.float32)


class ViewedEnv(gym.Wrapper[np.ndarray, np.ndarray, np.ndarray, np.ndarray]):
    """The env as networks see it; what goes wrong in it is an `EnvError`."""

    def __init__(self, env: gym.Env, view: View) -> None:
        super().__init__(state_view(env, view.task))
        self.view = view
        width = len(view.task.state_names) + len(view.task.angles)
        self.observation_space = Box(-np.inf, np.inf, (width,), np.float32)
        self.action_space = Box(-1.0, 1.0, view.low.shape, np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        try:
            observation, info = self.env.reset(seed=seed, options=options)
        except Exception as error:
            raise _blamed(error) from error
        return self._seen(observation), info

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, SupportsFloat, bool, bool, dict[str, Any]]:
        held = self.view.inputs(action).astype(self.env.action_space.dtype)
        try:
            observation, reward, terminated, truncated, info = self.env.step(held)
        except Exception as error:
            raise _blamed(error) from error
        if not np.isfinite(float(reward)):
            raise EnvError(f"The env must return finite rewards, got {reward}; check its cost.")
        return self._seen(observation), float(reward), terminated, truncated, info

    def _seen(self, observation: Any) -> Float32[np.ndarray, " F"]:
        features = self.view.features(np.asarray(observation, dtype=np.float64))
        if not np.isfinite(features).all():
            raise EnvError(
                f"The env must return finite numbers, got the observation {observation}; check its "
                "equations or its sensor."
            )
        return features


def _blamed(error: Exception) -> McPilcoError:
    """The env is foreign code: whatever it raises is its own."""
    if isinstance(error, McPilcoError):
        return error
    return EnvError(f"The env raised {type(error).__name__}: {error}; mend the env.")
