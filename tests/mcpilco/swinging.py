"""A pendulum that can be observed in several ways, right and wrong."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box

from mcpilco.task import TaskSpec

DT, SUBSTEPS = 0.1, 10
START, SPREAD = 0.5, 0.1

TASK = TaskSpec(
    state_names=("angle", "velocity"),
    state_units=("rad", "rad/s"),
    input_names=("torque",),
    input_units=("N m",),
    dt=DT,
    angles=(0,),
    velocities=((0, 1),),
    start_mean=(START, 0.0),
    start_std=(SPREAD, SPREAD),
)
CIRCLE = {"observed": ((0, 1), 2)}
"""entries of the task of one that observes cosine and sine"""


class Swinging(gym.Env):
    """angle'' = -9.81 sin(angle) + torque; the reward is -angle'^2 - (1 + cos(angle))^2.

    Args:
        view: of the state: `state`, `circle` (cosine, sine, velocity), `wrapped` (angle in +-pi),
            `positions` (no velocity) or `noisy` (the state, with noise of 1 %).
        limit: largest torque.
        unseeded: the start is drawn from numbers that no seed reaches.
        silent: the reward is always 0.
        nan_at: the step whose observation is not a number.
        push: what the angle's velocity starts with [rad/s].
        ends: the episode terminates beyond this angle [rad].
    """

    def __init__(
        self,
        view: str = "state",
        *,
        limit: float = 5.0,
        unseeded: bool = False,
        silent: bool = False,
        nan_at: int | None = None,
        push: float = 0.0,
        ends: float = np.inf,
    ) -> None:
        width = {"circle": 3, "positions": 1}.get(view, 2)
        self.observation_space = Box(-np.inf, np.inf, (width,), np.float64)
        self.action_space = Box(-limit, limit, (1,), np.float32)
        self.view, self.unseeded, self.silent = view, unseeded, silent
        self.nan_at, self.push, self.ends = nan_at, push, ends

    def reset(self, *, seed: int | None = None, options: Any = None):
        super().reset(seed=seed)
        random = np.random.default_rng() if self.unseeded else self.np_random
        self.state = np.array([START, self.push]) + SPREAD * random.standard_normal(2)
        self.steps = 0
        return self._observe(), {}

    def step(self, action):
        angle, velocity = self.state
        for _ in range(SUBSTEPS):
            velocity += DT / SUBSTEPS * (float(action[0]) - 9.81 * np.sin(angle))
            angle += DT / SUBSTEPS * velocity
        self.state = np.array([angle, velocity])
        self.steps += 1
        reward = 0.0 if self.silent else -(velocity**2) - (1 + np.cos(angle)) ** 2
        return self._observe(), reward, bool(abs(angle) > self.ends), False, {}

    def _observe(self):
        angle, velocity = self.state
        if self.steps == self.nan_at:
            return np.full(self.observation_space.shape, np.nan)
        views = {
            "state": [angle, velocity],
            "circle": [np.cos(angle), np.sin(angle), velocity],
            "wrapped": [np.arctan2(np.sin(angle), np.cos(angle)), velocity],
            "positions": [angle],
            "noisy": self.state * (1 + 0.01 * self.np_random.standard_normal(2)),
        }
        return np.array(views[self.view], dtype=np.float64)
