"""The file of an agent: plain arrays, and a JSON object that says what they are."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import gymnasium as gym
import numpy as np
import torch
from torch import nn

from mcpilco.agent.contract import AbsentEnv
from mcpilco.agent.guess import guess_task
from mcpilco.config import from_dict
from mcpilco.data import Transitions
from mcpilco.files import read_groups, write_groups
from mcpilco.policies import RewardCost
from mcpilco.task import TaskSpec, unknown_cost
from mcpilco.typing import Cost, EnvError, InputError, RunFolderError

if TYPE_CHECKING:
    from mcpilco.agent.model_based import ModelBasedAgent
    from mcpilco.agent.trial_agent import TrialAgent

STRUCTURE = ("state_names", "input_names", "angles", "velocities", "dt", "observed", "measured")
"""entries of a task that give the arrays their meaning"""

Groups = Mapping[str, Mapping[str, np.ndarray]]
"""arrays by name, in named groups"""

A = TypeVar("A", bound="TrialAgent")
S = TypeVar("S", bound="SavedAgent[Any]")


class MissingObjectError(RunFolderError):
    """An agent was made with an object that its file cannot hold, and `load` was given another."""


@dataclass(frozen=True)
class SavedAgent(ABC, Generic[A]):
    """The content of an agent's file; reading it checks nothing yet."""

    about: Mapping[str, Any]
    """numbers and names"""
    arrays: Groups
    """bounds, and what the agent has learned"""

    formats: ClassVar[tuple[int, ...]]
    """versions of the file that are read; the last one is written"""

    @classmethod
    @abstractmethod
    def learned(cls, agent: A) -> tuple[dict[str, Any], Groups]:
        """All that the agent has learned: numbers and names, and arrays."""

    @abstractmethod
    def restore(self, agent: A) -> None:
        """Give a new agent all that the saved one had learned.

        Raises:
            ValueError: an entry does not fit the agent, or is not finite.
        """

    @classmethod
    def write(cls, path: Path, agent: A) -> Path:
        """Write all that an agent has learned, and what it needs to go on; returns the file's path.

        Raises:
            RunFolderError: the file cannot be written.
        """
        own, groups = cls.learned(agent)
        about = {
            "format": cls.formats[-1],
            "algo": agent.algo,
            "config": dataclasses.asdict(agent.config),
            "task": agent.task.to_json(),
            "horizon": agent.horizon,
            "observations": int(np.prod(agent.env.observation_space.shape or (0,))),
            "seed": agent.seed,
            "trials": agent.trials,
            **own,
        }
        dtype = agent.env.action_space.dtype
        bounds = {"low": agent.low.astype(dtype), "high": agent.high.astype(dtype)}
        return write_groups(path, about, {"bounds": bounds, **groups})

    def config(self, kind: type[Any]) -> Any:
        """The agent's numbers, of the dataclass of its algorithm."""
        return from_dict(kind, self.about["config"])

    @property
    def task(self) -> TaskSpec:
        """The task that the agent knew, but for a cost that was given as a function."""
        return TaskSpec.from_json(self.about["task"])

    def task_for(self, env: gym.Env) -> TaskSpec:
        """The task for an env that shows none."""
        return self.task

    def absent_env(self) -> AbsentEnv:
        """A stand-in for the env where there is none."""
        width, horizon = self.about.get("observations"), self.about["horizon"]
        return AbsentEnv(self.task, **self.arrays["bounds"], horizon=horizon, width=width)

    def require_structure(self, agent: A) -> None:
        """Raises ValueError where the agent's task gives the arrays another meaning."""
        if different := difference(self.task, agent.task):
            raise ValueError("its {} is {}, the env has {}".format(*different))


def difference(task: TaskSpec, other: TaskSpec) -> tuple[str, Any, Any] | None:
    """The first entry of `STRUCTURE` in which two tasks differ, as each has it."""
    here, there = task.to_json(), other.to_json()
    different = ((n, here[n], there[n]) for n in STRUCTURE if here[n] != there[n])
    return next(different, None)


@contextlib.contextmanager
def reading(path: Path, algo: str, kind: type[S]) -> Iterator[S]:
    """Read a file, for the time in which an agent is made of it.

    A file that names no algorithm is of `mcpilco`.
    """
    about, arrays = read_groups(path)
    if (saved := about.get("algo", "mcpilco")) != algo:
        raise RunFolderError(
            f"{path} holds an agent of the algorithm {saved!r}, expected one of {algo!r}; "
            "load it with the class of its algorithm."
        )
    if about.get("format") not in kind.formats:
        raise RunFolderError(
            f"{path} has format {about.get('format')!r}, this mcpilco reads {kind.formats}; "
            "save the agent with this version, or install the one that saved it."
        )
    try:
        yield kind(about, arrays)
    except (EnvError, MissingObjectError):
        raise
    except Exception as error:  # what a damaged file says may lead to almost anything
        raise RunFolderError(
            f"{path} is damaged, or holds no agent of this env ({type(error).__name__}: {error})."
        ) from error


def npz_path(path: str | Path) -> Path:
    """The path of an agent's file, which ends with .npz."""
    if not isinstance(path, str | os.PathLike):
        raise InputError(f"An agent's file has a path, such as 'agent.npz', got {path!r:.80}.")
    path = Path(path)
    if path.suffix == ".npz":
        return path
    named = path.parent / f"{path.name}.npz"
    if path.is_dir() and not named.is_file():
        raise RunFolderError(f"{path} is a folder; name the file in it, as in {path}/agent.npz.")
    return named


def _own_kernel(agent: ModelBasedAgent) -> str | None:
    """The name of the kernel's class where the agent was given one; None: its configuration's."""
    if getattr(agent, "kernel", None) is None:
        return None
    return type(agent.model.gp.kernel).__name__


class SavedModelBased(SavedAgent["ModelBasedAgent"]):
    """The content of the file of an agent that learns a model.

    policy, gp; transitions, where there are any; perception, where states are measured in part;
    cost, where it was learned from rewards.
    """

    formats = (1, 2)
    """1 also held the state of random generators, which is no longer needed"""

    @classmethod
    def learned(cls, agent: ModelBasedAgent) -> tuple[dict[str, Any], Groups]:
        about = {
            "cost": _cost_name(agent.task.cost),
            "reference_cost": agent.reference_cost,
            "fitted_rows": agent.fitted_rows,
            "taught": agent.taught,
            **({} if (name := _own_kernel(agent)) is None else {"kernel": name}),
        }
        groups = {
            "policy": arrays_of(agent.policy),
            "gp": agent.model.to_arrays(),
            "cost": agent.task.cost.to_arrays() if isinstance(agent.task.cost, RewardCost) else {},
            "transitions": {} if agent.transitions is None else vars(agent.transitions),
        }
        if agent.perception is not None:
            groups["perception"] = agent.perception.to_arrays()
        return about, groups

    @property
    def task(self) -> TaskSpec:
        """The task that the agent knew, but for the cost."""
        task = super().task
        return dataclasses.replace(task, cost=None) if "cost" in self.arrays else task

    def task_for(self, env: gym.Env) -> TaskSpec:
        """The same with the cost that was guessed of this env, where it was."""
        task, guess = self.task, guess_task(env) if self.task.cost is unknown_cost else None
        if guess is None or _cost_name(guess.task.cost) != self.about.get("cost"):
            return task
        return dataclasses.replace(task, cost=guess.task.cost)

    def restore(self, agent: ModelBasedAgent) -> None:
        self.require_structure(agent)
        self._require_kernel(agent)
        trials, reference_cost = self.about["trials"], float(self.about["reference_cost"])
        if type(trials) is not int or trials < 0 or (trials and "transitions" not in self.arrays):
            raise ValueError(f"its trials are {trials!r}")
        if not math.isfinite(reference_cost):
            raise ValueError(f"its reference_cost is {reference_cost}")
        load_policy(agent.policy, self.arrays["policy"])
        agent.model.load_arrays(self.arrays["gp"])
        if agent.perception is not None:
            agent.perception.load_arrays(self.arrays["perception"])
        if isinstance(agent.task.cost, RewardCost) and "cost" in self.arrays:
            agent.task.cost.load_arrays(self.arrays["cost"])
        agent.trials, agent.reference_cost = trials, reference_cost
        agent.taught = bool(self.about.get("taught", False))
        if "transitions" in self.arrays:
            rows = Transitions(**self.arrays["transitions"])
            widths = agent.model.width, len(agent.task.input_names)
            if (rows.states.shape[1], rows.inputs.shape[1]) != widths:
                raise ValueError(f"its transitions have shapes {rows.states.shape}")
            agent.transitions = rows
            agent.fitted_rows = self._fitted_rows(len(rows))
            agent.look_ahead()

    def _require_kernel(self, agent: ModelBasedAgent) -> None:
        """Raises MissingObjectError where the agent's kernel is not that of the saved one."""
        saved, given = self.about.get("kernel"), _own_kernel(agent)
        if saved == given:
            return
        if saved is None:
            raise MissingObjectError(
                f"The saved agent has the kernel {agent.config.model.kernel} of its configuration, "
                f"got the kernel {given}; load it without `kernel`."
            )
        raise MissingObjectError(
            f"The saved agent has a kernel of its own, {saved!s:.80}, got "
            f"{given or 'none'}; give `load` the same one: kernel={saved!s:.80}."
        )

    def _fitted_rows(self, most: int) -> int:
        """How many of the rows the model was fitted to; files of before are of prompt actuators."""
        rows = self.about.get("fitted_rows", 0)
        if type(rows) is not int or not 0 <= rows <= most:
            raise ValueError(f"its fitted_rows are {rows!r}")
        return rows


def arrays_of(policy: nn.Module) -> dict[str, np.ndarray]:
    """The parameters of a policy by name."""
    return {name: value.numpy() for name, value in policy.state_dict().items()}


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


def _cost_name(cost: Cost | None) -> str:
    """A cost in words that are equal for equal ones: without addresses in memory."""
    if dataclasses.is_dataclass(cost):
        return str(cost)
    return getattr(cost, "__qualname__", type(cost).__qualname__)
