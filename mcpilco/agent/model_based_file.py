"""The file of an agent that learns a model: policy, Gaussian processes and data."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import torch
from torch import nn

from mcpilco.agent.agent_file import Groups, MissingObjectError, SavedAgent
from mcpilco.agent.guess import guess_task
from mcpilco.data import Transitions
from mcpilco.policies import RewardCost
from mcpilco.task import TaskSpec, unknown_cost
from mcpilco.typing import Cost

if TYPE_CHECKING:
    from mcpilco.agent.model_based import ModelBasedAgent


def _own_kernel(agent: ModelBasedAgent) -> str | None:
    """The name of the kernel's class where the agent was given one; None: its configuration's."""
    if getattr(agent, "kernel", None) is None:
        return None
    return type(agent.model.gp.kernel).__name__


class SavedModelBased(SavedAgent["ModelBasedAgent"]):
    """What the file holds.

    policy, gp; transitions, where there are any; perception, where states are measured in part;
    cost, where it was learned from rewards.
    """

    formats = (1, 2)
    """1 also held the state of random generators, which is no longer needed"""

    @classmethod
    def learned(cls, agent: ModelBasedAgent) -> tuple[dict[str, Any], Groups]:
        about = {
            "cost": _told(agent.task.cost),
            "reference_cost": agent.reference_cost,
            "fitted_rows": agent.fitted_rows,
            **({} if (name := _own_kernel(agent)) is None else {"kernel": name}),
        }
        groups = {
            "policy": {name: value.numpy() for name, value in agent.policy.state_dict().items()},
            "gp": agent.model.to_arrays(),
            "cost": agent.task.cost.to_arrays() if isinstance(agent.task.cost, RewardCost) else {},
            "transitions": {} if agent.transitions is None else vars(agent.transitions),
        }
        if agent.perception is not None:
            groups["perception"] = agent.perception.to_arrays()
        return about, groups

    @property
    def task(self) -> TaskSpec:
        """What the agent knew of its env, but for the cost."""
        task = super().task
        return dataclasses.replace(task, cost=None) if "cost" in self.arrays else task

    def task_for(self, env: gym.Env) -> TaskSpec:
        """The same with the cost that was guessed of this env, where it was."""
        task, guess = self.task, guess_task(env) if self.task.cost is unknown_cost else None
        if guess is None or _told(guess.task.cost) != self.about.get("cost"):
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


def _told(cost: Cost | None) -> str:
    """What a cost is, in words that are equal for equal ones: without addresses in memory."""
    if dataclasses.is_dataclass(cost):
        return str(cost)
    return getattr(cost, "__qualname__", type(cost).__qualname__)
