"""A point mass on a line: an env small enough to learn in within a fraction of a second."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium.spaces import Box

from mcpilco.config import Config, ModelConfig, Phase, PolicyConfig, SearchConfig
from mcpilco.policies import SaturatingCost
from mcpilco.task import TaskSpec

DT = 0.2
STEPS = 6

TASK = TaskSpec(
    state_names=("position", "velocity"),
    state_units=("m", "m/s"),
    input_names=("force",),
    input_units=("N",),
    dt=DT,
    angles=(),
    velocities=((0, 1),),
    start_mean=(0.0, 0.0),
    start_std=(0.1, 0.1),
    cost=SaturatingCost((0,), (1.0,), (1.0,), (False,)),
)

TINY = Config(
    model=ModelConfig(kernel="rbf"),
    policy=PolicyConfig(bases=6),
    search=SearchConfig(
        particles=6, steps=(4,), phases=(Phase(0.05),), restarts=(0,), evaluation_particles=8
    ),
    horizon=STEPS,
    engine="eager",
)
"""a few steps of everything, in plain torch"""


class PointEnv(gym.Env):
    """Unit mass, force within +-`limit` N, cost 0 at 1 m; the position is seen with noise.

    Args:
        limit: largest force [N].
        spread: of the start, and ten times the noise of the position, as seen [m, m/s].
        dtype: of the action space.
        ends_at: the step at which the episode terminates.
        bad: what `step` returns as observation in place of the state, at step `bad_at`.
        bad_at: when it does.
    """

    task = TASK

    def __init__(
        self,
        *,
        limit: float = 2.0,
        spread: float = 0.1,
        dtype: type = np.float32,
        ends_at: int | None = None,
        bad: Any = None,
        bad_at: int | None = None,
    ) -> None:
        self.observation_space = Box(-np.inf, np.inf, (2,), np.float64)
        self.action_space = Box(-limit, limit, (1,), dtype)
        self.spread = spread
        self.ends_at, self.bad, self.bad_at = ends_at, bad, bad_at
        self.actions: list[np.ndarray] = []
        self.seeds: list[int | None] = []

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.seeds.append(seed)
        self.state = self.spread * self.np_random.standard_normal(2)
        self.steps = 0
        return self._observe(), {"state": self.state.copy()}

    def step(self, action):
        self.actions.append(action)
        self.steps += 1
        position, velocity = self.state
        faster = velocity + DT * float(action[0])
        self.state = np.array([position + DT * (velocity + faster) / 2, faster])
        cost = TASK.cost(torch.from_numpy(self.state), torch.zeros(1))
        bad = self.steps == self.bad_at
        info = {"state": self.state.copy(), "is_success": bool(abs(self.state[0] - 1) < 0.3)}
        ended = self.steps == self.ends_at
        return self.bad if bad else self._observe(), 1.0 - float(cost), ended, False, info

    def _observe(self):
        noise = 0.1 * self.spread * self.np_random.standard_normal()
        return self.state + np.array([noise, 0.0])
