"""An agent that learns by trials: its making, its loop, its answers, its file.

What a trial does is a subclass's: `mcpilco.agent.model_based.ModelBasedAgent` fits a model and
searches a policy in it.
"""

from __future__ import annotations

import logging
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from numbers import Real
from pathlib import Path
from typing import Any, ClassVar, Self

import gymnasium as gym
import numpy as np
from jaxtyping import Float
from torch import nn

from mcpilco.agent.agent_file import SavedAgent, npz_path, reading
from mcpilco.agent.contract import (
    AbsentEnv,
    check_cost,
    horizon_of,
    input_bounds,
    make_env,
    name_of,
    task_of,
)
from mcpilco.agent.episode import (
    Act,
    BrokenEpisodeError,
    Controller,
    Streams,
    remembering,
    run_episode,
)
from mcpilco.agent.keywords import refuse_keywords
from mcpilco.agent.model import Model
from mcpilco.config import Preset
from mcpilco.data import Rollout, Stopwatch, Transitions, TrialResult
from mcpilco.logbook import Callback, Logged, Progress, Results, as_callback
from mcpilco.policies import costs_of, held
from mcpilco.sensing import Perception, state_of, state_view
from mcpilco.task import TaskSpec, unknown_cost
from mcpilco.typing import InputError

logger = logging.getLogger(__name__)


class TrialAgent(ABC):
    """An agent that learns by trials; a subclass says what it does in a trial."""

    algo: ClassVar[str]
    """what the command line and files call the algorithm, see `mcpilco.agent.algorithms`"""
    policy_name: ClassVar[str]
    """what its policy is called"""
    config_type: ClassVar[type[Any]]
    """the dataclass of its numbers: with `horizon`, and all with defaults"""
    presets: ClassVar[Mapping[str, Preset]]
    """its named settings; one is `default`"""
    saved_type: ClassVar[type[SavedAgent[Any]]]
    """what its file holds"""
    objects: ClassVar[tuple[str, ...]] = ()
    """keywords of what it is made with and no file can hold"""
    policy: nn.Module
    """what it acts by"""
    perception: Perception | None = None
    """what makes states of measurements; None where states are measured"""
    model: Model | None = None
    """of the system; None: it learns none"""
    logger: Any = None
    """of stable-baselines3, see `set_logger`"""
    transitions: Transitions | None = None
    """what a model is learned from; None: nothing yet, or no model"""

    def __init__(
        self,
        policy: str,
        env: gym.Env | str,
        *,
        preset: str = "default",
        config: Any = None,
        seed: int | None = 0,
        verbose: int = 0,
        task: TaskSpec | None = None,
        **unknown: Any,
    ) -> None:
        """An agent that has learned nothing yet.

        Arguments are those of `mcpilco.agent.MCPILCO`; a preset is one of `presets`.
        """
        known = ("preset", "config", "seed", "verbose", "task", *self.objects)
        refuse_keywords(type(self).__name__, unknown, known, self.config_type)
        if policy != self.policy_name:
            raise InputError(
                f'policy must be "{self.policy_name}", got {policy!r}; '
                f'write {type(self).__name__}("{self.policy_name}", env).'
            )
        if preset not in list(self.presets):
            raise InputError(f"preset must be one of {sorted(self.presets)}, got {preset!r}.")
        if not (config is None or isinstance(config, self.config_type)):
            name = self.config_type.__name__
            raise InputError(
                f"config must be a {name}, got {config!r:.80}; write config={name}(horizon=60)."
            )
        if seed is None:
            seed = int(np.random.SeedSequence().generate_state(1)[0])
        if not isinstance(seed, int | np.integer) or seed < 0:
            raise InputError(f"seed must be an integer of at least 0, or None, got {seed!r}.")
        chosen = self.presets[preset]
        keywords = chosen.keywords(env) if isinstance(env, str) and config is None else {}
        self.env = make_env(env, **keywords)
        env_id = "" if self.env.spec is None else self.env.spec.id
        self.config: Any = chosen.config_for(env_id) if config is None else config
        self.seed = int(seed)
        self.verbose = verbose
        self.task = self._own_task(task_of(self.env, task))
        self.low, self.high = input_bounds(self.env)
        if self.task.cost is not unknown_cost:  # that of an agent that was loaded to predict only
            check_cost(self.task, self.low, self.high)
        self.horizon = horizon_of(self.env, self.config.horizon)
        self.streams = Streams(self.seed)
        self.trials = 0
        """trials done, in all calls of `learn` and before a `load`"""
        self.results: list[TrialResult] = Results()
        """of these trials; a `load` does not bring them back"""
        self._set_up()

    @abstractmethod
    def _set_up(self) -> None:
        """Make what the algorithm has beside all this, before it has learned anything."""

    def _own_task(self, task: TaskSpec) -> TaskSpec:
        """The task as the agent sees it."""
        return task

    @staticmethod
    @abstractmethod
    def usual_trials(config: Any) -> int:
        """Trials of a training where nothing is said."""

    @property
    @abstractmethod
    def num_timesteps(self) -> int:
        """Steps of its env that the agent has learned from."""

    @abstractmethod
    def timesteps_of(self, trials: int) -> int:
        """The steps that `learn` needs for so many trials."""

    @abstractmethod
    def _trials_within(self, total_timesteps: int) -> int:
        """How many trials so many steps of the env allow, rounded up."""

    def _explore(self) -> list[Rollout]:
        """Episodes of random inputs, recorded before the first trial where they are needed."""
        return []

    @abstractmethod
    def _trial(self, trial: int, steps: int, events: Callback) -> TrialResult:
        """Improve the policy from all data so far, and try it for an episode."""

    def _run_episode(
        self,
        act: Act,
        trial: int,
        steps: int,
        episode: int = 0,
        stop: Callable[[np.ndarray], bool] | None = None,
    ) -> tuple[Rollout, str | None]:
        """A rollout of at most so many steps, and why it broke off if it did.

        It ends early where a measurement says `stop`.
        """
        env, width = state_view(self.env, self.task), len(self.task.state_names)
        seed, steps = self.streams.reset(trial, episode), min(steps, self.horizon)
        try:
            record = run_episode(env, act, steps, self.task.dt, seed=seed, width=width, stop=stop)
            return record, None
        except BrokenEpisodeError as error:
            return error.rollout, self._failed(trial, str(error))

    def _failed(self, trial: int, reason: str) -> str:
        """The reason on one line, which is also logged."""
        reason = " ".join(reason.split())
        logger.warning("Trial %d: %s", trial, reason)
        return reason

    def _costs(self, record: Rollout) -> Float[np.ndarray, " T"]:
        """Cost at the end of each step of a rollout on the system [-].

        An episode that ended early has its last cost to the end of the horizon.
        """
        return held(costs_of(self.task.cost, record), self.horizon)

    def _result(
        self, trial: int, record: Rollout, watch: Stopwatch, experience: int, **learned: Any
    ) -> TrialResult:
        """A trial's result: of its rollout, of so many steps of data, and of what was learned."""
        success, spent = record.outcome.get("is_success"), watch.read()
        unknown: dict[str, Any] = {"predicted_cost": math.nan, "predicted_cost_std": math.nan}
        unknown |= {"noise_std": (), "policy_steps": 0, "starts": 0, "prediction": None}
        return TrialResult(
            trial=trial,
            experience_s=round(experience * self.task.dt, 9),  # 6 * 0.1 is not quite 0.6
            real_cost=float(self._costs(record).sum()),
            success=None if success is None else bool(success),
            wall_s=spent.wall_s,
            cpu_s=spent.cpu_s,
            rollout=record,
            **(unknown | learned),
        )

    def learn(
        self, total_timesteps: int, callback: Any = None, progress_bar: bool = False, **unknown: Any
    ) -> Self:
        """Spend `total_timesteps` steps of the env, rounded up to whole trials; return the agent.

        Random inputs are recorded first; then each trial improves the policy and tries it. Calling
        again continues with further trials.

        Args:
            total_timesteps: steps of the env.
            callback: called at each event, see `mcpilco.logbook.callbacks`: one, or a list; also
                one of stable-baselines3, or a function of (locals, globals), which is called once a
                rollout is over, for each of its steps, and stops the learning by False.
            progress_bar: show progress on the screen.
            **unknown: refused, with what to use in place of a keyword of stable-baselines3.

        Raises:
            TypeError: a keyword is unknown.
            InputError: too few steps for a trial, or no number of them.
            EnvError: the env is absent, or an episode broke off before its first step was done.

        Reference: thesis chapter 5, Algorithm 1.
        """
        known = ("total_timesteps", "callback", "progress_bar")
        refuse_keywords("learn", unknown, known, self.config_type)
        if not isinstance(total_timesteps, Real) or not math.isfinite(total_timesteps):
            raise InputError(
                f"total_timesteps must be a number of steps of the env, got {total_timesteps!r}; "
                f"one trial takes {self.timesteps_of(1)}."
            )
        if isinstance(self.env, AbsentEnv):
            self.env.reset()  # raises
        check_cost(self.task, self.low, self.high)
        shown = [Progress()] if progress_bar or self.verbose else []
        logged = [] if self.logger is None else [Logged(self.logger)]
        events = as_callback(callback, *shown, *logged)
        try:
            trials, end = self._trials_within(total_timesteps), self.num_timesteps + total_timesteps
            events.on_training_start(self, trials)
            for record in self._explore():
                events.on_exploration(record)
            for _ in range(trials):
                if events.stops():
                    break
                trial, left = self.trials + 1, end - self.num_timesteps
                events.on_trial_start(trial)
                result = self._trial(trial, left, events)
                self.results.append(result)
                self.trials = trial
                events.on_trial_end(result)
            events.on_training_end()
        finally:
            as_callback(shown).close()
        return self

    def set_logger(self, logger: Any) -> None:
        """Record the numbers of each trial to come in a logger of stable-baselines3.

        `stable_baselines3.common.logger.configure(folder, ["csv"])` makes one.
        """
        self.logger = logger

    def predict(
        self,
        observation: Float[np.ndarray, "*b O"],
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Float[np.ndarray, "*b U"], Any]:
        """The action for one observation or a batch, and the state to hand back with the next.

        An agent with a model estimates the state to act on from the episode so far where states are
        measured in part, the actuator is late (`model.delay`) or the policy sees past inputs
        (`model.memory`): pass the state that the last call returned, as with recurrent policies.
        Else there is no memory, and the state is returned as it came.

        Before the first trial the action of such an agent is the middle of its range, or random,
        with a warning.

        Args:
            observation: in the env's units.
            state: returned by the call before; None begins an episode.
            episode_start: which of a batch begin an episode, whatever the state says.
            deterministic: False adds the noise of exploration, where a policy has any. Differs:
                stable-baselines3 has that by default.

        Raises:
            InputError: the observation has another width, or is not finite; or the state belongs to
                other observations.
        """
        measured = state_of(self.task, self._observation(observation))
        inputs, state = self._answer(measured, state, episode_start, deterministic)
        return np.clip(inputs, self.low, self.high).astype(self.env.action_space.dtype), state

    @abstractmethod
    def _answer(
        self, measured: Float[np.ndarray, "*b Y"], state: Any, begun: Any, deterministic: bool
    ) -> tuple[Float[np.ndarray, "*b U"], Any]:
        """The inputs, in the env's unit, from what is measured; and the state, as in `predict`."""

    def _observation(self, observation: Any) -> Float[np.ndarray, "*b O"]:
        shape = self.env.observation_space.shape
        try:
            found = np.asarray(observation, dtype=np.float64)
        except (TypeError, ValueError):
            found = np.array(np.nan)
        if found.shape[-1:] != shape or not np.isfinite(found).all():
            measured = tuple(self.task.state_names[i] for i in self.task.measured_states)
            names = "" if self.task.observed else f" {measured}"
            raise InputError(
                f"predict expects finite observations of {(shape or (0,))[0]} numbers{names}, one "
                f"or a batch, got shape {np.shape(observation)}: {observation!r:.200}; pass what "
                "`env.reset` and `env.step` return first."
            )
        return found

    def controller(self) -> Act:
        """A function from observation to action, for one episode or a batch that begins together.

        It remembers what `predict` returns as its state; each episode needs a new one.
        """
        return remembering(self.predict)

    def on_states(self) -> Act:
        """The same from states, or from what is measured of them, whatever the env observes."""
        return remembering(Controller(self.policy).answer)

    def __repr__(self) -> str:
        seconds, engine = self.num_timesteps * self.task.dt, getattr(self.config, "engine", None)
        return (
            f"<{type(self).__name__} in {name_of(self.env)}: {self.trials} trials learned, "
            f"{seconds:g} s of experience, seed {self.seed}"
            f"{'' if engine is None else f', engine {engine}'}>"
        )

    def save(self, path: str | Path) -> Path:
        """Write all that `load` needs to one `.npz` file of plain arrays; returns its path.

        Raises:
            InputError: the path is none.
            RunFolderError: the file cannot be written.
        """
        return self.saved_type.write(npz_path(path), self)

    @classmethod
    def load(
        cls,
        path: str | Path,
        env: gym.Env | str | None = None,
        *,
        task: TaskSpec | None = None,
        **objects: Any,
    ) -> Self:
        """The agent that `save` wrote: it predicts the same, and `learn` goes on where it ended.

        What it learns is what the saved agent would have learned, to the last digit, in an env
        whose episodes are functions of the seed that `reset` is given.

        Args:
            path: of the file.
            env: an env like the one it learned in, or its id; without one it can predict only.
            task: what to know of the env, where it does not show it; else what it knew when it was
                saved, but for a cost that was given as a function: it cannot learn on without, if
                it learns from costs.
            **objects: what the agent was made with and no file can hold, as `kernel` of MCPILCO.

        Raises:
            TypeError: a keyword is unknown.
            InputError: the path is none.
            RunFolderError: the file is missing, damaged, or not an agent of this class and env.
            EnvError: the env does not fit.
        """
        known = ("path", "env", "task", *cls.objects)
        unknown = [name for name in objects if name not in cls.objects]
        refuse_keywords(f"{cls.__name__}.load", unknown, known, cls.config_type)
        with reading(npz_path(path), cls.algo, cls.saved_type) as saved:
            env = make_env(saved.absent_env() if env is None else env)
            if task is None and getattr(env.unwrapped, "task", None) is None:
                task = saved.task_for(env)
            config, seed = saved.config(cls.config_type), saved.about["seed"]
            agent = cls(cls.policy_name, env, config=config, seed=seed, task=task, **objects)
            saved.restore(agent)
        return agent
