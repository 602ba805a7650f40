"""One seed of a sweep: a whole training, and each of its policies judged on fresh episodes.

`FreshEpisodes` says how good a policy is on episodes that nobody has learned from.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import logging
import math
import os
import platform
from collections.abc import Callable, Iterator, Mapping, MutableSequence, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from jaxtyping import Float

from mcpilco.agent import (
    BrokenEpisodeError,
    find,
    import_named,
    load_task,
    make_env,
    reported,
    run_episode,
    task_of,
)
from mcpilco.config import LONGEST, Checked, Config
from mcpilco.data import Rollout, TrialResult
from mcpilco.logbook import Callback, versions
from mcpilco.typing import InputError

logger = logging.getLogger(__name__)

Act = Callable[[Float[np.ndarray, "*b Y"]], Float[np.ndarray, "*b U"]]
Outcomes = dict[str, Float[np.ndarray, " M"]]
"""`return` [-] of each of M episodes, and what the env reports of them (`agent.reported`)"""

Kept = MutableSequence[dict[str, float]]
"""the same, an entry an episode"""

_BEYOND_TRAINING = 2**32
"""training seeds are below, seeds of fresh episodes above"""


class FreshEpisodes:
    """Episodes of an env of its own, whose seeds no training has.

    They run in one batch where the env is registered with a vector form of the same spaces, whose
    batch members a Gymnasium user expects to be the single env; else one after the other. Both
    draw from the same distribution.
    """

    def __init__(
        self, env: str, env_kwargs: Mapping[str, Any], episodes: int, horizon: int
    ) -> None:
        """Opens the env.

        Raises:
            EnvError: the env cannot be made.
        """
        self._episodes = episodes
        self._horizon = horizon
        self._env = make_env(env, **env_kwargs)
        self._vector = _vector_form(self._env, env, env_kwargs, episodes)

    def __enter__(self) -> FreshEpisodes:
        return self

    def __exit__(self, *_: object) -> None:
        self._env.close()
        if self._vector is not None:
            self._vector.close()

    def outcomes(
        self, begin: Callable[[], Act], seed: int, trial: int, kept: Kept | None = None
    ) -> Outcomes:
        """Returns and outcomes of a policy over the episodes.

        Those that run one after the other are `kept` as they end, and none of these is repeated.

        Raises:
            EnvError: the env returned a value that is not finite.
        """
        states = np.random.SeedSequence((seed, trial)).generate_state(self._episodes)
        seeds = [_BEYOND_TRAINING + int(state) for state in states]
        if self._vector is not None:
            return batch_outcomes(self._vector, begin(), self._horizon, seeds[0])
        return outcomes_one_by_one(self._env, begin, self._horizon, seeds, kept)


def batch_outcomes(env: VectorEnv, act: Act, horizon: int, seed: int) -> Outcomes:
    """The outcomes of one episode of each env in the batch; what follows its end is ignored."""
    space = env.action_space
    assert isinstance(space, gym.spaces.Box)  # so the agent has made sure
    observations, _ = env.reset(seed=seed)
    running = np.ones(env.num_envs, dtype=bool)
    outcomes = {"return": np.zeros(env.num_envs)}
    for _ in range(horizon):
        actions = np.clip(act(observations), space.low, space.high).astype(space.dtype)
        observations, rewards, terminated, truncated, infos = env.step(actions)
        outcomes["return"][running] += rewards[running]
        for name, values in reported(infos, (env.num_envs,)).items():
            last = outcomes.setdefault(name, np.full(env.num_envs, np.nan))
            last[running] = values[running]
        running &= ~(terminated | truncated)
        if not running.any():
            break
    return outcomes


def outcomes_one_by_one(
    env: gym.Env,
    begin: Callable[[], Act],
    horizon: int,
    seeds: Sequence[int],
    kept: Kept | None = None,
) -> Outcomes:
    """The outcomes of one episode for each seed; of what the env tells, what it tells of all.

    Each is appended to `kept` as it ends; those that are there already are of the first seeds.
    """
    kept = [] if kept is None else kept
    for seed in seeds[len(kept) :]:
        # dt dates the records, of which nothing is kept
        rollout = as_far_as_it_goes(env, begin(), horizon, dt=1.0, seed=seed)
        kept.append({"return": float(rollout.rewards.sum()), **rollout.outcome})
    return gathered(kept)


def gathered(each: Sequence[Mapping[str, float]]) -> Outcomes:
    """The outcomes of some episodes by measure, of which there is one at least."""
    told = set.intersection(*map(set, each)) - {"return"}
    return {name: np.array([one[name] for one in each]) for name in ("return", *sorted(told))}


def as_far_as_it_goes(env: gym.Env, act: Act, horizon: int, dt: float, seed: int) -> Rollout:
    """An episode, or the steps before it broke off: then it is no success, and a warning says why.

    Raises:
        EnvError: there is no such step.
    """
    try:
        return run_episode(env, act, horizon, dt, seed=seed)
    except BrokenEpisodeError as error:
        logger.warning("An episode broke off and counts as no success: %s", error)
        return error.rollout


def _vector_form(
    env: gym.Env, env_id: str, env_kwargs: Mapping[str, Any], count: int
) -> VectorEnv | None:
    """The env's own vector form, where it has one of the same spaces that leaves no wrapper out."""
    spec = env.spec
    if spec is None or spec.vector_entry_point is None or spec.additional_wrappers:
        return None
    # TypeError: the vector form does not know a keyword
    with contextlib.suppress(TypeError, gym.error.Error):
        vector = gym.make_vec(
            env_id, count, vectorization_mode="vector_entry_point", **dict(env_kwargs)
        )
        if (
            vector.metadata.get("autoreset_mode") is not AutoresetMode.SAME_STEP
            and vector.single_observation_space == env.observation_space
            and vector.single_action_space == env.action_space
        ):
            return vector
        vector.close()
    return None


FORMAT = 1
"""version of a result"""


@dataclass(frozen=True)
class Settings(Checked):
    """Env, algorithm and numbers that all seeds of a sweep have in common."""

    env: str
    """Gymnasium id of the env; `module:Id` imports the module first"""
    env_kwargs: Mapping[str, Any] = field(default_factory=dict)
    """keywords that the env is made with"""
    preset: str = "default"
    """what `config` is called"""
    config: Any = field(default_factory=Config)
    """the agent's numbers, of its algorithm's class"""
    trials: int = 4
    """policies to learn from each seed"""
    fresh: int = 100
    """fresh episodes that each policy is judged by; 0 judges none"""
    task: str | None = None
    """file of the task, the user's own, see `mcpilco.agent.task_file`; None: what the env shows,
    or a guess"""
    fresh_horizon: int | None = None
    """most steps of a fresh episode; None: as many as of a training's"""
    algo: str = "mcpilco"
    """the algorithm, see `mcpilco.agent.algorithms`; `package:name` imports the package first"""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.trials < 1:
            raise InputError(f"trials must be at least 1, got {self.trials}.")
        if self.fresh < 0:
            raise InputError(f"fresh must not be negative, got {self.fresh}.")
        if self.fresh_horizon is not None and not 1 <= self.fresh_horizon <= LONGEST:
            raise InputError(
                f"fresh_horizon must be from 1 to {LONGEST} steps, got {self.fresh_horizon}."
            )

    def to_json(self) -> dict[str, Any]:
        """As JSON reads it back."""
        return json.loads(json.dumps(dataclasses.asdict(self)))


def seed_job(settings: Settings, seed: int) -> partial[dict[str, Any]]:
    """One seed as a job that an engine calls for the result of `run_seed`."""
    return partial(run_seed, settings, seed)


def run_seed(settings: Settings, seed: int) -> dict[str, Any]:
    """The result of one seed: what `mcpilco train --seed` would learn, as JSON values.

    Judging the policies touches no random number of the training, and no time of its trials.

    Raises:
        McPilcoError: the env does not fit, or misbehaves.
    """
    import_named(settings.env, settings.algo)  # as the user typed them, maybe elsewhere
    kind = find(settings.algo)
    with contextlib.ExitStack() as stack:
        stack.enter_context(one_thread())  # other processes have the other cores
        env = stack.enter_context(contextlib.closing(make_env(settings.env, **settings.env_kwargs)))
        given = None if settings.task is None else load_task(settings.task)
        task = task_of(env, given, quiet=True)
        agent = kind(kind.policy_name, env, config=settings.config, seed=seed, task=task)
        judge = None
        if settings.fresh:
            judge = stack.enter_context(_judge(settings, agent.horizon))
        rows = _Rows(agent, judge)
        agent.learn(agent.timesteps_of(settings.trials), callback=rows)
    return result_of(seed, rows.trials)


def result_of(seed: int, trials: list[dict[str, Any]]) -> dict[str, Any]:
    """The rows of a seed's trials as a result: with where they were computed, and by what."""
    about = {"format": FORMAT, "seed": seed, "trials": trials}
    return {**about, "machine": machine(), "versions": versions()}


def _judge(settings: Settings, horizon: int) -> FreshEpisodes:
    kwargs = dict(settings.env_kwargs)
    if settings.fresh_horizon is not None:
        horizon = kwargs["max_episode_steps"] = settings.fresh_horizon
    return FreshEpisodes(settings.env, kwargs, settings.fresh, horizon)


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Keeps torch, for good, and BLAS to one thread; sums of several differ in last digits."""
    import torch
    from threadpoolctl import threadpool_limits

    torch.set_num_threads(1)
    with threadpool_limits(1):
        yield


class _Rows(Callback):
    def __init__(self, agent: Any, judge: FreshEpisodes | None) -> None:
        self.trials: list[dict[str, Any]] = []
        self._agent = agent
        self._judge = judge

    def on_trial_end(self, result: TrialResult) -> None:
        row = _row(result)
        if self._judge is not None:
            outcomes = self._judge.outcomes(self._agent.controller, self._agent.seed, result.trial)
            means = {name: _number(values.mean()) for name, values in outcomes.items()}
            row["p"], row["fresh_return"] = means.get("is_success"), means["return"]
        self.trials.append(row)


def _row(result: TrialResult) -> dict[str, Any]:
    return {
        "trial": result.trial,
        "experience_s": _number(result.experience_s),
        "success": result.success,
        "p": None,
        **{name: _number(value) for name, value in result.outcome.items()},
        "predicted_cost": _number(result.predicted_cost),
        "real_cost": _number(result.real_cost),
        "noise_std": [_number(std) for std in result.noise_std],
        "return": _number(result.rollout.rewards.sum()),
        "fresh_return": None,
        "starts": result.starts,
        "policy_steps": result.policy_steps,
        "cpu_s": round(result.cpu_s, 3),
        "wall_s": round(result.wall_s, 3),
        **({"failure": result.failure} if result.failure else {}),
    }


def _number(value: Any) -> float | None:
    """As JSON has it; None where the env does not tell, or it is not finite."""
    return None if value is None or not math.isfinite(value) else float(value)


def machine() -> dict[str, Any]:
    """The processor that this runs on."""
    return {"cpu": _cpu(), "cores": os.cpu_count()}


def _cpu() -> str:
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
