"""Whether what is hidden does anything: a limit that no command reaches can be found by nobody."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lsim
from systems import System
from truth import simulate

WINDOW, EVERY = 50, 50
"""samples over which a motion is followed anew, and from one start to the next"""
FELT = 10.0
"""noise std by which all positions of all windows together must differ, wherever they start"""
NUDGE = 1e-4
"""of a start, by which it is told what starts do [m, rad, m/s or rad/s]"""


@dataclass(frozen=True)
class Machine:
    """A simulated plant and how its sensors read."""

    body: np.ndarray
    joint: np.ndarray
    actuator: np.ndarray
    sensor: dict[int, dict[str, float]]

    def copy(self) -> Machine:
        """Another with the same numbers."""
        sensor = {k: dict(hidden) for k, hidden in self.sensor.items()}
        return Machine(self.body.copy(), self.joint.copy(), self.actuator.copy(), sensor)

    def positions(
        self, system: System, start: np.ndarray, commands: np.ndarray, how: tuple[float, ...]
    ) -> np.ndarray:
        """The positions as its sensors read them without noise, (T, J).

        Args:
            system: the plant.
            start: state.
            commands: (T, U), which nothing is fed back into.
            how: sampling time, gravity, and the speed over which friction turns over.
        """
        dt, gravity, width = how
        none = np.zeros((commands.shape[1], len(start)))
        drives = np.array(system.drives)
        arrays = self.body, self.joint, self.actuator, drives
        states = simulate(system.kind, start, commands.copy(), none, dt, *arrays, gravity, width)
        time = dt * np.arange(len(states))
        seen = states[:, 0::2].copy()
        for k, hidden in self.sensor.items():
            if k % 2 == 0:
                late = time - hidden.get("sensor_delay", 0.0)
                y = np.interp(late, time, states[:, k])
                if "sensor_lag" in hidden:
                    system_ = [1.0], [hidden["sensor_lag"], 1.0]
                    y = lsim(system_, y, time, X0=[y[0] * hidden["sensor_lag"]])[1]
                y = y + hidden.get("sine", 0.0) * np.sin(y) + hidden.get("cosine", 0.0) * np.cos(y)
                seen[:, k // 2] = hidden.get("sensor_scale", 1.0) * y + hidden.get(
                    "sensor_offset", 0.0
                )
        return seen


def felt(
    system: System,
    machine: Machine,
    lacking: Machine,
    motions: Sequence[tuple[np.ndarray, np.ndarray]],
    std: np.ndarray,
    how: tuple[float, ...],
) -> bool:
    """Whether a machine moves otherwise than one that lacks an effect, beyond the noise.

    The start of a window is known to nobody: what another start would do as well does not count.

    Args:
        system: the plant.
        machine: with the effect.
        lacking: without it.
        motions: states and commands of its recordings.
        std: of the noise of each position.
        how: as `Machine.positions` takes it.
    """
    total = 0.0
    for states, commands in motions:
        for first in range(0, len(states) - WINDOW + 1, EVERY):
            held = commands[first : first + WINDOW]
            starts = states[first] + NUDGE * np.eye(1 + states.shape[1], states.shape[1], -1)
            seen = [machine.positions(system, start, held, how) / std for start in starts]
            other = lacking.positions(system, states[first], held, how) / std
            columns = np.stack([(nudged - seen[0]).ravel() / NUDGE for nudged in seen[1:]], axis=1)
            apart = (seen[0] - other).ravel()
            told = np.isfinite(apart) & np.isfinite(columns).all(axis=1)
            explained = np.linalg.lstsq(columns[told], apart[told])[0]
            total += float(np.square(apart[told] - columns[told] @ explained).sum())
    return total >= FELT**2
