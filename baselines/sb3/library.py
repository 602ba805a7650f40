"""Between an agent of this package and stable-baselines3: classes, logger, saved agents, views.

An agent's file holds networks, optimisers and replay buffer as plain arrays. stable-baselines3's
own zip holds pickled objects, which execute when they are read; here the algorithm is made anew
from its numbers, and takes the arrays. Networks see cosines and sines of angles, and inputs between
-1 and 1 (`View`).
"""

from __future__ import annotations

import contextlib
import copy
import functools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, SupportsFloat

import gymnasium as gym
import numpy as np
import torch
from gymnasium.spaces import Box
from jaxtyping import Float, Float32

from mcpilco.agent import AbsentEnv, Groups, SavedAgent
from mcpilco.logbook import Callback
from mcpilco.sensing import state_view
from mcpilco.task import TaskSpec
from mcpilco.typing import EnvError, InputError, McPilcoError

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
    all_envs = [env]
    for _ in range(count - 1):
        assert env.spec is not None
        all_envs.append(copy.copy(env) if isinstance(env, AbsentEnv) else gym.make(env.spec))
    return DummyVecEnv([functools.partial(viewed, one) for one in all_envs])


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
        with _blamed():
            observation, info = self.env.reset(seed=seed, options=options)
        return self._seen(observation), info

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, SupportsFloat, bool, bool, dict[str, Any]]:
        held = self.view.inputs(action).astype(self.env.action_space.dtype)
        with _blamed():
            observation, reward, terminated, truncated, info = self.env.step(held)
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


@contextlib.contextmanager
def _blamed() -> Iterator[None]:
    """The env is foreign code: whatever it raises is its own."""
    try:
        yield
    except McPilcoError:
        raise
    except Exception as error:
        raise EnvError(f"The env raised {type(error).__name__}: {error}; mend the env.") from error
