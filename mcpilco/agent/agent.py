"""MC-PILCO: particles in a Gaussian-process model, and the gradient of their cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from mcpilco.agent.episode import Act
from mcpilco.agent.excitation import PlannedInputs
from mcpilco.agent.model import KernelFactory, Model
from mcpilco.agent.model_based import ModelBasedAgent
from mcpilco.config import PRESETS, Config
from mcpilco.data import Rollout
from mcpilco.dynamics import PhysicsDynamics
from mcpilco.logbook import Callback
from mcpilco.policies import Bounds, Brake, Regulator, SumOfGaussians, blank_policy, random_policy
from mcpilco.search import (
    Candidate,
    Limits,
    PolicySearch,
    Problem,
    SearchResult,
    follow,
    rollout_of,
)
from mcpilco.sensing import DelayModel, Observer, Perception
from mcpilco.task import TaskSpec
from mcpilco.typing import Dynamics, InputError, UncertainDynamics


class MCPILCO(ModelBasedAgent):
    """The MC-PILCO agent, used like a stable-baselines3 algorithm.

        agent = MCPILCO("SumOfGaussians", "mcpilco/CartPoleSwingUp-v0", seed=0)
        agent.learn(total_timesteps=150)
        action, _ = agent.predict(observation)

    Reference: thesis chapter 5, Algorithm 1.
    """

    algo = "mcpilco"
    policy_name = "SumOfGaussians"
    config_type = Config
    presets = PRESETS
    objects = ("kernel",)

    def __init__(
        self,
        policy: str,
        env: gym.Env | str,
        *,
        preset: str = "default",
        config: Config | None = None,
        seed: int | None = 0,
        verbose: int = 0,
        task: TaskSpec | None = None,
        kernel: KernelFactory | None = None,
        **unknown: Any,
    ) -> None:
        """An agent that has learned nothing yet.

        Args:
            policy: "SumOfGaussians", a sum of Gaussian bases, squashed to the env's inputs.
            env: a Gymnasium env, or its id; its observations and actions are one-dimensional Boxes
                in physical units, the actions bounded.
            preset: named numbers: "default", "thorough", "limited", "thesis" or "tro2022", see
                `mcpilco.config.PRESETS`; with a cart-pole's id it also sets the env's keywords.
            config: the numbers themselves, such as `Config(horizon=60)` [steps]; takes precedence
                over `preset`.
            seed: of everything random; equal seeds give equal results. None draws one, which
                `agent.seed` tells.
            verbose: 0 is silent, 1 shows progress.
            task: names, units, sampling time [s], start and cost of the env, where it does not
                show them as `task`; without either they are guessed, with a warning, where the
                env's class, model or names tell.
            kernel: a kernel of your own in place of the one that `config.model.kernel` names: a
                subclass of `mcpilco.kernels.Kernel`, or a function of (width, batch) that makes
                one. It is no part of the file that `save` writes: give it to `load` again.
            **unknown: refused, with what to use in place of a keyword of stable-baselines3.

        Raises:
            TypeError: a keyword is unknown.
            InputError: an argument does not fit.
            EnvError: the env does not fit.
        """
        if not (kernel is None or callable(kernel)):
            raise InputError(
                f"kernel must be a function of (width, batch) that makes one, got {kernel!r:.80}; "
                "kernels of this package have names: Config(model=ModelConfig(kernel='rbf'))."
            )
        self.kernel = kernel
        super().__init__(
            policy,
            env,
            preset=preset,
            config=config,
            seed=seed,
            verbose=verbose,
            task=task,
            **unknown,
        )

    def _set_up(self) -> None:
        search = self.config.search
        self.limits = Limits.of(search.limits, search.kept, self.task)
        super()._set_up()

    def _new_model(self) -> Model:
        return Model(self.config.model, self.task, self.kernel)

    @staticmethod
    def make_policy(config: Config, task: TaskSpec, low: Bounds, high: Bounds) -> SumOfGaussians:
        seen, limits = task.after_inputs(config.model.memory), config.search.limits
        policy = blank_policy(config.policy, seen, low, high)
        if config.policy.regulator:
            policy.regulator = Regulator(config.policy, task, low, high, config.model.memory)
        if limits:
            policy.brake = Brake(limits, task, low, high, len(seen.state_names))
        return policy

    @staticmethod
    def make_model(config: Config, task: TaskSpec) -> Model:
        return Model(config.model, task)

    def _random_policy(self, generator: torch.Generator) -> SumOfGaussians:
        task, numbers = self._searched, self.config.policy
        seen = self._data.states[:, : len(task.state_names)]
        policy = random_policy(numbers, task, self.low, self.high, seen, generator)
        policy.regulator, policy.brake = self.policy.regulator, self.policy.brake
        return policy

    def _exciting(self, random: np.random.Generator, steps: int, before: Sequence[Rollout]) -> Act:
        late = self.model.memory > 0
        if self.config.excitation == "random" or late or not PlannedInputs.applies(self.task):
            return super()._exciting(random, steps, before)
        known = [record.transitions() for record in before]
        return PlannedInputs(self.task, self.low, self.high, steps, random, known)

    def _fit_model(self, trial: int) -> dict[str, float]:
        numbers, regulator = super()._fit_model(trial), self.policy.regulator
        if self.perception is not None and not self.model.memory:
            for _ in range(self.config.estimator.refinements):
                dynamics = self.model.dynamics(self._data)
                self._refined = self.perception.refined(self._data, dynamics)
                numbers = super()._fit_model(trial)
        if regulator is not None:
            numbers["model/regulator"] = regulator.learn(self.model.dynamics(self._data))
        return numbers

    def _search(
        self, trial: int, perception: Perception | None, events: Callback
    ) -> SearchResult[Candidate]:
        if self.policy.brake is not None:
            self.policy.brake.learn(self._data)
        problem, generator = self._problem(trial, perception), self.streams.search(trial)
        warm = self.config.search.warm_start and self._begins_with_policy(trial)
        first = self.policy if warm else self._random_policy(generator)
        search = PolicySearch(self.config.search, generator, events.on_policy_step)
        find = search.run if problem.easier is None else partial(follow, search)
        return find(problem, first, lambda: self._random_policy(generator), trial)

    def _problem(self, trial: int, perception: Perception | None) -> Problem:
        """The expected cost in the model as it is fitted now, as a function of the policy.

        Raises:
            NotPositiveDefiniteError: the model cannot be conditioned on the data.
        """
        dynamics = self.model.dynamics(self._data)
        observer = self._observer(dynamics, perception)
        task, brake = self._searched, self.policy.brake
        return Problem(
            dynamics=dynamics,
            cost=self._cost,
            start_mean=self._searched_start,
            start_std=torch.tensor(task.start_std, dtype=torch.float64),
            horizon=self.horizon,
            reference_cost=self.reference_cost,
            rollout=rollout_of(self.config, dynamics, self.policy, observer),
            observer=observer,
            correlation=self.config.search.correlation_of(trial),
            judged=len(self.task.state_names),
            easier=self._easier(dynamics, trial),
            limits=None if brake is not None and brake.holds else self.limits,
        )

    def _observer(self, dynamics: Any, perception: Perception | None) -> Observer | None:
        """Measures particles as the system will be: in part, and too early for a late actuator."""
        late = None if self.tracker is None else DelayModel(dynamics, self.model.delay)
        if perception is not None and self.config.estimator.modelled:
            return perception.observer(late)
        if late is None:
            return None
        assert self.tracker is not None, "the actuator is late"
        return Observer(late, self.tracker.noise_std)

    def _easier(
        self, dynamics: Any, trial: int
    ) -> Callable[[float], Dynamics | UncertainDynamics] | None:
        """Dynamics on the way to these, where effects make them hard."""
        if self._begins_with_policy(trial) or not self.config.search.continuation:
            return None
        known = isinstance(dynamics, PhysicsDynamics) and dynamics.physics.plant.added
        return dynamics.weakened if known else None

    @property
    def _searched(self) -> TaskSpec:
        """The task of the search: its states hold past inputs, where policies see these."""
        return self.task.after_inputs(self.config.model.memory)

    @property
    def _searched_start(self) -> Float[Tensor, " X"]:
        """The mean state that the first input acts on; before an episode inputs were 0."""
        start = torch.tensor(self._searched.start_mean, dtype=torch.float64)
        return start if self.tracker is None else self.tracker.start(start)
