"""Swing-ups of a double pendulum with one motor, pendubot and acrobot: tasks, looks and envs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from jaxtyping import Float, UInt8

from envs import drawing
from envs.plants import acrobot, pendubot
from envs.swing_up import SwingUp
from envs.swing_up_env import PlantEnv
from mcpilco.plant import ChainPlant
from mcpilco.policies import SaturatingCost
from mcpilco.show import Pose, Scene, Shape

PENDUBOT = SwingUp(
    plant=pendubot(),
    input_limit=6.0,
    dt=0.05,
    start_std=0.01,
    noise_std=(0.001, 0.02, 0.001, 0.02),
    cost=SaturatingCost((0, 2), (math.pi, 0.0), (1.5, 0.75), (True, True)),
    links=(0, 2),
)
ACROBOT = replace(PENDUBOT, plant=acrobot())

# sizes in lengths of both links together [-], so that one of any size looks the same
JOINT_RADIUS = 0.05
TIP_RADIUS = 0.04
MOTOR_HALF = (0.07, 0.1, 0.07)
ARC_RADIUS = 0.2

VIEW_WIDTH = 4.4
"""width of a picture, in lengths of both links together [-]"""


class DoublePendulumEnv(PlantEnv):
    """The look that pendubot and acrobot share."""

    @staticmethod
    def scene_of(plant: ChainPlant) -> Scene:
        """The links in 3D: in the x-z plane, the shoulder at the origin; the marker is the tip."""
        upper_length, lower_length = plant.values["upper_length"], plant.values["lower_length"]
        reach = upper_length + lower_length
        radius = drawing.POLE_RADIUS * reach

        def elbow_of(states: Float[np.ndarray, "*b 4"]) -> Float[np.ndarray, "*b 3"]:
            return drawing.hanging_end(upper_length, states[..., 0])

        def tip_of(states: Float[np.ndarray, "*b 4"]) -> Float[np.ndarray, "*b 3"]:
            angle = np.asarray(states[..., 0] + states[..., 2])
            return elbow_of(states) + drawing.hanging_end(lower_length, angle)

        def poses(states: Float[np.ndarray, "T 4"]) -> Mapping[str, Pose]:
            elbow, tip = elbow_of(states), tip_of(states)
            upper = drawing.hanging(states[:, 0])
            lower = drawing.hanging(states[:, 0] + states[:, 2])
            return {
                "upper": Pose(0.5 * elbow, upper),
                "lower": Pose(0.5 * (elbow + tip), lower),
                "elbow": Pose(elbow, upper),
                "tip": Pose(tip, lower),
            }

        shapes = {
            "upper": Shape("capsule", (radius, 0.5 * upper_length), drawing.FIXED_COLOR),
            "lower": Shape("capsule", (radius, 0.5 * lower_length), drawing.POLE_COLOR),
            "elbow": Shape("sphere", (JOINT_RADIUS * reach,), drawing.FIXED_COLOR),
            "tip": Shape("sphere", (TIP_RADIUS * reach,), drawing.POLE_COLOR),
        }
        return drawing.standing_scene(MOTOR_HALF, reach, shapes=shapes, poses=poses, marker=tip_of)

    @staticmethod
    def picture_of(
        plant: ChainPlant, scene: Scene, state: Float[np.ndarray, " 4"], push: float
    ) -> UInt8[np.ndarray, "H W 3"]:
        """The links from the side, with the target of their tip and the torque at its joint."""
        shoulder = (0.0, 0.0)
        # the picture's unit is the length of both links together
        reach = plant.values["upper_length"] + plant.values["lower_length"]
        poses = scene.poses(state[None])
        elbow, tip = (
            (poses[name].translation[0, ::2] / reach).tolist() for name in ("elbow", "tip")
        )
        canvas = drawing.blank(VIEW_WIDTH, shoulder)
        canvas.box(shoulder, MOTOR_HALF[::2], 0.03, drawing.FIXED_COLOR)
        canvas.ring((0.0, 1.0), 0.08, 0.02, drawing.TARGET_COLOR)
        canvas.line(shoulder, elbow, drawing.POLE_RADIUS, drawing.FIXED_COLOR)
        canvas.line(elbow, tip, drawing.POLE_RADIUS, drawing.POLE_COLOR)
        canvas.disc(elbow, JOINT_RADIUS, drawing.FIXED_COLOR)
        canvas.disc(tip, TIP_RADIUS, drawing.POLE_COLOR)
        for joint in (shoulder, elbow):
            canvas.disc(joint, 0.5 * drawing.POLE_RADIUS, drawing.BACKGROUND)
        drawing.twist(canvas, (shoulder, elbow)[plant.layout.drives[0]], push, ARC_RADIUS)
        return canvas.image()


class PendubotEnv(DoublePendulumEnv):
    """Swing a hanging double pendulum up with a motor in its shoulder, and balance both links.

    ## Description

    An upper link hangs from a motor, the shoulder, and a lower one from its end, the elbow, which
    turns freely. The torque is held for 0.05 s at a time. The motor is strong enough to lift both
    links, 3.82 N m where they are level, but it cannot hold the lower one up but by moving the
    upper one under it: what falls doubles its distance from upright in 0.07 s. The numbers are
    those of the DFKI's double pendulum, design C.1, and of the simulations of its leaderboard, but
    for a little viscous friction. The machine has dry friction and its motors' inertias besides,
    which are `effects`: `coulomb_friction` of 0.25 N m in the shoulder and 0.19 N m in the elbow,
    `armature` of 0.0023 kg m^2 in both. With r
    the distances of the centers of mass from the joints, I the inertias about the centers, and
    tau the torque, here in the shoulder:

        [a + c + 2 h cos q2, c + h cos q2]  [q1'']   [s (2 q1' q2' + q2'^2) - g1 - b1 q1' + tau]
        [c + h cos q2,       c           ]  [q2''] = [-s q1'^2              - g2 - b2 q2'      ]

        a = I1 + m1 r1^2 + m2 l1^2,    c = I2 + m2 r2^2,    h = m2 l1 r2,    s = h sin q2
        g1 = (m1 r1 + m2 l1) g sin q1 + g2,    g2 = m2 r2 g sin(q1 + q2)

    An episode has 2.5 s. A swing takes about a second, and the last second must be spent upright.

    The id is `mcpilco/Pendubot-v0`, known after `import envs`; `gymnasium.make_vec` makes a
    `SwingUpVectorEnv` of it. `mcpilco/BoardPendubot-v0` has the exact numbers of the leaderboard,
    no friction and no noise, for 10 s.

    ## Action Space

    A `Box(-6, 6, (1,), float32)`. A torque beyond a limit is clipped to it; NaN is an error.

    | Num | Action                 | Min | Max | Unit |
    |-----|------------------------|-----|-----|------|
    | 0   | torque in the shoulder | -6  | 6   | N m  |

    ## Observation Space

    A `Box` of shape (4,), float64: the state, measured with independent Gaussian noise. Any finite
    number may occur.

    | Num | Observation              | Symbol | Zero at   | Noise (std) | Unit  |
    |-----|--------------------------|--------|-----------|-------------|-------|
    | 0   | angle of the upper link  | q1     | hanging   | 0.001       | rad   |
    | 1   | velocity of the shoulder | q1'    | rest      | 0.02        | rad/s |
    | 2   | angle of the lower link  | q2     | stretched | 0.001       | rad   |
    |     | relative to the upper    |        |           |             |       |
    | 3   | velocity of the elbow    | q2'    | rest      | 0.02        | rad/s |

    Both links are upright where q1 is pi and q2 is 0: the angles count turns, they are not wrapped.
    They grow as what hangs on their joint moves to positive x.

    `info`, from `reset` and from `step`:

    | Key          | Content                                                          | Unit   |
    |--------------|------------------------------------------------------------------|--------|
    | `state`      | the true state, without noise                                    | above  |
    | `is_success` | each link within 10 degrees of upright for at least the last 1 s | [bool] |
    | `time_up_s`  | time with each link within 10 degrees of upright, in this episode | s     |

    The last two look at the true state every 0.01 s, see `envs.judge.UprightJudge`; they are False
    and 0 at the start.

    ## Rewards

    1 - cost of the true state after the step and of the torque held in it, with the cost in [0, 1]

        cost = 1 - exp( -((|q1| - pi) / 1.5 rad)^2 - (q2 / 0.75 rad)^2 )

    a `mcpilco.policies.costs.SaturatingCost`.

    ## Starting State

    Independent Gaussians with mean 0 and standard deviation 0.01, in each state's unit.
    `reset(options={"state": x})` starts exactly in x.

    ## Episode End

    The episode never terminates. It is truncated after 50 steps (2.5 s) when the env is made by id.

    ## Arguments

    | Keyword             | Meaning                                          | Default | Unit      |
    |---------------------|--------------------------------------------------|---------|-----------|
    | `upper_mass`        | mass of the upper link                           | 0.523   | kg        |
    | `upper_length`      | from shoulder to elbow                           | 0.2     | m         |
    | `lower_mass`        | mass of the lower link                           | 0.626   | kg        |
    | `lower_length`      | from elbow to tip                                | 0.3     | m         |
    | `shoulder_friction` | viscous friction                                 | 0.001   | N m s/rad |
    | `elbow_friction`    | viscous friction                                 | 0.001   | N m s/rad |
    | `gravity`           | acceleration of gravity                          | 9.81    | m/s^2     |
    | `upper_center`      | center of mass from shoulder, to its length      | 1.0     | -         |
    | `upper_inertia`     | inertia about the center, to mass times length^2 | 0.523   | -         |
    | `lower_center`      | center of mass from elbow, to its length         | 0.852   | -         |
    | `lower_inertia`     | inertia about the center, to mass times length^2 | 0.177   | -         |
    | `torque_limit`      | largest torque                                   | 6.0     | N m       |
    | `dt`                | time for which a torque is held                  | 0.05    | s         |
    | `start_std`         | spread of the start, one number or four          | 0.01    | above     |
    | `noise_std`         | measurement noise, one number or four            | above   | above     |
    | `effects`           | what the equations lack, see `PlantEnv`          | None    |           |
    | `cost`              | a cost of (states, inputs), in torch             | above   | [-]       |
    | `render_mode`       | None or `"rgb_array"`                            | None    |           |

    A wrong value raises `mcpilco.typing.InputError`.

    ## Version History

    - v0: first version.
    """

    nominal = PENDUBOT


class AcrobotEnv(DoublePendulumEnv):
    """Swing a hanging double pendulum up with a motor in its elbow, and balance both links.

    ## Description

    The double pendulum of `PendubotEnv`, whose motor moved to the elbow while the shoulder turns
    freely, like a gymnast on a bar. It can only swing by bending, and balance by bending too, which
    takes more of the sensors: noise that moves a balanced pendubot by 1 degree moves it by 3.

    The id is `mcpilco/Acrobot-v0`, known after `import envs`; `gymnasium.make_vec` makes a
    `SwingUpVectorEnv` of it.

    ## Action Space

    A `Box(-6, 6, (1,), float32)`. A torque beyond a limit is clipped to it; NaN is an error.

    | Num | Action              | Min | Max | Unit |
    |-----|---------------------|-----|-----|------|
    | 0   | torque in the elbow | -6  | 6   | N m  |

    ## Observation Space, Rewards, Starting State, Arguments

    Those of `PendubotEnv`.

    ## Episode End

    The episode never terminates. It is truncated after 50 steps (2.5 s) when the env is made by id.

    ## Version History

    - v0: first version.
    """

    nominal = ACROBOT
