"""From observations to states: angles of cosines and sines; what is measured in part, estimated."""

from __future__ import annotations

import copy
import dataclasses
import functools
from collections.abc import Mapping
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
import torch
from gymnasium.spaces import Box
from jaxtyping import Float

from mcpilco.config import EstimatorConfig
from mcpilco.data import Rollout, Transitions
from mcpilco.dynamics import speed_integration
from mcpilco.sensing.estimator import Chain, LinearEstimator, Observer, differences, kalman
from mcpilco.sensing.motion import Motion, fit_motion, smooth
from mcpilco.sensing.refinement import refined
from mcpilco.task import TaskSpec
from mcpilco.typing import Estimator

TURN = 2 * np.pi
"""a full turn [rad]"""


def state_of(task: TaskSpec, observation: Float[np.ndarray, "*b O"]) -> Float[np.ndarray, "*b X"]:
    """The state that an observation tells, angles of cosines and sines within +-pi."""
    if not task.observed:
        return observation
    columns = [
        np.arctan2(observation[..., where[1]], observation[..., where[0]])
        if isinstance(where, tuple)
        else observation[..., where]
        for where in task.observed
    ]
    return np.stack(columns, axis=-1)


def unwrapped(
    task: TaskSpec, before: Float[np.ndarray, " X"], state: Float[np.ndarray, " X"]
) -> Float[np.ndarray, " X"]:
    """The state with as many full turns on each angle as bring it nearest to the one before."""
    state, angles = state.copy(), list(task.angles)
    state[angles] -= TURN * np.round((state[angles] - before[angles]) / TURN)
    return state


class StateView(gym.Wrapper[np.ndarray, np.ndarray, np.ndarray, np.ndarray]):
    """The env with its states as observations; angles count turns, so they never jump.

    Needs steps short enough for an angle to change by less than half a turn.
    """

    def __init__(self, env: gym.Env[np.ndarray, np.ndarray], task: TaskSpec) -> None:
        super().__init__(env)
        self._task = task
        self._last = np.zeros(len(task.state_names))
        self.observation_space = Box(-np.inf, np.inf, self._last.shape, np.float64)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options)
        self._last = self._state(observation)
        return self._last, info

    def step(
        self, action: np.ndarray
    ) -> tuple[np.ndarray, SupportsFloat, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._last = unwrapped(self._task, self._last, self._state(observation))
        return self._last, reward, terminated, truncated, info

    def _state(self, observation: Any) -> Float[np.ndarray, " X"]:
        return state_of(self._task, np.asarray(observation, dtype=np.float64))


def state_view(env: gym.Env, task: TaskSpec) -> gym.Env:
    """The env as the agent learns from it: itself, where its observation is the state."""
    return StateView(env, task) if task.observed else env


class Perception:
    """From measurements to states: after an episode without delay, in it from those so far.

    Reference: Amadio et al., IEEE Transactions on Robotics 38 (6), 2022, section VI (MC-PILCO4PMS).

    Differs: both the smoother and the filter follow one motion, whose numbers are fitted.
    """

    def __init__(self, config: EstimatorConfig, task: TaskSpec) -> None:
        """A perception that has seen nothing yet: until it has, velocities are differences."""
        self.config = config
        self.task = task
        self.estimator: LinearEstimator = differences(task, config.low_pass)
        """what policies act on"""
        stds = task.measurement_std
        self.noise_std = None if stds is None else np.array(stds)
        """of each measurement, in its unit; None: not known before the first recording"""
        self.estimate_std: Float[np.ndarray, " X"] | None = None
        """root mean square difference of the last episode's estimates from its smoothed states, in
        each state's unit; None: there was none"""
        self.recordings: tuple[Float[np.ndarray, "T_plus_1 Y"], ...] = ()
        """the measurements of all episodes, in each one's unit"""

    def digest(self, record: Rollout) -> Rollout:
        """The record of an episode with its states as estimated in it and as smoothed now.

        Raises:
            InputError: the episode is too short for a velocity.
        """
        motion = fit_motion(self.task, record.observations, self.noise_std)
        if self.noise_std is None:
            self.noise_std = motion.noise_std
        estimates = self._estimates(record.observations)
        smoothed = smooth(motion, record.observations)
        self.estimate_std = np.sqrt(((estimates - smoothed) ** 2).mean(0))
        self.recordings = (*self.recordings, record.observations)
        return dataclasses.replace(record, estimates=estimates, smoothed=smoothed)

    def refined(self, rows: Transitions, dynamics: Any) -> Transitions:
        """The rows of all episodes, smoothed by a model that was learned from them.

        Those of episodes whose measurements are not there, which come first, stay as they are.
        """
        first = len(rows) - sum(len(measured) - 1 for measured in self.recordings)
        anew = [rows[:first]]
        for measured in self.recordings:
            own = rows[first : first + len(measured) - 1]
            states = np.concatenate([own.states, own.next_states[-1:]])
            noise_std = self._known_noise
            states = refined(self.task, dynamics, noise_std, measured, own.inputs, states)
            anew.append(Transitions(states[:-1], own.inputs, states[1:]))
            first += len(own)
        return functools.reduce(Transitions.__add__, anew)

    def adapted(self, rows: Transitions) -> Perception:
        """The same with the estimator fitted to all that was learned."""
        adapted = copy.copy(self)
        if self.config.kind == "kalman":
            changes = speed_integration(self.task).targets(rows)
            change_std = np.sqrt((changes**2).mean(0))
            adapted.estimator = kalman(Motion.of(self.task, change_std, self._known_noise))
        return adapted

    def observer(self, behind: Estimator | None = None) -> Observer:
        """The sensor and the estimator behind it, for particles.

        The estimator `behind` takes this one's estimates as measurements.
        """
        estimator = self.estimator if behind is None else Chain(self.estimator, behind)
        return Observer(estimator, torch.from_numpy(self._known_noise), self.estimator.C)

    @property
    def _known_noise(self) -> Float[np.ndarray, " Y"]:
        assert self.noise_std is not None, "an episode has been digested"
        return self.noise_std

    def _estimates(self, measured: Float[np.ndarray, "T Y"]) -> Float[np.ndarray, "T X"]:
        series = torch.from_numpy(measured)
        estimates, memory = [], self.estimator.begin(series[0])
        for now in series:
            estimate, memory = self.estimator.observe(now, memory)
            estimates.append(estimate.numpy())
        return np.array(estimates)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """The estimator and the noise it was made for, as named arrays for a file."""
        arrays = {name: value.numpy() for name, value in vars(self.estimator).items()}
        known = {"noise_std": self.noise_std, "estimate_std": self.estimate_std}
        if self.recordings:
            known["measured"] = np.concatenate(self.recordings)
            known["lengths"] = np.array([len(measured) for measured in self.recordings])
        return arrays | {name: value for name, value in known.items() if value is not None}

    def load_arrays(self, arrays: Mapping[str, Any]) -> None:
        """Take the arrays that `to_arrays` gave.

        Raises:
            ValueError: an array is missing, of another shape, or not finite.
        """
        here = vars(self.estimator)
        missing = set(here) - set(arrays)
        if missing:
            raise ValueError(f"its estimator lacks {sorted(missing)}")
        shapes = {name: tuple(value.shape) for name, value in here.items()}
        shapes["gains"] = np.shape(arrays["gains"])[:1] + shapes["gains"][1:]
        shapes["noise_std"] = (len(self.task.measured_states),)
        shapes["estimate_std"] = (len(self.task.state_names),)  # files of before lack it
        loaded = {name: np.asarray(arrays[name], dtype=float) for name in shapes if name in arrays}
        if any(a.shape != shapes[n] or not np.isfinite(a).all() for n, a in loaded.items()):
            raise ValueError("its estimator does not fit the measured states")
        self.estimator = LinearEstimator(**{name: torch.from_numpy(loaded[name]) for name in here})
        self.noise_std = loaded.get("noise_std", self.noise_std)
        self.estimate_std = loaded.get("estimate_std")
        if "measured" in arrays:  # files of before lack them
            ends = np.cumsum(arrays["lengths"])[:-1]
            self.recordings = tuple(np.split(arrays["measured"], ends))
