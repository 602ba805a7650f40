"""The file of an agent: plain arrays, and a JSON object that says what they are."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import torch

from mcpilco.archive import read_groups, write_groups
from mcpilco.config import Config, from_dict
from mcpilco.data import Transitions
from mcpilco.guess import guess_task
from mcpilco.reward_cost import RewardCost
from mcpilco.task import TaskSpec, unknown_cost
from mcpilco.typing import EnvError, RunFolderError

if TYPE_CHECKING:
    from mcpilco.agent import MCPILCO

FORMAT = 1
"""version of the file"""
STRUCTURE = ("state_names", "input_names", "angles", "velocities", "dt", "observed")
"""entries of a task that give the arrays their meaning"""


@dataclass(frozen=True)
class SavedAgent:
    """What an agent's file holds; reading it checks nothing yet."""

    about: Mapping[str, Any]
    """numbers, names and the state of numpy's generator"""
    arrays: Mapping[str, Mapping[str, np.ndarray]]
    """bounds, generator, policy, gp, and transitions where there are any"""

    @property
    def config(self) -> Config:
        """The agent's numbers."""
        return from_dict(Config, self.about["config"])

    @property
    def task(self) -> TaskSpec:
        """What the agent knew of its env, but for the cost."""
        task = TaskSpec.from_json(self.about["task"])
        return dataclasses.replace(task, cost=None) if "cost" in self.arrays else task

    def task_for(self, env: gym.Env) -> TaskSpec:
        """The same with the cost that was guessed of this env, where it was."""
        task, guess = self.task, guess_task(env) if self.task.cost is unknown_cost else None
        if guess is None or str(guess.task.cost) != self.about.get("cost"):
            return task
        return dataclasses.replace(task, cost=guess.task.cost)

    def restore(self, agent: MCPILCO) -> None:
        """Give a new agent all that the saved one had learned.

        Raises:
            ValueError: an entry does not fit the agent, or is not finite.
        """
        saved, here = self.task.to_json(), agent.task.to_json()
        for name in STRUCTURE:
            if saved[name] != here[name]:
                raise ValueError(f"its {name} is {saved[name]}, the env has {here[name]}")
        policy = {name: torch.from_numpy(array) for name, array in self.arrays["policy"].items()}
        if not all(bool(value.isfinite().all()) for value in policy.values()):
            raise ValueError("its policy is not finite")
        agent.policy.load_state_dict(policy)
        agent.model.gp.load_arrays(self.arrays["gp"])
        if isinstance(agent.task.cost, RewardCost) and "cost" in self.arrays:
            agent.task.cost.load_arrays(self.arrays["cost"])
        agent.generator.set_state(torch.from_numpy(self.arrays["generator"]["state"]))
        agent.exploration.bit_generator.state = self.about["exploration"]
        agent.trials = int(self.about["trials"])
        agent.reference_cost = float(self.about["reference_cost"])
        if "transitions" in self.arrays:
            rows = Transitions(**self.arrays["transitions"])
            widths = len(agent.task.state_names), len(agent.task.input_names)
            if (rows.states.shape[1], rows.inputs.shape[1]) != widths:
                raise ValueError(f"its transitions have shapes {rows.states.shape}")
            agent.transitions = rows
            # The env keeps no record of its random numbers: it begins anew, in a defined way.
            entropy = np.random.SeedSequence((agent.seed, agent.trials))
            agent.reset_seed = int(entropy.generate_state(1)[0])


def write_agent(path: Path, agent: MCPILCO) -> Path:
    """Write all that an agent has learned, and what it needs to go on; returns the file's path.

    Raises:
        RunFolderError: the file cannot be written.
    """
    about = {
        "format": FORMAT,
        "config": dataclasses.asdict(agent.config),
        "task": agent.task.to_json(),
        "cost": str(agent.task.cost),
        "horizon": agent.horizon,
        "observations": int(np.prod(agent.env.observation_space.shape or (0,))),
        "seed": agent.seed,
        "trials": agent.trials,
        "reference_cost": agent.reference_cost,
        "exploration": agent.exploration.bit_generator.state,
    }
    dtype = agent.env.action_space.dtype
    groups = {
        "bounds": {"low": agent.low.astype(dtype), "high": agent.high.astype(dtype)},
        "generator": {"state": agent.generator.get_state().numpy()},
        "policy": {name: value.numpy() for name, value in agent.policy.state_dict().items()},
        "gp": agent.model.gp.to_arrays(),
        "cost": agent.task.cost.to_arrays() if isinstance(agent.task.cost, RewardCost) else {},
        "transitions": {} if agent.transitions is None else vars(agent.transitions),
    }
    return write_groups(_npz(path), about, groups)


@contextlib.contextmanager
def reading(path: Path) -> Iterator[SavedAgent]:
    """What a file holds, for the time in which an agent is made of it.

    Raises:
        RunFolderError: the file is missing or damaged, or the agent cannot be made of it.
    """
    path = _npz(path)
    about, arrays = read_groups(path)
    if about.get("format") != FORMAT:
        raise RunFolderError(
            f"{path} has format {about.get('format')!r}, this mcpilco reads {FORMAT}; "
            "save the agent with this version."
        )
    try:
        yield SavedAgent(about, arrays)
    except EnvError:
        raise
    except Exception as error:  # what a damaged file says may lead to almost anything
        raise RunFolderError(
            f"{path} is damaged, or holds no agent of this env ({type(error).__name__}: {error})."
        ) from error


def _npz(path: Path) -> Path:
    return path if path.suffix == ".npz" else path.with_name(f"{path.name}.npz")
