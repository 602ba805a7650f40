"""Swing-ups of a double pendulum with one motor: pendubot and acrobot."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from envs.checks import read_stds
from envs.correcting import Effects, correct
from envs.double_pendulum_dynamics import (
    AcrobotDynamics,
    DoublePendulumDynamics,
    PendubotDynamics,
)
from envs.double_pendulum_views import picture, scene
from envs.plants import acrobot, pendubot
from envs.swing_up import SwingUp
from envs.swing_up_env import SwingUpEnv
from mcpilco.plant import Plant
from mcpilco.policies import SaturatingCost
from mcpilco.typing import Cost

OneOrFour = float | Sequence[float] | Float[np.ndarray, " 4"]

COST = SaturatingCost((0, 2), (math.pi, 0.0), (1.5, 0.75), (True, True))
"""the default cost, of both angles"""
NOISE_STD = 0.001, 0.02, 0.001, 0.02
"""of the measured states [rad, rad/s]"""


class DoublePendulumEnv(SwingUpEnv):
    """What the envs with one motor have in common; each says in its docstring which it is."""

    equations: ClassVar[type[DoublePendulumDynamics]]
    plant: ClassVar[Callable[[], Plant]]

    def __init__(
        self,
        *,
        torque_limit: float = 6.0,
        dt: float = 0.05,
        start_std: OneOrFour = 0.01,
        noise_std: OneOrFour = NOISE_STD,
        effects: Effects | None = None,
        cost: Cost = COST,
        render_mode: str | None = None,
        **constants: Any,
    ) -> None:
        """The keywords are listed in the docstrings of the envs under Arguments."""
        dynamics, plant = correct(self.equations(**constants), type(self).plant(), effects)
        swing_up = SwingUp(
            dynamics=dynamics,
            input_limit=torque_limit,
            dt=dt,
            start_std=read_stds("start_std", start_std, 4),
            noise_std=read_stds("noise_std", noise_std, 4),
            cost=cost,
            links=dynamics.angles,
            plant=plant,
        )
        super().__init__(swing_up, scene(dynamics), partial(picture, dynamics), render_mode)


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
    `armature` of 0.0023 kg m^2 in both. The equations of motion are integrated to rounding error;
    see `envs.double_pendulum_dynamics.DoublePendulumDynamics`.

    An episode has 2.5 s. A swing takes about a second, and the last second must be spent upright.

    The id is `mcpilco/Pendubot-v0`, known after `import envs`; `gymnasium.make_vec` makes a
    `PendubotVectorEnv` of it.

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
    | `effects`           | what the equations lack, see below               | None    |           |
    | `cost`              | a cost of (states, inputs), in torch             | above   | [-]       |
    | `render_mode`       | None or `"rgb_array"`                            | None    |           |

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

    equations = PendubotDynamics
    plant = staticmethod(pendubot)


class AcrobotEnv(DoublePendulumEnv):
    """Swing a hanging double pendulum up with a motor in its elbow, and balance both links.

    ## Description

    The double pendulum of `PendubotEnv`, whose motor moved to the elbow while the shoulder turns
    freely, like a gymnast on a bar. It can only swing by bending, and balance by bending too, which
    takes more of the sensors: noise that moves a balanced pendubot by 1 degree moves it by 3.

    The id is `mcpilco/Acrobot-v0`, known after `import envs`; `gymnasium.make_vec` makes an
    `AcrobotVectorEnv` of it.

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

    equations = AcrobotDynamics
    plant = staticmethod(acrobot)
