"""The cart-pole swing-up: its task, what it looks like, and the env."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Float, UInt8

from envs import drawing
from envs.checks import read_array, require_positive
from envs.plants import cart_pole
from envs.swing_up import SwingUp
from envs.swing_up_env import PlantEnv
from mcpilco.plant import ChainPlant
from mcpilco.policies import cart_pole_cost
from mcpilco.show import Pose, Scene, Shape
from mcpilco.typing import Cost, InputError

LENGTHSCALES = (1.5, 1.0)
"""of the default cost: cart position [m], pole angle [rad]"""
MEASURED = {"all": None, "positions": (0, 2)}
"""which states the keyword `measured` stands for; None: all"""

SWING_UP = SwingUp(
    plant=cart_pole(),
    input_limit=10.0,
    dt=0.1,
    start_std=0.1,
    noise_std=0.01,
    cost=cart_pole_cost(*LENGTHSCALES),
    links=(2,),
    cart=0,
)

CART_COLOR = (64, 84, 120)

# sizes in pole lengths [-], so that a cart-pole of any size looks the same
CART_HALF = (0.24, 0.14, 0.11)
RAIL_HALF = (6.0, 0.03, 0.02)

VIEW_WIDTH = 5.4
"""width of a picture, in pole lengths [-]"""
VIEW_MARGIN = 1.6
"""how far from the middle the cart may be before the view follows it, in pole lengths [-]"""


class CartPoleSwingUpEnv(PlantEnv):
    """Swing a hanging pole up and hold it there, by pushing the cart it hangs from.

    ## Description

    A cart runs on a rail; a uniform pole is hinged to it and hangs down. A horizontal force on the
    cart, held for 0.1 s at a time, must swing the pole up, balance it, and keep the cart near the
    origin. The equations of motion and their constants are those of PILCO's cart-pole [1]; with
    a = m_p l / 2, the first moment of the pole's mass, and u the force:

        [ m_c + m_p    a cos q2    ] [ q1'' ]   [ u - b q1' + a sin(q2) q2'^2 ]
        [ a cos q2     m_p l^2 / 3 ] [ q2'' ] = [ - a g sin q2                ]

    The id is `mcpilco/CartPoleSwingUp-v0`, known after `import envs`; `gymnasium.make_vec` makes a
    `SwingUpVectorEnv` of it.

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
    | `effects`           | what the equations lack, see `PlantEnv`          | None       |        |
    | `measured`          | `"all"` states, or `"positions"` only            | "all"      |        |
    | `cost`              | another cost of (states, inputs), in torch       | None       | [-]    |
    | `cost_lengthscales` | of the default cost: cart position, pole angle   | (1.5, 1.0) | m, rad |
    | `render_mode`       | None or `"rgb_array"`                            | None       |        |

    A wrong value raises `mcpilco.typing.InputError`.

    ## References

    [1] Deisenroth, Efficient Reinforcement Learning using Gaussian Processes (2010), appendix C.2.

    ## Version History

    - v0: first version.
    """

    nominal = SWING_UP

    def __init__(
        self,
        *,
        measured: Literal["all", "positions"] = "all",
        cost: Cost | None = None,
        cost_lengthscales: Sequence[float] = LENGTHSCALES,
        **keywords: Any,
    ) -> None:
        super().__init__(
            measured=observed(measured), cost=read_cost(cost, cost_lengthscales), **keywords
        )

    @staticmethod
    def scene_of(plant: ChainPlant) -> Scene:
        """The cart-pole in the x-z plane, the hinge at z = 0; the marker is the pole's tip."""
        length = plant.values["pole_length"]
        radius = drawing.POLE_RADIUS * length

        def tip(states: Float[np.ndarray, "*b 4"]) -> Float[np.ndarray, "*b 3"]:
            end = drawing.hanging_end(length, states[..., 2])
            end[..., 0] += states[..., 0]
            return end

        def poses(states: Float[np.ndarray, "T 4"]) -> Mapping[str, Pose]:
            hinge = np.zeros((len(states), 3))
            hinge[:, 0] = states[:, 0]
            return {
                "cart": Pose(hinge, drawing.upright(len(states))),
                "pole": Pose(0.5 * (hinge + tip(states)), drawing.hanging(states[:, 2])),
            }

        shapes = {
            "cart": Shape("box", tuple(length * half for half in CART_HALF), CART_COLOR),
            "pole": Shape("capsule", (radius, 0.5 * length), drawing.POLE_COLOR),
        }
        return drawing.standing_scene(RAIL_HALF, length, shapes=shapes, poses=poses, marker=tip)

    @staticmethod
    def picture_of(
        plant: ChainPlant, scene: Scene, state: Float[np.ndarray, " 4"], push: float
    ) -> UInt8[np.ndarray, "H W 3"]:
        """The cart-pole from the side, with its rail, the target of the tip and the force."""
        length = plant.values["pole_length"]
        cart = float(state[0]) / length
        tip_x, _, tip_z = (scene.marker(state) / length).tolist()
        middle = cart - min(max(cart, -VIEW_MARGIN), VIEW_MARGIN)
        left, right = middle - VIEW_WIDTH, middle + VIEW_WIDTH

        # the picture's unit is the length of the pole
        canvas = drawing.blank(VIEW_WIDTH, (middle, 0.0))
        canvas.line((left, 0.0), (right, 0.0), RAIL_HALF[2], drawing.FIXED_COLOR)
        for tick in map(float, range(round(left), round(right) + 1)):
            canvas.line((tick, -0.06), (tick, 0.06), 0.008, drawing.FIXED_COLOR)
        canvas.ring((0.0, 1.0), 0.08, 0.02, drawing.TARGET_COLOR)
        canvas.disc((0.0, 1.0), 0.02, drawing.TARGET_COLOR)
        canvas.box((cart, 0.0), CART_HALF[::2], 0.04, CART_COLOR)
        if push:
            side = cart + math.copysign(CART_HALF[0] + 0.06, push)
            canvas.arrow((side, 0.0), (side + 0.5 * push, 0.0), 0.02, drawing.INPUT_COLOR)
        canvas.line((cart, 0.0), (tip_x, tip_z), drawing.POLE_RADIUS, drawing.POLE_COLOR)
        canvas.disc((cart, 0.0), 0.5 * drawing.POLE_RADIUS, drawing.BACKGROUND)
        return canvas.image()


def observed(measured: Literal["all", "positions"]) -> tuple[int, ...] | None:
    """The states that the keyword `measured` of a cart-pole stands for; None: all."""
    if measured not in MEASURED:
        raise InputError(f'measured must be "all" or "positions", got {measured!r}.')
    return MEASURED[measured]


def read_cost(cost: Cost | None, lengthscales: Sequence[float]) -> Cost:
    """The cost given, or a cart-pole's default with its lengthscales."""
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
