"""The pendulum swing-up: its task, what it looks like, and the env."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float, UInt8

from envs import drawing
from envs.plants import pendulum
from envs.swing_up import SwingUp
from envs.swing_up_env import PlantEnv
from mcpilco.plant import ChainPlant
from mcpilco.policies import SaturatingCost
from mcpilco.show import Pose, Scene, Shape

SWING_UP = SwingUp(
    plant=pendulum(),
    input_limit=1.2,
    dt=0.1,
    start_std=0.1,
    noise_std=0.01,
    cost=SaturatingCost((0,), (math.pi,), (1.0,), (True,)),
    links=(0,),
)

# sizes in lengths of the pendulum [-], so that one of any size looks the same
MASS_RADIUS = 0.11
MOTOR_HALF = (0.1, 0.14, 0.1)
ARC_RADIUS = 0.3

VIEW_WIDTH = 4.4
"""width of a picture, in lengths of the pendulum [-]"""


class PendulumEnv(PlantEnv):
    """Swing a hanging pendulum up and hold it there, with a motor too weak to lift it at once.

    ## Description

    A mass hangs on a rod. A motor in the hinge, whose torque is held for 0.1 s at a time, must
    swing it up and balance it. Holding the rod level takes 2.95 N m and the motor has 1.2 N m, so
    that it must swing: at its best to 0.8 rad, to 1.8 rad on the other side, and up with the third
    swing, 2.5 s after it began. That leaves half a second of the 4 s to err. A motor of 1.0 N m
    needs one swing more, one of 1.4 N m one less. With tau the torque:

        m l^2 q'' = tau - b q' - m g l sin q

    The id is `mcpilco/Pendulum-v0`, known after `import envs`; `gymnasium.make_vec` makes a
    `SwingUpVectorEnv` of it.

    ## Action Space

    A `Box(-1.2, 1.2, (1,), float32)`. A torque beyond a limit is clipped to it; NaN is an error.

    | Num | Action              | Min  | Max | Unit |
    |-----|---------------------|------|-----|------|
    | 0   | torque in the hinge | -1.2 | 1.2 | N m  |

    ## Observation Space

    A `Box` of shape (2,), float64: the state, measured with independent Gaussian noise. Any finite
    number may occur.

    | Num | Observation | Symbol | Zero at | Noise (std) | Unit  |
    |-----|-------------|--------|---------|-------------|-------|
    | 0   | angle       | q      | hanging | 0.01        | rad   |
    | 1   | velocity    | q'     | rest    | 0.01        | rad/s |

    The rod is upright at pi, at -pi, and so on: the angle counts turns, it is not wrapped. It grows
    under a positive torque, as the hanging mass moves to positive x.

    `info`, from `reset` and from `step`:

    | Key          | Content                                                     | Unit   |
    |--------------|-------------------------------------------------------------|--------|
    | `state`      | the true state, without noise                               | above  |
    | `is_success` | rod within 10 degrees of upright for at least the last 1 s  | [bool] |
    | `time_up_s`  | time within 10 degrees of upright, in this episode          | s      |

    The last two look at the true state every 0.01 s, see `envs.judge.UprightJudge`; they are False
    and 0 at the start.

    ## Rewards

    1 - cost of the true state after the step and of the torque held in it, with the cost in [0, 1]

        cost = 1 - exp( -((|q| - pi) / 1 rad)^2 )

    a `mcpilco.policies.costs.SaturatingCost`.

    ## Starting State

    Independent Gaussians with mean 0 and standard deviation 0.1, in each state's unit.
    `reset(options={"state": x})` starts exactly in x.

    ## Episode End

    The episode never terminates. It is truncated after 40 steps (4 s) when the env is made by id.

    ## Arguments

    | Keyword        | Meaning                                          | Default | Unit        |
    |----------------|--------------------------------------------------|---------|-------------|
    | `mass`         | mass at the end of the rod                       | 0.6     | kg          |
    | `length`       | from hinge to mass                               | 0.5     | m           |
    | `friction`     | viscous friction in the hinge                    | 0.05    | N m s/rad   |
    | `gravity`      | acceleration of gravity                          | 9.82    | m/s^2       |
    | `torque_limit` | largest torque                                   | 1.2     | N m         |
    | `dt`           | time for which a torque is held                  | 0.1     | s           |
    | `start_std`    | spread of the starting state, one number or two  | 0.1     | above       |
    | `noise_std`    | measurement noise, one number or two             | 0.01    | above       |
    | `effects`      | what the equation lacks, see `PlantEnv`          | None    |             |
    | `cost`         | a cost of (states, inputs), in torch             | above   | [-]         |
    | `render_mode`  | None or `"rgb_array"`                            | None    |             |

    A wrong value raises `mcpilco.typing.InputError`.

    ## Version History

    - v0: first version.
    """

    nominal = SWING_UP

    @staticmethod
    def scene_of(plant: ChainPlant) -> Scene:
        """The pendulum in 3D: in the x-z plane, the hinge at the origin; the marker is the mass."""
        length = plant.values["length"]
        radius = drawing.POLE_RADIUS * length

        def tip(states: Float[np.ndarray, "*b 2"]) -> Float[np.ndarray, "*b 3"]:
            return drawing.hanging_end(length, states[..., 0])

        def poses(states: Float[np.ndarray, "T 2"]) -> Mapping[str, Pose]:
            mass, turned = tip(states), drawing.hanging(states[:, 0])
            return {"rod": Pose(0.5 * mass, turned), "mass": Pose(mass, turned)}

        shapes = {
            "rod": Shape("capsule", (radius, 0.5 * length), drawing.FIXED_COLOR),
            "mass": Shape("sphere", (MASS_RADIUS * length,), drawing.POLE_COLOR),
        }
        return drawing.standing_scene(MOTOR_HALF, length, shapes=shapes, poses=poses, marker=tip)

    @staticmethod
    def picture_of(
        plant: ChainPlant, scene: Scene, state: Float[np.ndarray, " 2"], push: float
    ) -> UInt8[np.ndarray, "H W 3"]:
        """The pendulum from the side, with the target of its mass and the torque."""
        x, _, z = (scene.marker(state) / plant.values["length"]).tolist()
        # the picture's unit is the length of the pendulum
        canvas = drawing.blank(VIEW_WIDTH, (0.0, 0.0))
        canvas.box((0.0, 0.0), MOTOR_HALF[::2], 0.04, drawing.FIXED_COLOR)
        canvas.ring((0.0, 1.0), 0.08, 0.02, drawing.TARGET_COLOR)
        canvas.line((0.0, 0.0), (x, z), drawing.POLE_RADIUS, drawing.FIXED_COLOR)
        canvas.disc((x, z), MASS_RADIUS, drawing.POLE_COLOR)
        canvas.disc((0.0, 0.0), 0.5 * drawing.POLE_RADIUS, drawing.BACKGROUND)
        drawing.twist(canvas, (0.0, 0.0), push, ARC_RADIUS)
        return canvas.image()
