"""What is between an agent of this package and the library stable-baselines3."""

from __future__ import annotations

import contextlib
import copy
import functools
from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from mcpilco.agent import AbsentEnv
from mcpilco.logbook import Callback
from mcpilco.typing import InputError

try:
    from sb3_contrib import TQC
    from stable_baselines3 import PPO, SAC
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.logger import Logger
    from stable_baselines3.common.vec_env import DummyVecEnv
except ImportError as error:
    raise InputError(
        f"SAC, TQC and PPO need stable-baselines3 and sb3-contrib ({error}); "
        "run `pip install 'mcpilco[baselines]'`."
    ) from error

CLASSES: dict[str, Any] = {"sac": SAC, "tqc": TQC, "ppo": PPO}
"""the library's algorithms, by our names"""


def vector_of(env: gym.Env, count: int, viewed: Callable[[gym.Env], gym.Env]) -> DummyVecEnv:
    """The env, and copies of it, as the library steps them together.

    Args:
        env: the first.
        count: how many they are together.
        viewed: what is made of each.

    Raises:
        InputError: copies are asked for, and the env does not say how it is made.
    """
    if count > 1 and env.spec is None:
        raise InputError(
            f"n_envs = {count} needs copies of the env, and it does not say how it is made; "
            "register it with Gymnasium and pass its id, or set n_envs to 1."
        )
    all_envs = [env, *(_copy(env) for _ in range(count - 1))]
    return DummyVecEnv([functools.partial(viewed, one) for one in all_envs])


def _copy(env: gym.Env) -> gym.Env:
    """Another env like this one."""
    if isinstance(env, AbsentEnv):
        return copy.copy(env)
    assert env.spec is not None, "vector_of has checked it"
    return gym.make(env.spec)


def quiet_logger() -> Logger:
    """One that keeps numbers, and writes none."""
    return Logger(folder=None, output_formats=[])


@contextlib.contextmanager
def random_numbers(seed: int) -> Iterator[None]:
    """All that the library draws is drawn from this seed; its global generators are given back.

    Args:
        seed: below 2^32.
    """
    kept = np.random.get_state()  # noqa: NPY002
    with torch.random.fork_rng(devices=[]):
        np.random.seed(seed)  # noqa: NPY002
        torch.manual_seed(seed)
        try:
            yield
        finally:
            np.random.set_state(kept)  # noqa: NPY002


class Told(BaseCallback):
    """Tells our callbacks of each episode of a training, as of a step of a policy search."""

    def __init__(self, events: Callback, steps: int) -> None:
        """Tells `events` of a stretch of so many steps of the env."""
        super().__init__()
        self._events = events
        self._steps = steps

    def _on_training_start(self) -> None:
        self._first = self.num_timesteps
        self._returns = np.zeros(self.training_env.num_envs)
        self._lengths = np.zeros(self.training_env.num_envs, dtype=int)

    def _on_step(self) -> bool:
        self._returns += self.locals["rewards"]
        self._lengths += 1
        ended = np.flatnonzero(self.locals["dones"])
        if len(ended):
            costs = self._lengths[ended] - self._returns[ended]
            values = {"policy/cost": costs, "rollout/ep_return": self._returns[ended]}
            told = {name: float(value.mean()) for name, value in values.items()}
            step = min(self.num_timesteps - self._first, self._steps)
            self._events.on_policy_step(step, self._steps, told | self._numbers())
            self._returns[ended], self._lengths[ended] = 0.0, 0
        return True

    def _numbers(self) -> dict[str, float]:
        """What the library has logged since the last time, such as `train/actor_loss`."""
        kept = self.logger.name_to_value
        found = {name: float(value) for name, value in kept.items() if name.startswith("train/")}
        kept.clear()
        return found
