"""One episode: a policy acts on estimates, steps are recorded, what the env returns is checked."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from mcpilco.data import Rollout, is_measure
from mcpilco.typing import EnvError, Estimator, InputError

Act = Callable[[Float[np.ndarray, "*b Y"]], Float[np.ndarray, "*b U"]]
"""acts for one episode, or for a batch that begins together"""


@dataclass(frozen=True)
class Controller:
    """A policy with its estimator, as it acts on the system."""

    policy: Any
    """from states to inputs"""
    estimator: Estimator | None = None
    """makes the states of measurements; None: states are measured"""

    def answer(
        self,
        observation: Float[np.ndarray, "*b Y"],
        state: Any = None,
        restart: Bool[np.ndarray, "*b"] | None = None,
    ) -> tuple[Float[np.ndarray, "*b U"], Any]:
        """The input, in the env's unit, and the state to be handed back with the next observation.

        The state was returned by the call before; without it an episode begins, as for those of a
        batch that `restart`, whatever the state says.

        Raises:
            InputError: the state belongs to other observations.
        """
        measured = torch.as_tensor(observation, dtype=torch.float64)
        if self.estimator is None:
            with torch.no_grad():
                return self.policy(measured).numpy(), state
        first, begun = self.estimator.begin(measured), None
        if restart is not None:
            begun = torch.tensor(np.broadcast_to(restart, measured.shape[:-1]), dtype=torch.bool)
        memory = first if state is None else _memory(state, first)
        with torch.no_grad():
            estimate, memory = self.estimator.observe(measured, memory, begun)
            inputs = self.policy(estimate)
        return inputs.numpy(), (self.estimator.after(memory, inputs),)


def _memory(state: Any, first: Any) -> Any:
    """The memory that a state holds, which must be like that of an episode's beginning.

    Raises:
        InputError: `predict` did not return such a state for such observations.
    """
    if not isinstance(state, tuple) or len(state) != 1:
        raise InputError(
            f"predict expects the state that it returned before, a tuple of 1 entry, got "
            f"{state!r}; pass None to begin an episode."
        )
    memory = state[0]
    if isinstance(first, Tensor) and isinstance(memory, np.ndarray):
        memory = torch.from_numpy(memory)
    if _shape(memory) != _shape(first):
        raise InputError(
            f"predict expects the state that it returned before, of {_shape(first)}, got "
            f"{_shape(memory)}; pass None to begin an episode."
        )
    return memory


def _shape(memory: Any) -> Any:
    """The shapes of an estimator's memory, but for what grows with the episode."""
    if isinstance(memory, Tensor):
        return f"shape {tuple(memory.shape)}"
    if isinstance(memory, tuple):
        return tuple(map(_shape, memory))
    arrays = getattr(memory, "__dict__", {}).values()
    return type(memory).__name__, *(_shape(a) for a in arrays if isinstance(a, Tensor))


def remembering(answer: Callable[[np.ndarray, Any], tuple[np.ndarray, Any]]) -> Act:
    """Acts for one episode: the state of each answer goes to the next."""
    state = None

    def act(observation: Float[np.ndarray, "*b Y"]) -> Float[np.ndarray, "*b U"]:
        nonlocal state
        action, state = answer(observation, state)
        return action

    return act


class BrokenEpisodeError(EnvError):
    """An env misbehaved in the course of an episode; what it did before is in `rollout`."""

    def __init__(self, message: str, rollout: Rollout) -> None:
        super().__init__(message)
        self.rollout = rollout
        """the steps that were done, one at least; no success"""


def run_episode(
    env: gym.Env,
    act: Callable[[Float[np.ndarray, " X"]], Float[np.ndarray, " U"]],
    horizon: int,
    dt: float,
    seed: int | None = None,
    options: dict[str, Any] | None = None,
    width: int | None = None,
    stop: Callable[[Float[np.ndarray, " X"]], bool] | None = None,
) -> Rollout:
    """Reset the env, act until the horizon or the end of the episode, and return the record.

    `act` makes of an observation an input in the env's unit, which is clipped to the action space;
    the horizon is the most steps. dt [s] is for the record, seed and options are passed to
    `env.reset`. The true states that the env may tell are X = `width` numbers; by default as many
    as it observes. The episode ends early where an observation says `stop`.

    Raises:
        BrokenEpisodeError: the env raised, or returned a value that is not finite or of another
            shape than its space, after the first step.
        EnvError: it did so before.
    """
    space = env.action_space
    assert isinstance(space, gym.spaces.Box), "mcpilco.agent.contract has checked it"
    with _blamed(step=0):
        observation, info = env.reset(seed=seed, options=options)
        record = _Record(dt, env.observation_space.shape, observation, info, width)
    for step in range(1, horizon + 1):
        action = np.clip(act(record.seen), space.low, space.high).astype(space.dtype)
        try:
            with _blamed(step):
                observation, reward, terminated, truncated, info = env.step(action)
                record.add(action, observation, reward, info)
        except EnvError as error:
            if step == 1:
                raise
            raise BrokenEpisodeError(str(error), record.rollout(whole=False)) from error
        if terminated or truncated or (stop is not None and stop(record.seen)):
            break
    return record.rollout()


def reported(info: Mapping[str, Any], shape: tuple[int, ...] = ()) -> dict[str, Any]:
    """The measures of an episode that an env reports in `info`: `is_success` and its measures.

    Values of another shape are passed over; of a batch of M envs it is `(M,)`.
    """
    named = {k: np.asarray(v) for k, v in info.items() if k == "is_success" or is_measure(k)}
    fitting = {k: v for k, v in named.items() if v.shape == shape and v.dtype.kind in "biuf"}
    return {name: value.astype(float) if shape else float(value) for name, value in fitting.items()}


class _Record:
    """An episode so far: whole steps only."""

    def __init__(
        self,
        dt: float,
        shape: tuple[int, ...] | None,
        observation: Any,
        info: Mapping[str, Any],
        width: int | None,
    ) -> None:
        self._dt, self._shape = dt, shape
        self._state_shape = shape if width is None else (width,)
        self._observations = [_checked(observation, shape, "observation", 0)]
        self._states = [self._true_state(info)]
        self._inputs: list[np.ndarray] = []
        self._rewards: list[float] = []
        self._outcome: dict[str, float] = {}

    @property
    def seen(self) -> Float[np.ndarray, " X"]:
        """The last observation."""
        return self._observations[-1]

    def add(
        self, action: np.ndarray, observation: Any, reward: Any, info: Mapping[str, Any]
    ) -> None:
        """Keep a step, or raise EnvError and keep nothing of it."""
        step = len(self._observations)
        observation = _checked(observation, self._shape, "observation", step)
        reward = float(_checked(np.squeeze(np.asarray(reward)), (), "reward", step))
        state = self._true_state(info)
        self._outcome = reported(info)
        self._observations.append(observation)
        self._states.append(state)
        self._inputs.append(action.astype(np.float64))
        self._rewards.append(reward)

    def _true_state(self, info: Mapping[str, Any]) -> np.ndarray | None:
        """`info["state"]`; None where it is absent, or has another shape."""
        state = info.get("state")
        if state is None or np.shape(state) != self._state_shape:
            return None
        return _checked(state, self._state_shape, 'info["state"]', len(self._observations))

    def rollout(self, whole: bool = True) -> Rollout:
        """The record; what breaks off is no success."""
        known = all(state is not None for state in self._states)
        failed = {"is_success": 0.0} if not whole and "is_success" in self._outcome else {}
        return Rollout(
            dt=self._dt,
            observations=np.array(self._observations),
            inputs=np.array(self._inputs),
            rewards=np.array(self._rewards),
            states=np.array(self._states) if known else None,
            outcome=self._outcome | failed,
        )


@contextlib.contextmanager
def _blamed(step: int) -> Iterator[None]:
    """Turns whatever the env raises into an EnvError."""
    try:
        yield
    except EnvError:
        raise
    except Exception as error:  # the env is foreign code
        raise EnvError(
            f"The env raised {type(error).__name__} at step {step}: {error}; mend the env, or the "
            "connection to its system."
        ) from error


def _checked(
    value: Any, shape: tuple[int, ...] | None, name: str, step: int
) -> Float[np.ndarray, "*b"]:
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        array = None
    if array is None or array.shape != shape or not np.isfinite(array).all():
        raise EnvError(
            f"The env must return finite numbers of shape {shape}, "
            f"got {name} {value!r} at step {step}; "
            "check its equations, its sensor, or the action it was given."
        )
    return array


_INPUTS, _RESET, _SEARCH = range(3)


class Streams:
    """Independent sources of random numbers for each trial; trial 0 is the exploration.

    Each is a function of the training's seed, the trial and its use. No generator's state goes from
    one trial to the next, so that a training that begins again at any trial, from a file, draws the
    numbers that it would have drawn.

    Reference: numpy's SeedSequence; streams of different spawn keys are independent.
    """

    def __init__(self, seed: int) -> None:
        self.seed = seed

    def inputs(self, trial: int) -> np.random.Generator:
        """Source of the random inputs of an exploration."""
        return np.random.default_rng(self._sequence(trial, _INPUTS))

    def reset(self, trial: int, episode: int = 0) -> int:
        """The seed with which the env begins an episode of the trial, below 2^32."""
        later = (episode,) if episode else ()
        return int(self._sequence(trial, _RESET, *later).generate_state(1)[0])

    def search(self, trial: int) -> torch.Generator:
        """Source of the starts, particles and masks of a trial's policy search."""
        state = self._sequence(trial, _SEARCH).generate_state(1)
        return torch.Generator().manual_seed(int(state[0]))

    def _sequence(self, trial: int, *use: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(self.seed, spawn_key=(trial, *use))
