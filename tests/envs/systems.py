"""Every system there is; a new one is a line here."""

from __future__ import annotations

from ctypes.util import find_library
from dataclasses import dataclass

import numpy as np
import pytest

import envs
from envs.mujoco_cartpole import MujocoCartPoleSwingUpEnv
from envs.swing_up_env import SwingUpEnv, SwingUpVectorEnv


@dataclass(frozen=True)
class System:
    """What the laws of all envs must know of one."""

    id: str
    single: type[SwingUpEnv]
    steps: int
    """of an episode"""
    chaotic: bool = False
    """whether two ways of rounding part within an episode"""

    def batch(
        self, num_envs: int = 1, max_episode_steps: int | None = -1, **options
    ) -> SwingUpVectorEnv:
        """The vector env; by default of the episodes that the id has."""
        steps = self.steps if max_episode_steps == -1 else max_episode_steps
        return SwingUpVectorEnv(self.single(**options), num_envs, steps)

    @property
    def followed(self) -> int:
        """Steps over which motions are compared, at most an episode."""
        return 10 if self.chaotic else self.steps

    @property
    def width(self) -> int:
        """How many states it has."""
        return self.single().swing_up.width

    @property
    def limit(self) -> float:
        """Largest input."""
        return self.single().swing_up.input_limit

    def state(self, angle: float = 0.0, speed: float = 0.0) -> np.ndarray:
        """All at rest but the angle that must be upright."""
        state, index = np.zeros(self.width), self.single().swing_up.links[0]
        state[index : index + 2] = angle, speed
        return state

    def action(self, share: float = 0.0) -> np.ndarray:
        """A share of the largest input."""
        return np.array([share * self.limit], dtype=np.float32)


SYSTEMS = [
    System("mcpilco/CartPoleSwingUp-v0", envs.CartPoleSwingUpEnv, 30),
    System("mcpilco/MujocoCartPoleSwingUp-v0", MujocoCartPoleSwingUpEnv, 30),
    System("mcpilco/Pendulum-v0", envs.PendulumEnv, 40),
    System("mcpilco/Pendubot-v0", envs.PendubotEnv, 50, chaotic=True),
    System("mcpilco/Acrobot-v0", envs.AcrobotEnv, 50, chaotic=True),
]

each_system = pytest.mark.parametrize("system", SYSTEMS, ids=lambda system: system.id)

needs_gl = pytest.mark.skipif(
    not (find_library("EGL") or find_library("OSMesa")), reason="no library of OpenGL is here"
)
each_drawn_system = pytest.mark.parametrize(
    "system",
    [pytest.param(system, marks=needs_gl if "Mujoco" in system.id else ()) for system in SYSTEMS],
    ids=lambda system: system.id,
)
