"""Callbacks that follow the learning: their base, those that write its numbers, and foreign ones.

An agent calls the methods of `Callback` while it learns, in this order (+ one or more times); a
callback reads and must not change the agent:

    on_training_start
    on_exploration +
    ( on_trial_start  on_model_fitted  on_policy_step +  on_trial_end ) +
    on_training_end

The learning ends before another trial where `stops` answers True.

Numbers have keys like stable-baselines3's: `model/noise_std_0`, `policy/cost`, `time/trial`.

Users give ours, and callbacks and loggers of stable-baselines3. To these a rollout is told step by
step once it is over, so that nothing that a callback does delays a step of the system:
`on_rollout_start`, `on_step` + , `on_rollout_end`. A callback whose `on_step` is False ends the
learning before the next trial.
"""

from __future__ import annotations

import contextlib
import functools
import json
import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Literal, Protocol, TextIO

import numpy as np

from mcpilco.data import Rollout, Transitions, TrialResult
from mcpilco.files import destination
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError, RunFolderError


class Agent(Protocol):
    """The attributes of an agent that callbacks may read."""

    env: Any
    task: TaskSpec
    policy: Any
    model: Any
    perception: Any
    transitions: Transitions | None
    results: list[TrialResult]
    config: Any

    @property
    def num_timesteps(self) -> int:
        """Steps of its env that it has learned from."""
        ...

    def save(self, path: str | Path) -> Path:
        """Write the agent to a file, whole or not at all."""
        ...


class Callback:
    """Does nothing; subclass and override what you need.

    An exception raised in a callback ends the training.
    """

    def on_training_start(self, agent: Agent, trials: int) -> None:
        """Called once, before the first step on the system; `trials` policies will be learned."""

    def on_exploration(self, rollout: Rollout) -> None:
        """Called after each rollout before the first trial: of random inputs, or a given policy."""

    def on_trial_start(self, trial: int) -> None:
        """Called before the models of trial 1, 2, ... are fitted."""

    def on_fit_step(self, step: int, steps: int) -> None:
        """Called after iteration 1, 2, ... of the fit of the models, of at most `steps`."""

    def on_model_fitted(self, values: dict[str, float]) -> None:
        """Called with the numbers of the fitted models, such as `model/nlml`."""

    def on_policy_step(self, step: int, steps: int, values: dict[str, float]) -> None:
        """Called after optimisation step 1, 2, ... of the trial, of at most `steps` as seen now."""

    def on_trial_end(self, result: TrialResult) -> None:
        """Called when the new policy has been tried on the system."""

    def on_training_end(self) -> None:
        """Called once, after the last trial; not called when training fails."""

    def stops(self) -> bool:
        """Whether to learn no further trial; asked after the exploration and after each trial."""
        return False

    def close(self) -> None:
        """Gives back files and the terminal; its maker calls it, also after an error."""


class CallbackList(Callback):
    """Several callbacks, called in order."""

    def __init__(self, callbacks: Iterable[Callback]) -> None:
        self.callbacks = list(callbacks)
        for event in ("close", *(name for name in vars(Callback) if name.startswith("on_"))):
            setattr(self, event, partial(self._tell, event))

    def _tell(self, event: str, *about: Any) -> None:
        for callback in self.callbacks:
            getattr(callback, event)(*about)

    def stops(self) -> bool:
        return any(callback.stops() for callback in self.callbacks)


def trial_values(result: TrialResult) -> dict[str, float]:
    """The numbers of one trial under their logging keys; without those that are not known."""
    values = {
        "rollout/experience_s": result.experience_s,
        "rollout/predicted_cost": result.predicted_cost,
        "rollout/predicted_cost_std": result.predicted_cost_std,
        "rollout/real_cost": result.real_cost,
        "rollout/ep_return": float(result.rollout.rewards.sum()),
        "rollout/success": result.success,
        **{f"rollout/{name}": value for name, value in result.outcome.items()},
        "policy/steps": result.policy_steps,
        "policy/starts": result.starts,
        "time/wall_s": result.wall_s,
        "time/cpu_s": result.cpu_s,
    }
    return {key: float(value) for key, value in values.items() if value is not None}


class Numbers(Callback):
    """Hands the numbers of each model fit, policy step and trial to `_write` of a subclass."""

    _trial = 0

    def on_trial_start(self, trial: int) -> None:
        self._trial = trial

    def on_model_fitted(self, values: dict[str, float]) -> None:
        self._write(values)

    def on_policy_step(self, step: int, steps: int, values: dict[str, float]) -> None:
        self._write(values, step)

    def on_trial_end(self, result: TrialResult) -> None:
        self._write(trial_values(result))

    def on_training_end(self) -> None:
        self.close()

    def _write(self, values: Mapping[str, float], step: int | None = None) -> None:
        """Write numbers of the present trial, or of one of its policy steps."""
        raise NotImplementedError


class JsonLines(Numbers):
    """Numbers of each model fit, policy step and trial: one JSON object a line.

    The keys `time/trial` and `time/step` say where a line belongs; a number that is not finite is
    null. Each line is handed to the system at once, so a crash costs at most one line.
    """

    def __init__(self, path: str | Path, append: bool = False) -> None:
        """Writes into `path`, from the start of the training on; with `append`, after its lines."""
        self.path = Path(path)
        self._mode: Literal["a", "w"] = "a" if append else "w"
        self._file: TextIO | None = None

    def on_training_start(self, agent: Agent, trials: int) -> None:
        """Opens the file.

        Raises:
            RunFolderError: the file cannot be written.
        """
        self.close()
        try:
            self._file = destination(self.path).open(self._mode, encoding="utf-8", buffering=1)
        except OSError as error:
            raise self._unwritable(error) from error

    def close(self) -> None:
        if self._file is not None:
            file, self._file = self._file, None
            with contextlib.suppress(OSError):  # what a full disk did not take was told before
                file.close()

    def _write(self, values: Mapping[str, float], step: int | None = None) -> None:
        assert self._file is not None, "on_training_start opens the file"
        place = {"time/trial": self._trial} | ({} if step is None else {"time/step": step})
        finite = {key: value if math.isfinite(value) else None for key, value in values.items()}
        try:
            self._file.write(json.dumps({**place, **finite}, default=float) + "\n")
        except OSError as error:
            raise self._unwritable(error) from error

    def _unwritable(self, error: OSError) -> RunFolderError:
        return RunFolderError(
            f"cannot write {self.path}: {error.strerror}; make room, or choose another folder."
        )


class TensorBoard(Numbers):
    """The same numbers as scalars for TensorBoard; policy steps count on from trial to trial."""

    def __init__(self, folder: str | Path, earlier_steps: int = 0) -> None:
        """Writes event files into `folder` from the start of the training on.

        What the folder tells of policy steps behind the `earlier_steps` no longer counts.

        Raises:
            InputError: the package tensorboard is not installed.
        """
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError as error:
            raise InputError(
                "TensorBoard logging needs the package tensorboard; run `pip install tensorboard`."
            ) from error
        purge = earlier_steps + 1 if earlier_steps else None
        self._open: Callable[[], Any] = lambda: SummaryWriter(str(folder), purge_step=purge)
        self._before = earlier_steps
        self._writer: Any = None

    def on_training_start(self, agent: Agent, trials: int) -> None:
        self.close()
        self._writer = self._open()
        self._trial = self._step = 0
        self._earlier_steps = self._before

    def on_trial_start(self, trial: int) -> None:
        super().on_trial_start(trial)
        self._earlier_steps += self._step
        self._step = 0

    def on_trial_end(self, result: TrialResult) -> None:
        super().on_trial_end(result)
        self._writer.flush()

    def close(self) -> None:
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def _write(self, values: Mapping[str, float], step: int | None = None) -> None:
        if step is not None:
            self._step = step
        place = self._trial if step is None else self._earlier_steps + step
        for key, value in values.items():
            self._writer.add_scalar(key, value, place)


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
