"""The rule that says whether a pole has been swung up."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Bool, Float

TOLERANCE = math.radians(10.0)
"""how far from upright still counts as up [rad]"""
HOLD_S = 1.0
"""how long the pole must have stayed up, until now, for a success [s]"""
SAMPLE_S = 0.01
"""longest time between two looks at the true state [s]"""


def is_up(angle: Float[np.ndarray, "*b"]) -> Bool[np.ndarray, "*b"]:
    """Whether a pole at this angle [rad] is within the tolerance of upright, in any turn."""
    return np.abs(np.remainder(angle, 2.0 * np.pi) - np.pi) <= TOLERANCE


def looks(dt: float) -> int:
    """How many times the true state is looked at in a step of dt [s]."""
    return math.ceil(dt / SAMPLE_S - 1e-9)


class UprightJudge:
    """Watches the true state of a batch of systems, sample by sample.

    A sample stands for the time between the previous sample and itself, so that 100 samples of
    0.01 s in which the pole is up are 1 s, and an episode's start is not counted.
    """

    def __init__(
        self,
        sample_s: float,
        batch: tuple[int, ...] = (),
        *,
        links: tuple[int, ...],
        cart: int | None = None,
    ) -> None:
        """A judge that has seen nothing yet.

        Samples are `sample_s` apart [s]; `batch` is the shape of the batch of systems. `links` are
        the states that are angles of the links, each relative to the one before it and 0 hanging
        [rad]; for a pole its angle. All of them must be up; without links nothing is judged. `cart`
        is the state that is the position of a cart [m].
        """
        self._sample_s = sample_s
        self._links, self._cart = list(links), cart
        # rounding must not turn 1 s / 0.01 s into 101 samples
        self._needed = math.ceil(HOLD_S / sample_s - 1e-9)
        self._samples = np.zeros(batch, dtype=int)
        self._up = np.zeros(batch, dtype=int)
        self._up_until_now = np.zeros(batch, dtype=int)
        self._cart_path = np.zeros(batch)

    def restart(self, which: Bool[np.ndarray, "*b"] | bool = True) -> None:
        """Forgets the episodes of the systems marked in `which`."""
        for count in (self._samples, self._up, self._up_until_now, self._cart_path):
            count[...] = np.where(which, 0, count)

    def watch(self, states: Float[np.ndarray, "T *b X"]) -> None:
        """Takes in the next T samples of the state."""
        if not self._links:
            return
        angles = states[..., self._links].cumsum(axis=-1)
        up = np.logical_and.reduce(is_up(angles), axis=-1)
        unbroken = np.logical_and.accumulate(up[::-1]).sum(axis=0)
        self._up_until_now[...] = np.where(
            unbroken == len(up), self._up_until_now + unbroken, unbroken
        )
        self._up += up.sum(axis=0)
        self._samples += len(up)
        if self._cart is not None:
            self._cart_path += np.abs(states[..., self._cart]).sum(axis=0)

    def verdict(self) -> dict[str, np.ndarray]:
        """The episodes so far.

        Returns:
            `is_success`: whether the pole has been up for at least the last second; `time_up_s`:
            for how long it has been up in all [s]; with a cart `mean_abs_cart_m`: its mean distance
            from the origin [m]. Without links nothing.
        """
        if not self._links:
            return {}
        verdict = {
            "is_success": np.asarray(self._up_until_now >= self._needed),
            "time_up_s": np.asarray(self._up * self._sample_s),
        }
        if self._cart is not None:
            mean = self._cart_path / np.maximum(self._samples, 1)
            verdict["mean_abs_cart_m"] = np.asarray(mean)
        return verdict
