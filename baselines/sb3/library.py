"""Between an agent of this package and stable-baselines3: its classes, its logger, saved agents.

An agent's file holds networks, optimisers and replay buffer as plain arrays. stable-baselines3's
own zip holds pickled objects, which execute when they are read; here the algorithm is made anew
from its numbers, and takes the arrays.
"""

from __future__ import annotations

import contextlib
import copy
import functools
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import torch

from mcpilco.agent import AbsentEnv, Groups, SavedAgent
from mcpilco.logbook import Callback
from mcpilco.typing import InputError

if TYPE_CHECKING:
    from baselines.sb3.agent import SB3Agent

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
    """The env, and copies of it, as the library steps them together."""
    if count > 1 and env.spec is None:
        raise InputError(
            f"n_envs = {count} needs copies of the env, and it does not say how it is made; "
            "register it with Gymnasium and pass its id, or set n_envs to 1."
        )
    all_envs = [env, *(_copy(env) for _ in range(count - 1))]
    return DummyVecEnv([functools.partial(viewed, one) for one in all_envs])


def _copy(env: gym.Env) -> gym.Env:
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

    The seed is below 2^32.
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
        """The library's log since the last time, such as `train/actor_loss`."""
        kept = self.logger.name_to_value
        found = {name: float(value) for name, value in kept.items() if name.startswith("train/")}
        kept.clear()
        return found


_BUFFER = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")
_VARIABLES = ("log_ent_coef",)
_COUNTERS = ("num_timesteps", "_n_updates", "_episode_num")

Arrays = dict[str, np.ndarray]


class SavedSB3(SavedAgent["SB3Agent"]):
    """An agent in a file: networks and optimisers; memory, where there is one."""

    formats = (1,)

    @classmethod
    def learned(cls, agent: SB3Agent) -> tuple[dict[str, Any], Groups]:
        counters = {name: int(getattr(agent.learner, name)) for name in _COUNTERS}
        about = {"borrowed": agent.borrowed_timesteps, "counters": counters}
        return about, learner_arrays(agent.learner)

    def restore(self, agent: SB3Agent) -> None:
        self.require_structure(agent)
        counts = [*self.about["counters"].values(), self.about["trials"], self.about["borrowed"]]
        if not all(type(count) is int and count >= 0 for count in counts):
            raise ValueError(f"its counters are {counts}")
        load_learner(agent.learner, self.arrays)
        for name in _COUNTERS:
            setattr(agent.learner, name, self.about["counters"][name])
        agent.trials = self.about["trials"]
        agent.borrow(self.about["borrowed"])


def learner_arrays(learner: Any) -> dict[str, Arrays]:
    """Networks, optimisers and memory of an algorithm of stable-baselines3, by name."""
    groups = {name: _flat(state) for name, state in learner.get_parameters().items()}
    groups["variables"] = {
        name: getattr(learner, name).detach().numpy()
        for name in _VARIABLES
        if getattr(learner, name, None) is not None
    }
    buffer = getattr(learner, "replay_buffer", None)
    if buffer is not None:
        rows = {name: getattr(buffer, name)[: buffer.size()] for name in _BUFFER}
        groups["memory"] = {**rows, "position": np.array(buffer.pos)}
    return groups


def load_learner(learner: Any, arrays: Mapping[str, Mapping[str, np.ndarray]]) -> None:
    """Give a new algorithm the arrays of `learner_arrays`.

    Raises:
        ValueError: they are not those of an algorithm like this, or not finite.
    """
    for group in arrays.values():
        if not all(a.dtype.kind in "iu" or np.isfinite(a).all() for a in group.values()):
            raise ValueError("its networks or memory are not made of finite numbers")
    fresh = learner.get_parameters()
    learner.set_parameters(
        {name: _nested(arrays.get(name, {}), fresh[name]) for name in fresh}, exact_match=True
    )
    for name, value in arrays.get("variables", {}).items():
        if name not in _VARIABLES:
            raise ValueError(f"it has a variable {name!r}")
        with torch.no_grad():
            getattr(learner, name).copy_(torch.from_numpy(value))
    if "memory" in arrays:
        _load_memory(learner.replay_buffer, dict(arrays["memory"]))


def _load_memory(buffer: Any, arrays: Arrays) -> None:
    position, count = int(arrays.pop("position")), len(arrays["rewards"])
    if not 0 <= position <= count <= buffer.buffer_size:
        raise ValueError(f"its memory has {count} rows, and the next goes to {position}")
    for name in _BUFFER:
        getattr(buffer, name)[:count] = arrays[name]
    buffer.pos, buffer.full = position, count == buffer.buffer_size


def _flat(state: Mapping[str, Any]) -> Arrays:
    """The tensors of a module or an optimiser by name; an optimiser's settings are the config's."""
    if "param_groups" not in state:
        return {name: value.numpy() for name, value in state.items()}
    return {
        f"{index}.{name}": value.numpy()
        for index, entries in state["state"].items()
        for name, value in entries.items()
    }


def _nested(arrays: Mapping[str, np.ndarray], fresh: Mapping[str, Any]) -> dict[str, Any]:
    """The inverse of `_flat`, for an object whose present state is `fresh`."""
    tensors = {name: torch.from_numpy(array.copy()) for name, array in arrays.items()}
    if "param_groups" not in fresh:
        return tensors
    state: dict[int, dict[str, torch.Tensor]] = {}
    for path, tensor in tensors.items():
        index, _, name = path.partition(".")
        state.setdefault(int(index), {})[name] = tensor
    return {"state": state, "param_groups": fresh["param_groups"]}
