"""The file of an agent: plain arrays, and a JSON object that says what they are."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import torch
from torch import nn

from mcpilco.archive import read_groups, write_groups
from mcpilco.config import from_dict
from mcpilco.data import Transitions
from mcpilco.guess import guess_task
from mcpilco.reward_cost import RewardCost
from mcpilco.task import TaskSpec, unknown_cost
from mcpilco.typing import Cost, EnvError, RunFolderError

if TYPE_CHECKING:
    from mcpilco.model_based import ModelBasedAgent

FORMAT = 2
"""version of the file"""
READABLE = (1, 2)
"""versions that are read; 1 also held the state of random generators, which is no longer needed"""
STRUCTURE = ("state_names", "input_names", "angles", "velocities", "dt", "observed", "measured")
"""entries of a task that give the arrays their meaning"""


@dataclass(frozen=True)
class SavedAgent:
    """What an agent's file holds; reading it checks nothing yet."""

    about: Mapping[str, Any]
    """numbers and names"""
    arrays: Mapping[str, Mapping[str, np.ndarray]]
    """bounds, policy, gp; transitions where there are any, perception where states are measured in
    part"""

    def config(self, kind: type[Any]) -> Any:
        """The agent's numbers, of the dataclass of its algorithm."""
        return from_dict(kind, self.about["config"])

    @property
    def task(self) -> TaskSpec:
        """What the agent knew of its env, but for the cost."""
        task = TaskSpec.from_json(self.about["task"])
        return dataclasses.replace(task, cost=None) if "cost" in self.arrays else task

    def task_for(self, env: gym.Env) -> TaskSpec:
        """The same with the cost that was guessed of this env, where it was."""
        task, guess = self.task, guess_task(env) if self.task.cost is unknown_cost else None
        if guess is None or _told(guess.task.cost) != self.about.get("cost"):
            return task
        return dataclasses.replace(task, cost=guess.task.cost)

    def restore(self, agent: ModelBasedAgent) -> None:
        """Give a new agent all that the saved one had learned.

        Raises:
            ValueError: an entry does not fit the agent, or is not finite.
        """
        saved, here = self.task.to_json(), agent.task.to_json()
        for name in STRUCTURE:
            if saved[name] != here[name]:
                raise ValueError(f"its {name} is {saved[name]}, the env has {here[name]}")
        trials, reference_cost = self.about["trials"], float(self.about["reference_cost"])
        if type(trials) is not int or trials < 0 or (trials and "transitions" not in self.arrays):
            raise ValueError(f"its trials are {trials!r}")
        if not math.isfinite(reference_cost):
            raise ValueError(f"its reference_cost is {reference_cost}")
        load_policy(agent.policy, self.arrays["policy"])
        agent.model.gp.load_arrays(self.arrays["gp"])
        if agent.perception is not None:
            agent.perception.load_arrays(self.arrays["perception"])
        if isinstance(agent.task.cost, RewardCost) and "cost" in self.arrays:
            agent.task.cost.load_arrays(self.arrays["cost"])
        agent.trials, agent.reference_cost = trials, reference_cost
        if "transitions" in self.arrays:
            rows = Transitions(**self.arrays["transitions"])
            widths = len(agent.task.state_names), len(agent.task.input_names)
            if (rows.states.shape[1], rows.inputs.shape[1]) != widths:
                raise ValueError(f"its transitions have shapes {rows.states.shape}")
            agent.transitions = rows


def load_policy(policy: nn.Module, arrays: Mapping[str, np.ndarray]) -> None:
    """Give a policy the parameters of a saved one.

    Raises:
        ValueError: they are not those of a policy like this, or not finite.
    """
    if not all(array.dtype.kind == "f" and np.isfinite(array).all() for array in arrays.values()):
        raise ValueError("its policy is not made of finite numbers")
    try:
        policy.load_state_dict({name: torch.from_numpy(a) for name, a in arrays.items()})
    except RuntimeError as error:
        raise ValueError(f"its policy is another one: {error}") from error


def write_agent(path: Path, agent: ModelBasedAgent) -> Path:
    """Write all that an agent has learned, and what it needs to go on; returns the file's path.

    Raises:
        RunFolderError: the file cannot be written.
    """
    about = {
        "format": FORMAT,
        "algo": agent.algo,
        "config": dataclasses.asdict(agent.config),
        "task": agent.task.to_json(),
        "cost": _told(agent.task.cost),
        "horizon": agent.horizon,
        "observations": int(np.prod(agent.env.observation_space.shape or (0,))),
        "seed": agent.seed,
        "trials": agent.trials,
        "reference_cost": agent.reference_cost,
    }
    dtype = agent.env.action_space.dtype
    groups = {
        "bounds": {"low": agent.low.astype(dtype), "high": agent.high.astype(dtype)},
        "policy": {name: value.numpy() for name, value in agent.policy.state_dict().items()},
        "gp": agent.model.gp.to_arrays(),
        "cost": agent.task.cost.to_arrays() if isinstance(agent.task.cost, RewardCost) else {},
        "transitions": {} if agent.transitions is None else vars(agent.transitions),
    }
    if agent.perception is not None:
        groups["perception"] = agent.perception.to_arrays()
    return write_groups(_npz(path), about, groups)


@contextlib.contextmanager
def reading(path: Path, algo: str) -> Iterator[SavedAgent]:
    """What a file holds, for the time in which an agent is made of it.

    Args:
        path: of the file.
        algo: the algorithm of the agent; a file that names none is of `mcpilco`.

    Raises:
        RunFolderError: the file is missing or damaged, or the agent cannot be made of it.
    """
    path = _npz(path)
    about, arrays = read_groups(path)
    if about.get("format") not in READABLE:
        raise RunFolderError(
            f"{path} has format {about.get('format')!r}, this mcpilco reads {READABLE}; "
            "save the agent with this version, or install the one that saved it."
        )
    if (saved := about.get("algo", "mcpilco")) != algo:
        raise RunFolderError(
            f"{path} holds an agent of the algorithm {saved!r}, expected one of {algo!r}; "
            "load it with the class of its algorithm."
        )
    try:
        yield SavedAgent(about, arrays)
    except EnvError:
        raise
    except Exception as error:  # what a damaged file says may lead to almost anything
        raise RunFolderError(
            f"{path} is damaged, or holds no agent of this env ({type(error).__name__}: {error})."
        ) from error


def _told(cost: Cost | None) -> str:
    """What a cost is, in words that are equal for equal ones: without addresses in memory."""
    if dataclasses.is_dataclass(cost):
        return str(cost)
    return getattr(cost, "__qualname__", type(cost).__qualname__)


def _npz(path: Path) -> Path:
    return path if path.suffix == ".npz" else path.with_name(f"{path.name}.npz")
