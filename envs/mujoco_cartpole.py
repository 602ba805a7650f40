"""The cart-pole swing-up in MuJoCo, one at a time."""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Literal

import mujoco
import numpy as np

from envs.cartpole import LENGTHSCALES, OneOrFour, cart_pole_swing_up
from envs.cartpole_dynamics import CartPoleDynamics
from envs.checks import require_positive
from envs.judge import looks
from envs.mujoco_cartpole_dynamics import MujocoCartPoleDynamics, count_steps, fitting_step
from envs.mujoco_cartpole_model import build_model, input_limit, read_model
from envs.mujoco_views import MujocoPicture, scene
from envs.swing_up_env import SwingUpEnv
from mcpilco.typing import Cost, InputError

UPRIGHT = np.array([0.0, 0.0, np.pi, 0.0])


class MujocoCartPoleSwingUpEnv(SwingUpEnv):
    """The task of `CartPoleSwingUpEnv`, simulated by MuJoCo.

    ## Description

    The same cart, pole, force, noise, start, cost and judge as `mcpilco/CartPoleSwingUp-v0`, but
    MuJoCo integrates the motion, of the model in `envs/assets/cartpole.xml` or of one's own. As
    MuJoCo's timestep h shrinks, the motion becomes that of the analytic env; with the built-in
    model's Runge-Kutta method the difference falls as h^4. At the default step half of all random
    episodes of 3 s end within 2e-8 of the analytic ones, nine of ten within 2e-7, in SI units.

    The id is `mcpilco/MujocoCartPoleSwingUp-v0`, known after `import envs`, which does not load
    MuJoCo yet; `gymnasium.make_vec` makes a `MujocoCartPoleSwingUpVectorEnv` of it.

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
        cart_mass: float | None = None,
        pole_mass: float | None = None,
        pole_length: float | None = None,
        cart_friction: float | None = None,
        gravity: float | None = None,
        force_limit: float | None = None,
        dt: float = 0.1,
        start_std: OneOrFour = 0.1,
        noise_std: OneOrFour = 0.01,
        measured: Literal["all", "positions"] = "all",
        cost: Cost | None = None,
        cost_lengthscales: Sequence[float] = LENGTHSCALES,
        render_mode: str | None = None,
    ) -> None:
        """The keywords are listed above under Arguments."""
        constants = {
            "cart_mass": cart_mass,
            "pole_mass": pole_mass,
            "pole_length": pole_length,
            "cart_friction": cart_friction,
            "gravity": gravity,
        }
        compiled = _model(model, {k: v for k, v in constants.items() if v is not None})
        require_positive("dt", dt, "s")
        _set_timestep(compiled, timestep, dt / looks(dt), adapt=model is None)
        limit = input_limit(compiled) if force_limit is None else force_limit
        dynamics = MujocoCartPoleDynamics(compiled)
        swing_up = cart_pole_swing_up(
            dynamics,
            force_limit=limit,
            dt=dt,
            start_std=start_std,
            noise_std=noise_std,
            cost=cost,
            cost_lengthscales=cost_lengthscales,
            measured=measured,
        )
        posture = dynamics.posture
        super().__init__(swing_up, scene(posture, UPRIGHT), MujocoPicture(posture), render_mode)

    def close(self) -> None:
        """Gives OpenGL back; the env can still be used."""
        self.picture.close()


def _model(path: str | os.PathLike[str] | None, constants: dict[str, float]) -> mujoco.MjModel:
    """The user's model, or the built-in one with these constants."""
    if path is None:
        return build_model(CartPoleDynamics(**constants))
    if constants:
        raise InputError(
            f"{', '.join(constants)}: of the built-in model only; write the value into {path!r}."
        )
    return read_model(path)


def _set_timestep(model: mujoco.MjModel, timestep: float | None, look: float, adapt: bool) -> None:
    """Gives the model the step asked for, or its own, `adapt`ed to divide the time of a look."""
    if timestep is not None:
        require_positive("timestep", timestep, "s")
    elif adapt:
        timestep = fitting_step(look, model.opt.timestep)
    else:
        timestep = float(model.opt.timestep)
    model.opt.timestep = look / count_steps(look, timestep)
