"""Agents that learn with an algorithm of stable-baselines3, with the face of `MCPILCO`."""

from __future__ import annotations

import math
from abc import ABC
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Self

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import TimeLimit
from jaxtyping import Float
from torch import nn

from baselines.sb3.agent_file import reading, write_agent
from baselines.sb3.config import PPOConfig, SACConfig, SB3Config, TQCConfig
from baselines.sb3.library import CLASSES, Told, quiet_logger, random_numbers, vector_of
from baselines.sb3.presets import TunedPreset, shipped
from baselines.sb3.view import View, ViewedEnv
from mcpilco.callbacks import Callback, Progress, as_callback
from mcpilco.contract import AbsentEnv, horizon_of, input_bounds, make_env, task_of
from mcpilco.controller import Act, remembering
from mcpilco.costs import held
from mcpilco.data import Rollout, Transitions, TrialResult
from mcpilco.episode import BrokenEpisodeError, run_episode
from mcpilco.learning import Learning
from mcpilco.observing import state_of, state_view
from mcpilco.reward_cost import costs_of
from mcpilco.stopwatch import Stopwatch
from mcpilco.streams import Streams
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError


class SB3Agent(ABC):
    """What SAC, TQC and PPO have in common.

    A trial is a stretch of learning, `trial_steps` steps of the env long, and then one rollout of
    the policy without its noise, which is recorded, and neither learned from nor counted. What a
    trial draws at random is a function of seed and trial, so a training goes on from a file as if
    it had never stopped.
    """

    algo: ClassVar[str]
    """what the command line and files call the algorithm"""
    policy_name: ClassVar[str] = "MlpPolicy"
    """what its policy is called"""
    config_type: ClassVar[type[SB3Config]]
    """the dataclass of its numbers"""
    presets: ClassVar[Mapping[str, TunedPreset]]
    """its named settings, each with numbers for some envs"""
    model: None = None
    """of the system: it learns none"""
    perception: None = None
    """states are measured"""
    transitions: Transitions | None = None
    """none are kept for a model"""

    def __init__(
        self,
        policy: str,
        env: gym.Env | str,
        *,
        preset: str = "default",
        config: Any = None,
        seed: int = 0,
        verbose: int = 0,
        task: TaskSpec | None = None,
    ) -> None:
        """An agent that has learned nothing yet.

        Args:
            policy: "MlpPolicy".
            env: a Gymnasium env with one-dimensional Box spaces, or its id. Where `n_envs` exceeds
                1, the others are made as this one was.
            preset: name of a configuration, one of `presets`.
            config: the numbers themselves; takes precedence over `preset`.
            seed: of everything random; equal seeds give equal results.
            verbose: 0 silent, 1 shows progress.
            task: what to know of the env, where it does not show it as `task`; it learns from
                rewards alone, whatever the cost.

        Raises:
            InputError: an argument is unknown, or the task measures a part of its states.
            EnvError: the env does not fit.
        """
        if policy != self.policy_name:
            raise InputError(f'policy must be "{self.policy_name}", got {policy!r}.')
        if preset not in self.presets:
            raise InputError(f"preset must be one of {sorted(self.presets)}, got {preset!r}.")
        if not isinstance(seed, int | np.integer) or seed < 0:
            raise InputError(f"seed must be an integer of at least 0, got {seed!r}.")
        self.env = make_env(env)
        tuned = self.presets[preset].config_for("" if self.env.spec is None else self.env.spec.id)
        self.config: Any = tuned if config is None else config
        self.seed = int(seed)
        self.verbose = verbose
        self.task = task_of(self.env, task)
        self.low, self.high = input_bounds(self.env)
        self.horizon = horizon_of(self.env, self.config.horizon)
        self.view = View(self.task, self.low, self.high)
        """what the networks see of observations, and what becomes of their actions"""
        self.streams = Streams(self.seed)
        self.learner = self._new_learner()
        """the algorithm of stable-baselines3, in an env behind the view"""
        self.policy: nn.Module = getattr(self.learner.policy, "actor", self.learner.policy)
        """the network that acts"""
        self.borrowed_timesteps = 0
        """steps of the env that another agent has taken, and that this one has learned from too"""
        self.trials = 0
        """trials done, in all calls of `learn` and before a `load`"""
        self.results: list[TrialResult] = []
        """of these trials; a `load` does not bring them back"""

    def _new_learner(self) -> Any:
        def viewed(env: gym.Env) -> gym.Env:
            return TimeLimit(ViewedEnv(env, self.view), self.horizon)

        numbers, envs = self.config, vector_of(self.env, self.config.n_envs, viewed)
        with random_numbers(self._draw(trial=0)):
            learner = CLASSES[self.algo](numbers.policy, envs, device="cpu", **numbers.keywords())
        learner.set_logger(quiet_logger())
        return learner

    def _draw(self, trial: int) -> int:
        """The seed of all that a trial draws while it learns."""
        return int(self.streams.inputs(trial).integers(2**31))

    @property
    def num_timesteps(self) -> int:
        """Steps of its env that the agent has learned from."""
        return self.learner.num_timesteps

    @staticmethod
    def usual_trials(config: SB3Config) -> int:
        """Trials that take the `n_timesteps` of the numbers."""
        return config.trials

    def timesteps_of(self, trials: int) -> int:
        """The steps that `learn` needs for so many trials."""
        return trials * self.config.trial_steps

    def learn(
        self,
        total_timesteps: int,
        callback: Callback | Sequence[Callback] | None = None,
        progress_bar: bool = False,
    ) -> Self:
        """Spend `total_timesteps` steps of the env, in trials; return the agent.

        The number is rounded up to what the algorithm takes between two updates: PPO takes
        `n_envs * n_steps`. Calling again continues. Unlike in stable-baselines3 the count goes on
        too, as with `reset_num_timesteps=False`.

        Args:
            total_timesteps: steps of the env, of all its copies together.
            callback: told of each event, see `mcpilco.callbacks`; an episode is told as a step of
                a policy search is, with its cost, steps less rewards, as `policy/cost`.
            progress_bar: show progress on the screen.

        Raises:
            InputError: no step.
            EnvError: the env is absent, or misbehaves.
        """
        if isinstance(self.env, AbsentEnv):
            self.env.reset()  # raises
        if total_timesteps < 1:
            raise InputError(f"learn needs at least 1 timestep, got {total_timesteps}.")
        shown = [Progress()] if progress_bar or self.verbose else []
        try:
            self._learn(total_timesteps, as_callback(callback, *shown))
        finally:
            as_callback(shown).close()
        return self

    def learning(
        self,
        total_timesteps: int,
        callback: Callback | Sequence[Callback] | None = None,
        progress_bar: bool = False,
    ) -> Learning[None]:
        """`learn` for a sweep: it has no search that others could answer, and runs at once."""
        self.learn(total_timesteps, callback, progress_bar)
        yield from ()

    def borrow(self, timesteps: int) -> None:
        """Count steps of the env that others have taken; random inputs are not needed then.

        Args:
            timesteps: that this agent learns from, beside its own.
        """
        self.borrowed_timesteps = timesteps
        if timesteps:
            self.learner.learning_starts = 0

    def _learn(self, total_timesteps: int, events: Callback) -> None:
        most = self.config.trial_steps
        trials, end = math.ceil(total_timesteps / most), self.num_timesteps + total_timesteps
        events.on_training_start(self, trials)
        for _ in range(trials):
            result = self._trial(min(most, end - self.num_timesteps), events)
            self.results.append(result)
            self.trials = result.trial
            events.on_trial_end(result)
        events.on_training_end()

    def _trial(self, steps: int, events: Callback) -> TrialResult:
        """Learn for a while, then try the policy."""
        trial, watch, updates = self.trials + 1, Stopwatch(), self.learner._n_updates
        events.on_trial_start(trial)
        self._practise(trial, steps, events)
        record, failure = self._try(trial)
        success, spent = record.outcome.get("is_success"), watch.read()
        known = self.num_timesteps + self.borrowed_timesteps
        return TrialResult(
            trial=trial,
            experience_s=round(known * self.task.dt, 9),  # 6 * 0.1 is not quite 0.6
            predicted_cost=math.nan,
            predicted_cost_std=math.nan,
            real_cost=float(held(costs_of(self.task.cost, record), self.horizon).sum()),
            success=None if success is None else bool(success),
            time_up_s=record.outcome.get("time_up_s"),
            mean_abs_cart_m=record.outcome.get("mean_abs_cart_m"),
            noise_std=(),
            policy_steps=self.learner._n_updates - updates,
            starts=0,
            wall_s=spent.wall_s,
            cpu_s=spent.cpu_s,
            rollout=record,
            prediction=None,
            failure=failure,
        )

    def _practise(self, trial: int, steps: int, events: Callback) -> None:
        """Learn for so many steps, from new episodes on."""
        learner, seed = self.learner, self._draw(trial)
        learner.env.seed(seed)  # told to the envs by their next reset,
        learner._last_obs = None  # which comes first
        learner.action_space.seed(seed)
        with random_numbers(seed):
            learner.learn(steps, Told(events, steps), log_interval=None, reset_num_timesteps=False)

    def _try(self, trial: int) -> tuple[Rollout, str | None]:
        """A rollout of the policy, and why it broke off if it did."""
        env, width = state_view(self.env, self.task), len(self.task.state_names)
        seed = self.streams.reset(trial)
        dt, act = self.task.dt, self.inputs_in
        try:
            return run_episode(env, act, self.horizon, dt, seed=seed, width=width), None
        except BrokenEpisodeError as error:
            return error.rollout, " ".join(str(error).split())

    def predict(
        self,
        observation: Float[np.ndarray, "*b O"],
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Float[np.ndarray, "*b U"], Any]:
        """The action for one observation or a batch; it has no memory.

        Args:
            observation: in the env's units.
            state: returned as it came.
            episode_start: not used.
            deterministic: without the noise of exploration. Differs: stable-baselines3 has False.

        Raises:
            InputError: the observation has another width, or is not finite.
        """
        observation = np.asarray(observation, dtype=np.float64)
        shape = self.env.observation_space.shape
        if observation.shape[-1:] != shape or not np.isfinite(observation).all():
            raise InputError(
                f"predict expects finite observations of {(shape or (0,))[0]} numbers, "
                f"got shape {observation.shape}: {observation}."
            )
        action = self.inputs_in(state_of(self.task, observation), deterministic)
        return action.astype(self.env.action_space.dtype), state

    def inputs_in(
        self, states: Float[np.ndarray, "*b X"], deterministic: bool = True
    ) -> Float[np.ndarray, "*b U"]:
        """What the policy answers in states, in the env's unit.

        Args:
            states: as `task` has them, in their units.
            deterministic: without the noise of exploration.
        """
        features = self.view.features(states)
        rows = features.reshape(-1, features.shape[-1])
        actions, _ = self.learner.predict(rows, deterministic=deterministic)
        return self.view.inputs(actions).reshape(*features.shape[:-1], -1)

    def controller(self) -> Act:
        """What acts for one episode, or a batch that begins together."""
        return remembering(self.predict)

    def save(self, path: str | Path) -> Path:
        """Write all that `load` needs to one `.npz` file of plain arrays; returns its path.

        Raises:
            RunFolderError: the file cannot be written.
        """
        return write_agent(Path(path), self)

    @classmethod
    def load(
        cls, path: str | Path, env: gym.Env | str | None = None, *, task: TaskSpec | None = None
    ) -> Self:
        """The agent that `save` wrote: it predicts the same, and `learn` goes on where it ended.

        What it learns is what the saved agent would have learned, in an env whose episodes are
        functions of the seed that `reset` is given. The episodes that were running when it was
        saved are not gone on with: each trial begins new ones.

        Args:
            path: of the file.
            env: an env like the one it learned in, or its id; without one it can predict only.
            task: what to know of the env, where it does not show it; else what it knew when it was
                saved.

        Raises:
            RunFolderError: the file is missing, damaged, or not an agent of this class and env.
            EnvError: the env does not fit.
        """
        with reading(Path(path), cls.algo) as saved:
            if env is None:
                width, horizon = saved.about["observations"], saved.about["horizon"]
                env = AbsentEnv(saved.task, **saved.arrays["bounds"], horizon=horizon, width=width)
            env = make_env(env)
            if task is None and getattr(env.unwrapped, "task", None) is None:
                task = saved.task
            config, seed = saved.config(cls.config_type), saved.about["seed"]
            agent = cls(cls.policy_name, env, config=config, seed=seed, task=task)
            saved.restore(agent)
        return agent


class SACAgent(SB3Agent):
    """Soft actor-critic.

    Reference: Haarnoja et al., Soft actor-critic algorithms and applications, 2018.
    """

    algo = "sac"
    config_type = SACConfig
    presets = shipped("sac", SACConfig)


class TQCAgent(SB3Agent):
    """Truncated quantile critics.

    Reference: Kuznetsov et al., Controlling overestimation bias with truncated mixture of
    continuous distributional quantile critics, 2020.
    """

    algo = "tqc"
    config_type = TQCConfig
    presets = shipped("tqc", TQCConfig)


class PPOAgent(SB3Agent):
    """Proximal policy optimisation.

    Reference: Schulman et al., Proximal policy optimization algorithms, 2017.
    """

    algo = "ppo"
    config_type = PPOConfig
    presets = shipped("ppo", PPOConfig)


def make_learner(
    algo: str, env: gym.Env | str, *, preset: str = "default", seed: int = 0, config: Any = None
) -> SB3Agent:
    """An agent for `baselines.evaluate.learning_curve`: `num_timesteps`, `learn`, `predict`.

    Args:
        algo: sac, tqc or ppo.
        env: a Gymnasium env or its id; the preset has numbers of its own for the envs of this
            package.
        preset: name of a configuration.
        seed: of everything random.
        config: the numbers themselves; takes precedence over `preset`.

    Raises:
        InputError: an argument is unknown.
        EnvError: the env does not fit.
    """
    kinds = {kind.algo: kind for kind in (SACAgent, TQCAgent, PPOAgent)}
    if algo not in kinds:
        raise InputError(f"algo must be one of {sorted(kinds)}, got {algo!r}.")
    return kinds[algo]("MlpPolicy", env, preset=preset, seed=seed, config=config)
