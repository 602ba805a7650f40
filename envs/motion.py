"""Systems on their way: their true states, and what is measured of them."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
from jaxtyping import Bool, Float

from envs.system import System
from mcpilco.plant import Plant
from mcpilco.typing import EnvError


class Motion(ABC):
    """A batch of systems between two commands."""

    @property
    @abstractmethod
    def states(self) -> Float[np.ndarray, "*b X"]:
        """The true states now."""

    @property
    @abstractmethod
    def measured(self) -> Float[np.ndarray, "*b X"]:
        """What sensors without noise say now."""

    @abstractmethod
    def restart(
        self, which: Bool[np.ndarray, "*b"] | bool, states: Float[np.ndarray, "*c X"]
    ) -> None:
        """Starts the systems marked anew, in the states given; nothing was commanded before."""

    @abstractmethod
    def advance(self, inputs: Float[np.ndarray, "*b"]) -> Float[np.ndarray, "T *b X"]:
        """One step of dt: the true states at the times at which they are looked at.

        Raises:
            EnvError: a motion is too fast or too stiff to follow.
        """


class NominalMotion(Motion):
    """By the equations of motion alone, whose states are measured as they are."""

    def __init__(self, dynamics: System, dt: float, samples: int, batch: tuple[int, ...]) -> None:
        """Systems in the state 0, with dt [s] and the number of looks in a step."""
        self._dynamics, self._dt, self._samples = dynamics, dt, samples
        self._states = np.zeros((*batch, len(dynamics.state_names)))

    @property
    def states(self) -> Float[np.ndarray, "*b X"]:
        return self._states.copy()

    measured = states

    def restart(
        self, which: Bool[np.ndarray, "*b"] | bool, states: Float[np.ndarray, "*c X"]
    ) -> None:
        self._states[which] = states

    def advance(self, inputs: Float[np.ndarray, "*b"]) -> Float[np.ndarray, "T *b X"]:
        path = self._dynamics.advance(self._states, inputs, self._dt, self._samples)
        self._states = path[-1].copy()
        return path


class CorrectedMotion(Motion):
    """By a plant with effects: actuators and sensors have a memory."""

    def __init__(self, plant: Plant, dt: float, samples: int, batch: tuple[int, ...]) -> None:
        """Systems in the state 0, with dt [s] and the number of looks in a step."""
        self._batch = batch
        self._stepper = plant.stepper(dt, int(np.prod(batch, dtype=int)), samples)

    @property
    def states(self) -> Float[np.ndarray, "*b X"]:
        return self._stepper.states.reshape(*self._batch, -1).copy()

    @property
    def measured(self) -> Float[np.ndarray, "*b X"]:
        return self._stepper.measured.reshape(*self._batch, -1)

    def restart(
        self, which: Bool[np.ndarray, "*b"] | bool, states: Float[np.ndarray, "*c X"]
    ) -> None:
        marked = np.broadcast_to(which, self._batch).reshape(-1)
        self._stepper.restart(marked, states.reshape(-1, states.shape[-1]))

    def advance(self, inputs: Float[np.ndarray, "*b"]) -> Float[np.ndarray, "T *b X"]:
        before = self.states
        path = self._stepper.advance(inputs.reshape(-1, 1))
        if np.isnan(path[-1]).any():
            raise EnvError(
                f"The motion ran away from the states {before} under the inputs {inputs}; correct "
                "the plant by effects that leave it stable."
            )
        return path.reshape(len(path), *self._batch, -1)
