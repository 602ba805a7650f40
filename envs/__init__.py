"""Environments; importing this package registers them with Gymnasium.

import envs, gymnasium
env = gymnasium.make("mcpilco/CartPoleSwingUp-v0")
"""

from __future__ import annotations

import gymnasium

from envs.cartpole import CartPoleSwingUpEnv
from envs.cartpole_dynamics import CartPoleDynamics
from envs.cartpole_vector import CartPoleSwingUpVectorEnv
from envs.double_pendulum import AcrobotEnv, PendubotEnv
from envs.double_pendulum_dynamics import AcrobotDynamics, PendubotDynamics
from envs.double_pendulum_vector import AcrobotVectorEnv, PendubotVectorEnv
from envs.judge import UprightJudge
from envs.pendulum import PendulumEnv
from envs.pendulum_dynamics import PendulumDynamics
from envs.pendulum_vector import PendulumVectorEnv
from envs.plants import PLANTS

__all__ = [
    "PLANTS",
    "AcrobotDynamics",
    "AcrobotEnv",
    "AcrobotVectorEnv",
    "CartPoleDynamics",
    "CartPoleSwingUpEnv",
    "CartPoleSwingUpVectorEnv",
    "PendubotDynamics",
    "PendubotEnv",
    "PendubotVectorEnv",
    "PendulumDynamics",
    "PendulumEnv",
    "PendulumVectorEnv",
    "UprightJudge",
]

gymnasium.register(
    id="mcpilco/CartPoleSwingUp-v0",
    entry_point="envs.cartpole:CartPoleSwingUpEnv",
    vector_entry_point="envs.cartpole_vector:CartPoleSwingUpVectorEnv",
    max_episode_steps=30,
)
# named only, so that MuJoCo is loaded where it is used
gymnasium.register(
    id="mcpilco/MujocoCartPoleSwingUp-v0",
    entry_point="envs.mujoco_cartpole:MujocoCartPoleSwingUpEnv",
    vector_entry_point="envs.mujoco_cartpole_vector:MujocoCartPoleSwingUpVectorEnv",
    max_episode_steps=30,
)
gymnasium.register(
    id="mcpilco/CartPoleSwingUpPositions-v0",
    entry_point="envs.cartpole:CartPoleSwingUpEnv",
    vector_entry_point="envs.cartpole_vector:CartPoleSwingUpVectorEnv",
    max_episode_steps=30,
    kwargs={"measured": "positions"},
)
gymnasium.register(
    id="mcpilco/Pendulum-v0",
    entry_point="envs.pendulum:PendulumEnv",
    vector_entry_point="envs.pendulum_vector:PendulumVectorEnv",
    max_episode_steps=40,
)
gymnasium.register(
    id="mcpilco/Pendubot-v0",
    entry_point="envs.double_pendulum:PendubotEnv",
    vector_entry_point="envs.double_pendulum_vector:PendubotVectorEnv",
    max_episode_steps=50,
)
gymnasium.register(
    id="mcpilco/Acrobot-v0",
    entry_point="envs.double_pendulum:AcrobotEnv",
    vector_entry_point="envs.double_pendulum_vector:AcrobotVectorEnv",
    max_episode_steps=50,
)
