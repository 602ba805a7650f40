"""What an agent makes of a state measured in part: smoothed to learn from, estimated to act on."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float

from mcpilco.config import EstimatorConfig
from mcpilco.data import Rollout, Transitions
from mcpilco.dynamics import speed_integration
from mcpilco.sensing.estimator import LinearEstimator, LinearObserver, differences, kalman
from mcpilco.sensing.motion import Motion, fit_motion
from mcpilco.sensing.smoother import smooth
from mcpilco.task import TaskSpec
from mcpilco.typing import InputError


class Perception:
    """From measurements to states: after an episode without delay, in it from those so far.

    Reference: Amadio et al., IEEE Transactions on Robotics 38 (6), 2022, section VI (MC-PILCO4PMS).

    Differs: both the smoother and the filter follow one motion, whose numbers are fitted.
    """

    def __init__(self, config: EstimatorConfig, task: TaskSpec) -> None:
        """A perception that has seen nothing yet: until it has, velocities are differences.

        Args:
            config: its numbers.
            task: which states are measured, and how exactly.
        """
        self.config = config
        self.task = task
        self.estimator: LinearEstimator = differences(task, config.low_pass)
        """what policies act on"""
        stds = task.measurement_std
        self.noise_std = None if stds is None else np.array(stds)
        """of each measurement, in its unit; None: not known before the first recording"""

    def digest(self, record: Rollout) -> Rollout:
        """The record of an episode with its states as estimated in it and as smoothed now.

        Raises:
            InputError: the episode is too short for a velocity.
        """
        motion = fit_motion(self.task, record.observations, self.noise_std)
        if self.noise_std is None:
            self.noise_std = motion.noise_std
        return dataclasses.replace(
            record,
            estimates=self._estimates(record.observations),
            smoothed=smooth(motion, record.observations),
        )

    def adapted(self, rows: Transitions) -> Perception:
        """The same with the estimator fitted to all that was learned.

        Args:
            rows: smoothed states of all episodes so far.
        """
        adapted = copy.copy(self)
        if self.config.kind == "kalman":
            changes = speed_integration(self.task).targets(rows)
            change_std = np.sqrt((changes**2).mean(0))
            adapted.estimator = kalman(Motion.of(self.task, change_std, self._known_noise))
        return adapted

    @property
    def observer(self) -> LinearObserver:
        """The sensor and the estimator behind it, for particles."""
        return LinearObserver(self.estimator, torch.from_numpy(self._known_noise))

    @property
    def _known_noise(self) -> Float[np.ndarray, " Y"]:
        assert self.noise_std is not None, "an episode has been digested"
        return self.noise_std

    def see(
        self,
        measured: Float[np.ndarray, "*b Y"],
        memory: Float[np.ndarray, "*b M"] | None = None,
        restart: Bool[np.ndarray, "*b"] | None = None,
    ) -> tuple[Float[np.ndarray, "*b X"], Float[np.ndarray, "*b M"]]:
        """Estimates of the states, and what to remember for the next measurements.

        Args:
            measured: now, in the units of the measured states.
            memory: of the step before; None: these are the first measurements.
            restart: where these are the first measurements of an episode, whatever is remembered.

        Raises:
            InputError: the memory does not belong to these measurements.
        """
        first = self.estimator.begin(*measured.shape[:-1])
        known = first if memory is None else torch.as_tensor(memory, dtype=torch.float64)
        if known.shape != first.shape:
            raise foreign_state(f"shape {tuple(first.shape)}", tuple(known.shape))
        if restart is not None:
            again = np.broadcast_to(np.asarray(restart, dtype=bool), measured.shape[:-1])
            known = torch.where(torch.tensor(again)[..., None], first, known)
        estimate, known = self.estimator.update(known, torch.as_tensor(measured))
        return estimate.numpy(), known.numpy()

    def _estimates(self, measured: Float[np.ndarray, "T Y"]) -> Float[np.ndarray, "T X"]:
        """What was known at each step of an episode."""
        estimates, memory = [], None
        for now in measured:
            estimate, memory = self.see(now, memory)
            estimates.append(estimate)
        return np.array(estimates)

    def to_arrays(self) -> dict[str, np.ndarray]:
        """What was learned, for a file."""
        arrays = {name: value.numpy() for name, value in vars(self.estimator).items()}
        return arrays if self.noise_std is None else arrays | {"noise_std": self.noise_std}

    def load_arrays(self, arrays: Mapping[str, Any]) -> None:
        """What `to_arrays` gave.

        Raises:
            ValueError: an array is missing, of another shape, or not finite.
        """
        names = [field.name for field in dataclasses.fields(LinearEstimator)]
        missing = set(names) - set(arrays)
        if missing:
            raise ValueError(f"its estimator lacks {sorted(missing)}")
        loaded = {name: torch.from_numpy(np.asarray(arrays[name], dtype=float)) for name in names}
        here = vars(self.estimator)
        fits = all(loaded[name].shape == here[name].shape for name in ("A", "C", "start"))
        fits = fits and loaded["gains"].shape[1:] == here["gains"].shape[1:]
        noise = arrays.get("noise_std")
        fits = fits and (noise is None or noise.shape == (len(self.task.measured_states),))
        values = [*loaded.values(), *([] if noise is None else [torch.from_numpy(noise)])]
        if not fits or not all(bool(value.isfinite().all()) for value in values):
            raise ValueError("its estimator does not fit the measured states")
        self.estimator = LinearEstimator(**loaded)
        self.noise_std = self.noise_std if noise is None else noise


def foreign_state(expected: str, got: object) -> InputError:
    """The error of a state that `predict` did not return."""
    return InputError(
        f"predict expects the state that it returned before, of {expected}, got {got}; "
        "pass None to begin an episode."
    )
