"""A cart-pole that MuJoCo simulates."""

from __future__ import annotations

from typing import ClassVar

import mujoco
import mujoco.rollout
import numpy as np
from jaxtyping import Float

from envs.cartpole_dynamics import CartPoleDynamics
from envs.mujoco_cartpole_model import JOINTS
from envs.mujoco_views import Posture
from envs.system import Input, System
from mcpilco.typing import EnvError, InputError

_DIVISIBLE = 1e-6
"""how far from whole a number of steps may be, relative [-]"""


class MujocoCartPoleDynamics(System):
    """The cart-pole of a MuJoCo model; a state is that of `CartPoleDynamics`.

    A motion is a function of its start and input alone: the model keeps nothing in between.
    """

    state_names: ClassVar = CartPoleDynamics.state_names
    state_units: ClassVar = CartPoleDynamics.state_units
    input_name: ClassVar = CartPoleDynamics.input_name
    input_unit: ClassVar = CartPoleDynamics.input_unit
    angles: ClassVar = CartPoleDynamics.angles

    def __init__(self, model: mujoco.MjModel) -> None:
        """A cart-pole at its model's timestep.

        Args:
            model: has passed `envs.mujoco_cartpole_model`; from now on it belongs to this object.
        """
        self.model = model
        self.posture = Posture(model, tuple(JOINTS), "tip")
        # the force is limited where actions are read, the model's limit must not do it again
        model.actuator_ctrllimited[:] = 0
        self._data = mujoco.MjData(model)
        # the columns of MuJoCo's state (time, positions, velocities) that make up ours
        joints = [model.joint(name) for name in JOINTS]
        pairs = [(1 + j.qposadr[0], 1 + model.nq + j.dofadr[0]) for j in joints]
        self._columns = np.array(pairs).ravel()

    @property
    def timestep(self) -> float:
        """MuJoCo's step [s]."""
        return float(self.model.opt.timestep)

    def advance(
        self, states: Float[np.ndarray, "*b X"], force: Input, duration: float, samples: int = 1
    ) -> Float[np.ndarray, "T *b X"]:
        """The motion in steps of `timestep`; EnvError where MuJoCo calls it unstable.

        Raises:
            InputError: the time between two samples is no whole number of steps.
        """
        batch = states.shape[:-1]
        every = count_steps(duration / samples, self.timestep)
        start = np.zeros((int(np.prod(batch)), 1 + self.model.nq + self.model.nv))
        start[:, self._columns] = states.reshape(-1, 4)
        control = np.broadcast_to(force, batch).reshape(-1, 1, 1)
        path, _ = mujoco.rollout.rollout(
            self.model, self._data, start, control.astype(float), nstep=samples * every
        )
        path = path[:, every - 1 :: every]
        self._require_finished(states, path, duration)
        return path[..., self._columns].swapaxes(0, 1).reshape(samples, *batch, 4)

    def tip(self, states: Float[np.ndarray, "*b 4"]) -> Float[np.ndarray, "*b 3"]:
        """Where the model's site `tip` is; without one, the pole's centre of mass [m]."""
        return self.posture.marker(states)

    def _require_finished(
        self, states: np.ndarray, path: Float[np.ndarray, "B T full"], duration: float
    ) -> None:
        """Raises EnvError where MuJoCo has stopped: its clock then stands still, or starts anew."""
        late = np.abs(path[:, -1, 0] - duration) > 0.5 * self.timestep
        unstable = late | ~np.isfinite(path).all(axis=(1, 2))
        if unstable.any():
            first = states.reshape(-1, 4)[int(np.argmax(unstable))]
            raise EnvError(
                f"MuJoCo calls the motion from the state {first.tolist()} unstable; the state or "
                f"the force is too large, or the timestep of {self.timestep:g} s too long."
            )


def count_steps(duration: float, timestep: float) -> int:
    """How many steps a duration [s] takes.

    Raises:
        InputError: it is no whole number of them.
    """
    steps = round(duration / timestep)
    if steps < 1 or abs(duration / timestep - steps) > _DIVISIBLE * steps:
        raise InputError(
            f"timestep must divide the {duration:g} s between two looks at the state into equal "
            f"steps, got {timestep:g} s; pass timestep={fitting_step(duration, timestep)!r}."
        )
    return steps


def fitting_step(duration: float, longest: float) -> float:
    """The longest step that divides a duration, up to a longest one [s]."""
    return duration / max(1, int(np.ceil(duration / longest - _DIVISIBLE)))
