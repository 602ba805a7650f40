"""Recordings of an env: rollouts under exciting inputs, under random ones, or under a policy."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from mcpilco.agent import Act, BrokenEpisodeError, input_bounds, run_episode, task_of
from mcpilco.data import Rollout
from mcpilco.recordings import Recording, excitation, from_rollout
from mcpilco.sensing import state_view
from mcpilco.task import TaskSpec
from mcpilco.typing import EnvError, InputError

if TYPE_CHECKING:
    import gymnasium as gym

    from mcpilco.agent import TrialAgent

FEWEST, MOST = 10, 10_000_000
"""steps of a rollout; more than the latter take a GB and more"""
TRIES = 3
"""to record a rollout"""

logger = logging.getLogger(__name__)


def record_rollouts(
    env: gym.Env,
    policy: Literal["excitation", "random"] | TrialAgent,
    seconds: float,
    names: Sequence[str],
    seed: int,
) -> Iterator[Recording]:
    """Recordings of equal length, one rollout after the other; each begins with a reset.

    The env has no time limit below their length; they take `seconds` [s] together. Equal seeds give
    equal recordings. A rollout that breaks off is recorded again, a warning says why.

    Raises:
        McPilcoError: the env, the policy and the time do not fit; before the first rollout.
        EnvError: a rollout broke off `TRIES` times, or did not begin.
    """
    agent = None if isinstance(policy, str) else policy
    shown = getattr(env.unwrapped, "task", None)
    task = task_of(env, agent.task if agent is not None and shown is None else None)
    steps = round(seconds / len(names) / task.dt)
    if steps < FEWEST:
        raise InputError(
            f"--seconds must leave each rollout at least {FEWEST} steps of {task.dt:g} s, got "
            f"{seconds:g} s for {len(names)} of them; record for longer."
        )
    if steps > MOST:
        raise InputError(
            f"--seconds must leave each rollout at most {MOST} steps of {task.dt:g} s, got "
            f"{seconds:g} s for {len(names)} of them; record for a shorter time."
        )
    act, view = _actor(policy, task, env, steps), state_view(env, task)

    def rollout(own: np.random.SeedSequence) -> Rollout:
        rng = np.random.default_rng(own)
        reset_seed = int(rng.integers(2**31))
        return run_episode(view, act(rng), steps, task.dt, seed=reset_seed)

    def rollouts() -> Iterator[Recording]:
        seeds = np.random.SeedSequence(seed).spawn(len(names))
        for name, own in zip(names, seeds, strict=True):
            yield from_rollout(name, _whole(name, partial(rollout, own)), task)

    return rollouts()


def _whole(name: str, rollout: Callable[[], Rollout]) -> Rollout:
    """A rollout that did not break off, which a machine's may for no fault of its own."""
    for _ in range(TRIES - 1):
        try:
            return rollout()
        except BrokenEpisodeError as error:
            logger.warning("%s is recorded again: %s", name, error)
    return rollout()


def _actor(
    policy: Literal["excitation", "random"] | TrialAgent, task: TaskSpec, env: gym.Env, steps: int
) -> Callable[[np.random.Generator], Act]:
    """From random numbers to the policy of one rollout."""
    low, high = input_bounds(env)

    def excite(rng: np.random.Generator) -> Act:
        script = iter(excitation(low, high, steps, task.dt, rng))
        return lambda observation: next(script)

    def draw(rng: np.random.Generator) -> Act:
        return lambda observation: rng.uniform(low, high)

    if isinstance(policy, str):
        return excite if policy == "excitation" else draw
    agent: Any = policy
    if (agent.task.state_names, agent.task.input_names) != (task.state_names, task.input_names):
        raise EnvError(
            f"The policy expected the states {', '.join(agent.task.state_names)} and the inputs "
            f"{', '.join(agent.task.input_names)}, got an env with {', '.join(task.state_names)} "
            f"and {', '.join(task.input_names)}; leave --env out."
        )
    return lambda rng: agent.on_states()
