"""Environments: plants with a task and a scene; importing this package registers them.

    import envs, gymnasium
    env = gymnasium.make("mcpilco/CartPoleSwingUp-v0")

To read in this order: `plants` (the bodies and joints that move, and `register`), `cartpole` (a
task with a scene), `swing_up` (how plant and task fit), `swing_up_env` (episodes, single and in
batches), `motion` (the simulation), `judge` (success). `mujoco_cartpole` is the same task with
MuJoCo as its engine; `arms` are robots that are only recorded. A new system is a plant in `plants`
and a module such as `pendulum`; in a file of your own it is both, and a call of `register`.
"""

from __future__ import annotations

from envs.cartpole import CartPoleSwingUpEnv
from envs.double_pendulum import AcrobotEnv, PendubotEnv
from envs.judge import UprightJudge
from envs.pendulum import PendulumEnv
from envs.plants import MODELS, PLANTS, plant_named, register, rod
from envs.swing_up import SwingUp
from envs.swing_up_env import PlantEnv, SwingUpEnv, SwingUpVectorEnv

__all__ = [
    "MODELS",
    "PLANTS",
    "AcrobotEnv",
    "CartPoleSwingUpEnv",
    "PendubotEnv",
    "PendulumEnv",
    "PlantEnv",
    "SwingUp",
    "SwingUpEnv",
    "SwingUpVectorEnv",
    "UprightJudge",
    "plant_named",
    "register",
    "rod",
]
