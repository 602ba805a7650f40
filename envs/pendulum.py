"""The pendulum swing-up, one at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from jaxtyping import Float

from envs.checks import read_stds
from envs.correcting import Effects, correct
from envs.pendulum_dynamics import PendulumDynamics
from envs.pendulum_views import picture, scene
from envs.plants import pendulum
from envs.swing_up import SwingUp
from envs.swing_up_env import SwingUpEnv
from mcpilco.policies import SaturatingCost
from mcpilco.typing import Cost

COST = SaturatingCost((0,), (math.pi,), (1.0,), (True,))
"""the default cost, of the angle alone"""

OneOrTwo = float | Sequence[float] | Float[np.ndarray, " 2"]


class PendulumEnv(SwingUpEnv):
    """Swing a hanging pendulum up and hold it there, with a motor too weak to lift it at once.

    ## Description

    A mass hangs on a rod. A motor in the hinge, whose torque is held for 0.1 s at a time, must
    swing it up and balance it. Holding the rod level takes 2.95 N m and the motor has 1.2 N m, so
    that it must swing: at its best to 0.8 rad, to 1.8 rad on the other side, and up with the third
    swing, 2.5 s after it began. That leaves half a second of the 4 s to err. A motor of 1.0 N m
    needs one swing more, one of 1.4 N m one less. The equation of motion is integrated to rounding
    error; see `envs.pendulum_dynamics.PendulumDynamics`.

    The id is `mcpilco/Pendulum-v0`, known after `import envs`; `gymnasium.make_vec` makes a
    `PendulumVectorEnv` of it.

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
    | `effects`      | what the equation lacks, see below               | None    |             |
    | `cost`         | a cost of (states, inputs), in torch             | above   | [-]         |
    | `render_mode`  | None or `"rgb_array"`                            | None    |             |

    A wrong value raises `mcpilco.typing.InputError`.

    `effects` corrects the env by what was found missing in it: a file such as `gap/corrected.json`,
    what such a file holds, or a `mcpilco.plant.correction.Correction`. The constants above are
    then the
    nominal ones. Friction, delays, play and the like act in the motion, effects of sensors on the
    observation, before its noise; `info["state"]` stays the true state, and the torque of the cost
    the one that was asked for. Before an episode the motor was off.

    ## Version History

    - v0: first version.
    """

    def __init__(
        self,
        *,
        mass: float = 0.6,
        length: float = 0.5,
        friction: float = 0.05,
        gravity: float = 9.82,
        torque_limit: float = 1.2,
        dt: float = 0.1,
        start_std: OneOrTwo = 0.1,
        noise_std: OneOrTwo = 0.01,
        effects: Effects | None = None,
        cost: Cost = COST,
        render_mode: str | None = None,
    ) -> None:
        """The keywords are listed above under Arguments."""
        dynamics = PendulumDynamics(mass=mass, length=length, friction=friction, gravity=gravity)
        dynamics, plant = correct(dynamics, pendulum(), effects)
        swing_up = SwingUp(
            dynamics=dynamics,
            input_limit=torque_limit,
            dt=dt,
            start_std=read_stds("start_std", start_std, 2),
            noise_std=read_stds("noise_std", noise_std, 2),
            cost=cost,
            links=(0,),
            plant=plant,
        )
        super().__init__(swing_up, scene(dynamics), partial(picture, dynamics), render_mode)
