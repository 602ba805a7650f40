"""Whether what is hidden does anything: a limit that no command reaches can be found by nobody."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.signal import lsim
from systems import System
from truth import ROTARY_PENDULUM, VISCOUS, simulate

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


@dataclass(frozen=True)
class Made:
    """A machine, and the motions that it made."""

    system: System
    machine: Machine
    motions: Sequence[tuple[np.ndarray, np.ndarray]]
    """states and commands of its recordings"""
    std: np.ndarray
    """of the noise of each position"""
    how: tuple[float, ...]
    """as `Machine.positions` takes it"""

    def apart(self, lacking: Machine, uncertainty: float = 0.0) -> float:
        """Noise std by which all positions together leave those of a machine without an effect.

        The start of a window is known to nobody: what another start would do as well does not
        count. Nor, where parameters have an `uncertainty`, does what others of these would do as
        well, to first order; by how far they are off they count instead, in their std.
        """
        J = len(self._bent[0]) if uncertainty else 0
        H, g, total = np.eye(J) / (uncertainty or 1.0) ** 2, np.zeros(J), 0.0
        for n, ((start, held), moved) in enumerate(zip(self._windows, self._moved, strict=True)):
            missed = moved[0] - self._seen(lacking, start, held)
            bent = self._bent[n] if uncertainty else []
            whole = np.stack([*moved[1:], *bent, missed], axis=1)
            whole = whole[np.isfinite(whole).all(axis=1)]
            Q, _ = np.linalg.qr(whole[:, : len(start)])
            rest = whole[:, len(start) :]
            rest = rest - Q @ (Q.T @ rest)
            H, g = H + rest[:, :-1].T @ rest[:, :-1], g + rest[:, :-1].T @ rest[:, -1]
            total += float(rest[:, -1] @ rest[:, -1])
        return float(np.sqrt(max(total - float(g @ np.linalg.solve(H, g)), 0.0)))

    @cached_property
    def _windows(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Start and commands of each."""
        return [
            (states[first], commands[first : first + WINDOW])
            for states, commands in self.motions
            for first in range(0, len(states) - WINDOW + 1, EVERY)
        ]

    def _seen(self, machine: Machine, start: np.ndarray, held: np.ndarray) -> np.ndarray:
        """The positions in noise std."""
        return (machine.positions(self.system, start, held, self.how) / self.std).ravel()

    @cached_property
    def _moved(self) -> list[list[np.ndarray]]:
        """Of each window the positions, and how they change with each number of its start."""
        moved = []
        for start, held in self._windows:
            nudged = start + NUDGE * np.eye(1 + len(start), len(start), -1)
            here, *others = (self._seen(self.machine, each, held) for each in nudged)
            moved.append([here, *((other - here) / NUDGE for other in others)])
        return moved

    @cached_property
    def _bent(self) -> list[list[np.ndarray]]:
        """Of each window how its positions change with each parameter, relative to its value."""
        machines = _slack(self.system, self.machine)
        return [
            [(self._seen(other, start, held) - moved[0]) / NUDGE for other in machines]
            for (start, held), moved in zip(self._windows, self._moved, strict=True)
        ]

    def felt(self, lacking: Machine) -> bool:
        """Whether the machine moves otherwise than one that lacks an effect, beyond the noise."""
        return self.apart(lacking) >= FELT


def _slack(system: System, machine: Machine) -> list[Machine]:
    """The machine with each of its masses, lengths, frictions and gains a little larger."""
    kinds = [
        *(("mass", b) for b in range(len(system.bodies))),
        *(("length", b) for b in range(len(system.bodies)) if system.kind != ROTARY_PENDULUM),
        *(("viscous", j) for j in range(len(system.joints))),
        *(("gain", u) for u in range(len(system.inputs))),
    ]
    others = [machine.copy() for _ in kinds]
    for (kind, n), other in zip(kinds, others, strict=True):
        if kind == "mass":
            other.body[n, :3] *= 1.0 + NUDGE
        elif kind == "length":
            other.body[n] *= (1.0 + NUDGE) ** np.array([0.0, 1.0, 2.0, 1.0])
        elif kind == "viscous":
            other.joint[n, VISCOUS] += NUDGE * system.viscous[n]
        else:
            other.actuator[n, 0] *= 1.0 + NUDGE
    return others
