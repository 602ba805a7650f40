"""Callbacks that users give: ours, and callbacks and loggers of stable-baselines3.

A rollout is told step by step once it is over, so that nothing that a callback does delays a step
of the system: `on_rollout_start`, `on_step` + , `on_rollout_end`. A callback whose `on_step` is
False ends the learning before the next trial.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from mcpilco.data import Rollout, TrialResult
from mcpilco.logbook.callbacks import Agent, Callback, CallbackList, Numbers
from mcpilco.typing import InputError


def as_callback(callback: Any, *more: Callback) -> Callback:
    """One callback that stands for what the user gave (nothing, one, or several) and for `more`.

    Raises:
        InputError: an object that is no callback.
    """
    given = [] if callback is None else [callback]
    if isinstance(callback, Iterable):
        given = list(callback)
    return CallbackList([*map(_ours, given), *more])


def _ours(callback: Any) -> Callback:
    if isinstance(callback, Callback):
        return callback
    foreign = callable(callback) or hasattr(callback, "init_callback")
    if isinstance(callback, type) or not foreign:
        raise InputError(
            "callback must be a mcpilco.logbook.Callback, a callback of stable-baselines3, a "
            f"function of (locals, globals), or a list of them, got {callback!r:.80}."
        )
    return ForeignCallback(callback)


class ForeignCallback(Callback):
    """Passes rollouts on to a callback of stable-baselines3."""

    def __init__(self, callback: Any) -> None:
        """Tells a callback, or a function of (locals, globals).

        Raises:
            InputError: stable-baselines3 is not installed.
        """
        try:
            from stable_baselines3.common.callbacks import BaseCallback, ConvertCallback
        except ImportError as error:
            raise InputError(
                "A function or a callback of stable-baselines3 needs that package; run "
                "`pip install 'mcpilco[baselines]'`, or subclass mcpilco.logbook.Callback."
            ) from error
        known = isinstance(callback, BaseCallback)
        self.callback: Any = callback if known else ConvertCallback(callback)
        self._stopped = False

    def stops(self) -> bool:
        return self._stopped

    def on_training_start(self, agent: Any, trials: int) -> None:
        self._stopped = False
        self._model = _Model(agent)
        self.callback.init_callback(self._model)
        total = agent.num_timesteps + agent.timesteps_of(trials)
        told = {"self": agent, "total_timesteps": total, "tb_log_name": agent.algo}
        self.callback.on_training_start(told, {})

    def on_exploration(self, rollout: Rollout) -> None:
        self._tell(rollout, self._model.num_timesteps)

    def on_trial_end(self, result: TrialResult) -> None:
        rollout = result.rollout
        self._tell(rollout, self._model.agent.num_timesteps - len(rollout))

    def on_training_end(self) -> None:
        self.callback.on_training_end()

    def _tell(self, rollout: Rollout, before: int) -> None:
        """Each step as in an env that is the only one of a vector."""
        self.callback.on_rollout_start()
        last = len(rollout) - 1
        episode = {"r": float(rollout.rewards.sum()), "l": len(rollout)}
        for step in range(len(rollout)):
            self._model.num_timesteps = before + step + 1
            info = {"episode": episode, **rollout.outcome} if step == last else {}
            told = {
                "actions": rollout.inputs[step : step + 1],
                "new_obs": rollout.observations[step + 1 : step + 2],
                "rewards": rollout.rewards[step : step + 1],
                "dones": np.array([step == last]),
                "infos": [info],
            }
            self.callback.update_locals(told)
            self._stopped |= self.callback.on_step() is False
        self.callback.on_rollout_end()


class _Model:
    """An agent, as callbacks of stable-baselines3 see it."""

    def __init__(self, agent: Any) -> None:
        self.agent = agent
        self.num_timesteps = agent.num_timesteps
        """at the step that is told of"""

    def __getattr__(self, name: str) -> Any:
        return getattr(self.agent, name)

    @functools.cached_property
    def logger(self) -> Any:
        """The agent's, or one that writes nothing."""
        from stable_baselines3.common.logger import Logger

        return self.agent.logger or Logger(folder=None, output_formats=[])

    def dump_logs(self) -> None:
        """Writes what was recorded."""
        self.logger.dump(self.num_timesteps)

    @functools.cached_property
    def _env(self) -> Any:
        from stable_baselines3.common.vec_env import DummyVecEnv

        return DummyVecEnv([lambda: self.agent.env])

    def get_env(self) -> Any:
        """The agent's env, as the only one of a vector."""
        return self._env

    def get_vec_normalize_env(self) -> None:
        """None: observations are in their own units."""


class Logged(Numbers):
    """Records the numbers of each trial in a logger of stable-baselines3; a row a trial.

    The keys are those of `JsonLines`, of a search those of its last step.
    """

    def __init__(self, logger: Any) -> None:
        self._logger = logger

    def on_training_start(self, agent: Agent, trials: int) -> None:
        self._agent = agent

    def on_trial_end(self, result: TrialResult) -> None:
        super().on_trial_end(result)
        done = self._agent.num_timesteps
        self._write({"time/trial": result.trial, "time/total_timesteps": done})
        self._logger.dump(done)

    def _write(self, values: Mapping[str, float], step: int | None = None) -> None:
        for name, value in values.items():
            self._logger.record(name, value)
