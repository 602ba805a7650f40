"""One protocol that every agent is judged by, whatever it learns with and how long.

    judge = Judge("mcpilco/CartPoleSwingUp-v0", episodes=100, seed=0)
    for found in learning_curve(agent, judge, [60, 90, 120]):
        print(found.experience_s, found.mean("is_success"), found.cpu_s)

A judge has an env of its own, with the starts and noises of its seed: equal judges put every agent
before the same episodes. Success and all measures are those that the env reports.
"""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from jaxtyping import Float

from mcpilco.agent import horizon_of, make_env, remembering, task_of
from mcpilco.data import Spent, Stopwatch
from mcpilco.sweep import FreshEpisodes
from mcpilco.typing import InputError


class Actor(Protocol):
    """A policy to judge: anything that predicts as agents of stable-baselines3 do."""

    def predict(self, observation: Any, state: Any = None) -> tuple[Any, Any]:
        """The action for an observation, and the state to hand back with the next."""
        ...


class Learner(Actor, Protocol):
    """A learner that is judged while it learns."""

    @property
    def num_timesteps(self) -> int:
        """Steps of its env so far."""
        ...

    def learn(self, total_timesteps: int) -> Any:
        """Spend so many steps more."""
        ...


@dataclass(frozen=True)
class Judgement:
    """The outcomes of one policy in M fresh episodes, and what it took to learn it."""

    experience_s: float
    """duration of the data that the policy was learned from [s]"""
    cpu_s: float
    """processor time that it was learned in, all before it included [s]"""
    outcomes: Mapping[str, Float[np.ndarray, " M"]]
    """of each episode: `return` [-], and what the env reports: `is_success`, its measures"""
    wall_s: float = 0.0
    """time on the clock that it was learned in, all before it included [s]"""

    def mean(self, name: str) -> float | None:
        """Mean over the episodes; None where the env does not report it."""
        values = self.outcomes.get(name)
        return None if values is None else float(values.mean())

    def to_json(self) -> dict[str, Any]:
        """As JSON has it: the means, and the number of episodes."""
        means = {name: self.mean(name) for name in ("is_success", *self.outcomes)}
        names = ("experience_s", "cpu_s", "wall_s")
        costs = {name: getattr(self, name) for name in names}
        return {**costs, "episodes": len(self.outcomes["return"]), **means}


class Judge:
    """The same episodes for everyone."""

    def __init__(
        self,
        env: str,
        env_kwargs: Mapping[str, Any] | None = None,
        *,
        episodes: int = 100,
        horizon: int | None = None,
        seed: int = 0,
    ) -> None:
        """A judge with an env of its own.

        Args:
            env: Gymnasium id.
            env_kwargs: keywords it is made with.
            episodes: M, how many a policy is judged by.
            horizon: most steps of an episode; None: the env's time limit.
            seed: of starts and noises; no training has them, whatever its seed.

        Raises:
            EnvError: the env cannot be made, or shows no task.
            InputError: less than one episode, or no horizon is known.
        """
        if episodes < 1:
            raise InputError(f"episodes must be at least 1, got {episodes}.")
        kwargs = dict(env_kwargs or {})
        if horizon is not None:
            kwargs["max_episode_steps"] = horizon
        with contextlib.closing(make_env(env, **kwargs)) as made:
            steps = horizon_of(made, horizon)
            self.dt = task_of(made, None, quiet=True).dt
        self._fresh = FreshEpisodes(env, kwargs, episodes, steps)
        self._seed = seed

    def __enter__(self) -> Judge:
        return self

    def __exit__(self, *_: object) -> None:
        self._fresh.__exit__()

    def __call__(
        self, agent: Actor, experience_s: float = 0.0, spent: Spent | None = None
    ) -> Judgement:
        """The outcomes of the agent's policy in fresh episodes.

        The agent acts, and is not changed. Its policy was learned from `experience_s` of data [s]
        in the time `spent`.

        Raises:
            EnvError: the env returned a value that is not finite.
        """
        spent = spent or Spent()
        outcomes = self._fresh.outcomes(lambda: remembering(agent.predict), self._seed, trial=0)
        return Judgement(experience_s, spent.cpu_s, outcomes, spent.wall_s)


def learning_curve(agent: Learner, judge: Judge, amounts: Sequence[int]) -> Iterator[Judgement]:
    """A judgement each time the agent has spent so many steps of its env, as they come.

    One of stable-baselines3 learns on in an object that passes `reset_num_timesteps=False` on.

    Raises:
        InputError: the amounts do not rise.
    """
    if any(after <= before for before, after in itertools.pairwise(amounts)):
        raise InputError(f"amounts must rise, got {list(amounts)}.")
    spent = Spent()
    for amount in amounts:
        watch = Stopwatch()
        if (missing := amount - agent.num_timesteps) > 0:
            agent.learn(missing)
        spent += watch.read()
        yield judge(agent, _experience(agent, judge.dt), spent)


def _experience(agent: Any, dt: float) -> float:
    """Duration of the data that an agent's policy was learned from [s].

    An agent that learns by trials has spent one rollout more: that which tried the policy.
    """
    results = getattr(agent, "results", None)
    return results[-1].experience_s if results else agent.num_timesteps * dt
