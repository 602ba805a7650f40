"""Agents that learn with an algorithm of stable-baselines3, with the face of `MCPILCO`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import TimeLimit
from jaxtyping import Float

from baselines.sb3.config import PPOConfig, SACConfig, SB3Config, TQCConfig, TunedPreset, shipped
from baselines.sb3.library import (
    CLASSES,
    SavedSB3,
    Told,
    View,
    ViewedEnv,
    quiet_logger,
    random_numbers,
    vector_of,
)
from mcpilco.agent import TrialAgent
from mcpilco.data import Stopwatch, TrialResult
from mcpilco.logbook import Callback
from mcpilco.typing import InputError


class SB3Agent(TrialAgent):
    """The base of the agents SAC, TQC and PPO.

    A trial is a stretch of learning, `trial_steps` steps of the env long, and then one rollout of
    the policy without its noise, which is recorded, and neither learned from nor counted. What a
    trial draws at random is a function of seed and trial, so a training goes on from a file as if
    it had never stopped.
    """

    policy_name = "MlpPolicy"
    presets: ClassVar[Mapping[str, TunedPreset]]
    saved_type = SavedSB3

    def _set_up(self) -> None:
        self.view = View(self.task, self.low, self.high)
        """what the networks see of observations, and what becomes of their actions"""
        self.learner = self._new_learner()
        """the algorithm of stable-baselines3, in an env behind the view"""
        self.policy = getattr(self.learner.policy, "actor", self.learner.policy)
        self.borrowed_timesteps = 0
        """steps of the env that another agent has taken, and that this one has learned from too"""

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
        return self.learner.num_timesteps

    @staticmethod
    def usual_trials(config: SB3Config) -> int:
        """Trials that take the `n_timesteps` of the numbers."""
        return config.trials

    def timesteps_of(self, trials: int) -> int:
        return trials * self.config.trial_steps

    def borrow(self, timesteps: int) -> None:
        """Count steps of the env that others have taken; random inputs are not needed then."""
        self.borrowed_timesteps = timesteps
        if timesteps:
            self.learner.learning_starts = 0

    def _trials_within(self, total_timesteps: int) -> int:
        if total_timesteps < 1:
            raise InputError(f"learn needs at least 1 timestep, got {total_timesteps}.")
        return math.ceil(total_timesteps / self.config.trial_steps)

    def _trial(self, trial: int, steps: int, events: Callback) -> TrialResult:
        watch, updates = Stopwatch(), self.learner._n_updates
        self._practise(trial, min(self.config.trial_steps, steps), events)
        record, failure = self._run_episode(self.inputs_in, trial, self.horizon)
        known = self.num_timesteps + self.borrowed_timesteps
        steps = self.learner._n_updates - updates
        return self._result(trial, record, watch, known, policy_steps=steps, failure=failure)

    def _practise(self, trial: int, steps: int, events: Callback) -> None:
        """Learn for so many steps, from new episodes on."""
        learner, seed = self.learner, self._draw(trial)
        learner.env.seed(seed)  # used by the envs' next reset,
        learner._last_obs = None  # which comes first
        learner.action_space.seed(seed)
        with random_numbers(seed):
            learner.learn(steps, Told(events, steps), log_interval=None, reset_num_timesteps=False)

    def _answer(
        self, measured: Float[np.ndarray, "*b Y"], state: Any, begun: Any, deterministic: bool
    ) -> tuple[Float[np.ndarray, "*b U"], Any]:
        return self.inputs_in(measured, deterministic), state

    def inputs_in(
        self, states: Float[np.ndarray, "*b X"], deterministic: bool = True
    ) -> Float[np.ndarray, "*b U"]:
        """The policy's inputs in states, in the env's unit."""
        features = self.view.features(states)
        rows = features.reshape(-1, features.shape[-1])
        actions, _ = self.learner.predict(rows, deterministic=deterministic)
        return self.view.inputs(actions).reshape(*features.shape[:-1], -1)


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
    algo: str,
    env: gym.Env | str,
    *,
    preset: str = "default",
    seed: int | None = 0,
    config: Any = None,
) -> SB3Agent:
    """An agent for `baselines.evaluate.learning_curve`: `num_timesteps`, `learn`, `predict`.

    Args:
        algo: sac, tqc or ppo.
        env: a Gymnasium env or its id; the preset has numbers of its own for the envs of this
            package.
        preset: name of a configuration.
        seed: of everything random; None draws one.
        config: the numbers themselves; takes precedence over `preset`.

    Raises:
        InputError: an argument is unknown.
        EnvError: the env does not fit.
    """
    kinds = {kind.algo: kind for kind in (SACAgent, TQCAgent, PPOAgent)}
    if algo not in kinds:
        raise InputError(f"algo must be one of {sorted(kinds)}, got {algo!r}.")
    return kinds[algo]("MlpPolicy", env, preset=preset, seed=seed, config=config)
