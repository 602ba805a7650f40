"""How good a policy is on episodes that nobody has learned from."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from jaxtyping import Float

from mcpilco.agent import make_env, reported, run_episode

Act = Callable[[Float[np.ndarray, "*b Y"]], Float[np.ndarray, "*b U"]]
Outcomes = dict[str, Float[np.ndarray, " M"]]
"""`return` [-] of each of M episodes, and what the env reports of them (`agent.reported`)"""

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

    def outcomes(self, begin: Callable[[], Act], seed: int, trial: int) -> Outcomes:
        """Returns and outcomes of a policy over the episodes.

        Raises:
            EnvError: the env returned a value that is not finite.
        """
        states = np.random.SeedSequence((seed, trial)).generate_state(self._episodes)
        seeds = [_BEYOND_TRAINING + int(state) for state in states]
        if self._vector is not None:
            return batch_outcomes(self._vector, begin(), self._horizon, seeds[0])
        return outcomes_one_by_one(self._env, begin, self._horizon, seeds)


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
    env: gym.Env, begin: Callable[[], Act], horizon: int, seeds: Sequence[int]
) -> Outcomes:
    """The outcomes of one episode for each seed; of what the env tells, what it tells of all."""
    # dt dates the records, of which nothing is kept
    rollouts = [run_episode(env, begin(), horizon, dt=1.0, seed=seed) for seed in seeds]
    outcomes = {"return": np.array([float(rollout.rewards.sum()) for rollout in rollouts])}
    told = set.intersection(*(set(rollout.outcome) for rollout in rollouts))
    return outcomes | {
        name: np.array([rollout.outcome[name] for rollout in rollouts]) for name in sorted(told)
    }


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
