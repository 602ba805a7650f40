"""Motions under commands that come one at a time: true states, and what sensors measure."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float

from mcpilco.plant import ChainPlant
from mcpilco.typing import EnvError


class Motion:
    """A batch of motions of a plant with its effects, moved by one command after another.

    Actuators and sensors have a memory.
    """

    def __init__(self, plant: ChainPlant, dt: float, samples: int, batch: tuple[int, ...]) -> None:
        """Motions in the state 0.

        Arguments are those of `mcpilco.plant.ChainPlant.stepper`.
        """
        self._batch = batch
        self._stepper = plant.stepper(dt, int(np.prod(batch, dtype=int)), samples)

    @property
    def states(self) -> Float[np.ndarray, "*b X"]:
        """The true states now."""
        return self._stepper.states.reshape(*self._batch, -1).copy()

    @property
    def measured(self) -> Float[np.ndarray, "*b X"]:
        """The states as sensors without noise measure them now."""
        return self._stepper.measured.reshape(*self._batch, -1)

    def restart(
        self, which: Bool[np.ndarray, "*b"] | bool, states: Float[np.ndarray, "*c X"]
    ) -> None:
        """Starts the motions marked anew, in the states given; no command came before."""
        marked = np.broadcast_to(which, self._batch).reshape(-1)
        self._stepper.restart(marked, states.reshape(-1, states.shape[-1]))

    def advance(self, inputs: Float[np.ndarray, "*b U"]) -> Float[np.ndarray, "T *b X"]:
        """Holds the inputs for dt: the true states at T equally spaced times, the last at the end.

        Raises:
            EnvError: a motion is too fast or too stiff to follow.
        """
        before = self.states
        path = self._stepper.advance(inputs.reshape(-1, inputs.shape[-1]))
        if np.isnan(path[-1]).any():
            raise EnvError(
                f"The motion ran away from the states {before} under the inputs {inputs}; choose "
                "physical constants, effects and a start that leave it stable."
            )
        return path.reshape(len(path), *self._batch, -1)
