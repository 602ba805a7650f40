"""Does an env suit the agent? Sentences on what fits and what does not, from random inputs."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium.spaces import Box
from jaxtyping import Float

from mcpilco.agent.contract import check_cost, input_bounds, task_of, time_limit
from mcpilco.agent.episode import run_episode
from mcpilco.agent.guess import RESETS, guess_task, start_of
from mcpilco.agent.predictability import Gain, reward_share, state_gains
from mcpilco.data import Rollout
from mcpilco.policies import costs_of
from mcpilco.sensing import TURN, state_of
from mcpilco.task import TaskSpec
from mcpilco.typing import EnvError, McPilcoError

LONG = 200
"""a horizon of more steps is long for rollouts of particles"""
SURE = 2.0
"""memory that makes errors so many times smaller, at the lower end of the interval, is a fault"""
SHARE = 0.05
"""an error below this share of a change's spread is small [-]"""
LEARNABLE = 0.5
"""rewards of whose variance state and input explain less cannot be learned [-]"""
SCALES = 1e4
"""spreads of states that differ by more are hard on the models"""


@dataclass(frozen=True)
class Finding:
    """One thing looked at."""

    kind: Literal["fits", "note", "fault"]
    """fault: the agent cannot use the env like this, or will learn something wrong"""
    sentence: str
    """what was found, and what to do about it"""


_fits, _note, _fault = (partial(Finding, kind) for kind in ("fits", "note", "fault"))


def inspect_env(
    env: gym.Env,
    task: TaskSpec | None = None,
    *,
    horizon: int | None = None,
    steps: int = 400,
    seed: int = 0,
) -> Iterator[Finding]:
    """Findings, one by one: which demands an env meets; stops where none further can be checked.

    Without `task` it is what the env shows, or a guess; without `horizon` [steps] the time limit.
    Some more random `steps` are taken where an episode must end.
    """
    try:
        known, finding = _task(env, task)
    except EnvError as error:
        yield _fault(str(error))
        known = None
        if not all(isinstance(s, Box) for s in (env.observation_space, env.action_space)):
            return
    else:
        yield finding
    try:
        low, high = input_bounds(env)
    except EnvError as error:
        yield _fault(str(error))
        return
    yield _fits(f"Actions are bounded: {low.tolist()} to {high.tolist()}.")
    yield from _time(env, horizon)
    rng = np.random.default_rng(seed)
    try:
        yield from _seeding(env, rng)
        raw, terminated = _record(env, rng, horizon, steps, seed)
    except McPilcoError as error:
        yield _fault(str(error))
        return
    yield from _ends(raw, terminated, horizon or time_limit(env) or LONG)
    yield from _circles(raw, known)
    if known is None:
        return
    partly = known.measured is not None
    seen = [] if partly else [_as_states(known, episode) for episode in raw]
    if known.cost is not None:
        yield _cost(known, low, high, seen)
    if partly:
        yield _hidden(known)
        return
    yield from _start(env, known)
    yield from _scales(known, seen)
    yield from _velocities(known, seen)
    yield _memory(known, state_gains(known, seen, rng))
    if known.cost is None:
        yield _rewards(reward_share(known, seen, rng))


def _task(env: gym.Env, task: TaskSpec | None) -> tuple[TaskSpec, Finding]:
    shown = task is not None or getattr(env.unwrapped, "task", None) is not None
    known = task_of(env, task, quiet=True)
    if shown:
        names = ", ".join(known.state_names)
        return known, _fits(f"The task is known: states {names}; dt {known.dt:g} s.")
    return known, _note(str(guess_task(env)))


def _cost(
    task: TaskSpec,
    low: Float[np.ndarray, " U"],
    high: Float[np.ndarray, " U"],
    seen: Sequence[Rollout],
) -> Finding:
    """Can a search use the cost, and is it finite where random inputs lead?"""
    try:
        check_cost(task, low, high)
    except McPilcoError as error:
        return _fault(str(error))
    for episode in seen:
        costs = costs_of(task.cost, episode)
        if len(wrong := np.flatnonzero(~np.isfinite(costs))):
            state = episode.observations[1 + wrong[0]].round(3).tolist()
            return _fault(f"The cost is not finite at {state}: mend its formula there.")
    return _fits("The cost is one finite number a particle, and has a gradient.")


def _time(env: gym.Env, horizon: int | None) -> Iterator[Finding]:
    steps = time_limit(env) if horizon is None else horizon
    if steps is None:
        yield _fault("There is no time limit: say how many steps an episode has, --horizon.")
    elif steps > LONG:
        yield _note(
            f"Episodes of {steps} steps are long to roll particles out: a --horizon in which the "
            "goal can be reached, such as 50 to 100 steps, learns faster and often better."
        )
    else:
        yield _fits(f"Episodes have {steps} steps.")


def _seeding(env: gym.Env, rng: np.random.Generator) -> Iterator[Finding]:
    low, high = input_bounds(env)
    inputs = rng.uniform(low, high, (10, len(low)))
    path, again = (_replay(env, inputs) for _ in range(2))
    if not np.array_equal(path[0], again[0]):
        yield _note("Equal seeds of reset give different starts, so no run can be repeated.")
    elif not np.array_equal(path, again):
        yield _note(
            "Equal seeds and inputs give different episodes: the steps draw random numbers that "
            "reset does not seed, so no run can be repeated."
        )
    else:
        yield _fits("Equal seeds and inputs give equal episodes.")


def _replay(env: gym.Env, inputs: Float[np.ndarray, "T U"]) -> Float[np.ndarray, "T_plus_1 Y"]:
    waiting = iter(inputs)
    return run_episode(env, lambda _: next(waiting), len(inputs), 1.0, seed=0).observations


def _record(
    env: gym.Env, rng: np.random.Generator, horizon: int | None, steps: int, seed: int
) -> tuple[list[Rollout], list[bool]]:
    """Episodes of random inputs, as observed, and which of them the env terminated."""
    low, high = input_bounds(env)
    watched, episodes, terminated = _Watched(env), list[Rollout](), list[bool]()
    seeds = itertools.chain([seed], itertools.repeat(None))
    while (left := steps - sum(map(len, episodes))) > 0:
        longest = min(left, horizon or left)
        record = run_episode(watched, lambda _: rng.uniform(low, high), longest, 1.0, next(seeds))
        episodes.append(record)
        terminated.append(watched.terminated)
    return episodes, terminated


class _Watched(gym.Wrapper[Any, Any, Any, Any]):
    """The env, and whether its last step terminated the episode."""

    terminated = False

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        observation, reward, self.terminated, truncated, info = self.env.step(action)
        return observation, reward, self.terminated, truncated, info


def _as_states(task: TaskSpec, episode: Rollout) -> Rollout:
    """The same episode with states in place of observations."""
    states = state_of(task, episode.observations).copy()
    angles = list(task.angles)
    states[:, angles] = np.unwrap(states[:, angles], axis=0)
    return replace(episode, observations=states, states=None, dt=task.dt)


def _ends(
    episodes: Sequence[Rollout], terminated: Sequence[bool], longest: int
) -> Iterator[Finding]:
    """Do most episodes terminate in the first half of their time?"""
    lengths = [len(e) if early else longest for e, early in zip(episodes, terminated, strict=True)]
    if np.median(lengths) < longest / 2:
        yield _note(
            f"Under random inputs an episode lasts {np.median(lengths):g} steps in the median: "
            "they are learned from, but the particles know nothing of the end, so the cost must "
            "say that it is bad. Take more random steps at first, --exploration 300 for example."
        )


def _circles(episodes: Sequence[Rollout], task: TaskSpec | None) -> Iterator[Finding]:
    """Cosines and sines that no angle is made of, and angles that jump by a full turn."""
    seen = np.concatenate([episode.observations for episode in episodes])
    known = {
        frozenset(where) for where in (task.observed if task else ()) if isinstance(where, tuple)
    }
    for pair in itertools.combinations(range(seen.shape[1]), 2):
        round_ = np.abs((seen[:, pair] ** 2).sum(1) - 1).max() < 1e-5 and seen[:, pair].std() > 1e-3
        if round_ and frozenset(pair) not in known:
            yield _fault(
                f"Observations {pair[0]} and {pair[1]} look like cosine and sine of one angle, for "
                "their squares add up to 1. Let the task say so: observed=(..., (cosine, sine), "
                "...), and name the state in angles."
            )
        elif round_:
            yield _fits(f"Observations {pair[0]} and {pair[1]} are read as one angle.")
    yield from _jumps(episodes, task)


def _jumps(episodes: Sequence[Rollout], task: TaskSpec | None) -> Iterator[Finding]:
    """Are steps beyond half a turn other steps plus a full turn?"""
    steps = np.concatenate([np.diff(episode.observations, axis=0) for episode in episodes])
    counted = {task.observed[i] for i in task.angles} if task and task.observed else set()
    for column in range(steps.shape[1]):
        size = np.abs(steps[:, column])
        jumps, rest = size[size > np.pi], size[size <= np.pi]
        if not len(jumps) or not len(rest) or column in counted:
            continue
        if (np.abs(jumps - TURN) <= rest.max() + 1e-6).all() and rest.max() < np.pi / 2:
            yield _fault(
                f"Observation {column} jumps by a full turn {len(jumps)} times: an angle that is "
                "kept within a turn. Name it in angles, and name all states in observed, so that "
                "its turns are counted."
            )


def _hidden(task: TaskSpec) -> Finding:
    names = [name for i, name in enumerate(task.state_names) if i not in task.measured_states]
    return _note(
        f"Not measured, and estimated by the agent: {', '.join(names) or 'nothing'}. The start, "
        "the scales and whether the state is Markov are checked only where all are measured."
    )


def _start(env: gym.Env, task: TaskSpec) -> Iterator[Finding]:
    """Does the task's Gaussian fit the states that reset gives?"""
    states = state_of(task, np.array([env.reset(seed=seed)[0] for seed in range(RESETS)], float))
    mean, std = start_of(states, task.angles)
    said_mean, said_std = np.array(task.start_mean), np.array(task.start_std)
    off = np.abs(mean - said_mean)
    around = list(task.angles)
    off[around] = np.abs((off[around] + np.pi) % TURN - np.pi)
    small = 1e-3 * (1.0 + np.abs(said_mean))
    full_turn = np.isin(np.arange(len(std)), around) & (np.maximum(std, said_std) > 1.3)
    wrong_mean = (off > 4 * np.maximum(std, said_std) / np.sqrt(RESETS) + small) & ~full_turn
    wrong_std = (std > 2 * said_std + small) | (2 * std < said_std - small)
    for i in np.flatnonzero(wrong_mean | (wrong_std & ~(full_turn & (said_std > 1.3)))):
        yield _fault(
            f"Episodes start with {task.state_names[i]} at {mean[i]:.3g} +- {std[i]:.2g} "
            f"{task.state_units[i]}, the task says {said_mean[i]:.3g} +- {said_std[i]:.2g}: "
            "the particles would start elsewhere. Mend start_mean and start_std."
        )
    if full_turn.any():
        wide = ", ".join(task.state_names[i] for i in np.flatnonzero(full_turn))
        yield _note(
            f"Episodes start anywhere around the circle of {wide}: the policy must work from all "
            "of it, which takes more data than one start does."
        )
    elif not wrong_mean.any() and not wrong_std.any():
        yield _fits("Episodes start where the task says.")


def _scales(task: TaskSpec, episodes: Sequence[Rollout]) -> Iterator[Finding]:
    seen = np.concatenate([episode.observations for episode in episodes])
    std = seen.std(0)
    still = [name for name, value in zip(task.state_names, std, strict=True) if value == 0]
    if still:
        yield _note(f"{', '.join(still)} never changed: leave it out of the state, with observed.")
    moving = std[std > 0]
    if len(moving) and moving.max() / moving.min() > SCALES:
        yield _note(
            f"The spreads of the states differ by a factor of {moving.max() / moving.min():.0e}; "
            "give them in units in which they are more alike."
        )


def _velocities(task: TaskSpec, episodes: Sequence[Rollout]) -> Iterator[Finding]:
    """Are the velocities the derivatives of their positions, in the task's dt?"""
    change = np.concatenate([np.diff(e.observations, axis=0) for e in episodes])
    middle = np.concatenate([(e.observations[1:] + e.observations[:-1]) / 2 for e in episodes])
    for position, velocity in task.velocities:
        moved, rate = change[:, position], middle[:, velocity]
        if not rate.any():
            continue
        fitted = float(moved @ rate / (rate @ rate))
        rest = float(np.std(moved - fitted * rate) / (np.std(moved) + 1e-12))
        names = f"{task.state_names[velocity]} is the velocity of {task.state_names[position]}"
        if rest > 0.5:
            yield _fault(f"The task says that {names}, but the one does not move with the other.")
        elif abs(fitted - task.dt) > 0.2 * task.dt:
            yield _fault(
                f"The task says that {names} and dt is {task.dt:g} s, but it moves as if dt were "
                f"{fitted:.3g} s: mend dt, or the units of one of them."
            )
        else:
            yield _fits(f"{names[0].upper()}{names[1:]}, within {rest:.1%} of a step.")


def _memory(task: TaskSpec, gains: Sequence[Gain]) -> Finding:
    """Is the state Markov?"""
    if not gains:
        return _note("Episodes are too short to test whether the state is Markov.")
    worst = max(
        range(len(gains)), key=lambda i: gains[i].low if gains[i].unexplained > SHARE else 0
    )
    gain, name = gains[worst], task.state_names[worst]
    if gain.unexplained > SHARE and gain.low > SURE:
        return _fault(
            f"The state is not Markov: the one-step prediction error of {name} is "
            f"{gain.factor:.1f} times smaller (95 % interval {gain.low:.1f} to {gain.high:.1f}) if "
            "the previous observation is known too. A velocity or another state is not observed, "
            "or the action acts with delay: observe all states, or list the measured ones in "
            "`measured`, so that velocities are estimated; for a late actuator train with --delay "
            "or --memory."
        )
    return _fits(
        "The state looks Markov: the previous observation makes no one-step prediction error more "
        f"than {SURE:g} times smaller (most that of {name}: {gain.factor:.1f} times, 95 % interval "
        f"{gain.low:.1f} to {gain.high:.1f})."
    )


def _rewards(share: float) -> Finding:
    if np.isnan(share):
        return _fault("All rewards are equal, so no cost can be learned from them: give a cost.")
    if share < LEARNABLE:
        return _fault(
            f"The task has no cost, and state and input explain only {max(share, 0):.0%} of the "
            "rewards' variance: give a cost."
        )
    return _fits(
        f"The cost is learned: state and input explain {share:.1%} of the rewards' variance."
    )
