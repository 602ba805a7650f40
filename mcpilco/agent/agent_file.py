"""The file of an agent: plain arrays, and a JSON object that says what they are."""

from __future__ import annotations

import contextlib
import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import gymnasium as gym
import numpy as np

from mcpilco.agent.contract import AbsentEnv
from mcpilco.config import from_dict
from mcpilco.files import read_groups, write_groups
from mcpilco.task import TaskSpec
from mcpilco.typing import EnvError, RunFolderError

if TYPE_CHECKING:
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
    """What an agent's file holds; reading it checks nothing yet."""

    about: Mapping[str, Any]
    """numbers and names"""
    arrays: Groups
    """bounds, and what the agent has learned"""

    formats: ClassVar[tuple[int, ...]]
    """versions of the file that are read; the last one is written"""

    @classmethod
    @abstractmethod
    def learned(cls, agent: A) -> tuple[dict[str, Any], Groups]:
        """What the agent has learned: numbers and names, and arrays."""

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
        return write_groups(_npz(path), about, {"bounds": bounds, **groups})

    def config(self, kind: type[Any]) -> Any:
        """The agent's numbers, of the dataclass of its algorithm."""
        return from_dict(kind, self.about["config"])

    @property
    def task(self) -> TaskSpec:
        """What the agent knew of its env, but for a cost that was given as a function."""
        return TaskSpec.from_json(self.about["task"])

    def task_for(self, env: gym.Env) -> TaskSpec:
        """The task for an env that shows none."""
        return self.task

    def absent_env(self) -> AbsentEnv:
        """What stands for the env where there is none."""
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
    """What a file holds, for the time in which an agent is made of it.

    Args:
        path: of the file.
        algo: the algorithm of the agent; a file that names none is of `mcpilco`.
        kind: what the files of this algorithm hold.

    Raises:
        RunFolderError: the file is missing or damaged, or the agent cannot be made of it.
    """
    path = _npz(path)
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


def _npz(path: Path) -> Path:
    return path if path.suffix == ".npz" else path.with_name(f"{path.name}.npz")
