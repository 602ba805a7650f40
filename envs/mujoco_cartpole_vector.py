"""MuJoCo's cart-pole swing-up, many at a time."""

from __future__ import annotations

from typing import Any

from envs.mujoco_cartpole import MujocoCartPoleSwingUpEnv
from envs.mujoco_views import MujocoPicture
from envs.swing_up_vector import SwingUpVectorEnv


class MujocoCartPoleSwingUpVectorEnv(SwingUpVectorEnv):
    """`num_envs` cart-poles in one batch; see `SwingUpVectorEnv` and `MujocoCartPoleSwingUpEnv`."""

    picture: MujocoPicture

    def __init__(
        self, num_envs: int = 1, *, max_episode_steps: int | None = 30, **options: Any
    ) -> None:
        """A batch of envs with the same physics.

        Args:
            num_envs: how many cart-poles.
            max_episode_steps: steps after which an episode is truncated; None never does.
            **options: the keywords of `MujocoCartPoleSwingUpEnv`.

        Raises:
            InputError: a value does not fit.
        """
        super().__init__(MujocoCartPoleSwingUpEnv(**options), num_envs, max_episode_steps)

    def close_extras(self, **kwargs: Any) -> None:
        """Gives OpenGL back."""
        self.picture.close()
