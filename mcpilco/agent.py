"""MC-PILCO: learn a model from seconds of experience, search a policy in it, try it, go on."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from jaxtyping import Float

from mcpilco.agent_file import reading, write_agent
from mcpilco.callbacks import Callback, Progress, as_callback
from mcpilco.config import PRESETS, Config
from mcpilco.contract import AbsentEnv, horizon_of, input_bounds, make_env, task_of
from mcpilco.costs import costs_along, held
from mcpilco.data import Rollout, Transitions, TrialResult
from mcpilco.engine import rollout_of
from mcpilco.episode import run_episode
from mcpilco.learning import Learning, SearchRequest, answer_alone
from mcpilco.model import Model
from mcpilco.observing import state_of, state_view
from mcpilco.policies import SumOfGaussians, blank_policy, random_policy
from mcpilco.reward_cost import RewardCost, with_cost
from mcpilco.rollout import Problem
from mcpilco.search import PolicySearch
from mcpilco.stopwatch import Stopwatch
from mcpilco.task import TaskSpec
from mcpilco.typing import Cost, Dynamics, InputError, UncertainDynamics

SHOWN_PARTICLES = 100
"""particles of a prediction that are kept with a trial's result"""


class MCPILCO:
    """The MC-PILCO agent, used like a stable-baselines3 algorithm.

        agent = MCPILCO("SumOfGaussians", "mcpilco/CartPoleSwingUp-v0", seed=0)
        agent.learn(total_timesteps=150)
        action, _ = agent.predict(observation)

    Reference: thesis chapter 5, Algorithm 1.
    """

    def __init__(
        self,
        policy: str,
        env: gym.Env | str,
        *,
        preset: str = "default",
        config: Config | None = None,
        seed: int = 0,
        verbose: int = 0,
        task: TaskSpec | None = None,
    ) -> None:
        """An agent that has learned nothing yet.

        Args:
            policy: `"SumOfGaussians"`.
            env: a Gymnasium env with one-dimensional Box spaces, or its id.
            preset: name of a configuration, see `mcpilco.config.PRESETS`; with the id of the
                cart-pole it also sets the env's keywords.
            config: the numbers themselves; takes precedence over `preset`.
            seed: of everything random; equal seeds give equal results.
            verbose: 0 silent, 1 shows progress.
            task: what to know of the env, where it does not show it as `task`; without either it
                is guessed, with a warning, where the env's class, model or names tell.

        Raises:
            InputError: an argument is unknown.
            EnvError: the env does not fit.
        """
        if policy != "SumOfGaussians":
            raise InputError(f'policy must be "SumOfGaussians", got {policy!r}.')
        if preset not in PRESETS:
            raise InputError(f"preset must be one of {sorted(PRESETS)}, got {preset!r}.")
        if not isinstance(seed, int | np.integer) or seed < 0:
            raise InputError(f"seed must be an integer of at least 0, got {seed!r}.")
        self.config = PRESETS[preset].config if config is None else config
        keywords = PRESETS[preset].keywords(env) if isinstance(env, str) and config is None else {}
        self.env = make_env(env, **keywords)
        self.seed = int(seed)
        self.verbose = verbose
        self.task = with_cost(task_of(self.env, task))
        self.low, self.high = input_bounds(self.env)
        self.horizon = horizon_of(self.env, self.config.horizon)
        self.policy = blank_policy(self.config.policy, self.task, self.low, self.high)
        self.model = Model(self.config.model, self.task)
        self.generator = torch.Generator().manual_seed(self.seed)
        self.exploration = np.random.default_rng(self.seed)
        self.transitions: Transitions | None = None
        self.reference_cost = 1.0
        self.trials = 0
        """trials done, in all calls of `learn` and before a `load`"""
        self.results: list[TrialResult] = []
        """of these trials; a `load` does not bring them back"""
        self.reset_seed: int | None = self.seed
        """of the env's next reset; None goes on with the random numbers it has"""

    @property
    def num_timesteps(self) -> int:
        """Steps of the env that the agent has learned from."""
        return 0 if self.transitions is None else len(self.transitions)

    def learn(
        self,
        total_timesteps: int,
        callback: Callback | Sequence[Callback] | None = None,
        progress_bar: bool = False,
    ) -> MCPILCO:
        """Spend `total_timesteps` steps of the env, rounded up to whole rollouts; return the agent.

        The first call spends one rollout on random inputs, or `Config.exploration` steps; each
        further rollout is a trial: fit the model to all data, search a policy, try it. Calling
        again continues.

        Args:
            total_timesteps: steps of the env.
            callback: told of each event, see `mcpilco.callbacks`.
            progress_bar: show progress on the screen.

        Raises:
            InputError: too few steps for a trial.
            EnvError: the env is absent, or misbehaves.
            NotPositiveDefiniteError: the data make the covariance of a GP singular.
        """
        answer_alone(self.learning(total_timesteps, callback, progress_bar))
        return self

    def learning(
        self,
        total_timesteps: int,
        callback: Callback | Sequence[Callback] | None = None,
        progress_bar: bool = False,
    ) -> Learning[None]:
        """`learn`, which stops at each search until it is sent the answer.

        Several agents can so be brought to their searches, and these be answered together.
        """
        if isinstance(self.env, AbsentEnv):
            self.env.reset()  # raises
        trials = self._affordable_trials(total_timesteps)
        shown = [Progress()] if progress_bar or self.verbose else []
        try:
            yield from self._learn(trials, as_callback(callback, *shown))
        finally:
            as_callback(shown).close()

    def _affordable_trials(self, total_timesteps: int) -> int:
        needed = self.timesteps_of(1)
        trials = 1 + math.ceil((total_timesteps - needed) / self.horizon)
        if trials < 1:
            first = f"{needed - self.horizon} of random inputs and " if self._unexplored else ""
            raise InputError(
                f"learn needs at least {needed} timesteps, {first}{self.horizon} for a trial, "
                f"got {total_timesteps}."
            )
        return trials

    def timesteps_of(self, trials: int) -> int:
        """The steps that `learn` needs for so many trials, random inputs included at first."""
        return trials * self.horizon + (self._exploration_steps if self._unexplored else 0)

    @property
    def _unexplored(self) -> bool:
        return self.transitions is None

    @property
    def _exploration_steps(self) -> int:
        """Steps of random inputs, before the first trial."""
        asked = self.config.exploration
        return self.horizon if asked is None else asked

    def _learn(self, trials: int, events: Callback) -> Learning[None]:
        events.on_training_start(self, trials)
        if self._unexplored:
            for record in self._explore():
                events.on_exploration(record)
        for _ in range(trials):
            self.results.append((yield from self._trial(events)))
            self.trials = self.results[-1].trial
            events.on_trial_end(self.results[-1])
        events.on_training_end()

    def _explore(self) -> list[Rollout]:
        """Rollouts of uniform random inputs: as many as it takes, where they end early."""
        records: list[Rollout] = []
        while (left := self._exploration_steps - self.num_timesteps) > 0:
            steps = min(left, self.horizon)
            records.append(
                self._run_episode(lambda _: self.exploration.uniform(self.low, self.high), steps)
            )
        self._learn_cost(records)
        self.policy = self._random_policy()
        return records

    def _learn_cost(self, random: Sequence[Rollout] = ()) -> None:
        """Fit the cost to the rewards so far, where it is not given, and what random inputs cost.

        Args:
            random: rollouts of random inputs, where these are the first.
        """
        cost = self.task.cost
        if isinstance(cost, RewardCost):
            if random:
                cost.baseline = float(
                    np.mean([held(record.rewards, self.horizon) for record in random])
                )
            cost.fit()
            self.reference_cost = cost.reference
        elif random:
            self.reference_cost = float(np.mean([self._costs(record) for record in random]))

    def _trial(self, events: Callback) -> Learning[TrialResult]:
        """Learn the model, search the policy, try it."""
        trial, data = self.trials + 1, self._data
        events.on_trial_start(trial)
        watch = Stopwatch()
        events.on_model_fitted(self.model.fit(data))
        self._learn_cost()
        request = self._request(self.model.dynamics(data), trial, events)
        watch.pause()
        found = yield request
        watch.resume(found.spent)
        self.policy = found.best.policy
        record = self._run_episode(self._act, self.horizon)
        success, spent = record.outcome.get("is_success"), watch.read()
        return TrialResult(
            trial=trial,
            experience_s=round(len(data) * self.task.dt, 9),  # 6 * 0.1 is not quite 0.6
            predicted_cost=found.best.cost,
            predicted_cost_std=found.best.cost_std,
            real_cost=float(self._costs(record).sum()),
            success=None if success is None else bool(success),
            time_up_s=record.outcome.get("time_up_s"),
            mean_abs_cart_m=record.outcome.get("mean_abs_cart_m"),
            noise_std=self.model.noise_std,
            policy_steps=found.steps,
            starts=found.starts,
            wall_s=spent.wall_s,
            cpu_s=spent.cpu_s,
            rollout=record,
            prediction=found.best.prediction(SHOWN_PARTICLES),
        )

    def _request(
        self, dynamics: Dynamics | UncertainDynamics, trial: int, events: Callback
    ) -> SearchRequest:
        """The search for the trial's policy."""
        problem = Problem(
            dynamics=dynamics,
            cost=self._cost,
            start_mean=torch.tensor(self.task.start_mean, dtype=torch.float64),
            start_std=torch.tensor(self.task.start_std, dtype=torch.float64),
            horizon=self.horizon,
            reference_cost=self.reference_cost,
            rollout=rollout_of(self.config, dynamics, self.policy),
        )
        warm = self.config.search.warm_start and trial > 1
        first = self.policy if warm else self._random_policy()
        search = PolicySearch(self.config.search, self.generator, events.on_policy_step)
        return SearchRequest(search, problem, first, self._random_policy, trial)

    def _random_policy(self) -> SumOfGaussians:
        """A start for the search, its centres spread over the states seen so far."""
        seen = self._data.states
        numbers = self.config.policy
        return random_policy(numbers, self.task, self.low, self.high, seen, self.generator)

    def _run_episode(self, act: Callable[[np.ndarray], np.ndarray], steps: int) -> Rollout:
        """A rollout on the system, which joins the data."""
        env = state_view(self.env, self.task)
        record = run_episode(env, act, steps, self.task.dt, seed=self.reset_seed)
        self.reset_seed = None
        if isinstance(self.task.cost, RewardCost):
            self.task.cost.add(record)
        rows = record.transitions()
        self.transitions = rows if self.transitions is None else self.transitions + rows
        return record

    def _costs(self, record: Rollout) -> Float[np.ndarray, " T"]:
        """Cost at the end of each step of a rollout on the system [-].

        An episode that ended early has its last cost to the end of the horizon.
        """
        if isinstance(self._cost, RewardCost):
            costs = self._cost.of_rewards(record.rewards)
        else:
            costs = costs_along(self._cost, record.shown_states[1:], record.inputs)
        return held(costs, self.horizon)

    @property
    def _cost(self) -> Cost:
        assert self.task.cost is not None, "with_cost has seen to it"
        return self.task.cost

    @property
    def _data(self) -> Transitions:
        assert self.transitions is not None, "learn explores first"
        return self.transitions

    def predict(
        self,
        observation: Float[np.ndarray, "*b O"],
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Float[np.ndarray, "*b U"], Any]:
        """The action for one observation or a batch; the state is unchanged, there is no memory.

        Args:
            observation: in the env's units.
            state: returned as it came.
            episode_start: not used.
            deterministic: not used; the policy is deterministic.

        Raises:
            InputError: the observation has another width, or is not finite.
        """
        observation = np.asarray(observation, dtype=np.float64)
        shape = self.env.observation_space.shape
        if observation.shape[-1:] != shape or not np.isfinite(observation).all():
            names = "" if self.task.observed else f" {self.task.state_names}"
            raise InputError(
                f"predict expects finite observations of {(shape or (0,))[0]} numbers{names}, "
                f"got shape {observation.shape}: {observation}."
            )
        action = np.clip(self._act(state_of(self.task, observation)), self.low, self.high)
        return action.astype(self.env.action_space.dtype), state

    def _act(self, state: Float[np.ndarray, "*b X"]) -> Float[np.ndarray, "*b U"]:
        with torch.no_grad():
            return self.policy(torch.as_tensor(state, dtype=torch.float64)).numpy()

    def save(self, path: str | Path) -> Path:
        """Write all that `load` needs to one `.npz` file of plain arrays; returns its path.

        Raises:
            RunFolderError: the file cannot be written.
        """
        return write_agent(Path(path), self)

    @classmethod
    def load(
        cls, path: str | Path, env: gym.Env | str | None = None, *, task: TaskSpec | None = None
    ) -> MCPILCO:
        """The agent that `save` wrote: it predicts the same, and `learn` goes on where it ended.

        An env keeps no record of its random numbers, so the next rollout seeds it anew, from the
        agent's seed and the number of its trials.

        Args:
            path: of the file.
            env: an env like the one it learned in, or its id; without one it can predict only.
            task: what to know of the env, where it does not show it; else what it knew when it was
                saved, but for a cost that was given as a function: it cannot learn on without.

        Raises:
            RunFolderError: the file is missing, damaged, or not an agent of this env.
            EnvError: the env does not fit.
        """
        with reading(Path(path)) as saved:
            if env is None:
                env = AbsentEnv(
                    saved.task,
                    **saved.arrays["bounds"],
                    horizon=saved.about["horizon"],
                    width=saved.about.get("observations"),
                )
            env = make_env(env)
            if task is None and getattr(env.unwrapped, "task", None) is None:
                task = saved.task_for(env)
            config, seed = saved.config, saved.about["seed"]
            agent = cls("SumOfGaussians", env, config=config, seed=seed, task=task)
            saved.restore(agent)
        return agent
