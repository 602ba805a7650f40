"""The cart-pole swing-up with MuJoCo as its engine."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal

import mujoco
import mujoco.rollout
import numpy as np
from jaxtyping import Bool, Float

from envs.cartpole import LENGTHSCALES, SWING_UP, observed, read_cost
from envs.checks import require_positive
from envs.motion import Motion
from envs.mujoco_cartpole_model import CONSTANTS, JOINTS, build_model, input_limit, read_model
from envs.mujoco_views import MujocoPicture, Posture, scene
from envs.swing_up_env import SwingUpEnv
from mcpilco.typing import Cost, EnvError, InputError

UPRIGHT = np.array([0.0, 0.0, np.pi, 0.0])
_DIVISIBLE = 1e-6
"""how far from whole a number of steps may be, relative [-]"""


class MujocoCartPoleSwingUpEnv(SwingUpEnv):
    """The task of `CartPoleSwingUpEnv`, simulated by MuJoCo.

    ## Description

    The same cart, pole, force, noise, start, cost and judge as `mcpilco/CartPoleSwingUp-v0`, but
    MuJoCo integrates the motion, of the model in `envs/assets/cartpole.xml` or of one's own. As
    MuJoCo's timestep h shrinks, the motion becomes that of the analytic env; with the built-in
    model's Runge-Kutta method the difference falls as h^4. At the default step half of all random
    episodes of 3 s end within 2e-8 of the analytic ones, nine of ten within 2e-7, in SI units.

    The id is `mcpilco/MujocoCartPoleSwingUp-v0`, known after `import envs`, which does not load
    MuJoCo yet; `gymnasium.make_vec` makes a `SwingUpVectorEnv` of it.

    ## Action Space

    A `Box(-10, 10, (1,), float32)`: the force on the cart [N], see `CartPoleSwingUpEnv`.

    ## Observation Space

    A `Box` of shape (4,), float64: cart position [m], cart velocity [m/s], pole angle [rad], pole
    velocity [rad/s], with noise; see `CartPoleSwingUpEnv`, also for `info`.

    ## Rewards, Starting State, Episode End

    Those of `CartPoleSwingUpEnv`.

    ## Arguments

    | Keyword         | Meaning                                           | Default     | Unit  |
    |-----------------|---------------------------------------------------|-------------|-------|
    | `model`         | path of an MJCF file, instead of the built-in one | None        |       |
    | `timestep`      | MuJoCo's step                                     | its own     | s     |
    | `cart_mass`     | mass of the cart                                  | 0.5         | kg    |
    | `pole_mass`     | mass of the pole, a uniform rod                   | 0.5         | kg    |
    | `pole_length`   | from hinge to tip                                 | 0.5         | m     |
    | `cart_friction` | viscous friction between cart and rail            | 0.1         | N s/m |
    | `gravity`       | acceleration of gravity                           | 9.82        | m/s^2 |
    | `force_limit`   | largest force                                     | its own: 10 | N     |

    and `dt`, `start_std`, `noise_std`, `measured`, `cost`, `cost_lengthscales`, `render_mode` as
    `CartPoleSwingUpEnv` has them. The masses, the length, the friction and gravity belong to the
    built-in model; another one says them itself. A wrong value raises `mcpilco.typing.InputError`.

    The true state is looked at every 0.01 s, or a little less where dt is no multiple of it, and
    `timestep` must divide this time. The built-in model's 0.002 s is shortened where it does not.

    ## A model of one's own

    An MJCF file with a slide joint `cart`, a hinge joint `pole` and a motor `force` on the cart,
    with gear 1, and with no other joint or actuator. The pole hangs at the angle 0. Masses,
    damping, dry friction, springs, joint limits, contacts and the integrator are the file's. A
    site `tip` is the point by which particles are drawn; without one, it is the pole's centre of
    mass. Such a model best begins as a copy of `envs/assets/cartpole.xml`.

    ## Pictures

    `render_mode="rgb_array"` draws by EGL, which needs no display, and by GLFW where only that is
    there; the variable MUJOCO_GL (egl, osmesa, glfw) chooses another way. Where nothing draws, the
    first `render()` raises `mcpilco.typing.EnvError` and says what to install.

    ## Version History

    - v0: first version.
    """

    picture: MujocoPicture

    def __init__(
        self,
        *,
        model: str | os.PathLike[str] | None = None,
        timestep: float | None = None,
        force_limit: float | None = None,
        measured: Literal["all", "positions"] = "all",
        cost: Cost | None = None,
        cost_lengthscales: Sequence[float] = LENGTHSCALES,
        render_mode: str | None = None,
        **keywords: Any,
    ) -> None:
        constants = [name for name in CONSTANTS if name in keywords]
        if model is not None and constants:
            raise InputError(
                f"{', '.join(constants)}: of the built-in model only; write the value into "
                f"{os.fspath(model)!r}."
            )
        if unknown := keywords.keys() - {*CONSTANTS, "dt", "start_std", "noise_std"}:
            raise InputError(
                f"MuJoCo's cart-pole has no keyword {', '.join(sorted(unknown))}; its docstring "
                "lists those it has."
            )
        task = SWING_UP.where(
            measured=observed(measured), cost=read_cost(cost, cost_lengthscales), **keywords
        )
        compiled = build_model(task.plant) if model is None else read_model(model)
        _set_timestep(compiled, timestep, task.sample_s, adapt=model is None)
        limit = input_limit(compiled) if force_limit is None else force_limit
        self.simulator = MujocoSimulator(compiled)
        swing_up = replace(task, input_limit=limit, engine=partial(MujocoMotion, self.simulator))
        posture = self.simulator.posture
        super().__init__(swing_up, scene(posture, UPRIGHT), MujocoPicture(posture), render_mode)

    def close(self) -> None:
        """Gives OpenGL back; the env can still be used."""
        self.picture.close()


class MujocoSimulator:
    """The cart-pole of a MuJoCo model; a state is that of `envs.plants.cart_pole`.

    A motion is a function of its start and input alone: the model keeps nothing in between.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        """A cart-pole at its model's timestep.

        The model has passed `envs.mujoco_cartpole_model`; from now on it belongs to this object.
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
        self,
        states: Float[np.ndarray, "*b 4"],
        force: float | Float[np.ndarray, "*b"],
        duration: float,
        samples: int = 1,
    ) -> Float[np.ndarray, "T *b 4"]:
        """The motion in steps of `timestep`, at equally spaced times, the last at the end.

        Motions start in the states [m, m/s, rad, rad/s]; the force on the cart [N], one for all or
        for each, is held for the duration [s]; T `samples` of each motion are returned.

        Raises:
            InputError: the time between two samples is no whole number of steps.
            EnvError: MuJoCo calls the motion unstable.
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


class MujocoMotion(Motion):
    """Motions that MuJoCo integrates; sensors measure states as they are."""

    def __init__(
        self, simulator: MujocoSimulator, dt: float, samples: int, batch: tuple[int, ...]
    ) -> None:
        """Motions in the state 0, of commands that are held for dt [s]."""
        self._simulator, self._dt, self._samples = simulator, dt, samples
        self._states = np.zeros((*batch, 4))

    @property
    def states(self) -> Float[np.ndarray, "*b X"]:
        return self._states.copy()

    measured = states

    def restart(
        self, which: Bool[np.ndarray, "*b"] | bool, states: Float[np.ndarray, "*c X"]
    ) -> None:
        self._states[which] = states

    def advance(self, inputs: Float[np.ndarray, "*b U"]) -> Float[np.ndarray, "T *b X"]:
        path = self._simulator.advance(self._states, inputs[..., 0], self._dt, self._samples)
        self._states = path[-1].copy()
        return path


def count_steps(duration: float, timestep: float) -> int:
    """How many steps a duration [s] takes."""
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


def _set_timestep(model: mujoco.MjModel, timestep: float | None, look: float, adapt: bool) -> None:
    """Gives the model the step asked for, or its own, `adapt`ed to divide the time of a look."""
    if timestep is not None:
        require_positive("timestep", timestep, "s")
    elif adapt:
        timestep = fitting_step(look, model.opt.timestep)
    else:
        timestep = float(model.opt.timestep)
    model.opt.timestep = look / count_steps(look, timestep)
