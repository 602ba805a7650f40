"""Envs that the cart-pole is not, registered when this module is imported."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from mcpilco.agent import Streams
from mcpilco.config import Config, PolicyConfig, SearchConfig
from mcpilco.policies import QuadraticCost
from mcpilco.task import TaskSpec

HERE = __name__
HORIZON = 5

TINY = Config(
    policy=PolicyConfig(bases=5),
    search=SearchConfig(particles=4, steps=(2,), restarts=(0,), evaluation_particles=4),
    engine="eager",
)
"""a search that takes no time, and finds nothing"""


class Point(gym.Env):
    """A point that is pushed; it tells no success."""

    observation_space = Box(-9, 9, (1,), np.float64)
    action_space = Box(-1, 1, (1,), np.float32)
    cost = QuadraticCost((0.0,), (1.0,), (0.0,))
    task = TaskSpec(("x",), ("m",), ("u",), ("N",), 0.1, (), (), (0.0,), (0.1,), cost)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.x = 0.1 * self.np_random.standard_normal(1)
        return self.x.copy(), {}

    def step(self, action):
        self.x = self.x + 0.1 * np.asarray(action, dtype=float)
        return self.x.copy(), 1.0 - float(self.x[0] ** 2), False, False, {}


class Broken(Point):
    def step(self, action):
        return np.full(1, np.nan), 0.0, False, False, {}


class Unlucky(Point):
    """Breaks for the agent of seed 1, once it has seen a whole episode."""

    def __init__(self):
        self.episodes, self.first = 0, None

    def reset(self, *, seed=None, options=None):
        self.episodes += 1
        self.first = seed if self.first is None else self.first
        return super().reset(seed=seed)

    def step(self, action):
        if self.first == Streams(1).reset(0) and self.episodes > 1:
            raise ValueError("no luck")
        return super().step(action)


class Short(Point):
    """An episode of two steps, of which only the second is a success."""

    def reset(self, *, seed=None, options=None):
        self.steps = 0
        return super().reset(seed=seed)

    def step(self, action):
        self.steps += 1
        observation, *_ = super().step(action)
        over = self.steps == 2
        return observation, 1.0, over, False, {"is_success": over}


def batch(num_envs, max_episode_steps=None):
    return SyncVectorEnv([Short] * num_envs)


def batch_that_resets_at_once(num_envs, max_episode_steps=None):
    return SyncVectorEnv([Short] * num_envs, autoreset_mode=AutoresetMode.SAME_STEP)


def other_batch(num_envs, max_episode_steps=None):
    env = batch(num_envs)
    env.single_observation_space = Box(-8, 8, (1,), np.float64)
    return env


for kind in (Point, Broken, Unlucky, Short):
    gym.register(f"Sweep/{kind.__name__}-v0", kind, max_episode_steps=HORIZON)
for name, vector in (
    ("Same", batch),
    ("AtOnce", batch_that_resets_at_once),
    ("Other", other_batch),
):
    gym.register(f"Sweep/{name}-v0", Short, vector_entry_point=vector, max_episode_steps=HORIZON)
