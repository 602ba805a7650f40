"""The agent PILCO: learns by trials as MC-PILCO does, with another model, policy and search."""

from __future__ import annotations

import dataclasses
from functools import partial

import torch

from baselines.moments.costs import TipDistanceCost, expected_cost
from baselines.moments.image import Gaussian
from baselines.pilco.model import PRESETS, PilcoConfig, PilcoModel
from baselines.pilco.rollout import GPMean
from baselines.pilco.search import Candidate, Problem, Starts, pilco_search
from mcpilco.agent import ModelBasedAgent
from mcpilco.dynamics import AngleAugmentation
from mcpilco.logbook import Callback
from mcpilco.policies import Bounds
from mcpilco.search import SearchResult
from mcpilco.sensing import Perception
from mcpilco.task import TaskSpec, unknown_cost
from mcpilco.typing import InputError


class PILCO(ModelBasedAgent):
    """The PILCO agent, used like a stable-baselines3 algorithm.

        agent = PILCO("GPMean", "mcpilco/CartPoleSwingUp-v0", seed=0)
        agent.learn(total_timesteps=150)
        action, _ = agent.predict(observation)

    Reference: Deisenroth, Fox & Rasmussen 2015 (DFR, see `baselines.moments.image`).
    Differs: L-BFGS in place of BFGS; where the model has no finite answer to the last policy, the
        search starts from a random one; with `restarts` it starts from more of them.
    """

    algo = "pilco"
    policy_name = "GPMean"
    config_type = PilcoConfig
    presets = PRESETS
    model: PilcoModel

    @staticmethod
    def make_policy(config: PilcoConfig, task: TaskSpec, low: Bounds, high: Bounds) -> GPMean:
        augmentation = AngleAugmentation(len(task.state_names), task.angles)
        return GPMean(augmentation, low, high, config.centres)

    @staticmethod
    def make_model(config: PilcoConfig, task: TaskSpec) -> PilcoModel:
        return PilcoModel(config, task)

    def _own_task(self, task: TaskSpec) -> TaskSpec:
        if task.measured is not None:
            raise InputError(
                "PILCO learns where all states are measured, got a task that measures a part of "
                "them; let the env show its states, or take the algorithm mcpilco."
            )
        if self.config.cost == "tip":
            task = dataclasses.replace(task, cost=_tip_cost(self.config, task))
        if task.cost is None:
            raise InputError(
                "PILCO needs a task with a cost, got one whose cost is learned from the rewards; "
                "give the task a cost, or take the algorithm mcpilco."
            )
        if task.cost is not unknown_cost:  # that of an agent that was loaded to predict only
            start, inputs = _start(task), torch.zeros(len(task.input_names), dtype=torch.float64)
            expected_cost(task.cost, start, Gaussian(inputs, torch.diag(inputs)))  # raises
        return task

    def _fit_model(self, trial: int) -> dict[str, float]:
        return self.model.fit(self._data, warm=trial > 1)

    def _random_policy(self, generator: torch.Generator) -> GPMean:
        """Centres where episodes start, values around zero."""
        config, policy = self.config, self.make_policy(self.config, self.task, self.low, self.high)
        spread = self.task.start_mean, self.task.start_std
        mean, std = torch.tensor(spread, dtype=torch.float64)
        size = config.centres, len(mean)
        states = mean + std * torch.randn(size, generator=generator, dtype=torch.float64)
        plain, angles = len(policy.augmentation.plain), len(policy.augmentation.angles)
        scales = [config.lengthscale] * plain + [config.angle_lengthscale] * (2 * angles)
        lengthscale = torch.tensor(scales, dtype=torch.float64)
        policy.randomise(states, lengthscale, config.target_std, generator)
        return policy

    def _search(
        self, trial: int, perception: Perception | None, events: Callback
    ) -> SearchResult[Candidate]:
        dynamics = self.model.moments(self._data)
        problem = Problem(dynamics, self._cost, _start(self.task), self.horizon)
        generator = self.streams.search(trial)
        first = self.policy if self._begins_with_policy(trial) else self._random_policy(generator)
        fresh = partial(self._random_policy, generator)
        fails = self.config.failing * self.reference_cost
        starts = Starts(fresh, self.config.further_starts(trial), fails)
        return pilco_search(self.config, problem, first, starts, generator, events.on_policy_step)


def _start(task: TaskSpec) -> Gaussian:
    std = torch.tensor(task.start_std, dtype=torch.float64)
    return Gaussian(torch.tensor(task.start_mean, dtype=torch.float64), torch.diag(std.square()))


def _tip_cost(config: PilcoConfig, task: TaskSpec) -> TipDistanceCost:
    names = "cart_position", "pole_angle"
    if not set(names) <= set(task.state_names):
        raise InputError(
            f"The cost `tip` is of a cart-pole with the states {names}, got {task.state_names}; "
            "take the cost of the task."
        )
    cart, angle = map(task.state_names.index, names)
    return TipDistanceCost(cart, angle, config.tip_length, config.tip_width)
