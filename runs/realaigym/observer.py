"""The state now, from measurements that come late and whose velocities are noisy."""

from __future__ import annotations

import numpy as np
from realaigym.equations import Row, State, step

MOVED = 1e-4
"""angle from the start beyond which the machine is seen to move [rad]"""
LATEST = 25
"""largest delay that is looked for [steps]"""
TRUST = 0.6
"""share of the error of a predicted velocity that a position corrects in a step [-]"""


class Observer:
    """Follows the plant from its positions, and predicts over a delay that it has found itself.

    The delay is how much later than in the model the first torques are seen to move the machine.
    Until then the model alone is followed. Measured velocities are not used: positions of these
    machines are exact, and what the model says wrongly of a velocity shows in the next position.
    """

    def __init__(self, plant: Row, joint: int, dt: float) -> None:
        """Of a plant with a motor in the joint 0 or 1, asked every dt [s]."""
        self.plant, self.joint, self.dt = plant, joint, dt
        self.reset()

    def reset(self) -> None:
        """Begin an episode."""
        self.torques: list[float] = []
        self.delay: int | None = None
        """found so far [steps]; None before the machine is seen to move"""
        self._start: State | None = None

    def __call__(self, measured: State) -> State:
        """The state now, from what is measured now; `told` must have had each torque before."""
        if self._start is None:
            self._start = self._seen = self._model = np.array(measured, dtype=float)
            self._moved_after = 0
            return self._start
        if self.delay is None:
            self._look_for_motion(measured)
        else:
            self._follow(measured)
        late = len(self.torques) if self.delay is None else self.delay
        return self._along(self._seen, self.torques[-late:] if late else [])

    def told(self, torque: float) -> None:
        """Take note of the torque that is held from now on [N m]."""
        self.torques.append(torque)

    def _look_for_motion(self, measured: State) -> None:
        assert self._start is not None
        if not self._far(self._model):
            self._model = self._along(self._model, self.torques[-1:])
            self._moved_after += 1
        if self._far(measured):
            self.delay = min(len(self.torques) - self._moved_after, LATEST)
            self._seen = np.array(measured, dtype=float)

    def _follow(self, measured: State) -> None:
        """One step of the model behind the delay, corrected by the positions."""
        assert self.delay is not None
        held = self.torques[-1 - self.delay]
        predicted = self._along(self._seen, [held])
        error = (measured[:2] - predicted[:2]) / self.dt
        self._seen = np.concatenate([measured[:2], predicted[2:] + TRUST * error])

    def _far(self, state: State) -> bool:
        return bool(np.abs(state[:2] - self._start[:2]).max() > MOVED)

    def _along(self, state: State, torques: list[float]) -> State:
        for torque in torques:
            both = (torque, 0.0) if self.joint == 0 else (0.0, torque)
            state = step(state, *both, self.plant, self.dt)
        return state
