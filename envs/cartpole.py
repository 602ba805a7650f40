"""The cart-pole swing-up, one at a time."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Literal

import numpy as np
from jaxtyping import Float

from envs.cartpole_dynamics import CartPoleDynamics
from envs.cartpole_views import picture, scene
from envs.checks import read_array, read_stds, require_positive
from envs.correcting import Effects, correct
from envs.plants import cart_pole
from envs.swing_up import SwingUp
from envs.swing_up_env import SwingUpEnv
from envs.system import System
from mcpilco.plant import Plant
from mcpilco.policies import cart_pole_cost
from mcpilco.typing import Cost, InputError

LENGTHSCALES = (1.5, 1.0)
"""of the default cost: cart position [m], pole angle [rad]"""

MEASURED = {"all": None, "positions": (0, 2)}
"""which states the keyword `measured` stands for; None: all"""

OneOrFour = float | Sequence[float] | Float[np.ndarray, " 4"]


class CartPoleSwingUpEnv(SwingUpEnv):
    """Swing a hanging pole up and hold it there, by pushing the cart it hangs from.

    ## Description

    A cart runs on a rail; a uniform pole is hinged to it and hangs down. A horizontal force on the
    cart, held for 0.1 s at a time, must swing the pole up, balance it, and keep the cart near the
    origin. The equations of motion and their constants are those of PILCO's cart-pole [1],
    integrated to rounding error; see `envs.cartpole_dynamics.CartPoleDynamics`.

    The id is `mcpilco/CartPoleSwingUp-v0`, known after `import envs`; `gymnasium.make_vec` makes a
    `CartPoleSwingUpVectorEnv` of it.

    ## Action Space

    A `Box(-10, 10, (1,), float32)`. A force beyond a limit is clipped to it; NaN is an error.

    | Num | Action                   | Min | Max | Unit |
    |-----|--------------------------|-----|-----|------|
    | 0   | horizontal force on cart | -10 | 10  | N    |

    ## Observation Space

    A `Box` of shape (4,), float64: the state, measured with independent Gaussian noise. Any finite
    number may occur.

    | Num | Observation   | Symbol | Zero at    | Noise (std) | Unit  |
    |-----|---------------|--------|------------|-------------|-------|
    | 0   | cart position | q1     | the origin | 0.01        | m     |
    | 1   | cart velocity | q1'    | rest       | 0.01        | m/s   |
    | 2   | pole angle    | q2     | hanging    | 0.01        | rad   |
    | 3   | pole velocity | q2'    | rest       | 0.01        | rad/s |

    With `measured="positions"`, as the id `mcpilco/CartPoleSwingUpPositions-v0` makes it, the shape
    is (2,): cart position and pole angle, with the same noise. Whoever needs the velocities must
    estimate them; the true ones are in `info`.

    The pole is upright at pi, at -pi, and so on: the angle counts turns, it is not wrapped. It
    grows as the tip of the hanging pole moves towards positive cart positions.

    `info`, from `reset` and from `step`:

    | Key               | Content                                                      | Unit   |
    |-------------------|--------------------------------------------------------------|--------|
    | `state`           | the true state, without noise                                | above  |
    | `is_success`      | pole within 10 degrees of upright for at least the last 1 s  | [bool] |
    | `time_up_s`       | time within 10 degrees of upright, in this episode           | s      |
    | `mean_abs_cart_m` | mean distance of the cart from the origin, in this episode   | m      |

    The last three look at the true state every 0.01 s, see `envs.judge.UprightJudge`; they are
    False, 0 and 0 at the start.

    ## Rewards

    1 - cost of the true state after the step and of the force held in it, with the cost in [0, 1]

        cost = 1 - exp( -(q1 / 1.5 m)^2 - ((|q2| - pi) / 1 rad)^2 )

    of `mcpilco.policies.costs.cart_pole_cost`.

    ## Starting State

    Independent Gaussians with mean 0 and standard deviation 0.1, in each state's unit.
    `reset(options={"state": x})` starts exactly in x.

    ## Episode End

    The episode never terminates. It is truncated after 30 steps (3 s) when the env is made by id.

    ## Arguments

    | Keyword             | Meaning                                          | Default    | Unit   |
    |---------------------|--------------------------------------------------|------------|--------|
    | `cart_mass`         | mass of the cart                                 | 0.5        | kg     |
    | `pole_mass`         | mass of the pole                                 | 0.5        | kg     |
    | `pole_length`       | from hinge to tip                                | 0.5        | m      |
    | `cart_friction`     | viscous friction between cart and rail           | 0.1        | N s/m  |
    | `gravity`           | acceleration of gravity                          | 9.82       | m/s^2  |
    | `force_limit`       | largest force                                    | 10         | N      |
    | `dt`                | time for which a force is held                   | 0.1        | s      |
    | `start_std`         | spread of the starting state, one number or four | 0.1        | above  |
    | `noise_std`         | measurement noise, one number or four            | 0.01       | above  |
    | `effects`           | what the equations lack, see below               | None       |        |
    | `measured`          | `"all"` states, or `"positions"` only            | "all"      |        |
    | `cost`              | another cost of (states, inputs), in torch       | None       | [-]    |
    | `cost_lengthscales` | of the default cost: cart position, pole angle   | (1.5, 1.0) | m, rad |
    | `render_mode`       | None or `"rgb_array"`                            | None       |        |

    A wrong value raises `mcpilco.typing.InputError`.

    `effects` corrects the env by what was found missing in it: a file such as `gap/corrected.json`,
    what such a file holds, or a `mcpilco.plant.correction.Correction`. The constants above are
    then the
    nominal ones. Friction, delays, play and the like act in the motion, effects of sensors on the
    observation, before its noise; `info["state"]` stays the true state, and the force of the cost
    the one that was asked for. Before an episode the motor was off.

    ## References

    [1] Deisenroth, Efficient Reinforcement Learning using Gaussian Processes (2010), appendix C.2.

    ## Version History

    - v0: first version.
    """

    def __init__(
        self,
        *,
        cart_mass: float = 0.5,
        pole_mass: float = 0.5,
        pole_length: float = 0.5,
        cart_friction: float = 0.1,
        gravity: float = 9.82,
        force_limit: float = 10.0,
        dt: float = 0.1,
        start_std: OneOrFour = 0.1,
        noise_std: OneOrFour = 0.01,
        effects: Effects | None = None,
        measured: Literal["all", "positions"] = "all",
        cost: Cost | None = None,
        cost_lengthscales: Sequence[float] = LENGTHSCALES,
        render_mode: str | None = None,
    ) -> None:
        """The keywords are listed above under Arguments."""
        dynamics = CartPoleDynamics(
            cart_mass=cart_mass,
            pole_mass=pole_mass,
            pole_length=pole_length,
            cart_friction=cart_friction,
            gravity=gravity,
        )
        dynamics, plant = correct(dynamics, cart_pole(), effects)
        swing_up = cart_pole_swing_up(
            dynamics,
            force_limit=force_limit,
            dt=dt,
            start_std=start_std,
            noise_std=noise_std,
            cost=cost,
            cost_lengthscales=cost_lengthscales,
            plant=plant,
            measured=measured,
        )
        super().__init__(swing_up, scene(dynamics), partial(picture, dynamics), render_mode)


def cart_pole_swing_up(
    dynamics: System,
    *,
    force_limit: float,
    dt: float,
    start_std: OneOrFour,
    noise_std: OneOrFour,
    cost: Cost | None,
    cost_lengthscales: Sequence[float],
    plant: Plant | None = None,
    measured: Literal["all", "positions"],
) -> SwingUp:
    """The task of `CartPoleSwingUpEnv`, whatever simulates it; the keywords are its arguments.

    Raises:
        InputError: a value does not fit.
    """
    if measured not in MEASURED:
        raise InputError(f'measured must be "all" or "positions", got {measured!r}.')
    return SwingUp(
        dynamics=dynamics,
        input_limit=force_limit,
        dt=dt,
        start_std=read_stds("start_std", start_std, 4),
        noise_std=read_stds("noise_std", noise_std, 4),
        cost=_read_cost(cost, cost_lengthscales),
        links=(2,),
        cart=0,
        plant=plant,
        measured=MEASURED[measured],
    )


def _read_cost(cost: Cost | None, lengthscales: Sequence[float]) -> Cost:
    """The cost given, or the default with its lengthscales."""
    cart, angle = read_array("cost_lengthscales", lengthscales, (2,)).tolist()
    require_positive("cost_lengthscales[0]", cart, "m")
    require_positive("cost_lengthscales[1]", angle, "rad")
    if cost is None:
        return cart_pole_cost(cart, angle)
    if (cart, angle) != LENGTHSCALES:
        raise InputError(
            "cost_lengthscales belong to the default cost; pass either them or a cost, not both."
        )
    return cost
